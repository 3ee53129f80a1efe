"""What the command line does to policies and archives, with a service running or without."""

import hashlib
import time
from collections.abc import Callable
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from orbitfb.app.setup.frequency import archived_rf
from orbitfb.config.tree import AppConfig
from orbitfb.control.client import ask, is_running
from orbitfb.core.errors import ConfigError, OrbitFeedbackError, StoreError
from orbitfb.core.refit import Decision
from orbitfb.core.signals import Mask, Vector
from orbitfb.core.transitions import Transitions
from orbitfb.estimation.columns import KnownRf
from orbitfb.history.archive import read_archive
from orbitfb.learn.builders import ResponsePolicy, builder, first_policy, masked
from orbitfb.learn.messages import TrainerJob, learner_of
from orbitfb.learn.process import ProcessTrainer
from orbitfb.learn.trainer import InlineTrainer, Trainer
from orbitfb.loop.guard import Safeguards
from orbitfb.measure.response_file import nominal_response
from orbitfb.observe.plain import plain
from orbitfb.physics.places import Ring
from orbitfb.policies.failures import Failure
from orbitfb.policies.masking import mask_of, without
from orbitfb.policies.settings import LINEAR
from orbitfb.policies.stability import is_unstable, warning_of
from orbitfb.policies.store.directory import PolicyStore
from orbitfb.policies.svd import SvdPolicy
from orbitfb.sim.job import SimJob

REFIT_TIMEOUT = 60.0
"""How long the command line waits for a running service to refit [s]."""
TOLD_TIMES = 10
"""How often a training before the loop says how far it is."""


def open_store(config: AppConfig) -> PolicyStore:
    """Open the policy store of the data directory."""
    return PolicyStore(config.data_directory / "policies")


def movable(config: AppConfig, ring: Ring) -> Mask | None:
    """Say which correctors may move, shape (m,); None: all.

    Raises:
        ConfigError: A masked name is not of this ring.
    """
    mask = mask_of(ring.channels(config.ring.planes), config.masks)[1]
    return None if mask.all() else mask


def baseline(
    config: AppConfig, ring: Ring, say: Callable[[str], None] = lambda _: None
) -> ResponsePolicy:
    """Build the policy on the nominal response of the ring.

    Args:
        config: The kind and its settings; the response, if it was measured.
        ring: The ring.
        say: Told how far it is, where that takes its time: a kind that is trained.
    """
    matrix = nominal_response(ring, config.ring.planes, config.ring.response, config.masks)
    kind, total, begun = config.policy.kind, config.policy.supervised.iterations, time.monotonic()
    if kind == "supervised":
        say(f"training the first policy ({kind}): {total} iterations")

    def progress(done: int, loss: float) -> None:
        if done == 1 or done * TOLD_TIMES // total > (done - 1) * TOLD_TIMES // total:
            say(
                f"training the first policy ({kind}): {done} of {total} iterations, loss {loss:.3g}"
            )

    policy = first_policy(matrix, config.policy, movable(config, ring), progress)
    if kind == "supervised":
        say(f"training the first policy ({kind}) took {time.monotonic() - begun:.0f} s")
    return policy


def check_policy(nominal: ResponsePolicy, config: AppConfig) -> None:
    """Refuse settings of a linear law that no ring of this response could bear.

    A trained kind is not asked: what a training made is told where it is stored and started.

    Args:
        nominal: The policy on the nominal response.
        config: Names its kind.

    Raises:
        ConfigError: The loop would run away.
    """
    kind = config.policy.kind
    if kind in LINEAR and is_unstable(warning := warning_of(nominal)):
        raise ConfigError(f"policy.{kind}: {warning}; set smaller gains")


def safeguards(nominal: ResponsePolicy, config: AppConfig, mask: Mask) -> Safeguards:
    """Give the loop the SVD baseline to fall back on, and the means to leave correctors out.

    Args:
        nominal: The policy on the nominal response.
        config: The settings of the SVD policy.
        mask: Correctors that may move, shape (m,).
    """
    svd = SvdPolicy(nominal.response, config.policy.svd)
    return Safeguards(masked(svd, mask), without)


def trainer(config: AppConfig, matrix: Vector, mask: Mask, rf: KnownRf | None = None) -> Trainer:
    """Start whoever does the learner's arithmetic.

    Args:
        config: Says whether in a process of its own.
        matrix: R̂ to begin with, shape (n, m) [m/A].
        mask: Correctors that may move, shape (m,).
        rf: What is told of the RF; None: the loop leaves it alone.
    """
    job = TrainerJob(
        config.learn, config.policy, matrix, mask, config.seed, config.loop.rate_hz, rf
    )
    return ProcessTrainer(job) if config.learn.process else InlineTrainer(learner_of(job))


def sim_job(config: AppConfig) -> SimJob:
    """Return what the soft IOC's process must know."""
    return SimJob(
        places=config.ring.places,
        parameters=config.ring.parameters,
        planes=config.ring.planes,
        seed=config.seed,
        plant=config.plant,
        effects=config.effect,
        period=config.loop.period if config.sim.lockstep else None,
        sim=config.sim,
    )


def refit_online(config: AppConfig, activate: bool) -> dict[str, Any]:
    """Have the running service refit now.

    Raises:
        ControlError: None runs on this data directory.
    """
    return ask(
        config.data_directory, {"command": "refit", "activate": activate}, timeout=REFIT_TIMEOUT
    )


def refit_offline(config: AppConfig, archive: Path, activate: bool) -> dict[str, Any]:
    """Refit from an archive, starting from the policy in force; store an accepted candidate.

    Args:
        config: Names the ring and the store.
        archive: A segment, or a directory of them.
        activate: Put the candidate in force if the judge accepts it.

    Raises:
        ArchiveError: The archive cannot be read or is of another ring.
    """
    from orbitfb.learn.learner import Learner

    ring = config.ring.load()
    channels = ring.channels(config.ring.planes)
    transitions = read_archive(archive, channels)
    store = open_store(config)
    active = store.active()
    mask = movable(config, ring)
    if active is None:
        incumbent = baseline(config, ring)
    else:
        incumbent = masked(store.load(active, channels), mask)
    learner = Learner(
        incumbent.response,
        config.learn,
        builder(config.policy, mask, config.seed),
        rf=archived_rf(config, ring, transitions),
    )
    report, candidate = learner.refit(transitions, incumbent, "on-demand")
    answer: dict[str, Any] = plain(asdict(report))
    if candidate is not None and report.decision is Decision.ACCEPTED:
        answer["stored"] = store.save(
            candidate,
            channels,
            parent=incumbent.policy_id,
            data_hash=data_hash(transitions),
            figures=report.figures,
        )
        if activate:
            answer |= activate_stored(config, candidate.policy_id)
            answer["decision"] = Decision.PROMOTED
    return answer


def data_hash(transitions: Transitions) -> str:
    """Name the data that a policy was fitted to."""
    digest = hashlib.sha256()
    for column in (transitions.time, transitions.orbit, transitions.applied):
        digest.update(np.ascontiguousarray(column).tobytes())
    return digest.hexdigest()


def list_policies(config: AppConfig) -> list[dict[str, Any]]:
    """List the stored policies, the oldest first; a damaged one is listed with its damage."""
    store = open_store(config)
    damage: list[StoreError] = []
    active, probation, failures = store.active(), store.probation(), store.failures()
    rows: list[dict[str, Any]] = [
        {
            "id": card.id,
            "kind": card.kind,
            "planes": card.planes,
            "created": datetime.fromtimestamp(card.created, UTC).isoformat(timespec="seconds"),
            "parent": card.parent,
            "active": card.id == active,
            "warning": card.warning,
            "failure": _failure_in_words(failures.get(card.id)),
            "probation": card.id == active and probation is not None,
            "damage": None,
        }
        for card in store.cards(damage.append)
    ]
    nothing = {
        "id": "?",
        "kind": "?",
        "planes": "?",
        "created": "",
        "parent": None,
        "active": False,
        "warning": None,
        "failure": None,
        "probation": False,
    }
    return rows + [{**nothing, "damage": str(error)} for error in damage]


def _failure_in_words(failure: Failure | None) -> str | None:
    """Say when a policy failed in force, and how; None: it did not."""
    if failure is None:
        return None
    when = datetime.fromtimestamp(failure.time, UTC).isoformat(timespec="seconds")
    return f"{when} {failure.words}"


def show_policy(config: AppConfig, policy_id: str) -> dict[str, Any]:
    """Return the card of a policy."""
    return open_store(config).card(policy_id).model_dump(mode="json")


def activate_stored(config: AppConfig, policy_id: str) -> dict[str, Any]:
    """Put a policy in force that was stored just now.

    Raises:
        StoreError: It was not; the message says under which id it lies, and why.
    """
    try:
        return activate_policy(config, policy_id)
    except OrbitFeedbackError as error:
        raise StoreError(
            f"policy {policy_id} is stored in {open_store(config).path}, but was not activated: "
            f"{error}"
        ) from error


def activate_policy(
    config: AppConfig, policy_id: str | None, force: bool = False
) -> dict[str, Any]:
    """Put a policy in force, in the running service too.

    Args:
        config: Names the store.
        policy_id: Which; None: the one that was active before.
        force: Even if a loop that is closed would run away with it, or if it failed before.

    Returns:
        `policy`, `before`, and `warning` where there is one.

    Raises:
        StoreError: There is no such policy, or it is damaged.
        ControlError: The running service refuses it.
    """
    request = {"command": "activate", "policy": policy_id, "force": force}
    if is_running(config.data_directory):
        return ask(config.data_directory, request)
    store = open_store(config)
    before = store.active()
    if policy_id is None:
        policy_id = store.rollback(force)
    else:
        store.activate(policy_id)
    answer = {"policy": policy_id, "before": before}
    warning = store.fault_of(policy_id)
    return answer | {"warning": warning} if warning else answer
