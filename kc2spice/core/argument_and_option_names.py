"""Names of Python arguments and of command-line options in errors.

The Python interface and the command line call the same functions, which raise the same errors. The
functions of this module replace the names of one interface by the names of the other, for example
``tolerance=1e-4`` by ``--tolerance 1e-4``.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import wraps
from typing import Any, ParamSpec, TypeVar

from kc2spice.core.errors import ArgumentError, UsageError, did_you_mean, list_candidates

P = ParamSpec("P")
R = TypeVar("R")

LONGEST_VALUE = 80  # largest number of characters of a value that advice repeats
_PAIR_OPTION = "band"  # option with two values
_LIST_OPTION = "vary"  # option that may be repeated; the Python argument is a list
# A word after an option is its value if it contains a digit, a capital letter or an equals sign.
# A word without such a character belongs to the sentence of the error.
_WORD = r"(?:'[^']*'|(?=\S*[\dA-Z=])\S*[^\s,;:.)])"
# A command line, such as "kc2spice scenes --keys", keeps its options.
_COMMAND = r"(?P<command>\bkc2spice(?: [^\s,;:)]+)+)"
_OPTION = re.compile(
    rf"{_COMMAND}|(?P<noun>options? )?--(?P<name>[a-z][a-z-]*)(?: (?P<value>{_WORD}(?: {_WORD})?))?"
)
_ARGUMENT_VALUE = r"(?P<value>\((?P<pair>[^)]*)\)|\['(?P<item>[^']*)'\]|'[^']*'|[^\s,;:)]+)"


def replace_arguments_by_options(error: UsageError, names: Iterable[str]) -> None:
    """Replace the names of Python arguments in an error by command-line options.

    >>> error = UsageError("no band", where="band", hint="add band=(0, 20e3), or leave out order")
    >>> replace_arguments_by_options(error, ["band", "order"])
    >>> print(error)
    --band: no band
      next:     add --band 0 20e3, or leave out --order
    """
    pattern = "|".join(map(re.escape, names))
    assigned = re.compile(rf"(?<![\w.\-])(?P<name>{pattern})={_ARGUMENT_VALUE}")
    alone = re.compile(rf"\b(leave out|delete|add|raise|lower|arguments?) ({pattern})\b(?!=)")

    def write_option(match: re.Match[str]) -> str:
        """Write the command-line option that replaces a Python argument in an error text."""
        value = match["item"] or match["value"]
        if match["pair"] is not None:
            value = match["pair"].replace(",", "")
        return f"--{match['name']} {value}"

    def translate(text: str) -> str:
        """Replace all Python arguments in a text by command-line options."""
        options = alone.sub(r"\1 --\2", assigned.sub(write_option, text))
        return re.sub(r"\bargument(s?) --", r"option\1 --", options)

    _translate_error(error, translate)
    if error.where is not None and re.fullmatch(pattern, error.where):
        error.where = f"--{error.where}"


def replace_options_by_arguments(error: UsageError, overrides: str = "overrides") -> None:
    """Replace options of the command line in an error by arguments of a Python call.

    ``overrides`` is the argument that corresponds to the option ``--set``.

    >>> error = UsageError("no shunt", where="--shunt", hint="add for example  --shunt '100 Ohm'")
    >>> replace_options_by_arguments(error)
    >>> print(error)
    shunt: no shunt
      next:     add for example  shunt='100 Ohm'
    """

    def write_argument(match: re.Match[str]) -> str:
        """Write the Python argument that replaces a command-line option in an error text.

        If the match is a whole command line, the matched text is returned unchanged.
        """
        if match["command"]:
            return match[0]
        name, value = match["name"], match["value"]
        noun = (match["noun"] or "").replace("option", "argument")
        if value is None:
            return f"{noun}{name}"
        first, blank, second = value.partition(" ") if value[0] != "'" else (value, "", "")
        if name == _PAIR_OPTION:
            return f"{noun}{name}=({first}, {second})"
        value_text = f"['{first}']" if name == _LIST_OPTION else first
        return f"{noun}{name}={value_text}{blank}{second}"

    _translate_error(error, lambda text: _OPTION.sub(write_argument, text))
    if error.where is not None:
        location = re.sub(r"^--set:?(?= |$)", f"{overrides}:", error.where).removesuffix(":")
        error.where = location.removeprefix("--")


def _translate_error(error: UsageError, translate: Callable[[str], str]) -> None:
    """Apply a translation function to message, expected values and hint of an error."""
    error.message = translate(error.message)
    error.expected = error.expected and translate(error.expected)
    error.hint = error.hint and translate(error.hint)


@contextmanager
def use_arguments_in_errors(overrides: str = "overrides") -> Iterator[None]:
    """Use Python arguments instead of command options in errors of a ``with`` block."""
    try:
        yield
    except UsageError as error:
        replace_options_by_arguments(error, overrides)
        raise


@contextmanager
def use_options_in_errors(names: Iterable[str]) -> Iterator[None]:
    """Use command options instead of Python arguments in errors of a ``with`` block."""
    try:
        yield
    except UsageError as error:
        replace_arguments_by_options(error, names)
        raise


def check_arguments(function: Callable[P, R]) -> Callable[P, R]:
    """Make a function raise errors with advice about missing or unknown arguments.

    >>> @check_arguments
    ... def run(scene, out=None):
    ...     return scene
    >>> run("impact", ouut="folder")
    Traceback (most recent call last):
        ...
    kc2spice.core.errors.ArgumentError: run: this argument does not exist
      got:      ouut
      expected: one of scene, out
      next:     did you mean 'out'?
    """
    signature = inspect.signature(function)

    @wraps(function)
    def call(*values: P.args, **named_values: P.kwargs) -> R:
        try:
            signature.bind(*values, **named_values)
        except TypeError:
            raise _make_argument_error(function.__name__, signature, values, named_values) from None
        return function(*values, **named_values)

    return call


def _suggest_overrides(name: str, value: object) -> str:
    """Suggest the argument ``overrides`` for an unknown argument of a call.

    A table of keys, or a list of texts ``KEY=VALUE``, is suggested unchanged. Any other value is
    suggested as the value of a key of a part.
    """
    texts = list(value) if isinstance(value, (list, tuple)) and value else [value]
    if isinstance(value, Mapping) or all(isinstance(text, str) and "=" in text for text in texts):
        keys = repr([value] if isinstance(value, str) else value)
        return f"to set keys, write overrides={keys if len(keys) <= LONGEST_VALUE else 'VALUE'}"
    short = repr(value)
    if len(short) > LONGEST_VALUE:
        short = "VALUE"
    return f'to set a key of a part, write overrides={{"PART.{name}": {short}}}'


def _make_argument_error(
    function: str,
    signature: inspect.Signature,
    values: tuple[Any, ...],
    named_values: Mapping[str, Any],
) -> ArgumentError:
    """Return the error about a call whose arguments do not fit the signature."""
    parameters = signature.parameters
    positional = [p.name for p in parameters.values() if p.kind is not p.KEYWORD_ONLY]
    required = [p.name for p in parameters.values() if p.default is p.empty]
    present = {*positional[: len(values)], *named_values}
    lacking = [name for name in required if name not in present]
    unknown_names = [name for name in named_values if name not in parameters]
    if unknown_names:
        name = unknown_names[0]
        hint = did_you_mean(name, parameters) or f"leave out {name}"
        if "overrides" in parameters and hint.startswith("leave out"):
            hint = _suggest_overrides(name, named_values[name])
        return ArgumentError(
            "this argument does not exist",
            where=function,
            got=name,
            expected=f"one of {list_candidates(name, parameters)}",
            hint=hint,
        )
    if len(values) > len(positional):
        further = [name for name in parameters if name not in positional]
        return ArgumentError(
            "too many arguments without a name",
            where=function,
            got=f"{len(values)} arguments without a name",
            expected=f"at most {len(positional)}: {', '.join(positional)}",
            hint=f"write NAME=VALUE for {list_candidates('', further)}"
            if further
            else f"leave out all arguments after {positional[-1]}",
        )
    if lacking:
        names = ", ".join(lacking)
        return ArgumentError(
            f"the argument{'s' if len(lacking) > 1 else ''} {names} "
            f"{'are' if len(lacking) > 1 else 'is'} missing",
            where=function,
            got=f"only {', '.join(name for name in parameters if name in present)}"
            if present
            else "no arguments",
            expected=f"the argument{'s' if len(required) > 1 else ''} {', '.join(required)}",
            hint=f"write  {function}({', '.join(required)})",
        )
    twice = next(name for name in positional[: len(values)] if name in named_values)
    return ArgumentError(
        "this argument is given twice",
        where=function,
        got=f"{twice} without its name, and {twice}=",
        expected=f"{function}({', '.join(required)})",
        hint=f"delete {twice}=",
    )
