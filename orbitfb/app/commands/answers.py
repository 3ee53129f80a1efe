"""What a running service does when a command line asks it over the control socket."""

from collections.abc import Callable, Mapping
from concurrent.futures import CancelledError, Future
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from orbitfb.app.commands.known_response import KnownResponse
from orbitfb.core.errors import ControlError
from orbitfb.core.ports import Policy
from orbitfb.core.signals import Channels, LoopState
from orbitfb.learn.worker import LearnerThread
from orbitfb.loop.runner import Runner
from orbitfb.loop.slot import PolicySlot
from orbitfb.loop.states import Event
from orbitfb.observe.plain import plain
from orbitfb.observe.statistics.running import LoopStatistics
from orbitfb.observe.statistics.summary import summary
from orbitfb.policies.stability import is_unstable, unstable_on, warning_of
from orbitfb.policies.store.directory import PolicyStore
from orbitfb.policies.store.kinds import StoredPolicy

LONGEST_PATIENCE = 25.0
"""Whoever asks waits a little longer [s]."""
REFIT_TIMEOUT = 50.0
"""How long a refit may take; whoever asks waits a little longer [s]."""


@dataclass(frozen=True, slots=True)
class Remote:
    """Answers requests; called from the control socket's threads.

    Args:
        runner: The loop.
        statistics: Its figures.
        slot: The policy in force.
        store: The policies.
        learner: The learner's thread; None when it is off.
        channels: The ring.
        archive: Where the archive lies, for advice.
        period: Of the loop [s]; a command takes effect at a tick, so it waits for a few.
        dress: Makes of a stored policy the one that may act: masked correctors do not move.
        freeze: Freezes the last seconds to a file, for who asks; None when that is off.
        measured: The response that was measured, if one was.
    """

    runner: Runner
    statistics: LoopStatistics
    slot: PolicySlot
    store: PolicyStore
    learner: LearnerThread | None
    channels: Channels
    archive: Path
    period: float
    dress: Callable[[StoredPolicy], Policy] = lambda policy: policy
    freeze: Callable[[str], Future[Path]] | None = None
    measured: KnownResponse = field(default_factory=KnownResponse)

    def __call__(self, request: Mapping[str, Any]) -> Mapping[str, Any]:
        """Carry out a request.

        Raises:
            ControlError: It is unknown, or refused.
            StoreError: The policy is missing, damaged, or of another ring.
        """
        name = request.get("command")
        if name == "status":
            return {**summary(self.statistics.snapshot()), **self._restraint()}
        if name == "refit":
            return self._refit(request.get("activate") is True)
        if name == "activate":
            return self._activate(request.get("policy"), request.get("force") is True)
        if name == "postmortem":
            return self._freeze()
        return self._command(str(name))

    def _restraint(self) -> Mapping[str, Any]:
        wanted, planes = self.runner.adjustments, self.channels.planes
        bands = wanted.dead_band or (0.0,) * len(planes)
        return {
            "average_orbits": wanted.average,
            "dead_band_um": {its: band * 1e6 for its, band in zip(planes, bands, strict=True)},
        }

    def _freeze(self) -> Mapping[str, Any]:
        if self.freeze is None:
            raise ControlError(
                "post-mortems of this service are off (postmortem.enabled); its archive is in "
                f"{self.archive}"
            )
        try:
            path = self.freeze("asked for by the command postmortem").result(LONGEST_PATIENCE)
        except TimeoutError:
            raise ControlError(
                f"the post-mortem is not on disk after {LONGEST_PATIENCE:g} s; it is written as "
                "soon as the disk takes it"
            ) from None
        return {"postmortem": str(path)}

    def _command(self, name: str) -> Mapping[str, Any]:
        if name == Event.CLOSE:
            policy = self.slot.current
            if problem := self._lost(policy):
                raise ControlError(f"close refused: policy {policy.policy_id} {problem}")
        patience = min(max(5.0, 3 * self.period), LONGEST_PATIENCE)
        future = self.runner.command(name)
        try:
            state = future.result(patience)
        except TimeoutError:
            # A command that was told to have failed must not be carried out later.
            if future.cancel():
                raise ControlError(
                    f"{name}: no tick came within {patience:g} s, the command is withdrawn; the "
                    f"loop is {self.runner.state}: {self.runner.reason}"
                ) from None
            state = future.result(patience)
        return {"state": state, "reason": self.runner.reason}

    def _lost(self, policy: Policy) -> str:
        """Say that a policy would lose the beam on the measured response; "" where it would not."""
        matrix = self.measured.matrix
        return "" if matrix is None else unstable_on(policy, matrix)

    def _refit(self, activate: bool) -> Mapping[str, Any]:
        if self.learner is None:
            raise ControlError(
                "the learner of this service is off (learn.enabled); refit from its archive: "
                f"orbitfb refit --from {self.archive}"
            )
        try:
            report = self.learner.request(activate).result(REFIT_TIMEOUT)
        except TimeoutError:
            raise ControlError(f"the refit is not done after {REFIT_TIMEOUT} s") from None
        except CancelledError:
            raise ControlError("the service stopped before the refit was made") from None
        return plain(asdict(report))

    def _activate(self, policy_id: object, force: bool) -> Mapping[str, Any]:
        back = policy_id is None
        if back:
            policy_id = self.store.previous(force)
        if not isinstance(policy_id, str):
            raise ControlError(f"{policy_id!r} is no policy id")
        # Whatever is refused is refused before anything changes.
        policy = self.dress(self.store.load(policy_id, self.channels))
        failure = self.store.failures().get(policy_id)
        unstable = warning_of(policy)
        lost = self._lost(policy)
        warning = "; ".join(filter(None, (failure.words if failure else "", unstable, lost)))
        barred = failure is not None or is_unstable(unstable) or bool(lost)
        if barred and not force and self.runner.state in (LoopState.CLOSED, LoopState.HELD):
            raise ControlError(
                f"policy {policy_id}: {warning}; the loop is {self.runner.state}, so that it "
                "would act at once: open the loop first, or insist with `orbitfb policies "
                f"{'rollback' if back else f'activate {policy_id}'} --force`"
            )
        if back:
            self.store.rollback(force)
        else:
            self.store.activate(policy_id)
        before = self.slot.swap(policy)
        answer = {"policy": policy_id, "before": before.policy_id}
        return answer | {"warning": warning} if warning else answer
