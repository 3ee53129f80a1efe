"""How a command line speaks to a running service on the same computer."""
