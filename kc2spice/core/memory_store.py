"""Store of large results in memory.

Each scene, built scene and sweep has its own :class:`Workspace`. No results are stored in global
variables. The module :mod:`kc2spice.core.cache` stores results on disk.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

T = TypeVar("T")


class Workspace:
    """Workspace in memory that stores only the latest result of each kind.

    A key identifies the inputs of each result. Several threads may share a workspace. A thread
    never receives a result for another key.

    Examples
    --------
    >>> workspace = Workspace()
    >>> workspace.get_or_compute("square", 3, lambda: 9)
    9
    >>> workspace.get_or_compute("square", 3, lambda: 0)  # the same key: not computed again
    9
    >>> workspace.get_or_compute("square", 4, lambda: 16)
    16
    """

    def __init__(self) -> None:
        self._entries: dict[str, tuple[Any, Any]] = {}

    def get_or_compute(self, kind: str, key: Any, compute: Callable[[], T]) -> T:
        """Return the stored result if its key is unchanged; otherwise compute a new one.

        A new result is computed if the key has changed. The previous result is deleted before the
        computation, because two results would need twice the memory.
        """
        entry = self._entries.get(kind)
        if entry is None or entry[0] != key:
            entry = None
            self._entries.pop(kind, None)
            entry = self._entries[kind] = key, compute()
        result: T = entry[1]
        return result

    def __reduce__(self) -> tuple[type[Workspace], tuple[()]]:
        """Pickle an empty workspace, because results are not pickled."""
        return Workspace, ()
