"""The file of an excitation: a description (TOML) or a waveform (`.npz`).

TOML, parts one after the other::

    start = 10.0             # s after the loop has closed
    seed = 1
    [[part]]
    kind = "prbs"            # prbs or white: random levels; ladder: the levels in their order
    modes = [1, 2, 3]        # singular modes of the nominal response, the strongest is 1; or
    correctors = ["CL1A_C01"]
    planes = "x"             # of the correctors that are named
    amplitude = [0.05, 0.1]  # A: rms of every mode's or corrector's excursion, or one for all
    levels = [1, -1, 2, -2]  # of a ladder, times the amplitude
    hold = 2                 # ticks at every level
    duration = 60.0          # s

`.npz`: `waveform` (T, k) [A], `corr_names` (k,), and, where both planes are there, `planes` (k,);
`start_s` () if it is not to be the default.
"""

import math
import tokenize
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray
from pydantic import ValidationError

from orbitfb.core.errors import ConfigError
from orbitfb.core.files.arrays import first_line
from orbitfb.core.files.bounded import LARGEST_TEXT, parse_toml, read_text
from orbitfb.core.signals import Channels
from orbitfb.loop.excitation.design import (
    DEFAULT_START,
    LONGEST,
    ExcitationSettings,
    columns_of,
    design,
)
from orbitfb.loop.excitation.movement import Waveform

Matrix = NDArray[np.float64]
HOW_TO = (
    "a description (TOML) holds one [[part]] or more, each with kind, modes or correctors, "
    "amplitude and duration; a waveform (.npz) holds waveform (T, k) [A] and corr_names (k,); "
    "`orbitfb diagnose plan RECORD --out FILE` makes either"
)
_LARGEST, _USUAL, _ABSURD_RATIO = 1 << 30, 1 << 26, 200
_DAMAGED = (
    ValueError, EOFError, KeyError, TypeError, SyntaxError, RecursionError, OverflowError,
    NotImplementedError, RuntimeError, zlib.error, zipfile.BadZipFile, tokenize.TokenError,
)  # fmt: skip
"""All that zipfile and numpy raise over a damaged file."""


def read_excitation(path: Path, channels: Channels, response: Matrix, period: float) -> Waveform:
    """Read what to do from a file.

    Args:
        path: `.npz`: a waveform; any other: a description.
        channels: Of the ring.
        response: Nominal, shape (n, m) [m/A].
        period: Of the loop [s].

    Raises:
        ConfigError: It cannot be read, or names what the ring does not have.
    """
    try:
        if path.suffix == ".npz":
            return _from_arrays(path, channels, period)
    except OSError as error:
        raise ConfigError(f"--excite {path}: cannot be read ({error.strerror})") from None
    text = read_text(path, LARGEST_TEXT, ConfigError, "name a TOML or .npz file with --excite")
    tree = parse_toml(text, f"--excite {path}", ConfigError)
    try:
        settings = ExcitationSettings.model_validate(tree)
    except ValidationError as error:
        raise ConfigError(f"--excite {path}: {_problems(error)}; {HOW_TO}") from None
    return design(settings, channels, response, period, f"--excite {path}")


_SAID = {
    "missing": "{0} is missing",
    "extra_forbidden": "{0} is no key of a description",
}
"""What is wrong, by the validator's type, of what stands where; its own words for the others."""


def _problems(error: ValidationError) -> str:
    """Say what is wrong, each once: a list with a part that is wrong is not also too short."""
    found = error.errors()
    outer = {each["loc"][:depth] for each in found for depth in range(len(each["loc"]))}
    told: list[str] = []
    for each in found:
        if each["loc"] not in outer:
            where = " ".join(str(key + 1 if isinstance(key, int) else key) for key in each["loc"])
            given = each["input"]
            told_value = isinstance(given, str | int | float) and each["type"] != "extra_forbidden"
            got = f", got {given!r:.60}" if told_value else ""
            told.append(_SAID.get(each["type"], "{0}: {1}").format(where, each["msg"]) + got)
    return "; ".join(told)


def _from_arrays(path: Path, channels: Channels, period: float) -> Waveform:
    where = f"--excite {path}"
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            size = sum(its.file_size for its in members)
            if size > min(_LARGEST, max(_USUAL, _ABSURD_RATIO * path.stat().st_size)):
                raise ConfigError(f"{where}: unpacks to {size} bytes, which no waveform does")
            given = {its.filename.removesuffix(".npy"): _array(archive, its) for its in members}
    except (*_DAMAGED, MemoryError) as error:
        told = first_line(error)
        raise ConfigError(f"{where}: is no file of arrays that can be read: {told}") from None
    missing = {"waveform", "corr_names"} - set(given)
    if missing:
        raise ConfigError(f"{where}: has no {' and no '.join(sorted(missing))}; {HOW_TO}")
    rows, names = given["waveform"], [str(name) for name in np.atleast_1d(given["corr_names"])]
    if rows.ndim != 2 or rows.shape[1] != len(names) or not 0 < len(rows) <= LONGEST:
        raise ConfigError(
            f"{where}: waveform has shape {rows.shape}; it must be (T, {len(names)}), T from 1 to "
            f"{LONGEST}, one column for each of corr_names"
        )
    if rows.dtype.kind not in "fiu" or not np.isfinite(rows).all():
        raise ConfigError(f"{where}: waveform must be finite numbers [A]")
    planes = [str(p) for p in np.atleast_1d(given.get("planes", [channels.planes] * len(names)))]
    if len(planes) != len(names):
        raise ConfigError(f"{where}: planes must have one element for each of corr_names")
    excursion = np.zeros((len(rows), len(channels.correctors)))
    used: set[int] = set()
    for column, (name, plane) in enumerate(zip(names, planes, strict=True)):
        hits = columns_of([name], plane, channels, where)
        if len(hits) > 1 or hits[0] in used:
            raise ConfigError(f"{where}: {name} is not unique; say in `planes` which is x, which y")
        used.add(hits[0])
        excursion[:, hits[0]] = rows[:, column]
    begin = np.asarray(given.get("start_s", DEFAULT_START))
    if begin.size != 1 or begin.dtype.kind not in "fiu" or not 0 <= begin.item() < 1e6:
        raise ConfigError(f"{where}: start_s is {begin!s:.40}; give one number of seconds")
    return Waveform(excursion, round(begin.item() / period))


def _array(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> NDArray[Any]:
    """Read an array whose header claims what is there; nothing is unpickled."""
    with archive.open(member) as file:
        version = npy.read_magic(file)
        read_header = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
        shape, fortran, dtype = read_header(file)
        content = file.read(member.file_size - file.tell())
    if dtype.hasobject or math.prod(shape) * dtype.itemsize != len(content):
        raise ValueError(f"{member.filename} holds no array of shape {shape} and type {dtype}")
    return np.frombuffer(content, dtype).reshape(shape, order="F" if fortran else "C")
