"""The kinds of faults, after the table on the page on safety: what is done, and where.

A fault of the ring is a dictionary that the soft IOC understands (`devices`); one of a process is
done by whoever holds that process (`campaign`).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

BPMS = CORRECTORS = 180
Draw = Callable[[np.random.Generator], dict[str, Any]]


@dataclass(frozen=True)
class Kind:
    """A kind of fault.

    Args:
        name: Of it.
        where: `ring`: in the soft IOC; `ioc`, `controller`: to that process; `policy`: in the law.
        draw: What it does, at random.
        seconds: How long it lasts, shortest and longest [s].
        weight: How often it is drawn.
        early: Whether it belongs to the first half: it ends the life of a process, whose growth
            could not be followed.
    """

    name: str
    where: str
    draw: Draw
    seconds: tuple[float, float] = (0.1, 1.0)
    weight: float = 1.0
    early: bool = False


def _some(rng: np.random.Generator, least: int, most: int) -> list[int]:
    """Some BPMs, no two next to each other."""
    places = rng.permutation(BPMS // 3)[: rng.integers(least, most + 1)]
    return sorted(int(place) * 3 for place in places)


def _bpms(value: Any, most: int = 4) -> Draw:
    def draw(rng: np.random.Generator) -> dict[str, Any]:
        told = value(rng) if callable(value) else value
        return {"bpms": dict.fromkeys(map(str, _some(rng, 1, most)), told)}

    return draw


def _row(rng: np.random.Generator) -> dict[str, Any]:
    first, count = int(rng.integers(BPMS)), int(rng.integers(3, 7))
    told = str(rng.choice(["nan", "zero", "invalid"]))
    return {"bpms": {str((first + step) % BPMS): told for step in range(count)}}


def _many(rng: np.random.Generator) -> dict[str, Any]:
    told = str(rng.choice(["nan", "zero", "invalid"]))
    return {"bpms": dict.fromkeys(map(str, _some(rng, 12, 40)), told)}


def _offset(rng: np.random.Generator) -> float:
    return float(rng.uniform(0.3e-3, 2e-3) * rng.choice([-1, 1]))


def _orbit(kind: str, least: float = 0.0, most: float = 0.0) -> Draw:
    return lambda rng: {"orbit": kind, "by": float(rng.uniform(least, most))}


def _torn(rng: np.random.Generator) -> dict[str, Any]:
    return {
        "orbit": "torn",
        "which": sorted(map(int, rng.permutation(BPMS)[: rng.integers(30, 100)])),
    }


def _correctors(value: Any, least: int = 1, most: int = 2, strong: bool = True) -> Draw:
    """Of the strongest: one without current cannot fail to deliver it."""

    def draw(rng: np.random.Generator) -> dict[str, Any]:
        told = value(rng) if callable(value) else value
        ranks = rng.permutation(10 if strong else CORRECTORS)[: rng.integers(least, most + 1)]
        return {"ranks": sorted(map(int, ranks)), "corrector": told}

    return draw


def _error(rng: np.random.Generator) -> float:
    return float(rng.uniform(0.3, 2.0) * rng.choice([-1, 1]))


def _plain(**what: Any) -> Draw:
    return lambda _: dict(what)


def _kick(least: float, most: float) -> Draw:
    return lambda rng: {"kick": float(rng.uniform(least, most))}


def _unanswered(what: str, count: int) -> Draw:
    """Devices next to each other that go on as if they were well: fresh stamps, plausible values.

    A blind BPM shows for ever what it read last, and noise; a deaf supply echoes its setpoint.
    """

    def draw(rng: np.random.Generator) -> dict[str, Any]:
        first = int(rng.integers(BPMS))
        return {what: [(first + step) % BPMS for step in range(count)], "noise": 0.2e-6}

    return draw


def _moved(rng: np.random.Generator) -> dict[str, Any]:
    return {
        "move": int(rng.integers(CORRECTORS)),
        "by": float(rng.uniform(0.06, 0.3) * rng.choice([-1, 1])),
    }


def _refusing(rng: np.random.Generator) -> dict[str, Any]:
    return {"refuse": [int(rng.integers(CORRECTORS))]}


def _limits(rng: np.random.Generator) -> dict[str, Any]:
    return {"do": "restart", "corrector_limit": float(rng.choice([0.3, 0.6, 2.0]))}


KINDS = (
    Kind("BPM reads NaN", "ring", _bpms("nan"), weight=2),
    Kind("BPM reads exactly 0", "ring", _bpms("zero"), weight=2),
    Kind("BPM frozen", "ring", _bpms("frozen"), weight=2),
    Kind("BPM keeps its stamp", "ring", _bpms("stamp"), weight=2),
    Kind("BPM jumps", "ring", _bpms(_offset, 2), weight=2),
    Kind("BPM stamped 1.5 ms ahead", "ring", _bpms("apart"), weight=2),
    Kind("BPM INVALID", "ring", _bpms("invalid"), weight=2),
    Kind("BPM disconnected", "ring", _bpms("gone", 3), weight=2),
    Kind("BPMs in a row bad", "ring", _row, weight=2),
    Kind("BPMs beyond the quota", "ring", _many, weight=2),
    Kind("orbit frozen", "ring", _orbit("frozen"), weight=2),
    Kind("orbit silent", "ring", _orbit("silent"), weight=2),
    Kind("orbit stale", "ring", _orbit("old", 1.5, 4.0), weight=2),
    Kind("orbit incomplete", "ring", _torn, weight=2),
    Kind("orbit of zeros", "ring", _orbit("zero"), weight=2),
    Kind("orbits at a third of the rate", "ring", _plain(slow=3)),
    Kind("clock of the IOC ahead", "ring", _orbit("ahead", 1.5, 3.0)),
    Kind("corrector off", "ring", _correctors("off"), weight=2),
    Kind("corrector stuck", "ring", _correctors("stuck"), weight=2),
    Kind("corrector readback away", "ring", _correctors("away", strong=False)),
    Kind("corrector readback wrong", "ring", _correctors(_error, strong=False)),
    Kind("corrector refuses puts", "ring", _refusing),
    Kind("correctors beyond the quota", "ring", _correctors("off", 5, 8)),
    Kind("setpoint moved by somebody", "ring", _moved),
    Kind("beam kicked", "ring", _kick(30e-6, 300e-6), (0.3, 0.6), weight=2),
    Kind("beam kicked hard", "ring", _kick(0.7e-3, 2e-3), (0.3, 0.6)),
    Kind("beam lost", "ring", _plain(current=0.0)),
    Kind("current drops", "ring", _plain(current=250.0)),
    Kind("current not known", "ring", _plain(current=None)),
    Kind("current old", "ring", _plain(current_old=True), (0.5, 1.0)),
    Kind("response of the other sign", "ring", _plain(sign=-1.0), (0.3, 1.0)),
    Kind("BPMs exchanged", "ring", lambda rng: {"shift": int(rng.integers(3, 60))}, (0.3, 1.0)),
    Kind("BPMs all blind", "ring", _unanswered("blind", BPMS), (2.0, 5.0)),
    Kind("BPMs of a cell blind", "ring", _unanswered("blind", 6), (2.0, 5.0)),
    Kind("BPM blind", "ring", _unanswered("blind", 1), (2.0, 5.0)),
    Kind("supplies all deaf", "ring", _unanswered("deaf", CORRECTORS), (2.0, 5.0)),
    Kind("supplies of a cell deaf", "ring", _unanswered("deaf", 6), (2.0, 5.0)),
    Kind("supply deaf", "ring", _unanswered("deaf", 1), (2.0, 5.0)),
    Kind("IOC killed", "ioc", _plain(do="restart"), (0.1, 1.5), 0.5),
    Kind("IOC back with other limits", "ioc", _limits, (0.1, 1.0), 0.3),
    Kind("another server has the PVs", "ioc", _plain(do="other"), (2.0, 4.0), 0.3),
    Kind("IOC stands still", "ioc", _plain(do="stop"), (0.1, 2.0)),
    Kind("controller killed", "controller", _plain(do="kill"), (0.1, 0.5), 0.5, early=True),
    Kind(
        "terminal of the controller closed",
        "controller",
        _plain(do="hangup"),
        (0.1, 0.5),
        0.3,
        True,
    ),
    Kind("controller out of descriptors", "controller", _plain(do="descriptors"), (0.5, 2.0)),
    Kind("controller stands still", "controller", _plain(do="stop"), (0.1, 2.0)),
    Kind("second controller", "controller", _plain(do="second")),
    Kind("disk full", "controller", _plain(do="full"), (0.5, 1.5)),
    Kind("archive directory gone", "controller", _plain(do="gone"), (0.5, 1.5), 0.5),
    Kind("policy asks for NaN", "policy", _plain(mode="nan")),
    Kind("policy raises", "policy", _plain(mode="raise")),
    Kind("policy late", "policy", _plain(mode="late")),
    Kind("policy asks for too much", "policy", _plain(mode="huge")),
    Kind("policy of another shape", "policy", _plain(mode="shape")),
)
