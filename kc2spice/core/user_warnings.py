"""Warnings that name the line of the user's program."""

from __future__ import annotations

import sys
import warnings

_PACKAGE = __name__.partition(".")[0]


def warn_user(message: str) -> None:
    """Issue a UserWarning at the line that called kc2spice.

    The location is the line outside of the package that called the outermost function of the
    package. Python prints this line with the warning.
    """
    level, user_level = 1, 2
    frame = sys._getframe()
    while frame.f_back is not None:
        if frame.f_globals.get("__name__", "").partition(".")[0] == _PACKAGE:
            user_level = level + 1
        frame, level = frame.f_back, level + 1
    warnings.warn(message, stacklevel=user_level)
