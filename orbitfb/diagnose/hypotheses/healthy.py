"""Errors that any ring has, beyond what a healthy ring has of them."""

from collections.abc import Iterator

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.likelihood.errors import ErrorBlock, variances
from orbitfb.estimation.evidence import NormalTerms
from orbitfb.estimation.priors import MORE, MOST_DEVICES, SCATTER, SHARES, SIZE_WIDTH


def scan_errors(scorer: Scorer) -> Iterator[Candidate]:
    """Raise the scatter of all devices, or let a few of them be further off."""
    space = scorer.space
    terms = scorer.errors
    base = terms.evidence()
    for number, block in enumerate(space.blocks):
        if block.accepted:
            continue
        yield from _all(scorer, number, terms, base)
        yield from _few(block, terms, base)


def _all(scorer: Scorer, number: int, terms: NormalTerms, base: float) -> Iterator[Candidate]:
    space = scorer.space
    block = space.blocks[number]
    best, share = -np.inf, 0.0
    for factor in SCATTER:
        if space.shares[number] >= factor:
            continue
        shares = [*space.shares[:number], factor, *space.shares[number + 1 :]]
        variance = np.maximum(variances(space.blocks, shares, len(space.terms)), space.single)
        found = NormalTerms(terms.pull, terms.information, variance).evidence()
        if found > best:
            best, share = found, factor
    if best - base > 0.0 and block.kind.linear is not None:
        size = share * float(np.median(block.limit))
        values = {p.name: p.nominal for p in block.kind.parameters} | {block.kind.linear: size}
        yield Candidate(block.kind, (), (), values, best - base, raised={number: share}, cost=0.0)


def _few(block: ErrorBlock, terms: NormalTerms, base: float) -> Iterator[Candidate]:
    """Devices whose own variance is wide, grown greedily."""
    if block.kind.linear is None:
        return
    typical = next(p.typical for p in block.kind.parameters if p.name == block.kind.linear)
    wide = (SIZE_WIDTH * typical) ** 2
    columns = np.arange(block.columns.start, block.columns.stop)
    variance = terms.variance.copy()
    cost = float(np.log(len(columns)))
    chosen: list[int] = []
    last = base
    while len(chosen) < MOST_DEVICES:
        pull, own = _marginal(terms, variance, columns)
        more = np.maximum(wide - variance[columns], 0.0)
        grown = 1.0 + np.maximum(own, 0.0) * more
        gain = 0.5 * pull**2 * more / grown - 0.5 * np.log(grown)
        gain[chosen] = -np.inf
        device = int(np.argmax(gain))
        if gain[device] < cost + MORE:
            break
        kept = variance[columns[device]]
        variance[columns[device]] = wide
        found = NormalTerms(terms.pull, terms.information, variance).evidence()
        if found - last < cost + MORE:
            variance[columns[device]] = kept
            break
        last = found
        chosen.append(device)
    if not chosen:
        return
    last += _eased(terms, variance, columns[chosen])
    mean = NormalTerms(terms.pull, terms.information, variance).mean()
    places = tuple(sorted(chosen))
    sizes = tuple(float(mean[columns[place]]) for place in places)
    largest = max(sizes, key=abs)
    values = {p.name: p.nominal for p in block.kind.parameters} | {block.kind.linear: largest}
    yield Candidate(
        block.kind,
        places,
        tuple(block.law.names[place] for place in places),
        values,
        last - base - cost * len(places),
        sizes=sizes,
        columns={int(columns[place]): wide for place in places},
        cost=cost * len(places),
    )


def _eased(terms: NormalTerms, variance: np.ndarray, chosen: np.ndarray) -> float:
    """Log evidence gained if all other errors are smaller once these few are known [nats].

    Args:
        terms: The errors, with what they are allowed now.
        variance: With the few wide, shape (k,).
        chosen: Columns of the few.
    """

    def best(allowed: np.ndarray, kept: np.ndarray) -> float:
        found = []
        for share in SHARES[::-1]:
            smaller = share**2 * allowed
            smaller[kept] = allowed[kept]
            found.append(NormalTerms(terms.pull, terms.information, smaller).evidence())
        return max(found) - found[0]

    return max(best(variance, chosen) - best(terms.variance, chosen[:0]), 0.0)


def _marginal(
    terms: NormalTerms, variance: np.ndarray, columns: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Pull and information of columns with all others, and they themselves, marginalised."""
    used = np.flatnonzero(variance > 0.0)
    pull, own = terms.pull[columns].copy(), np.diag(terms.information)[columns].copy()
    if len(used):
        scale = np.sqrt(variance[used])
        inner = scale[:, None] * terms.information[np.ix_(used, used)] * scale
        inner[np.diag_indices_from(inner)] += 1.0
        factor = cho_factor(inner, lower=True)
        cross = scale[:, None] * terms.information[np.ix_(used, columns)]
        solved = cho_solve(factor, cross)
        own -= np.einsum("uc,uc->c", cross, solved)
        pull -= solved.T @ (scale * terms.pull[used])
    return pull, own
