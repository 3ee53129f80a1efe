"""Write `diagnosis.json`, `report.html`, `gap.csv` and `effect.toml`, all of them or none."""

import os
import tempfile
from collections.abc import Sequence
from pathlib import Path

from orbitfb.core.errors import RecordError
from orbitfb.diagnose.report.document import page
from orbitfb.diagnose.result.diagnosis import Diagnosis, document
from orbitfb.diagnose.result.parts import Cause, PlaceValues
from orbitfb.diagnose.result.tables import gap_csv
from orbitfb.effects.files import effects_toml
from orbitfb.effects.kinds import EffectKind
from orbitfb.effects.registry import effect
from orbitfb.effects.settings import EffectSettings, read_effect

ANSWER, REPORT, EFFECTS, GAP = "diagnosis.json", "report.html", "effect.toml", "gap.csv"
_FILES = (ANSWER, REPORT, GAP, EFFECTS)
_UNKNOWN_RING = "unknown-ring"
"""The check that looks for the names in the places table."""
_OF_ANOTHER_RING = (
    "No known places table has these names, so the default ring cannot have these effects. Give "
    "`orbitfb run` the places table of your ring: ring.places in the configuration."
)


def check_directory(directory: Path) -> None:
    """See to it that a diagnosis can be written, before the work for it; make nothing.

    Raises:
        RecordError: It is a file, or cannot be made or written to; or a directory stands where a
            file is to be.
    """
    nearest = directory
    try:
        while not nearest.exists() and nearest != nearest.parent:
            nearest = nearest.parent
        if not nearest.is_dir():
            raise RecordError(
                f"--out {directory}: {nearest} is not a directory; name a directory, existing or "
                "new"
            )
        taken = [name for name in _FILES if (directory / name).is_dir()]
    except OSError as error:
        raise RecordError(
            f"--out {directory}: cannot be read ({error.strerror}); name another directory"
        ) from error
    if taken:
        raise RecordError(
            f"--out {directory}: {directory / taken[0]} is a directory where a file is to be "
            "written; remove it, or name another directory"
        )
    if not os.access(nearest, os.W_OK | os.X_OK):
        raise RecordError(
            f"--out {directory}: {nearest} cannot be written to; name another directory"
        )


def write(its: Diagnosis, directory: Path) -> tuple[Path, ...]:
    """Write the files of a diagnosis; what an earlier one left is replaced.

    All are made before the first is replaced: whoever interrupts this keeps the old ones.

    Args:
        its: The diagnosis.
        directory: Where; made when it is not there.

    Returns:
        The files written.

    Raises:
        RecordError: They cannot be written; those there are the old ones.
        ConfigError: A cause is no effect that the simulator could have.
    """
    check_directory(directory)
    texts = {ANSWER: document(its), REPORT: page(its)}
    if not its.failed:
        texts |= {GAP: gap_csv(its), EFFECTS: fragment(its)}
    try:
        directory.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".new.", dir=directory) as made:
            for name, text in texts.items():
                _write_through(Path(made, name), text)
            for name in texts:
                Path(made, name).replace(directory / name)
        for name in set(_FILES) - set(texts):
            (directory / name).unlink(missing_ok=True)
    except OSError as error:
        raise RecordError(
            f"--out {directory}: cannot be written ({error.strerror}); make room there, or name "
            "another directory"
        ) from error
    return tuple(directory / name for name in texts)


def fragment(its: Diagnosis) -> str:
    """Write the causes as the file of effects that gives a simulated ring the same gap."""
    said = "".join(sign for sign in its.headline if sign.isprintable())
    heading = f"orbitfb diagnose: {its.state}\n{said}"
    if any(finding.check == _UNKNOWN_RING for finding in its.findings):
        heading += f"\n{_OF_ANOTHER_RING}"
    return effects_toml(effects_of(its.causes), heading)


def effects_of(causes: Sequence[Cause]) -> tuple[EffectSettings, ...]:
    """Make the settings of a simulated ring from causes."""
    return tuple(_settings(cause, one) for cause in causes for one in _by_place(cause))


def _by_place(cause: Cause) -> tuple[PlaceValues, ...]:
    """Values of every device; of all of them where they are the same."""
    values = {name: its.value for name, its in cause.parameters.items()}
    same = PlaceValues(
        places=cause.places, planes=cause.planes, values=values, onset_s=cause.onset_s
    )
    return cause.by_place or (same,)


def _settings(cause: Cause, one: PlaceValues) -> EffectSettings:
    kind = effect(cause.effect)
    table: dict[str, object] = {
        "id": cause.effect,
        "values": {
            name: _within(kind, name, value)
            for name, value in one.values.items()
            if value is not None
        },
    }
    if one.elements:
        table["elements"] = {
            name: error for name, error in one.elements.items() if error is not None
        }
    if one.onset_s is not None and one.onset_s > 0:
        table["from"] = one.onset_s
    if kind.target != "ring" and one.places:
        table["names"] = list(one.places)
        if one.planes != "xy":
            table["planes"] = one.planes
    return read_effect(table, f"cause {cause.effect}")


def _within(kind: EffectKind, name: str, value: float) -> float:
    """Keep an estimate within the bounds of its parameter: rounding may have pushed it out."""
    bounds = {parameter.name: (parameter.low, parameter.high) for parameter in kind.parameters}
    low, high = bounds.get(name, (value, value))
    return min(max(value, low), high)


def _write_through(path: Path, content: str) -> None:
    with path.open("x", encoding="utf-8", errors="replace") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
