"""Groups of members that are joined in pairs, such as nets that sources connect."""

from __future__ import annotations

from collections.abc import Hashable, Iterable
from typing import Any


class DisjointGroups:
    """Disjoint groups of members, with a method that joins two groups."""

    def __init__(self, members: Iterable[Hashable]) -> None:
        self._groups = {member: [member] for member in members}

    def are_joined(self, a: Hashable, b: Hashable) -> bool:
        """Return whether two members are in the same group."""
        return self._groups[a] is self._groups[b]

    def join(self, a: Hashable, b: Hashable) -> None:
        """Merge the group that contains ``a`` and the group that contains ``b``."""
        second, first = sorted((self._groups[a], self._groups[b]), key=len)
        if first is not second:  # the smaller group is copied, so that many joins take little time
            first += second
            self._groups.update(dict.fromkeys(second, first))

    def list_groups(self) -> list[list[Any]]:
        """List all groups of joined members, in the order of their first members."""
        result: dict[int, list[Any]] = {}
        for member, group in self._groups.items():
            result.setdefault(id(group), []).append(member)
        return list(result.values())
