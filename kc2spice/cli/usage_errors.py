"""Errors about wrong options, arguments and commands of the command line."""

from __future__ import annotations

import contextlib
import difflib
import itertools
import re
import shlex
from collections.abc import Sequence
from importlib import resources
from itertools import chain
from pathlib import Path
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup

from kc2spice.cli.terminal_output import report_errors
from kc2spice.core.errors import UsageError, did_you_mean, list_candidates, unknown
from kc2spice.core.unit_spelling import convert_percentage

PROGRAM = "kc2spice"
# Order of the commands in the help: everyday commands, studies, models, installation.
COMMAND_ORDER = (
    "scenes", "parts", "explain", "run", "verify", "sweep", "bench", "export", "reduce", "fit",
    "doctor",
)  # fmt: skip
_MAX_WORDS_OF_NAME = 12  # largest number of words of a file name with blanks
_SEARCH_ARGUMENT = "SEARCH"  # name of an argument that may consist of several words
# base class of parser errors, which is a class of click in older versions of typer
_ParserError: Any = typer.BadParameter.__base__


class CheckedCommand(TyperCommand):
    """Command with checked arguments: a wrong argument is a :class:`UsageError`.

    The usage line of the command has no braces.
    """

    def make_context(self, info_name: Any, args: Any, parent: Any = None, **extra: Any) -> Any:
        """Make a command's context; report a wrong argument as a :class:`UsageError`."""
        typed = list(args)
        # Extra arguments are rejected below, in an error that contains the typed text.
        extra.setdefault("allow_extra_args", True)
        with report_errors():
            try:
                context = super().make_context(info_name, args, parent, **extra)
            except _ParserError as error:
                raise _make_parser_error(self, error, typed) from None
            if context.args and not context.resilient_parsing:
                raise _make_extra_word_error(self, context.args, typed)
        return context

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """Return the words of the command's usage line, without braces."""
        return [piece.strip("{}") for piece in super().collect_usage_pieces(ctx)]


class CheckedCommands(TyperGroup):
    """Group of checked commands: an unknown name or option is a :class:`UsageError`."""

    def make_context(self, info_name: Any, args: Any, parent: Any = None, **extra: Any) -> Any:
        """Make the context of the program from the options before the name of the command."""
        try:
            return super().make_context(info_name, args, parent, **extra)
        except _ParserError as error:
            if not hasattr(error, "option_name"):  # without arguments, the help is printed
                raise
            with report_errors():
                raise _make_unknown_option_error(self, error.option_name, PROGRAM) from None

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of all commands, in the order of :data:`COMMAND_ORDER`."""
        return sorted(super().list_commands(ctx), key=COMMAND_ORDER.index)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return the command with the typed name, or report a :class:`UsageError`."""
        name = str(args[0])
        if self.get_command(ctx, name) is None and not ctx.resilient_parsing:
            with report_errors():
                raise _make_unknown_command_error(name, self.list_commands(ctx))
        return super().resolve_command(ctx, args)


# Command names of other programs, and the command of this program with the same meaning.
_COMMAND_SYNONYMS = {
    "simulate": "run", "sim": "run", "start": "run", "solve": "run", "plot": "run",
    "netlist": "export", "write": "export", "convert": "export", "test": "verify",
    "check": "verify", "validate": "verify", "optimize": "fit", "list": "scenes", "ls": "scenes",
    "examples": "scenes", "compress": "reduce", "mor": "reduce", "version": "--version",
}  # fmt: skip


def _make_unknown_command_error(name: str, commands: list[str]) -> UsageError:
    """Make the error for an unknown command."""
    error = unknown("this command does not exist", name, commands, command=f"{PROGRAM} --help")
    scene = resources.files("kc2spice") / "scenes" / f"{name}.toml"
    similar = difflib.get_close_matches(name, commands, n=1)
    if similar:
        error.hint = f"did you mean {similar[0]!r}?"
    elif name in _COMMAND_SYNONYMS:
        error.hint = f"write {PROGRAM} {_COMMAND_SYNONYMS[name]} in place of {PROGRAM} {name}"
    else:
        is_scene = name.endswith(".toml") or scene.is_file()
        error.hint = (
            f"{PROGRAM} run {name}" if is_scene else f"{PROGRAM} --help describes all commands"
        )
    return error


def _make_parser_error(command: Any, error: Any, typed: list[str]) -> UsageError:
    """Make a :class:`UsageError` from an error of the command-line parser."""
    param = getattr(error, "param", None)
    name = getattr(error, "option_name", None)
    if name is not None:
        param = next((item for item in command.params if name in item.opts), None)
        if param is None:
            return _make_unknown_option_error(command, name, f"{PROGRAM} {command.name}")
        return _make_option_value_error(param, name, typed)
    if param is None:
        return UsageError(
            error.format_message(),
            where=command.name,
            got=_join_typed_line(command, typed),
            hint=f"{PROGRAM} {command.name} --help lists all options",
        )
    if type(error) is not typer.BadParameter:
        return _make_missing_argument_error(command, param, typed)
    number = re.search("number|integer|float|range", error.message)
    if number or _find_option_limits(param) != (None, None):
        return _make_invalid_number_error(param, typed, "integer" in error.message)
    got, hint = _join_typed_line(command, typed), f"{PROGRAM} {command.name} --help"
    return UsageError(error.message, where=param.opts[0], got=got, hint=f"{hint} lists its values")


def _convert_to_hertz(words: Sequence[str]) -> list[str]:
    """Convert words such as ``20k`` to texts in Hz; return an empty list if one fails."""
    from kc2spice.core.quantities import convert_quantity  # slow import

    with contextlib.suppress(UsageError):
        ends = [
            convert_quantity(word if word.endswith("Hz") else f"{word}Hz", "Hz") for word in words
        ]
        return [f"{end:.12g}" for end in ends]
    return []


def _join_typed_line(command: Any, typed: list[str]) -> str:
    """Return the complete command line as typed, including the program and command."""
    return " ".join([PROGRAM, command.name, shlex.join(typed)]).strip()


# Option names of other programs, and the options of this program with the same meaning.
_OPTION_SYNONYMS = {
    "--format": ("--dialect",),
    "--simulator": ("--dialect",),
    "--output": ("--out",),
    "--dir": ("--out",),
    "--folder": ("--out",),
    "-o": ("--out",),
    "--param": ("--set",),
    "--parameter": ("--set",),
    "--key": ("--set",),
    "--override": ("--set",),
    "-p": ("--set",),
    "--jobs": ("--workers",),
    "--threads": ("--workers",),
    "-j": ("--workers",),
    "-n": ("--workers",),
    "--states": ("--order",),
    "--size": ("--order",),
    "--accuracy": ("--tolerance", "--error"),
    "--tol": ("--tolerance", "--error"),
    "--range": ("--band",),
    "--frequency": ("--band",),
    "--silent": ("--quiet",),
}


def _make_unknown_option_error(command: Any, name: str, line: str) -> UsageError:
    """Make the error for an unknown option."""
    words = chain.from_iterable(item.opts for item in command.params)
    options = [word for word in words if word.startswith("--")]
    similar = did_you_mean(name.strip("-"), [word.strip("-") for word in options])
    suggestion = similar and similar.replace("'", "'--", 1)
    hint = suggestion or f"leave out {name}; {line} --help describes all options"
    synonym = next(filter(options.__contains__, _OPTION_SYNONYMS.get(name, ())), None)
    hint = f"write {synonym} in place of {name}" if synonym else hint
    where = line.removeprefix(PROGRAM).strip() or None
    return UsageError(
        "this option does not exist",
        where=where,
        got=name,
        expected=f"one of {list_candidates(name, options, f'{line} --help')}",
        hint=hint,
    )


def _make_option_value_error(param: Any, name: str, typed: list[str]) -> UsageError:
    """Make the error for an option without a value, or for a flag with a value."""
    words = _find_option_value(param, typed)
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
    if param.name == "dialect":
        from kc2spice.netlist.printers.dialect_registry import list_dialect_names

        expected = f"{name} with one of {', '.join(list_dialect_names())}"
    got = " ".join([name, *words])
    count = param.nargs
    problem = "the value is missing" if count == 1 else f"this option needs {count} values"
    hint = f"write {param.metavar} after {name}, or leave out {name}"
    parts = re.split(r"[-,:…]+|\.\.+", words[0]) if len(words) == 1 and count > 1 else []
    if len(parts) == count and all(parts):
        hint = f"write {name} {' '.join(_convert_to_hertz(parts) or parts)}"
    return UsageError(problem, where=name, got=got, expected=expected, hint=hint)


def _make_missing_argument_error(command: Any, param: Any, typed: list[str]) -> UsageError:
    """Make the error for a command whose argument is missing."""
    arguments = [item.metavar for item in command.params if item.param_type_name == "argument"]
    return UsageError(
        f"the argument {param.metavar} is missing",
        where=command.name,
        got=_join_typed_line(command, typed),
        expected=" ".join([PROGRAM, command.name, *arguments, "[OPTIONS]"]),
        hint=f"for example  {_complete_example(command, typed)}",
    )


def _make_extra_word_error(command: Any, words: list[str], typed: list[str]) -> UsageError:
    """Make the error for words that are neither options nor arguments."""
    word, count = words[0], len(words)
    position = typed.index(word) if word in typed else 0
    hint = f"delete {shlex.join(words)}"
    if typed[max(0, position - 2) : position - 1] == ["--set"]:
        value = [typed[position - 1]]
        for item in typed[position - 1 + 1 :]:
            if item.startswith("--"):
                break
            value.append(item)
        hint = f"put quotes around a value with blanks: --set {shlex.quote(' '.join(value))}"
    elif (name := _find_file_with_blanks(typed)) is not None:
        hint = f"put quotes around the name of the file: {shlex.quote(name)}"
    elif "=" in word:
        hint = f"write --set {shlex.quote(word)}"
    elif count == 1 and any("--part" in item.opts for item in command.params):
        hint = _advise_scenes_argument(f"{PROGRAM} {command.name}", word) or hint
    elif any(item.metavar == _SEARCH_ARGUMENT for item in command.params):
        searched = itertools.takewhile(lambda item: not item.startswith("-"), typed)
        hint = f"write {PROGRAM} {command.name} {shlex.quote(' '.join(searched))}"
    arguments = [item.metavar for item in command.params if item.param_type_name == "argument"]
    return UsageError(
        f"the command line has {'one argument' if count == 1 else f'{count} arguments'} too many",
        where=command.name,
        got=shlex.join(words),
        expected=" ".join([PROGRAM, command.name, *arguments, "[OPTIONS]"]),
        hint=hint,
    )


def read_scene_toml(name: str) -> str:
    """Read the TOML text of a scene: a built-in scene, a part number or a file.

    If a built-in scene reads netlist files, a comment states their paths.

    Raises
    ------
    UsageError : there is no such scene; for the name of a part type, the error advises --part.
    """
    from kc2spice.scene.scene_file import list_gallery, open_scene  # slow import

    try:
        source = open_scene(name)
    except UsageError as error:
        if advice := _advise_scenes_argument(f"{PROGRAM} scenes", name):
            error.hint = advice
        raise
    text = f"{source.text.rstrip()}\n"
    for file in sorted(source.folder.glob("*.lib")) if name in list_gallery() else ():
        if f'"{file.name}"' in text:
            text += f"\n# Copy this file into the folder of the scene: {file}\n"
    return text


def _advise_scenes_argument(line: str, word: str) -> str | None:
    """Advise which argument of ``kc2spice scenes`` a mistyped word probably means.

    Return None if no part type and no option is similar to the word.
    """
    from kc2spice.scene.parttype import list_type_names  # slow import
    from kc2spice.scene.scene_file import list_gallery

    types, scenes = list_type_names(), list_gallery()
    if word in types:
        return f"write {line} --part {word}"
    if word.lower() in ("parts", "part", "types", "keys"):
        return f"write {line} {'--keys' if word.lower() == 'keys' else '--parts'}"
    if word in scenes:
        return f"write {line} {word}"
    similar = difflib.get_close_matches(word, (*types, *scenes), n=1, cutoff=0.7)
    return f"write {line} --part {similar[0]}" if similar and similar[0] in types else None


def _find_file_with_blanks(typed: list[str]) -> str | None:
    """Find a file whose name consists of several typed words, joined by blanks."""
    words = typed[:_MAX_WORDS_OF_NAME]
    for start, end in itertools.combinations(range(len(words) + 1), 2):
        name = " ".join(words[start:end])
        # a name that is too long for the operating system is not the name of a file
        with contextlib.suppress(OSError, ValueError):
            if end - start > 1 and Path(name).is_file():
                return name
    return None


def _complete_example(command: Any, typed: list[str]) -> str:
    """Return an example of a command with the options that the user typed."""
    example = _find_example(command)
    if typed and typed[0].startswith("-"):
        program, name, argument, *_ = example.split()
        return shlex.join([program, name, argument, *typed])
    return example


def _find_example(command: Any) -> str:
    """Return the first example in the help text of a command."""
    lines = [line.strip() for line in (command.epilog or "").splitlines()]
    return next((line for line in lines if line.startswith(PROGRAM)), f"{PROGRAM} --help")


def _find_option_value(param: Any, typed: list[str]) -> list[str]:
    """Find the typed value of an option; for a repeated option, the last value."""
    words: list[str] = []
    for k, word in enumerate(typed):
        if word in param.opts:
            words = typed[k + 1 : k + 1 + param.nargs]
        elif word.partition("=")[0] in param.opts:
            words = [word.partition("=")[2]]
    return words


def _make_invalid_number_error(param: Any, typed: list[str], is_integer: bool) -> UsageError:
    """Make the error for an option whose value is not a number or is out of range.

    ``is_integer`` is true if the option needs a whole number.
    """
    name, words = param.opts[0], _find_option_value(param, typed)
    wrong_word = next((word for word in words if not _is_number(word)), None)
    low, high = _find_option_limits(param)
    limits = f"{low:g} to {high:g}" if high is not None else f"at least {low or 0:g}"
    if wrong_word is None:
        problem = "this value is not a whole number" if is_integer else "this value is out of range"
        unlimited = low is None and high is None
        expected = "a whole number" + ("" if unlimited else f", {limits}") if is_integer else limits
        hint = f"for example {name} {_choose_example_number(param):g}"
        fraction = convert_percentage(float(words[0])) if high == 1 and len(words) == 1 else None
        if fraction is not None:
            hint = f"for {words[0]} %, write {name} {fraction:g}"
        return UsageError(problem, where=name, got=" ".join(words), expected=expected, hint=hint)
    if param.name != "band":
        problem, kind = "this value is not a number", "a whole number" if is_integer else "a number"
        expected, hint = kind, f"write {kind} in place of {wrong_word}"
        if low is not None or high is not None:
            expected = f"{kind}, {limits}"
            hint = f"for example {name} {_choose_example_number(param):g}"
        share = wrong_word.removesuffix("%").strip()
        if wrong_word.endswith("%") and _is_number(share) and not is_integer:
            hint = f"write {name} {float(share) / 100:.12g}"
        return UsageError(problem, where=name, got=wrong_word, expected=expected, hint=hint)
    hint = f"write {name} 1000 2000 for 1 to 2 kHz"
    if ends := _convert_to_hertz(words):
        hint = " ".join(["write", name, *ends])
    return UsageError(
        "this value is not a number",
        where=name,
        got=wrong_word,
        expected="numbers in Hz",
        hint=hint,
    )


def _find_option_limits(param: Any) -> tuple[float | None, float | None]:
    """Return the smallest and largest accepted values of an option.

    A value is None if there is no limit.
    """
    owner = param if hasattr(param, "min") else getattr(param, "type", None)
    return getattr(owner, "min", None), getattr(owner, "max", None)


def _choose_example_number(param: Any) -> float:
    """Return an accepted value of an option: its default value, or a number near 1."""
    low, high = _find_option_limits(param)
    if isinstance(param.default, (int, float)):
        return param.default
    number = max(low or 1, 1)
    return number if high is None else min(number, high)


def _is_number(word: str) -> bool:
    """Return whether a word is a number."""
    try:
        float(word)
    except ValueError:
        return False
    return True
