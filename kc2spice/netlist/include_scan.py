"""Security check of a user's netlist for cards that could execute programs.

The included files are merged into one text for the simulator. This module treats names,
continuation lines and comments in the same way as the simulator. In the merged text, lines end with
a line feed, and all blanks are spaces. Comments begin with ``*`` or ``;``, and continuation lines
with ``+``.

Only known commands, element letters, options and file names are allowed. The text of a circuit that
the user trusts is not changed.

The file of a part may define only subcircuits, because every other card affects the whole deck. For
example, a definition of the function ``max`` affects all cards that call ``max``. An option in the
file of a part would affect the accuracy of the whole run, and is therefore rejected. The node names
of an element outside of subcircuits denote the nodes of the deck that have these names.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from operator import attrgetter
from pathlib import Path, PurePosixPath

from kc2spice.core.errors import UsageError, did_you_mean, list_candidates
from kc2spice.core.files import suggest_file
from kc2spice.core.other_file_formats import (
    KICAD_SCHEMATIC,
    LTSPICE_SCHEMATIC,
    NETLIST_SUFFIXES,
    PACKED,
    PDF,
    WEB_PAGE,
    identify_binary_format,
    identify_text_format,
)
from kc2spice.core.untrusted_files import (
    explain_unsafe_name,
    make_encoding_error,
    make_plain_name,
    read_bounded,
)
from kc2spice.core.user_warnings import warn_user
from kc2spice.netlist.card_parser import (
    LAPLACE_HINT,
    OPTION_CARDS,
    Statement,
    parse_element,
    split_comment,
    split_statements,
)
from kc2spice.netlist.circuit import NODE_COUNTS
from kc2spice.netlist.expression import BUILT_IN_NAMES, FUNCTIONS
from kc2spice.netlist.number_and_name_spelling import format_comment

# largest number of bytes in a file, and of characters in the merged text
MAX_CIRCUIT_BYTES = 4_000_000
MAX_INCLUDED_FILES = 64  # largest number of files of one circuit
# The simulator treats every word that begins with ".inc" as an include, even after blanks.
_INCLUDE_LINE = re.compile(r"(?i)\s*\.inc\S*(.*)", re.DOTALL)
_INCLUDE_TARGET = re.compile(r"\"([^\"]*)\"|'([^']*)'|([^\s\"']+)")
_END_LINE = re.compile(r"(?i)\.end(?=\s|$)")
_CONTINUATION_MARK = "\\\\"  # a line with two backslashes at its end continues on the next line


@dataclass(frozen=True)
class Line:
    """Line of a file: normalised text, position ``file:line`` and original text."""

    text: str
    where: str
    raw: str


@dataclass(frozen=True)
class FlatCircuit:
    """Lines of a circuit, with the content of included files inserted."""

    file: str
    lines: tuple[Line, ...]

    @property
    def text(self) -> str:
        """Text of the circuit: all lines, joined by line feeds."""
        return "\n".join(map(attrgetter("text"), self.lines))

    def cards(self, *, title: bool = False) -> Iterator[Statement]:
        """Yield the cards of the circuit, each with its position ``file:line``.

        Each card is on one line, without continuation lines.
        """
        for card in split_statements(self.text, "", title=title):
            if card.written:
                yield replace(card, where=self.lines[card.line - 1].where)


def flatten_includes(path: Path, home: Path, *, trust: bool, inside: bool = False) -> FlatCircuit:
    """Return a circuit with the content of included files in place of include lines.

    Included files must be below the directory ``home``. With ``trust``, lines are unchanged, and
    included files may be in any directory. With ``trust``, an include line also remains if this
    function cannot resolve it. With ``inside``, only files below ``home`` are opened, as is
    necessary for a circuit that the user does not trust yet.

    Raises
    ------
    UsageError : a file is not text or too large, there are too many files, or an include is
        circular or leads out of ``home``.
    """
    lines = _Reader(path, home, trust, inside).read_lines(path.name, path, str(path), ())
    return FlatCircuit(make_plain_name(path.name), tuple(lines))


@dataclass
class _Reader:
    """Reader of a circuit and its included files, with limits on number and size."""

    main: Path
    home: Path
    trust: bool
    inside: bool
    files: int = 0
    size: int = 0

    def read_lines(
        self, name: str, path: Path, where: str, chain: tuple[Path, ...]
    ) -> Iterator[Line]:
        """Yield the lines of a file, with the content of included files inserted.

        ``name`` is the name of the file in messages. ``where`` is the position of the line that
        includes the file; for the main file, ``where`` is the path of the file.
        """
        real = path.resolve()
        if real in chain:
            got = " -> ".join(map(attrgetter("name"), (*chain, real)))
            raise UsageError(
                "this file includes itself, directly or through other files",
                where=where,
                got=got,
                hint="delete this line"
                if chain[-1] == real
                else f"delete one of the .include "
                f"lines of {' and '.join(dict.fromkeys(map(attrgetter('name'), chain)))}",
            )
        goes_on = False
        for number, raw in enumerate(self._read_text(name, real, where).split("\n"), 1):
            position, match = f"{name}:{number}", _INCLUDE_LINE.match(raw)
            if match is None:
                line = raw
                if not self.trust:
                    line, goes_on = _normalize_line(raw, goes_on)
                yield Line(line, position, raw)
                continue
            if goes_on and not self.trust:
                raise make_forbidden_line_error(
                    "has a line that continues in an included file", self.main, position, raw
                )
            target = self._parse_include(match[1], position, raw)
            file = path.parent / target
            try:
                readable = file.is_file() and file.stat().st_size <= MAX_CIRCUIT_BYTES
            except OSError:  # the name is too long, or the directory is unreadable
                readable = False
            if self.trust and (not target or not readable or self._is_outside(file)):
                yield Line(raw, position, raw)
                continue
            inner = target if self.trust else str(PurePosixPath(name).parent / target)
            begin, end = f"* begin of {format_comment(inner)}", f"* end of {format_comment(inner)}"
            yield Line(begin, position, begin)
            yield from self.read_lines(inner, file, position, (*chain, real))
            yield Line(end, position, end)

    def _is_outside(self, file: Path) -> bool:
        """Return whether a file must not be opened, because it is outside of the folder.

        ``home`` is the folder.
        """
        outside = not file.resolve().is_relative_to(self.home.resolve())
        return outside and (self.inside or not self.trust)

    def _parse_include(self, rest: str, where: str, raw: str) -> str:
        """Return the file name in an include line: one word, or one quoted text."""
        rest = split_comment(rest)[0].strip()
        result = _INCLUDE_TARGET.fullmatch(rest)
        target = next(filter(None, result.groups()), "") if result else ""
        if not self.trust:
            reason = (
                "more than one word" if rest and result is None else explain_unsafe_name(target)
            )
            if reason:
                error = make_forbidden_line_error(
                    f"includes a file whose name is not allowed: {reason}", self.main, where, raw
                )
                plain = make_plain_name(re.split(r"[\\/]", target)[-1])
                if plain and reason != "more than one word":
                    error.hint = f"copy the file into the folder of {self.main.name}, and write  "
                    error.hint += f".include {plain}"
                raise error
        return target

    def _read_text(self, name: str, real: Path, where: str) -> str:
        """Return the text of a file; reject a file beyond the circuit's size limits."""
        self.files += 1
        if self.files > MAX_INCLUDED_FILES:
            raise UsageError(
                "the netlist includes too many files",
                where=str(self.main),
                expected=f"at most {MAX_INCLUDED_FILES}",
                hint="copy the content of small files in place of their .include lines",
            )
        if self._is_outside(real):
            raise UsageError(
                "the included file is outside of the directory of the netlist",
                where=where,
                got=name,
                hint=f"copy the file into {self.home}, and write its new path",
            )
        try:
            data = read_bounded(real, MAX_CIRCUIT_BYTES - self.size)
            _require_netlist_format(data, name if where == str(self.main) else where)
            self.size += len(data)
            try:
                text = data.decode("utf-8-sig")
            except UnicodeDecodeError:  # many vendors encode micro signs in Latin-1
                text = data.decode("cp1252")
            return text.replace("\r\n", "\n").replace("\r", "\n")
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or str(error)
            missing = isinstance(error, FileNotFoundError)
            if where == str(self.main) and (missing or isinstance(error, IsADirectoryError)):
                raise UsageError(
                    "this file does not exist"
                    if missing
                    else "this path is a directory, not a netlist",
                    where=where,
                    expected="the path of a netlist",
                    hint="give the path of a netlist that kc2spice export or kc2spice run wrote",
                ) from None
            raise UsageError(
                "this file cannot be included",
                where=where,
                got=f"{name}: {reason}",
                expected=(
                    f"a text file, and at most {MAX_CIRCUIT_BYTES} bytes in the netlist and all "
                    "its included files together"
                ),
                hint=f"copy {name} to {real.parent}, or correct its name" if missing else None,
            ) from None


# Recommended actions for files in other formats, keyed by the name of the format.
_ACTIONS = {
    PDF: "give the path of the SPICE model (.lib or .cir) instead",
    PACKED: "unpack the archive, and give the path of the unpacked netlist",
    LTSPICE_SCHEMATIC: (
        "open the schematic in LTspice, choose View > SPICE Netlist, and save the text as a .cir "
        "file"
    ),
    KICAD_SCHEMATIC: (
        "open the schematic in KiCad, choose File > Export > Netlist > SPICE, and give the path of "
        "the exported file"
    ),
    WEB_PAGE: "download the netlist file instead of the web page that shows it",
}


# marks of encrypted models of PSpice and LTspice
_ENCRYPTION = re.compile(rb"(?im)^\s*(\$CDNENCSTART|\*+\s*LTspice Encrypted|\.prot(ect)?\b)")


def _require_netlist_format(data: bytes, where: str) -> None:
    """Reject files of other programs, binary files, and text in UTF-16.

    Raises
    ------
    UsageError : the file is not a netlist; the message names its format.
    """
    if _ENCRYPTION.search(data):
        raise UsageError(
            "this netlist is encrypted",
            where=where,
            expected="a text file with a SPICE netlist",
            hint="ask the manufacturer for a model without encryption",
        )
    suffix = PurePosixPath(where).suffix
    name = identify_binary_format(data, suffix) or identify_text_format(data)
    if name is not None and (name in _ACTIONS or b"\0" in data[:200]):
        raise UsageError(
            f"this file is {name}",
            where=where,
            expected="a text file with a SPICE netlist",
            hint=_ACTIONS.get(name, _ACTIONS[PDF]),
        )
    if b"\0" in data[:200]:
        raise make_encoding_error(data, where)


def _is_missing(path: Path) -> bool:
    """Return whether a path is valid and no file exists there."""
    try:
        return not path.is_file()
    except (OSError, ValueError):
        return False


def make_missing_netlist_error(path: Path) -> UsageError:
    """Return the error for a netlist that is missing or a directory."""
    if path.is_dir():
        inside = sorted(item.name for item in path.glob("*.*") if item.suffix in NETLIST_SUFFIXES)
        return UsageError(
            "this path is a directory, not a netlist",
            where=path.name,
            expected="a file of subcircuits in the folder of the scene",
            hint=f'write the path of a file in it, such as  "{(*inside, "NAME.lib")[0]}"',
        )
    return UsageError(
        "this netlist file does not exist",
        where=path.name,
        expected="a file of subcircuits in the folder of the scene",
        hint=suggest_file(path) or f"copy {path.name} into the folder {path.resolve().parent}",
    )


def make_forbidden_line_error(reason: str, path: Path, where: str, text: str) -> UsageError:
    """Return the error for a forbidden line of a circuit."""
    library = re.fullmatch(r"(?i)\s*\.lib\s+\"?([\w.+-]+)\"?\s*", text)
    read = "read the file; if you trust every line, repeat the command with --trust"
    hint = f"write  .include {library[1]}" if library else read
    return UsageError(
        f"the netlist {reason}",
        where=f"{path} ({where})" if where not in str(path) else str(path),
        got=text[:120],
        expected="subcircuits, models, parameters, elements and accuracy options only",
        hint=hint,
    )


def _normalize_line(raw: str, goes_on: bool) -> tuple[str, bool]:
    """Return the normalised line, and whether the next line continues it."""
    line = raw.replace("\t", " ").strip(" ")
    if not line or line.startswith("*"):
        return line, goes_on
    card, note = split_comment(line)
    follows = card.endswith(_CONTINUATION_MARK)
    if follows:
        card = card[: -len(_CONTINUATION_MARK)].rstrip()
    if _END_LINE.match(card):
        card, note = "", f"{card} {note}".rstrip()  # lines after .end have no effect
    if goes_on and card and not card.startswith("+"):
        card = f"+ {card}"
    if not card:
        return f"* {note}".rstrip(), follows or goes_on
    return f"{card} ; {note}" if note else card, follows


# --- cards that affect the whole deck ---

# fmt: off
# Functions that every card may call, not only the cards of sources.
_FUNCTION_NAMES = FUNCTIONS.union((
    "agauss", "arctan", "atan2", "aunif", "db", "ddt", "gauss", "hypot", "i", "if", "int", "limit",
    "pwrs", "sign", "sqr", "stp", "table", "ternary_fcn", "unif", "v",
))
_CONSTANT_NAMES = BUILT_IN_NAMES.union(("c", "echarge", "false", "kelvin", "planck", "true"))
# Options that affect only the printed output, but not the computation.
PRINT_OPTIONS = frozenset((
    "acct", "list", "noacct", "node", "nomod", "nopage", "numdgt", "opts", "post", "probe", "warn",
    "width",
))
ANALYSES = frozenset((".tran", ".ac", ".dc", ".op", ".tf", ".noise", ".pz", ".sens", ".disto",
                      ".sp", ".pss", ".hb", ".four"))
_OUTPUT_COMMANDS = frozenset((".save", ".print", ".plot", ".probe", ".meas", ".measure", ".width"))
# fmt: on
_FUNCTION_LINE = re.compile(r"(?i)\.(?:func|param|params|csparam)\s+(\w+)\s*\(")
_DECIMAL_COMMA = re.compile(r"[+-]?\d+,\d+[A-Za-z]*")
_ASSIGNED_COMMA = re.compile(r"=\s*([+-]?\d+,\d+[A-Za-z]*)(?=[\s)]|$)")
_PLAIN_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?", re.IGNORECASE)
_SCALE_FACTOR = re.compile(r"(t|g|meg|k|m|u|µ|n|p|f)?(ohm|ohms|f|farad|h|henry)?", re.IGNORECASE)
# number with the suffix M in upper case, which users of other programs read as mega
_UPPER_CASE_M = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+))M(?:[Oo]hms?|Hz)?")
# capacitance with the suffix F in upper case, which users read as farad
_UPPER_CASE_F = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+))F")
_SINE_FREQUENCY = re.compile(r"(?i)\bsine?\s*\(\s*\S+\s+\S+\s+([\w.]+)")
_ASSIGNMENT = re.compile(r"(\w+)\s*=\s*([\w.]+)")
_LAPLACE_LAW = re.compile(r"(?i)(?<![\w.])laplace\s*[={(]")
_PART_FILE_CONTENT = "a file of subcircuits with their models, parameters and functions"


def reject_side_effects(cards: Iterable[Statement], *, part: bool) -> None:
    """Reject faulty cards, and cards that affect the rest of a deck.

    Raises
    ------
    UsageError : a card defines a global node, or redefines a built-in function or constant. In a
        part file, these cards are also rejected: analyses, outputs, temperatures, options that
        affect results, and elements or initial conditions outside of subcircuits. In a deck, the
        option ``interp`` is also rejected, because it removes time points from the results. The
        error contains file and line of the card.
    """
    depth, commands = 0, False
    cards = list(cards)
    subcircuits = any(card.keyword == ".subckt" for card in cards)
    texts = [card for card in cards if not card.keyword.startswith(".end")]
    # A netlist without lower-case letters has no other spelling of milli and femto.
    if any(re.search("[a-z]", card.written) for card in texts):
        _warn_of_milli(texts)
        _warn_of_femto(texts)
    for card in cards:
        key = card.keyword
        if commands or key == ".control":  # only trusted netlists contain control blocks
            commands = key != ".endc"
            continue
        depth += (key == ".subckt") - (key == ".ends")
        for what, expected, hint in _list_card_problems(card, depth == 0, part, subcircuits):
            raise card.make_error(f"the netlist {what}", card.written[:120], expected, hint)


def _warn_of_milli(cards: Iterable[Statement]) -> None:
    """Warn about resistances and frequencies with the suffix M, which means milli."""
    for card in cards:
        for value in _list_mega_candidates(card):
            if number := _UPPER_CASE_M.fullmatch(value):
                warn_user(
                    f"{card.where}: ngspice reads {value} as {number[1]} milli, in the line "
                    f"{card.written[:120]}: write {number[1]}meg if you mean mega, or "
                    f"{number[1]}m if you mean milli"
                )


def _warn_of_femto(cards: Iterable[Statement]) -> None:
    """Warn about capacitances such as ``1F``, which ngspice reads as 1 femtofarad."""
    for card in cards:
        value = card.words[3] if card.keyword.startswith("c") and len(card.words) > 3 else ""
        if number := _UPPER_CASE_F.fullmatch(value):
            warn_user(
                f"{card.where}: ngspice reads {value} as {number[1]} femtofarad, in the line "
                f"{card.written[:120]}: write {number[1]} if you mean farad, or {number[1]}f if "
                "you mean femtofarad"
            )


def _list_mega_candidates(card: Statement) -> Iterator[str]:
    """Yield a card's probable resistances and frequencies, where M may mean mega.

    The value of a parameter is yielded if the parameter's name begins with R or F.
    """
    key, words = card.keyword, card.words
    if key.startswith("r"):
        yield from words[3:4]
    if key == ".ac":
        yield from words[3:]
    if sine := _SINE_FREQUENCY.search(card.written):
        yield sine[1]
    if key in (".param", ".params") or key[:1] in ("r", "x"):
        for name, value in _ASSIGNMENT.findall(card.written):
            if name[0] in "rRfF":
                yield value


def _list_card_problems(
    card: Statement, outside: bool, part: bool, subcircuits: bool
) -> Iterator[tuple[str, str, str]]:
    """Yield each problem of a card as a description, the expected text and a remedy.

    ``subcircuits`` is true if the file of the card contains subcircuits.
    """
    key, options = card.keyword, read_accuracy_options((card,))
    if parts := _find_separate_suffix(card):
        hint = f"write {parts[0]}{parts[1]} in place of {parts[0]} {parts[1]}"
        yield "has a blank between a number and its unit", "a number without blanks", hint
    if number := _find_decimal_comma(card):
        hint = f"write {number.replace(',', '.')} in place of {number}"
        yield f"has a comma in the number {number}", "a number with a decimal point", hint
    if key[:1] in ("e", "g", "b", "f", "h") and _LAPLACE_LAW.search(card.written):
        what = "has a Laplace transform, which ngspice cannot simulate"
        yield what, "elements of ngspice", LAPLACE_HINT
    if part and key in ANALYSES | _OUTPUT_COMMANDS:
        what = "contains an analysis" if key in ANALYSES else "contains an output command"
        yield (
            what,
            _PART_FILE_CONTENT,
            "delete this line: the scene defines analysis and results",
        )
    if part and options:
        what = "temperature" if key == ".temp" else f"option {next(iter(options))}"
        hint = (
            "delete this line; set the accuracy in the table [solver] of the scene, and the "
            "temperature of a device by temp=… on its card"
        )
        yield f"sets the {what} of the whole deck", _PART_FILE_CONTENT, hint
    if part and outside and (key in (".ic", ".nodeset") or (key and not key.startswith("."))):
        what = "has a card outside of all subcircuits, which acts on nodes of the whole deck"
        hint = "move this card into the .subckt, or delete it"
        if card.line == 1:  # decks begin with a title, but files of subcircuits do not
            what = "has text outside of all subcircuits in its first line"
            hint = "delete this line if it is a title; move a card into the .subckt"
        if not subcircuits:
            hint = (
                "put the circuit between  .subckt NAME NODE1 NODE2 ref  and  .ends, without title, "
                "analysis and .end lines; name its reference node `ref`, and write  "
                'subckt = "NAME"  in the scene'
            )
        yield what, _PART_FILE_CONTENT, hint
    if not part and "interp" in options:
        hint = "delete this option, because it removes time points that the results need"
        yield "sets the option interp", "results at every time point", hint
    if key.startswith(".global"):
        hint = "replace the global node by a pin of the subcircuit"
        yield "makes nodes global", "nodes of subcircuits", hint
    defined = _FUNCTION_LINE.match(card.written)
    words = card.words[1:] if key in (".param", ".params") else ()
    redefines = (defined and defined[1].lower() in _FUNCTION_NAMES) or _CONSTANT_NAMES.intersection(
        word.partition("=")[0].lower() for word in words
    )
    if outside and redefines:
        hint = "rename the definition, or move the definition into the .subckt"
        yield "redefines a built-in name for the whole deck", "a name that is not built in", hint


def _find_separate_suffix(card: Statement) -> tuple[str, str] | None:
    """Return a number and its suffix if a blank separates them, otherwise None.

    The simulator reads a separate suffix, such as a scale factor, as the name of a model.
    """
    words = card.words
    if card.keyword[:1] not in ("r", "c", "l") or len(words) < 5:
        return None
    number, suffix = words[3], words[4]
    separate = _PLAIN_NUMBER.fullmatch(number) and _SCALE_FACTOR.fullmatch(suffix)
    return (number, suffix) if separate else None


def _find_decimal_comma(card: Statement) -> str:
    """Find a number with a decimal comma on a card; if none, return an empty text.

    The simulator reads a number with a decimal comma as two numbers.
    """
    key = card.keyword
    if key in (".param", ".params", ".model") or key.startswith("x"):
        assigned = _ASSIGNED_COMMA.search(card.written)
        return assigned[1] if assigned else ""
    if key[:1] not in ("r", "c", "l", "v", "i"):
        return ""
    words = [word for word in card.words[3:] if word.lower() not in ("dc", "ac")]
    return words[0] if words and _DECIMAL_COMMA.fullmatch(words[0]) else ""


def read_accuracy_options(cards: Iterable[Statement]) -> Mapping[str, str]:
    """Return the values of accuracy options, keyed by option; ``""`` for a flag.

    If an option is repeated, the result contains its last value.
    """
    result: dict[str, str] = {}
    for card in cards:
        if card.keyword == ".temp":
            result["temp"] = " ".join(card.words[1:])
        for word in card.words[1:] if card.keyword in OPTION_CARDS else ():
            key, _, value = word.partition("=")
            if key.lower() not in PRINT_OPTIONS:
                result[key.lower()] = value
    return result


# --- lines that could execute programs or open files ---

# fmt: off
ALLOWED_COMMANDS = OPTION_CARDS.union(_OUTPUT_COMMANDS, (
    ".subckt", ".ends", ".model", ".param", ".params", ".func", ".global", ".ic", ".nodeset",
    ".temp", ".end", ".title", ".tran", ".ac", ".dc", ".op", ".tf", ".noise", ".four", ".if",
    ".elseif", ".else", ".endif",
))
ALLOWED_OPTIONS = frozenset((
    "abstol", "acct", "autostop", "badmos3", "bypass", "chgtol", "convabsstep", "convstep",
    "cshunt", "defad", "defas", "defl", "defnrd", "defnrs", "defw", "ebdw", "gmin", "gminsteps",
    "interp", "itl1", "itl2", "itl3", "itl4", "itl5", "itl6", "keepopinfo", "list", "maxevtiter",
    "maxopalter", "maxord", "method", "minbreak", "mu", "noacct", "noinit", "node", "nomod",
    "nopage", "noopac", "noopalter", "noopiter", "numdgt", "opts", "oldlimit", "pivrel", "pivtol",
    "post", "probe", "ramptime", "reltol", "rseries", "rshunt", "savecurrents", "scale", "seed",
    "sparse", "srcsteps", "temp", "tnom", "trtol", "trytocompact", "vntol", "warn", "xmu",
))
# Commands of ngspice that run programs or open files.
_TRUSTED_COMMANDS = frozenset((".control", ".endc", ".exec", ".lib", ".include", ".inc",
                               ".codemodel", ".spiceinit", ".endl"))
# Commands that only LTspice has, with the recommended action for each command.
_LTSPICE_COMMANDS = {
    ".backanno": "delete this line, which affects only the display of LTspice",
    ".wave": "delete this line, and set a probe in the scene",
    ".step": "delete this line, and vary the value by kc2spice sweep",
    ".machine": "delete this line, and write B sources in place of the state machine",
    ".savebias": "delete this line",
    ".loadbias": "delete this line",
    ".ferret": "delete this line",
    ".net": "delete this line",
}
_ALLOWED_ELEMENTS = frozenset("bcdefghijklmqrstuvwxz")
# Commands of ngspice that are also possible names of elements, such as Cd and Load. ngspice 39 runs
# these commands only between .control and .endc, after *#, and in files that begin with *ng_script.
# Among the cards of a netlist, ngspice 39 reads the line ``cd a 0 1n`` as a capacitor.
# tests/spice/hostile contains lines that begin with these commands.
_SHELL_WORDS = frozenset((
    "shell", "system", "codemodel", "source", "load", "exec", "alias", "osdi", "write", "wrdata",
    "hardcopy", "cd", "set", "unset", "pre_codemodel", "pre_osdi", "quit", "exit",
))
# fmt: on
_FILE_WORDS = re.compile(
    r"(?i)\b(\w*file|simulation|lib|library|process)\s*=|\b\w*file\s*\(|"
    r"\b(table|spline|fasttable)\s*\(\s*[\"']"
)
_HIDDEN_CHARACTERS = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e]")
_UNUSUAL_BLANK = re.compile(r"[^\S \t]")
_DISGUISED_COMMAND = re.compile(r"(?i)^[\s+;$/#&]*\.(control|endc|exec|inc|lib|codemodel)")
_COMMAND_COMMENT = re.compile(r"(?i)^\s*\*(#|ng_script)")
_PROGRAM_WORDS = re.compile(r"(?i)\b(d_process|d_cosim|filesource|d_source|d_state|table[23]d)\b")


def read_checked_circuit(
    path: Path, *, trust: bool = False, home: Path | None = None
) -> FlatCircuit:
    """Return a circuit with its included files, after the security check.

    Parameters
    ----------
    trust : whether the user trusts the circuit; the check is then omitted.
    home : directory of the circuit and of its included files, by default the directory of ``path``.

    Raises
    ------
    UsageError : the file is not text or too large, or a line could run a program, access a file, or
        include a file outside of ``home``.
    """
    result = flatten_includes(path, home or path.parent, trust=trust)
    if trust:
        return result
    # The original lines are checked, because hidden characters can change cards.
    for line in result.lines:
        text = line.raw.rstrip("\r")
        for reason in _find_line_faults(text):
            quotation = repr(text) if _HIDDEN_CHARACTERS.search(text) else text
            raise make_forbidden_line_error(reason, path, line.where, quotation)
    for card in result.cards():
        _require_known_command(card)
        _require_complete_element(card, path)
        _require_known_options(card)
        for reason in _find_card_faults(card):
            raise make_forbidden_line_error(reason, path, card.where, card.written)
    return result


def read_included_netlist(name: str, home: Path, *, trust: bool = False) -> FlatCircuit:
    """Read a netlist file in a directory, with the files that it includes.

    Raises
    ------
    UsageError : the file does not exist, affects the deck outside of its subcircuits, or could
        execute programs or open files (unless ``trust``).
    """
    reason = None if trust else explain_unsafe_name(name)
    if reason:
        raise UsageError(
            f"the name of an included file is not allowed: {reason}",
            where="include",
            got=repr(name[:120]),
            expected="a file in the scene's folder, with letters, digits, blanks and _ . + - in "
            "its name",
            hint="copy the netlist to the scene's folder, or repeat the command with --trust",
        )
    if _is_missing(home / name):
        raise make_missing_netlist_error(home / name)
    result = read_checked_circuit(home / name, trust=trust, home=home)
    reject_side_effects(result.cards(), part=True)
    return result


def read_untrusted_netlist(name: str, home: Path) -> FlatCircuit:
    """Read an untrusted netlist file, with included files below one directory only.

    The directory is ``home``, or the directory of the file if ``home`` is empty. All lines remain
    unchanged. The function is for reading pins and nodes of a circuit that the user does not trust
    yet.

    Raises
    ------
    UsageError : the errors of :func:`read_included_netlist`. Lines that could execute programs are
        read without an error, because the function does not run the netlist.
    """
    path = home / name
    if _is_missing(path):
        raise make_missing_netlist_error(path)
    result = flatten_includes(
        path, path.parent if home == Path() else home, trust=True, inside=True
    )
    reject_side_effects(result.cards(), part=True)
    return result


def _find_line_faults(text: str) -> Iterator[str]:
    """Yield the security faults of one line of a netlist, such as hidden characters."""
    if _HIDDEN_CHARACTERS.search(text) or "\r" in text:
        yield "has control characters that can hide text"
    if _COMMAND_COMMENT.match(text):
        yield "has a comment that the simulator runs as a command"
    if text.lstrip(" \t").startswith("*"):
        return
    if match := _DISGUISED_COMMAND.match(text):
        yield f"has a {match[1].lower()} command"
    if _UNUSUAL_BLANK.search(split_comment(text)[0]):
        yield "contains non-ASCII spaces, which the simulator does not treat as spaces"
    if "`" in text:
        yield "contains a back quote, which can run a program"


def _require_known_command(card: Statement) -> None:
    """Reject commands that are misspelt or that only LTspice has.

    The function raises no error for an unknown command that is neither misspelt nor from LTspice.
    Afterwards, :func:`_find_card_faults` reports every unknown command, because unknown commands
    could run programs.

    Raises
    ------
    UsageError : the command is misspelt, or only LTspice has the command.
    """
    key = card.keyword
    if not key.startswith(".") or key in ALLOWED_COMMANDS | ANALYSES | _TRUSTED_COMMANDS:
        return
    hint = _LTSPICE_COMMANDS.get(key)
    if hint is None and (suggestion := did_you_mean(key, sorted(ALLOWED_COMMANDS))):
        hint = suggestion
    if hint is not None:
        expected = f"one of {list_candidates(key, sorted(ALLOWED_COMMANDS))}"
        raise card.make_error(f"ngspice has no command {key}", card.written[:120], expected, hint)


def _require_complete_element(card: Statement, path: Path) -> None:
    """Require a complete element if its name is a command of ngspice, such as ``cd``.

    Raises
    ------
    UsageError : the line begins with a command, such as ``cd``, and has too few nodes or no value.
    """
    if card.keyword not in _SHELL_WORDS or card.keyword[0] not in NODE_COUNTS:
        return
    try:
        parse_element(card)
    except UsageError as error:
        fault = make_forbidden_line_error(
            f"has the command {card.keyword}", path, card.where, card.written
        )
        complete = f"; if it is an element, {error.hint}" if error.hint else ""
        fault.hint = f"delete this line{complete}"
        raise fault from None


def _require_known_options(card: Statement) -> None:
    """Reject misspelt options, such as ``reltl`` for ``reltol``.

    Raises
    ------
    UsageError : the card sets an option whose name is similar to that of an accuracy option.
    """
    for word in card.words[1:] if card.keyword in OPTION_CARDS else ():
        name = word.partition("=")[0].lower()
        if name in ALLOWED_OPTIONS:
            continue
        if suggestion := did_you_mean(name, sorted(ALLOWED_OPTIONS)):
            raise card.make_error(
                f"the option {name} does not exist",
                card.written[:120],
                f"one of {list_candidates(name, sorted(ALLOWED_OPTIONS))}",
                suggestion,
            )


def _find_card_faults(card: Statement) -> Iterator[str]:
    """Yield the security faults of a card, including its continuation lines."""
    key = card.keyword
    if key.startswith("."):
        if key not in ALLOWED_COMMANDS:
            yield f"has the command {key}"
    elif key in _SHELL_WORDS and key[0] not in NODE_COUNTS:
        yield f"has the command {key}"
    elif key[0] not in _ALLOWED_ELEMENTS:
        yield "contains a card that is not a permitted element"
    if key in OPTION_CARDS:
        for word in card.words[1:]:
            name = word.partition("=")[0].lower()
            if name not in ALLOWED_OPTIONS:
                yield f"sets the option {name[:40]}, which is not an accuracy option"
    if _FILE_WORDS.search(card.written):
        yield "reads or writes a file"
    if _PROGRAM_WORDS.search(card.written):
        yield "uses a code model that can run programs"
