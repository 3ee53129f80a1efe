"""The project's own generator of sealed cases; see `benchmarks.blind`."""
