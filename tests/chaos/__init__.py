"""A seeded campaign of random faults against the service as it runs, and a plain loop beside it."""
