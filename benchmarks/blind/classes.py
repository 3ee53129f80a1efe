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
"""Same first derivative, nested, or only told apart by an experiment. Swapping an offset and a kick
is not among them: there are BPMs enough."""


def class_of(effect: str) -> frozenset[str]:
    """Give an effect and all that is in a class with it by construction."""
    return frozenset({effect}).union(*(group for group in EQUAL if effect in group))
