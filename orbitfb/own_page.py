"""The operator page of the service's own: started with it, watched, stopped with it."""
