"""Experiments: what to do next when a record cannot decide, and the file that a loop executes."""
