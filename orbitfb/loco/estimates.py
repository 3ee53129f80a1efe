"""Parameters of a fit as people read them: gauge stated, uncertainty as it is on real data."""

from dataclasses import dataclass

import numpy as np

from orbitfb.core.robust import TO_SIGMA
from orbitfb.core.signals import Mask, Vector
from orbitfb.loco.coupling import Coupling
from orbitfb.loco.families import families_of, middles
from orbitfb.loco.fit import PlaneFit
from orbitfb.loco.parameters import LEAST_SPREAD, STANDS_OUT, Fit, centred
from orbitfb.loco.posterior import spread_of
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices

GAUGE = (
    "In each plane the gains of the BPMs that do not stand out are 1 on average; the common "
    "factor of gains and calibrations is in the calibrations."
)


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """Values of a group.

    Args:
        value: Shape (k,); deviations from what the table says, but calibrations are whole.
        sigma: Standard deviations, shape (k,), widened by what halves of the data differ.
        z: How far each stands out of the healthy spread, shape (k,).
        free: Those that stand out, shape (k,).
        spread: Healthy spread of the group, within its families.
        widened: By how much the halves differ more than the noise says [1], at least 1.
        family: Family of each that is in another than the largest, else 0, shape (k,).
    """

    value: Vector
    sigma: Vector
    z: Vector
    free: Mask
    spread: float
    widened: float
    family: Indices


def estimates(fitting: PlaneFit, fit: Fit, coupling: Coupling | None) -> dict[str, Estimate]:
    """Give all groups: `gain:x`, `calibration:x`, `row-phase:x`, `gradient`, `roll:x`, `skew`, ….

    Args:
        fitting: What made the fit.
        fit: In the planes.
        coupling: Of the cross blocks, if there are any.
    """
    by_column, by_row = fitting.halves(fit, True), fitting.halves(fit, False)
    found: dict[str, Estimate] = {}
    usual: dict[str, Indices] = {}
    for name, index in fit.groups.of.items():
        kind, _, plane = name.partition(":")
        if kind in ("scale", "rf"):
            continue
        z, free, spread, family = _standing(fit, name)
        if kind == "gain":
            usual[plane] = index[~free]
        form, offset = contrast(fit, name, usual)
        spread_out = form @ fit.posterior.covariance
        sigma = np.sqrt(np.einsum("ij,ij->i", spread_out, form))
        halves = by_row if kind in ("calibration", "column-phase", "energy") else by_column
        apart = form @ (halves[0] - halves[1])
        widened = max(1.0, _typical(apart) / (2.0 * max(float(np.median(sigma)), 1e-300)))
        found[name] = Estimate(
            form @ fit.theta + offset, sigma * widened, z, free, spread, widened, family
        )
    if coupling is not None:
        for name, index in coupling.groups.of.items():
            z = coupling.posterior.standing(index, coupling.spread[name], False)
            found[name] = Estimate(
                coupling.part(name), coupling.posterior.sigma[index], z, coupling.free[index],
                coupling.spread[name], 1.0, np.zeros(len(index), dtype=np.intp),
            )  # fmt: skip
    return found


def _typical(values: Vector) -> float:
    return TO_SIGMA * float(np.median(np.abs(values - np.median(values)))) if len(values) else 0.0


def _standing(fit: Fit, name: str) -> tuple[Vector, Mask, float, Indices]:
    """How far each of a group stands out, whether it does, the healthy spread, and its family."""
    index, kind = fit.groups.of[name], name.split(":")[0]
    family = np.zeros(len(index), dtype=np.intp)
    if kind not in ("gain", "calibration"):
        z = fit.posterior.standing(index, fit.spread[name], centred(name))
        return z, fit.free[index], fit.spread[name], family
    value, variance = (its[index] for its in fit.posterior.by_data())
    label = families_of(value, LEAST_SPREAD[kind])
    middle = middles(value, label)
    apart = value - middle
    spread = spread_of(apart, variance, LEAST_SPREAD[kind])
    sigma = np.sqrt(spread**2 + variance)
    z = np.abs(apart) / sigma
    family = np.where(z > STANDS_OUT, 0, label)  # one far off is a device and not a family
    typical = float(np.median(sigma))  # a family stands out as a whole, or does not
    others = np.abs(middle - np.median(value[label == 0])) / typical
    z = np.where(family > 0, others, z)
    return z, z > STANDS_OUT, spread, family


def contrast(fit: Fit, name: str, usual: dict[str, Indices]) -> tuple[Matrix, Vector]:
    """Give the linear form of the parameters that a group is told by, and what is added.

    Args:
        fit: The fit.
        name: Of the group.
        usual: Of every plane the gains that are 1 on average.
    """
    kind, _, plane = name.partition(":")
    index = fit.groups.of[name]
    form = np.zeros((len(index), fit.groups.size))
    form[np.arange(len(index)), index] = 1.0
    if kind not in ("gain", "calibration"):
        return form, np.zeros(len(index))
    healthy = usual[plane]
    mean = float(np.mean(fit.theta[healthy])) if len(healthy) else 0.0
    share = 1.0 / max(len(healthy), 1)
    if kind == "gain":
        form /= 1.0 + mean
        form[:, healthy] -= share / (1.0 + mean)
        # (1 + g)/(1 + mean) − 1 at the fitted values is this form at the fitted values
        return form, np.zeros(len(index))
    form[:, fit.groups.of[f"scale:{plane}"]] = 1.0
    form *= 1.0 + mean
    kick = 1.0 + fit.part(f"scale:{plane}") + fit.theta[index]
    form[:, healthy] += np.outer(kick, np.full(len(healthy), share))
    # the value is c (1 + mean); the form is its slope
    return form, kick * (1.0 + mean) - form @ fit.theta
