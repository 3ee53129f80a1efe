"""What came of a measurement: for its file, for people, for programs."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from orbitfb import __version__
from orbitfb.app.setup.stored_policies import activate_stored, movable, open_store
from orbitfb.config.tree import AppConfig
from orbitfb.core.signals import Channels, Mask, Vector
from orbitfb.learn.builders import first_policy
from orbitfb.measure.growth import Loop, growth_told
from orbitfb.measure.judging import Judgement
from orbitfb.measure.measurement import Result
from orbitfb.measure.response_file import adopted, read_response
from orbitfb.policies.masking import mask_of
from orbitfb.policies.settings import LINEAR


def about_of(
    config: AppConfig,
    result: Result,
    where: str,
    begin: float,
    end: float,
    rejected: int,
    channels: Channels,
) -> dict[str, Any]:
    """Say how it was measured, for the card of its file."""
    return {
        "created": end,
        "duration": end - begin,
        "ring": where,
        "method": "steps" if config.measure.at_once == 1 else "at once",
        "settings": config.measure.model_dump(mode="json"),
        "orbits_rejected": rejected,
        "check": {channels.setpoint_pvs[j]: apart for j, apart in result.check.items()},
        "version": __version__,
    }


def answer_of(
    result: Result,
    judgement: Judgement,
    nominal: Vector,
    counting: Mask,
    out: Path,
    about: dict[str, Any],
    channels: Channels,
    loop: Loop,
) -> dict[str, Any]:
    """Say what came of it, for people and programs."""
    table = result.table
    area = np.isfinite(table.response) & counting[:, None]
    size = float(np.sqrt(np.mean(table.response[area] ** 2)))
    return {
        "file": str(out),
        "correctors": int(table.measured.sum()),
        "not_measured": len(judgement.missing),
        "bad_correctors": judgement.correctors,
        "bad_bpms": judgement.bpms,
        "uncertainty": float(np.sqrt(np.mean(table.sigma[area] ** 2))) / size,
        "noise_um": float(np.nanmedian(table.noise)) * 1e6,
        "from_optics": float(
            np.linalg.norm((table.response - nominal)[area]) / np.linalg.norm(nominal[area])
        ),
        "loop": growth_told(np.where(area, table.response, np.nan), nominal, channels, loop),
        "check": about["check"],
        "orbits_rejected": about["orbits_rejected"],
        "duration_s": about["duration"],
    }


def offered(
    config: AppConfig, answer: Mapping[str, Any], channels: Channels
) -> tuple[dict[str, Any], str]:
    """Make a policy of a matrix that was just measured and store it; nothing is put in force.

    Args:
        config: Names the kind of policy.
        answer: What came of the measurement.
        channels: Of the ring.

    Returns:
        Id of the policy, if one was stored, and what to tell people.

    Raises:
        OrbitFeedbackError: The matrix cannot be used as it is.
    """
    out = Path(answer["file"])
    told = f"{answer['correctors']} correctors in {answer['duration_s']:.0f} s: {out}"
    bad = len(answer["bad_correctors"]), len(answer["bad_bpms"])
    if any(bad):
        told += f"; {bad[0]} correctors and {bad[1]} BPMs are bad: see `measure` and its file"
        return {}, f"{told}; repair or mask them, then measure again"
    if config.policy.kind not in LINEAR:
        return {}, f"{told}; set ring.response to it and train a policy: `orbitfb train`"
    counting, moving = mask_of(channels, config.masks)
    policy, _ = _stored(config, out, channels, counting, moving)
    advice = f"`orbitfb policies activate {policy}` (or PV Activate-Cmd) puts it in force"
    return {"policy": policy}, f"{told}; stored as policy {policy}, {advice}"


def activate(
    config: AppConfig, out: Path, channels: Channels, counting: Mask, moving: Mask
) -> dict[str, Any]:
    """Make a policy of a measured matrix and put it in force; refused if anything is bad."""
    policy, stored = _stored(config, out, channels, counting, moving)
    return {"stored": stored, **activate_stored(config, policy)}


def _stored(
    config: AppConfig, out: Path, channels: Channels, counting: Mask, moving: Mask
) -> tuple[str, Any]:
    """Make a policy of a measured matrix and store it; give its id and where it is."""
    matrix = adopted(read_response(out, channels), out, channels, counting, moving)
    policy = first_policy(matrix, config.policy, movable(config, config.ring.load()))
    stored = open_store(config).save(policy, channels, training={"measured": str(out)})
    return policy.policy_id, stored
