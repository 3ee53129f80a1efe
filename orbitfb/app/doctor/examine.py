"""Everything in its order; what cannot be looked at, because something before failed, is said."""

from pathlib import Path
from typing import Any

from orbitfb.app.doctor.clock import look_at_clock
from orbitfb.app.doctor.files import look_at_files
from orbitfb.app.doctor.finding import Finding, Verdict
from orbitfb.app.doctor.network import look_at_environment, look_at_ports
from orbitfb.app.doctor.program import look_at_program
from orbitfb.app.doctor.ring import look_at_ring
from orbitfb.config.load import load_config
from orbitfb.config.tree import AppConfig
from orbitfb.core.errors import OrbitFeedbackError
from orbitfb.measure.response_file import nominal_response
from orbitfb.physics.places import Ring
from orbitfb.policies.masking import mask_of
from orbitfb.policies.store.directory import PolicyStore

_PART = "configuration"


def examine(
    path: Path | None, options: dict[str, Any], ioc: str | None, live: bool, deadline: float
) -> list[Finding]:
    """Look at everything.

    Args:
        path: Configuration file, or None.
        options: Options of the command line by dotted path.
        ioc: The ring to ask, or None.
        live: Whether a machine may be asked.
        deadline: How long its PVs are waited for [s].

    Returns:
        What was found, in the order in which it was looked at.

    Raises:
        ConfigError: The ring is not to be asked without `--live`.
    """
    found = [*look_at_program()]
    config, ring, about = _configuration(path, options)
    found += about
    found += look_at_files(config, ring)
    found += look_at_clock()
    found += look_at_environment()
    running = any(each.figures.get("running") for each in found)
    found += look_at_ports(config, running)
    if ring is None or about[0].verdict is Verdict.FAILED:
        told = "the configuration or the ring's tables are wrong, see above"
        found.append(Finding("ring", "PVs", Verdict.SKIPPED, told))
    else:
        found += look_at_ring(config, ring, ioc, live, deadline)
    return found


def _configuration(
    path: Path | None, options: dict[str, Any]
) -> tuple[AppConfig, Ring | None, list[Finding]]:
    """Read what is configured, as far as it can be; the rest has its defaults."""
    origin = str(path) if path else "defaults and environment"
    ring: Ring | None = None
    try:
        config = load_config(path, options)
    except OrbitFeedbackError as error:
        failed = Finding(_PART, "file", Verdict.FAILED, str(error), "correct it; what follows is "
                         "looked at with the defaults")  # fmt: skip
        return AppConfig(), None, [failed]
    found = [Finding(_PART, "file", Verdict.OK, origin)]
    try:
        ring = config.ring.load()
        channels = ring.channels(config.ring.planes)
        mask_of(channels, config.masks)
        nominal_response(ring, config.ring.planes, config.ring.response, config.masks)
        told = f"{len(channels.bpms)} BPMs, {len(channels.correctors)} correctors"
        told += f", planes {config.ring.planes}"
        if config.ring.response is not None:
            told += f", measured response {config.ring.response}"
        found.append(Finding(_PART, "ring", Verdict.OK, told))
    except OrbitFeedbackError as error:
        found.append(Finding(_PART, "ring", Verdict.FAILED, str(error), "correct it"))
    store = PolicyStore(config.data_directory / "policies")
    try:
        active = store.active()
        if active is not None and ring is not None:
            store.load(active, ring.channels(config.ring.planes))
        told = f"{active} is active" if active else "none yet: `orbitfb run` stores its baseline"
        found.append(Finding(_PART, "policy", Verdict.OK, told))
    except OrbitFeedbackError as error:
        found.append(
            Finding(_PART, "policy", Verdict.FAILED, str(error), "`orbitfb policies rollback`")
        )
    return config, ring, found
