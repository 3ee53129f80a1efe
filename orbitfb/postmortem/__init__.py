"""What is kept of a trip: the last seconds of everything, frozen to a file, and how to read it."""
