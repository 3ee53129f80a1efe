"""Effects on BPMs and on when they are read."""
