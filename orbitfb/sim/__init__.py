"""The simulated ring behind Channel Access: a soft IOC around a plant, and its child process."""
