"""What `orbitfb train` does: bring response, data and settings together, train, store."""
