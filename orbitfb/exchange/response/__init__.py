"""Response matrices from elsewhere and for other programs."""
