"""A record of operation as values: the devices, the layout of the ring, the readings."""
