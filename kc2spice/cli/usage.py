"""Errors of the command line: options, arguments and commands, with the typed text and a hint.
typer reports these mistakes in another form. :class:`CheckedCommand` and :class:`CheckedCommands`
report them in the form of all errors: the mistake, the typed text, what is accepted, what to do
next.
"""

from __future__ import annotations

import contextlib
import difflib
import re
import shlex
from importlib import resources
from itertools import chain
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup

from kc2spice.cli.tables import reported_errors
from kc2spice.core.errors import UsageError, candidates, did_you_mean, unknown

PROGRAM = "kc2spice"
_ParserError: Any = typer.BadParameter.__base__  # older versions of typer take the class from click


class CheckedCommand(TyperCommand):
    """A command whose usage line shows ``SCENE`` instead of ``{SCENE}``, and whose errors have the
    form of all others."""

    def make_context(self, info_name: Any, args: Any, parent: Any = None, **extra: Any) -> Any:
        typed = list(args)
        extra.setdefault("allow_extra_args", True)  # refused below, with the typed text
        with reported_errors():
            try:
                context = super().make_context(info_name, args, parent, **extra)
            except _ParserError as error:
                raise _parser_error(self, error, typed) from None
            if context.args and not context.resilient_parsing:
                raise _extra_word_error(self, context.args[0], typed)
        return context

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        return [piece.strip("{}") for piece in super().collect_usage_pieces(ctx)]


class CheckedCommands(TyperGroup):
    """All commands. Errors of unknown commands or options have the form of all other errors."""

    def make_context(self, info_name: Any, args: Any, parent: Any = None, **extra: Any) -> Any:
        try:
            return super().make_context(info_name, args, parent, **extra)
        except _ParserError as error:
            if not hasattr(error, "option_name"):  # no argument at all prints the help
                raise
            with reported_errors():
                raise _unknown_option_error(self, error.option_name, PROGRAM) from None

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        name = str(args[0])
        if self.get_command(ctx, name) is None and not ctx.resilient_parsing:
            with reported_errors():
                raise _unknown_command_error(name, self.list_commands(ctx))
        return super().resolve_command(ctx, args)


def _unknown_command_error(name: str, commands: list[str]) -> UsageError:
    error = unknown("no such command", name, commands, command=f"{PROGRAM} --help")
    scene = resources.files("kc2spice") / "scenes" / f"{name}.toml"
    near = difflib.get_close_matches(name, commands, n=1)
    if near:
        error.hint = f"did you mean {near[0]!r}?"
    else:
        known = name.endswith(".toml") or scene.is_file()
        error.hint = (
            f"{PROGRAM} run {name}" if known else f"{PROGRAM} --help describes all commands"
        )
    return error


def _parser_error(command: Any, error: Any, typed: list[str]) -> UsageError:
    """The error of a command whose words ``typed`` the parser refused with ``error``."""
    param = getattr(error, "param", None)
    name = getattr(error, "option_name", None)
    if name is not None:
        param = next((item for item in command.params if name in item.opts), None)
        if param is None:
            return _unknown_option_error(command, name, f"{PROGRAM} {command.name}")
        return _missing_value_error(param, name, typed)
    if param is None:
        return UsageError(
            error.format_message(), where=command.name, got=_typed_line(command, typed)
        )
    if type(error) is not typer.BadParameter:
        return _missing_argument_error(command, param, typed)
    number = re.search("number|integer|float|range", error.message)
    if number or _option_limits(param) != (None, None):
        return _invalid_number_error(param, typed, "integer" in error.message)
    return UsageError(error.message, where=param.opts[0], got=_typed_line(command, typed))


def _typed_line(command: Any, typed: list[str]) -> str:
    """The command line as typed."""
    return " ".join([PROGRAM, command.name, shlex.join(typed)]).strip()


def _unknown_option_error(command: Any, name: str, line: str) -> UsageError:
    words = chain.from_iterable(item.opts for item in command.params)
    options = [word for word in words if word.startswith("--")]
    expected = f"one of {candidates(name, options, f'{line} --help')}"
    hint = did_you_mean(name, options) or f"{line} --help describes all options"
    where = line.removeprefix(PROGRAM).strip() or None
    return UsageError("no such option", where=where, got=name, expected=expected, hint=hint)


def _missing_value_error(param: Any, name: str, typed: list[str]) -> UsageError:
    """The error of an option without its value, or of a flag with one."""
    words = _option_words(param, typed)
    if getattr(param, "is_flag", False):
        got = next((word for word in typed if word.startswith(f"{name}=")), name)
        return UsageError(
            "this option takes no value",
            where=name,
            got=got,
            expected=name,
            hint=f"write {name} alone",
        )
    expected = f"{name} {param.metavar}"
    got = " ".join([name, *words])
    problem = "the value is missing" if param.nargs == 1 else f"needs {param.nargs} values"
    hint = f"write {param.metavar} behind {name}, or leave out {name}"
    return UsageError(problem, where=name, got=got, expected=expected, hint=hint)


def _missing_argument_error(command: Any, param: Any, typed: list[str]) -> UsageError:
    """The error of a command without one of its arguments."""
    arguments = [item.metavar for item in command.params if item.param_type_name == "argument"]
    return UsageError(
        f"the argument {param.metavar} is missing",
        where=command.name,
        got=_typed_line(command, typed),
        expected=" ".join([PROGRAM, command.name, *arguments]),
        hint=f"for example  {_example(command)}",
    )


def _extra_word_error(command: Any, word: str, typed: list[str]) -> UsageError:
    """The error of a word that is neither an option nor an argument of the command."""
    place = typed.index(word) if word in typed else 0
    hint = f"delete {shlex.quote(word)}"
    if typed[max(0, place - 2) : place - 1] == ["--set"]:
        value = [typed[place - 1]]
        for item in typed[place - 1 + 1 :]:
            if item.startswith("--"):
                break
            value.append(item)
        hint = f"put quotes around a value with blanks: --set {shlex.quote(' '.join(value))}"
    elif "=" in word:
        hint = f"write --set {shlex.quote(word)}"
    arguments = [item.metavar for item in command.params if item.param_type_name == "argument"]
    return UsageError(
        "one argument too many",
        where=command.name,
        got=word,
        expected=" ".join([PROGRAM, command.name, *arguments, "[OPTIONS]"]),
        hint=hint,
    )


def _example(command: Any) -> str:
    """The first example of the help text."""
    lines = [line.strip() for line in (command.epilog or "").splitlines()]
    return next((line for line in lines if line.startswith(PROGRAM)), f"{PROGRAM} --help")


def _option_words(param: Any, typed: list[str]) -> list[str]:
    """Words typed as the last value of an option."""
    words: list[str] = []
    for k, word in enumerate(typed):
        if word in param.opts:
            words = typed[k + 1 : k + 1 + param.nargs]
        elif word.partition("=")[0] in param.opts:
            words = [word.partition("=")[2]]
    return words


def _invalid_number_error(param: Any, typed: list[str], fractional: bool) -> UsageError:
    """The error of an option whose value in the words ``typed`` is no number or out of range.

    ``fractional`` states that the value is not a whole number although the option needs one.
    """
    name, words = param.opts[0], _option_words(param, typed)
    wrong = next((word for word in words if not _is_number(word)), None)
    low, high = _option_limits(param)
    limits = f"{low:g} to {high:g}" if high is not None else f"at least {low or 0:g}"
    if wrong is None:
        problem = "not a whole number" if fractional else "out of range"
        unlimited = low is None and high is None
        expected = "a whole number" + ("" if unlimited else f", {limits}") if fractional else limits
        return UsageError(problem, where=name, got=" ".join(words), expected=expected)
    if param.name != "band":
        return UsageError("not a number", where=name, got=wrong, expected="a number")
    hint = f"write {name} 1000 2000 for 1 to 2 kHz"
    with contextlib.suppress(UsageError):
        from kc2spice.core.quantities import quantity

        ends = [quantity(word if word.endswith("Hz") else f"{word}Hz", "Hz") for word in words]
        hint = " ".join(["write", name, *(f"{end:.12g}" for end in ends)])
    return UsageError("not a number", where=name, got=wrong, expected="numbers in Hz", hint=hint)


def _option_limits(param: Any) -> tuple[float | None, float | None]:
    """Least and greatest value of an option; older versions of typer store both in its type."""
    owner = param if hasattr(param, "min") else getattr(param, "type", None)
    return getattr(owner, "min", None), getattr(owner, "max", None)


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
