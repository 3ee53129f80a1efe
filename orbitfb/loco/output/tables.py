"""The tables of the answer as CSV, and the fitted response for `orbitfb import response`."""

import csv
import io
from collections.abc import Iterable, Sequence

from pydantic import BaseModel

from orbitfb.loco.measured import bpm_labels, corrector_labels
from orbitfb.loco.run import Result
from orbitfb.loco.schema import ResponseDiagnosis
from orbitfb.physics.places import plane_row


def csv_of(rows: Iterable[BaseModel]) -> str:
    """Write parts of one kind, a column per field; what is not known is empty."""
    dumped = [row.model_dump(mode="json") for row in rows]
    heads = list(dumped[0]) if dumped else []
    return _text([heads, *([_cell(row[head]) for head in heads] for row in dumped)])


def corrections_csv(answer: ResponseDiagnosis) -> str:
    """Propose corrections of quadrupole strengths: the fitted errors with the opposite sign."""
    rows: list[list[str]] = [["quadrupole", "change_percent", "sigma_percent", "with"]]
    for its in answer.quadrupoles:
        if its.relative is not None and its.sigma is not None:
            rows.append(
                [its.name, f"{-100 * its.relative:.4f}", f"{100 * its.sigma:.4f}",
                 " ".join(its.degenerate_with)]
            )  # fmt: skip
    return _text(rows)


def fitted_csv(result: Result) -> str:
    """Write the fitted response [m/A], all planes; empty between planes."""
    ring, measured = result.ring, result.mended
    columns = [name for p in measured.planes for name in corrector_labels(measured, ring, p)]
    rows: list[list[str]] = [["R [m/A]", *columns]]
    before = 0
    for plane in measured.planes:
        per_ampere = ring.table.calibration[plane_row(plane), measured.correctors[plane]]
        model = result.fit.model[plane] * per_ampere
        before = sum(
            len(measured.correctors[p]) for p in measured.planes[: measured.planes.index(plane)]
        )
        for name, values in zip(bpm_labels(measured, ring, plane), model, strict=True):
            cells = [f"{value:.9g}" for value in values]
            after = len(columns) - before - len(cells)
            rows.append([name, *["0"] * before, *cells, *["0"] * after])
        before += model.shape[1]
    return _text(rows)


def _cell(value: object) -> str:
    if value is None:
        return ""
    return " ".join(map(str, value)) if isinstance(value, list) else str(value)


def _text(rows: Sequence[Sequence[str]]) -> str:
    text = io.StringIO(newline="")
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()
