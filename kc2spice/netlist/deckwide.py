"""Cards that act on a whole deck: what the netlist of a part may not say to all the others.

A subcircuit has its own parameters, models, functions and nodes. What stands outside of every one
is everybody's: a function ``max`` there replaces that of all other cards, an option changes the
accuracy of the run, an element sits on whatever node of the deck has the name of its own.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

from kc2spice.core.errors import UsageError
from kc2spice.netlist.statements import Statement

# fmt: off
FUNCTIONS = frozenset((
    "abs", "acos", "acosh", "agauss", "arctan", "asin", "asinh", "atan", "atan2", "atanh", "aunif",
    "buf", "ceil", "cos", "cosh", "db", "ddt", "exp", "floor", "gauss", "hypot", "i", "if", "int",
    "inv", "limit", "ln", "log", "log10", "max", "min", "nint", "pow", "pwl", "pwr", "pwrs", "sgn",
    "sign", "sin", "sinh", "sqr", "sqrt", "stp", "table", "tan", "tanh", "ternary_fcn", "u", "u2",
    "unif", "uramp", "v",
))
CONSTANTS = frozenset(("boltz", "c", "e", "echarge", "false", "gmin", "hertz", "kelvin", "pi",
                       "planck", "temp", "temper", "time", "true", "vt"))
# Options that change what is printed and nothing that is computed.
HARMLESS = frozenset(("acct", "list", "noacct", "node", "nomod", "nopage", "numdgt", "opts", "post",
                      "probe", "warn", "width"))
ANALYSES = frozenset((".tran", ".ac", ".dc", ".op", ".tf", ".noise", ".pz", ".sens", ".disto",
                      ".sp", ".pss", ".hb", ".four"))
_OUTPUTS = frozenset((".save", ".print", ".plot", ".probe", ".meas", ".measure", ".width"))
# fmt: on
_OPTIONS = frozenset((".options", ".option", ".opt"))
_FUNCTION = re.compile(r"(?i)\.(?:func|param|params|csparam)\s+(\w+)\s*\(")
_PARTS = "a file of subcircuits with their models, parameters and functions"


def refuse_in_part(cards: Iterable[tuple[Statement, str]]) -> None:
    """Nothing, if a part's netlist keeps to itself; ``cards`` come with ``file:line`` of each.

    Raises
    ------
    UsageError : an analysis, an output, a global node, a temperature, an option that is more than
        one of printing, a built-in function or constant that is defined again, or an element or
        initial condition outside of every subcircuit; it names file and line.
    """
    depth, commands = 0, False
    for card, where in cards:
        key = card.keyword
        if commands or key == ".control":  # only a trusted netlist has any
            commands = key != ".endc"
            continue
        depth += (key == ".subckt") - (key == ".ends")
        if key in ANALYSES | _OUTPUTS:
            what = "asks for an analysis" if key in ANALYSES else "asks for an output"
            raise _refused(
                f"{what} of its own",
                where,
                card,
                _PARTS,
                "drop this line: the scene has analysis and results",
            )
        _deck_wide(card, where)
        if key == ".temp" or (given := _inexact(card)):
            what = "temperature" if key == ".temp" else f"option {given[0]}"
            raise _refused(
                f"sets the {what} of the whole deck",
                where,
                card,
                _PARTS,
                "drop this line; accuracy is set by the scene's [solver], the temperature of a "
                "device by temp=… on its own card",
            )
        if depth == 0 and (key in (".ic", ".nodeset") or (key and not key.startswith("."))):
            raise _refused(
                "has a card outside of every subcircuit, which acts on nodes of the whole deck",
                where,
                card,
                _PARTS,
                "put it into the .subckt or drop it",
            )
        if depth == 0:
            _built_in(card, where)


def refuse_in_deck(cards: Iterable[tuple[Statement, str]]) -> None:
    """Nothing, if an edited deck of ours leaves its parts what they are.

    Raises
    ------
    UsageError : a global node, a built-in function or constant that is defined again, or results
        at interpolated times; it names file and line.
    """
    depth = 0
    for card, where in cards:
        depth += (card.keyword == ".subckt") - (card.keyword == ".ends")
        _deck_wide(card, where)
        if "interp" in _inexact(card):
            raise _refused(
                "sets the option interp",
                where,
                card,
                "results at every time point",
                "drop it: events lie between the points that it keeps",
            )
        if depth == 0:
            _built_in(card, where)


def accuracy(cards: Iterable[Statement]) -> Mapping[str, str]:
    """Values of the options that change what is computed; ``""`` of a flag, the last one counts."""
    found: dict[str, str] = {}
    for card in cards:
        for word in _inexact(card, whole=True):
            name, _, value = word.partition("=")
            found[name.lower()] = value.strip()
        if card.keyword == ".temp":
            found["temp"] = " ".join(card.words[1:])
    return found


def _deck_wide(card: Statement, where: str) -> None:
    if card.keyword.startswith(".global"):
        raise _refused(
            "makes nodes global",
            where,
            card,
            "nodes of subcircuits",
            "make it a pin: it would be one with any node of its name",
        )


def _built_in(card: Statement, where: str) -> None:
    """Refuse what replaces a name that other cards use."""
    match = _FUNCTION.match(card.text)
    again = match is not None and match[1].lower() in FUNCTIONS
    if card.keyword in (".param", ".params"):
        names = (word.partition("=")[0].lower() for word in card.words[1:])
        again = again or any(name in CONSTANTS for name in names)
    if again:
        raise _refused(
            "defines a built-in name for the whole deck",
            where,
            card,
            "a name of its own",
            "rename it, or put it into the .subckt that uses it",
        )


def _inexact(card: Statement, *, whole: bool = False) -> list[str]:
    """Names (or words) of the options of a card that change what is computed."""
    if card.keyword not in _OPTIONS:
        return []
    named = [(word.partition("=")[0].lower(), word) for word in card.words[1:]]
    return [word if whole else name for name, word in named if name not in HARMLESS]


def _refused(what: str, where: str, card: Statement, expected: str, hint: str) -> UsageError:
    message = f"the netlist {what}"
    return UsageError(message, where=where, got=card.text[:120], expected=expected, hint=hint)
