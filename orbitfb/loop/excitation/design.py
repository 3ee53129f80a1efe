"""What an excitation is made of: its description, the waveform that this means, its limits."""

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator, model_validator

from orbitfb.core.errors import ConfigError
from orbitfb.core.settings import Settings
from orbitfb.core.signals import Channels, Mask
from orbitfb.loop.excitation.movement import Waveform
from orbitfb.safety.limits import LimitSettings

Matrix = NDArray[np.float64]
DEFAULT_START = 10.0
"""After the loop has closed, when the file does not say [s]."""
LONGEST = 1_000_000
"""Ticks that an excitation may take."""


class ExcitationPart(Settings):
    """A stretch of an excitation."""

    kind: Literal["prbs", "white", "ladder"] = Field(description="How levels follow each other.")
    modes: tuple[int, ...] = Field(
        default=(), description="Singular modes of the nominal response; the strongest is 1."
    )
    correctors: tuple[str, ...] = Field(default=(), description="Names of correctors.")
    planes: Literal["x", "y", "xy"] = Field(
        default="xy", description="Planes of the correctors that are named."
    )
    amplitude: tuple[float, ...] = Field(
        min_length=1,
        description="Rms excursion of every mode or corrector, or one for all [A].",
    )
    levels: tuple[float, ...] = Field(
        default=(1.0, -1.0), min_length=1, description="Of a ladder, times the amplitude."
    )
    hold: int = Field(default=1, ge=1, description="Ticks at every level [ticks].")
    duration: float = Field(gt=0, le=1e5, description="How long it takes [s].")

    @field_validator("amplitude", mode="before")
    @classmethod
    def _listed(cls, given: Any) -> Any:
        """Take a single amplitude for a list of one."""
        return [given] if isinstance(given, int | float) else given

    @model_validator(mode="after")
    def _one_choice(self) -> "ExcitationPart":
        if bool(self.modes) == bool(self.correctors):
            raise ValueError("give either modes or correctors")
        return self


class ExcitationSettings(Settings):
    """A description of an excitation."""

    start: float = Field(
        default=DEFAULT_START, ge=0, description="Begin, after the loop has closed [s]."
    )
    seed: int = Field(default=1, ge=0, description="Seed of random levels.")
    part: tuple[ExcitationPart, ...] = Field(min_length=1, description="Parts, one after another.")


def design(
    settings: ExcitationSettings,
    channels: Channels,
    response: Matrix,
    period: float,
    origin: str = "the excitation",
) -> Waveform:
    """Make the waveform that a description means.

    Args:
        settings: The description.
        channels: Of the ring.
        response: Nominal, shape (n, m) [m/A].
        period: Of the loop [s].
        origin: For messages.

    Raises:
        ConfigError: It names what the ring does not have, or is too long.
    """
    rng = np.random.default_rng(settings.seed)
    total = sum(part.duration for part in settings.part) / period
    if total > LONGEST:
        raise ConfigError(f"{origin}: {total:.0f} ticks are more than {LONGEST}")
    pieces: list[Matrix] = []
    for number, part in enumerate(settings.part, start=1):
        where = f"{origin}, part {number}"
        shapes = _shapes(part, channels, response, where)
        if len(part.amplitude) not in (1, len(shapes)):
            raise ConfigError(
                f"{where}: {len(part.amplitude)} amplitudes for {len(shapes)} excursions; give "
                "one for all, or one for each"
            )
        ticks = max(1, round(part.duration / period))
        steps = -(-ticks // part.hold)
        if part.kind == "ladder":
            course = np.resize(part.levels, (steps,))[:, None] * np.ones(len(shapes))
        elif part.kind == "white":
            course = rng.standard_normal((steps, len(shapes)))
        else:
            course = 2.0 * rng.integers(0, 2, (steps, len(shapes))) - 1.0
        pieces.append(np.repeat(course * part.amplitude, part.hold, axis=0)[:ticks] @ shapes)
    return Waveform(np.concatenate(pieces), round(settings.start / period))


def check_excitation(
    waveform: Waveform,
    channels: Channels,
    response: Matrix,
    limits: LimitSettings,
    largest_orbit: float,
    movable: Mask,
) -> None:
    """Refuse a waveform that the loop would not be able to follow, or that would trip it.

    Args:
        waveform: What to do.
        channels: Of the ring.
        response: Nominal, shape (n, m) [m/A].
        limits: Of a write.
        largest_orbit: Rms orbit error at which an interlock acts [m].
        movable: Correctors that may move, shape (m,).

    Raises:
        ConfigError: It is beyond a limit, or moves what must not move.
    """
    rows = waveform.excursion
    edge = np.zeros((1, rows.shape[1]))
    step = np.abs(np.diff(rows, axis=0, prepend=edge, append=edge)).max(axis=0)
    # After a hold the waveform is taken up again from nothing: any row may be one step.
    step = np.maximum(step, np.abs(rows).max(axis=0))
    orbit = float(np.sqrt(np.mean((rows @ response.T) ** 2, axis=1)).max())
    worst = int(np.argmax(step))
    if step[worst] > min(limits.change_per_tick, limits.setpoint):
        raise ConfigError(
            f"the excitation moves {channels.correctors[worst]} by {step[worst]:.3g} A in one "
            f"tick; allowed are {limits.change_per_tick:g} A (limits.change_per_tick)"
        )
    if orbit > 0.5 * largest_orbit:
        raise ConfigError(
            f"the excitation moves the orbit by {orbit * 1e6:.3g} µm rms, more than half of what "
            f"trips the loop ({largest_orbit * 1e6:.3g} µm, interlocks.distortion_rms); make it "
            "smaller"
        )
    barred = np.flatnonzero(rows.any(axis=0) & ~movable)
    if barred.size:
        raise ConfigError(
            f"the excitation moves {channels.correctors[int(barred[0])]}, which is masked; leave "
            "it out of the excitation, or of masks.correctors"
        )


def _shapes(part: ExcitationPart, channels: Channels, response: Matrix, where: str) -> Matrix:
    """Excursions of unit size, one in a row, shape (k, m)."""
    m = response.shape[1]
    if part.correctors:
        columns = columns_of(part.correctors, part.planes, channels, where)
        return np.eye(m)[columns]
    modes = np.array(part.modes)
    most = min(response.shape)
    if modes.min() < 1 or modes.max() > most:
        raise ConfigError(f"{where}: modes are numbered from 1 to {most}")
    return np.linalg.svd(response, full_matrices=False)[2][modes - 1]


def columns_of(names: Sequence[str], planes: str, channels: Channels, where: str) -> list[int]:
    """Find the columns of correctors.

    Args:
        names: Of the correctors.
        planes: That count.
        channels: Of the ring.
        where: For messages.

    Raises:
        ConfigError: One is not there.
    """
    column_planes = channels.corrector_planes
    found: list[int] = []
    for name in names:
        hits = [
            index
            for index, (its, plane) in enumerate(
                zip(channels.correctors, column_planes, strict=True)
            )
            if its == name and plane in planes
        ]
        if not hits:
            raise ConfigError(
                f"{where}: the ring has no corrector called {name!r} in planes {planes}; it has "
                f"{len({*channels.correctors})}, {', '.join(channels.correctors[:3])} for some"
            )
        found += hits
    return found
