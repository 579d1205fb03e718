"""The algorithms of the paper, step by step on the CPU, and what each step costs."""
