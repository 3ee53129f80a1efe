"""How often the change detector cries wolf, and how soon it tells a change.

    python -m benchmarks.false_alarms [--days 20] [--delays]

The first table draws the detector's scalar statistic while R is as it was. `worst` is what the
threshold is solved for: a block per tick, each with the information that makes false alarms most
frequent, nothing taken off. The other rows are blocks of 20 ticks through the detector itself.
The second table runs the loop on the simulated ring, with the first policy in force throughout.
"""

import argparse
from collections.abc import Iterator

import numpy as np

from orbitfb.evaluate.simulate import ClosedLoop
from orbitfb.models.changes import ChangeDetector, fewest_blocks
from orbitfb.models.comparison import Contrast
from orbitfb.models.identify import Identifier
from orbitfb.models.rows import select_rows
from orbitfb.models.settings import ChangeSettings, IdentifySettings
from orbitfb.physics.drift import DriftSettings
from orbitfb.physics.places import Ring
from orbitfb.physics.plant import Plant, PlantSettings
from orbitfb.policies.svd import SvdPolicy, SvdSettings

RATE = 10.0
BLOCK = 20
MODES = 180
TICKS_PER_DAY = int(RATE * 86_400)
_FOREVER = 10**9


def worst_case(days: int, seed: int, settings: ChangeSettings | None = None) -> int:
    """Count false alarms of Page's sum alone, at the information for which they are most frequent.

    Args:
        days: How many, each with its own draws.
        seed: Of the draws.
        settings: Of the detector.
    """
    threshold = ChangeDetector(settings or ChangeSettings(), RATE).threshold
    _, information = fewest_blocks(threshold)
    generator = np.random.default_rng(seed)
    alarms = 0
    for _ in range(days):
        steps = generator.standard_normal(TICKS_PER_DAY)
        steps *= np.sqrt(information)
        steps -= 0.5 * information
        alarms += passages(steps, threshold)
    return alarms


def passages(steps: np.ndarray, threshold: float) -> int:
    """Count how often Page's sum passes the threshold, beginning anew each time."""
    count, begin, reach = 0, 0, 20_000
    carried = 0.0
    while begin < len(steps):
        total = carried + np.cumsum(steps[begin : begin + reach])
        page = total - np.minimum(np.minimum.accumulate(total), 0.0)
        over = np.flatnonzero(page >= threshold)
        if over.size:
            count += 1
            begin += int(over[0]) + 1
            carried = 0.0
        else:
            carried = float(page[-1])
            begin += reach
    return count


def through_detector(
    days: int, seed: int, information: float, noise: float = 1.0, kicks_per_hour: float = 0.0
) -> int:
    """Count false alarms of the detector on blocks of 20 ticks.

    Args:
        days: How many.
        seed: Of the draws.
        information: Mean information of a block [nats]; it is drawn for each one.
        noise: True noise over the one that is believed, rms [1].
        kicks_per_hour: Blocks whose innovations are 30 times too large.
    """
    detector = ChangeDetector(ChangeSettings(), RATE)
    generator = np.random.default_rng(seed)
    blocks = days * TICKS_PER_DAY // BLOCK
    amount = information * generator.gamma(2.0, 0.5, blocks)
    kicked = generator.random(blocks) < kicks_per_hour * BLOCK / (3600.0 * RATE)
    scale = noise * np.where(kicked, 30.0, 1.0)
    pull = scale * np.sqrt(amount) * generator.standard_normal(blocks)
    spread = np.sqrt(2.0 / (MODES * BLOCK))
    chi2 = noise**2 * (1.0 + spread * generator.standard_normal(blocks))
    alarms = 0
    for index in range(blocks):
        contrast = Contrast(
            BLOCK, float(pull[index]), float(amount[index]), 1.0, float(chi2[index])
        )
        if detector.absorb(contrast):
            alarms += 1
            detector.reset()
    return alarms


def loop_contrasts(
    drift: DriftSettings, seed: int, ticks: int, kick_every: int = 0, kick_rms: float = 0.0
) -> Iterator[tuple[ClosedLoop, tuple[Contrast, ...]]]:
    """Run the loop on the ring with its first policy, which knows the first R, in force throughout.

    Args:
        drift: Of R.
        seed: Of the ring.
        ticks: How long.
        kick_every: Ticks between two kicks; 0: none.
        kick_rms: Their size [m].

    Yields:
        Every 20 ticks the loop and what the comparison says about them.
    """
    plant = Plant(Ring.load(), "x", PlantSettings(drift=drift), seed)
    response = plant.response
    loop = ClosedLoop(plant, SvdPolicy(response, SvdSettings()), ticks)
    identifier = Identifier(response, IdentifySettings())
    while loop.tick < ticks and not loop.lost:
        if kick_every and loop.tick and loop.tick % kick_every == 0:
            plant.kick(kick_rms)
        loop.advance(BLOCK)
        last = identifier.last_tick
        rows = select_rows(loop.transitions(0 if last is None else last + 1), 0.05)
        yield loop, identifier.absorb(rows, response).contrasts


def first_alarm(drift: DriftSettings, seed: int, ticks: int) -> tuple[int | None, float, float]:
    """Tick of the first alarm, mean-square innovation and true orbit of the 100 ticks before it."""
    detector = ChangeDetector(ChangeSettings(), RATE)
    chi2: list[float] = []
    recent = float("nan")
    for loop, contrasts in loop_contrasts(drift, seed, ticks):
        chi2 += [contrast.chi2 for contrast in contrasts if contrast.rows]
        recent = float(np.mean(loop.true_rms[max(0, loop.tick - 100) : loop.tick]))
        alarms = [detector.absorb(contrast) for contrast in contrasts]
        if any(alarm is not None for alarm in alarms):
            return loop.tick, float(np.mean(chi2[-5:])), recent
    return None, float(np.mean(chi2[-5:])), recent


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--days", type=int, default=20, help="simulated days of the statistic")
    parser.add_argument("--delays", action="store_true", help="also run the loop on the ring")
    arguments = parser.parse_args()
    days = arguments.days
    print(f"false alarms in {days} days at {RATE:g} Hz; stated: at most {days}")
    print(f"  worst                                {worst_case(days, 0)}")
    for information in (0.002, 0.3, 3.0):
        for noise in (1.0, 1.05):
            found = through_detector(days, 1, information, noise, kicks_per_hour=1.0)
            print(f"  {information:5.3f} nats a block, noise x {noise:4.2f}    {found}")
    if arguments.delays:
        print("first alarm on the ring [tick]; chi2 and true orbit [um] then")
        for preset, length, ticks in (
            ("none", 0, 10_000),
            ("paper", 10_000, 10_000),
            ("mild", 10_000, 10_000),
            ("strong", 10_000, 10_000),
            ("strong", _FOREVER, 5_000),
        ):
            for seed in (1, 2, 3):
                drift = DriftSettings.model_validate({"preset": preset, "ticks": length})
                tick, chi2, orbit = first_alarm(drift, seed, ticks)
                still = " (R as at its start)" if length == _FOREVER else ""
                print(f"  {preset}{still} seed {seed}: {tick}  {chi2:.3f}  {orbit * 1e6:.3f}")


if __name__ == "__main__":
    main()
