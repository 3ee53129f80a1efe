"""The loop that one writes first: read the BPMs, multiply by the pseudo-inverse, put.

    python -m tests.chaos.naive RATE_HZ

It monitors the BPMs and puts what comes out, as beside-the-control-room scripts do: no look at
stamps, alarms, limits, readbacks or the current. EPICS_CA_… say where the ring is.
"""

import sys
import time

import epics
import numpy as np

from orbitfb.physics.places import Ring
from orbitfb.physics.response import response

GAIN = 0.5
CUT = 1e-2
"""Least singular value that is inverted, as part of the largest."""
MILLIMETRE = 1e-3


def main() -> None:
    """Correct the orbit until told to stop."""
    period = 1.0 / float(sys.argv[1])
    ring = Ring.load()
    channels = ring.channels("x")
    inverse = np.linalg.pinv(response(ring, "x"), rcond=CUT)
    bpms = [epics.PV(name, auto_monitor=True) for name in channels.orbit_pvs]
    correctors = [epics.PV(name, auto_monitor=False) for name in channels.setpoint_pvs]
    for pv in (*bpms, *correctors):
        pv.wait_for_connection(10.0)
    setpoints = np.array([pv.get() for pv in correctors], dtype=float)
    print("running", flush=True)
    while True:
        orbit = np.array([pv.get() for pv in bpms], dtype=float) * MILLIMETRE
        setpoints -= GAIN * inverse @ orbit
        for pv, value in zip(correctors, setpoints, strict=True):
            pv.put(value)
        time.sleep(period)


if __name__ == "__main__":
    main()
