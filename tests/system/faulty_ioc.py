"""The soft IOC of `orbitfb ioc` with faults that are switched on through its standard input.

    python faulty_ioc.py JOB.json

Each line on the standard input is a JSON object that replaces all faults: `bpms` maps indices to
`zero`, `nan`, `frozen`, `stamp` or an offset [m]; `correctors` maps indices to `stuck`, `off`,
`away` (the readback is not known) or an error of the readback [A]; `sign` is that of the response;
`shift` says by how many places the BPMs are exchanged; `current` is the stored current [mA], null:
not known; `current_old` keeps its stamp; `clock` is by how much its clock was set [s].
Everything else, the server and its PVs, is the
program's own. Prints the port.
"""

import json
import sys
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from orbitfb.core.names import CURRENT_PV
from orbitfb.sim import server
from orbitfb.sim.access.board import Board
from orbitfb.sim.access.stamp import Stamp, now
from orbitfb.sim.job import SimJob
from orbitfb.sim.process import run_job
from orbitfb.sim.server import RingServer


@dataclass
class Shown:
    """One tick, as it is shown."""

    reading: np.ndarray
    true_orbit: np.ndarray
    readback: np.ndarray


class FaultyRing:
    """A simulated ring whose devices fail as they are told."""

    def __init__(self, ring: Any) -> None:
        self._ring = ring
        self.faults: dict[str, Any] = {}
        self._since: dict[str, Any] = {}
        self._before: Shown | None = None
        self._held: dict[int, float] = {}

    def __getattr__(self, name: str) -> Any:
        return getattr(self._ring, name)

    def step(self, setpoints: np.ndarray, frequency_change: float = 0.0) -> Shown:
        faults, actual = self.faults, np.array(setpoints)
        readback_errors = {}
        for key, kind in faults.get("correctors", {}).items():
            index = int(key)
            if kind == "stuck":
                actual[index] = self._held.setdefault(index, actual[index])
            elif kind == "off":
                actual[index] = 0.0
            else:
                readback_errors[index] = np.nan if kind == "away" else float(kind)
        for index in [i for i in self._held if str(i) not in faults.get("correctors", {})]:
            del self._held[index]
        state = self._ring.step(faults.get("sign", 1.0) * actual, frequency_change)
        reading = np.roll(state.reading, faults.get("shift", 0))
        for key, kind in faults.get("bpms", {}).items():
            index = int(key)
            if kind == "zero":
                reading[index] = 0.0
            elif kind == "nan":
                reading[index] = np.nan
            elif kind == "frozen" and self._before is not None:
                reading[index] = self._before.reading[index]
            elif isinstance(kind, float):
                reading[index] += kind
        readback = faults.get("sign", 1.0) * state.readback
        for index, error in readback_errors.items():
            readback[index] += error
        self._before = Shown(reading, state.true_orbit, readback)
        return self._before


def main() -> None:
    """Serve the job named on the command line."""
    job = SimJob.model_validate_json(Path(sys.argv[1]).read_text())
    ring, settings = job.build()
    faulty = FaultyRing(ring)
    show, tick = Board.show, RingServer.tick
    first = len(ring.channels.readback_pvs)  # of the readings, the readbacks come first

    def stamped(board: Board, values: np.ndarray, stamp: Any) -> None:
        bpms = faulty.faults.get("bpms", {})
        late = [first + int(key) for key, kind in bpms.items() if kind == "stamp"]
        if faulty.faults.get("current_old"):
            late.append(board.names.index(CURRENT_PV))
        old = [(index, board.get(index)) for index in late]
        show(board, values, stamp)
        for index, entry in old:
            board.set(index, entry)

    def ticked(server: RingServer) -> None:
        if "current" in faulty.faults:
            known = faulty.faults["current"]
            server._stored = float("nan") if known is None else known
        tick(server)

    def wrong_now() -> Stamp:
        stamp = now()
        return Stamp(stamp.seconds + int(faulty.faults.get("clock", 0)), stamp.nanoseconds)

    def listen() -> None:
        for line in sys.stdin:
            faulty.faults = json.loads(line)

    Board.show, RingServer.tick = stamped, ticked
    server.now = wrong_now
    SimJob.build = lambda self: (faulty, settings)
    threading.Thread(target=listen, daemon=True).start()
    run_job(job, lambda served: print(served.port, flush=True))


if __name__ == "__main__":
    main()
