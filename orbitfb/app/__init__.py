"""The service and the work that commands start: the only place that knows everybody."""
