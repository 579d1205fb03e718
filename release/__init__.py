"""Build what is published, and try it in clean environments."""
