"""Changes of the setpoints by hand while the loop is open, and their undoing."""
