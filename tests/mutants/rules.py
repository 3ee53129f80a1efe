"""The table: how each rule is broken, and which unit tests must notice it."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]


@dataclass(frozen=True, slots=True)
class Mutant:
    """A rule and how it is broken.

    Args:
        rule: What no longer holds.
        module: Where it is written, as an import would name it.
        old: Text of the module that stands there exactly once.
        new: What stands there instead.
        tests: Files of which at least one test must fail, below `tests/unit`.
    """

    rule: str
    module: str
    old: str
    new: str
    tests: tuple[str, ...]

    @property
    def file(self) -> Path:
        """The file of the module, below the root of the repository."""
        return Path(*self.module.split(".")).with_suffix(".py")

    @property
    def paths(self) -> Sequence[str]:
        """The test files, below the root of the repository."""
        return [f"tests/unit/{name}" for name in self.tests]

    def broken(self, text: str) -> str:
        """Break the rule in the text of its module.

        Raises:
            ValueError: The text to be replaced does not stand there exactly once.
        """
        if (count := text.count(self.old)) != 1:
            raise ValueError(f"{self.rule}: {self.old!r} is {count} times in {self.file}, not once")
        return text.replace(self.old, self.new)


LIMITS, BOUNDS, INTERLOCKS, WATCH = (
    "orbitfb.safety.limits",
    "orbitfb.safety.bounds",
    "orbitfb.safety.interlocks",
    "orbitfb.safety.watch",
)
BPMS, CORRECTORS = "orbitfb.safety.bpms", "orbitfb.safety.correctors"
ANSWERING = "orbitfb.safety.answers.answering"
ENGINE, TICK = "orbitfb.loop.engine", "orbitfb.loop.tick"

MUTANTS = (
    Mutant(
        "no setpoint moves by more than limits.change_per_tick in a tick",
        LIMITS,
        "if peak <= settings.change_per_tick:",
        "if peak <= 3 * settings.change_per_tick:",
        ("safety/test_limits.py",),
    ),
    Mutant(
        "no setpoint is sent beyond limits.setpoint",
        LIMITS,
        "(target >= bounds.low) & (target <= bounds.high)",
        "(target >= bounds.low) | (target <= bounds.high)",
        ("safety/test_limits.py",),
    ),
    Mutant(
        "a change or a setpoint that is not finite is refused",
        LIMITS,
        "    if not refused.may_act:\n",
        "    if False:\n",
        ("safety/test_limits.py",),
    ),
    Mutant(
        "drive limits of the machine that are narrower than ours are told, either of them",
        BOUNDS,
        "(drive[:, 0] > low) | (drive[:, 1] < high)",
        "(drive[:, 0] > low) & (drive[:, 1] < high)",
        ("safety/test_bounds.py",),
    ),
    Mutant(
        "drive limits of the machine that are narrower than ours hold for their corrector",
        BOUNDS,
        "np.fmax(low, drive[:, 0]), np.fmin(high, drive[:, 1]), narrow",
        "low, high, narrow",
        ("safety/test_bounds.py",),
    ),
    Mutant(
        "a setpoint beyond a drive limit is not moved: the machine would have it jump",
        BOUNDS,
        "np.where(self.stranded(setpoints), 0.0, np.maximum(room, 0.0))",
        "np.maximum(room, 0.0)",
        ("safety/test_bounds.py",),
    ),
    Mutant(
        "a stored current that is not known is not enough",
        INTERLOCKS,
        "if current >= settings.current_min:",
        "if not current < settings.current_min:",
        ("safety/test_interlocks.py",),
    ),
    Mutant(
        "a stored current that drops trips",
        INTERLOCKS,
        "current < (1 - settings.current_drop) * before",
        "current < 0.0 * before",
        ("safety/test_interlocks.py",),
    ),
    Mutant(
        "an rms orbit error that is not a number trips",
        INTERLOCKS,
        "if not value <= most:",
        "if value > most:",
        ("safety/test_interlocks.py",),
    ),
    Mutant(
        "an orbit error that is too large at one BPM trips",
        INTERLOCKS,
        '("largest", largest, settings.distortion_max),',
        '("largest", largest, float("inf")),',
        ("safety/test_interlocks.py",),
    ),
    Mutant(
        "a readback that is not known does not follow",
        INTERLOCKS,
        "return ~((readback >= low - tolerance) & (readback <= high + tolerance))",
        "return (readback < low - tolerance) | (readback > high + tolerance)",
        ("safety/test_interlocks.py",),
    ),
    Mutant(
        "a BPM that reads exactly 0 is left out",
        BPMS,
        "zero = known & (position == 0.0)",
        "zero = known & (position == np.inf)",
        ("safety/test_bpms.py",),
    ),
    Mutant(
        "a BPM that repeats itself while others change is left out",
        BPMS,
        "known & (repeats >= limit)",
        "known & (repeats >= 1000)",
        ("safety/test_bpms.py",),
    ),
    Mutant(
        "a BPM that jumps alone is left out",
        BPMS,
        "jump = known & _jumped(",
        "jump = ~known & _jumped(",
        ("safety/test_bpms.py",),
    ),
    Mutant(
        "a BPM that was left out proves itself before it counts again",
        BPMS,
        "flaws[~bad & (good < settings.bpm_proving)]",
        "flaws[~bad & (good < 0)]",
        ("safety/test_bpms.py",),
    ),
    Mutant(
        "more invalid BPMs than may be hold the loop",
        BPMS,
        "if invalid > settings.max_invalid_bpms or invalid == wanted:",
        "if invalid == wanted:",
        ("safety/test_interlocks.py",),
    ),
    Mutant(
        "too many invalid BPMs next to each other hold the loop, also where the ring closes",
        BPMS,
        "start = int(np.argmin(bad))",
        "start = 0",
        ("safety/test_bpms.py",),
    ),
    Mutant(
        "more lost correctors than may be trip",
        CORRECTORS,
        "if count > settings.max_lost_correctors and new.any():",
        "if count > 1000 and new.any():",
        ("safety/test_correctors.py",),
    ),
    Mutant(
        "a corrector that cannot be written is left out at once",
        CORRECTORS,
        "new = (counts >= ticks) | gone",
        "new = counts >= ticks",
        ("safety/test_correctors.py",),
    ),
    Mutant(
        "an orbit that does not answer as the response says trips",
        "orbitfb.safety.prediction",
        'Verdict(Action.TRIP, "prediction", reason)',
        'Verdict(Action.WARN, "prediction", reason)',
        ("safety/test_prediction.py",),
    ),
    Mutant(
        "an orbit error that grows tick by tick trips",
        WATCH,
        'Verdict(Action.TRIP, "divergence", reason)',
        'Verdict(Action.WARN, "divergence", reason)',
        ("safety/test_watch.py",),
    ),
    Mutant(
        "an orbit error that grows too fast trips",
        WATCH,
        "if most is None or rate <= most:",
        "if most is None or rate <= 10 * most:",
        ("safety/test_watch.py",),
    ),
    Mutant(
        "an orbit is acted on once",
        WATCH,
        "if not orbit.time > memory.time:",
        "if orbit.time < memory.time:",
        ("safety/test_watch.py",),
    ),
    Mutant(
        "an orbit that repeats itself as a whole is not acted on",
        WATCH,
        "if settings.frozen_ticks and repeats >= settings.frozen_ticks:",
        "if settings.frozen_ticks and repeats >= 1000:",
        ("safety/test_watch.py",),
    ),
    Mutant(
        "one error is corrected once, also while puts are late",
        "orbitfb.safety.arrival",
        "    late = part < SEEN\n",
        "    late = False\n",
        ("safety/test_arrival.py",),
    ),
    Mutant(
        "a tripped loop does not close before it was reset",
        "orbitfb.loop.states",
        "{Event.RESET: _OPEN}",
        "{**_ORDERS, Event.RESET: _OPEN}",
        ("loop/test_states.py",),
    ),
    Mutant(
        "an orbit that has grown old while the policy decided is not acted on",
        ENGINE,
        "> rules.loop.patience:",
        "> 1e9:",
        ("loop/test_rules.py", "loop/test_runner.py", "loop/test_guard.py"),
    ),
    Mutant(
        "only correctors that the loop moves are put",
        ENGINE,
        "self._machine.write(limited.setpoints, mine)",
        "self._machine.write(limited.setpoints)",
        ("loop/test_disabled_correctors.py",),
    ),
    Mutant(
        "a loop whose write failed holds",
        ENGINE,
        'self.move(Event.HOLD, f"writing failed: {error}")',
        "pass",
        ("loop/test_runner.py",),
    ),
    Mutant(
        "before it closes the loop reads the setpoints",
        "orbitfb.loop.inspection",
        "doubt = closing or unknown or given or memory.state is LoopState.HELD",
        "doubt = unknown or given",
        ("loop/test_runner.py", "loop/test_rules.py", "loop/test_away_rules.py"),
    ),
    Mutant(
        "the loop does not close while the machine must not be written to",
        "orbitfb.loop.inspection",
        "trouble=answer.trouble or self.guard.obstacle()",
        "trouble=answer.trouble",
        ("loop/test_guard.py",),
    ),
    Mutant(
        "the baseline decides where the policy asks for what is not finite",
        "orbitfb.loop.guard",
        "            if not np.isfinite(change).all():\n",
        "            if False:\n",
        ("loop/test_guard.py",),
    ),
    Mutant(
        "a loop that is held too long trips",
        TICK,
        "held >= loop.trip_after:",
        "held < 0:",
        ("loop/test_runner.py",),
    ),
    Mutant(
        "the gain is ramped after closing",
        TICK,
        "return min(1.0, (max(closed_for, 0.0) + loop.period) / loop.ramp)",
        "return 1.0",
        ("loop/test_runner.py",),
    ),
    Mutant(
        "BPMs that are masked by configuration never count",
        "orbitfb.loop.machines.masked",
        "reading.orbit.valid & self._counting",
        "reading.orbit.valid",
        ("loop/test_masked.py",),
    ),
    Mutant(
        "the way back to good setpoints ends when the orbit error grows",
        "orbitfb.loop.comeback",
        "if not checked.rms <= _WORSE * way.rms + _NOISE:",
        "if checked.rms > 1e3:",
        ("loop/test_comeback.py", "loop/test_coming_back.py"),
    ),
    Mutant(
        "what a BPM said before it went away is not taken for what it says now",
        "orbitfb.epics.orbit.assembler",
        "            self.records[index] = (0, INVALID, 0, 0, np.nan)\n",
        "            pass\n",
        ("epics/test_assembler.py",),
    ),
    Mutant(
        "an orbit that is too old is not handed to the loop",
        "orbitfb.epics.inbox",
        "        if age > limit:\n",
        "        if age > 1e9:\n",
        ("epics/test_inbox.py",),
    ),
    Mutant(
        "a controller whose lease is not confirmed does not write",
        "orbitfb.epics.lease.lease",
        "        if age < self._time:\n",
        "        if age < 1e9:\n",
        ("epics/test_epics_lease.py",),
    ),
    Mutant(
        "a lease whose owner lives is not taken",
        "orbitfb.epics.lease.lease",
        "while self._sign(now) is Sign.THEIRS and",
        "while False and",
        ("epics/test_epics_lease.py",),
    ),
    Mutant(
        "what was not sent from here was put by somebody else",
        "orbitfb.epics.setpoints.put_watch",
        "        others[which[~ours & np.isfinite(values)]] = True\n",
        "        others[which[ours & np.isfinite(values)]] = False\n",
        ("epics/test_put_watch.py",),
    ),
    Mutant(
        "a closed loop gives way to a second controller",
        "orbitfb.safety.second_controller",
        "Action.TRIP if gives_way else Action.WARN",
        "Action.WARN",
        ("safety/test_second_controller.py", "loop/test_two_loops.py"),
    ),
    Mutant(
        "a loop does not close beside a second controller",
        "orbitfb.loop.inspection",
        "    matters = closing or closed or state is LoopState.HELD\n",
        "    matters = closed\n",
        ("loop/test_two_loops.py",),
    ),
    Mutant(
        "a loop that may not write for its lease does not trip on what the owner puts",
        "orbitfb.loop.machines.guarded",
        "return replace(reading, by_others=None)",
        "return reading",
        ("loop/test_two_loops.py",),
    ),
    Mutant(
        "a dead channel that reads exactly 0 is not believed",
        BPMS,
        "zero = known & (position == 0.0)",
        "zero = np.zeros_like(known)",
        ("safety/test_bpms.py",),
    ),
    Mutant(
        "what a held loop has asked for is still owed",
        ANSWERING,
        "waits = seen.held and memory.owed is not None",
        "waits = False",
        ("safety/answers/test_answering.py",),
    ),
    Mutant(
        "nothing is corrected once a BPM owes twice the reach, until it has answered",
        ANSWERING,
        "stopped=memory.overdue(owed) > least",
        "stopped=False",
        ("safety/answers/test_answering.py",),
    ),
    Mutant(
        "a large change that a blind BPM does not see says nothing for it",
        "orbitfb.safety.answers.evidence",
        "_over(self.sums[ASKED, 0], self.sums[MUCH_V, 0])",
        "_over(1.5 * (self.sums[LITTLE_M, 0] - self.sums[MUCH_M, 0]), self.sums[MUCH_V, 0])",
        ("safety/answers/test_questions.py",),
    ),
    Mutant(
        "what is left of a deaf corrector's change is no answer",
        "orbitfb.safety.answers.evidence",
        "heard(surprise + (1.0 - LITTLE) * own)",
        "heard(surprise + 1.1 * own)",
        ("safety/answers/test_deaf_devices.py",),
    ),
    Mutant(
        "a current stamped in the future grows old from when it was seen",
        "orbitfb.epics.auxiliary",
        "now - max(age, 0.0), -min(age, 0.0)",
        "now - age, 0.0",
        ("epics/test_slow_channels.py",),
    ),
    Mutant(
        "a loop that has just closed waits where a BPM stands still, before it can ask",
        "orbitfb.safety.answers.owing",
        "return self._stands_still(self.owed, reach)",
        "return False",
        ("loop/test_answering_loop.py",),
    ),
    Mutant(
        "a loop that has just closed does not wait for BPMs that follow",
        "orbitfb.safety.answers.owing",
        "(went < NEAR * due)",
        "(went < 3.0 * due)",
        ("loop/test_answering_loop.py",),
    ),
)
