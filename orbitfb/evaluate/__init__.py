"""Measurements of what the loop and the learner are worth, as commands."""
