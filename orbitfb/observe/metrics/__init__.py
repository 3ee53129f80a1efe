"""What Prometheus scrapes: the metrics by subject, and the collector that serves them."""
