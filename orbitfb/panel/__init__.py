"""The panel: the loop's own PVs, from which operators see and command it."""
