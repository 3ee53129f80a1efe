"""May this be sent? Limits and interlocks: pure functions of values."""
