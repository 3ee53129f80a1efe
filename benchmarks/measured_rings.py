"""Fit LOCO files of real rings: `python -m benchmarks.measured_rings FOLDER`.

The folder holds `.mat` files of LOCO with their lattice, such as those of atcollab/MML
(`LOCO_*.mat`, `locoset.mat`). Needs accelerator-toolbox for the optics of the lattices. One JSON is
printed: per file residuals x / y, correlation of gains with the laboratory's own fit, devices
named, seconds.
"""

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.measured_lattice import read
from orbitfb.core.errors import OrbitFeedbackError
from orbitfb.core.robust import TO_SIGMA
from orbitfb.loco.growth import growths
from orbitfb.loco.run import diagnose


def fitted(path: Path) -> dict[str, Any]:
    """Fit one file."""
    its = read(path)
    begin = time.process_time()
    found = diagnose(its.ring, its.measured)
    seconds = time.process_time() - begin
    answer: dict[str, Any] = {"cpu_seconds": round(seconds, 1), "steps": found.fit.steps}
    for plane in found.mended.planes:
        kick, noise = its.kick[plane], found.fit.noise[plane]
        left = (found.fit.residual[plane] * kick)[noise.kept]
        answer[plane] = {name: round(value, 5) for name, value in found.ladder[plane].items()}
        answer[plane] |= {
            "um_rms": round(1e6 * float(np.sqrt(np.mean(left**2))), 3),
            "noise_um": round(1e6 * np.sqrt(2) * float(np.median(its.noise[plane])), 3),
            "outliers": int(noise.outliers.sum()),
            "tune": round(found.optics.tune(plane, found.fit.part("gradient")), 5),
        }
        for group in ("gain", "calibration"):
            own = found.estimates[f"{group}:{plane}"].value + (group == "gain")
            theirs = its.laboratory[f"{group}:{plane}"]
            factor = np.median(theirs / own)
            apart = np.median(np.abs(theirs / factor - own))
            answer[plane][f"{group}_correlation"] = round(float(np.corrcoef(own, theirs)[0, 1]), 4)
            answer[plane][f"{group}_mad"] = round(TO_SIGMA * float(apart), 5)
    answer["growth"] = {
        one.planes: one.per_tick for one in growths(its.ring, its.measured, found.nominal)
    }
    answer["named"] = [
        f"{one.kind} {','.join(one.places)} {one.value:+.3f} ({one.z:.1f} σ)" for one in found.named
    ]
    return answer


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path, help="File for the JSON.")
    given = parser.parse_args()
    answers: dict[str, Any] = {}
    for path in sorted(given.folder.glob("*.mat")):
        try:
            answers[path.name] = fitted(path)
        except (OrbitFeedbackError, KeyError, AttributeError, ValueError, TypeError) as error:
            answers[path.name] = {"not_fitted": f"{type(error).__name__}: {error}"[:300]}
    text = json.dumps(answers, indent=1, ensure_ascii=False)
    print(text)
    if given.out:
        given.out.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
