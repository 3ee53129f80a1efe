"""Score groups of devices that are struck alike, and the devices one by one."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.candidate import KEPT, Candidate, best_strength, sized
from orbitfb.diagnose.device_groups import groups_of, membership
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.innovation import information
from orbitfb.diagnose.scan_changes import Changes
from orbitfb.diagnose.scan_shapes import Scoring
from orbitfb.effects.device_kinds import ActuatorKind
from orbitfb.effects.kinds import EffectKind, Values
from orbitfb.effects.layout import Layout
from orbitfb.physics.optics import Matrix


@dataclass(frozen=True, slots=True, eq=False)
class Groups:
    """All devices, those of a plane, and every run of neighbouring cells: G groups of P devices.

    Args:
        places: Members of each.
        names: Of each.
        member: Who is in which, shape (G, P).
        known: Information on all devices, shape (P, P).
    """

    places: list[tuple[int, ...]]
    names: list[str]
    member: Matrix
    known: Matrix

    @classmethod
    def of(cls, scoring: Scoring, layout: Layout, kind: EffectKind, changes: Changes) -> "Groups":
        """Put the devices of an effect together.

        Args:
            scoring: On a bench.
            layout: Its devices.
            kind: The effect.
            changes: That it makes.
        """
        devices = layout.correctors if isinstance(kind, ActuatorKind) else layout.bpms
        (shapes, drivers), *_ = changes.parts
        keep = np.sqrt(1.0 - changes.information[1])
        known = information(shapes.fine, scoring.courses(drivers)) * np.outer(keep, keep)
        groups = list(groups_of(devices))
        member = membership(groups, len(devices))
        places = [tuple(columns.tolist()) for _, columns in groups]
        return cls(places, [name for name, _ in groups], member, known)

    @property
    def information(self) -> Vector:
        """On every group whose devices are struck alike, shape (G,)."""
        return np.einsum("gp,gp->g", self.member @ self.known, self.member)

    @property
    def alone(self) -> Vector:
        """On every device, shape (P,)."""
        return np.diagonal(self.known)


def of_places(kind: EffectKind, values: Values, score: Vector, info: Vector) -> Iterator[Candidate]:
    """Propose single places by their scores and information, both of shape (P,)."""
    strength, gain = best_strength(kind, score, info)
    for place in np.argsort(gain)[::-1][:KEPT]:
        if gain[place] > 0:
            scaled = sized(kind, values, float(strength[place]))
            yield Candidate(Cause(kind, (int(place),), scaled), float(gain[place]), len(score))


def of_groups(
    kind: EffectKind, values: Values, score: Vector, groups: Groups
) -> Iterator[Candidate]:
    """Propose devices and groups of them by the scores of the devices, shape (P,)."""
    strength, gain = best_strength(kind, groups.member @ score, groups.information)
    yield from of_places(kind, values, score, groups.alone)
    # a group that gains no more than one of its devices is that device
    alone = best_strength(kind, score, groups.alone)[1]
    gain[gain <= np.max(groups.member * alone, axis=1)] = 0.0
    for group in np.argsort(gain)[::-1][:KEPT]:
        if gain[group] > 0:
            cause = Cause(kind, groups.places[group], sized(kind, values, float(strength[group])))
            yield Candidate(cause, float(gain[group]), float(len(gain)), groups.names[group])
