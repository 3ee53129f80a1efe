"""What no record of a passive loop can tell apart: classes that hold whatever a tool declares."""

EQUAL = (
    frozenset({"loop-delay", "bpm-latency"}),
    frozenset({"bpm-gain", "bpm-nonlinearity"}),
    frozenset({"quadrupole-gradient", "sextupole"}),
    frozenset({"corrector-gain", "corrector-stuck"}),
    frozenset({"corrector-gain", "corrector-polarity"}),
    frozenset({"bpm-gain", "bpm-polarity"}),
    frozenset({"corrector-quantisation", "ground-motion-level"}),
    frozenset({"corrector-deadband", "corrector-hysteresis", "corrector-slew", "corrector-lag"}),
    frozenset({"missed-write", "clock-jitter"}),
)
"""Of the design of the diagnosis, section 2.3: same first derivative, nested, or only told apart
by an experiment. Swapping an offset and a kick is not among them: there are BPMs enough."""


def same_class(first: str, second: str) -> bool:
    """Tell whether two effects are one, or in a class by construction."""
    return first == second or any(first in group and second in group for group in EQUAL)
