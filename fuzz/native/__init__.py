"""The compiled loops and the decoders, called directly under Address- and UndefinedBehaviorSanitizer."""
