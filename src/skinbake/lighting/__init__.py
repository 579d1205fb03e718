"""Whether a baked file still carries the right α and β, and what they are worth on it."""
