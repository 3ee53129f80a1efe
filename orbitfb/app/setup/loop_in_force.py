"""The loop that a service of a configuration would begin with, before there is one."""

from orbitfb.app.setup.stored_policies import movable, open_store
from orbitfb.config.tree import AppConfig
from orbitfb.core.errors import RingError, StoreError
from orbitfb.learn.builders import first_policy, masked
from orbitfb.measure.growth import Loop
from orbitfb.measure.response_file import nominal_response
from orbitfb.physics.places import Ring


def loop_of(config: AppConfig, ring: Ring) -> Loop:
    """Give the loop that a service of this configuration would begin with.

    It has the policy in force of the store. Where none is in force, or none that fits the ring, it
    has the one that the configuration makes at once: an SVD law in place of one that is trained
    for minutes, and the optics in place of a response that cannot be used.

    Args:
        config: The configuration.
        ring: The ring.

    Raises:
        ConfigError: A masked name is not of this ring.
    """
    channels, store = ring.channels(config.ring.planes), open_store(config)
    try:
        active = store.active()
        if active is not None:
            policy = masked(store.load(active, channels), movable(config, ring))
            return Loop(policy, f"policy {active}, which is in force,")
    except StoreError:
        pass  # the start of a service says what is wrong with it
    settings = config.policy
    if settings.kind == "supervised":
        settings = settings.model_copy(update={"kind": "svd"})
    given, planes = config.ring.response, config.ring.planes
    try:
        matrix = nominal_response(ring, planes, given, config.masks)
    except RingError:  # the start of a service refuses it; a new one is measured in its place
        given, matrix = None, nominal_response(ring, planes, None, config.masks)
    name = {"svd": "SVD"}.get(settings.kind, settings.kind)
    on = "the optics" if given is None else given.name
    policy = first_policy(matrix, settings, movable(config, ring))
    return Loop(policy, f"the configured {name} loop on {on}")
