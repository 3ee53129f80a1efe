"""Simpler methods, as engines of the same check: what the diagnosis has to beat."""
