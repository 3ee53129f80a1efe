"""Policies against each other on the same simulated ring: same drift, same noise, same seeds.

Each policy closes the loop on a ring of its own, made anew from the same seed, from the initial
orbit to the end. Nothing learns meanwhile: what is compared are the laws as they are.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from pydantic import Field

from orbitfb.core.errors import ConfigError
from orbitfb.core.ports import Policy
from orbitfb.core.settings import Settings
from orbitfb.core.signals import Mask, Vector
from orbitfb.effects.build import plant_with
from orbitfb.effects.settings import EffectSettings
from orbitfb.evaluate.simulate import ClosedLoop
from orbitfb.learn.judge import gain_of
from orbitfb.physics.places import Planes, Ring
from orbitfb.physics.plant import PlantSettings

NEAR = 50e-6
"""The orbit that counts as corrected, rms [m]: the paper's 0.05 mm."""

_UM = 1e6


class CompareSettings(Settings):
    """What the policies have to live through."""

    ticks: int = Field(default=1000, ge=20, description="Length of each run [ticks].")
    seed: int = Field(default=1, ge=0, description="First seed of ring, noise and drift.")
    seeds: int = Field(default=4, ge=1, description="How many seeds.")
    planes: Planes = Field(default="x", description="Planes under feedback.")
    plant: PlantSettings = Field(default=PlantSettings(), description="The simulated ring.")
    effects: tuple[EffectSettings, ...] = Field(
        default=(), description="Effects that the ring has besides."
    )
    period: float = Field(default=0.1, gt=0, description="By which effects count time [s].")


@dataclass(frozen=True, slots=True)
class Comparison:
    """How one policy did; rms over the second half of every run and over the seeds.

    Args:
        policy: Its id.
        kind: Its class.
        true_rms: Of the true orbit [m]; infinite when a seed was lost.
        observed_rms: Of the readings [m]; infinite when a seed was lost.
        steps: Ticks until the true orbit is within 0.05 mm rms, median of the seeds; infinite
            when most of them never are.
        change_rms: Of a corrector's change per tick [A].
        growth: Largest factor by which a pattern of the orbit grows per tick at the end of the
            run, the largest of the seeds: spectral radius of I − R_t K, K the slope at zero.
            1 means a pattern that is not corrected, more one that the law drives away.
        lost: Seeds in which the orbit passed 5 mm.
    """

    policy: str
    kind: str
    true_rms: float
    observed_rms: float
    steps: float
    change_rms: float
    growth: float
    lost: int


def compare(
    policies: Mapping[str, Policy],
    settings: CompareSettings,
    ring: Ring,
    valid: Mask | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> list[Comparison]:
    """Run every policy over every seed.

    Args:
        policies: By the name under which they are reported.
        settings: What they have to live through.
        ring: The ring.
        valid: BPMs that count, shape (n,); None: all.
        progress: Told of every policy that begins.

    Returns:
        One line for each, in their order.

    Raises:
        ConfigError: No policy is given, or one does not fit the ring.
    """
    channels = ring.channels(settings.planes)
    shape = (len(channels.bpms), len(channels.correctors))
    if not policies:
        raise ConfigError("nothing to compare; name at least one policy")
    for name, policy in policies.items():
        response = getattr(policy, "response", None)
        if response is not None and response.shape != shape:
            raise ConfigError(
                f"policy {name} is for {response.shape[0]} BPMs and {response.shape[1]} "
                f"correctors, the ring has {shape[0]} and {shape[1]} in planes "
                f"{settings.planes}; compare policies of one ring"
            )
    rows: list[Comparison] = []
    for name, policy in policies.items():
        progress(f"{name}: {settings.seeds} x {settings.ticks} ticks")
        rows.append(_run(name, policy, settings, ring, valid))
    return rows


def _run(
    name: str, policy: Policy, settings: CompareSettings, ring: Ring, valid: Mask | None
) -> Comparison:
    half = settings.ticks // 2
    true, observed, changes, steps, growth, lost = [], [], [], [], [], 0
    for seed in range(settings.seed, settings.seed + settings.seeds):
        plant = plant_with(
            ring, settings.planes, settings.plant, seed, settings.effects, settings.period
        )
        loop = ClosedLoop(plant, policy, settings.ticks, ramp=1, valid=valid).run()
        lost += loop.lost
        true.append(np.mean(loop.true_rms[half:] ** 2))
        observed.append(np.mean(loop.observed_rms[half:] ** 2))
        changes.append(np.mean(loop.applied(half) ** 2) if loop.tick > half + 1 else np.nan)
        near = np.flatnonzero(loop.true_rms <= NEAR)
        steps.append(float(near[0]) if near.size else np.inf)
        growth.append(_growth(plant.response_at(settings.ticks), policy))
    end = np.inf if lost else 1.0
    return Comparison(
        policy=name,
        kind=type(getattr(policy, "policy", policy)).__name__,
        true_rms=float(np.sqrt(np.mean(true))) * end,
        observed_rms=float(np.sqrt(np.mean(observed))) * end,
        steps=float(np.median(steps)),
        change_rms=float(np.sqrt(np.nanmean(changes))) if np.isfinite(changes).any() else np.inf,
        growth=max(growth),
        lost=lost,
    )


def _growth(response: Vector, policy: Policy) -> float:
    answer = response @ gain_of(policy, len(response))
    return float(np.max(np.abs(np.linalg.eigvals(np.eye(len(answer)) - answer))))


def as_rows(rows: Sequence[Comparison]) -> list[dict[str, Any]]:
    """Give the comparison as JSON knows it, SI; null where a figure is not finite."""
    return [
        {
            key: None if isinstance(value, float) and not np.isfinite(value) else value
            for key, value in asdict(row).items()
        }
        for row in rows
    ]


def as_table(rows: Sequence[Comparison]) -> str:
    """Write the comparison for people, the best true orbit first."""
    width = max(len(row.policy) for row in rows)
    head = (
        f"{'policy':<{width}}  {'class':<13}  {'true':>9}  {'observed':>9}  {'steps to':>8}  "
        f"{'change':>9}  {'growth':>8}  {'lost':>4}\n"
        f"{'':<{width}}  {'':<13}  {'µm rms':>9}  {'µm rms':>9}  {'0.05 mm':>8}  {'µA rms':>9}  "
        f"{'per tick':>8}  {'':>4}\n"
    )
    lines = [
        f"{row.policy:<{width}}  {row.kind:<13}  {_cell(row.true_rms * _UM):>9}  "
        f"{_cell(row.observed_rms * _UM):>9}  {_cell(row.steps):>8}  "
        f"{_cell(row.change_rms * _UM):>9}  {row.growth:>8.5f}  {row.lost:>4}"
        for row in sorted(rows, key=lambda row: row.true_rms)
    ]
    return head + "\n".join(lines)


def _cell(value: float) -> str:
    return f"{value:.4g}" if np.isfinite(value) else "-"
