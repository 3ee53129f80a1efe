"""Masks: how every policy works on without some BPMs or some correctors.

**BPMs.** Masked BPMs read what the valid ones let expect (`policies.infill`).

**Correctors.** A masked corrector does not move, and what it was asked to do is handed to the
others by least squares: with M the masked and F the free ones, H = RᵀR + λ² I + n P,

    a_F ← a_F + H_FF⁻¹ H_FM a_M,   a_M ← 0.

For a linear law a = −K e with K = H⁻¹ Rᵀ this is exactly the law that is solved without the
columns M (block elimination in the normal equations), so that nothing is lost against solving
it anew; for a network it is the best that its own answer allows.

Source: the Schur complement of the normal equations.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from pydantic import Field

from orbitfb.core.errors import ConfigError, RingError
from orbitfb.core.near_names import did_you_mean
from orbitfb.core.ports import Policy, inform, take_back
from orbitfb.core.settings import Settings
from orbitfb.core.signals import Channels, Mask, Vector
from orbitfb.policies.inverse import frozen
from orbitfb.policies.recent import Recent


class MaskedPolicy:
    """Any policy, with some correctors that do not move.

    It keeps the name of the policy inside: that is the one which is stored and can be put in
    force again; which correctors were masked stands in the configuration.

    Args:
        policy: The policy inside.
        response: R, shape (n, m) [m/A].
        movable: Correctors that may move, shape (m,), at least one.
        regularisation: λ [m/A] of the least squares; None: that of the policy's settings, if
            it has one, else 0.
        covariance: P of every row of R, shape (m, m) [(m/A)²]; None: the policy's, if any.

    Attributes:
        policy: The policy inside.
        response: R, shape (n, m) [m/A].
        movable: Correctors that may move, shape (m,).

    Raises:
        RingError: The mask has another length than R has columns, or leaves no corrector.
    """

    def __init__(
        self,
        policy: Policy,
        response: Vector,
        movable: Mask,
        regularisation: float | None = None,
        covariance: Vector | None = None,
    ) -> None:
        m = response.shape[1]
        if movable.shape != (m,) or not movable.any():
            raise RingError(
                f"a mask of shape {movable.shape} that leaves {np.count_nonzero(movable)} "
                f"correctors does not fit {m} correctors; leave at least one to move"
            )
        damping: Vector | float | None = regularisation
        if damping is None:
            damping = getattr(policy, "damping", None)
        if damping is None:
            damping = getattr(getattr(policy, "settings", None), "regularisation", 0.0)
        if covariance is None:
            covariance = getattr(policy, "covariance", None)
        self.policy, self.response = policy, response
        self.movable = movable.copy()
        self.movable.setflags(write=False)
        strength = np.broadcast_to(np.asarray(0.0 if damping is None else damping), (m,))
        rows: Vector = getattr(policy, "solved", response)
        self._share = _share(rows, movable, strength, covariance)
        self._shares = Recent(lambda valid: _share(rows[valid], self.movable, strength, covariance))

    @property
    def policy_id(self) -> str:
        """Name of the policy inside."""
        return self.policy.policy_id

    @property
    def learns(self) -> bool:
        """Whether the policy inside learns while it acts."""
        return bool(getattr(self.policy, "learns", False))

    @property
    def chi2(self) -> float:
        """How well the policy inside explains what it reads, if it learns; else infinite [1]."""
        return float(getattr(self.policy, "chi2", np.inf))

    def take_back(self) -> None:
        """Tell the policy inside that the loop has tripped, if it learns."""
        take_back(self.policy)

    @property
    def rf(self) -> Any:
        """What the policy inside knows of the RF; None: nothing."""
        return getattr(self.policy, "rf", None)

    def initial_state(self) -> Any:
        """State of the policy inside."""
        return self.policy.initial_state()

    def act(self, error: Vector, valid: Mask, state: Any) -> tuple[Vector, Any]:
        """Decide; what is handed on counts at the valid BPMs alone.

        Args:
            error: Orbit − reference, shape (n,) [m]; elements that are not valid are ignored.
            valid: BPMs that count, shape (n,).
            state: Of the policy inside.

        Returns:
            The change of setpoints, shape (m,) [A], zero where masked, and the new state.
        """
        change, after = self.policy.act(error, valid, state)
        share = self._share if valid.all() else self._shares.get(valid)
        return share @ change, after

    @property
    def learns_rf(self) -> bool:
        """Whether the policy inside wants to know of steps of the RF."""
        return bool(getattr(self.policy, "learns_rf", False))

    def inform(
        self, error: Vector, valid: Mask, applied: Vector, state: Any, hertz: float = 0.0
    ) -> Any:
        """Tell the policy inside what was read and sent, if it learns."""
        return inform(self.policy, error, valid, applied, state, hertz)

    def changes(self, errors: Vector) -> Vector:
        """Decide on many orbits at once, (..., n) [m], if the policy inside can: (..., m) [A]."""
        inside: Any = self.policy
        return inside.changes(errors) @ self._share.T

    @property
    def gain_matrix(self) -> Vector:
        """Slope at zero, shape (m, n) [A/m], of a policy inside that has one."""
        inside: Any = self.policy
        return self._share @ inside.gain_matrix


def _share(response: Vector, movable: Mask, damping: Vector, covariance: Vector | None) -> Vector:
    """Give the matrix that takes a change to the one without masked correctors, (m, m)."""
    n, m = response.shape
    square = response.T @ response + np.diag(damping**2)
    if covariance is not None:
        square = square + n * covariance
    free, still = np.flatnonzero(movable), np.flatnonzero(~movable)
    share = np.zeros((m, m))
    share[free, free] = 1.0
    if len(still):
        among, across = square[np.ix_(free, free)], square[np.ix_(free, still)]
        if damping[free].min() > 0:  # a corrector may be lost in the middle of a tick
            share[np.ix_(free, still)] = np.linalg.solve(among, across)
        else:  # without λ the equations may have no unique solution
            share[np.ix_(free, still)] = np.linalg.lstsq(among, across, rcond=None)[0]
    return frozen(share)


def without(policy: Policy, lost: Mask) -> Policy:
    """Let a policy do without some correctors, besides those that it leaves alone already.

    Args:
        policy: One that has the response that it was made for; any other is returned as it is.
        lost: Correctors that must not move, shape (m,).
    """
    response: Vector | None = getattr(policy, "response", None)
    if response is None:
        return policy
    movable = ~lost
    while isinstance(policy, MaskedPolicy):
        movable &= policy.movable
        policy = policy.policy
    return MaskedPolicy(policy, response, movable) if movable.any() else policy


class MaskSettings(Settings):
    """BPMs that are not used and correctors that do not move."""

    bpms: tuple[str, ...] = Field(
        default=(),
        description="Masked BPMs, names of the places table; NAME:x or NAME:y masks one plane.",
    )
    correctors: tuple[str, ...] = Field(
        default=(),
        description="Correctors that are not moved, names as for bpms.",
    )


def mask_of(channels: Channels, settings: MaskSettings) -> tuple[Mask, Mask]:
    """Turn names into masks.

    Args:
        channels: Names behind the vectors.
        settings: Names that are masked.

    Returns:
        BPMs that count, shape (n,), and correctors that may move, shape (m,).

    Raises:
        ConfigError: A name that the ring does not have (all of them at once, with the nearest
            known ones), or nothing is left.
    """
    return (
        _unmasked(channels.bpms, channels.bpm_planes, settings.bpms, "masks.bpms"),
        _unmasked(
            channels.correctors, channels.corrector_planes, settings.correctors, "masks.correctors"
        ),
    )


def _unmasked(names: Sequence[str], planes: Sequence[str], masked: Sequence[str], key: str) -> Mask:
    where: dict[str, list[int]] = {}
    for index, name in enumerate(names):
        where.setdefault(name, []).append(index)
        where.setdefault(f"{name}:{planes[index]}", []).append(index)
    unknown = [name for name in masked if name not in where]
    if unknown:
        problems = "; ".join(f"{name!r}{did_you_mean(name, where)}" for name in unknown)
        raise ConfigError(
            f"{key} names {len(unknown)} that the ring does not have in planes "
            f"{''.join(dict.fromkeys(planes))}: "
            f"{problems}; use the names of the places table"
        )
    unmasked = np.ones(len(names), dtype=np.bool_)
    for name in masked:
        unmasked[where[name]] = False
    if not unmasked.any():
        raise ConfigError(f"{key} masks all {len(names)} of them; leave at least one")
    return unmasked
