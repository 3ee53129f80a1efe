"""Every kind of effect by its id: those of this package, and those that other packages add.

Each module of this package that defines a kind adds it; another package names its classes as
entry points of the group `orbitfb.effects`.
"""

import importlib
import inspect
import pkgutil
import re
from functools import cache

import orbitfb.effects
from orbitfb.core.errors import ConfigError
from orbitfb.core.near_names import did_you_mean
from orbitfb.core.plugins import EFFECTS, added
from orbitfb.effects.kinds import EffectKind

_HERE = f"entry point ({EFFECTS})"
_ID = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")
_TOLD = ("id", "stage", "target", "parameters", "title", "sentence", "equation")
"""What a kind tells of itself; the rest has a default."""


@cache
def all_effects() -> dict[str, EffectKind]:
    """Every kind of effect, in alphabetical order of the ids."""
    found: dict[str, EffectKind] = {}
    for module in pkgutil.walk_packages(orbitfb.effects.__path__, "orbitfb.effects."):
        content = vars(importlib.import_module(module.name))
        for item in content.values():
            if (
                inspect.isclass(item)
                and issubclass(item, EffectKind)
                and not inspect.isabstract(item)
                and item.__module__ == module.name
            ):
                found[item.id] = item()
    for name, item in added(EFFECTS, type).items():
        kind = _checked(name, item)
        if kind.id in found:
            raise ConfigError(f"{_HERE} {name}: there is an effect {kind.id} already")
        found[kind.id] = kind
    return dict(sorted(found.items()))


def _checked(name: str, item: type) -> EffectKind:
    """See that what another package adds is an effect that can be made, and make it."""
    if not issubclass(item, EffectKind):
        raise ConfigError(f"{_HERE} {name}: {item.__name__} is no EffectKind")
    if missing := sorted(getattr(item, "__abstractmethods__", ())):
        raise ConfigError(f"{_HERE} {name}: {item.__name__} does not define {', '.join(missing)}")
    if missing := [each for each in _TOLD if not hasattr(item, each)]:
        raise ConfigError(f"{_HERE} {name}: {item.__name__} does not say {', '.join(missing)}")
    if not _ID.fullmatch(item.id):
        raise ConfigError(f"{_HERE} {name}: {item.id!r} is no id, use letters a to z and hyphens")
    return item()


def effect(name: str) -> EffectKind:
    """Find a kind of effect.

    Raises:
        ConfigError: There is none of that name.
    """
    known = all_effects()
    if name not in known:
        hint = did_you_mean(name, known)
        raise ConfigError(f"no effect is called {name!r}{hint}; `orbitfb effects` lists them")
    return known[name]
