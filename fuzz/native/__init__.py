"""The compiled loops and the decoders under AddressSanitizer and UndefinedBehaviorSanitizer, called directly."""
