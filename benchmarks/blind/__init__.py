"""The blind check of the diagnosis: fresh records whose truth it is not told, scored by one rule.

    python -m benchmarks.blind --help

`generator` is the project's own; further generators write folders of records and truths. Nothing
in `generator` imports `orbitfb.effects`: what a record holds must not come from the library that
is to find it. Of `orbitfb` it uses the table of places and its Green's function only.
"""
