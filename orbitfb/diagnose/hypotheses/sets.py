"""Which devices a law strikes: all of them, groups, or single ones, grown greedily."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.estimation.evidence import normal_size
from orbitfb.estimation.priors import MORE, MOST_DEVICES, SIZE_WIDTH
from orbitfb.estimation.transform import Indices, Matrix

Worth = Callable[[Vector, Vector], Vector]
"""Log evidence of a set from its summed pull and information."""


def best_set(
    pull: Vector,
    information: Matrix,
    groups: Mapping[str, Indices],
    worth: Worth,
    *,
    alone: bool = False,
) -> tuple[float, tuple[int, ...]]:
    """Find the set of devices with one common value that has the most evidence.

    Several are struck only where that says more than that the best one of them is: of a device that
    shows nothing, as one whose current stays below the limit, nothing is told.

    Args:
        pull: Of every device, shape (D,).
        information: Of them, shape (D, D).
        groups: That are commonly struck together.
        worth: Log evidence of a set.
        alone: Whether only groups that have a name, or single devices, can be struck.

    Returns:
        Log evidence less what choosing the set costs (the logarithm of how many there are to
        choose from, for each that is chosen), and the devices; empty: all of them.
    """
    if alone:
        return _one(pull, information, groups, worth)
    every = float(worth(np.array([pull.sum()]), np.array([information.sum()]))[0])
    most = float(np.max(worth(pull, np.diag(information)), initial=0.0))
    best: tuple[float, tuple[int, ...]] = (every if every > most + MORE else -np.inf, ())
    units = [list(map(int, members)) for members in groups.values()]
    single = [[device] for device in range(len(pull))]
    for choice in (units, single):
        if len(choice) < 2:
            continue
        found = _grown(pull, information, choice, worth)
        if found[0] > best[0]:
            best = found
    found = _kept(pull, information, worth)
    return found if found[0] > best[0] else best


def _one(
    pull: Vector, information: Matrix, groups: Mapping[str, Indices], worth: Worth
) -> tuple[float, tuple[int, ...]]:
    """The best single device, or the best named group of several."""
    cost = float(np.log(len(pull) + len(groups)))
    own = worth(pull, np.diag(information))
    device = int(np.argmax(own))
    best: tuple[float, tuple[int, ...]] = (float(own[device]) - cost, (device,))
    for members in groups.values():
        total, along = pull[members].sum(), information[np.ix_(members, members)].sum()
        found = float(worth(np.array([total]), np.array([along]))[0])
        if found - cost > best[0] and found > own[members].max() + MORE:
            best = (found - cost, tuple(int(one) for one in members))
    return best


def _grown(
    pull: Vector, information: Matrix, units: Sequence[Sequence[int]], worth: Worth
) -> tuple[float, tuple[int, ...]]:
    member = np.zeros((len(units), len(pull)))
    for number, devices in enumerate(units):
        member[number, list(devices)] = 1.0
    own, shared = member @ pull, member @ information @ member.T
    diagonal, cost = np.diag(shared), np.log(len(units))
    alone = worth(pull, np.diag(information))
    several = np.array([len(one) > 1 for one in units])
    most = np.array([alone[list(one)].max() for one in units])
    chosen: list[int] = []
    total = along = 0.0
    best = -np.inf
    while len(chosen) < len(units):
        beside = shared[:, chosen].sum(axis=1) if chosen else np.zeros(len(units))
        pulls, informations = total + own, along + 2.0 * beside + diagonal
        gain = worth(pulls, informations) - cost * (len(chosen) + 1)
        gain[chosen] = -np.inf
        if not chosen:
            gain[several & (gain + cost < most + MORE)] = -np.inf
        next_one = int(np.argmax(gain))
        if gain[next_one] <= best + (MORE if chosen else 0.0):
            break
        best = float(gain[next_one])
        chosen.append(next_one)
        total, along = float(pulls[next_one]), float(informations[next_one])
    devices = sorted({int(device) for number in chosen for device in units[number]})
    return best, tuple(devices)


def _kept(pull: Vector, information: Matrix, worth: Worth) -> tuple[float, tuple[int, ...]]:
    """Those that stand out where all have a size of their own, less what is not worth its choice.

    Devices whose orbits are alike hide each other: a set that grows may begin with a wrong one.
    """
    sizes = np.linalg.solve(information + np.eye(len(pull)), pull)
    chosen = list(map(int, np.flatnonzero(sizes > 0.5 * sizes.max())))
    cost = float(np.log(len(pull)))
    while chosen:
        own, inner = pull[chosen], information[np.ix_(chosen, chosen)]
        now = float(worth(np.array([own.sum()]), np.array([inner.sum()]))[0])
        less = worth(own.sum() - own, inner.sum() - 2.0 * inner.sum(axis=1) + np.diag(inner))
        least = int(np.argmax(less))
        if len(chosen) == 1 or less[least] < now - cost - MORE:
            return now - cost * len(chosen), tuple(chosen)
        del chosen[least]
    return -np.inf, ()


def grown_apart(
    pull: Vector, information: Matrix, costs: Vector | float, free: bool
) -> tuple[list[int], float]:
    """Find the devices that explain more than they cost, each with a size of its own.

    Args:
        pull: Of every device, shape (D,).
        information: Of them, shape (D, D).
        costs: Of choosing each, shape (D,) [nats].
        free: Whether each may have any size; otherwise all have the one that is given.

    Returns:
        The devices, the strongest first, and their log evidence less what they cost.
    """
    chosen: list[int] = []
    evidence = 0.0
    for _ in range(min(MOST_DEVICES, len(pull))):
        gain = _beside(pull, information, chosen, free) - costs
        gain[chosen] = -np.inf
        device = int(np.argmax(gain))
        if gain[device] < MORE:
            break
        chosen.append(device)
        evidence += float(gain[device])
    return chosen, evidence


def _beside(pull: Vector, information: Matrix, chosen: list[int], free: bool) -> Vector:
    """Log evidence of one more device beside those chosen, shape (D,)."""
    own = np.diag(information)
    if not free:
        beside = information[:, chosen].sum(axis=1)
        return pull - beside - 0.5 * own
    if not chosen:
        return normal_size(pull, np.maximum(own, 0.0), SIZE_WIDTH**2)
    inner = information[np.ix_(chosen, chosen)] + np.eye(len(chosen)) / SIZE_WIDTH**2
    solved = np.linalg.solve(inner, information[chosen])
    left = pull - solved.T @ pull[chosen]
    rest = own - np.einsum("kd,kd->d", solved, information[chosen])
    return normal_size(left, np.maximum(rest, 0.0), SIZE_WIDTH**2)
