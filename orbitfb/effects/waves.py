"""What swings at one frequency: its parameters, values that are tried, and its course."""

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.effects.kinds import Parameter, Values
from orbitfb.records.record import Record


def wave_parameters(unit: str, most: float, typical: float) -> tuple[Parameter, ...]:
    """Amplitudes of cosine and sine, and the frequency [Hz].

    Args:
        unit: Of the amplitudes.
        most: Their bound on either side.
        typical: One of them.
    """
    return (
        Parameter("cosine", unit, -most, most, 0.0, typical, "Amplitude of the cosine."),
        Parameter("sine", unit, -most, most, 0.0, typical, "Amplitude of the sine."),
        Parameter(
            "frequency",
            "Hz",
            0.0,
            1e4,
            1.0,
            1.0,
            "Frequency, or its alias below half the rate of the loop.",
        ),
    )


def wave_grid(record: Record, typical: float) -> tuple[Values, ...]:
    """One of ten frequencies; `periodic` of a kind tells to scan them all by a Fourier transform.

    Args:
        record: With the period of the loop.
        typical: Amplitude.
    """
    half = 0.5 / record.layout.period
    return tuple(
        {"cosine": cosine, "sine": typical - cosine, "frequency": half * (line + 0.5) / 10}
        for line in range(10)
        for cosine in (0.0, typical)
    )


def wave(values: Values, time: Vector) -> Vector:
    """Give a cos 2πft + b sin 2πft of times [s], in their shape."""
    phase = 2.0 * np.pi * values["frequency"] * time
    return np.asarray(values["cosine"] * np.cos(phase) + values["sine"] * np.sin(phase))
