"""The PVs of how the loop corrects: averages, dead band, cut, lambda and weights of an SVD law."""

from collections.abc import Mapping

from orbitfb.loop.settings import MOST_AVERAGED
from orbitfb.panel.pv import Kind, Order, PanelPv
from orbitfb.panel.pvs.forms import MICRO, ONCE, choice_pv, number_pv, pair_of
from orbitfb.panel.settings import PanelSettings
from orbitfb.policies.svd import LARGEST_WEIGHT


def restraint_pvs(settings: PanelSettings, planes: str) -> tuple[PanelPv, ...]:
    """Give those that say how often, and from which error on, the loop corrects.

    Args:
        settings: Has the limits.
        planes: x, y or xy.
    """
    average = PanelPv(
        "Average",
        Kind.INTEGER,
        "Orbits that are averaged for a correction: one correction in so many ticks.",
        limits=(1.0, float(MOST_AVERAGED)),
        order=Order("average", "orbits"),
    )
    bands = (
        PanelPv(
            f"DeadBand{plane.upper()}",
            Kind.DOUBLE,
            f"Rms orbit error below which plane {plane} is not corrected; 0: none.",
            "um",
            3,
            limits=(0.0, settings.dead_band_limit / MICRO),
            order=Order("dead-band", "value", MICRO, more=(("plane", plane),)),
        )
        for plane in planes
    )
    return tuple(pv for its in (average, *bands) for pv in pair_of(its))


def trial_pvs(lengths: Mapping[str, tuple[int, int]]) -> tuple[PanelPv, ...]:
    """Give those by which another SVD law is tried.

    Args:
        lengths: BPMs and correctors of each plane.
    """
    bpms, correctors = (sum(its[kind] for its in lengths.values()) for kind in (0, 1))
    several = len(lengths) > 1
    weights = PanelPv(
        "BpmWeight",
        Kind.DOUBLES,
        "Weight of each BPM in an SVD law, x first, then y; SP: to try, RB: in force.",
        precision=3,
        limits=(0.0, LARGEST_WEIGHT),
        length=bpms,
        order=Order("try", "weights"),
    )
    of_planes = (
        pv
        for plane, (rows, columns) in (lengths.items() if several else ())
        for pv in _cut(min(rows, columns), plane)
    )
    return (
        *_cut(min(bpms, correctors)),
        *of_planes,
        *pair_of(weights),
        number_pv("PredictedRms-I", "Next change that the tried law would make, rms.", "A", 6),
        number_pv("PredictedMax-I", "The same, largest.", "A", 6),
        number_pv("PredictedOrbit-I", "Rms orbit error expected after it.", "um", 3),
        choice_pv("Apply-Cmd", "Puts the tried law in force.", ONCE, {"command": "apply"}),
    )


def _cut(modes: int, plane: str = "") -> tuple[PanelPv, ...]:
    """Give cut and lambda of a plane, or of the whole response."""
    letter, more = plane.upper(), (("plane", plane),) if plane else ()
    where = f"of plane {plane} by itself" if plane else "of the whole response"
    return (
        *pair_of(
            PanelPv(
                f"Modes{letter}",
                Kind.INTEGER,
                f"Singular values {where} that an SVD law keeps; SP: to try, RB: in force.",
                limits=(1.0, float(modes)),
                order=Order("try", "singular_values", more=more),
            )
        ),
        *pair_of(
            PanelPv(
                f"Lambda{letter}",
                Kind.DOUBLE,
                f"Tikhonov's lambda {where}; SP: to try, RB: in force.",
                "m/A",
                7,
                limits=(0.0, 1.0),
                order=Order("try", "regularisation", more=more),
            )
        ),
    )
