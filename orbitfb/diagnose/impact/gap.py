"""The gap: how much less likely the record is under the nominal model, and where that lies.

Causes that add f to the transformed steps z of what the nominal model leaves make the record more
likely by Σ f ∘ Ω(z − f/2), summed over frequencies and BPMs. The product is taken apart by cause,
BPM, singular mode, band, and, turned back to rows, by window: every cut adds up to the same sum.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.impact.explained import Explained
from orbitfb.diagnose.impact.named import Named
from orbitfb.diagnose.impact.windows import Windows, interval
from orbitfb.diagnose.result.naming import column_names
from orbitfb.diagnose.result.parts import Gap, GapPiece
from orbitfb.diagnose.result.values import numbers
from orbitfb.estimation.transform import Matrix, StepTransform

OCTAVES = 7
"""Bands of frequency, each twice as high as the one below; the lowest has all below it."""

UNEXPLAINED = "unexplained"
"""Key of the part of the gap that no effect of the library explains, beside the stages."""


@dataclass(frozen=True, slots=True, eq=False)
class Parts:
    """The gap of the causes with a course in time, taken apart; all in nats.

    Args:
        field: Spectrum of what they add, shape (T, n) [m].
        pulled: Ω (z − f/2), shape (T, n) [1/m].
        transform: Of the record.
        windows: Of it.
        by_cause: Share of every cause; of one that is only noise what it is worth.
        rest: What a free course finds besides.
    """

    field: Matrix
    pulled: Matrix
    transform: StepTransform
    windows: Windows
    by_cause: Vector
    rest: float

    @classmethod
    def of(cls, its: Explained, causes: Sequence[Named], rest: float, windows: Windows) -> "Parts":
        """Weigh what causes add.

        Args:
            its: What they add, and the floor.
            causes: In their order.
            rest: What a free course explains beside them [nats].
            windows: Of the record.
        """
        transform, field = its.space.transform, its.named
        pulled = its.noise.pull(its.nominal - 0.5 * field, transform)
        shares = [
            one.evidence if field is None else float(np.sum(field * pulled))
            for one, field in zip(causes, its.fields, strict=True)
        ]
        return cls(field, pulled, transform, windows, np.array(shares), rest)

    @property
    def whole(self) -> float:
        """The gap [nats]."""
        return float(self.by_cause.sum()) + self.rest

    def by_bpm(self) -> Vector:
        """Shape (n,)."""
        return np.einsum("tn,tn->n", self.field, self.pulled)

    def by_mode(self, response: Matrix) -> Vector:
        """By singular mode of the response, strongest first; last what no corrector reaches."""
        left = np.linalg.svd(response, full_matrices=False)[0]
        shares = np.einsum("tk,tk->k", self.field @ left, self.pulled @ left)
        return np.append(shares, np.sum(self.field * self.pulled) - shares.sum())

    def by_band(self, period: float) -> tuple[GapPiece, ...]:
        """By octaves of the frequency [Hz]."""
        frequency = np.arccos(np.clip(1.0 - self.transform.eigenvalue / 2.0, -1.0, 1.0))
        frequency /= 2.0 * np.pi * period
        edges = 0.5 / period * 2.0 ** np.arange(-OCTAVES + 1, 1)
        place = np.minimum(np.searchsorted(edges, frequency), len(edges) - 1)
        sums = np.bincount(
            place, np.einsum("tn,tn->t", self.field, self.pulled), minlength=len(edges)
        )
        lows = [0.0, *edges[:-1]]
        return tuple(
            GapPiece(
                label=f"{low:.3g}–{high:.3g} Hz", start=low, stop=high,
                nats_per_tick=value / len(self.transform),
            )
            for low, high, value in zip(lows, edges, sums, strict=True)
        )  # fmt: skip

    def in_windows(self) -> Vector:
        """By window, shape (W,)."""
        rows = self.transform.turn(self.field) * self.transform.turn(self.pulled)
        return self.windows.sums(rows.sum(axis=1))

    def by_window(self, time: Vector) -> tuple[GapPiece, ...]:
        """By window [s]."""
        ends = time[self.transform.step_rows()]
        edges = [*ends[self.windows.edges[:-1]], ends[-1]]
        return tuple(
            GapPiece(
                label=f"{low:.4g}–{high:.4g} s", start=float(low), stop=float(high),
                nats_per_tick=value / len(self.transform),
            )
            for low, high, value in zip(edges[:-1], edges[1:], self.in_windows(), strict=True)
        )  # fmt: skip

    def ends(self) -> tuple[float, float]:
        """90 % interval of the whole: windows drawn anew; of noise alone as its evidence scatters.

        Returns:
            Low and high [nats].
        """
        steady = self.whole - float(np.sum(self.field * self.pulled))
        low, high = interval(self.windows.drawn(self.in_windows()))
        spread = 1.645 * float(np.sqrt(2.0 * max(steady, 0.0)))
        return low + max(steady - spread, 0.0), high + steady + spread


def gap(
    its: Explained,
    parts: Parts,
    causes: Sequence[Named],
    above: tuple[Vector, Vector],
    floor: Vector,
) -> Gap:
    """Tell the gap.

    Args:
        its: What the causes add, and the floor.
        parts: The gap in nats.
        causes: In their order.
        above: Mean square of the one-step error of the nominal model beyond that with the causes,
            by BPM, shape (n,), and of draws of the windows, shape (DRAWS,) [m²].
        floor: Mean square that noise and walk leave, by BPM, shape (n,) [m²].
    """
    record, ticks = its.space.signals.record, len(its.space.transform)
    stages: dict[str, float | None] = {}
    for one, nats in zip(causes, parts.by_cause, strict=True):
        stages[one.kind.stage] = (stages.get(one.kind.stage) or 0.0) + float(nats) / ticks
    if parts.rest > 0.0:
        stages[UNEXPLAINED] = parts.rest / ticks
    names = column_names(record.layout.bpms)
    mean, draws = above
    low, high = parts.ends()
    least, most = interval(np.sqrt(np.maximum(draws, 0.0)))
    courses = its.counts
    return Gap(
        nats_per_tick=parts.whole / ticks,
        low=low / ticks,
        high=high / ticks,
        um=1e6 * float(np.sqrt(max(float(np.mean(mean)), 0.0))) if courses else 0.0,
        um_low=1e6 * least if courses else None,
        um_high=1e6 * most if courses else None,
        floor_um=1e6 * float(np.sqrt(np.mean(floor))),
        resolved=bool(causes) or parts.rest > 0.0,
        by_stage=stages,
        by_bpm=dict(zip(names, (parts.by_bpm() / ticks).tolist(), strict=True)) if courses else {},
        um_by_bpm={
            name: 1e6 * float(np.sqrt(max(v, 0.0))) for name, v in zip(names, mean, strict=True)
        } if courses else {},
        by_corrector=_by_corrector(its) if courses else {},
        by_mode=numbers(parts.by_mode(record.layout.response) / ticks) if courses else (),
        by_band=parts.by_band(record.layout.period) if courses else (),
        by_window=parts.by_window(record.time) if courses else (),
        floor_from="what a model in which every device may be wrong leaves of the record",
    )  # fmt: skip


def _by_corrector(its: Explained) -> dict[str, float | None]:
    """What an error of every corrector's gain alone would explain [nats/tick]."""
    space, response = its.space, its.space.signals.record.layout.response
    transform = space.transform
    spectra = transform.quick_spectrum(space.signals.currents)
    pulled = its.noise.pull(its.nominal, transform)
    pull = np.einsum("fm,fm->m", pulled @ response, spectra)
    seen = (response.T @ its.noise.modes) ** 2
    weight = seen @ its.noise.inverse_variance(transform).T
    information = np.einsum("mb,bm->m", weight, transform.by_band(spectra * spectra))
    worth = 0.5 * pull**2 / np.maximum(information, 1e-300) / len(transform)
    names = column_names(space.signals.record.layout.correctors)
    return dict(zip(names, worth.tolist(), strict=True))
