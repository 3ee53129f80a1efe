"""A sealed check of the diagnosis: cases made by a generator of its own, scored by a third process.

Nothing here imports `orbitfb.effects`: what a record holds must not come from the library that is
to find it. Of `orbitfb` only the table of places and its Green's function are used. The one
exception makes no record: `baselines.naive` is the diagnosis itself with another noise.
"""
