"""What the command line does to policies and archives, with a service running or without."""

import hashlib
from collections.abc import Callable
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orbitfb.config import AppConfig
from orbitfb.control import ask, is_running
from orbitfb.core.errors import StoreError
from orbitfb.core.ports import Policy
from orbitfb.core.refit import Decision
from orbitfb.core.transitions import Transitions
from orbitfb.history.archive import read_archive
from orbitfb.learn.learner import Learner
from orbitfb.observe.plain import plain
from orbitfb.physics.places import Ring
from orbitfb.physics.response import response
from orbitfb.policies.store import PolicyStore
from orbitfb.policies.svd import SvdPolicy
from orbitfb.sim.job import SimJob

REFIT_TIMEOUT = 60.0
"""How long the command line waits for a running service to refit [s]."""

Matrix = NDArray[np.float64]


def open_store(config: AppConfig) -> PolicyStore:
    """Open the policy store of the data directory."""
    return PolicyStore(config.data_directory / "policies")


def policy_builder(config: AppConfig) -> Callable[[Matrix, Matrix | None], Policy]:
    """Return how a policy is made from R̂ (n, m) [m/A] and its covariance."""
    return lambda matrix, covariance: SvdPolicy(matrix, config.policy, covariance=covariance)


def baseline(config: AppConfig, ring: Ring) -> SvdPolicy:
    """Build the policy on the nominal response of the ring."""
    return SvdPolicy(response(ring, config.ring.planes), config.policy)


def sim_job(config: AppConfig) -> SimJob:
    """Return what the soft IOC's process must know."""
    return SimJob(
        places=config.ring.places,
        parameters=config.ring.parameters,
        planes=config.ring.planes,
        seed=config.seed,
        plant=config.plant,
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
    incumbent = baseline(config, ring) if active is None else store.load(active, channels)
    learner = Learner(incumbent.response, config.learn, policy_builder(config))
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
