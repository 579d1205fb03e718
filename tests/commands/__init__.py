"""Tests of what commands do beneath the command line."""
