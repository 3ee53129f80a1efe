"""The watch over the gap of the running service: a look at its last ticks, now and then."""
