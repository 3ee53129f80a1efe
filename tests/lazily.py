"""Modules that are imported where they are first used: every worker collects all tests."""

import importlib
from typing import Any


class Lazy:
    """Stands for a module that takes seconds to import.

    Args:
        name: Its name.
    """

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, attribute: str) -> Any:
        if attribute.startswith("_"):  # pytest asks everything in a module whether it is a fixture
            raise AttributeError(attribute)
        return getattr(importlib.import_module(self._name), attribute)
