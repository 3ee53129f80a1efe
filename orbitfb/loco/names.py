"""Which devices stand out of the healthy spread, as what, and how sure that is."""

import numpy as np

from orbitfb.core.robust import TO_SIGMA
from orbitfb.loco.coupling import Coupling
from orbitfb.loco.estimates import Estimate
from orbitfb.loco.families import as_families
from orbitfb.loco.fit import PlaneFit
from orbitfb.loco.measured import Measured, bpm_labels, corrector_labels
from orbitfb.loco.named import Named
from orbitfb.loco.noise import spreads
from orbitfb.loco.parameters import LEAST_SPREAD, STANDS_OUT, Fit
from orbitfb.loco.posterior import WIDE, posterior
from orbitfb.loco.together import as_turns, in_order, rows_together, without_echoes
from orbitfb.measure.screen import DEAD
from orbitfb.physics.places import Indices, Plane, Ring, plane_row

_LIKELY = 3.0
"""Natural logarithm of the odds by which a neighbour is left out of a class."""

_SHAPE = 4.0
"""Times the median of what a fit leaves of a row, from which the row has another shape [1]."""

_POLARITY = 0.3
"""How near to −1 a gain is that of two cables exchanged [1]; else it is a negative gain."""

_WATCHED = 4.0
"""Standard deviations from which a gain or calibration is told beside the answer, as what to look
at next; of 1000 healthy ones 0.06 are there by chance."""


def name_devices(
    ring: Ring,
    measured: Measured,
    fitting: PlaneFit,
    fit: Fit,
    coupling: Coupling | None,
    found: dict[str, Estimate],
) -> list[Named]:
    """Name what stands out, the surest first.

    Args:
        ring: The ring.
        measured: What was fitted.
        fitting: What made the fit.
        fit: In the planes.
        coupling: Of the cross blocks.
        found: Values of all groups.
    """
    named: list[Named] = []
    for plane in measured.planes:
        rows = bpm_labels(measured, ring, plane)
        columns = corrector_labels(measured, ring, plane)
        gain, kick = found[f"gain:{plane}"], found[f"calibration:{plane}"]
        named += as_families(_gains(gain, rows), _labels(gain), gain.spread)
        named += as_families(_calibrations(kick, columns), _labels(kick), kick.spread)
        named += _phases(ring, measured, plane, found)
        named += _shapes(fit, plane, rows, columns)
        if coupling is not None:
            named += _turned(found[f"roll:{plane}"], rows, "bpm-roll", plane)
            named += _turned(found[f"tilt:{plane}"], columns, "corrector-roll", plane)
    quadrupoles = ring.names("QUAD")
    named += _gradients(fit, quadrupoles, found["gradient"])
    if coupling is not None:
        named += _skews(found["skew"], quadrupoles, ring.names("SEXT"))
    return in_order(rows_together(as_turns(without_echoes(named))))


def sure(z: float, spread: float, sigma: float, places: int) -> float:
    """Probability that a device stands out and not by chance, of so many places.

    The evidence of a free size of variance `WIDE` over the healthy spread, less ln(places).
    """
    narrow = spread**2 + sigma**2
    nats = 0.5 * z**2 - 0.5 * np.log(max((WIDE + sigma**2) / narrow, 1.0)) - np.log(max(places, 1))
    return float(min(0.999, 1.0 / (1.0 + np.exp(-np.clip(nats, -50.0, 50.0)))))


def _looked_at(its: Estimate) -> Indices:
    """Gains or calibrations that stand out, or nearly do."""
    return np.flatnonzero(its.free | (its.z > _WATCHED))


def _labels(its: Estimate) -> list[int]:
    return its.family[_looked_at(its)].tolist()


def _gains(its: Estimate, labels: tuple[str, ...]) -> list[Named]:
    found: list[Named] = []
    for row in _looked_at(its):
        gain, sigma, z = 1.0 + float(its.value[row]), float(its.sigma[row]), float(its.z[row])
        kind, how = "bpm-gain", f"reads {gain:.3g} times what it should"
        if abs(gain + 1.0) < _POLARITY:
            kind, how = "bpm-polarity", f"reads with the opposite sign (gain {gain:.3g})"
        elif abs(gain) < DEAD:
            kind, how = "bpm-dead", f"is dead: it reads {gain:.2g} times what it should"
        text = f"BPM {labels[row]} {how}; the others scatter by {100 * its.spread:.2g} %."
        p = sure(z, its.spread, sigma, len(labels))
        found.append(Named(kind, (labels[row],), gain - 1.0, sigma, "1", z, p, text))
    return found


def _calibrations(its: Estimate, labels: tuple[str, ...]) -> list[Named]:
    usual = float(np.median(its.value[its.family == 0]))
    found: list[Named] = []
    for column in _looked_at(its):
        kick = float(its.value[column] / usual)
        sigma, z = float(its.sigma[column] / abs(usual)), float(its.z[column])
        kind, how = "corrector-gain", f"kicks {kick:.3g} times what the others of its plane do"
        if abs(kick + 1.0) < _POLARITY:
            kind, how = "corrector-polarity", f"kicks with the opposite sign ({kick:.3g})"
        elif abs(kick) < DEAD:
            kind, how = "corrector-dead", f"is dead: it kicks {kick:.2g} times what the others do"
        text = (
            f"Corrector {labels[column]} {how}, against the table; the others scatter by "
            f"{100 * its.spread:.2g} %."
        )
        p = sure(z, its.spread, sigma, len(labels))
        found.append(Named(kind, (labels[column],), kick - 1.0, sigma, "1", z, p, text))
    return found


def _phases(
    ring: Ring, measured: Measured, plane: Plane, estimates: dict[str, Estimate]
) -> list[Named]:
    found: list[Named] = []
    for group, kind, what, places, labels in (
        ("row-phase", "bpm-row", "row of BPM", measured.bpms[plane],
         bpm_labels(measured, ring, plane)),
        ("column-phase", "corrector-column", "column of corrector", measured.correctors[plane],
         corrector_labels(measured, ring, plane)),
    ):  # fmt: skip
        its = estimates[f"{group}:{plane}"]
        for number in np.flatnonzero(its.free):
            phase, z = float(its.value[number]), float(its.z[number])
            apart = phase * float(ring.table.beta[plane_row(plane), places[number]])
            text = (
                f"The {what} {labels[number]} is not of this lattice: its betatron phase is "
                f"{1e3 * phase:+.3g} mrad off, as if it stood {abs(apart):.2g} m "
                f"{'downstream' if apart > 0 else 'upstream'}."
            )
            sigma = float(its.sigma[number])
            p = sure(z, its.spread, sigma, len(labels))
            found.append(Named(kind, (labels[number],), phase, sigma, "rad", z, p, text))
    return found


def _shapes(fit: Fit, plane: Plane, rows: tuple[str, ...], columns: tuple[str, ...]) -> list[Named]:
    """Rows and columns that the fit leaves far more of than of others."""
    found: list[Named] = []
    noise = fit.noise[plane]
    s, t = spreads(fit.residual[plane], noise.kept | noise.outliers)
    size = np.sqrt(np.nanmean(np.where(noise.kept, fit.model[plane], np.nan) ** 2))
    for left, labels, kind, what in (
        (s, rows, "bpm-row", "row of BPM"),
        (t * np.nanmedian(s), columns, "corrector-column", "column of corrector"),
    ):
        usual = float(np.nanmedian(left))
        logs = np.log(left / usual)
        scatter = TO_SIGMA * float(np.nanmedian(np.abs(logs)))
        for number in np.flatnonzero(logs > max(np.log(_SHAPE), STANDS_OUT * scatter)):
            known = noise.rows[number] if kind == "bpm-row" else np.inf
            if kind == "bpm-row" and left[number] <= 1.5 * known and known > 3.1 * usual:
                continue  # it is known to be noisy
            text = (
                f"The {what} {labels[number]} is not of this lattice, in no structured way: the "
                f"fit leaves {left[number] / usual:.2g} times what it leaves of the others, "
                f"{100 * left[number] / size:.2g} % of a typical response."
            )
            z = float(logs[number] / max(scatter, 0.1))
            found.append(
                Named(kind, (labels[number],), float(left[number]), float("nan"), "m/rad", z,
                      float(min(0.999, 1.0 - np.exp(-z))), text)
            )  # fmt: skip
    return found


def _turned(its: Estimate, labels: tuple[str, ...], kind: str, plane: Plane) -> list[Named]:
    other = "y" if plane == "x" else "x"
    found: list[Named] = []
    for number in np.flatnonzero(its.free):
        value, sigma, z = float(its.value[number]), float(its.sigma[number]), float(its.z[number])
        text = (
            f"BPM {labels[number]} reads {value:+.3g} of {other} beside {plane}: a roll, a cable "
            "or a button."
            if kind == "bpm-roll"
            else f"Corrector {labels[number]} kicks {value:+.3g} rad of {other} per rad: a tilt."
        )
        p = sure(z, its.spread, sigma, len(labels))
        found.append(Named(kind, (labels[number],), value, sigma, "rad", z, p, text))
    return found


def _gradients(fit: Fit, labels: tuple[str, ...], its: Estimate) -> list[Named]:
    """Quadrupoles that stand out, with the neighbours that explain it nearly as well."""
    index = fit.groups.of["gradient"]
    if not len(index) or not its.free.any():
        return []
    # each in its turn against a healthy spread of all others that are not named
    found: list[Named] = []
    pull = fit.matrix @ fit.theta
    for number in np.flatnonzero(its.free):
        prior = fit.posterior.prior.copy()
        prior[index[number]] = max(its.spread, LEAST_SPREAD["gradient"]) ** 2
        value, variance = posterior(fit.matrix, pull, prior).by_data()
        z = np.abs(value[index]) / np.sqrt(prior[index] + variance[index])
        z[np.setdiff1d(np.flatnonzero(its.free), [number])] = 0.0
        weight = np.exp(0.5 * (z**2 - np.max(z**2)))
        chance = weight / weight.sum()
        best = int(np.argmax(chance))
        if z[best] < STANDS_OUT:
            continue
        sigma = float(its.sigma[best])
        p = sure(float(z[best]), its.spread, sigma, len(labels))
        near = [
            (labels[other], float(p * chance[other]))
            for other in np.argsort(-chance)[1:6]
            if 0.5 * (z[best] ** 2 - z[other] ** 2) < _LIKELY
        ]
        size = float(its.value[number]) if best == number else float(value[index[best]])
        text = (
            f"Quadrupole {labels[best]} has a gradient error of {100 * size:+.2g} %; the others "
            f"scatter by {100 * its.spread:.2g} %."
        )
        if near:
            text += f" {', '.join(name for name, _ in near)} would explain it as well."
        found.append(
            Named("quadrupole-gradient", (labels[best],), size, sigma, "1", float(z[best]),
                  float(p * chance[best]) if near else p, text, tuple(near))
        )  # fmt: skip
    return found


def _skews(its: Estimate, quadrupoles: tuple[str, ...], sextupoles: tuple[str, ...]) -> list[Named]:
    labels = quadrupoles + sextupoles
    found: list[Named] = []
    for number in np.flatnonzero(its.free):
        value, sigma, z = float(its.value[number]), float(its.sigma[number]), float(its.z[number])
        what = "Quadrupole" if number < len(quadrupoles) else "Sextupole"
        text = f"{what} {labels[number]} couples the planes: skew gradient {value:+.3g} 1/m."
        p = sure(z, its.spread, sigma, len(labels))
        found.append(Named("skew-coupling", (labels[number],), value, sigma, "1/m", z, p, text))
    return found
