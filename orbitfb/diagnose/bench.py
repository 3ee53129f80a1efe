"""A record under a set of causes: what is left, how likely it is, which way it would improve."""

import copy
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.background import Background
from orbitfb.diagnose.changed import Change, Explained
from orbitfb.diagnose.drift_memory import echoes
from orbitfb.diagnose.explain import Cause, actuated, explain, heard, restored
from orbitfb.diagnose.floor import estimate_floor
from orbitfb.diagnose.free import Beyond, Few, beyond, orthonormal
from orbitfb.diagnose.ground import settled
from orbitfb.diagnose.healthy_levels import HealthyLevels
from orbitfb.diagnose.healthy_search import HealthySearch
from orbitfb.diagnose.innovation import NoiseFloor
from orbitfb.diagnose.noise_modes import Ground, NoiseModes
from orbitfb.diagnose.quick import Quick, Single
from orbitfb.diagnose.standing import FreeSteps, stretches_across
from orbitfb.diagnose.uneven import uneven
from orbitfb.diagnose.unread import owed_for_unread
from orbitfb.physics.optics import Matrix
from orbitfb.records.record import Record

_PASSES = 2
_FEW_LEVELS = 4
"""Of the ladder, while orbit and floor are not yet what they will be."""
_REMEMBERED = 3
"""Sets of causes whose free drift is kept: the same few are judged again and again."""
SEEN = 1e-2
"""Gain of a step of the healthy errors below which they are the best, as a share of what they have
left of a change."""


@dataclass(frozen=True, slots=True, eq=False)
class _Base:
    """A record under the causes that stay, and its innovations of unit variance, (N, n)."""

    explained: Explained
    floor: NoiseFloor
    white: Matrix


class Bench:
    """The workplace of a diagnosis: a record, the causes accepted so far, floor and background.

    Args:
        record: What happened.
        causes: Accepted so far.
        floor: The noise, if a reference record tells it; estimated with the record otherwise.
        modes: Of the noise; None: found with the record, BPMs that differ in noise included.
        background: Scale of the healthy scatter of gains and gradients; 0: the model is exact.
        ground: How quadrupoles move, where modes are to be found; None: that is found too.

    Attributes:
        orbit: Predicted orbit at the BPMs, shape (N, n) [m].
        white: Innovations of unit variance under causes and background, in modes, shape (N, n).
        slope: λ, derivative of the log-likelihood by the prediction, shape (N, n) [1/m].
        sizes: Most likely errors of the background, in units of their scatter.
    """

    def __init__(
        self,
        record: Record,
        causes: Sequence[Cause] = (),
        floor: NoiseFloor | None = None,
        modes: NoiseModes | None = None,
        background: float = 1.0,
        ground: Ground | None = None,
    ) -> None:
        self.record = record
        self.causes = tuple(causes)
        self.scale = background
        self.told_floor = floor is not None
        alike = modes is None and floor is None
        modes = NoiseModes.of(record.layout, ground=ground or "alone") if modes is None else modes
        self._base: _Base | None = None
        self._in_single: Quick | None = None
        self._steps: FreeSteps | None = None
        self._freed: list[tuple[NoiseFloor, tuple[Cause, ...], Beyond, Matrix]] = []
        self.currents = actuated(record, self.causes)
        self.orbit = readings = restored(record, self.causes)[0]
        leftover = explain(record, self.causes, self.orbit)
        healthy, starts = np.zeros_like(record.readings), stretches_across(record, causes)
        for _ in range(_PASSES):
            self.floor = floor or estimate_floor(leftover.left - healthy, starts, modes)
            innovation, _ = self.floor.innovations(leftover.left - healthy, starts)
            moved = heard(record, self.causes, self.orbit)
            self.orbit = readings - moved - self.floor.to_bpms(innovation)
            leftover = explain(record, self.causes, self.orbit)
            self.background = Background(
                record.layout, self.currents, self.orbit, record.starts, background
            )
            self.background.prepare(self.floor, _FEW_LEVELS)
            self._healthy = HealthySearch(self._quick, self.background)
            white = self.floor.whiten(leftover.left, record.starts)
            self.sizes = self._healthy.healed(white, beyond(self.free_steps.basis(causes)))[1]
            healthy = self.background.orbit(self.sizes)
            if alike:
                left, its = leftover.left - healthy, self.floor
                if ground is None:
                    its = settled(left, starts, record.layout, its)
                modes = uneven(left, starts, record.layout, its)
        self.floor = floor or estimate_floor(leftover.left - healthy, starts, modes)
        self.background.prepare(self.floor)
        self._healthy = HealthySearch(self._quick, self.background)
        self._healthy.remember(self.sizes)
        self.white, self.sizes, self.jacobian = self.residual(())
        self._healthy.remember(self.sizes)
        self.slope = self.floor.adjoint(self.white, record.starts)

    def residual(self, causes: Sequence[Cause]) -> tuple[Matrix, Vector, Vector]:
        """Judge more causes on top of the accepted ones, with this floor.

        The sizes of the background are fitted anew.

        Returns:
            White innovations (N, n), sizes of the background (P,), log-Jacobian of the sensors'
            causes by row (N,): the log-likelihood is −½ Σ white² − ½ Σ sizes² + Σ log-Jacobian.
        """
        white, log_jacobian = self._with(causes)
        every = (*self.causes, *causes)
        kicks = self.free_steps.basis(every)
        without = beyond(kicks)
        left, sizes = self._healthy.healed(without(white), without)
        free, memory = without, echoes(self._quick, left.astype(np.float32))
        if len(memory):
            kept = [without(echo.reshape(left.shape)).reshape(-1) for echo in memory]
            free = beyond(kicks, Few(orthonormal(np.array(kept))))
            left, sizes = self._healthy.healed(free(white), free)
        self._freed = [*self._freed[1 - _REMEMBERED :], (self.floor, every, free, left)]
        for levels in self._levels(causes):
            left, owed = levels.likeliest(self.white, left)
            log_jacobian = log_jacobian + owed
        return left, sizes, log_jacobian

    def difference(
        self, causes: Sequence[Cause], others: Sequence[Cause]
    ) -> tuple[Matrix, Vector, Vector]:
        """What `residual` of some causes is more than that of others, however alike they are.

        The healthy errors do their best against the difference itself: what is left of it may be
        a small part, smaller than what they miss beside either.
        """
        (white, jacobian), (before, jacobian_before) = self._with(causes), self._with(others)
        free, left = self._free(others)
        moved, sizes = self._unhealed(free(white - before), free, SEEN)
        jacobian = jacobian - jacobian_before
        for levels in self._levels(others):
            moved, owed = levels.following(left, moved)
            jacobian = jacobian + owed
        return moved, sizes, jacobian

    def _levels(self, causes: Sequence[Cause]) -> list[HealthyLevels]:
        """What is free in the noise of BPMs whose readings causes change."""
        return HealthyLevels.of(self.record, self.floor, causes, self.white) if causes else []

    def granted(self, causes: Sequence[Cause], left: Matrix) -> float:
        """What is counted for no cause, as the levels of their BPMs' noise are free anyway [nats].

        A misfit of the orbit makes a BPM loud, so that this may be much: causes that leave the
        noise as it is are not charged with it.

        Args:
            causes: More causes.
            left: White innovations that they leave, as `residual` gives them, shape (N, n).
        """
        return sum(levels.granted(self.white, left) for levels in self._levels(causes))

    def roughly(self, causes: Sequence[Cause]) -> tuple[Matrix, Vector, Vector]:
        """As `residual`; memory, levels of noise and background as they are: a first look."""
        (white, log_jacobian), near = self._with(causes), self._healthy.nearby
        kicks = beyond(self.free_steps.basis((*self.causes, *causes)))
        return kicks(white - near.change), near.sizes, log_jacobian

    def _free(self, causes: Sequence[Cause]) -> tuple[Beyond, Matrix]:
        """What drift and first kicks are free to do beside causes, and what they leave.

        Of the last few it is known.
        """
        every = (*self.causes, *causes)
        for floor, known, free, left in self._freed:
            if floor is self.floor and known == every:
                return free, left
        self.residual(causes)
        return self._freed[-1][2], self._freed[-1][3]

    def _with(self, causes: Sequence[Cause]) -> tuple[Matrix, Vector]:
        """White innovations before healthy errors and what is free are taken out; log-Jacobian."""
        base = self._beside()
        if not causes:
            return base.white, base.explained.log_jacobian
        change = base.explained.change(causes)
        white = base.white + self._whitened(change)
        log_jacobian, healthy = change.log_jacobian, self._healthy.nearby.change
        for cause in causes:
            log_jacobian = log_jacobian - owed_for_unread(
                self.record, self.floor, cause, self.white, lambda: white - healthy, self._left
            )
        return white, log_jacobian

    def _left(self) -> Matrix:
        """What is left before it is whitened, healthy errors out of it, shape (N, n) [m]."""
        return self._beside().explained.left - self.background.orbit(self.sizes)

    def energy(self, change: Matrix) -> float:
        """Sum the squares of a change of the prediction as the noise sees it.

        Args:
            change: Shape (N, n) [m].
        """
        white = self._quick.whiten(change.astype(np.float32))
        return float(np.vdot(white, white))

    def information(self, change: Matrix) -> float:
        """Measure a change of the prediction, the healthy errors doing their best against it.

        Args:
            change: Shape (N, n) [m].

        Returns:
            |δ|²: half of it is the expected gain [nats].
        """
        white, sizes = self.unhealed(change)
        return float(np.sum(white**2) + np.sum(sizes**2))

    def unhealed(self, change: Matrix, missed: float = SEEN) -> tuple[Matrix, Vector]:
        """What healthy errors leave of a change of the prediction, and what they take for it.

        Args:
            change: Shape (N, n) [m].
            missed: Share of what they leave that they may still miss.

        Returns:
            White innovations (N, n), sizes of the background (P,).
        """
        free, _ = self._free(())
        return self._unhealed(free(self.floor.whiten(change, self.record.starts)), free, missed)

    def _unhealed(self, moved: Matrix, free: Beyond, missed: float) -> tuple[Matrix, Vector]:
        return self._healthy.against(moved, 0.0, free, share=missed)

    def _beside(self) -> "_Base":
        """What more causes are put beside, computed once for causes, orbit and floor."""
        known = self._base
        explained = None if known is None else known.explained
        if (
            explained is None
            or explained.causes is not self.causes
            or explained.orbit is not self.orbit
        ):
            explained, known = Explained(self.record, self.causes, self.orbit), None
        if known is None or known.floor is not self.floor:
            white = self.floor.whiten(explained.left, self.record.starts)
            known = self._base = _Base(explained, self.floor, white)
        return known

    @property
    def free_steps(self) -> FreeSteps:
        """First kicks under this floor."""
        if self._steps is None or self._steps.floor is not self.floor:
            self._steps = FreeSteps(self.record, self.floor)
        return self._steps

    @property
    def _quick(self) -> Quick:
        if self._in_single is None or self._in_single.floor is not self.floor:
            before = self._in_single
            same = before is not None and before.floor.modes is self.floor.modes
            modes = before.modes if before is not None and same else None
            self._in_single = Quick(self.floor, self.record.starts, modes)
        return self._in_single

    def _whitened(self, change: Change) -> Single:
        """Whiten what is left more: few columns of many as a rule."""
        quick, response = self._quick, self.record.layout.response
        if change.orbit is not None or 2 * len(change.bpms) > response.shape[0]:
            return quick.whiten(change.whole(response).astype(np.float32))
        modes = self.floor.modes.directions
        z = change.readings.astype(np.float32) @ modes[change.bpms].astype(np.float32)
        if len(change.correctors):
            made = (response[:, change.correctors].T @ modes).astype(np.float32)
            z -= change.currents.astype(np.float32) @ made
        return quick.whiten_modes(z)

    def with_floor(self, floor: NoiseFloor) -> "Bench":
        """The same causes judged under another floor; the background's information stays."""
        other = copy.copy(self)
        other.floor = floor
        other._healthy = HealthySearch(other._quick, self.background)
        other._healthy.remember(self.sizes)
        other.white, other.sizes, other.jacobian = other.residual(())
        other.slope = floor.adjoint(other.white, self.record.starts)
        return other

    def cleared_of(self, causes: Sequence[Cause]) -> "Bench":
        """The same causes judged with floor, orbit and healthy errors as further ones leave them.

        What a large cause has thrown off is all of these; a floor alone does not put it right.
        """
        floor = self.floor if self.told_floor else None
        every = (*self.causes, *causes)
        other = Bench(self.record, every, floor, self.floor.modes, self.scale)
        other.causes = self.causes
        other.white, other.sizes, other.jacobian = other.residual(())
        other.slope = other.floor.adjoint(other.white, self.record.starts)
        return other

    def floor_without(self, causes: Sequence[Cause]) -> NoiseFloor:
        """Estimate the floor that more causes leave; a floor that was told stays."""
        if self.told_floor:
            return self.floor
        record, every = self.record, (*self.causes, *causes)
        left = explain(record, every, self.orbit).left
        left = left - self.background.orbit(self.residual(causes)[1])
        return estimate_floor(left, stretches_across(record, every), self.floor.modes)

    @property
    def log_likelihood(self) -> float:
        """Of the record under the causes [nats], comparable under one floor."""
        return log_likelihood(self.white, self.sizes, self.jacobian)

    @property
    def full_log_likelihood(self) -> float:
        """Of the record under the causes [nats], comparable between floors too."""
        return self.log_likelihood + float(np.sum(self.floor.log_density_terms(self.record.starts)))


def log_likelihood(white: Matrix, sizes: Vector, jacobian: Vector) -> float:
    """Sum what `Bench.residual` gives [nats]."""
    return float(-0.5 * np.vdot(white, white) - 0.5 * np.sum(sizes**2) + np.sum(jacobian))
