"""Effects on correctors and on when they are written."""
