"""The matrices of a file as they stand in it, with the names and units that it gives them."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from orbitfb.core.errors import ExchangeError
from orbitfb.core.signals import COUNTS, Vector, parts, planes_in
from orbitfb.exchange.formats.csv_file import COLUMNS, ROWS, VALUES, CsvSource
from orbitfb.exchange.formats.datasets import LARGEST_FILE, Source, column_of, matrix_of
from orbitfb.exchange.formats.source import check_file, names_from, names_listed, open_source
from orbitfb.exchange.response.middle_layer import block_of, is_middle_layer
from orbitfb.loco.input.matrix import Raw
from orbitfb.loco.input.parts import BPMS, CORRECTORS, MATRICES, of_json, of_numpy, unpacked
from orbitfb.loco.measured import PLANES
from orbitfb.measure.packed import read_packed

_ADVICE = "measure it with `orbitfb measure-response`, or import it"


def raw_blocks(
    file: Path, matrix: str | None, bpm_names: str | None, corrector_names: str | None
) -> tuple[Raw, ...]:
    """Read the matrices of a file.

    Args:
        file: The file.
        matrix: Path within it; None: the usual place of its format.
        bpm_names: Path of the names within it, or @FILE.
        corrector_names: Names of the correctors, in the same way.

    Raises:
        ExchangeError: It cannot be read, or says not which of its contents is the matrix.
    """
    suffix = file.suffix.lower()
    check_file(file, LARGEST_FILE)
    if suffix == ".safetensors":
        return (_packed(file),)
    if suffix in (".npy", ".npz", ".json"):
        its = of_json(file) if suffix == ".json" else of_numpy(file)
        return (_renamed(its, bpm_names, corrector_names),)
    source = open_source(file)
    if matrix is None and suffix == ".mat":
        there = source.listing()
        if is_middle_layer(source):
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
        with unpacked(file) as archive:
            return frozenset(name.removesuffix(".npy") for name in archive.namelist())
    if suffix in (".h5", ".hdf5", ".hdf"):
        return frozenset(name.partition("/")[0] for name in open_source(file).listing())
    return frozenset()


def _renamed(its: Raw, bpm_names: str | None, corrector_names: str | None) -> Raw:
    """Make the matrix of a file of parts, with the names that the caller gives."""

    def named(where: str | None, own: tuple[str, ...], option: str) -> tuple[str, ...]:
        if where is None:
            return own
        if not where.startswith("@"):
            raise ExchangeError(
                f"{option} {where}: give @FILE, a text file with one name per line; names within a "
                f"file of this format are found by themselves"
            )
        return names_listed(Path(where[1:]))

    return replace(
        its, rows=named(bpm_names, its.rows, "--bpm-names"),
        columns=named(corrector_names, its.columns, "--corrector-names"),
    )  # fmt: skip


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


def _named(
    source: Source, matrix: str | None, bpm_names: str | None, corrector_names: str | None
) -> Raw:
    if matrix is None and not isinstance(source, CsvSource):
        there = source.listing()
        matrix = next((name for name in MATRICES if name in there), None)
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
    bpm_names = bpm_names or next((name for name in BPMS if name in there), None)
    corrector_names = corrector_names or next((n for n in CORRECTORS if n in there), None)
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
    their numbers as that of the table, and the likeness with the optics tells whether it is right.
    """
    found: list[Raw] = []
    for i, read in enumerate(PLANES, start=1):
        for j, driven in enumerate(PLANES, start=1):
            its = block_of(source, i, j)
            if its is not None:
                where = f"Rmat({i},{j}).Data"
                found.append(Raw(where, its[1], its[0].units, pair=(read, driven)))
    if not found:
        raise ExchangeError(f"{source.path}: Rmat has no block with numbers in it")
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
