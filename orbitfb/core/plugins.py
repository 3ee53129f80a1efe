"""What other packages add to this one, by entry points of their distributions."""

from collections.abc import Mapping
from importlib.metadata import EntryPoint, entry_points
from typing import TypeVar

from orbitfb.core.errors import ConfigError

T = TypeVar("T")

EFFECTS = "orbitfb.effects"
"""Group of effects: each entry point is a class."""
POLICIES = "orbitfb.policies"
"""Group of policies: the name of each entry point is the kind."""


def added(group: str, wanted: type[T]) -> Mapping[str, T]:
    """Load what installed packages add.

    What cannot be loaded is refused, not left out: a loop that was told to use it must not run
    without it, and a diagnosis that lacks a cause would name another one.

    Args:
        group: Of the entry points.
        wanted: What each must be.

    Returns:
        What was loaded, by the name of its entry point.

    Raises:
        ConfigError: One cannot be loaded, or is something else; says of which package.
    """
    return {entry.name: _load(entry, wanted) for entry in entry_points(group=group)}


def whose(entry: EntryPoint) -> str:
    """Say which package an entry point is of.

    Args:
        entry: The entry point.
    """
    package = entry.dist.name if entry.dist is not None else "?"
    return f"entry point {entry.name} ({entry.group}) of the package {package}"


def _load(entry: EntryPoint, wanted: type[T]) -> T:
    advice = "repair or uninstall that package"
    try:
        item = entry.load()
    except Exception as error:
        raise ConfigError(
            f"{whose(entry)} cannot be loaded: {type(error).__name__}: {error}; {advice}"
        ) from error
    if not isinstance(item, wanted):
        raise ConfigError(
            f"{whose(entry)}: {entry.value} is {type(item).__name__}, expected was "
            f"{wanted.__name__}; {advice}"
        )
    return item
