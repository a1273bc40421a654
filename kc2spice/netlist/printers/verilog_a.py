"""Parts as Verilog-A modules, translated element by element from their one netlist.

Every card becomes one contribution on the same nodes, so module and ``.subckt`` are the same
system of equations (Verilog-AMS Language Reference Manual 2.4, chapters 4 and 5). Nested instances
are written out flat: compilers for simulators take no hierarchy.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from kc2spice.core.errors import UsageError
from kc2spice.netlist.cards import number
from kc2spice.netlist.circuit import (
    Circuit,
    Directive,
    Element,
    Function,
    Parameters,
    Subcircuit,
)
from kc2spice.netlist.expression import Name, parse, walk
from kc2spice.netlist.printers.contributions import Module, Names, law
from kc2spice.netlist.scope import Scope, circuit


def library(
    parts: Iterable[Subcircuit], known: Iterable[Subcircuit] | None = None
) -> dict[str, str]:
    """``{name.va: text}``, one module per part; ``known`` are all parts that they may contain.

    Raises
    ------
    UsageError : a construct without a Verilog-A form (waveforms, hysteresis, global ground).
    """
    parts = tuple(parts)
    for part in parts:
        if part.no_module:
            raise UsageError(part.no_module, where=part.filename, hint="it stays a library")
    files = {part.filename: part.circuit for part in known or parts}
    main = Circuit(items=tuple(Directive(".include", (name,)) for name in files))
    top = circuit("parts", {"parts": main, **files})
    return {p.filename.removesuffix(".lib") + ".va": _module(p, top) for p in parts}


def _module(part: Subcircuit, top: Scope) -> str:
    scope = top.subcircuits[part.name.lower()]
    module = Module()
    pins = {pin.name.lower(): module.identifier(pin.name) for pin in part.pins}
    wanted = _used_params(scope)
    params = {}
    for p in part.params:
        if p.name.lower() in wanted:
            spelled = params[p.name.lower()] = module.identifier(p.name)
            line = f"parameter real {spelled} = {number(p.default)};"
            module.declarations.append(f"{line}  // {p.unit}: {p.doc}")
    _expand(scope, module, pins, params, "")
    ports = ", ".join(pins.values())
    inner = ", ".join(module.nodes.values())
    body = [
        *(line.replace("*", "//", 1) for line in _head(part)),
        "// A transient starts from its operating point, in which initial conditions hold.",
        '`include "disciplines.vams"',
        "",
        f"module {Module().identifier(part.name)}({ports});",
        f"  inout {ports};",
        f"  electrical {ports};",
        *([f"  electrical {inner};"] if inner else []),
        *(f"  {line}" for line in (*module.declarations, *module.branches)),
        *module.functions,
        "  analog begin",
        *(f"    {line}" for line in module.laws),
        "  end",
        "endmodule",
    ]
    return "\n".join(body) + "\n"


def _head(part: Subcircuit) -> tuple[str, ...]:
    """The comments above ``.subckt``."""
    return next((item.notes for item in part.circuit.items), ())


def _used_params(scope: Scope) -> set[str]:
    """Words of the expressions of a scope."""
    texts = [
        value
        for card in scope.commands
        if isinstance(card, Parameters)
        for value in card.values.values()
    ]
    for part in scope.elements:
        texts += [*part.values, *part.parameters.values()]
    trees = [parse(text) for text in texts if text.startswith("{")]
    trees += [part.law for part in scope.elements if part.quantity]
    return {leaf.text.lower() for tree in trees for leaf in walk(tree) if isinstance(leaf, Name)}


def _expand(
    scope: Scope, module: Module, pins: Mapping[str, str], params: Mapping[str, str], prefix: str
) -> None:
    """Add the contributions of ``scope``; nested instances come in place, with a prefix."""
    names = Names(module, scope, pins, dict(params), prefix)
    for card in scope.commands:
        if not isinstance(card, Parameters | Function) or card.text.startswith(".csparam"):
            what = "Verilog-A cannot say this command"
            raise UsageError(what, where=card.where, got=card.text[:80])
        names.where = card.where
        for key, text in card.values.items() if isinstance(card, Parameters) else ():
            local = module.identifier(prefix + key)
            _assign(module, local, names.value(text))
            names.params = {**names.params, key.lower(): local}
    for part in scope.elements:
        names.where, names.part = part.where, part.key
        module.laws += [f"// {line[1:].strip()}" if line else "" for line in part.notes]
        if part.kind == "x":
            _nested(part, scope, names)
        else:
            module.laws += law(part, names)


def _assign(module: Module, variable: str, value: str) -> None:
    """A parameter of the netlist that instances cannot set is a variable here."""
    module.declarations.append(f"real {variable};")
    module.laws.append(f"{variable} = {value};")


def _nested(part: Element, scope: Scope, outer: Names) -> None:
    called = scope.find(part.model)
    if called is None or len(called.pins) != len(part.nodes):
        raise UsageError("no such subcircuit", where=part.where, got=part.model)
    prefix = f"{outer.prefix}{part.key}_"
    pins = dict(zip(called.pins, map(outer.node, part.nodes), strict=True))
    params = {}
    for key, default in called.defaults.items():
        local = params[key] = outer.module.identifier(prefix + key)
        value = outer.value(part.settings.get(key, default))
        _assign(outer.module, local, value)
    _expand(called, outer.module, pins, params, prefix)
