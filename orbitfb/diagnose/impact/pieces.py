"""What is named, device by device: the values that `effect.toml` gives to a simulated ring."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from orbitfb.core.signals import Vector
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.impact.waves import wave_of
from orbitfb.diagnose.likelihood.workspace import Workspace


@dataclass(frozen=True, slots=True)
class Piece:
    """Devices of a cause that have the same values.

    Args:
        names: Of the devices; empty: the ring, or all of them.
        values: Of the parameters, SI.
        onset: Row at which it begins; 0: with the record.
    """

    names: tuple[str, ...]
    values: Mapping[str, float]
    onset: int


def pieces_of(part: Candidate, space: Workspace, sizes: Vector) -> tuple[Piece, ...]:
    """Tell the values of every device of an accepted candidate.

    Args:
        part: The candidate.
        space: Of the record, all causes explained.
        sizes: Posterior mean of every column of the errors, shape (k,).
    """
    return tuple(_pieces(part, space, sizes))


def _pieces(part: Candidate, space: Workspace, sizes: Vector) -> Iterator[Piece]:
    linear = part.kind.linear
    wave = wave_of(part, space)
    if wave is not None:
        for name, values in zip(wave.names, wave.values, strict=True):
            yield Piece((name,), values, part.onset)
        return
    if linear is not None and part.columns:
        for name, column in zip(part.names, part.columns, strict=True):
            yield Piece((name,), {**part.values, linear: float(sizes[column])}, part.onset)
    elif linear is not None and part.raised:
        for number in part.raised:
            block = space.blocks[number]
            for name, size in zip(block.law.names, sizes[block.columns], strict=True):
                yield Piece((name,), {**part.values, linear: float(size)}, part.onset)
    elif len(part.sources) > 1:
        scaled = {parameter.name for parameter in part.kind.sizes}
        for name, one in zip(part.names, part.sources, strict=True):
            size = float(one.size[0])
            values = {key: size * v if key in scaled else v for key, v in one.values.items()}
            yield Piece((name,), values, one.onset)
    else:
        yield Piece(part.names, dict(part.values), part.onset)
