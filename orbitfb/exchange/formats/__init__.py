"""Files of other programs, opened and read within bounds: CSV, HDF5, MATLAB, archiver."""
