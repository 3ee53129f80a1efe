"""Transitions in memory (ring buffer) and on disk (archive)."""
