"""Libraries that are loaded at their first use: most commands find their models in the cache."""

from __future__ import annotations

from importlib import import_module
from typing import Any


class _Lazy:
    """Stands for a module; looking up a name of it loads it."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, name: str) -> Any:
        found = import_module(self._name)
        if not hasattr(found, name):  # a package in it that nothing has loaded yet
            import_module(f"{self._name}.{name}")
        return getattr(found, name)


def lazy(name: str) -> Any:
    """The module ``name``, not loaded before something of it is used."""
    return _Lazy(name)
