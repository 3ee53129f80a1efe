"""Random kicks on the simulated ring, through Channel Access: the paper's machine experiment."""
