"""The small errors that every device has, beside which an effect on it is seen.

Who knows that gains scatter by a per cent and gradients by what beats by one or two, but not the
error of each device, sees less of an effect that acts like such an error.
"""

from collections.abc import Sequence

import numpy as np

from tests.blind.conditions import Conditions
from tests.blind.draft import Draft, Maker
from tests.blind.machine import Nature
from tests.blind.nature_actuator import Scaled
from tests.blind.nature_optics import Gradients
from tests.blind.nature_sensor import Gain

GAIN = 0.01
"""Scatter of gains, as `drawing` has it."""


def healthy_errors(case: Conditions, maker: Maker, draft: Draft) -> list[Nature]:
    """Make an error of one standard deviation for each device that an effect sits on."""
    if draft.law != "mean":
        return []

    def columns(names: Sequence[str]) -> list[int]:
        return [i for i, name in enumerate(names) if name in draft.places]

    if maker.stage == "sensor":
        return [Gain(np.array([i]), GAIN) for i in columns(case.bpm_names)]
    if maker.stage == "actuator":
        return [Scaled(np.array([i]), GAIN) for i in columns(case.corr_names)]
    if maker.stage == "optics":
        names = case.lattice.ring.names("QUAD")
        scatter = float(np.std(case.lattice.errors))
        return [Gradients([(0, scatter * row)]) for row in np.eye(len(names))[columns(names)]]
    return []
