"""The soft IOC of `orbitfb ioc` with faults told on its standard input, which notes every put.

    python -m tests.chaos.ioc JOB.json JOURNAL LIFE LIMIT STEP

Each line of the standard input is a JSON object: `faults` replaces all of them, `restore` brings
the last good setpoints back, `move` and `by` are somebody's hand at a setpoint. Each is answered
by a line: tick, rms and peak of the true orbit [m]. Everything else, the server and its PVs, is
the program's own; faults and notes are hung on from outside. The first line is the port.
"""

import json
import struct
import sys
import threading
from pathlib import Path
from typing import Any

import numpy as np

from orbitfb.core.names import CURRENT_PV
from orbitfb.sim.access.board import INVALID, UNDEFINED, Board
from orbitfb.sim.access.channels import BoardSetpoint
from orbitfb.sim.access.circuit import FastCircuit, FastContext
from orbitfb.sim.access.stamp import Stamp
from orbitfb.sim.job import SimJob
from orbitfb.sim.process import run_job
from orbitfb.sim.served import Served
from orbitfb.sim.server import RingServer
from tests.chaos.devices import FaultyRing
from tests.chaos.journal import Journal
from tests.chaos.notes import Notes

DISCONNECTED = 27
"""Message of a server that lets go of a channel."""
WELL = 10e-6
"""Rms of an orbit whose setpoints are worth keeping [m]."""
APART = 1_500_000
"""By which a BPM that stamps itself is ahead of the others [ns]."""


class Desk:
    """Hangs faults and notes on the server."""

    def __init__(self, faulty: FaultyRing, notes: Notes, drive: float) -> None:
        self.faulty, self.notes, self.drive = faulty, notes, drive
        self.context: FastContext | None = None
        self.hands: list[dict[str, Any]] = []
        self._first = len(faulty.channels.readback_pvs)
        self._kept = np.zeros(len(faulty.channels.correctors))
        self._away: set[int] = set()
        self._silent = False

    def told(self, what: dict[str, Any]) -> dict[str, Any]:
        """Do what a line says."""
        if "faults" in what:
            self.faulty.faults = what["faults"]
        if "move" in what or "restore" in what:
            self.hands.append(what)
        orbit = self.faulty.last.true_orbit
        return {
            "tick": int(self.faulty.tick),
            "rms": float(np.sqrt(np.mean(orbit**2))),
            "peak": float(np.abs(orbit).max()),
        }

    def before_tick(self, server: RingServer) -> None:
        """Do by hand what was asked for; set the current."""
        front = server.front
        for what in [self.hands.pop() for _ in range(len(self.hands))]:
            if "move" in what:
                index = what["move"]
                value = float(np.clip(front.setpoints[index] + what["by"], -self.drive, self.drive))
                self.notes.moved(index)
                self._quietly(front, np.array([index]), np.array([value]))
            else:
                self._quietly(front, np.arange(len(self._kept)), self._kept)
        currents = [f["current"] for f in self.faulty.current_faults() if "current" in f]
        known = currents[0] if currents else 400.0
        server._stored = float("nan") if known is None else known

    def let_pass(self, server: RingServer) -> None:
        """Let time go by without telling anybody; behind the correctors the RF has its setpoint."""
        self.faulty.step(server.front.setpoints[: len(self._kept)])

    def after_tick(self, server: RingServer, shown: bool) -> None:
        """Note the orbit, and whether it was shown; keep the setpoints of a good one."""
        ring = self.faulty
        rms = float(np.sqrt(np.mean(ring.last.true_orbit**2)))
        if not ring.faults and rms < WELL:
            self._kept = server.front.setpoints[: len(self._kept)]
        self.notes.tick(int(ring.tick), ring.good and shown, ring.last.true_orbit, len(ring.faults))
        if ring.gone - self._away:
            self._let_go(ring.gone - self._away)
        self._away = set(ring.gone)

    def _quietly(self, front: Any, which: np.ndarray, values: np.ndarray) -> None:
        self._silent = True
        front.take(which, values)
        front.puts_taken()
        self._silent = False

    def is_away(self, name: str) -> bool:
        """Whether a channel is not to be found."""
        pvs = self.faulty.channels.orbit_pvs
        return any(pvs[index] == name for index in self._away)

    def is_lost(self, circuit: FastCircuit, command: Any) -> bool:
        """Whether a command is for a channel that is gone: nobody is there to answer.

        The server would not find it, and would answer nothing at all from then on.
        """
        channel = circuit.circuit.channels_sid.get(getattr(command, "sid", None))
        return channel is not None and self.is_away(channel.name)

    def _let_go(self, which: set[int]) -> None:
        """Tell every client that channels are gone."""
        names = {self.faulty.channels.orbit_pvs[index] for index in which}
        for circuit in list(self.context.circuits) if self.context else []:
            for sid, channel in list(circuit.circuit.channels_sid.items()):
                if channel.name in names:
                    message = struct.pack(">HHHHII", DISCONNECTED, 0, 0, 0, channel.cid, 0)
                    circuit.client.writer.transport.write(message)
                    circuit.feed.remove_channel(sid)

    def note_fast(self, board: Board, which: np.ndarray, values: np.ndarray) -> None:
        if not self._silent:
            before = board.setpoints[which].copy()
            if len(which) > len(before_last := dict.fromkeys(which.tolist())):  # several came late
                for row, (index, value) in enumerate(zip(which.tolist(), values, strict=True)):
                    if before_last[index] is not None:
                        before[row] = before_last[index]
                    before_last[index] = value
            self.notes.put(which, values, before, self.drive)

    def note_slow(self, channel: BoardSetpoint, value: Any) -> None:
        board = channel._board
        which = np.array([channel.index - board.readings])
        values = np.array(value, dtype=float).reshape(-1)[:1]
        self.notes.put(which, values, board.setpoints[which].copy(), self.drive)

    def show(self, board: Board, values: np.ndarray, stamp: Stamp, show: Any) -> None:
        """Show a tick on the board, with what is wrong with it."""
        orbit = self.faulty.orbit_fault() or {}
        by = {"old": -1.0, "ahead": 1.0}.get(orbit.get("orbit", ""), 0.0) * orbit.get("by", 0.0)
        faults = dict(self.faulty.board_faults)
        late = [self._first + index for index, told in faults.items() if told == "stamp"]
        if any("current_old" in fault for fault in self.faulty.current_faults()):
            late.append(board.names.index(CURRENT_PV))
        old = [(index, board.get(index)) for index in late]
        nanoseconds = round(by * 1e9) + stamp.seconds * 10**9 + stamp.nanoseconds
        show(board, values, Stamp(*divmod(nanoseconds, 10**9)))
        for index, entry in old:
            board.set(index, entry)
        for index, told in faults.items():
            if told == "invalid":
                entry = board.get(self._first + index)
                bad = entry._replace(status=UNDEFINED, severity=INVALID)
                board.set(self._first + index, bad)
            elif told == "apart":
                entry = board.get(self._first + index)
                ahead = Stamp(*divmod(nanoseconds + APART, 10**9))
                board.set(self._first + index, entry._replace(stamp=ahead))


def hang_on(desk: Desk) -> None:
    """Put the desk between the server and the world."""
    show, tick, write, allow = Board.show, RingServer.tick, Board.write, Board.allowed
    slow, find, begin = BoardSetpoint.write, FastContext.__getitem__, FastContext.__init__
    keep = FastCircuit._keep

    def ticked(server: RingServer) -> None:
        desk.before_tick(server)
        orbit = desk.faulty.orbit_fault()
        slow = bool(desk.faulty.tick % desk.faulty.slowness())
        if slow or (orbit and orbit["orbit"] == "silent"):
            desk.let_pass(server)
        else:
            tick(server)
        desk.after_tick(server, not slow)

    def written(board: Board, which: Any, values: Any, stamp: Stamp) -> None:
        desk.note_fast(board, which, values)
        write(board, which, values, stamp)

    def allowed(board: Board, which: Any, values: Any) -> Any:
        return allow(board, which, values) & ~np.isin(which, desk.faulty.refusing())

    async def written_slowly(channel: BoardSetpoint, value: Any, **options: Any) -> None:
        desk.note_slow(channel, value)
        if channel.index - channel._board.readings in desk.faulty.refusing():
            raise ValueError("puts are disabled")
        await slow(channel, value, **options)

    def found(context: FastContext, name: str) -> Any:
        if desk.is_away(name):
            raise KeyError(name)
        return find(context, name)

    async def kept(circuit: FastCircuit, command: Any) -> bool:
        return desk.is_lost(circuit, command) or await keep(circuit, command)

    def begun(context: FastContext, *arguments: Any) -> None:
        begin(context, *arguments)
        desk.context = context

    def shown(board: Board, values: Any, stamp: Stamp) -> None:
        desk.show(board, values, stamp, show)

    replace(Board, show=shown, write=written, allowed=allowed)
    replace(RingServer, tick=ticked)
    replace(BoardSetpoint, write=written_slowly)
    replace(FastContext, __getitem__=found, __init__=begun)
    replace(FastCircuit, _keep=kept)


def replace(kind: type, **methods: Any) -> None:
    """Put other methods into a class."""
    for name, method in methods.items():
        setattr(kind, name, method)


def main() -> None:
    """Serve the job named on the command line."""
    job = SimJob.model_validate_json(Path(sys.argv[1]).read_text())
    ring, settings = job.build()
    faulty = FaultyRing(ring)
    limit, step = float(sys.argv[4]), float(sys.argv[5])
    size = len(ring.channels.correctors)
    notes = Notes(Journal(Path(sys.argv[2])), int(sys.argv[3]), limit, step, size)
    desk = Desk(faulty, notes, settings.corrector_limit)
    hang_on(desk)
    replace(SimJob, build=lambda self: (faulty, settings))

    def listen() -> None:
        for line in sys.stdin:
            print(json.dumps(desk.told(json.loads(line))), flush=True)

    def announce(served: Served) -> None:
        print(served.port, flush=True)
        threading.Thread(target=listen, daemon=True).start()

    run_job(job, announce)


if __name__ == "__main__":
    main()
