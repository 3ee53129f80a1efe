"""Whether the loop stays as it is for hours: memory, file descriptors, threads, latency."""
