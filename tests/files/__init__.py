"""Tests of names, folders and files on the disk: what is read, and what is written whole or not at all."""
