"""Every number that decides what is named, with its unit, its source, and what it changes."""

SURE = 12.0
"""Log evidence [nats] above which a cause is accepted. Of records without a gap the best candidate
stays below 5 (measured on both generators); 7 more are odds of a thousand to one."""

VALUE_COST = 3.0
"""Nats that a law pays for its values: they are fitted, within a prior of about 20 widths of the
posterior (ln 20)."""

SIZE_WIDTH = 5.0
"""Standard deviation of a free size over the typical one of the effect."""

MOST_DEVICES = 24
"""Devices that a set may have before it is all, a group or a scatter of all."""

MORE = 3.0
"""Nats beyond its look-elsewhere cost that a further device of a set must bring."""

ONSET_SIGN = 8.0
"""Nats a²/2H of one device from which onsets of its law are looked for: a law that begins at the
middle of a record shows half of its final evidence in the whole of it."""

ROUNDS = 4
"""Causes that are accepted at most."""

SCATTER = (2.0, 4.0, 8.0, 16.0, 32.0)
"""Multiples of the healthy scatter that are tried for all devices at once."""

SHAPE_COUNTS = 32.0
"""Steps that the ground's families are worth where a walk is compared with them: they are right to
a quarter of the variance of a mode, and the scatter of a variance of ν normal values is √(2/ν)."""
