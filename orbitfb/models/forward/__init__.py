"""The forward net f(s, a): the net, its training, its validation, its files."""
