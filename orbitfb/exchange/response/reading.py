"""Take a response matrix that was measured elsewhere into the file that `ring.response` names."""

import time
from dataclasses import replace
from typing import Any

import numpy as np

from orbitfb import __version__
from orbitfb.core.errors import ExchangeError
from orbitfb.core.near_names import did_you_mean
from orbitfb.core.signals import Channels, Vector
from orbitfb.exchange.formats.datasets import matrix_of
from orbitfb.exchange.formats.source import open_source
from orbitfb.exchange.plausible import doubtful, likeness, response_problem
from orbitfb.exchange.response.parts import (
    ORDERS,
    ResponseRequest,
    found_in,
    places_in,
    table_of,
)
from orbitfb.exchange.units import PER_CURRENT, PER_KICK, RESPONSE, factor
from orbitfb.measure.column import Table
from orbitfb.measure.growth import Loop, growth_told
from orbitfb.measure.judging import Judgement, judge, labels
from orbitfb.measure.response_file import write_response
from orbitfb.measure.settings import MeasureSettings
from orbitfb.physics.places import Planes, Ring, split
from orbitfb.physics.response import response


def import_response(
    request: ResponseRequest,
    ring: Ring,
    planes: Planes,
    settings: MeasureSettings,
    loop: Loop | None = None,
) -> dict[str, Any]:
    """Read a matrix, see that it is of this ring, and write it for `ring.response`.

    Args:
        request: The file, and what is said of it.
        ring: The ring.
        planes: `x`, `y` or `xy`.
        settings: Thresholds of what is bad.
        loop: The loop that would be closed on it; None: the default SVD of the optics.

    Returns:
        What was taken, and what of it is not to be used.

    Raises:
        ExchangeError: The file is not readable, not of this ring, or not plausible.
        MeasurementError: The result cannot be written.
    """
    if request.order not in ORDERS:
        raise ExchangeError(f"--order {request.order}: choose from {', '.join(ORDERS)}")
    if request.out.suffix.lower() not in (".safetensors", ""):
        raise ExchangeError(
            f"--out {request.out}: `ring.response` is a safetensors file whatever it is called; "
            "let its name end in .safetensors"
        )
    source = open_source(request.file)
    channels = ring.channels(planes)
    found = found_in(source, request.matrix, planes)
    rows, columns, lacking = places_in(source, request, matrix_of(found, source.path), channels)
    unit, size = factor(
        request.unit, found.units, RESPONSE, f"{source.path}: {found.where}", "--unit"
    )
    scale = size * (_calibration(ring, planes) if unit in PER_KICK else 1.0)
    nominal = response(ring, planes)
    if not np.isfinite(matrix_of(found, source.path)).any():
        raise ExchangeError(f"{source.path}: {found.where} has no number; nothing is written")
    table = table_of(source, request, found, channels, rows, columns)
    table.response[:] *= scale
    table.sigma[:] *= scale
    units = PER_KICK if unit in PER_KICK else PER_CURRENT
    problem = response_problem(table.response, nominal, channels, unit, units)
    if problem and not request.anyway:
        raise ExchangeError(
            f"{source.path}: {found.where} is not taken: {problem}; --anyway takes it as it is"
        )
    judgement = _judged(table, nominal, channels, settings)
    about = {
        "created": time.time(),
        "method": "imported",
        "source": source.path.name,
        "matrix": found.where,
        "unit": unit,
        "implausible": problem,
        "version": __version__,
    }
    base = np.full(len(channels.correctors), np.nan)
    write_response(request.out, table, base, channels, judgement, about)
    answer = _answer(request, table, nominal, channels, judgement, unit, problem, loop)
    known = (*labels(channels.bpms, channels.bpm_planes),
             *labels(channels.correctors, channels.corrector_planes))  # fmt: skip
    return answer | {
        "left_out": {
            name: f"is not in the places table{did_you_mean(name, known, most=1)}"
            for name in lacking
        }
    }


def _calibration(ring: Ring, planes: Planes) -> Vector:
    """Kick per ampere of every setpoint, shape (m,) [rad/A]."""
    return np.concatenate([ring.calibration(plane) for plane in split(planes)])


def _judged(
    table: Table, nominal: Vector, channels: Channels, settings: MeasureSettings
) -> Judgement:
    """Judge as a measurement of our own is; what was not measured elsewhere does not count."""
    nothing = np.zeros_like(table.linearity)
    assumed = replace(
        table,
        sigma=np.where(np.isfinite(table.sigma), table.sigma, 0.0),
        linearity=nothing,
        phase=nothing,
    )
    judged = judge(
        assumed, nominal, channels, settings, np.ones(len(channels.bpms), dtype=np.bool_)
    )
    columns = labels(channels.correctors, channels.corrector_planes)
    rows = labels(channels.bpms, channels.bpm_planes)
    return replace(
        judged,
        correctors=doubtful(table.response, nominal, columns) | judged.correctors,
        bpms=doubtful(table.response.T, nominal.T, rows) | judged.bpms,
    )


def _answer(
    request: ResponseRequest,
    table: Table,
    nominal: Vector,
    channels: Channels,
    judgement: Judgement,
    unit: str,
    problem: str,
    loop: Loop | None,
) -> dict[str, Any]:
    found = likeness(table.response, nominal)
    return {
        "file": str(request.out),
        "unit": unit,
        "bpms": int(np.isfinite(table.response).any(axis=1).sum()),
        "correctors": int(table.measured.sum()),
        "not_measured": len(judgement.missing),
        "cosine_with_optics": round(found.cosine, 4),
        "size_over_optics": round(found.size, 4),
        "planes": channels.planes,
        "implausible": problem,
        "loop": growth_told(table.response, nominal, channels, loop),
        "bad_correctors": judgement.correctors,
        "bad_bpms": judgement.bpms,
    }
