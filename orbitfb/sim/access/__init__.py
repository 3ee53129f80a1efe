"""Channel Access of the simulated ring: what clients send, what they are sent."""
