"""What the loop costs on Channel Access, measured; `make bench` writes `loop.json`."""
