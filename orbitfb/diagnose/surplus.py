"""The gap of every cell (row × channel), in any orthonormal basis: its sums are the gap's parts.

With ν the white innovations of the nominal model and ν' those of the best explanation, the gap of
a cell is ½ (ν² − ν'²) and the log-Jacobian of its reading. Rotating both by an orthonormal matrix,
or taking a Fourier transform of both over time, leaves the sum as it is: by BPM, by mode and by
frequency the parts add up to the same whole (Parseval).
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from orbitfb.core.signals import Mask, Vector
from orbitfb.diagnose.innovation import NoiseFloor
from orbitfb.physics.optics import Matrix


@dataclass(frozen=True, slots=True, eq=False)
class Surplus:
    """What the nominal model loses against the best explanation, and that against the floor.

    Args:
        floor: The noise; its modes are the basis of all white innovations here.
        counted: Rows that count, shape (N,).
        nominal: White innovations of the nominal model, shape (N, n).
        best: Those of the best explanation, shape (N, n).
        jacobian: log |∂restored/∂reading| of the best explanation by row and BPM, (N, n).
        even: Gap that no innovation shows, by row, shape (N,) [nats].
        where: Share of it that every BPM has, shape (n,), of sum 1; None: all alike.
        raw: White innovations of the best explanation before the healthy errors are taken out,
            shape (N, n), if what is left above the floor is a part of the gap; None if it is not.
            (The mean of raw · best is 1 in every cell of a right model, whatever the prior of the
            healthy errors: Cov(raw) = C and best = C⁻¹ raw.)
    """

    floor: NoiseFloor
    counted: Mask
    nominal: Matrix
    best: Matrix
    jacobian: Matrix
    even: Vector
    where: Vector | None = None
    raw: Matrix | None = None

    @property
    def by_row(self) -> Vector:
        """Gap of every row, shape (N,) [nats]."""
        return self._quadratic(np.eye(self.nominal.shape[1])).sum(axis=1) + self._whole_rows()

    def by_bpm(self) -> Matrix:
        """Gap of every row and BPM, shape (N, n) [nats]."""
        cells = self._quadratic(self.floor.modes.axes.T) + np.where(
            self.counted[:, None], self.jacobian, 0.0
        )
        return cells + self._unseen()

    def by_direction(self, basis: Matrix) -> Matrix:
        """Gap of every row and direction of an orthonormal basis of orbits, shape (N, n) [nats].

        Args:
            basis: Columns, shape (n, n).
        """
        channels = self.nominal.shape[1]
        alike = np.where(self.counted, self.jacobian.sum(axis=1), 0.0)[:, None] / channels
        return self._quadratic(self.floor.modes.axes.T @ basis) + alike + self._unseen(basis)

    def by_frequency(self, edges: Vector) -> list[Matrix]:
        """Gap of every row and BPM in bands of frequency, each of shape (N, n) [nats].

        Args:
            edges: Of the bands, in cycles per tick; the first below zero, the last above ½.
        """
        frequency = np.fft.rfftfreq(len(self.counted)).astype(np.float64)
        rotation = self.floor.modes.axes.T
        pairs = [(self.nominal, self.nominal), (self.best, self.best)]
        signs = [0.5, -0.5]
        if self.raw is not None:
            pairs.append((self.raw, self.best))
            signs.append(0.5)
        spectra = [
            tuple(np.fft.rfft((one * self.counted[:, None]) @ rotation, axis=0) for one in pair)
            for pair in pairs
        ]
        flat = self.jacobian * self.counted[:, None] + self._unseen()
        if self.raw is not None:
            flat -= 0.5 * self.counted[:, None]
        bands: list[Matrix] = []
        for low, high in pairwise(edges):
            chosen = (frequency >= low) & (frequency < high)
            share = _weight(frequency, chosen, len(self.counted))
            band = flat * share
            for sign, pair in zip(signs, spectra, strict=True):
                first, second = (
                    np.fft.irfft(one * chosen[:, None], n=len(self.counted), axis=0) for one in pair
                )
                band += sign * first * second
            bands.append(band)
        return bands

    def _quadratic(self, rotation: Matrix) -> Matrix:
        best = self.best @ rotation
        cells = 0.5 * ((self.nominal @ rotation) ** 2 - best**2)
        if self.raw is not None:
            cells += 0.5 * ((self.raw @ rotation) * best - 1.0)
        cells[~self.counted] = 0.0
        return cells

    def _whole_rows(self) -> Vector:
        return np.where(self.counted, self.jacobian.sum(axis=1) + self.even, 0.0)

    def _unseen(self, basis: Matrix | None = None) -> Matrix:
        """What no innovation shows by row and BPM, or direction of a basis (n, n), shape (N, n)."""
        channels = self.nominal.shape[1]
        shares = np.full(channels, 1.0 / channels) if self.where is None else self.where
        if basis is not None:
            shares = shares @ basis**2  # noise of a BPM moves every direction that has a part of it
        return np.outer(np.where(self.counted, self.even, 0.0), shares)


def _weight(frequency: Vector, chosen: Mask, rows: int) -> float:
    """Share of a white noise that a band has: lines count twice except the first and the last."""
    lines = np.full(len(frequency), 2.0)
    lines[0] = 1.0
    if rows % 2 == 0:
        lines[-1] = 1.0
    return float(lines[chosen].sum() / rows)
