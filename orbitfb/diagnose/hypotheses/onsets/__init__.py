"""Laws that begin in the middle of a record: scanned, then told exactly."""
