"""Commands that measure what a method is worth."""
