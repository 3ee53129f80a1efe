"""A device of a measured response that stands out."""

from dataclasses import dataclass, field

from orbitfb.loco.parameters import STANDS_OUT

_SURE = 0.8
"""Probability from which a device is named."""


@dataclass(frozen=True, slots=True)
class Named:
    """One device that stands out.

    Args:
        kind: `bpm-gain`, `bpm-polarity`, `bpm-swap`, `bpm-dead`, `bpm-roll`, `bpm-row`,
            `corrector-gain`, `corrector-polarity`, `corrector-swap`, `corrector-dead`,
            `corrector-roll`, `corrector-column`, `quadrupole-gradient` or `skew-coupling`.
        places: Labels of the devices: one, the two that are exchanged, or a family.
        value: Its size in `unit`.
        sigma: Standard deviation, the same unit; NaN where it has none.
        unit: `1`, `rad`, `1/m`, or `m` of the orbit that is left over.
        z: By how many standard deviations of the healthy spread it stands out; inf: certain.
        probability: That it is this device with this kind, 0 to 0.999.
        alternatives: Other places that explain it nearly as well, with their probabilities.
        text: A sentence.
    """

    kind: str
    places: tuple[str, ...]
    value: float
    sigma: float
    unit: str
    z: float
    probability: float
    text: str
    alternatives: tuple[tuple[str, float], ...] = field(default=())

    @property
    def stands_out(self) -> bool:
        """Whether it is named; else it is beside the answer, as what to look at next."""
        return self.z >= STANDS_OUT and (self.probability >= _SURE or bool(self.alternatives))
