"""The ring as a Green's function between named places, and the plant built on it."""
