"""What the trainer's process and its parent tell each other.

Both ends are this program, on one computer, on a pair of sockets that nobody else can open, so
that Python's own serialisation is no risk. Policies travel as the store keeps them: kind,
settings, tensors.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.errors import StoreError
from orbitfb.core.ports import Policy
from orbitfb.core.signals import Mask, Vector
from orbitfb.core.transitions import Transitions
from orbitfb.estimation.columns import KnownRf
from orbitfb.learn.builders import builder, masked, unmasked
from orbitfb.learn.settings import LearnSettings
from orbitfb.learn.trainer import Answer
from orbitfb.policies.settings import PolicySettings
from orbitfb.policies.store.kinds import kind_named, kind_of

if TYPE_CHECKING:
    from orbitfb.learn.learner import Learner


@dataclass(frozen=True, slots=True)
class TrainerJob:
    """What a trainer must know to begin.

    Args:
        learn: How to identify and judge.
        policy: How candidates are made.
        response: R̂ to begin with, shape (n, m) [m/A].
        movable: Correctors that may move, shape (m,); None: all.
        seed: Of what is drawn.
        rate: Ticks per second [Hz].
        rf: What is told of the RF; None: the loop leaves it alone.
    """

    learn: LearnSettings
    policy: PolicySettings
    response: Vector
    movable: Mask | None = None
    seed: int = 0
    rate: float = 10.0
    rf: KnownRf | None = None


@dataclass(frozen=True, slots=True)
class PackedPolicy:
    """A policy on its way.

    Args:
        kind: Which class it is.
        identifier: Its name.
        settings: Of its class, as JSON.
        tensors: By name.
        movable: Correctors that may move, shape (m,); None: all.
    """

    kind: str
    identifier: str
    settings: str
    tensors: Mapping[str, NDArray[Any]]
    movable: Mask | None


@dataclass(frozen=True, slots=True)
class TaskMessage:
    """A `Task` on its way; `incumbent` is its name, and the policy itself when it is new."""

    transitions: Transitions
    incumbent: str
    policy: PackedPolicy | None
    trigger: str | None
    may_refit: bool
    afresh: bool


@dataclass(frozen=True, slots=True)
class AnswerMessage:
    """An `Answer` on its way; the candidate is packed beside it."""

    answer: Answer
    candidate: PackedPolicy | None
    last_tick: int | None


def learner_of(job: TrainerJob) -> "Learner":
    """Make the learner that a job asks for."""
    from orbitfb.learn.learner import Learner  # its arithmetic: here and in no loop's process

    build = builder(job.policy, job.movable, job.seed)
    return Learner(job.response, job.learn, build, seed=job.seed, rate=job.rate, rf=job.rf)


def pack(policy: Policy) -> PackedPolicy:
    """Make a policy ready to travel.

    Raises:
        StoreError: It is of a kind that the store does not know.
    """
    kind, inside = kind_of(policy)
    return PackedPolicy(
        kind.word,
        inside.policy_id,
        inside.settings.model_dump_json(),
        kind.take_all(inside),
        None if unmasked(policy) is policy else np.array(getattr(policy, "movable")),  # noqa: B009
    )


def unpack(packed: PackedPolicy) -> Policy:
    """Make the policy that has travelled.

    Raises:
        StoreError: Its kind is not known here.
    """
    kind = kind_named(packed.kind)
    if kind is None:
        raise StoreError(f"a policy of kind {packed.kind!r} came, which is not known here")
    settings = kind.settings.model_validate_json(packed.settings)
    return masked(kind.make_all(packed.tensors, settings, packed.identifier), packed.movable)
