"""Write `diagnosis.json`, `report.html`, `gap.csv` and `effect.toml`, each whole or not at all."""

import os
import uuid
from collections.abc import Sequence
from pathlib import Path

from orbitfb.core.errors import RecordError
from orbitfb.diagnose.answer import Diagnosis, document
from orbitfb.diagnose.answer_parts import Cause
from orbitfb.diagnose.report.page import page
from orbitfb.diagnose.tables import gap_csv
from orbitfb.effects.files import effects_toml
from orbitfb.effects.kinds import EffectKind
from orbitfb.effects.registry import effect
from orbitfb.effects.settings import EffectSettings, read_effect

ANSWER, REPORT, EFFECTS, GAP = "diagnosis.json", "report.html", "effect.toml", "gap.csv"


def check_directory(directory: Path) -> None:
    """See to it that a diagnosis can be written, before the work for it; make nothing.

    Raises:
        RecordError: It is a file, or cannot be made or written to.
    """
    nearest = directory
    while not nearest.exists() and nearest != nearest.parent:
        nearest = nearest.parent
    if not nearest.is_dir():
        raise RecordError(f"--out {directory}: {nearest} is no directory; name one, or a new one")
    if not os.access(nearest, os.W_OK | os.X_OK):
        raise RecordError(
            f"--out {directory}: {nearest} cannot be written to; name another directory"
        )


def write(its: Diagnosis, directory: Path) -> tuple[Path, ...]:
    """Write the files of a diagnosis; what an earlier one left is replaced.

    Args:
        its: The diagnosis.
        directory: Where; made when it is not there.

    Returns:
        The files written.

    Raises:
        RecordError: They cannot be written; each is then the old one or the new one.
        ConfigError: A cause is no effect that the simulator could have.
    """
    try:
        directory.mkdir(parents=True, exist_ok=True)
        _replace(directory / ANSWER, document(its))
        _replace(directory / REPORT, page(its))
        if its.failed:
            for stale in (EFFECTS, GAP):
                (directory / stale).unlink(missing_ok=True)
            return directory / ANSWER, directory / REPORT
        _replace(directory / GAP, gap_csv(its))
        _replace(directory / EFFECTS, fragment(its))
    except OSError as error:
        raise RecordError(
            f"--out {directory}: {error.filename or directory}: {error.strerror}; the files there "
            "are whole, but may be of different diagnoses"
        ) from error
    return tuple(directory / name for name in (ANSWER, REPORT, GAP, EFFECTS))


def fragment(its: Diagnosis) -> str:
    """Write the causes as the file of effects that gives a simulated ring the same gap."""
    said = "".join(sign for sign in its.headline if sign.isprintable())
    heading = f"orbitfb diagnose: {its.state}\n{said}"
    return effects_toml(effects_of(its.causes), heading)


def effects_of(causes: Sequence[Cause]) -> tuple[EffectSettings, ...]:
    """Make the settings of a simulated ring from causes."""
    return tuple(_settings(cause) for cause in causes)


def _settings(cause: Cause) -> EffectSettings:
    kind = effect(cause.effect)
    table: dict[str, object] = {
        "id": cause.effect,
        "values": {
            name: _within(kind, name, its.value)
            for name, its in cause.parameters.items()
            if its.value is not None
        },
    }
    if cause.onset_s is not None and cause.onset_s > 0:
        table["from"] = cause.onset_s
    if kind.target != "ring" and cause.places:
        table["names"] = list(cause.places)
        if cause.planes != "xy":
            table["planes"] = cause.planes
    return read_effect(table, f"cause {cause.effect}")


def _within(kind: EffectKind, name: str, value: float) -> float:
    """Keep an estimate within the bounds of its parameter: rounding may have pushed it out."""
    bounds = {parameter.name: (parameter.low, parameter.high) for parameter in kind.parameters}
    low, high = bounds.get(name, (value, value))
    return min(max(value, low), high)


def _replace(path: Path, content: str) -> None:
    new = path.parent / f".{path.name}.{uuid.uuid4().hex}"
    try:
        with new.open("x", encoding="utf-8", errors="replace") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        new.replace(path)
    finally:
        new.unlink(missing_ok=True)
