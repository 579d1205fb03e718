"""The algorithms of the paper, step by step on the CPU, and the cost of each step."""
