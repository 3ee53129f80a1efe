"""Write a response matrix for other programs: CSV, HDF5 or MATLAB, names and unit with it."""

import csv
import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from scipy.io import savemat

from orbitfb.core.errors import ExchangeError
from orbitfb.core.signals import Channels, Vector
from orbitfb.exchange.naming import plain_labels
from orbitfb.exchange.writing import write_whole
from orbitfb.measure.response_file import read_response
from orbitfb.policies.store.directory import PolicyStore

UNIT = "m/A"
FORMATS = (".csv", ".h5", ".hdf5", ".mat")


@dataclass(frozen=True, slots=True, eq=False)
class Exported:
    """A response matrix to write.

    Args:
        matrix: R or R̂, shape (n, m) [m/A]; NaN where nothing is known.
        covariance: Of the errors of a row, shape (m, m) [(m/A)²], or None.
        sigma: Standard deviation, shape (n, m) [m/A], or None.
        origin: Id of the policy, or the file of the measurement.
        about: What is known of it: parent, time, figures.
    """

    matrix: Vector
    covariance: Vector | None
    sigma: Vector | None
    origin: str
    about: Mapping[str, Any]


def response_of_policy(store: PolicyStore, policy: str | None, channels: Channels) -> Exported:
    """Take R̂ of a stored policy.

    Args:
        store: The store.
        policy: Its id; None: the active one.
        channels: Of the ring.

    Raises:
        ExchangeError: None is named and none is active.
        StoreError: There is no such policy, or it is damaged.
    """
    identifier = policy or store.active()
    if identifier is None:
        raise ExchangeError(
            f"there is no active policy in {store.path}; name one (`orbitfb policies list`)"
        )
    loaded, card = store.load(identifier, channels), store.card(identifier)
    about: dict[str, Any] = {
        "created": card.created,
        "kind": card.kind,
        "parent": card.parent or "",
    }
    return Exported(loaded.response, getattr(loaded, "covariance", None), None, identifier, about)


def response_of_file(path: Path, channels: Channels) -> Exported:
    """Take the matrix of a measurement.

    Raises:
        RingError: The file is missing, damaged or of another ring.
    """
    measured = read_response(path, channels)
    about = {"created": measured.card.get("created", 0.0), "kind": "measured", "parent": ""}
    return Exported(measured.table.response, None, measured.table.sigma, path.name, about)


def export_response(exported: Exported, channels: Channels, out: Path) -> dict[str, Any]:
    """Write a matrix in the format that the name of the file tells.

    Returns:
        What was written.

    Raises:
        ExchangeError: The name ends in something else, or it cannot be written.
    """
    bpms = plain_labels(channels.bpms, channels.bpm_planes)
    correctors = plain_labels(channels.correctors, channels.corrector_planes)
    suffix = out.suffix.lower()
    if suffix == ".csv":
        content = _csv(exported, bpms, correctors)
    elif suffix in (".h5", ".hdf5"):
        content = _hdf5(exported, bpms, correctors)
    elif suffix == ".mat":
        content = _mat(exported, bpms, correctors)
    else:
        raise ExchangeError(f"--out {out}: let its name end in {', '.join(FORMATS)}")
    write_whole(out, content)
    return {
        "file": str(out),
        "origin": exported.origin,
        "bpms": len(bpms),
        "correctors": len(correctors),
        "unit": UNIT,
        "covariance": exported.covariance is not None and suffix != ".csv",
    }


def _csv(exported: Exported, bpms: tuple[str, ...], correctors: tuple[str, ...]) -> bytes:
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([f"R [{UNIT}]", *correctors])
    for name, row in zip(bpms, exported.matrix, strict=True):
        writer.writerow([name, *("" if np.isnan(value) else repr(float(value)) for value in row)])
    return text.getvalue().encode()


def _parts(exported: Exported) -> dict[str, tuple[Vector, str]]:
    parts = {"response": (exported.matrix, UNIT)}
    if exported.covariance is not None:
        parts["covariance"] = (exported.covariance, f"({UNIT})^2")
    if exported.sigma is not None:
        parts["sigma"] = (exported.sigma, UNIT)
    return parts


def _hdf5(exported: Exported, bpms: tuple[str, ...], correctors: tuple[str, ...]) -> bytes:
    content = io.BytesIO()
    with h5py.File(content, "w") as file:
        for name, (array, unit) in _parts(exported).items():
            file[name] = array
            file[name].attrs["units"] = unit
        file["bpms"], file["correctors"] = list(bpms), list(correctors)
        file.attrs["origin"] = exported.origin
        for key, value in exported.about.items():
            file.attrs[key] = value
    return content.getvalue()


def _mat(exported: Exported, bpms: tuple[str, ...], correctors: tuple[str, ...]) -> bytes:
    content = io.BytesIO()
    struct: dict[str, Any] = {name: array for name, (array, _) in _parts(exported).items()}
    struct |= {"units": UNIT, "origin": exported.origin, **exported.about}
    struct["bpms"] = np.array(bpms, dtype=object)[:, None]
    struct["correctors"] = np.array(correctors, dtype=object)[:, None]
    savemat(content, {"R": struct}, do_compression=True)
    return content.getvalue()
