"""Orbit histories from elsewhere, and the archive for other programs."""
