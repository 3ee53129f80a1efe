"""A LOCO-like fit: gains of BPMs, of correctors, and gradients, by χ² of the one-step residual.

After J. Safranek, Nucl. Instrum. Meth. A 388 (1997) 27, on the log instead of a measured response:
rows, columns and quadrupoles are all that it knows, and white errors all that it believes in.
"""

from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.blind.rivals.residual import read


def diagnose(path: Path, *, ring: tuple[Path, Path] | None = None) -> dict[str, Any]:
    """Name the row, column or quadrupole that lowers χ² most."""
    record = read(path, ring)
    bpms, correctors = record.arrays["bpm_names"], record.arrays["corr_names"]
    found = [
        ("bpm-gain", "sensor", record.row_gains(), bpms),
        ("corrector-gain", "actuator", record.column_gains(), correctors),
    ]
    if record.ring is not None:
        quads = np.array(record.ring.names("QUAD"))
        found.append(("quadrupole-gradient", "optics", record.quadrupole_gains(), quads))
    best = [float(gains.max()) for _, _, gains, _ in found]
    candidates = sum(len(gains) for _, _, gains, _ in found)
    first = int(np.argmax(best))
    # One in a thousand records of pure noise: χ² of one parameter, as many tries as candidates.
    if best[first] < np.log(candidates) + np.log(1000):
        return {"state": "no_gap", "causes": []}
    share = np.exp(np.array(best) - best[first])
    effect, stage, gains, names = found[first]
    cause = {
        "effect": effect,
        "stage": stage,
        "places": [str(names[int(np.argmax(gains))])],
        "parameters": {},
        "probability": float(share[first] / share.sum()),
        "alternatives": [],
        "held_out_nats": best[first],
    }
    rows = [{"effect": f[0], "nats": gain} for f, gain in zip(found, best, strict=True)]
    return {"state": "named", "causes": [cause], "tournament": {"rows": rows}}
