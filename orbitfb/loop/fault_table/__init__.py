"""The table of faults, as data: what may happen, what the loop answers, by which rule."""
