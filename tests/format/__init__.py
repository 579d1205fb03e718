"""Tests of a bake inside a file: the note, what is stored, and how it is taken out again."""
