"""The lease of a machine, held in a PV that every controller sees."""
