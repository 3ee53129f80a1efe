"""What causes do to the orbit: where the gap lies, how far it shrinks, what the loop does."""
