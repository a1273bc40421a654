"""Our docstrings in the words of the site's generator: an extension of griffe (see mkdocs.yml)."""

from __future__ import annotations

import re
from typing import Any

import griffe

_ROLE = re.compile(r":\w+:`~?(?:kc2spice\.)?([^`]+)`")
_ENTRY = re.compile(r"(?m)^(\w+(?:, \w+)*) : (.*)$")
_RAISES = re.compile(r"(Raises\n-+\n)(.*?)(?=\n\n|\Z)", re.DOTALL)


class Docstrings(griffe.Extension):
    """Rewrites roles and quotes, and ``Error : text`` as numpydoc wants it."""

    def on_object(self, *, obj: griffe.Object, **kwargs: Any) -> None:
        """Called once for every object that is read."""
        if obj.docstring is not None and not obj.is_alias:
            obj.docstring.value = rewritten(obj.docstring.value)


def rewritten(text: str) -> str:
    """``:func:`x``` and double quotes as code; errors on a line of their own."""
    text = _ROLE.sub(r"`\1`", text).replace("``", "`")
    return _RAISES.sub(lambda found: found[1] + _entries(found[2]), text)


def _entries(text: str) -> str:
    """One entry an error, its text indented below it."""
    joined = re.sub(r"\n\s+", " ", text)
    return _ENTRY.sub(r"\1\n    \2", joined)
