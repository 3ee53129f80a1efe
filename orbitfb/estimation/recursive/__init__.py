"""The response tracked at every tick, and the cautious gain made from it."""
