"""The matrices of a file as they stand in it, with the names and units that it gives them."""

import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from orbitfb.core.errors import ExchangeError
from orbitfb.core.files.arrays import first_line
from orbitfb.core.files.bounded import LARGEST_TEXT, parse_json, read_text
from orbitfb.core.signals import COUNTS, Vector, parts, planes_in
from orbitfb.exchange.formats.csv_file import COLUMNS, ROWS, VALUES, CsvSource
from orbitfb.exchange.formats.datasets import LARGEST_FILE, Source, column_of, matrix_of
from orbitfb.exchange.formats.source import check_file, names_from, open_source
from orbitfb.loco.measured import PLANES, Pair
from orbitfb.loco.noise import of_repeats
from orbitfb.measure.packed import read_packed
from orbitfb.physics.optics import Matrix

_ADVICE = "measure it with `orbitfb measure-response`, or import it"
_MATRICES = ("response", "matrix", "R", "RM")
_BPMS = ("bpms", "bpm_names", "output_names", "outputs", "rows")
_CORRECTORS = ("correctors", "corrector_names", "input_names", "inputs", "columns")
_UNITS = ("units", "unit")
_MOST_ARRAYS, _LARGEST, _PACKED = 64, 1 << 30, 200
"""Most arrays of a file, most bytes of them, and how many times they may be packed."""


@dataclass(frozen=True, slots=True, eq=False)
class Raw:
    """A matrix of a file.

    Args:
        where: In the file, for messages.
        values: Shape (n, m), in the unit of the file.
        unit: As the file says; empty: it does not.
        rows: Names of the BPMs; empty: none.
        columns: Names of the correctors; empty: none.
        sigma: Standard deviations, the same unit; None: not known.
        pair: Planes of rows and columns, where the file says.
        planes: Planes that are stacked in it, where the file says.
        dispersion: Measured horizontal dispersion of the rows [m], or the change of their orbit by
            a relative change of the RF frequency of 1 [m]; None: not in the file.
        by_frequency: Whether it is the latter.
    """

    where: str
    values: Matrix
    unit: str = ""
    rows: tuple[str, ...] = ()
    columns: tuple[str, ...] = ()
    sigma: Matrix | None = None
    pair: Pair | None = None
    planes: str | None = None
    dispersion: Vector | None = None
    by_frequency: bool = False


def raw_blocks(
    file: Path, matrix: str | None, bpm_names: str | None, corrector_names: str | None
) -> tuple[Raw, ...]:
    """Read the matrices of a file.

    Args:
        file: The file.
        matrix: Path within it; None: the usual place of its format.
        bpm_names: Path of the names within it, or @FILE.
        corrector_names: The same of the correctors.

    Raises:
        ExchangeError: It cannot be read, or says not which of its contents is the matrix.
    """
    suffix = file.suffix.lower()
    check_file(file, LARGEST_FILE)
    if suffix == ".safetensors":
        return (_packed(file),)
    if suffix in (".npy", ".npz"):
        return (_numpy(file),)
    if suffix == ".json":
        return (_json(file),)
    source = open_source(file)
    if matrix is None and suffix == ".mat":
        there = source.listing()
        if any(name.startswith("Rmat.") for name in there):
            return _middle_layer(source)
        if "LocoMeasData.M" in there:
            return (_loco(source),)
    return (_named(source, matrix, bpm_names, corrector_names),)


def names_inside(file: Path) -> frozenset[str]:
    """Read the names of what is at the top of an `.npz` or HDF5 file; none of another format.

    Raises:
        ExchangeError: It cannot be read.
    """
    suffix = file.suffix.lower()
    if suffix == ".npz":
        with _unpacked(file) as archive:
            return frozenset(name.removesuffix(".npy") for name in archive.namelist())
    if suffix in (".h5", ".hdf5", ".hdf"):
        return frozenset(name.partition("/")[0] for name in open_source(file).listing())
    return frozenset()


def _unpacked(file: Path) -> zipfile.ZipFile:
    """Open an `.npz` file whose arrays are few and not absurdly packed.

    Raises:
        ExchangeError: It is none, or claims more than a response can be.
    """
    try:
        archive = zipfile.ZipFile(file)
    except (OSError, zipfile.BadZipFile) as error:
        raise ExchangeError(
            f"{file}: no readable .npz ({first_line(error)}); save it again with numpy.savez"
        ) from error
    members = archive.infolist()
    size = sum(one.file_size for one in members)
    if len(members) > _MOST_ARRAYS or size > _LARGEST or size > _PACKED * file.stat().st_size:
        archive.close()
        raise ExchangeError(
            f"{file}: {len(members)} arrays of {size} bytes when unpacked: a response is smaller; "
            f"save the matrix, its names and sigmas alone"
        )
    return archive


def _packed(file: Path) -> Raw:
    tensors, card = read_packed(file, "response", _ADVICE, ExchangeError)
    planes = str(card.get("planes", "x"))

    def labels(names: Any, counts: Any) -> tuple[str, ...]:
        each = planes_in(parts(planes, len(names), counts))
        return tuple(f"{name}:{plane}" for name, plane in zip(names, each, strict=True))

    return Raw(
        "response", tensors["response"], "m/A", labels(card["bpms"], card.get(COUNTS[0], ())),
        labels(card["correctors"], card.get(COUNTS[1], ())), tensors["sigma"], None, planes,
    )  # fmt: skip


def _numpy(file: Path) -> Raw:
    try:
        if file.suffix.lower() == ".npy":  # mapped: a header cannot claim more than there is
            values, sigma = _matrices(np.load(file, "r", allow_pickle=False), file)
            return Raw(file.name, values, sigma=sigma)
        _unpacked(file).close()
        content = np.load(file, allow_pickle=False)
        found = {name: content[name] for name in content.files}
    except (OSError, ValueError, KeyError, EOFError) as error:
        raise ExchangeError(
            f"{file}: no readable {file.suffix} of numbers and names ({first_line(error)}); save "
            "it again, without objects in it"
        ) from error
    return _of_parts(file, found)


def _json(file: Path) -> Raw:
    content = parse_json(read_text(file, LARGEST_TEXT, ExchangeError, "name a file"), file,
                         ExchangeError)  # fmt: skip
    if not isinstance(content, dict):
        raise ExchangeError(f"{file}: no object with a matrix in it; {_ADVICE}")
    return _of_parts(file, content)


def _of_parts(file: Path, parts: dict[str, Any]) -> Raw:
    name = next((name for name in _MATRICES if name in parts), None)
    if name is None:
        raise ExchangeError(
            f"{file}: none of {', '.join(_MATRICES)} is in it (there are: "
            f"{', '.join(list(parts)[:20])}); call the matrix one of these"
        )
    values, scatter = _matrices(parts[name], file)
    sigma = _table(parts["sigma"], file) if "sigma" in parts else scatter
    eta = parts.get("dispersion")
    units = next((str(np.asarray(parts[key])) for key in _UNITS if key in parts), "")
    return Raw(
        name, values, units, _texts(parts, _BPMS), _texts(parts, _CORRECTORS), sigma,
        dispersion=None if eta is None else np.ravel(_numbers(eta, file)),
    )  # fmt: skip


def _texts(parts: dict[str, Any], keys: tuple[str, ...]) -> tuple[str, ...]:
    for key in keys:
        if key in parts:
            return tuple(str(name) for name in np.ravel(np.asarray(parts[key])))
    return ()


def _numbers(values: Any, file: Path) -> Vector:
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ExchangeError(f"{file}: its matrix is no table of numbers ({error})") from error


def _table(values: Any, file: Path) -> Matrix:
    found = _numbers(values, file)
    if found.ndim != 2 or 0 in found.shape:
        raise ExchangeError(f"{file}: its matrix has shape {found.shape}; give rows and columns")
    return found


def _matrices(values: Any, file: Path) -> tuple[Matrix, Matrix | None]:
    """Read a matrix, or repeats of one (first axis): their mean, and its noise by their scatter."""
    found = _numbers(values, file)
    if found.ndim == 3 and 0 not in found.shape:
        mean, sigma = of_repeats(found)
        return mean, sigma if np.isfinite(sigma).any() else None
    return _table(found, file), None


def _named(
    source: Source, matrix: str | None, bpm_names: str | None, corrector_names: str | None
) -> Raw:
    if matrix is None and not isinstance(source, CsvSource):
        there = source.listing()
        matrix = next((name for name in _MATRICES if name in there), None)
        if matrix is None:
            raise ExchangeError(
                f"{source.path}: --matrix must say which of these is the matrix: "
                f"{', '.join(there[:30])}"
            )
    found = source.get(matrix or VALUES)
    there = source.listing()
    if bpm_names is None and isinstance(source, CsvSource):
        bpm_names = ROWS if source.rows else None
    if corrector_names is None and isinstance(source, CsvSource):
        corrector_names = COLUMNS if source.columns else None
    bpm_names = bpm_names or next((name for name in _BPMS if name in there), None)
    corrector_names = corrector_names or next((n for n in _CORRECTORS if n in there), None)
    sigma = None
    if not isinstance(source, CsvSource) and "sigma" in there:
        sigma = matrix_of(source.get("sigma"), source.path)
    return Raw(
        found.where, matrix_of(found, source.path), found.units,
        names_from(source, bpm_names) if bpm_names else (),
        names_from(source, corrector_names) if corrector_names else (), sigma,
    )  # fmt: skip


def _middle_layer(source: Source) -> tuple[Raw, ...]:
    """Read `Rmat` of the Matlab Middle Layer: rows and columns are the families of x and y.

    Its devices are numbered, [sector, device], and have no names: they are taken in the order of
    the table, and the likeness with the optics tells whether that is right.
    """
    found: list[Raw] = []
    for i, read in enumerate(PLANES, start=1):
        for j, driven in enumerate(PLANES, start=1):
            where = f"Rmat({i},{j}).Data"
            try:
                block = source.get(where)
            except ExchangeError:
                if i == j == 1:
                    raise
                continue
            if block.numbers.size:
                values = matrix_of(block, source.path)
                found.append(Raw(where, values, block.units, pair=(read, driven)))
    return tuple(found)


def _loco(source: Source) -> Raw:
    """Read a LOCO file: orbits per whole step [mm], steps in mrad, BPM noise in mm."""

    def numbers(*paths: str) -> Vector:
        return np.concatenate(
            [column_of(source.get(path), source.path).astype(float) for path in paths]
        )

    kicks = 1e-3 * numbers("CMData(1).HCMKicks", "CMData(1).VCMKicks")
    orbits = matrix_of(source.get("LocoMeasData.M"), source.path)
    if orbits.shape[1] != len(kicks):
        raise ExchangeError(
            f"{source.path}: LocoMeasData.M has {orbits.shape[1]} columns, CMData(1) "
            f"{len(kicks)} kicks; save them together"
        )
    noise = numbers("LocoMeasData.BPMSTD")
    sigma = np.sqrt(2.0) * noise[:, None] / np.abs(kicks)
    return Raw(
        "LocoMeasData.M", orbits / kicks, "mm/rad", sigma=sigma * np.ones_like(orbits),
        planes="xy", dispersion=_of_rf_step(numbers, len(noise)), by_frequency=True,
    )  # fmt: skip


def _of_rf_step(numbers: Callable[..., Vector], rows: int) -> Vector | None:
    """Change of the orbit [mm] by a step of the RF frequency [Hz], per relative change [m]."""
    try:
        eta = numbers("LocoMeasData.Eta")
        step, frequency = (float(numbers(f"LocoMeasData.{n}")[0]) for n in ("DeltaRF", "RF"))
    except (ExchangeError, ValueError):
        return None  # it was not measured
    return 1e-3 * eta * frequency / step if step and len(eta) == rows else None
