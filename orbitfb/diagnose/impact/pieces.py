"""What is named, device by device: the values that `effect.toml` gives to a simulated ring."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.refit import Course
from orbitfb.diagnose.impact.waves import wave_of
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.estimation.transform import Indices

Differences = Mapping[str, Vector]
"""Relative differences of every device's value from the one of all, by parameter, (k,) each [1]."""


@dataclass(frozen=True, slots=True)
class Piece:
    """Devices of a cause that have the same values.

    Args:
        names: Of the devices; empty: the ring, or all of them.
        values: Of the parameters, SI.
        onset: Row at which it begins; 0: with the record.
        elements: Errors of single elements of the response, by the name of what they are with
            [m/A].
    """

    names: tuple[str, ...]
    values: Mapping[str, float]
    onset: int
    elements: Mapping[str, float] = field(default_factory=dict)


def pieces_of(
    part: Candidate, space: Workspace, sizes: Vector, differences: Mapping[int, Differences]
) -> tuple[Piece, ...]:
    """Tell the values of every device of an accepted candidate.

    Args:
        part: The candidate.
        space: Of the record, all causes explained.
        sizes: Posterior mean of every column of the errors, shape (k,).
        differences: Of the devices of a source, by its number, where they differ.
    """
    return tuple(_pieces(part, space, sizes, differences))


def columns_of(part: Candidate, space: Workspace) -> Indices:
    """Columns of the errors that a candidate has for its own, shape (k,)."""
    found = list(part.columns)
    for number in part.raised:
        block = space.blocks[number].columns
        found += range(block.start, block.stop)
    return np.array(found, dtype=np.intp)


def _pieces(
    part: Candidate, space: Workspace, sizes: Vector, differences: Mapping[int, Differences]
) -> Iterator[Piece]:
    linear = part.kind.linear
    bounds = {parameter.name: (parameter.low, parameter.high) for parameter in part.kind.parameters}
    wave = wave_of(part, space)
    if wave is not None:
        for name, values in zip(wave.names, wave.values, strict=True):
            yield Piece((name,), values, part.onset)
    elif linear is not None and part.columns:
        for name, column in zip(part.names, part.columns, strict=True):
            size = float(np.clip(sizes[column], *bounds[linear]))
            yield Piece((name,), {**part.values, linear: size}, part.onset)
    elif linear is not None and part.raised:
        for number in part.raised:
            block = space.blocks[number]
            own = np.clip(sizes[block.columns], *bounds[linear]).tolist()
            for name, size in zip(block.law.names, own, strict=True):
                yield Piece((name,), {**part.values, linear: size}, part.onset)
    elif part.parts:
        for one in part.parts:
            yield Piece(one.names, dict(one.values), one.onset)
    elif len(part.sources) > 1 or differences or any(_differ(one) for one in part.sources):
        for number, one in enumerate(part.sources):
            yield from _of_course(part, one, differences.get(number, {}))
    else:
        yield Piece(part.names, dict(part.values), part.onset)


def _differ(one: Course) -> bool:
    """Whether its devices differ in anything."""
    return bool(one.elements or one.own) or len(np.unique(one.size)) > 1


def _of_course(part: Candidate, one: Course, differences: Differences) -> Iterator[Piece]:
    scaled = {parameter.name for parameter in part.kind.sizes}
    bounds = {parameter.name: (parameter.low, parameter.high) for parameter in part.kind.parameters}
    places = one.places or tuple(range(len(one.law.names)))
    wide = np.broadcast_to(one.size, len(places))
    for number, place in enumerate(places):
        values = {
            key: value
            * (float(wide[number]) if key in scaled else 1.0)
            * (float(one.own[key][number]) if key in one.own else 1.0)
            * (1.0 + float(differences[key][number]) if key in differences else 1.0)
            for key, value in one.values.items()
        }
        values = {key: float(np.clip(value, *bounds[key])) for key, value in values.items()}
        size = part.kind.linear
        grown = values[size] / one.values[size] if size and one.elements else 1.0
        elements = {name: grown * error for name, error in one.elements.items()}
        yield Piece((one.law.names[place],), values, one.onset, elements)
