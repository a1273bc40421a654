"""Third-party circuits are programs: reads them before a simulator does, refuses what could act.

Nothing is let through because it was not recognised: commands, element letters and paths are
allowed by name. A circuit that needs more can be trusted by its user, word for word.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from kc2spice.core.errors import UsageError
from kc2spice.spice.statements import Statement, beside, statements

LARGEST = 4_000_000  # bytes of one file
MOST = 64  # files of one circuit
# fmt: off
COMMANDS = frozenset((
    ".subckt", ".ends", ".model", ".param", ".params", ".func", ".global", ".ic", ".nodeset",
    ".temp", ".options", ".option", ".opt", ".end", ".title", ".tran", ".ac", ".dc", ".op", ".tf",
    ".noise", ".four", ".meas", ".measure", ".save", ".print", ".plot", ".probe", ".width", ".if",
    ".elseif", ".else", ".endif",
))
_ELEMENTS = frozenset("bcdefghijklmqrstuvwxz")
_SHELL_WORDS = frozenset((
    "shell", "system", "codemodel", "source", "load", "exec", "alias", "osdi", "write", "wrdata",
    "hardcopy", "cd", "set", "unset", "pre_codemodel", "pre_osdi", "quit", "exit",
))
# fmt: on
_FILES = re.compile(
    r"(?i)\b(\w*file|simulation|lib|library|process)\s*=|\b\w*file\s*\(|"
    r"\b(table|spline|fasttable)\s*\(\s*[\"']"
)  # fmt: skip
_HIDDEN = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e]")
_DISGUISED = re.compile(r"(?i)^[\s+;$/#&]*\.(control|endc|exec|inc|lib|codemodel)")
_COMMAND_COMMENT = re.compile(r"(?i)^\s*\*(#|ng_script)")
_PROGRAMS = re.compile(r"(?i)\b(d_process|d_cosim|filesource|d_source|d_state|table[23]d)\b")


@dataclass(frozen=True)
class Threat:
    """A line that could act on the machine, and why."""

    where: str
    reason: str
    text: str


def third_party(path: Path, *, trust: bool = False) -> dict[str, str]:
    """A circuit and what it includes, as ``{relative file name: text}``, the circuit first.

    Parameters
    ----------
    trust : take the circuit as it is; its user answers for it.

    Raises
    ------
    UsageError : not readable as text, too large, or a line that could run a program, read or
        write a file, or reach outside the circuit's own directory.
    """
    home = path.parent.resolve()
    files: dict[str, str] = {}
    waiting = [(path.name, str(path))]
    while waiting:
        name, where = waiting.pop(0)
        if name in files:
            continue
        if len(files) >= MOST:
            raise UsageError("includes too many files", where=str(path), expected=f"at most {MOST}")
        text = files[name] = _read(home, name, where, trust)
        if not trust:
            refuse(scan(text, name), str(path))
        for card in statements(text, name):
            target = _target(card)
            # what a trusted circuit takes from elsewhere stays there
            if card.keyword.startswith(".inc") and _path_threat(target) is None:
                waiting.append((beside(name, target), card.where))
    return files


def refuse(threats: list[Threat], path: str) -> None:
    """Raise the first threat, if there is one.

    Raises
    ------
    UsageError : there is.
    """
    if threats:
        first = threats[0]
        raise UsageError(
            f"the included circuit {first.reason}",
            where=f"{path} ({first.where})" if first.where not in path else path,
            got=first.text[:120],
            expected="subcircuits, models, parameters and elements only",
            hint="read the file; if you trust every line of it, repeat with --trust",
        )


def scan(text: str, file: str) -> list[Threat]:
    """Every line of a netlist that does more than describe a circuit."""
    return [*_raw_threats(text, file), *_card_threats(text, file)]


def _raw_threats(text: str, file: str) -> Iterator[Threat]:
    """What is wrong with a line as it stands, whatever it continues or comments on."""
    for number, line in enumerate(text.split("\n"), 1):
        line = line.rstrip("\r")
        where = f"{file}:{number}"
        if _HIDDEN.search(line) or "\r" in line:
            yield Threat(where, "has control characters that can hide text", repr(line)[:120])
        if _COMMAND_COMMENT.match(line):
            yield Threat(where, "has a comment that the simulator runs as a command", line)
        comment = line.lstrip().startswith("*")
        match = None if comment else _DISGUISED.match(line)
        if match and (match[1].lower() != "inc" or not line.lstrip().startswith(".")):
            yield Threat(where, f"has a {match[1].lower()} command", line)
        if "`" in line and not comment:
            yield Threat(where, "has a back quote, which runs a program", line)


def _card_threats(text: str, file: str) -> Iterator[Threat]:
    """What is wrong with a card once its continuation lines are joined."""
    for card in statements(text, file):
        key = card.keyword
        if key.startswith(".inc"):
            if reason := _path_threat(_target(card)):
                yield Threat(card.where, reason, card.text)
        elif key.startswith("."):
            if key not in COMMANDS:
                yield Threat(card.where, f"has the command {key}", card.text)
        elif key in _SHELL_WORDS:
            yield Threat(card.where, f"has the command {key}", card.text)
        elif key and key[0] not in _ELEMENTS:
            yield Threat(card.where, "has a card that is no element", card.text)
        if _FILES.search(card.text):
            yield Threat(card.where, "reads or writes a file", card.text)
        if _PROGRAMS.search(card.text):
            yield Threat(card.where, "uses a code model that can run programs", card.text)


def _target(card: Statement) -> str:
    """The file that an include card names."""
    return card.text.partition(" ")[2].strip().strip("\"'")


def _path_threat(target: str) -> str | None:
    """Why a path may not be included, if so."""
    if not target:
        return "includes nothing"
    if re.match(r"([A-Za-z]:|[/\\~]|\w+://)", target):
        return "includes an absolute path"
    if ".." in re.split(r"[/\\]", target):
        return "includes a parent directory"
    if re.search(r"[$%*?<>|`\\\"'\s]", target):
        return "includes a path with characters that are expanded"
    return None


def _read(home: Path, name: str, where: str, trust: bool) -> str:
    path = home / name
    real = path.resolve()
    if not trust and not real.is_relative_to(home):
        raise UsageError("the include leads out of the circuit's directory", where=where, got=name)
    try:
        if not real.is_file() or real.stat().st_size > LARGEST:
            raise UsageError(
                "cannot include this",
                where=where,
                got=name,
                expected=f"a text file of at most {LARGEST} bytes",
            )
        return _decoded(real.read_bytes()).replace("\r\n", "\n").replace("\r", "\n")
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError("cannot read the included circuit", where=where, got=str(error)) from None


def _decoded(data: bytes) -> str:
    """UTF-8, else the Windows code page in which many vendors write their micro signs."""
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        return data.decode("cp1252")
