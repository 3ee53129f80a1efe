"""The setpoints of the machine: asked for, sent, and heard of."""
