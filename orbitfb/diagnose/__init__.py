"""Where the gap between the simulator and the machine lies, and which effect makes it."""
