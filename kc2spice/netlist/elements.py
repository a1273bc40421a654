"""Statements to a circuit: elements with nodes and values, scopes with what they define."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import takewhile

from kc2spice.core.errors import UsageError
from kc2spice.netlist.statements import Statement, beside, statements

# Nodes of each element letter; X counts by its subcircuit, E and G have two if behavioural.
NODES = {
    "r": 2, "c": 2, "l": 2, "v": 2, "i": 2, "b": 2, "e": 4, "g": 4, "f": 2, "h": 2,
    "d": 2, "q": 3, "j": 3, "m": 4, "z": 3, "s": 4, "w": 2, "t": 4, "k": 0,
}  # fmt: skip
_MODELLED = frozenset("dqjmzsw")  # the word behind nodes and controls names a .model
_BEHAVIOURAL = re.compile(r"(?i)(value|vol|cur|table|poly|laplace)\b")
_ASSIGNMENT = re.compile(r"([A-Za-z_]\w*)=(.*)", re.DOTALL)


@dataclass(frozen=True)
class Element:
    """One part: ``nodes`` it connects, ``sources`` that control it, its ``model`` or subcircuit.

    ``values`` are the words behind, ``params`` the assignments among them, names in lower case.
    """

    statement: Statement
    kind: str
    name: str
    nodes: tuple[str, ...]
    sources: tuple[str, ...] = ()
    model: str | None = None
    values: tuple[str, ...] = ()
    params: dict[str, str] = field(default_factory=dict)


@dataclass
class Scope:
    """A subcircuit or the top level (``name == ""``): what it defines, in lower case.

    ``defaults`` are the parameters that an instance may set, ``params`` those and its own.
    """

    name: str
    statement: Statement | None
    parent: Scope | None = None
    pins: tuple[str, ...] = ()
    defaults: dict[str, str] = field(default_factory=dict)
    params: dict[str, str] = field(default_factory=dict)
    elements: list[Element] = field(default_factory=list)
    models: dict[str, Statement] = field(default_factory=dict)
    subcircuits: dict[str, Scope] = field(default_factory=dict)
    commands: list[Statement] = field(default_factory=list)

    def find(self, name: str) -> Scope | None:
        """The subcircuit ``name`` as this scope sees it."""
        own = self.subcircuits.get(name.lower())
        return own if own or self.parent is None else self.parent.find(name)

    def knows_model(self, name: str) -> bool:
        """Is ``.model name`` visible here?"""
        return name.lower() in self.models or bool(self.parent and self.parent.knows_model(name))

    def knows_param(self, name: str) -> bool:
        """Is the parameter ``name`` visible here?"""
        return name.lower() in self.params or bool(self.parent and self.parent.knows_param(name))


def circuit(main: str, files: Mapping[str, str]) -> Scope:
    """The whole circuit of a deck, its includes followed.

    Raises
    ------
    UsageError : a missing or circular include, a broken card, a name defined twice; the message
        names file and line.
    """
    top = Scope("", None)
    _read(main, files, top, (), title=True)
    return top


def _read(
    file: str,
    files: Mapping[str, str],
    scope: Scope,
    chain: tuple[str, ...],
    *,
    title: bool = False,
) -> None:
    top = scope
    skipping = False
    for s in statements(files[file], file, title=title):
        key = s.keyword
        if key in (".control", ".endc"):
            skipping = key == ".control"
        elif skipping or not key:
            continue
        elif key == ".end":
            break
        elif key in (".include", ".inc"):
            _read(_included(s, files, (*chain, file)), files, scope, (*chain, file))
        elif key == ".subckt":
            scope = _opened(s, scope)
        elif key == ".ends":
            if scope is top or scope.parent is None:
                raise UsageError(".ends without .subckt", where=s.where, got=s.text)
            scope = scope.parent
        else:
            _take(s, scope)
    if scope is not top:
        raise UsageError(
            "subcircuit is not closed",
            where=scope.statement.where if scope.statement else file,
            got=f".subckt {scope.name}",
            expected=f".ends {scope.name}",
        )


def _included(s: Statement, files: Mapping[str, str], chain: tuple[str, ...]) -> str:
    written = s.text.partition(" ")[2].strip().strip("\"'")
    target = beside(s.file, written)
    if target not in files:
        raise UsageError(
            "included file is not there",
            where=s.where,
            got=written or "no file name",
            expected="one of " + ", ".join(sorted(set(files) - set(chain))),
        )
    if target in chain:
        raise UsageError("include goes in a circle", where=s.where, got=" -> ".join(chain))
    return target


def _opened(s: Statement, parent: Scope) -> Scope:
    rest = [w for w in s.words[1:] if w.lower() != "params:"]
    if not rest:
        raise UsageError("subcircuit has no name", where=s.where, got=s.text)
    name, rest = rest[0], rest[1:]
    pins = tuple(w.lower() for w in rest if "=" not in w)
    if len(set(pins)) < len(pins):
        raise UsageError("a pin name stands twice", where=s.where, got=" ".join(pins))
    if name.lower() in parent.subcircuits:
        first = parent.subcircuits[name.lower()].statement
        raise UsageError(
            "two subcircuits have one name",
            where=s.where,
            got=name,
            expected=f"one definition; the first is in {first.where if first else '?'}",
        )
    defaults = _assignments([w for w in rest if "=" in w], s)
    scope = Scope(name, s, parent, pins, defaults, dict(defaults))
    parent.subcircuits[name.lower()] = scope
    return scope


def _take(s: Statement, scope: Scope) -> None:
    """Sort one card into its scope."""
    if s.keyword in (".param", ".csparam"):
        scope.params |= _assignments(s.words[1:], s)
        scope.commands.append(s)
    elif s.keyword == ".model":
        if len(s.words) < 3:
            raise UsageError("model card is not complete", where=s.where, got=s.text)
        first = scope.models.get(s.words[1].lower(), s)
        if first.file != s.file and first.text.lower() != s.text.lower():
            raise UsageError(
                "two models have one name", where=s.where, got=s.words[1],
                expected=f"one definition; the first is in {first.where}",
                hint="rename one, or put it into its .subckt",
            )  # fmt: skip
        scope.models[s.words[1].lower()] = s
    elif s.keyword.startswith("."):
        scope.commands.append(s)
    else:
        scope.elements.append(element(s))


def _assignments(words: list[str], s: Statement) -> dict[str, str]:
    pairs = {}
    for word in words:
        match = _ASSIGNMENT.fullmatch(word.strip(","))
        if match is None:
            raise UsageError("not a parameter", where=s.where, got=word, expected="name=value")
        pairs[match[1].lower()] = match[2]
    return pairs


def element(s: Statement) -> Element:
    """Split one element card.

    Raises
    ------
    UsageError : an unknown element letter or too few words.
    """
    words = s.words
    kind, name = words[0][0].lower(), words[0].lower()
    rest = [w for w in words[1:] if w.lower() != "params:"]
    if kind == "x":
        plain = [w for w in rest if "=" not in w]
        if not plain:
            raise UsageError("instance names no subcircuit", where=s.where, got=s.text)
        params = _assignments([w for w in rest if "=" in w], s)
        return Element(
            s, kind, name, tuple(w.lower() for w in plain[:-1]), (), plain[-1], (), params
        )
    if kind not in NODES:
        raise UsageError(
            "unknown kind of element",
            where=s.where,
            got=words[0],
            expected=f"a name that begins with one of {''.join(sorted(NODES)).upper()}X",
        )
    count = NODES[kind]
    if kind in "eg" and len(rest) > 2 and _BEHAVIOURAL.match(rest[2]):
        count = 2
    if kind == "q" and len(rest) > 4 and "=" not in rest[4] and not _number(rest[4]):
        count = 4
    if kind == "m" and len([*takewhile(lambda w: "=" not in w, rest)]) == 4:
        count = 3  # a VDMOS has no bulk
    controls = {"f": 1, "h": 1, "w": 1, "k": 2}.get(kind, 0)
    needed = count + controls + (kind in _MODELLED or kind not in "vi")
    if len(rest) < needed or any("=" in w or "(" in w for w in rest[:count]):
        raise UsageError(
            "element is not complete",
            where=s.where,
            got=s.text[:120],
            expected=f"{count} nodes" + (", then a value or model" if kind not in "vi" else ""),
        )
    nodes, rest = rest[:count], rest[count:]
    sources, rest = rest[:controls], rest[controls:]
    model = rest.pop(0) if kind in _MODELLED else None
    return Element(
        s,
        kind,
        name,
        tuple(n.lower() for n in nodes),
        tuple(v.lower() for v in sources),
        model,
        tuple(w for w in rest if not _ASSIGNMENT.fullmatch(w) or kind == "b"),
        {m[1].lower(): m[2] for w in rest if (m := _ASSIGNMENT.fullmatch(w))},
    )


_CURRENT = re.compile(r"i\(([^()]+)\)|@([^\[\]]+)\[\w+\]")


def has_vector(top: Scope, vector: str) -> bool:
    """Whether the circuit has the node or device that a saved ``vector`` is read from.

    ``v(node)``, ``v(a,b)``, a bare node, ``i(source)`` or ``@device[parameter]``; inside instances
    as ngspice has it, ``v(xa.xb.node)`` and ``@r.xa.rout[i]``.
    """
    low = vector.lower().strip("\"'")
    if match := _CURRENT.fullmatch(low):
        *path, name = (match[1] or match[2]).split(".")
        scope = _inside(top, path[1:] if path and len(path[0]) == 1 else path)
        return scope is not None and any(e.name == name for e in scope.elements)
    if "(" in low.removeprefix("v("):
        return False
    inner = low[2:-1] if low.startswith("v(") else low
    return all(_has_node(top, node.strip()) for node in inner.split(","))


def _has_node(top: Scope, name: str) -> bool:
    *path, node = name.split(".")
    scope = _inside(top, path)
    if scope is None:
        return False
    return node == "0" or node in scope.pins or any(node in e.nodes for e in scope.elements)


def _inside(top: Scope, path: list[str]) -> Scope | None:
    """The scope of the instance ``xa.xb`` …; None where there is none."""
    scope = top
    for name in path:
        called = next((e.model for e in scope.elements if e.name == name), None)
        found = scope.find(called) if called else None
        if found is None:
            return None
        scope = found
    return scope


def behaviour(part: Element) -> tuple[str, str]:
    """``("I" or "V", expression)`` of a B source; the expression runs to the end of the card.

    Raises
    ------
    UsageError : neither.
    """
    match = re.fullmatch(r"\S+\s+\S+\s+\S+\s+([VvIi])\s*=\s*(.+)", part.statement.text, re.DOTALL)
    if match is None:
        raise UsageError(
            "behavioural source without a law",
            where=part.statement.where,
            got=part.statement.text[:80],
            expected="I=expression or V=expression",
        )
    return match[1].upper(), match[2].strip()


def _number(text: str) -> bool:
    return re.match(r"[-+.]?\d", text) is not None
