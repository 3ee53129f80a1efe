"""Whether the orbit answers what was asked of the ring: what is owed, and what speaks for whom."""
