"""Models of the ring that are identified from transitions, and how sure they are."""
