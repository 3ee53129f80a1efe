"""How the result of a fit becomes an answer: state, headline, tables."""

from collections.abc import Sequence

import numpy as np

from orbitfb.loco.estimates import GAUGE
from orbitfb.loco.named import Named
from orbitfb.loco.output.correlations import correlations
from orbitfb.loco.output.devices import kicks, outliers, quadrupoles, readings, skews
from orbitfb.loco.parameters import BELIEVED
from orbitfb.loco.run import Result
from orbitfb.loco.schema import (
    SCHEMA_VERSION,
    Alternative,
    Block,
    Finding,
    Growth,
    Optics,
    ResponseDiagnosis,
    State,
)
from orbitfb.physics.places import Plane

_LEFT = 3.0
"""Times the known noise from which what a fit leaves is more than noise [1]."""

_EVERYWHERE = 0.02
"""Relative residual from which the table is wrong everywhere, less what is named [1]."""


def answer_of(
    result: Result, source: str, notes: Sequence[str], growth: Sequence[Growth]
) -> ResponseDiagnosis:
    """Make the answer.

    Args:
        result: What came of the fit.
        source: Name of the file.
        notes: What was said while it was read.
        growth: Of the loop on it.
    """
    state, headline = verdict(result)
    estimates = result.estimates
    return ResponseDiagnosis(
        schema_version=SCHEMA_VERSION,
        source=source,
        state=state,
        headline=headline,
        notes=(*notes, *_overstated(result)),
        gauge=GAUGE,
        findings=tuple(_finding(its) for its in result.named),
        healthy_spread={name: its.spread for name, its in estimates.items()},
        sigma_widened={name: its.widened for name, its in estimates.items()},
        blocks=_blocks(result),
        optics=tuple(_optics(result, plane) for plane in result.mended.planes),
        growth=tuple(growth),
        steps=result.fit.steps,
        converged=result.fit.converged,
        bpms=readings(result),
        correctors=kicks(result),
        quadrupoles=quadrupoles(result),
        skews=skews(result),
        outliers=outliers(result),
        correlations=correlations(result),
    )


def verdict(result: Result) -> tuple[State, str]:
    """Judge: what is named, and whether the table is wrong everywhere."""
    named = [its for its in result.named if its.stands_out]
    largest = max(its["raw"] for its in result.ladder.values())
    left = max(its["without_outliers"] for its in result.ladder.values())
    # what stands out of the rest as it is after the named devices are taken at their word
    everywhere = max(its["raw_without_named"] for its in result.ladder.values())
    wide = (
        f" In addition, the whole response is off by {100 * everywhere:.2g} %: use this fit, "
        f"which leaves {100 * left:.2g} %."
        if everywhere > _EVERYWHERE
        else f" The fit leaves {100 * left:.2g} % of the response."
    )
    if named:
        rest = len(named) - 1
        more = f" {rest} more {'stand' if rest > 1 else 'stands'} out." if rest else ""
        ambiguous = any(its.alternatives for its in named) and named[0].alternatives
        return ("ambiguous" if ambiguous else "named", f"{named[0].text}{more}{wide}")
    beyond = [plane for plane in result.mended.planes if _known_excess(result, plane) > _LEFT**2]
    if beyond:
        return "unknown", (
            "No device stands out of the healthy spread, but in plane "
            f"{' and '.join(beyond)} the fit leaves more than {_LEFT:.0f} times the noise." + wide
        )
    return "no_gap", (
        f"No device stands out of the healthy spread; the response differs by {100 * largest:.2g} %"
        f" from the table.{wide}"
    )


def _overstated(result: Result) -> tuple[str, ...]:
    """Say where the stated noise is larger than what the data show."""
    found: list[str] = []
    for plane in result.mended.planes:
        stated = result.mended.sigma[plane, plane]
        ratio = np.where(
            result.fit.noise[plane].kept, stated / result.fit.noise[plane].sigma, np.nan
        )
        if np.isfinite(ratio).any() and float(np.nanmedian(ratio)) > 1.0 / BELIEVED:
            found.append(
                f"plane {plane}: the stated noise is {np.nanmedian(ratio):.2g} times what the fit "
                "leaves; it is not used"
            )
    return tuple(found)


def _known_excess(result: Result, plane: Plane) -> float:
    sigma = result.mended.sigma[plane, plane]
    kept = result.fit.noise[plane].kept & np.isfinite(sigma) & (sigma > 0)
    if not kept.any():
        return 0.0
    return float(np.mean((result.fit.residual[plane][kept] / sigma[kept]) ** 2))


def _finding(its: Named) -> Finding:
    return Finding(
        named=its.stands_out,
        kind=its.kind,
        places=its.places,
        value=its.value,
        sigma=its.sigma,
        unit=its.unit,
        z=its.z,
        probability=its.probability,
        alternatives=tuple(Alternative(place=n, probability=p) for n, p in its.alternatives),
        text=its.text,
    )


def _blocks(result: Result) -> tuple[Block, ...]:
    found: list[Block] = []
    for plane in result.mended.planes:
        its, noise = result.ladder[plane], result.fit.noise[plane]
        known = result.mended.sigma[plane, plane]
        sigma = np.where(np.isfinite(known) & (known > 0), known, noise.sigma)
        kept = noise.kept
        model = result.nominal[plane]
        before = (result.mended.response[plane, plane] - model)[kept] / sigma[kept]
        after = result.fit.residual[plane][kept] / sigma[kept]
        found.append(
            Block(
                read=plane, driven=plane, bpms=kept.shape[0], correctors=kept.shape[1],
                raw=its["raw"], scale=its["scale"], gains=its["gains"], optics=its["optics"],
                noise=its["noise"], noise_known=bool(np.isfinite(known).any()),
                chi2_before=float(np.mean(before**2)), chi2_after=float(np.mean(after**2)),
                outliers=int(noise.outliers.sum()),
            )
        )  # fmt: skip
    if result.coupling is None:
        return tuple(found)
    for (read, driven), residual in result.coupling.residual.items():
        noise = result.coupling.noise[read, driven]
        data = residual + result.coupling.model[read, driven]
        kept, size = noise.kept, float(np.linalg.norm(data)) or 1.0
        found.append(
            Block(
                read=read, driven=driven, bpms=kept.shape[0], correctors=kept.shape[1],
                raw=1.0, scale=None, gains=None,
                optics=float(np.linalg.norm(residual[kept])) / size,
                noise=float(np.linalg.norm(noise.sigma[kept])) / size,
                noise_known=bool(np.isfinite(result.mended.sigma[read, driven]).any()),
                chi2_before=float(np.mean((data[kept] / noise.sigma[kept]) ** 2)),
                chi2_after=float(np.mean((residual[kept] / noise.sigma[kept]) ** 2)),
                outliers=int(noise.outliers.sum()),
            )
        )  # fmt: skip
    return tuple(found)


def _optics(result: Result, plane: Plane) -> Optics:
    relative = result.fit.part("gradient")
    places = result.mended.bpms[plane]
    beat = result.optics.beta_beat(plane, relative, places)
    change = result.fit.optics[plane].dispersion - result.ring.table.dispersion[places]
    return Optics(
        plane=plane,
        tune_table=result.ring.tune(plane),
        tune_fit=result.optics.tune(plane, relative),
        beta_beat_rms=float(np.sqrt(np.mean(beat**2))),
        dispersion_change_rms_m=float(np.sqrt(np.mean(change**2))) if plane == "x" else None,
        scale=float(np.median(result.estimates[f"calibration:{plane}"].value)),
    )
