"""Changed documents as bytes: untouched parts stay as they were read."""
