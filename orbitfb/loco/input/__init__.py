"""Read a measured response: the matrices of a file, its devices, and what is said beside it."""
