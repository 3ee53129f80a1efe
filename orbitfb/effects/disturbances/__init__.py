"""Effects that move the orbit by themselves: kicks, energy, ground."""
