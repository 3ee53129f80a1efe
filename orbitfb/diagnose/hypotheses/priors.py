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
"""Devices with a size of each one's own that a set may have before it is a scatter of all."""

MORE = 3.0
"""Nats beyond its look-elsewhere cost that a further device of a set must bring."""

ONSET_SIGN = 8.0
"""Nats a²/2H of one device from which onsets of its law are looked for: a law that begins at the
middle of a record shows half of its final evidence in the whole of it."""

ROUNDS = 4
"""Causes that are accepted at most."""

SCATTER = (2.0, 4.0, 8.0, 16.0, 32.0)
"""Multiples of the healthy scatter that are tried for all devices at once."""

LEAK = 0.02
"""Share of the walk along a pattern that the ground's shapes may have wrong besides a factor of
two of what they leave there [1]: patterns that few quadrupoles move share the errors of others.
Chosen by hand."""

FINALISTS = 10
"""Candidates that are evaluated exactly, and whose values are refined between those of the grid: a
scan leaves out what healthy errors of other devices hide, up to half of a large effect, and steps
of a grid that are 1.5 apart lose a tenth."""

COURSELESS = 0.5
"""Share of the evidence of a random course from which a law with a course is told before it [1]:
chosen by hand. The random course is weighed over another floor, which counts the same motion for
more."""

MISFIT = 0.004
"""Share of the best evidence by which the evidences of models that are all a little wrong may
differ by chance [1]."""

RIVAL = 0.02
"""Probability from which another effect is told as one that the record cannot exclude [1]."""

REMAINDER = 0.03
"""Share of the named causes' evidence from which what a free course finds beside them is told [1]:
a law that is right to a sixth of its amplitude leaves that."""

HOPE = 2.0
"""Log evidence [nats] of the best single device below which values are not looked at closely: the
best of 180 devices of a healthy record reaches 4."""

MOST_REFINED = 6
"""Devices of a set whose own values are searched between those of the grid; others keep it."""

STROKES = 0.05
"""Share of the rows in which single strokes are sought [1]: more of them are a walk."""
