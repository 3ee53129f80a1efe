"""What the command line does to policies and archives, with a service running or without."""

import hashlib
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from orbitfb.config import AppConfig
from orbitfb.control import ask, is_running
from orbitfb.core.errors import StoreError
from orbitfb.core.refit import Decision
from orbitfb.core.signals import Mask, Vector
from orbitfb.core.transitions import Transitions
from orbitfb.history.archive import read_archive
from orbitfb.learn.builders import ResponsePolicy, builder, first_policy, masked
from orbitfb.learn.learner import Learner
from orbitfb.learn.messages import TrainerJob, learner_of
from orbitfb.learn.process import ProcessTrainer
from orbitfb.learn.trainer import InlineTrainer, Trainer
from orbitfb.observe.plain import plain
from orbitfb.physics.places import Ring
from orbitfb.physics.response import response
from orbitfb.policies.masking import mask_of
from orbitfb.policies.store import PolicyStore
from orbitfb.sim.job import SimJob

REFIT_TIMEOUT = 60.0
"""How long the command line waits for a running service to refit [s]."""


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


def baseline(config: AppConfig, ring: Ring) -> ResponsePolicy:
    """Build the policy on the nominal response of the ring."""
    matrix = response(ring, config.ring.planes)
    return first_policy(matrix, config.policy, movable(config, ring))


def trainer(config: AppConfig, matrix: Vector, mask: Mask) -> Trainer:
    """Start whoever does the learner's arithmetic.

    Args:
        config: Says whether in a process of its own.
        matrix: R̂ to begin with, shape (n, m) [m/A].
        mask: Correctors that may move, shape (m,).
    """
    job = TrainerJob(config.learn, config.policy, matrix, mask, config.seed, config.loop.rate_hz)
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
    learner = Learner(incumbent.response, config.learn, builder(config.policy, mask, config.seed))
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
            answer |= activate_policy(config, candidate.policy_id)
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
    active = store.active()
    rows: list[dict[str, Any]] = [
        {
            "id": card.id,
            "kind": card.kind,
            "created": datetime.fromtimestamp(card.created, UTC).isoformat(timespec="seconds"),
            "parent": card.parent,
            "active": card.id == active,
            "damage": None,
        }
        for card in store.cards(damage.append)
    ]
    nothing = {"id": "?", "kind": "?", "created": "", "parent": None, "active": False}
    return rows + [{**nothing, "damage": str(error)} for error in damage]


def show_policy(config: AppConfig, policy_id: str) -> dict[str, Any]:
    """Return the card of a policy."""
    return open_store(config).card(policy_id).model_dump(mode="json")


def activate_policy(config: AppConfig, policy_id: str | None) -> dict[str, Any]:
    """Put a policy in force, in the running service too.

    Args:
        config: Names the store.
        policy_id: Which; None: the one that was active before.

    Raises:
        StoreError: There is no such policy, or it is damaged.
    """
    request = {"command": "activate", "policy": policy_id}
    if is_running(config.data_directory):
        return ask(config.data_directory, request)
    store = open_store(config)
    before = store.active()
    if policy_id is None:
        policy_id = store.rollback()
    else:
        store.activate(policy_id)
    return {"policy": policy_id, "before": before}
