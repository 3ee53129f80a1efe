"""Which columns and rows of a measured matrix may be used: everything else is named."""

from dataclasses import dataclass

import numpy as np

from orbitfb.core.signals import Channels, Mask, Vector
from orbitfb.measure.column import Table
from orbitfb.measure.settings import MeasureSettings

_NOISIER = 10.0
"""Times the median BPM from which one counts as noisy."""


@dataclass(frozen=True, slots=True)
class Judgement:
    """What is wrong with a measured matrix.

    Args:
        correctors: By label, what is wrong with a corrector that was measured.
        bpms: By label, what is wrong with a BPM that is not masked.
        missing: Labels of correctors that were not measured.
    """

    correctors: dict[str, str]
    bpms: dict[str, str]
    missing: tuple[str, ...]


def labels(names: tuple[str, ...], planes: tuple[str, ...]) -> tuple[str, ...]:
    """Name every element as `masks` does: NAME, or NAME:x and NAME:y in a loop of both planes.

    Args:
        names: Of its devices.
        planes: Of each of them.
    """
    if len({*planes}) == 1:
        return names
    return tuple(f"{name}:{plane}" for name, plane in zip(names, planes, strict=True))


def judge(
    table: Table,
    nominal: Vector,
    channels: Channels,
    settings: MeasureSettings,
    counting: Mask,
) -> Judgement:
    """Judge a measured matrix.

    Args:
        table: What was measured.
        nominal: Response by the optics, shape (n, m) [m/A].
        channels: Names.
        settings: Thresholds.
        counting: BPMs that are not masked, shape (n,).
    """
    measured = table.measured
    bpms = _judge_bpms(table, nominal, settings, counting)
    good = counting & np.array([not problem for problem in bpms])
    names = labels(channels.correctors, channels.corrector_planes)
    correctors = {
        names[j]: problem
        for j in np.flatnonzero(measured)
        if (problem := _judge_corrector(table, nominal, settings, good, int(j)))
    }
    rows = labels(channels.bpms, channels.bpm_planes)
    return Judgement(
        correctors,
        {rows[i]: problem for i, problem in enumerate(bpms) if problem},
        tuple(names[j] for j in np.flatnonzero(~measured)),
    )


def _judge_bpms(
    table: Table, nominal: Vector, settings: MeasureSettings, counting: Mask
) -> list[str]:
    columns = np.flatnonzero(table.measured)
    problems = [""] * len(counting)
    if not columns.size:
        return problems
    response, sigma = table.response[:, columns], table.sigma[:, columns]
    absent = ~np.isfinite(response)
    rms = np.sqrt(np.mean(np.where(absent, 0.0, response) ** 2, axis=1))
    noise = np.sqrt(np.mean(np.where(absent, 0.0, sigma) ** 2, axis=1))
    expected = np.sqrt(np.mean(nominal[:, columns] ** 2, axis=1))
    usual = float(np.median(noise[counting]))
    for i in np.flatnonzero(counting):
        if absent[i].any():
            problems[i] = f"was not valid in {np.count_nonzero(absent[i])} of {columns.size}"
        elif not rms[i] >= settings.weakest * expected[i]:
            problems[i] = f"is dead: sees {rms[i] / expected[i]:.2g} of what the optics say"
        elif noise[i] > max(_NOISIER * usual, settings.noise * rms[i]):
            problems[i] = f"is noisy: {noise[i] / rms[i]:.2g} of its response is uncertain"
    return problems


def _judge_corrector(
    table: Table, nominal: Vector, settings: MeasureSettings, good: Mask, j: int
) -> str:
    if not good.any():
        return "no BPM saw it"
    size = float(np.sqrt(np.mean(table.response[good, j] ** 2)))
    doubt = float(np.sqrt(np.mean(table.sigma[good, j] ** 2)))
    expected = float(np.sqrt(np.mean(nominal[good, j] ** 2)))
    following = table.following[j]
    if not abs(table.phase[j]) <= settings.lag and size >= settings.weakest * expected:
        return f"lags by {table.phase[j]:.2g} rad at its frequency; measure it by steps"
    if not size >= settings.weakest * expected:
        return f"is dead: moves the orbit by {size / expected:.2g} of what the optics say"
    if not doubt <= settings.noise * size:
        return f"is noisy: {doubt / size:.2g} of its column is uncertain"
    if not table.linearity[j] <= settings.linearity:
        return f"is not linear: {table.linearity[j]:.2g} of its column"
    if np.isfinite(following) and not abs(following - 1.0) <= settings.following:
        return f"does not follow: its readback changes by {following:.3g} times the setpoint change"
    return ""
