"""Laws of BPMs that are undone in the readings: what is left then tells whether they were there."""
