"""Files of named parts, `.npz` and JSON, and `.npy`: a matrix, its names, planes, unit and noise.

JSON of pyAML and pySC has matrix, names of observables and variables (outputs and inputs in pySC)
and a plane for each, H or V.
"""

import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from orbitfb.core.errors import ExchangeError
from orbitfb.core.files.arrays import first_line
from orbitfb.core.files.bounded import LARGEST_TEXT, parse_json, read_text
from orbitfb.core.signals import Vector
from orbitfb.loco.input.matrix import Raw
from orbitfb.loco.noise import of_repeats
from orbitfb.physics.optics import Matrix

MATRICES = ("response", "matrix", "R", "RM")
BPMS = ("bpms", "bpm_names", "observable_names", "output_names", "outputs", "rows")
CORRECTORS = (
    "correctors", "corrector_names", "variable_names", "input_names", "inputs", "columns",
)  # fmt: skip
_BPM_PLANES = ("bpm_planes", "observable_planes", "output_planes", "outputs_plane")
_CORRECTOR_PLANES = ("corrector_planes", "variable_planes", "input_planes", "inputs_plane")
_UNITS = ("units", "unit")
_PLANES = {"H": "x", "V": "y", "X": "x", "Y": "y"}
_MOST_ARRAYS, _LARGEST, _PACKED = 64, 1 << 30, 200
"""Most arrays of a file, most bytes of them, and how many times they may be packed."""


def unpacked(file: Path) -> zipfile.ZipFile:
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


def of_numpy(file: Path) -> Raw:
    """Read `.npy` or `.npz`.

    Raises:
        ExchangeError: It cannot be read, or has no matrix.
    """
    try:
        if file.suffix.lower() == ".npy":  # mapped: a header cannot claim more than there is
            values, sigma = _matrices(np.load(file, "r", allow_pickle=False), file)
            return Raw(file.name, values, sigma=sigma)
        unpacked(file).close()
        content = np.load(file, allow_pickle=False)
        found = {name: content[name] for name in content.files}
    except (OSError, ValueError, KeyError, EOFError) as error:
        raise ExchangeError(
            f"{file}: no readable {file.suffix} of numbers and names ({first_line(error)}); save "
            "it again, without objects in it"
        ) from error
    return _of_parts(file, found)


def of_json(file: Path) -> Raw:
    """Read JSON.

    Raises:
        ExchangeError: It cannot be read, or has no matrix.
    """
    content = parse_json(read_text(file, LARGEST_TEXT, ExchangeError, "name a file"), file,
                         ExchangeError)  # fmt: skip
    if not isinstance(content, dict):
        raise ExchangeError(
            f"{file}: no object with a matrix in it; write one with `response`, `bpms`, "
            "`correctors` and `units`"
        )
    return _of_parts(file, content)


def _of_parts(file: Path, parts: dict[str, Any]) -> Raw:
    name = next((name for name in MATRICES if name in parts), None)
    if name is None:
        raise ExchangeError(
            f"{file}: none of {', '.join(MATRICES)} is in it (there are: "
            f"{', '.join(list(parts)[:20])}); call the matrix one of these"
        )
    values, scatter = _matrices(parts[name], file)
    sigma = _table(parts["sigma"], file) if "sigma" in parts else scatter
    eta = parts.get("dispersion")
    units = next((str(np.asarray(parts[key])) for key in _UNITS if key in parts), "")
    rows = _labels(parts, BPMS, _BPM_PLANES, file)
    columns = _labels(parts, CORRECTORS, _CORRECTOR_PLANES, file)
    dispersion = None if eta is None else np.ravel(_numbers(eta, file))
    return Raw(name, values, units, rows, columns, sigma, dispersion=dispersion)


def _labels(
    parts: dict[str, Any], names: tuple[str, ...], planes: tuple[str, ...], file: Path
) -> tuple[str, ...]:
    """Name the devices NAME:x and NAME:y where the file says the plane of each.

    Names that come twice in a row, all of them, are those of x and then of y.
    """
    own, each = _texts(parts, names), _texts(parts, planes)
    if own and each:
        if len(own) != len(each):
            raise ExchangeError(
                f"{file}: {len(each)} planes for {len(own)} names ({own[0]}, …); give one for each"
            )
        # what is of no plane of the orbit, a quadrupole, keeps its name and is left out
        found = [(name, _PLANES.get(plane.upper())) for name, plane in zip(own, each, strict=True)]
        return tuple(f"{name}:{plane}" if plane else name for name, plane in found)
    half = len(own) // 2
    if half and own[:half] == own[half:]:
        return tuple(f"{name}:{plane}" for plane in "xy" for name in own[:half])
    return own


def _texts(parts: dict[str, Any], keys: tuple[str, ...]) -> tuple[str, ...]:
    for key in keys:
        if parts.get(key) is not None:
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
