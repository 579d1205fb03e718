"""The common parts of the tests: independent readers and validators, and the corpus of real models."""
