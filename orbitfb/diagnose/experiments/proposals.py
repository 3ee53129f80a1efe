"""Excitations that may be tried: dither shaped in the modes, ladders of correctors and of bumps.

A ladder has three amplitudes and both directions. The pattern of a bump moves what is asked for
(the current of a corrector, the orbit at a BPM or at a magnet) as far as possible for its rms
orbit: u = (RᵀR + λ)⁻¹ o, o the derivative of what is asked for by the setpoints.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from orbitfb.core.signals import Channels, Vector
from orbitfb.diagnose.experiments.suspects import Suspect
from orbitfb.effects.optics.gradients import nearest_bpms
from orbitfb.loop.excitation.design import ExcitationPart, ExcitationSettings, design
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout
from orbitfb.safety.limits import LimitSettings

ORBIT_LIMIT = {"x": 10e-6, "y": 1e-6}
"""Rms orbit of an excitation by plane: a tenth of a beam of 100 µm by 10 µm [m]."""
STEPS = (1 / 3, -1 / 3, 2 / 3, -2 / 3, 1.0, -1.0)
"""Levels of a ladder of steps."""
TRIANGLES = tuple(
    sign * level / height
    for height, top in ((3, 1), (3, 2), (3, 3))
    for sign in (1, -1)
    for level in (*range(1, top), *range(top, -1, -1))
)
"""Levels of a ladder that turns round at three amplitudes."""
_LOW_MODES = 16
_WEAKEST = 0.02
"""Singular values below this share of the largest are excited as if they had it."""
_RIDGES = (0.3, 0.03)
"""λ over the largest singular value squared is the square of this."""
_MOST_PLACES = 3
_LEAST_ELEMENT = 0.02
_MARGIN = 0.9


@dataclass(frozen=True, slots=True, eq=False)
class Limits:
    """What an excitation must keep to.

    Args:
        orbit: Largest rms orbit by plane [m].
        write: Limits of a write.
        minutes: Beam time at most [min].
        source: Where the limit of the orbit comes from, for people.
    """

    orbit: dict[str, float]
    write: LimitSettings
    minutes: float
    source: str


@dataclass(frozen=True, slots=True, eq=False)
class Proposal:
    """An excitation as it would be run.

    Args:
        kind: `shaped-dither`, `white-dither`, `amplitude-ladder`, `bump-ladder` or
            `corrector-dither`.
        part: Its description, of unit duration.
        label: In words.
    """

    kind: str
    part: ExcitationPart
    label: str

    def settings(self, ticks: int, period: float, seed: int) -> ExcitationSettings:
        """Describe an excitation of a length."""
        part = self.part.model_copy(update={"duration": ticks * period})
        return ExcitationSettings(seed=seed, part=(part,))

    def waveform(self, layout: Layout, ticks: int, seed: int) -> Matrix:
        """Make the excursion, shape (ticks, m) [A]."""
        settings = self.settings(ticks, layout.period, seed)
        channels = channels_of(layout)
        return design(settings, channels, layout.response, layout.period).excursion


def channels_of(layout: Layout) -> Channels:
    """Name the columns of a record as the service names its own."""
    return Channels("".join(layout.planes), layout.bpms.names, layout.correctors.names, (), (), ())


def proposals(layout: Layout, suspects: Sequence[Suspect], limits: Limits) -> Iterator[Proposal]:
    """List what may tell suspects apart, as large as the limits allow.

    Args:
        layout: Devices and model.
        suspects: To be told apart.
        limits: To be kept.
    """
    # A description names correctors by plane, in as many of each: else only modes can be named.
    ladders = _ladders(layout, suspects) if _regular(layout) else ()
    for raw in (*_dithers(layout), *ladders):
        scale = _largest(layout, raw, limits)
        if scale > 0.0:
            amplitude = tuple(scale * each for each in raw.part.amplitude)
            part = raw.part.model_copy(update={"amplitude": amplitude})
            yield Proposal(raw.kind, part, raw.label)


def orbit_rms(layout: Layout, excursion: Matrix, plane: str) -> Vector:
    """Rms orbit of every row at the BPMs of a plane, shape (T,) [m]."""
    rows = np.array([its == plane for its in layout.bpms.planes])
    return np.sqrt(np.mean((excursion @ layout.response[rows].T) ** 2, axis=1))


def _regular(layout: Layout) -> bool:
    counts = {layout.correctors.planes.count(plane) for plane in layout.planes}
    return len(counts) == 1


def _dithers(layout: Layout) -> Iterator[Proposal]:
    size = np.linalg.svd(layout.response, compute_uv=False)
    size = np.maximum(size, _WEAKEST * size[0])
    modes = tuple(range(1, len(size) + 1))
    shaped = tuple(float(each) for each in size[0] / size)
    for hold in (1, 4):
        part = ExcitationPart(kind="prbs", modes=modes, amplitude=shaped, hold=hold, duration=1.0)
        yield Proposal(
            "shaped-dither", part, "random changes of all modes, of equal size in the orbit"
        )
    part = ExcitationPart(kind="prbs", modes=modes, amplitude=(1.0,), duration=1.0)
    yield Proposal(
        "white-dither", part, "random changes of all modes, of equal size in the currents"
    )
    low = min(_LOW_MODES, len(size))
    part = ExcitationPart(
        kind="prbs", modes=modes[:low], amplitude=shaped[:low], hold=2, duration=1.0
    )
    yield Proposal("shaped-dither", part, "random changes of the strongest modes")


def _ladders(layout: Layout, suspects: Sequence[Suspect]) -> Iterator[Proposal]:
    seen: set[bytes] = set()
    for suspect in suspects:
        for what, wanted in _wanted(layout, suspect):
            if not np.any(wanted) or wanted.tobytes() in seen:
                continue
            seen.add(wanted.tobytes())
            if np.count_nonzero(wanted) == 1:
                column = np.flatnonzero(wanted)
                ladder = f"steps of {what} in several sizes"
                yield from _of_pattern(layout, column, np.ones(1), "amplitude-ladder", ladder)
                yield Proposal(
                    "corrector-dither",
                    _part(layout, "prbs", column, np.ones(1), (1.0, -1.0), 2),
                    f"random steps of {what}",
                )
            for ridge in _RIDGES:
                column, pattern = _bump(layout, wanted, ridge)
                ladder = f"steps of {what} in several sizes, by a bump"
                yield from _of_pattern(layout, column, pattern, "bump-ladder", ladder)


def _of_pattern(
    layout: Layout, columns: Indices, pattern: Vector, kind: str, label: str
) -> Iterator[Proposal]:
    for levels, hold in ((STEPS, 1), (STEPS, 4), (TRIANGLES, 2)):
        part = _part(layout, "ladder", columns, pattern, levels, hold)
        yield Proposal(kind, part, label)


def _part(
    layout: Layout,
    kind: str,
    columns: Indices,
    pattern: Vector,
    levels: tuple[float, ...],
    hold: int,
) -> ExcitationPart:
    names = tuple(layout.correctors.names[int(column)] for column in columns)
    plane = layout.correctors.planes[int(columns[0])]
    return ExcitationPart.model_validate(
        {
            "kind": kind,
            "correctors": names,
            "planes": plane,
            "amplitude": tuple(float(each) for each in pattern),
            "levels": levels,
            "hold": hold,
            "duration": 1.0,
        }
    )


def _wanted(layout: Layout, suspect: Suspect) -> Iterator[tuple[str, Vector]]:
    """What should move, as the derivative by the setpoints, in one plane at a time."""
    kind, places = suspect.kind, suspect.kind.devices_at(layout, suspect.places)
    several = np.linspace(0, len(places) - 1, min(_MOST_PLACES, len(places)))
    chosen = [places[int(index)] for index in several]
    for place in chosen:
        if kind.target == "corrector":
            yield layout.correctors.label(place), np.eye(layout.response.shape[1])[place]
        elif kind.target == "bpm":
            yield f"the orbit at {layout.bpms.label(place)}", layout.response[place]
        elif kind.target == "quadrupole" and layout.ring is None:
            near = int(nearest_bpms(layout)[place])
            yield f"the orbit at {layout.bpms.label(near)}", layout.response[near]
        elif kind.target in ("quadrupole", "sextupole"):
            magnets = "QUAD" if kind.target == "quadrupole" else "SEXT"
            for plane in layout.planes:
                count = len(layout.known_ring.places(magnets))
                at = layout.orbit_at(magnets, plane)[place % count]
                yield f"the orbit at {layout.known_ring.names(magnets)[place % count]}", at


def _bump(layout: Layout, wanted: Vector, ridge: float) -> tuple[Indices, Vector]:
    response = layout.response
    plane = layout.correctors.planes[int(np.argmax(np.abs(wanted)))]
    own = np.array([its == plane for its in layout.correctors.planes])
    squares = response[:, own].T @ response[:, own]
    largest = float(np.linalg.norm(response[:, own], 2))
    squares[np.diag_indices_from(squares)] += (ridge * largest) ** 2
    pattern = np.linalg.solve(squares, wanted[own])
    pattern /= np.max(np.abs(pattern))
    kept = np.abs(pattern) > _LEAST_ELEMENT
    return np.flatnonzero(own)[kept], pattern[kept]


def _largest(layout: Layout, proposal: Proposal, limits: Limits) -> float:
    """Scale at which the first limit is reached."""
    rows = proposal.waveform(layout, 200, seed=1)
    edge = np.zeros((1, rows.shape[1]))
    step = float(np.abs(np.diff(rows, axis=0, prepend=edge, append=edge)).max())
    peak = float(np.abs(rows).max())
    if peak == 0.0:
        return 0.0
    write = _MARGIN * min(limits.write.change_per_tick, limits.write.setpoint)
    scale = write / max(step, peak)
    for plane in layout.planes:
        rms = orbit_rms(layout, rows, plane).max()
        if rms > 0.0:
            scale = min(scale, limits.orbit[plane] / float(rms))
    return scale
