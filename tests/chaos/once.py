"""One campaign from its seed to its figures."""

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from orbitfb.history.reader import segment_paths
from tests.chaos import journal, judge
from tests.chaos.campaign import Campaign
from tests.chaos.growth import grown
from tests.chaos.kinds import KINDS, Kind
from tests.chaos.rings import LostError
from tests.chaos.schedule import schedule


def run_once(
    directory: Path,
    seed: int,
    faults: int,
    rate: float,
    beside: bool = True,
    say: Callable[[str], None] = lambda _: None,
    settled: float = 60.0,
    first: int = 0,
    kinds: Sequence[Kind] = KINDS,
) -> dict[str, Any]:
    """Run a campaign and judge it.

    Args:
        directory: For data and journals.
        seed: Of schedule and rings.
        faults: How many.
        rate: Of the orbits [Hz].
        beside: Whether the plain loop runs beside it.
        say: Gets a line now and then.
        settled: Time after a start from which growth is looked at [s].
        first: Number of the episode to begin with.
        kinds: Of which faults are drawn.
    """
    began = time.monotonic()
    episodes = list(schedule(seed, faults, kinds))[first:]
    campaign = Campaign(directory, seed, rate, say, beside)
    try:
        campaign.run(episodes)
    except LostError as error:
        campaign.trouble.append({"what": str(error), "episode": -1})
    finally:
        campaign.close()
    ours = campaign.ours
    unreadable = ours.read_all()
    changes = ours.events("loop_state_changed")
    written = ours.events("postmortem_written")
    rings = [journal.read(ring.journal) for ring in campaign.rings]
    figures = judge.put_figures(rings[0], rate)
    longest = max(campaign.lives, key=lambda life: life.seconds)
    growth = longest.figures(settled)
    unexplained = judge.trips(changes, written, ours.unlogged)
    broken_in = judge.broken_in(rings[0], campaign.lived)
    elsewhere = int(journal.read(campaign.other.journal)["puts"].sum())
    broken = [
        *judge.broken_rules(figures),
        *(
            f"episode {number}: puts after {n} orbits broke a rule"
            for number, n in broken_in.items()
        ),
        *(f"episode {t['episode']}: {t['what']}" for t in campaign.trouble),
        *unexplained,
        *judge.wandered(rings[0], campaign.lived),
        *([f"puts at another server: {elsewhere}"] if elsewhere else []),
        *(f"archive: {problem}" for problem in unreadable),
        *grown(growth),
    ]
    result: dict[str, Any] = {
        "seed": seed,
        "faults": sum(len(episode.faults) for episode in episodes),
        "episodes": len(episodes),
        "rate_hz": rate,
        "seconds": round(time.monotonic() - began, 1),
        "broken": broken,
        "ours": figures,
        "tripped": sum(line.get("state") == "TRIPPED" for line in changes),
        "held": sum(line.get("state") == "HELD" for line in changes),
        "trips_by_reason": judge.reasons(changes),
        "postmortems": len(written),
        "segments": len(segment_paths(ours.data / "archive")),
        "unexplained": len(unexplained),
        "recovery_p50_s": round(float(np.median(campaign.recoveries)), 2),
        "recovery_longest_s": round(max(campaign.recoveries), 2),
        "growth": growth,
        "counts": {name: n for name, n in sorted(campaign.counts.items()) if n},
        "trouble": campaign.trouble,
    }
    if campaign.naive is not None:
        result["naive"] = judge.put_figures(rings[1], rate)
        result["naive_again"] = campaign.naive.again
        result["naive_died"] = campaign.naive.died
    return result
