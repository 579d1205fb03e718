"""What the tests share: independent readers and validators, and the corpus of real models."""
