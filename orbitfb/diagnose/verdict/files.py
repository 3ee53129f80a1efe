"""From the files of records to a diagnosis: read, screen, ask the engine."""

from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path

import numpy as np

from orbitfb.core.errors import RecordError
from orbitfb.diagnose.finding import Finding as Found
from orbitfb.diagnose.integrity import screen
from orbitfb.diagnose.load import load
from orbitfb.diagnose.planes import check_planes
from orbitfb.diagnose.progress import Progress
from orbitfb.diagnose.provenance import versions
from orbitfb.diagnose.result.diagnosis import Diagnosis
from orbitfb.diagnose.result.headline import headline
from orbitfb.diagnose.result.parts import Finding, Provenance
from orbitfb.diagnose.verdict.engine import diagnose
from orbitfb.physics.places import Planes, Ring
from orbitfb.records.layout import Devices
from orbitfb.records.record import Record

_SAME_PERIOD = 0.1
"""Share by which the periods of two records may differ: what moves per tick goes with it."""

_SAME_MODEL = 1e-3
"""Difference of two models that comes of the type they are saved in, of their largest value [1]."""

_MOST_SHARED = 0.5
"""Share of its rows that a record may have in common with another one of few bits [1]."""


def diagnose_files(
    record: Path,
    reference: Path | None,
    holdout: Path | None,
    *,
    planes: Planes | None,
    ring: Ring | None,
    seed: int,
    without: frozenset[str] = frozenset(),
    progress: Progress,
) -> Diagnosis:
    """Diagnose a record of a file.

    Args:
        record: The record in question.
        reference: Of a time without a gap, to calibrate the floor of the noise.
        holdout: A later one, to tell how far the gap shrinks.
        planes: Plane(s) to look at; all that the record has when None.
        ring: Whose names the devices may have; the default ring when None.
        seed: Of the draws that intervals come from.
        without: Ids of effects that are not to be considered.
        progress: Is told how far it is.

    Raises:
        RecordError: A record cannot be read, or has an array that is wrong; or reference or later
            record are of other devices, of another rate or model, the same data, or not intact.
        ConfigError: The planes asked for are not those of the record.
    """
    progress("reading", 0.0)
    loaded = load(record, planes=planes, ring=ring)
    others = [
        None if path is None else _beside(loaded.record, path, planes, ring)
        for path in (reference, holdout)
    ]
    progress("screening", 0.0)
    found = (*loaded.findings, *screen(loaded.record))
    check_planes(planes, found)
    findings = reported(found)
    if any(finding.severity == "failure" for finding in findings):
        return _refused(loaded.record, findings, seed)
    answer = diagnose(
        loaded.record,
        *others,
        seed=seed,
        without=without,
        findings=found,
        progress=progress,
    )
    merged = tuple(dict.fromkeys((*findings, *answer.findings)))
    return answer.model_copy(update={"findings": merged})


def _beside(record: Record, path: Path, planes: Planes | None, ring: Ring | None) -> Record:
    """Read a record that is to be looked at together with the one in question."""
    loaded = load(path, planes=planes, ring=ring)
    other, own = loaded.record.layout, record.layout
    for array, its, wanted in (
        ("bpm_names", other.bpms, own.bpms),
        ("corr_names", other.correctors, own.correctors),
    ):
        if its != wanted:
            raise RecordError(
                f"{path}: array '{array}' is not that of {record.source}: "
                f"{_first_difference(its, wanted)}; give a record of the same devices in the "
                "same order"
            )
    if abs(other.period - own.period) > _SAME_PERIOD * own.period:
        raise RecordError(
            f"{path}: array 't' says that orbits are {other.period:g} s apart, in {record.source} "
            f"they are {own.period:g} s apart; give a record of the same rate"
        )
    error, largest = np.abs(other.response - own.response).max(), np.abs(own.response).max()
    if error > _SAME_MODEL * largest:
        raise RecordError(
            f"{path}: array 'model_R' is not that of {record.source}: it differs by up to "
            f"{error * 1e3:.3g} mm/A, the largest there is {largest * 1e3:.3g} mm/A; give both the "
            "model that is in question"
        )
    if _shared(record, loaded.record) > _MOST_SHARED:
        raise RecordError(
            f"{path}: array 'orbit' has the rows of {record.source}, and the same data tells "
            "nothing more; give a record of another time, or leave the option out"
        )
    for finding in (*loaded.findings, *screen(loaded.record)):
        if finding.severity == "failure":
            raise RecordError(f"{path}: not intact: {finding.text}")
    return loaded.record


def _shared(first: Record, second: Record) -> float:
    """Share of the rows of the shorter record that are, to the last bit, in the other one."""
    rows = [
        {row.tobytes() for row in np.hstack([its.readings, its.setpoints])}
        for its in (first, second)
    ]
    return len(rows[0] & rows[1]) / min(map(len, rows))


def _first_difference(its: Devices, wanted: Devices) -> str:
    if len(its) != len(wanted):
        return f"it names {len(its)} devices in place of {len(wanted)}"
    for column in range(len(its)):
        if its.label(column) != wanted.label(column):
            return f"column {column} is {its.label(column)} in place of {wanted.label(column)}"
    return "the devices are in other cells"


def reported(findings: Iterable[Found]) -> tuple[Finding, ...]:
    """Put findings of the screen in the form of the answer."""
    return tuple(Finding(**asdict(finding)) for finding in findings)


def _refused(record: Record, findings: tuple[Finding, ...], seed: int) -> Diagnosis:
    layout = record.layout
    return Diagnosis(
        state=None,
        headline=headline(None, findings=findings),
        findings=findings,
        provenance=Provenance(
            data_sha256=record.digest,
            seed=seed,
            versions=versions(),
            source=record.source,
            ticks=len(record),
            bpms=len(layout.bpms),
            correctors=len(layout.correctors),
            planes="".join(layout.planes),
            period_s=layout.period,
        ),
    )
