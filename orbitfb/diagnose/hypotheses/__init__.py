"""Every hypothesis against every other, by evidence: accept the best, then look again."""
