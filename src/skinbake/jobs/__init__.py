"""The work on many files: the processes that do it, and the state file that remembers it."""
