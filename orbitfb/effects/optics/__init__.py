"""Effects on the optics: gradients, tunes, coupling."""
