"""Days on an accelerated clock: does the energy of the beam stay, while the surroundings move it?

The loop, with the RF frequency following, on a ring in process. Nothing fails; tide, temperature,
gaps and the ground move the beam.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import psutil

from orbitfb.core.clock import ManualClock
from orbitfb.core.signals import LoopState
from orbitfb.history.buffer import History
from orbitfb.loop.frequency import Follower
from orbitfb.loop.guard import Safeguards
from orbitfb.loop.runner import Runner
from orbitfb.loop.settings import LoopSettings
from orbitfb.loop.slot import PolicySlot
from orbitfb.observe.statistics.running import LoopStatistics
from orbitfb.physics.frequency import frequency_model
from orbitfb.physics.places import Ring
from orbitfb.physics.plant import Plant, PlantSettings
from orbitfb.physics.plant_machine import PlantMachine
from orbitfb.policies.masking import without
from orbitfb.policies.svd import SvdPolicy, SvdSettings
from orbitfb.safety.interlocks import InterlockSettings
from orbitfb.safety.limits import LimitSettings
from orbitfb.safety.rf_settings import RfSettings
from tests.soak.flat import Soak, first_and_last
from tests.soak.surroundings import Surroundings

ENERGY, STEP = 1e-5, 5.0
"""Largest net energy deviation [1] and step [Hz] that are none."""
SETTLED = 10.0
"""Time after closing that is not looked at [s]."""
SAMPLE = 60.0
"""Time of the ring between two samples of the process [s]."""


@dataclass(frozen=True)
class Energy:
    """What became of the energy.

    Args:
        days: Of the ring.
        follows: Whether the frequency followed.
        largest: Net relative energy deviation, the largest [1].
        rms: The same, rms [1].
        correctors: Setpoints at the end, rms [A].
        true_orbit: Rms of the true orbit [m].
        steps: Of the frequency.
        largest_step: The largest [Hz].
        excursion: Farthest from the nominal frequency [Hz].
        moves: Moves of gaps.
        not_closed: Ticks in which the loop was not CLOSED once it had settled.
        trips: Ticks in which it was TRIPPED.
        reason: Why the frequency does not follow at the end; empty: it does.
    """

    days: float
    follows: bool
    largest: float
    rms: float
    correctors: float
    true_orbit: float
    steps: int
    largest_step: float
    excursion: float
    moves: int
    not_closed: int
    trips: int
    reason: str

    def lines(self) -> list[str]:
        """Give the figures for people."""
        return [
            f"energy in {self.days:g} days: δ up to {self.largest:.2e}, rms {self.rms:.2e}",
            f"  correctors {self.correctors:.4f} A rms at the end, true orbit "
            f"{self.true_orbit * 1e6:.3f} µm rms",
            f"  {self.steps} steps of the RF up to {self.largest_step:.2f} Hz, "
            f"{self.excursion:.1f} Hz away at most; {self.moves} moves of gaps",
            f"  not CLOSED for {self.not_closed} ticks, TRIPPED for {self.trips}",
        ]

    def problems(self) -> list[str]:
        """Say what is not as it must be."""
        found = []
        if not self.largest <= ENERGY:
            found.append(f"days: energy deviation up to {self.largest:.2e}, more than {ENERGY:g}")
        if not self.largest_step <= STEP:
            found.append(f"days: a step of {self.largest_step:.2f} Hz, more than {STEP:g}")
        if self.trips:
            found.append(f"days: TRIPPED for {self.trips} ticks")
        if self.not_closed:
            found.append(f"days: not CLOSED for {self.not_closed} ticks")
        if self.follows and self.reason:
            found.append(f"days: the frequency does not follow: {self.reason}")
        return found


def live(
    days: float,
    seed: int = 1,
    rate: float = 1.0,
    follows: bool = True,
    say: Callable[[str], None] = lambda _: None,
) -> tuple[Soak, Energy]:
    """Run so many days of the ring.

    Args:
        days: Of the ring.
        seed: Of the ring, its surroundings and the loop's questions.
        rate: Of loop and ring [Hz].
        follows: Whether the frequency follows.
        say: Gets a line now and then.
    """
    ring, clock, period = Ring.load(), ManualClock(), 1.0 / rate
    surroundings = Surroundings(ring, period, seed)
    quiet = PlantSettings(initial_orbit_rms=0.0, ground_motion_rms=0.0)
    machine = PlantMachine(Plant(ring, "x", quiet, seed, (surroundings,)), clock, period)
    channels, response = machine.channels, machine.plant.nominal_response
    model, oscillator = frequency_model(ring, "x"), machine.oscillator
    loop = LoopSettings(rate_hz=rate)
    statistics = LoopStatistics(channels, LimitSettings().setpoint, clock)
    follower = Follower(oscillator, model, RfSettings(), quiet.bpm_noise_rms, loop.ramp)
    runner = Runner(
        machine,
        PolicySlot(SvdPolicy(response, SvdSettings())),
        loop,
        LimitSettings(),
        InterlockSettings(),
        np.zeros(len(channels.bpms)),
        clock,
        start=LoopState.CLOSED,
        subscribers=(History(channels, 2000), statistics),
        safeguards=Safeguards(SvdPolicy(response, SvdSettings(), "baseline"), without),
        random=np.random.default_rng([seed, 1]),
        follower=follower if follows else None,
    )
    ticks = round(days * 86400 * rate)
    settled, every = round(SETTLED * rate), round(SAMPLE * rate)
    spent = np.zeros(ticks, dtype=np.float32)
    samples: list[tuple[float, int, int]] = []
    largest = energy_squares = orbit_squares = largest_step = excursion = 0.0
    not_closed = trips = steps = 0
    process, began = psutil.Process(), time.monotonic()
    before = oscillator.frequency
    for tick in range(ticks):
        start = time.thread_time()  # so that what else runs on this computer does not count
        record = runner.step()
        spent[tick] = time.thread_time() - start
        state = runner.state
        trips += state is LoopState.TRIPPED
        step = oscillator.frequency - before
        before += step
        steps += step != 0.0
        largest_step = max(largest_step, abs(step))
        moved = before - ring.rf_frequency
        excursion = max(excursion, abs(moved))
        if tick >= settled:
            not_closed += state is not LoopState.CLOSED
            made = float(model.energy @ (record.setpoints + record.applied))
            energy = made + model.per_hertz * moved + surroundings.energy
            largest = max(largest, abs(energy))
            energy_squares += energy**2
            orbit_squares += machine.true_orbit_rms**2
        if tick % every == 0:
            memory = process.memory_info().rss / 2**20
            samples.append((memory, process.num_fds(), process.num_threads()))
            statistics.snapshot()
        if (tick + 1) % max(1, ticks // 28) == 0:
            done = (tick + 1) / ticks * days
            told = f"{largest:.2e}, {steps} steps, {excursion:.1f} Hz, {samples[-1][0]:.0f} MB"
            say(f"{done:.2f} days simulated: energy deviation up to {told}, {state}")
    rows = np.array(samples)[len(samples) // 10 :]
    part = max(1, len(rows) // 6)
    latency = spent[ticks // 10 :] * 1e3
    window = min(6000, len(latency) // 3)
    sizes, files, threads = (first_and_last(column, part, np.median) for column in rows.T)
    counted = max(1, ticks - settled)
    return Soak(
        "days",
        ticks,
        days * 24,
        round(time.monotonic() - began, 1),
        sizes,
        files,
        threads,
        first_and_last(latency, window, lambda part: np.percentile(part, 99)),
        first_and_last(latency, window, np.median),
    ), Energy(
        days,
        follows,
        largest,
        float(np.sqrt(energy_squares / counted)),
        float(np.sqrt(np.mean(machine.setpoints() ** 2))),
        float(np.sqrt(orbit_squares / counted)),
        steps,
        largest_step,
        excursion,
        surroundings.moves,
        not_closed,
        trips,
        follower.sight.reason if follows else "",
    )
