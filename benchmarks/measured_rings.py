"""Fit public measured responses of real rings: `python -m benchmarks.measured_rings FOLDER`.

The folder holds `.mat` files of LOCO with their lattice, such as those of atcollab/MML
(`LOCO_*.mat`, `locoset.mat`), and may hold a folder with the files of PETRA III of
elafmusa/pyLOCO. Needs accelerator-toolbox for the optics of the lattices. One JSON is printed: per
file residuals x / y, χ², gains beside the laboratory's own fit, devices named, and seconds.
"""

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.measured_files import PETRA_LEFT_OUT, MeasuredRing, read
from orbitfb.core.errors import OrbitFeedbackError
from orbitfb.core.robust import TO_SIGMA
from orbitfb.loco.growth import growths
from orbitfb.loco.measured import Measured, bpm_labels, corrector_labels
from orbitfb.loco.named import Named
from orbitfb.loco.run import Result, diagnose
from orbitfb.physics.places import Plane

_SAME = 0.3
"""Share of a deviation by which the laboratory's may differ, of the same device [1]."""


def fitted(its: MeasuredRing, checks: bool) -> dict[str, Any]:
    """Fit one response.

    Args:
        its: The response.
        checks: Whether to fit every other corrector and the rest, too, and the fit itself with
            noise anew.
    """
    begin = time.process_time()
    found = diagnose(its.ring, its.measured)
    seconds = time.process_time() - begin
    answer: dict[str, Any] = {
        "cpu_seconds": round(seconds, 1),
        "steps": found.fit.steps,
        "converged": found.fit.converged,
        "chi2": round(chi2(its, found), 3),
    }
    for plane in found.mended.planes:
        answer[plane] = _plane(its, found, plane)
    if checks:
        for plane, apart in _halves(its).items():
            answer[plane]["gain_scatter_of_halves"] = round(apart, 6)
        answer["named_of_resimulated_only"] = _resimulated(its, found)
    if "gradient" in its.laboratory:
        mine, theirs = found.fit.part("gradient"), its.laboratory["gradient"]
        both = np.isfinite(theirs)
        answer["gradient_correlation"] = round(
            float(np.corrcoef(mine[both], theirs[both])[0, 1]), 3
        )
    answer["growth"] = {
        one.planes: round(one.per_tick or 0.0, 4)
        for one in growths(its.ring, its.measured, found.nominal)
    }
    answer["gains_named_as_the_laboratory"] = _as_the_laboratory(its, found)
    answer["named"] = [_told(its, one) for one in found.named if one.stands_out]
    answer["nearly"] = [_told(its, one) for one in found.named if not one.stands_out]
    return answer


def chi2(its: MeasuredRing, found: Result) -> float:
    """χ² per value that counts, by the noise of one reading as laboratories weigh it."""
    squares, count = 0.0, 0
    for plane in found.mended.planes:
        kept = found.fit.noise[plane].kept
        left = found.fit.residual[plane] * its.kick[plane] / its.noise[plane][:, None]
        squares += float(np.sum(left[kept] ** 2))
        count += int(kept.sum())
    return squares / max(count, 1)


def _plane(its: MeasuredRing, found: Result, plane: Plane) -> dict[str, Any]:
    kick, noise = its.kick[plane], found.fit.noise[plane]
    left = (found.fit.residual[plane] * kick)[noise.kept]
    answer: dict[str, Any] = {name: round(v, 5) for name, v in found.ladder[plane].items()}
    gain = found.estimates[f"gain:{plane}"]
    answer |= {
        "um_rms": round(1e6 * float(np.sqrt(np.mean(left**2))), 3),
        "noise_um": round(1e6 * np.sqrt(2) * float(np.median(its.noise[plane])), 3),
        "outliers": int(noise.outliers.sum()),
        "tune": round(found.optics.tune(plane, found.fit.part("gradient")), 5),
        "tune_table": round(its.ring.tune(plane), 5),
        "gain_sigma": round(float(np.median(gain.sigma)), 6),
        "gain_spread": round(gain.spread, 5),
    }
    for group in ("gain", "calibration"):
        own = found.estimates[f"{group}:{plane}"].value + (group == "gain")
        theirs = its.laboratory[f"{group}:{plane}"]
        counts = noise.kept.any(axis=1 if group == "gain" else 0)
        both = np.isfinite(theirs) & counts & (np.abs(theirs) > 0.0)
        own, theirs = own[both], theirs[both]
        apart = theirs / np.median(theirs / own) - own
        answer[f"{group}_correlation"] = round(float(np.corrcoef(own, theirs)[0, 1]), 4)
        answer[f"{group}_mad"] = round(TO_SIGMA * float(np.median(np.abs(apart))), 5)
        answer[f"{group}_worst"] = round(float(np.max(np.abs(apart))), 5)
    return answer


def _as_the_laboratory(its: MeasuredRing, found: Result) -> str:
    """Count gains and calibrations that are named and that the laboratory's fit has, too."""
    same, known = 0, 0
    for group in ("gain", "calibration"):
        for plane in found.mended.planes:
            own = found.estimates[f"{group}:{plane}"]
            theirs = its.laboratory[f"{group}:{plane}"]
            value = own.value + (group == "gain")
            usual = np.isfinite(theirs) & (own.family == 0) & ~own.free
            there = own.free & np.isfinite(theirs)
            there &= found.fit.noise[plane].kept.any(axis=1 if group == "gain" else 0)
            apart = (value / np.median(value[usual]) - 1.0)[there]
            lab = (theirs / np.median(theirs[usual]) - 1.0)[there]
            known += int(there.sum())
            same += int((np.abs(lab - apart) < _SAME * np.abs(apart)).sum())
    return f"{same} of {known}"


def _halves(its: MeasuredRing) -> dict[Plane, float]:
    """Fit odd and even correctors each alone: scatter of the gains of one such fit [1]."""
    found = [diagnose(its.ring, _every_other(its.measured, first)) for first in (0, 1)]
    apart: dict[Plane, float] = {}
    for plane in its.measured.planes:
        one, other = (1.0 + half.estimates[f"gain:{plane}"].value for half in found)
        difference = one - other * np.median(one / other)
        apart[plane] = TO_SIGMA * float(np.median(np.abs(difference))) / np.sqrt(2.0)
    return apart


def _resimulated(its: MeasuredRing, found: Result) -> list[str]:
    """Diagnose the fitted response with noise anew; what is named there and not before is false."""
    rng = np.random.default_rng(1)
    response = {
        (p, p): np.where(
            found.fit.noise[p].kept,
            found.fit.model[p] + found.fit.noise[p].sigma * rng.standard_normal(model.shape),
            np.nan,
        )
        for p, model in found.fit.model.items()
    }
    sigma = {(p, p): noise.sigma for p, noise in found.fit.noise.items()}
    again = diagnose(its.ring, replace(its.measured, response=response, sigma=sigma))
    before = {place for one in found.named for place in one.places}
    return [
        _told(its, one) for one in again.named if one.stands_out and not set(one.places) <= before
    ]


def _every_other(measured: Measured, first: int) -> Measured:
    some = {p: slice(first, None, 2) for p in measured.planes}
    return replace(
        measured,
        correctors={p: measured.correctors[p][some[p]] for p in measured.planes},
        response={(p, p): measured.response[p, p][:, some[p]] for p in measured.planes},
        sigma={(p, p): measured.sigma[p, p][:, some[p]] for p in measured.planes},
    )


def _told(its: MeasuredRing, one: Named) -> str:
    """Tell a device with its number in the file, from 1."""
    numbers: list[str] = []
    for place in one.places:
        plane = place.rpartition(":")[2]
        for labels, what in ((bpm_labels, "BPM"), (corrector_labels, "corrector")):
            known = labels(its.measured, its.ring, plane) if plane in ("x", "y") else ()
            numbers += [f"{what} #{i + 1} {plane}" for i, n in enumerate(known) if n == place]
    where = ", ".join(numbers) or ", ".join(one.places)
    return f"{one.kind} {where}: {one.value:+.3g} {one.unit} ({one.z:.1f} σ)"


def sets_of(folder: Path) -> dict[str, tuple[Path, tuple[int, ...]]]:
    """Find the responses of a folder: path, and BPMs that are left out."""
    found: dict[str, tuple[Path, tuple[int, ...]]] = {
        path.stem: (path, ()) for path in sorted(folder.glob("*.mat"))
    }
    for path in sorted(folder.glob("*/measurement_matlab.npy")):
        name = path.parent.name
        found[f"{name}, {246 - len(PETRA_LEFT_OUT)} BPMs"] = (path.parent, PETRA_LEFT_OUT)
        found[f"{name}, all BPMs"] = (path.parent, ())
    return found


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", default="", help="Part of the names of the sets to fit.")
    parser.add_argument(
        "--checks", action="store_true", help="Fit halves, and the fit with noise anew, too."
    )
    parser.add_argument("--out", type=Path, help="File for the JSON.")
    given = parser.parse_args()
    answers: dict[str, Any] = {}
    for name, (path, left_out) in sets_of(given.folder).items():
        if given.only not in name:
            continue
        try:
            answers[name] = fitted(read(path, left_out), given.checks)
        except (OrbitFeedbackError, KeyError, AttributeError, ValueError, TypeError) as error:
            answers[name] = {"not_fitted": f"{type(error).__name__}: {error}"[:300]}
    text = json.dumps(answers, indent=1, ensure_ascii=False)
    print(text)
    if given.out:
        given.out.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
