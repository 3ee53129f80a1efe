"""The laws of the kick experiment: what each one begins with, and its learner."""

from collections.abc import Callable, Mapping
from contextlib import ExitStack

from orbitfb.core.ports import Policy
from orbitfb.core.refit import RefitReport
from orbitfb.evaluate.kick.settings import KickSettings, Law, Responses
from orbitfb.history.buffer import History
from orbitfb.learn.builders import builder, first_policy
from orbitfb.learn.messages import TrainerJob
from orbitfb.learn.process import ProcessTrainer
from orbitfb.learn.settings import LearnSettings
from orbitfb.learn.worker import LearnerThread
from orbitfb.loop.slot import PolicySlot
from orbitfb.models.identify import Identifier
from orbitfb.policies.settings import PolicySettings

_POLL = 0.02

LABELS: Mapping[Law, str] = {
    "svd": "SVD on the wrong R, frozen",
    "told": "SVD told the true R",
    "adaptive": "SVD on the wrong R, learning",
    "network": "network on the wrong R, learning",
    "told-network": "network told the true R",
}
LEARNING: frozenset[Law] = frozenset(("adaptive", "network"))
TOLD: frozenset[Law] = frozenset(("told", "told-network"))


def learn_settings(settings: KickSettings, known: Responses) -> LearnSettings:
    """Give the learner of the experiment: as configured, or with the error as its prior.

    Args:
        settings: The experiment.
        known: The responses.
    """
    learn = settings.learn
    if settings.prior == "configured":
        return learn
    entry, relative = known.error_scales(settings)
    prior = {"prior_entry": entry, "prior_relative": relative}
    return learn.model_copy(update={"identify": learn.identify.model_copy(update=prior)})


def policy_settings(law: Law, settings: KickSettings) -> PolicySettings:
    """Give the kind of policy that a law is."""
    kind = settings.network_kind if law in ("network", "told-network") else "svd"
    return settings.policy.model_copy(update={"kind": kind})


def opening_policy(law: Law, settings: KickSettings, known: Responses) -> Policy:
    """Give the policy that a law begins with.

    Those that learn begin with what the learner's prior calls for, the others without caution.

    Args:
        law: Which one.
        settings: The experiment.
        known: The responses.
    """
    policy = policy_settings(law, settings)
    begun = first_policy(known.true if law in TOLD else known.believed, policy)
    if law not in LEARNING:
        return begun
    learn = learn_settings(settings, known)
    prior = Identifier(known.believed, learn.identify).model
    return builder(policy, seed=settings.seed)(prior, begun)


def start_learner(
    law: Law,
    settings: KickSettings,
    known: Responses,
    history: History,
    slot: PolicySlot,
    publish: Callable[[RefitReport], None],
    tripped: Callable[[], bool],
    stack: ExitStack,
) -> None:
    """Start the learner of a law that has one, in a process of its own.

    Args:
        law: Which one.
        settings: The experiment.
        known: The responses.
        history: The last transitions.
        slot: The policy in force.
        publish: Gets every report.
        tripped: Whether the loop has tripped.
        stack: Stops it.
    """
    if law not in LEARNING:
        return
    job = TrainerJob(
        learn_settings(settings, known),
        policy_settings(law, settings),
        known.believed,
        seed=settings.seed,
    )
    thread = LearnerThread(ProcessTrainer(job), history, slot, publish, poll=_POLL, tripped=tripped)
    thread.start()
    stack.callback(thread.stop)
