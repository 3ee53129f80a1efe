"""What every network needs: a device, layers, a training loop that can be resumed."""
