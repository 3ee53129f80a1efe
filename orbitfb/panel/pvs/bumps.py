"""The PVs of closed bumps: place, position, angle."""

from orbitfb.panel.pv import Kind, Order, PanelPv
from orbitfb.panel.pvs.forms import MICRO, pair_of, text_pv
from orbitfb.panel.settings import PanelSettings


def bump_pvs(settings: PanelSettings, planes: str) -> tuple[PanelPv, ...]:
    """Give them all, names without prefix.

    Args:
        settings: Has the limits.
        planes: x, y or xy.
    """
    place = text_pv(
        "BumpPlace",
        "Place of the bump: a name of the places table, two as in A,B (the middle), or s in m.",
        Order("bump", "place"),
    )
    return (
        *pair_of(place),
        *(pv for plane in planes for pv in _of_plane(settings, plane)),
        text_pv("Bumps-I", "Bumps that are part of the reference, each with its place."),
    )


def _of_plane(settings: PanelSettings, plane: str) -> tuple[PanelPv, ...]:
    return tuple(
        pv
        for name, key, units, limit, what in (
            ("Position", "position", "um", settings.bump_limit, "Position"),
            ("Angle", "angle", "urad", settings.bump_angle_limit, "Angle"),
        )
        for pv in pair_of(
            PanelPv(
                f"Bump{name}{plane.upper()}",
                Kind.DOUBLE,
                f"{what} of the orbit by the bump at that place, plane {plane}.",
                units,
                3,
                limits=(-limit / MICRO, limit / MICRO),
                order=Order("bump", key, MICRO, more=(("plane", plane),)),
            )
        )
    )
