"""Effects on the noise of readings."""
