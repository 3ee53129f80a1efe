"""A lattice of accelerator-toolbox as a places table of orbitfb.

Needs accelerator-toolbox (of the `dev` extra) for the optics.
"""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from orbitfb.physics.parameters import SPEED_OF_LIGHT, RingParameters
from orbitfb.physics.places import Ring
from orbitfb.physics.table import PlacesTable

_APART = 1e-6
"""Two devices at one place are told apart by this [m]; no optics change over it."""

_KIND = {"B": "BPM", "C": "COR", "Q": "QUAD", "S": "SEXT"}

Key = tuple[str, int]
"""What a place is, B, C, Q or S, and the number of its element."""


def ring_of(
    elements: Iterable[Any],
    bpms: Iterable[int],
    correctors: Iterable[int],
    energy: float,
    frequency: float,
) -> tuple[Ring, dict[Key, int]]:
    """Make the places table: BPMs, correctors and magnets, all seen from their middles.

    Args:
        elements: Of the lattice, in the order of the beam.
        bpms: Numbers of the elements that read the orbit.
        correctors: Numbers of those that kick.
        energy: Of the beam [eV].
        frequency: Of the cavities [Hz].

    Returns:
        The ring, and the place of every device.
    """
    import at

    own = dict.fromkeys((int(i) for i in bpms), "B")
    own |= dict.fromkeys((int(i) for i in correctors), "C")
    parts: list[Any] = []
    marks: dict[Key, int] = {}
    strengths: dict[int, float] = {}
    for number, element in enumerate(elements):
        kind = own.get(number)
        if isinstance(element, at.Quadrupole):  # one without gradient is a skew quadrupole
            kind, strengths[number] = "Q", element.K * element.Length
        elif kind is None and isinstance(element, at.Sextupole):
            kind, strengths[number] = "S", element.H * element.Length
        if kind is None:
            parts.append(element)
            continue
        halves = element.divide([0.5, 0.5]) if element.Length else [element]
        marks[kind, number] = len(parts) + len(halves) // 2
        parts += halves
    lattice = at.Lattice(parts, energy=energy, periodicity=1)
    lattice.disable_6d()
    optics = at.get_optics(lattice, refpts=range(len(parts) + 1), get_chrom=False)[2]
    order = sorted(marks, key=lambda key: (marks[key], key))
    table = _table([(key, optics[marks[key]]) for key in order], strengths)
    circumference = float(optics[-1].s_pos)
    tunes = optics[-1].mu / (2 * np.pi)
    parameters = RingParameters(
        energy_eV=energy,
        circumference_m=circumference,
        harmonic=max(1, round(frequency * circumference / SPEED_OF_LIGHT)),
        nu_x=float(tunes[0]),
        nu_y=float(tunes[1]),
        alpha_c=float(at.get_mcf(lattice)),
    )
    return Ring(table, parameters), {key: place for place, key in enumerate(order)}


def _table(seen: Sequence[tuple[Key, Any]], strengths: dict[int, float]) -> PlacesTable:
    """Write the optics of every device."""
    positions: list[float] = []
    for _, its in seen:
        least = positions[-1] + _APART if positions else 0.0
        positions.append(max(float(its.s_pos), least))
    empty = ("",) * len(seen)
    calibration = [1.0 if kind == "C" else np.nan for (kind, _), _ in seen]
    return PlacesTable(
        name=tuple(f"{kind}{number}" for (kind, number), _ in seen),
        kind=tuple(_KIND[kind] for (kind, _), _ in seen),
        s=np.array(positions),
        beta=np.array([its.beta for _, its in seen]).T.copy(),
        phase=np.array([its.mu for _, its in seen]).T.copy(),
        dispersion=np.array([float(its.dispersion[0]) for _, its in seen]),
        strength=np.array([strengths[n] if kind in "QS" else np.nan for (kind, n), _ in seen]),
        calibration=np.array([calibration, calibration]),
        pv=(empty, empty),
        readback=(empty, empty),
    )
