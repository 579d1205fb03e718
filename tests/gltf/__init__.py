"""Tests of documents and files: what goes in, what comes out, and what must not change on the way."""
