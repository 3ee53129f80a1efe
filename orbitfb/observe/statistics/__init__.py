"""The running figures of the loop, counted as it runs."""
