"""Warnings that name the line of the user's program."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_PACKAGE = __name__.partition(".")[0]
# texts of warnings in this thread, if they are collected instead of issued
_collected: ContextVar[dict[str, None] | None] = ContextVar("_collected", default=None)


@contextmanager
def collect_warnings() -> Iterator[dict[str, None]]:
    """Collect the warnings of a ``with`` block in this thread, and issue none of them.

    The keys of the yielded dictionary are the texts of the warnings, in their order. Unlike
    ``warnings.catch_warnings``, this function also works in several threads at a time.
    """
    texts = dict[str, None]()
    token = _collected.set(texts)
    try:
        yield texts
    finally:
        _collected.reset(token)


def warn_user(message: str) -> None:
    """Issue a UserWarning at the line that called kc2spice.

    The location is the line outside of the package that called the outermost function of the
    package. Python prints this line with the warning. In a ``with`` block of
    :func:`collect_warnings`, the warning is collected instead.
    """
    if (texts := _collected.get()) is not None:
        texts[message] = None
        return
    level, user_level = 1, 2
    frame = sys._getframe()
    while frame.f_back is not None:
        if frame.f_globals.get("__name__", "").partition(".")[0] == _PACKAGE:
            user_level = level + 1
        frame, level = frame.f_back, level + 1
    warnings.warn(message, stacklevel=user_level)
