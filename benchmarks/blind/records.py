"""Records with their truths: from a folder, or from a list of records of one known truth."""

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.blind.truth import TrueEffect, Truth, TruthError, read_truth


@dataclass(frozen=True, slots=True)
class Case:
    """A record with its truth.

    Args:
        source: Name of the generator, folder or list that it is of.
        name: Of the case.
        record: Its file.
        truth: What it holds.
        later: A later record of the same machine, if there is one.
        ring: Table of places and parameters of its ring; None: the packaged ring, or names alone.
        without: Ids of effects that the engine is to lack.
    """

    source: str
    name: str
    record: Path
    truth: Truth
    later: Path | None = None
    ring: tuple[Path, Path] | None = None
    without: tuple[str, ...] = ()


def left_out(cases: Sequence[Case]) -> list[Case]:
    """Make cases of a library that lacks the true effect, from all single ones that can be seen.

    Right is then what is right for an effect of no library: to say that here is something unknown,
    or to name one of its class by construction.
    """
    found: list[Case] = []
    for case in cases:
        truth = case.truth
        if truth.kind != "single" or truth.level not in ("easy", "medium"):
            continue
        (true,) = truth.effects
        own = true.accepted if true.effect not in true.accepted else frozenset({true.effect})
        foreign = replace(true, accepted=true.accepted - own, known=False)
        found.append(
            replace(
                case,
                source=f"{case.source} left out",
                truth=replace(truth, effects=(foreign,)),
                without=tuple(sorted(own)),
            )
        )
    return found


def read_folder(
    folder: Path,
    truths: Path | None = None,
    *,
    source: str = "",
    names: Path | None = None,
    chosen: Sequence[str] | None = None,
) -> list[Case]:
    """Read the cases of a folder.

    Args:
        folder: With NAME.npz for every case; LATER/NAME.npz beside them where there is more; a
            table of places (CSV) and its parameters (JSON, same stem) if it is another ring.
        truths: With NAME.truth.json or NAME.json; by default FOLDER_truth.
        source: What to call it; by default the name of the folder.
        names: Table from an external generator's words to ids of the library.
        chosen: Only these cases.

    Raises:
        TruthError: There is no record, or one without a truth.
    """
    truths = truths or folder.with_name(f"{folder.name}_truth")
    found: list[Case] = []
    for record in sorted(folder.glob("*.npz")):
        if chosen is not None and record.stem not in chosen:
            continue
        told = [truths / f"{record.stem}{end}" for end in (".truth.json", ".json")]
        file = next((one for one in told if one.exists()), None)
        if file is None:
            raise TruthError(f"{record}: no truth beside it; put it into {told[0]}")
        later = folder / "later" / record.name
        found.append(
            Case(
                source or folder.name,
                record.stem,
                record,
                read_truth(file, names),
                later if later.exists() else None,
                ring_of(record, folder),
            )
        )
    if not found:
        raise TruthError(f"{folder}: there is no record NAME.npz in it")
    return found


def ring_of(record: Path, folder: Path) -> tuple[Path, Path] | None:
    """Find the table of places that knows the devices of a record; None: there is none."""
    tables = [
        table for table in sorted(folder.glob("*.csv")) if table.with_suffix(".json").exists()
    ]
    if not tables:
        return None
    with np.load(record, allow_pickle=False) as arrays:
        first = str(arrays["bpm_names"][0])
    for table in tables:
        if f"\n{first}," in table.read_text(encoding="utf-8"):
            return table, table.with_suffix(".json")
    return None


def read_list(file: Path) -> list[Case]:
    """Read a list of records of which little is known: that they are healthy, or one right answer.

    A TOML file of tables `[[case]]`: `record` (path, relative to the file), `accepted` (right ids;
    none: healthy), and where wanted `states` (further right states), `places` and `parameters`
    (files of its ring), `later`, `devices` (right ones), `level` (easy, medium, hard).

    Raises:
        TruthError: A key is missing or wrong, or a file is not there.
    """
    try:
        tables = tomllib.loads(file.read_text(encoding="utf-8"))["case"]
        return [_listed(file, table) for table in tables]
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise TruthError(
            f"{file}: it is no list of cases ({type(error).__name__}: {error}); it needs tables "
            "[[case]] with record and accepted"
        ) from error


def _listed(file: Path, table: dict[str, object]) -> Case:
    def path(key: str) -> Path | None:
        return None if key not in table else _there(file, file.parent / str(table[key]))

    accepted = frozenset(map(str, _texts(table["accepted"])))
    devices = frozenset(map(str, _texts(table.get("devices", []))))
    effects = (
        (TrueEffect(" / ".join(sorted(accepted)), accepted, places=devices),) if accepted else ()
    )
    level = str(table.get("level", "easy"))
    if level not in ("easy", "medium", "hard"):
        raise ValueError(f"level {level!r}")
    record = _there(file, file.parent / str(table["record"]))
    places, parameters = path("places"), path("parameters")
    return Case(
        file.stem,
        record.stem,
        record,
        Truth(
            effects,
            level if effects else "none",
            states=tuple(map(str, _texts(table.get("states", [])))),
        ),
        path("later"),
        None if places is None or parameters is None else (places, parameters),
    )


def _texts(value: object) -> list[object]:
    if not isinstance(value, list):
        raise TypeError(f"{value!r} is no list")
    return value


def _there(file: Path, path: Path) -> Path:
    if not path.exists():
        raise TruthError(f"{file}: {path} is not there")
    return path
