"""Data in and out: what others measured, and what this program recorded and learned."""
