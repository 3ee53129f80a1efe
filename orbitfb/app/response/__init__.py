"""The measurement of the response on a machine at hand: one on its own, or that of a loop."""
