"""From path to arrays and back: the document, its accessors, its skinned primitives."""
