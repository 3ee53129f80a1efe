"""One coherent orbit out of single events."""
