"""Simpler methods, in the same table: what the diagnosis has to beat."""
