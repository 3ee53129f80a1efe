"""From the files of records to a diagnosis: read, screen, ask the engine."""

from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path

from orbitfb.core.errors import EstimationError
from orbitfb.diagnose.progress import Progress
from orbitfb.diagnose.provenance import versions
from orbitfb.diagnose.result.diagnosis import Diagnosis
from orbitfb.diagnose.result.headline import headline
from orbitfb.diagnose.result.parts import Finding, Provenance
from orbitfb.diagnose.screen.companion import read_beside
from orbitfb.diagnose.screen.planes import check_planes
from orbitfb.diagnose.screen.run import screen
from orbitfb.diagnose.screen.runaway import without_runaway
from orbitfb.diagnose.screen.spikes import without_spikes
from orbitfb.diagnose.verdict.engine import diagnose
from orbitfb.physics.places import Planes, Ring
from orbitfb.records.finding import Finding as Found
from orbitfb.records.reading.load import load
from orbitfb.records.record import Record


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
        EstimationError: Noise and motion cannot be told apart in the record.
        ConfigError: The planes asked for are not those of the record.
    """
    progress("reading", 0.0)
    loaded = load(record, planes=planes, ring=ring)
    others = [
        None if path is None else read_beside(loaded.record, path, planes, ring)
        for path in (reference, holdout)
    ]
    progress("screening", 0.0)
    record_itself, left_out = _usable(loaded.record)
    others = [None if one is None else _usable(one)[0] for one in others]
    found = (*loaded.findings, *left_out, *screen(record_itself))
    check_planes(planes, found)
    findings = reported(found)
    if any(finding.severity == "failure" for finding in findings):
        return _refused(record_itself, findings, seed)
    try:
        answer = diagnose(
            record_itself,
            *others,
            seed=seed,
            without=without,
            findings=found,
            progress=progress,
        )
    except EstimationError as error:
        raise EstimationError(f"{record}: {error}") from error
    merged = tuple(dict.fromkeys((*findings, *answer.findings)))
    return answer.model_copy(update={"findings": merged})


def _usable(record: Record) -> tuple[Record, list[Found]]:
    """A record without the readings that would mislead, and what was left out of it."""
    near, runaway = without_runaway(record)
    plain, spikes = without_spikes(near)
    return plain, [*runaway, *spikes]


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
