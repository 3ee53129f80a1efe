"""The ring as a service reaches it: simulated or real, leased, limited, without masked devices."""

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass

from orbitfb.app.service.reports import say_and_log
from orbitfb.app.setup.frequency import with_rf
from orbitfb.app.setup.lease import take_lease
from orbitfb.app.setup.simulated_ring import SimulatedRing
from orbitfb.app.setup.startup import SIMULATED, take_ring
from orbitfb.app.setup.stored_policies import sim_job
from orbitfb.config.tree import AppConfig
from orbitfb.core.ports import Clock, Machine
from orbitfb.core.signals import Channels, Mask
from orbitfb.epics.lease.lease import Lease
from orbitfb.epics.machine import EpicsMachine
from orbitfb.epics.settings import EpicsSettings
from orbitfb.loop.machines.guarded import GuardedMachine
from orbitfb.loop.machines.masked import MaskedMachine
from orbitfb.loop.machines.stepped import rounding_told, stepped
from orbitfb.physics.places import Ring
from orbitfb.physics.response import response
from orbitfb.policies.masking import mask_of
from orbitfb.safety.bounds import Bounds, narrower


@dataclass(frozen=True, slots=True)
class RingAccess:
    """The ring as a service reaches it.

    Args:
        epics: How Channel Access finds it.
        own: The simulated ring of our own; None: the ring runs elsewhere.
        lease: Of the machine; None: there is none.
        machine: The ring itself.
        guarded: The ring as the loop has it: not written to without the lease, without the BPMs
            that are masked.
        counting: BPMs that are not masked by configuration, shape (n,).
        movable: Correctors that are not, shape (m,).
        limit: Largest setpoint by configuration [A].
    """

    epics: EpicsSettings
    own: SimulatedRing | None
    lease: Lease | None
    machine: EpicsMachine
    guarded: Machine
    counting: Mask
    movable: Mask
    limit: float

    @property
    def place(self) -> str:
        """The machine, as messages and journals call it."""
        return f"{self.epics.searched}:{self.epics.server_port}"

    @property
    def failure(self) -> str:
        """Why the simulated ring of our own died; empty while it lives or where there is none."""
        return self.own.failure if self.own is not None else ""

    def bounds(self) -> Bounds:
        """Give the limits of the setpoints that are in force: ours, and those of the drives."""
        machine = self.machine
        return Bounds.of(self.limit, len(machine.channels.correctors), machine.drive_limits)

    def obstacle(self) -> str:
        """Say why the machine must not be written to now; empty when it may."""
        return self.lease.refusal() if self.lease is not None else ""


def reach_ring(
    config: AppConfig,
    ring: Ring,
    channels: Channels,
    epics: EpicsSettings,
    ioc: str,
    follows: bool,
    lost: Callable[[str], None],
    clock: Clock,
    stack: ExitStack,
    say: Callable[[str], None],
) -> RingAccess:
    """Start the simulated ring if it is ours, take the ring and its lease, and connect.

    Args:
        config: The configuration.
        ring: The ring.
        channels: Of the loop.
        epics: Where the ring is to be found.
        ioc: The same, as the command line calls it.
        follows: Whether the loop steps the RF frequency.
        lost: Told who took the lease.
        clock: The time.
        stack: Closes what is opened here, in reverse order.
        say: Gets a line about what narrows the limits, and about steps of the setpoints.

    Raises:
        OrbitFeedbackError: Somebody else has the ring or its lease, or it cannot be reached.
    """
    own = SimulatedRing(sim_job(config), stack) if ioc == SIMULATED else None
    if own is not None:
        epics = own.settings(config)
    if follows:
        epics = with_rf(epics, config)
    take_ring(epics, channels, stack)
    lease = take_lease(config, epics, lost, stack)
    counting, movable = mask_of(channels, config.masks)
    rf_pv = config.rf.setpoint_pv if follows else ""
    fast = config.fast_feedback if config.fast_feedback.reference_pvs else None
    machine = EpicsMachine(channels, epics, clock, counting, movable, rf_pv, fast)
    stack.callback(machine.close)
    limit = config.limits.setpoint
    if told := narrower(limit, machine.drive_limits, channels.correctors):
        say_and_log(say, told)
    steps = machine.steps
    if told := rounding_told(steps, response(ring, config.ring.planes), channels.setpoint_pvs):
        say_and_log(say, told)
    guarded = stepped(machine, steps, limit, lambda: machine.drive_limits)
    if lease is not None:
        guarded = GuardedMachine(guarded, lease.refusal)
    if not counting.all():
        guarded = MaskedMachine(guarded, counting)
    return RingAccess(epics, own, lease, machine, guarded, counting, movable, limit)
