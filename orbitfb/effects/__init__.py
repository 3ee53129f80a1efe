"""Physical effects that the nominal simulator leaves out: how they act, and how they show."""
