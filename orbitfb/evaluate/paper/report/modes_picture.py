"""Picture of the modes that a static law loses while the response drifts (the paper's figure 2).

With the law a = −K y an eigenvector of R_t K is a mode of the loop, and its eigenvalue the gain:
the share of the mode that a tick takes away. Where R_t becomes singular on its way a gain passes
zero, and from there on the mode grows. λ makes the gains of weak modes small, so it slows down
that growth; it does not change the sign.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.signals import Vector
from orbitfb.evaluate.paper.report.pictures import new_figure
from orbitfb.evaluate.paper.scenarios import PAPER_LAMBDA, Scenario

_LOOKS = 31
_EVERY = 20
_TRAJECTORIES = 16
_SHOWN = 6


@dataclass(frozen=True, slots=True)
class Modes:
    """What becomes of the modes under the static law, without noise.

    Args:
        ticks: When R_t was looked at, shape (T,) [ticks].
        gains: Eigenvalues of R_t K, by their real part, shape (T, n), complex [1].
        later: When the orbit was looked at, shape (S,) [ticks].
        amplitudes: Orbit along u_i, a left singular vector of the first R, over its start; rms over
            trajectories, shape (S, n) [1].
    """

    ticks: Vector
    gains: NDArray[np.complex128]
    later: Vector
    amplitudes: Vector


def follow_modes(scenario: Scenario, trajectory: int = 0) -> Modes:
    """Follow the modes under the paper's law.

    Args:
        scenario: What happens.
        trajectory: Whose R the law is made from.
    """
    known = scenario.known(trajectory)
    n, m = known.shape
    gain = np.linalg.solve(known.T @ known + PAPER_LAMBDA * np.eye(m), known.T)
    modes = np.linalg.svd(known)[0]
    ticks = np.linspace(0, scenario.steps, _LOOKS)
    loops = [scenario.response(int(tick)) @ gain for tick in ticks]
    found = [np.sort_complex(np.linalg.eigvals(loop)) for loop in loops]
    gains = np.array(found, dtype=np.complex128)
    rng = scenario.generator(trajectory, 1)
    orbits = rng.standard_normal((_TRAJECTORIES, n)) @ modes.T
    begin = np.sqrt(np.mean((orbits @ modes) ** 2, axis=0))
    first, drift = loops[0], (loops[-1] - loops[0]) / scenario.steps
    both = np.hstack((first.T, drift.T))
    seen: list[Vector] = []
    for tick in range(scenario.steps + 1):
        if tick % _EVERY == 0:
            seen.append(np.sqrt(np.mean((orbits @ modes) ** 2, axis=0)) / begin)
        moved = orbits @ both
        orbits = orbits - moved[:, :n] - tick * moved[:, n:]
    later = np.arange(len(seen), dtype=np.float64) * _EVERY
    return Modes(ticks, gains, later, np.array(seen))


def draw_modes(scenario: Scenario, path: Path) -> None:
    """Draw the smallest gains, the growth of the loop, the orbit along the modes.

    Args:
        scenario: What happens.
        path: Where the PNG goes.
    """
    modes = follow_modes(scenario)
    figure = new_figure(13.0, 4.2)
    gains, growth, orbits = figure.subplots(1, 3)
    for tick, values in zip(modes.ticks, modes.gains, strict=True):
        real = values.real
        bad = real < 0.0
        gains.plot(np.full(np.sum(~bad), tick), real[~bad], ".", color="grey", ms=2)
        gains.plot(np.full(np.sum(bad), tick), real[bad], ".", color="tab:red", ms=5)
    gains.set_yscale("symlog", linthresh=1e-5)
    gains.axhline(0.0, color="black", lw=0.8)
    gains.set_ylabel("gains: eigenvalues of R_t K, real part [1]")
    lost = int(np.max(np.sum(modes.gains.real < 0.0, axis=1)))
    gains.set_title(f"red: lost; at most {lost} at a time")
    growth.plot(modes.ticks, np.max(np.abs(1.0 - modes.gains), axis=1) - 1.0, color="tab:red")
    growth.axhline(0.0, color="black", lw=0.8)
    growth.set_ylabel("largest |eigenvalue| of I − R_t K, minus 1 [1]")
    growth.set_title("above 0: the orbit grows")
    largest = np.argsort(modes.amplitudes[-1])[-_SHOWN:]
    for mode in range(modes.amplitudes.shape[1]):
        orbits.semilogy(modes.later, modes.amplitudes[:, mode], color="lightgrey", lw=0.6)
    for mode in largest:
        orbits.semilogy(modes.later, modes.amplitudes[:, mode], color="tab:red", lw=1.0)
    orbits.axhline(1.0, color="black", lw=0.8)
    orbits.set_ylim(1e-5, None)
    orbits.set_ylabel("orbit along uᵢ of the first R, over its start [1]")
    orbits.set_title(f"red: the {_SHOWN} that are largest at the end")
    for axes in (gains, growth, orbits):
        axes.set_xlabel("tick")
        axes.grid(alpha=0.25)
    figure.suptitle(f"{scenario.name}: the paper's SVD law on the first R while R drifts, no noise")
    figure.savefig(path, dpi=110)
