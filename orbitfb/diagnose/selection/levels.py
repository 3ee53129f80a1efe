"""Which of several courses each device most likely has, its level, where all are told at once."""

import numpy as np
from numpy.typing import NDArray

from orbitfb.diagnose.hypotheses.refit import Course
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.estimation.priors import PARTNERS
from orbitfb.estimation.transform import Indices, Matrix


def courses_of(source: Course, scorer: Scorer) -> list[Matrix]:
    """Courses of the devices, block by block, shape (N, k) each."""
    courses = source.of(scorer.space.signals, source.values)
    return [np.broadcast_to(one, (len(one), len(source.size))) * source.size for one in courses]


def weighed(
    source: Course, several: list[list[Matrix]], scorer: Scorer
) -> tuple[Matrix, NDArray[np.float64]]:
    """Pull (L, k) and information (L, k, L, k) of L courses of every device.

    Args:
        source: Whose devices they are.
        several: The courses, L times block by block, shape (N, k) each.
        scorer: Of what is left to explain.
    """
    count, size = len(several), len(source.size)
    chosen = list(source.places) if source.places else slice(None)
    patterns = [one[:, chosen] for one in source.law.patterns]
    turned = scorer.space.transform.quick_spectrum
    spectrum = np.hstack([turned(one) for level in several for one in level])
    pull, information = scorer.columns(patterns, spectrum)
    return pull.reshape(count, size), information.reshape(count, size, count, size)


def likeliest(pull: Matrix, information: NDArray[np.float64]) -> tuple[Indices, Matrix]:
    """Numbers of the best levels of devices, shape (k,), and what each level gains, (L, k).

    One device after the other, then each with those that act most like it: what one of two that
    are alike has too much, the other has too little, and neither is better for itself.

    Args:
        pull: Shape (L, k).
        information: Of all pairs, shape (L, k, L, k).
    """
    count = pull.shape[1]
    own = np.einsum("lklk->lk", information)
    middle, devices = len(pull) // 2, np.arange(count)
    state = np.full(count, middle)
    usual = np.sqrt(np.maximum(own[middle], 1e-300))
    alike = np.abs(information[middle, :, middle]) / np.outer(usual, usual)
    alike[devices, devices] = -1.0
    partners = np.argsort(-alike, axis=1)[:, :PARTNERS]
    total = information[:, :, state, devices].sum(axis=2)
    gain, alone = np.zeros_like(pull), pull - 0.5 * own
    for _ in range(len(pull)):
        before = state.copy()
        for one in devices:
            for other in (one, *partners[one]):
                both = [one] if other == one else [one, other]
                rest = total[:, both] - sum(information[:, both, state[its], its] for its in both)
                gains = (alone[:, both] - rest).T
                if other == one:
                    gain[:, one] = gains[0]
                    found = (int(np.argmax(gains[0])),)
                else:
                    joint = gains[0][:, None] + gains[1] - information[:, one, :, other]
                    found = np.unravel_index(int(np.argmax(joint)), joint.shape)
                for its, level in zip(both, found, strict=True):
                    if level != state[its]:
                        total += information[level, its] - information[state[its], its]
                        state[its] = level
        if np.array_equal(before, state):
            break
    return state, gain
