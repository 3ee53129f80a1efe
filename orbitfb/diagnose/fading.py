"""Steps that an orbit may have made, as the noise sees them.

A step of any shape fades in every mode of the noise in a course of its own, however large it is
there. So as many steps as there are correctors are known by one number per mode each: what they
have of the innovations is taken out without a record for every one of them.
"""

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.signals import Mask
from orbitfb.diagnose.free import Rows, orthonormal
from orbitfb.diagnose.innovation import NoiseFloor
from orbitfb.physics.optics import Matrix


class Steps:
    """Orthonormal innovations that steps of the orbit may have made.

    Args:
        floor: The noise.
        starts: Where stretches begin, shape (N,).
        onsets: Row at which each is made, shape (k,), k > 0.
        orbits: The steps at the BPMs, shape (k, n) [m].

    Attributes:
        information: On the size of each, shape (k,).
    """

    def __init__(
        self, floor: NoiseFloor, starts: Mask, onsets: NDArray[np.intp], orbits: Matrix
    ) -> None:
        rows, which = np.unique(onsets, return_inverse=True)
        self._since = int(rows[0])
        fading = _fading(floor, starts, rows)[self._since :]
        # What fades since two rows is not orthogonal in the same mode.
        courses, sizes = np.linalg.qr(fading.swapaxes(0, 1))
        self._courses = np.ascontiguousarray(courses.transpose(2, 1, 0))  # onsets × rows × modes
        shares = floor.to_modes(orbits)[:, None, :] * sizes.transpose(2, 1, 0)[which]
        self.information = np.sum(shares**2, axis=(1, 2))
        self._shares = orthonormal(shares.reshape(len(shares), -1))

    def __len__(self) -> int:
        """How many of them differ."""
        return len(self._shares)

    def take_out(self, left: Rows) -> None:
        """Take what they have out of innovations, shape (N, n), in place."""
        own, courses = left[self._since :], self._courses
        seen = np.einsum("okm,km->om", courses, own)
        taken = ((self._shares @ seen.reshape(-1)) @ self._shares).reshape(seen.shape)
        own -= np.einsum("okm,om->km", courses, taken)


def likeliest_steps(
    floor: NoiseFloor, starts: Mask, onsets: NDArray[np.intp], orbits: Matrix, left: Matrix
) -> Matrix:
    """The likeliest course of an orbit that consists of steps, shape (N, n) [m].

    Args:
        floor: The noise.
        starts: Where stretches begin, shape (N,).
        onsets: Row at which each step is made, shape (k,), k > 0.
        orbits: The steps at the BPMs, of any size, shape (k, n) [m].
        left: What the steps are a part of, shape (N, n) [m].
    """
    rows, which = np.unique(onsets, return_inverse=True)
    fading, modes = _fading(floor, starts, rows), floor.to_modes(orbits)
    pull = np.einsum("nmr,nm->rm", fading, floor.whiten(left, starts))
    alike = np.einsum("nmr,nmq->rqm", fading, fading)[which[:, None], which[None, :]]
    normal = np.einsum("im,jm,ijm->ij", modes, modes, alike)
    sizes = np.linalg.pinv(normal, hermitian=True) @ np.sum(modes * pull[which], axis=1)
    return (np.arange(len(starts))[:, None] >= onsets) @ (sizes[:, None] * orbits)


def _fading(floor: NoiseFloor, starts: Mask, rows: NDArray[np.intp]) -> NDArray[np.float64]:
    """How a step of 1 m in every mode fades in the innovations, (N, modes, rows it begins at)."""
    unit = np.arange(len(starts))[:, None] >= rows
    return np.stack(
        [
            floor.whiten_modes(np.repeat(own[:, None], len(floor.modes.axes), axis=1), starts)
            for own in unit.T.astype(np.float64)
        ],
        axis=2,
    )
