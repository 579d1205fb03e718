"""Tests of the files by which other tools run skinbake: an action, hooks, and examples of builds."""
