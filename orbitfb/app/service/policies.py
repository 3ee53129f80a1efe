"""The policies of a service: the store, the one that the configuration makes, the one in force."""

from collections.abc import Callable
from dataclasses import dataclass

from orbitfb.app.commands.known_response import KnownResponse
from orbitfb.app.service.access import RingAccess
from orbitfb.app.service.active_policy import Keeper
from orbitfb.app.service.reports import say_and_log
from orbitfb.app.setup.stored_policies import baseline, check_policy, open_store
from orbitfb.config.tree import AppConfig
from orbitfb.core.errors import ConfigError
from orbitfb.core.signals import Channels, LoopState
from orbitfb.estimation.columns import KnownRf
from orbitfb.learn.builders import ResponsePolicy
from orbitfb.loop.slot import PolicySlot
from orbitfb.physics.places import Ring
from orbitfb.policies.rf_known import told
from orbitfb.policies.stability import unstable_on
from orbitfb.policies.store.directory import PolicyStore


@dataclass(frozen=True, slots=True)
class Policies:
    """What there is to correct with.

    Args:
        store: The policy store.
        keeper: Keeps it in step with the policy in force.
        nominal: What the configuration makes of the response.
        first: The policy that the loop begins with.
        slot: Where the loop takes its policy from.
        measured: The response that was measured, if one was.
    """

    store: PolicyStore
    keeper: Keeper
    nominal: ResponsePolicy
    first: ResponsePolicy
    slot: PolicySlot
    measured: KnownResponse


def choose_policies(
    config: AppConfig,
    ring: Ring,
    channels: Channels,
    access: RingAccess,
    start: LoopState,
    asked: bool,
    say: Callable[[str], None],
    rf: KnownRf | None = None,
) -> Policies:
    """Open the store and choose the policy that the loop begins with.

    Args:
        config: The configuration.
        ring: The ring.
        channels: Of the loop.
        access: The ring as the service reaches it.
        start: State to start in.
        asked: Whether the kind of policy was asked for at this start.
        say: Gets a line now and then about what takes long.
        rf: What is told of the RF; None: the loop leaves it alone.

    Raises:
        OrbitFeedbackError: The store or the response cannot be read, or the loop would start
            closed with a policy that runs away.
    """
    store = open_store(config)
    keeper = Keeper(store, channels, config.policies_kept, watches=config.learn.enabled)
    nominal = baseline(config, ring, lambda line: say_and_log(say, line))
    check_policy(nominal, config)
    first = told(keeper.first(nominal, access.movable, access.own is not None, asked), rf)
    measured = nominal.response if config.ring.response is not None else None
    lost = "" if measured is None else unstable_on(first, measured)
    if lost and start is LoopState.CLOSED:
        raise ConfigError(f"the loop does not start closed: policy {first.policy_id} {lost}")
    return Policies(store, keeper, nominal, first, PolicySlot(first), KnownResponse(measured))
