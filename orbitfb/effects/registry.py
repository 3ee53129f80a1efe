"""Every kind of effect by its id: each module of this package that defines one adds it."""

import importlib
import inspect
import pkgutil
from functools import cache

import orbitfb.effects
from orbitfb.core.errors import ConfigError
from orbitfb.core.near_names import did_you_mean
from orbitfb.effects.kinds import EffectKind


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
    return dict(sorted(found.items()))


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
