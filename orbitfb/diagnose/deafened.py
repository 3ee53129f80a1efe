"""Leave BPMs whose noise is a cause by itself out of a search, so that the others can speak."""

from dataclasses import replace

import numpy as np

from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.noise_modes import NoiseModes
from orbitfb.effects.random_kinds import NoiseKind
from orbitfb.records.record import Record

_MOST = 0.25
"""Share of the BPMs beyond which what is left is no record."""
_DEAF = 1e3
"""Noise that is given to a BPM so that it tells nothing, over its usual one."""


def without_bpms(bench: Bench, cause: Cause) -> tuple[Record, NoiseModes] | None:
    """Give noisy BPMs readings that are nothing but noise, and modes of the noise that know it.

    They stay among the columns; whatever they read is as likely as anything.

    Args:
        bench: The record under the causes so far.
        cause: Noise of BPMs.

    Returns:
        None where it is the noise of something else, or of too many BPMs.
    """
    kind, record = cause.kind, bench.record
    if not isinstance(kind, NoiseKind) or kind.target != "bpm" or not cause.places:
        return None
    shapes = kind.patterns(record.layout)[:, list(cause.places)]
    struck = np.count_nonzero(shapes, axis=1) > 0
    modes = bench.floor.modes
    deaf = tuple(sorted({*modes.deaf, *np.flatnonzero(struck).tolist()}))
    if len(deaf) > _MOST * len(struck):
        return None
    spread = np.where(struck, _DEAF, modes.spread)
    noise = np.random.default_rng(0).standard_normal(record.readings.shape)
    noise *= spread * np.sqrt(bench.floor.reading)
    readings = np.where(struck, noise, record.readings)
    modes = NoiseModes.of(record.layout, spread, modes.scatter, deaf, modes.ground)
    return replace(record, readings=readings), modes
