"""The loop: state table, one tick as functions of values, and the runner that paces it."""
