"""Names of Python arguments and of command-line options in errors.

The Python interface and the command line call the same functions, which raise the same errors. The
functions of this module replace the names of one interface by the names of the other, for example
``tolerance=1e-4`` by ``--tolerance 1e-4``.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager

from kc2spice.core.errors import UsageError

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
