"""The operator page: what the loop does, in a browser, read-only."""
