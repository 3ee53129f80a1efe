"""What an energy that drifts does to a loop, with the RF frequency alone and with it following.

`python -m benchmarks.energy`: the whole loop on the simulated ring in process, on virtual time, ten
minutes by default. Questions to the ring are off, as they are drawn without a seed.
"""

import argparse
import json
from dataclasses import asdict, dataclass

import numpy as np

from orbitfb.core.clock import ManualClock
from orbitfb.core.signals import LoopState
from orbitfb.effects.build import plant_with
from orbitfb.effects.settings import EffectSettings
from orbitfb.loop.frequency import Follower
from orbitfb.loop.runner import Runner
from orbitfb.loop.settings import LoopSettings
from orbitfb.loop.slot import PolicySlot
from orbitfb.physics.frequency import frequency_model
from orbitfb.physics.places import Ring
from orbitfb.physics.plant import PlantSettings
from orbitfb.physics.plant_machine import PlantMachine
from orbitfb.physics.response import response
from orbitfb.policies.svd import SvdPolicy, SvdSettings
from orbitfb.safety.interlocks import InterlockSettings
from orbitfb.safety.limits import LimitSettings
from orbitfb.safety.rf_settings import RfSettings

SETTLED = 5.0
"""Time after closing that is not looked at [s]."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What one run came to.

    Args:
        follows: Whether the frequency followed.
        state: Of the loop at the end.
        energy: Net relative energy deviation at the end [1].
        largest_energy: The largest after the first 5 s [1].
        correctors: Rms of the setpoints at the end [A].
        true_orbit: Rms of the true orbit after the first 5 s [m].
        steps: Steps of the frequency.
        largest_step: The largest [Hz].
    """

    follows: bool
    state: str
    energy: float
    largest_energy: float
    correctors: float
    true_orbit: float
    steps: int
    largest_step: float


def run(follows: bool, seconds: float, rate: float, seed: int, hertz: float = 10.0) -> Outcome:
    """Run a closed loop under an energy ramp.

    Args:
        follows: Whether the frequency follows.
        seconds: How long [s].
        rate: Of the relative energy deviation [1/s].
        seed: Of the ring.
        hertz: Ticks per second [Hz].
    """
    period, settled = 1.0 / hertz, round(SETTLED * hertz)
    ring = Ring.load()
    model, matrix = frequency_model(ring, "x"), response(ring, "x")
    ramp = EffectSettings.model_validate({"id": "energy-ramp", "values": {"rate": rate}})
    plant = plant_with(ring, "x", PlantSettings(initial_orbit_rms=0.0), seed, (ramp,), period)
    clock = ManualClock()
    machine = PlantMachine(plant, clock, period)
    noise, loop = PlantSettings().bpm_noise_rms, LoopSettings(rate_hz=hertz)
    runner = Runner(
        machine,
        PolicySlot(SvdPolicy(matrix, SvdSettings())),
        loop,
        LimitSettings(),
        InterlockSettings(answer_question=0.0),
        np.zeros(len(matrix)),
        clock,
        start=LoopState.CLOSED,
        follower=Follower(machine.oscillator, model, RfSettings(), noise, loop.ramp)
        if follows
        else None,
    )
    energy, orbit, frequency = [], [], []
    for tick in range(round(seconds * hertz)):
        record = runner.step()
        orbit.append(machine.true_orbit_rms)
        frequency.append(machine.oscillator.frequency)
        made = float(model.energy @ (record.setpoints + record.applied))
        moved = model.per_hertz * (frequency[-1] - ring.rf_frequency)
        energy.append(made + moved + rate * period * tick)
    steps = np.diff(frequency)
    return Outcome(
        follows,
        str(runner.state),
        energy[-1],
        float(np.abs(energy[settled:]).max()),
        float(np.sqrt(np.mean(machine.setpoints() ** 2))),
        float(np.sqrt(np.mean(np.square(orbit[settled:])))),
        int(np.count_nonzero(steps)),
        float(np.abs(steps).max()),
    )


def main() -> None:
    """Print both runs, a line of JSON each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=600.0, help="how long [s]")
    parser.add_argument("--rate", type=float, default=8e-7, help="of the energy [1/s]")
    parser.add_argument("--hertz", type=float, default=10.0, help="of the loop [Hz]")
    parser.add_argument("--seed", type=int, default=1, help="of the ring")
    its = parser.parse_args()
    for follows in (False, True):
        print(json.dumps(asdict(run(follows, its.seconds, its.rate, its.seed, its.hertz))))


if __name__ == "__main__":
    main()
