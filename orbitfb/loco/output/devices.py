"""What the fit says of every device, as the answer has it."""

import numpy as np

from orbitfb.loco.classes import degenerate
from orbitfb.loco.estimates import Estimate
from orbitfb.loco.measured import bpm_labels, corrector_labels
from orbitfb.loco.run import Result
from orbitfb.loco.schema import Kick, Outlier, Quadrupole, Reading, Skew


def readings(result: Result) -> tuple[Reading, ...]:
    """Tell every reading of a plane."""
    found: list[Reading] = []
    for plane in result.mended.planes:
        gain, phase = result.estimates[f"gain:{plane}"], result.estimates[f"row-phase:{plane}"]
        roll = result.estimates.get(f"roll:{plane}")
        noise, residual = result.fit.noise[plane], result.fit.residual[plane]
        for number, (label, place) in enumerate(
            zip(bpm_labels(result.mended, result.ring, plane), result.mended.bpms[plane],
                strict=True)
        ):  # fmt: skip
            kept = noise.kept[number]
            there = bool(kept.any())
            found.append(
                Reading(
                    name=label, plane=plane, s_m=float(result.ring.table.s[place]),
                    gain=1.0 + gain.value[number] if there else None,
                    gain_sigma=gain.sigma[number] if there else None,
                    z=gain.z[number] if there else None,
                    roll=_of(roll, number), roll_sigma=_sigma_of(roll, number),
                    phase_rad=phase.value[number] if there else None,
                    residual_m_per_rad=float(np.sqrt(np.mean(residual[number][kept] ** 2)))
                    if there else None,
                )
            )  # fmt: skip
    return tuple(found)


def kicks(result: Result) -> tuple[Kick, ...]:
    """Tell every corrector of a plane."""
    found: list[Kick] = []
    for plane in result.mended.planes:
        its = result.estimates[f"calibration:{plane}"]
        phase = result.estimates[f"column-phase:{plane}"]
        energy, tilt = (
            result.estimates.get(f"energy:{plane}"),
            result.estimates.get(f"tilt:{plane}"),
        )
        kept = result.fit.noise[plane].kept
        for number, (label, place) in enumerate(
            zip(corrector_labels(result.mended, result.ring, plane),
                result.mended.correctors[plane], strict=True)
        ):  # fmt: skip
            there = bool(kept[:, number].any())
            found.append(
                Kick(
                    name=label, plane=plane, s_m=float(result.ring.table.s[place]),
                    calibration=its.value[number] if there else None,
                    calibration_sigma=its.sigma[number] if there else None,
                    z=its.z[number] if there else None,
                    tilt=_of(tilt, number), tilt_sigma=_sigma_of(tilt, number),
                    phase_rad=phase.value[number] if there else None,
                    energy_per_rad=_of(energy, number),
                )
            )  # fmt: skip
    return tuple(found)


def _of(its: Estimate | None, number: int) -> float | None:
    return None if its is None else float(its.value[number])


def _sigma_of(its: Estimate | None, number: int) -> float | None:
    return None if its is None else float(its.sigma[number])


def quadrupoles(result: Result) -> tuple[Quadrupole, ...]:
    """Tell every quadrupole, with those that it cannot be told from."""
    its = result.estimates["gradient"]
    names, s = result.ring.names("QUAD"), result.ring.table.s[result.ring.places("QUAD")]
    classes = degenerate(result.fit, names)
    return tuple(
        Quadrupole(
            name=name, s_m=float(s[number]), relative=its.value[number], sigma=its.sigma[number],
            z=its.z[number], degenerate_with=classes[number][0],
            integral_sigma=classes[number][1],
        )
        for number, name in enumerate(names)
    )  # fmt: skip


def skews(result: Result) -> tuple[Skew, ...]:
    """Tell what couples the planes; nothing where no cross block was measured."""
    its = result.estimates.get("skew")
    if its is None:
        return ()
    table, places = result.ring.table, result.optics.skews
    return tuple(
        Skew(
            name=table.name[int(place)], s_m=float(table.s[place]), skew_per_m=its.value[number],
            sigma=its.sigma[number], z=its.z[number],
        )
        for number, place in enumerate(places)
    )  # fmt: skip


def outliers(result: Result) -> tuple[Outlier, ...]:
    """Tell the elements that are far off."""
    found: list[Outlier] = []
    for plane in result.mended.planes:
        noise, residual = result.fit.noise[plane], result.fit.residual[plane]
        rows = bpm_labels(result.mended, result.ring, plane)
        columns = corrector_labels(result.mended, result.ring, plane)
        for i, j in np.argwhere(noise.outliers):
            found.append(
                Outlier(
                    bpm=rows[i], corrector=columns[j], residual_m_per_rad=float(residual[i, j]),
                    sigmas=float(abs(residual[i, j]) / noise.sigma[i, j]),
                )
            )  # fmt: skip
    return tuple(found)
