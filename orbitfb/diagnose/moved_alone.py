"""Whether the ground that a record seems to show is a cause: the rival of any shape of the drift.

What one device does moves the orbit in one pattern, which modes of another ground may follow more
closely. So a shape of the drift has to explain more than a cause does where magnets move alone.
"""

from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.entry import Entry, profiled, refitted
from orbitfb.diagnose.explain import Cause


def moved_alone(bench: Bench, given: tuple[Cause, ...], best: Entry | None) -> bool:
    """Whether magnets that move alone, with a cause, explain more than the ground of a bench.

    Args:
        bench: The record without the cause.
        given: Causes that are known to be there.
        best: What explains it best.
    """
    if best is None or bench.told_floor or bench.floor.modes.ground == "alone":
        return False
    alone = Bench(bench.record, given, ground="alone")
    there = _worth(alone, best)
    return alone.full_log_likelihood + there > bench.full_log_likelihood + max(best.weight, 0.0)


def _worth(alone: Bench, best: Entry) -> float:
    """What a cause is worth where magnets move alone [nats]."""
    if best.fit is None:
        return 0.0
    there = refitted(alone, best)
    return max(profiled(alone, there, there.weight)[0].weight, 0.0)
