"""Records of any file, as one sequence of readings."""
