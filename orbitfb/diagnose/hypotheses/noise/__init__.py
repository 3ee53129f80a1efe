"""Laws of the reading noise itself: its level in time or with the beam, its memory, its tails."""
