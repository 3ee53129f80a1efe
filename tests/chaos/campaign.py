"""Do what the schedule says to both rings, and watch the service recover."""

import signal
import time
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

from tests.chaos.growth import Life
from tests.chaos.naive_side import Naive
from tests.chaos.ours import Ours, needs_hand
from tests.chaos.rings import DRIVE, LostError, Ring, wait
from tests.chaos.schedule import Episode, Fault, Lived

PATIENCE = 12.0
"""Time that the loop has to come back once everything is whole [s]."""
STARTING = 60.0
"""The same after a new start, in which the program is loaded and an old lease waited for [s]."""
SHORT = 0.6
"""Time without a word of its own after which an operator opens and closes [s]."""


class Campaign:
    """Two rings under the same faults, with the service at one and the plain loop at the other.

    Args:
        directory: For everything that is written.
        seed: Of the rings.
        rate: Of orbits and loops [Hz].
        say: Gets a line now and then.
        beside: Whether the plain loop runs too.
    """

    def __init__(
        self,
        directory: Path,
        seed: int,
        rate: float,
        say: Callable[[str], None] = lambda _: None,
        beside: bool = True,
    ) -> None:
        self._say, self._period = say, 1.0 / rate
        self.counts: Counter[str] = Counter()
        self.trouble: list[dict[str, Any]] = []
        self.recoveries: list[float] = []
        self.lives: list[Life] = []
        self.lived: list[Lived] = []
        self._limits_until_restart = self._stopped = False
        self._later: list[dict[str, Any]] = []
        self._looked = 0.0
        self._stack = ExitStack()
        with ExitStack() as undo:
            self.rings = [undo.enter_context(closing(Ring(directory / "ring", seed, rate)))]
            self.other = undo.enter_context(closing(Ring(directory / "other", seed + 1, rate)))
            self.other.kill()
            self.ours = Ours(directory / "ours", self.rings[0], self.other, rate)
            undo.callback(self.ours.close)
            self.naive: Naive | None = None
            if beside:
                twin = undo.enter_context(closing(Ring(directory / "twin", seed, rate)))
                self.rings.append(twin)
                self.naive = Naive(directory / "naive", self.rings[1], rate)
                undo.callback(self.naive.side.kill)
            if not self.ours.come_up():
                raise LostError(f"the service does not come up: {self.ours.side.errors()[-500:]}")
            self._stack = undo.pop_all()
        self._new_life()

    def run(self, episodes: list[Episode]) -> None:
        """Live through all of them."""
        done = 0
        for episode in episodes:
            self._live(episode)
            done += len(episode.faults)
            self._recover(episode)
            self._dismiss_second(episode)
            if self.naive is not None:
                self.naive.look_after()
            if episode.number % 10 == 9:
                self._look_at_archive(episode.number)
                self._say(
                    f"{done} faults, {self.counts['tripped']} trips, {len(self.trouble)} troubles"
                )

    def _live(self, episode: Episode) -> None:
        began, wall, on = time.monotonic(), time.time(), {}
        for at, begins, index in episode.changes():
            self._wait_until(began + at)
            fault = episode.faults[index]
            name = f"{episode.number}.{index}"
            if begins:
                self.counts[f"fault: {fault.kind}"] += 1
            if fault.where == "ring":
                on.pop(name, None)
                if begins:
                    on[name] = {"id": name, **fault.what}
                    if "move" in fault.what:
                        on[name] = {"id": name}
                        self._tell_all(**fault.what)
                for ring in self.rings:
                    ring.faults = list(on.values())
                self._tell_all(faults=list(on.values()))
            else:
                self._process(fault, begins)
        self.lived.append(Lived(episode, wall, time.time()))
        self.counts["episodes"] += 1
        self.counts[f"pattern: {episode.pattern}"] += 1

    def _tell_all(self, **what: Any) -> None:
        for ring in self.rings:
            if not self._stopped:
                ring.tell(**what)
            else:
                self._later.append(what)
                break

    def _process(self, fault: Fault, begins: bool) -> None:
        do = fault.what.get("do", "")
        if fault.where == "policy":
            self.ours.mode(fault.what["mode"] if begins else "")
        elif fault.where == "ioc":
            self._ioc(do, begins, fault.what.get("corrector_limit", DRIVE))
        elif do in ("kill", "hangup"):
            self._end_controller(begins, do)
        elif do == "stop":
            number = signal.SIGSTOP if begins else signal.SIGCONT
            self.ours.side.signal(number)
            if self.naive is not None:
                self.naive.side.signal(number)
        elif do == "second" and begins:
            self.ours.second.start()
        elif do in ("full", "descriptors"):
            (self.ours.fill_disk if do == "full" else self.ours.take_descriptors)(begins)
        elif do == "gone":
            self.ours.hide_archive(begins)

    def _ioc(self, do: str, begins: bool, drive: float) -> None:
        if do == "stop":
            for ring in self.rings:
                ring.signal(signal.SIGSTOP if begins else signal.SIGCONT)
            self._stopped = begins
            if not begins:
                later, self._later = self._later, []
                for what in later:
                    self._tell_all(**what)
            return
        if do == "other":
            self.other.start() if begins else self.other.kill()
        for ring in self.rings:
            if begins:
                ring.kill()
            else:
                ring.start(drive)
        self._stopped = begins
        if not begins:
            self._later = []
            for ring in self.rings:
                ring.tell(faults=ring.faults)
            self._limits_until_restart = drive != DRIVE

    def _end_controller(self, begins: bool, do: str) -> None:
        if begins:
            if do == "hangup" and not self.ours.hang_up():
                self._note("a closed terminal does not end the service in order", None)
            self.ours.kill()
            if self.naive is not None:
                self.naive.side.kill()
            return
        self.ours.side.start()
        if self.naive is not None:
            self.naive.side.start()
        self._new_life()

    def _recover(self, episode: Episode) -> None:
        began = time.monotonic()
        states: set[str] = set()
        quiet = began
        killed = any(fault.what.get("do") in ("kill", "hangup") for fault in episode.faults)
        patience = STARTING if killed else PATIENCE
        while True:
            self._look()
            status = self.ours.status()
            if status is None or not self.ours.side.alive:
                if not self.ours.side.alive:
                    self._note(f"the service died ({self.ours.side.popen.returncode})", episode)
                    self.ours.side.start()
                    self.ours.come_up()
                    self._new_life()
                elif time.monotonic() - began > patience:
                    self._note("the service does not answer", episode)
                    return
                time.sleep(0.1)
                continue
            state, reason = status["state"], status["reason"]
            states.add(state)
            if self._limits_until_restart and state != "TRIPPED":
                if time.monotonic() - quiet > SHORT:
                    self.counts[f"other limits: {state}"] += 1
                    self._whole_limits()
                    began = quiet = time.monotonic()  # now everything is whole
            elif state == "CLOSED" and not reason:
                break
            if time.monotonic() - began > patience:
                self._note(f"unrecovered {state}: {reason}", episode)
                self._rescue()
                break
            if state == "TRIPPED":
                self.counts["tripped"] += 1
                if not reason:
                    self._note("TRIPPED without a reason", episode)
                self._after_trip(episode)
            elif state == "OPEN" and time.monotonic() - quiet > SHORT:
                refused = self.ours.command("close")
                self.counts["closed by hand"] += not refused
                if refused:
                    self.rings[0].tell(restore=True)
                quiet = time.monotonic()
            elif needs_hand(state, reason) and time.monotonic() - quiet > SHORT:
                self.counts["opened and closed by hand"] += 1
                self.ours.command("open")
                time.sleep(4 * self._period)
                self.ours.command("close")
                quiet = time.monotonic()
            time.sleep(0.05)
        self.recoveries.append(time.monotonic() - began)
        for state in states - {"CLOSED"}:
            self.counts[f"episodes that ended {state}"] += 1

    def _dismiss_second(self, episode: Episode) -> None:
        """See that a second controller was refused, unless the IOC was not there to do so."""
        became, told = self.ours.second.end(STARTING)
        self.counts[f"second controller: {became}"] += bool(became)
        at_ring = any(fault.where == "ioc" for fault in episode.faults)
        if became == "runs" or (became == "ended" and not at_ring):
            self._note(f"a second controller {became}: {told}", episode)

    def _after_trip(self, episode: Episode) -> None:
        if self.rings[0].tell()["rms"] > 0.3e-3:
            self.rings[0].tell(restore=True)
            self.counts["setpoints restored by hand"] += 1
        refused = self.ours.command("reset")
        if refused:
            self._note(f"reset refused: {refused}", episode)
        time.sleep(4 * self._period)
        self.ours.command("close")

    def _whole_limits(self) -> None:
        """Start the IOC again with the limits that it had."""
        for ring in self.rings:
            ring.kill()
            ring.start()
        self._limits_until_restart = False

    def _rescue(self) -> None:
        """Go on with the campaign all the same."""
        self._whole_limits()
        self.ours.command("open")
        time.sleep(0.3)
        self.ours.command("close")
        wait(self.ours.is_well, 5.0)

    def _note(self, what: str, episode: Episode | None) -> None:
        faults = [(f.kind, f.what) for f in episode.faults] if episode else []
        number = episode.number if episode else -1
        self.trouble.append(
            {"what": what, "episode": number, "wall": time.time(), "faults": faults}
        )
        self._say(f"TROUBLE in episode {number}: {what}; {[kind for kind, _ in faults]}")

    def _look_at_archive(self, number: int) -> None:
        self.counts["archive read"] += 1
        if problem := self.ours.read_archive():
            self.trouble.append({"what": f"archive: {problem}", "episode": number})

    def _look(self) -> None:
        if time.monotonic() - self._looked > 1.0:
            self._looked = time.monotonic()
            self.lives[-1].sample()

    def _new_life(self) -> None:
        self.lives.append(Life(self.ours.side.popen.pid))

    def _wait_until(self, moment: float) -> None:
        while (left := moment - time.monotonic()) > 0:
            self._look()
            time.sleep(min(left, 0.2))

    def close(self) -> None:
        """End every process."""
        self._stack.close()
