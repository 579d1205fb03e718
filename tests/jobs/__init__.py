"""Tests of work on many files: processes, clusters, URLs, the state file."""
