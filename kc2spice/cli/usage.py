"""Errors of options of the command line, with what was typed, what is accepted and what to do."""

from __future__ import annotations

import contextlib
import re
from typing import Any

import typer
from typer.core import TyperCommand

from kc2spice.cli.tables import reported_errors
from kc2spice.core.errors import UsageError


def _bad_option(param: Any, typed: list[str]) -> UsageError:
    """The error of an option whose value in the words ``typed`` is no number or out of range."""
    name, words = param.opts[0], [""]
    for k, word in enumerate(typed):
        if word in param.opts:
            words = typed[k + 1 : k + 1 + param.nargs]
        elif word.partition("=")[0] in param.opts:
            words = [word.partition("=")[2]]
    wrong = next((word for word in words if not _is_number(word)), None)
    low, high = _limits(param)
    limits = f"{low:g} to {high:g}" if high is not None else f"at least {low or 0:g}"
    if wrong is None:
        return UsageError("out of range", where=name, got=" ".join(words), expected=limits)
    if param.name != "band":
        return UsageError("not a number", where=name, got=wrong, expected="a number")
    hint = f"kc2spice reduce MODEL {name} 1000 2000"
    with contextlib.suppress(UsageError):
        from kc2spice.core.quantities import quantity

        ends = [quantity(word if word.endswith("Hz") else f"{word}Hz", "Hz") for word in words]
        hint = " ".join([name, *(f"{end:.12g}" for end in ends)])
    return UsageError("not a number", where=name, got=wrong, expected="numbers in Hz", hint=hint)


def _limits(param: Any) -> tuple[float | None, float | None]:
    """Least and greatest value of an option; older typer has them at its type."""
    owner = param if hasattr(param, "min") else getattr(param, "type", None)
    return getattr(owner, "min", None), getattr(owner, "max", None)


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


class Command(TyperCommand):
    """A command whose usage line shows ``SCENE``, where typer shows ``{SCENE}``, and that names
    what was typed for an option with an invalid number."""

    def make_context(self, info_name: Any, args: Any, parent: Any = None, **extra: Any) -> Any:
        typed = list(args)
        try:
            return super().make_context(info_name, args, parent, **extra)
        except typer.BadParameter as error:
            number = re.search("number|integer|float|range", error.message)
            limited = _limits(error.param) != (None, None)
            if type(error) is not typer.BadParameter or not (number or limited):
                raise
            with reported_errors():
                raise _bad_option(error.param, typed) from None

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        return [piece.strip("{}") for piece in super().collect_usage_pieces(ctx)]
