"""The configuration of the whole service: one frozen tree, and its text."""
