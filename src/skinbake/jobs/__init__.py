"""The same work on many files: who does it, and what is remembered of it."""
