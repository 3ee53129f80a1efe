"""A lattice of Accelerator Toolbox becomes a table of places."""
