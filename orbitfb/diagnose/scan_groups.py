"""Score groups of devices that are struck alike, and the devices one by one."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array

from orbitfb.core.signals import Vector
from orbitfb.diagnose.candidate import (
    KEPT,
    LEAST_INFORMATION,
    Candidate,
    best_strength,
    sized,
)
from orbitfb.diagnose.device_groups import Group, groups_of, membership
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.scan_changes import Changes
from orbitfb.diagnose.scan_shapes import Scoring
from orbitfb.effects.device_kinds import ActuatorKind
from orbitfb.effects.kinds import EffectKind, Values
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout

PART = 64
"""Rows within which devices of a group hide as much of each other, whatever moves them."""


@dataclass(frozen=True, eq=False)
class Groups:
    """G groups of P devices, as `groups_of` lists them.

    Args:
        each: All of them.
        member: Who is in which, shape (G, P).
        parts: Information that every `PART` rows of the record have on all devices, each of shape
            (P, P).
    """

    each: tuple[Group, ...]
    member: Matrix
    parts: tuple[Matrix, ...]

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
        seen = [shape.T @ shape * np.outer(keep, keep) for shape in shapes.fine]
        courses = scoring.courses(drivers)
        parts = tuple(
            np.sum(
                [
                    both * (course[begin : begin + PART].T @ course[begin : begin + PART])
                    for both, course in zip(seen, courses, strict=True)
                ],
                axis=0,
            )
            for begin in range(0, len(drivers), PART)
        )
        groups = groups_of(devices)
        return cls(groups, membership(groups, len(devices)), parts)

    @property
    def choices(self) -> Vector:
        """Of how many every group is one, shape (G,)."""
        return np.array([group.choices for group in self.each])

    @cached_property
    def information(self) -> Vector:
        """On every group whose devices are struck alike, shape (G,)."""
        return self._together(np.sum(self.parts, axis=0))

    @property
    def alone(self) -> Vector:
        """On every device, shape (P,)."""
        return np.sum([np.diagonal(part) for part in self.parts], axis=0)

    def shown(self, begins: Indices, steps: Matrix) -> Matrix:
        """Share of what devices tell apart that they tell together from a row on, (B, G).

        Devices that steer the drift away hide each other nearly whole, those that make a new golden
        orbit do not: one share for all of a record would take a step for far less than it tells.

        Args:
            begins: The rows, shape (B,).
            steps: Information on the step that each device makes there, shape (B, P).
        """
        part = begins // PART
        apart, together = self._by_part
        later_apart, later = (np.cumsum(its[::-1], axis=0)[::-1] for its in (apart, together))
        visible = together / np.maximum(apart, LEAST_INFORMATION)
        stepped = steps @ self.member.T
        told = later[part] + stepped * visible[part]
        return told / np.maximum(later_apart[part] + stepped, LEAST_INFORMATION)

    @cached_property
    def _by_part(self) -> tuple[Matrix, Matrix]:
        """What is known of the members of every group, apart and together, each (parts, G)."""
        apart = np.array([self.member @ np.diagonal(part) for part in self.parts])
        return apart, np.array([self._together(part) for part in self.parts])

    def _together(self, known: Matrix) -> Vector:
        """Sum of what is known of the members of every group, shape (G,) of (P, P)."""
        return np.einsum("gp,gp->g", self._few @ known, self.member)

    @cached_property
    def _few(self) -> "csr_array[np.float64]":
        """`member` without its zeros: most devices are in few of the groups."""
        return csr_array(self.member)


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
    for index in np.argsort(gain - np.log(groups.choices))[::-1][:KEPT]:
        if gain[index] > 0:
            name, members, choices = groups.each[int(index)]
            scaled = sized(kind, values, float(strength[index]))
            cause = Cause(kind, tuple(members.tolist()), scaled)
            yield Candidate(cause, float(gain[index]), choices, name)
