"""Large results in memory, beside those on disk in :mod:`kc2spice.core.cache`.

A scene, a build and a sweep have one :class:`Workspace` each, so that no module holds results.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

T = TypeVar("T")


class Workspace:
    """The latest result of each kind, with the key that it follows from.

    Threads may share it: one thread never gets the result of another key.

    Examples
    --------
    >>> workspace = Workspace()
    >>> workspace.latest("square", 3, lambda: 9)
    9
    >>> workspace.latest("square", 3, lambda: 0)  # the same key: not computed again
    9
    >>> workspace.latest("square", 4, lambda: 16)
    16
    """

    def __init__(self) -> None:
        self._entries: dict[str, tuple[Any, Any]] = {}

    def latest(self, kind: str, key: Any, compute: Callable[[], T]) -> T:
        """Return the result of ``key``, computed unless it is the latest of its kind.

        The former result is dropped first: two at a time would need twice the memory.
        """
        entry = self._entries.get(kind)
        if entry is None or entry[0] != key:
            entry = None
            self._entries.pop(kind, None)
            entry = self._entries[kind] = key, compute()
        result: T = entry[1]
        return result

    def __reduce__(self) -> tuple[type[Workspace], tuple[()]]:
        """Another process begins with an empty workspace."""
        return Workspace, ()
