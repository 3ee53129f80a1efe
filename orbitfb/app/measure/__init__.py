"""The measurement of the response matrix from start to file, on a machine behind EPICS."""
