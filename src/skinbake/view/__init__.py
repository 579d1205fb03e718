"""One self-contained page that shows a model: its files, and the python that puts them together."""
