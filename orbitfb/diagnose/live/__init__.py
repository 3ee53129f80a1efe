"""The gap while the loop runs: a look at the last ticks, once a period."""
