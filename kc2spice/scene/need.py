"""Sections that a stage cannot do without."""

from __future__ import annotations

from typing import TypeVar

from kc2spice.core.errors import UsageError

Part = TypeVar("Part")


def need(section: Part | None, key: str) -> Part:
    """``section`` if the scene has it. Raises UsageError naming ``key`` otherwise."""
    if section is None:
        raise UsageError("this study needs a section that the scene lacks", where=key)
    return section
