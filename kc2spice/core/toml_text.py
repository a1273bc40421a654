"""Values as TOML text, as in a scene file."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import Any

_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")  # pattern of keys that TOML reads without quotes


def format_toml(value: Any) -> str:
    """Format a value as TOML with all digits, as in a scene file.

    >>> format_toml([[0, 0], ["1 ms", 5]])
    '[[0, 0], ["1 ms", 5]]'
    """
    if isinstance(value, Mapping):
        items = (f"{_format_key(key)} = {format_toml(item)}" for key, item in value.items())
        return f"{{ {', '.join(items)} }}" if value else "{}"
    if hasattr(value, "tolist"):  # numpy arrays and numbers
        return format_toml(value.tolist())
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(format_toml, value)) + "]"
    return repr(value) if isinstance(value, float) else json.dumps(value, default=str)


def _format_key(key: object) -> str:
    """Format a key as TOML, without quotes if possible."""
    return key if isinstance(key, str) and _BARE_KEY.fullmatch(key) else json.dumps(key)


def display_text(value: Any) -> str:
    """Format a value for display, cut after 120 characters.

    A number with too many digits is described in words.
    """
    try:
        return clip_text(quote_value(value))
    except ValueError:
        return f"a {type(value).__name__} that is too long to print"


def quote_value(value: Any) -> str:
    """Format a value as text for an error message.

    Tables and lists are written in TOML syntax, and all other values as ``repr`` formats them.
    """
    if isinstance(value, Mapping):
        return (
            "{ " + ", ".join(f"{key} = {quote_value(item)}" for key, item in value.items()) + " }"
        )
    if isinstance(value, list):
        return "[" + ", ".join(map(quote_value, value)) + "]"
    return repr(value)


def clip_text(text: str) -> str:
    """Cut a text after 120 characters."""
    return text if len(text) <= 120 else text[:120] + " …"
