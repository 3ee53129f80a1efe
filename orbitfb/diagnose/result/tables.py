"""The parts of the gap and the scores along the ring as one tidy table (CSV).

One row per number: how the gap is divided, which part, its value with interval and unit.
"""

import csv
import io
from collections.abc import Iterable, Iterator, Mapping

from orbitfb.diagnose.result.blocks import ScoreRow
from orbitfb.diagnose.result.diagnosis import Diagnosis
from orbitfb.diagnose.result.parts import Gap, GapPiece

HEADS = (
    "cut", "piece", "s_m", "start", "stop",
    "value", "low", "high", "unit", "adds_up",
)  # fmt: skip
_RATE = "nats/tick"
_FORMULA = ("=", "+", "-", "@", "\t", "\r")

_Cell = str | float | int | bool | None
_Line = dict[str, _Cell]


def gap_csv(its: Diagnosis) -> str:
    """Write the table; only its head if there is no gap.

    Args:
        its: The diagnosis.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(HEADS)
    for line in _lines(its):
        writer.writerow([_cell(line.get(head)) for head in HEADS])
    return text.getvalue()


def _cell(value: _Cell) -> _Cell:
    """Keep text that a record brought from being taken for a formula by a spreadsheet."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, str):
        plain = "".join(sign for sign in value if sign.isprintable())
        return f"'{plain}" if plain.startswith(_FORMULA) else plain
    return value


def _lines(its: Diagnosis) -> Iterator[_Line]:
    if its.gap is not None:
        yield from _gap_lines(its.gap, its)
    for row in its.score_map.rows if its.score_map is not None else ():
        yield from _score_lines(row)


def _gap_lines(gap: Gap, its: Diagnosis) -> Iterator[_Line]:
    yield _line("whole", "gap", gap.nats_per_tick, low=gap.low, high=gap.high)
    yield _line("whole", "one step", gap.um, low=gap.um_low, high=gap.um_high, unit="µm")
    where = its.geometry
    bpms = where.bpms if where else {}
    correctors = where.correctors if where else {}
    yield from _named("stage", gap.by_stage, {}, adds_up=True)
    yield from _named("bpm", gap.by_bpm, bpms, adds_up=True)
    yield from _named("bpm, one step", gap.um_by_bpm, bpms, unit="µm")
    yield from _named("corrector, score", gap.by_corrector, correctors)
    for number, value in enumerate(gap.by_mode, start=1):
        last = number == len(gap.by_mode)
        piece = "beyond the correctors' reach" if last else str(number)
        yield _line("singular mode", piece, value, adds_up=True)
    yield from _pieces("band [Hz]", gap.by_band)
    yield from _pieces("window [s]", gap.by_window)


def _line(cut: str, piece: str, value: float | None, *, unit: str = _RATE, **more: _Cell) -> _Line:
    return {"cut": cut, "piece": piece, "value": value, "unit": unit, "adds_up": False, **more}


def _named(
    cut: str,
    parts: Mapping[str, float | None],
    where: Mapping[str, float | None],
    *,
    unit: str = _RATE,
    adds_up: bool = False,
) -> Iterator[_Line]:
    for name, value in parts.items():
        yield _line(cut, name, value, unit=unit, s_m=where.get(name), adds_up=adds_up)


def _pieces(cut: str, pieces: Iterable[GapPiece]) -> Iterator[_Line]:
    for one in pieces:
        yield _line(
            cut,
            one.label,
            one.nats_per_tick,
            start=one.start,
            stop=one.stop,
            adds_up=True,
        )


def _score_lines(its: ScoreRow) -> Iterator[_Line]:
    for index, gain in enumerate(its.gain):
        name = its.names[index] if index < len(its.names) else str(index)
        place = its.s_m[index] if index < len(its.s_m) else None
        yield _line(f"score, {its.effect}", name, gain, unit="nats", s_m=place)
