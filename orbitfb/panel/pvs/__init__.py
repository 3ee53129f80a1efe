"""The PVs of the panel, by what they are about."""
