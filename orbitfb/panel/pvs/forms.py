"""The forms that most PVs of the panel have."""

from dataclasses import replace

from orbitfb.panel.pv import LONGEST_TEXT, NO_RANGE, Kind, Order, PanelPv

MILLI, MICRO = 1e-3, 1e-6
ONCE = ("-", "do")
"""Words of a command that takes nothing with it."""


def text_pv(name: str, meaning: str, order: Order | None = None) -> PanelPv:
    """Make a text."""
    return PanelPv(name, Kind.TEXT, meaning, length=LONGEST_TEXT, order=order)


def number_pv(name: str, meaning: str, units: str, precision: int) -> PanelPv:
    """Make a number that is shown."""
    return PanelPv(name, Kind.DOUBLE, meaning, units, precision)


def count_pv(name: str, meaning: str) -> PanelPv:
    """Make a count that is shown."""
    return PanelPv(name, Kind.INTEGER, meaning)


def choice_pv(name: str, meaning: str, states: tuple[str, ...], *requests: object) -> PanelPv:
    """Make a choice of commands.

    Args:
        name: Without the prefix.
        meaning: In one sentence.
        states: Its words.
        requests: What each word but the first asks for.
    """
    choices = tuple(dict(request) if isinstance(request, dict) else None for request in requests)
    return PanelPv(
        name, Kind.CHOICE, meaning, states=states, order=Order("", choices=(None, *choices))
    )


def pair_of(pv: PanelPv) -> tuple[PanelPv, PanelPv]:
    """Make of one quantity the PV that is written and the one that shows what is in force."""
    return (
        replace(pv, name=f"{pv.name}-SP"),
        replace(pv, name=f"{pv.name}-RB", limits=NO_RANGE, order=None),
    )
