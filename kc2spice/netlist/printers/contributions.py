"""Verilog-A words: names, expressions and the contribution of one element."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from kc2spice.core.errors import UsageError
from kc2spice.netlist.cards import number
from kc2spice.netlist.circuit import Element
from kc2spice.netlist.expression import (
    Binary,
    Name,
    Probe,
    Tree,
    Writer,
    literal,
    parse,
    replaced,
    simplified,
    walk,
)
from kc2spice.netlist.scope import GROUND, Scope

# Verilog-AMS Language Reference Manual 2.4, annex B, and the names of our own header.
_WORDS = (
    "above abs absdelay absdelta access acos acosh ac_stim aliasparam always analog "
    "analysis and asin asinh assert assign atan atan2 atanh automatic begin branch buf "
    "bufif0 bufif1 case casex casez ceil cell cmos config connect connectmodule "
    "connectrules continuous cos cosh cross ddt ddt_nature ddx deassign default defparam "
    "design disable discipline discrete domain driver_update edge else end endcase "
    "endconfig endconnectrules enddiscipline endfunction endgenerate endmodule endnature "
    "endparamset endprimitive endspecify endtable endtask event exclude exp final_step "
    "flicker_noise floor flow for force forever fork from function generate genvar ground "
    "highz0 highz1 hypot idt idtmod idt_nature if ifnone incdir include inf initial "
    "initial_step inout input instance integer join laplace_nd laplace_np laplace_zd "
    "laplace_zp large last_crossing liblist library limexp ln localparam log macromodule "
    "max medium merged min module nand nature negedge net_resolution nmos noise_table "
    "noise_table_log nor noshowcancelled not notif0 notif1 or output parameter paramset "
    "pmos posedge potential pow primitive pull0 pull1 pulldown pullup pulsestyle_ondetect "
    "pulsestyle_onevent rcmos real realtime reg release repeat resolveto rnmos rpmos rtran "
    "rtranif0 rtranif1 scalared showcancelled signed sin sinh slew small specify specparam "
    "split sqrt string strong0 strong1 supply0 supply1 table tan tanh task time timer tran "
    "tranif0 tranif1 transition tri tri0 tri1 triand trior trireg units unsigned use uwire "
    "vectored wait wand weak0 weak1 while white_noise wire wor wreal xnor xor zi_nd zi_np "
    "zi_zd zi_zp electrical V I"
)
_RESERVED = frozenset(_WORDS.split())
_FUNCTIONS = frozenset(
    ("abs", "acos", "asin", "atan", "cos", "cosh", "exp", "floor", "ln", "max", "min", "sin",
     "sinh", "sqrt", "tan", "tanh")
)  # fmt: skip
HOLD = 1e9  # S, of initial conditions
SERIES = 1e-15  # Ohm, of a source of voltage
_SWITCH = {"vt": "0.0", "vh": "0.0", "ron": "1.0", "roff": "1e12"}


@dataclass
class Module:
    """A module while it is written."""

    declarations: list[str] = field(default_factory=list)
    functions: list[str] = field(default_factory=list)
    branches: list[str] = field(default_factory=list)
    laws: list[str] = field(default_factory=list)
    nodes: dict[str, str] = field(default_factory=dict)
    taken: set[str] = field(default_factory=set)

    def identifier(self, name: str) -> str:
        """``name``, or what stands for it where the language or another name needs the word."""
        while name in _RESERVED or name in self.taken:
            name += "_"
        self.taken.add(name)
        return name


class Names(Writer):
    """Spelling inside one instance: ``prefix`` keeps nested instances apart."""

    def __init__(
        self,
        module: Module,
        scope: Scope,
        pins: Mapping[str, str],
        params: Mapping[str, str],
        prefix: str,
    ) -> None:
        self.module, self.scope, self.prefix = module, scope, prefix
        self.pins, self.params = pins, params
        self.where, self.part = "", ""

    def node(self, name: str) -> str:
        """Name of a node; a new one is declared."""
        key = name.lower()
        if key in self.pins:
            return self.pins[key]
        if key in GROUND:
            raise UsageError("a module has no global ground", where=self.where, got=name)
        if self.prefix + key not in self.module.nodes:
            self.module.nodes[self.prefix + key] = self.module.identifier(self.prefix + key)
        return self.module.nodes[self.prefix + key]

    def across(self, names: Iterable[str]) -> str:
        """``V(a,b)``."""
        return f"V({','.join(map(self.node, names))})"

    def value(self, text: str) -> str:
        """A literal or ``{expression}`` of a card."""
        return self.law(parse(text, where=self.where))

    def law(self, tree: Tree) -> str:
        """An expression as a factor of a product."""
        return self.write(simplified(tree), 5)

    def write(self, tree: Tree, level: int = 0) -> str:
        """A power is that of the absolute value, as ngspice takes it."""
        if isinstance(tree, Binary) and tree.op == "^":
            return f"pow(abs({self.write(tree.left)}), {self.write(tree.right)})"
        return super().write(tree, level)

    def branch(self, source: str) -> str:
        """The named branch of a voltage source or inductor."""
        return f"br_{self.prefix}{source.lower()}"

    def number(self, text: str) -> str:
        """Reals have a point or an exponent; integers divide differently."""
        return text if set(".eE").intersection(text) else f"{text}.0"

    def name(self, text: str) -> str:
        """A parameter of this instance."""
        if text.lower() not in self.params:
            raise UsageError("Verilog-A cannot say this word", where=self.where, got=text)
        return self.params[text.lower()]

    def probe(self, kind: str, names: tuple[str, ...]) -> str:
        """A voltage, or the current of a source."""
        return self.across(names) if kind == "v" else f"I({self.branch(names[0])})"

    def call(self, function: str, arguments: tuple[Tree, ...]) -> str:
        """Functions by what they mean."""
        if function == "pwl":
            name = f"table_{self.prefix}{self.part}_{len(self.module.functions)}"
            given = [literal(self.write(a), where=self.where) for a in arguments[1:]]
            points = [value for value in given if value is not None]
            at, f = points[::2], points[1::2]
            if len(points) < max(4, len(given)) or len(at) != len(f) or at != sorted(set(at)):
                raise UsageError(
                    "a table of a module has two rising numbers or more, each with its value",
                    where=self.where,
                    got=self.part,
                )
            self.module.functions.append(_table(name, at, f))
            return f"{name}({self.write(arguments[0])})"
        if defined := self.scope.function(function):
            named = dict(zip(map(str.lower, defined.arguments), arguments, strict=False))
            body = parse(defined.expression, where=defined.where)
            words = {leaf.text for leaf in walk(body) if isinstance(leaf, Name)}
            inserted = {word: named[word.lower()] for word in words if word.lower() in named}
            return f"({self.write(replaced(body, inserted))})"
        if function == "pow" and len(arguments) == 2:
            return self.write(Binary("^", *arguments))
        if function == "uramp":
            return f"max(0.0, {self.write(arguments[0])})"
        if function == "sgn":
            x = self.write(arguments[0])
            return f"({x} > 0.0 ? 1.0 : ({x} < 0.0 ? -1.0 : 0.0))"
        spelled = "ln" if function == "log" else function
        if spelled not in _FUNCTIONS:
            raise UsageError("Verilog-A cannot say this function", where=self.where, got=function)
        return super().call(spelled, arguments)


def law(part: Element, names: Names) -> list[str]:
    """Contributions of one primitive element."""
    a, b = (names.node(n) for n in part.nodes[:2]) if part.nodes else ("", "")
    through, across = f"I({a},{b})", f"V({a},{b})"
    value = _value(part, names) if part.kind in "rclegfhk" and not part.quantity else ""
    if part.quantity == "I":
        return [f"{through} <+ {names.law(part.law)};"]
    match part.kind:
        case "r":
            return [f"{through} <+ {across}/{value};"]
        case "c":
            charge = names.module.identifier(f"charge_{names.prefix}{part.key}")
            names.module.declarations.append(f"real {charge};")
            return [
                # of equal products inside of ddt, OpenVAF (Reloaded, 2026-08) now and then gives
                # the derivative of one to the node of another
                f"{charge} = {value}*{across};",
                f"{through} <+ ddt({charge});",
                *_initial(part, through, across, names),
            ]
        case "g":
            return [f"{through} <+ {value}*{names.across(part.nodes[2:])};"]
        case "f":
            return [f"{through} <+ {value}*I({names.branch(part.sources[0])});"]
        case "i":
            return [f"{through} <+ {names.value(_steady(part))};"]
        case "s":
            on = _switch(part, names)
            return [f"{through} <+ {across}/{on};"]
        case "k":
            return _mutual(part, names, value)
    own = names.branch(part.name)
    names.module.branches.append(f"branch ({a},{b}) {own};")
    if part.quantity:
        return [f"V({own}) <+ {names.law(part.law)};"]
    match part.kind:
        case "v":
            value = names.value(_steady(part))
            if part.key in _currents(names.scope):
                # OpenVAF makes one node of the ends of a plain 0 V, and its current zero
                value += f" + {number(SERIES)}*I({own})"
            return [f"V({own}) <+ {value};"]
        case "l":
            return [f"V({own}) <+ ddt({value}*I({own}));"]
        case "e":
            return [f"V({own}) <+ {value}*{names.across(part.nodes[2:])};"]
        case "h":
            return [f"V({own}) <+ {value}*I({names.branch(part.sources[0])});"]
    raise _unsaid(part)


def _unsaid(part: Element) -> UsageError:
    return UsageError("Verilog-A cannot say this card", where=part.where, got=part.text[:80])


def _value(part: Element, names: Names) -> str:
    """The one value of a card; a second one, a multiplier or a model would be left out."""
    known = {"ic"} if part.kind == "c" else set()
    if len(part.values) != 1 or set(part.settings) - known:
        raise _unsaid(part)
    return names.value(part.values[0])


def _initial(part: Element, through: str, across: str, names: Names) -> list[str]:
    """An initial voltage, held by a large conductance while the start of a transient is sought.

    By the clock, because ngspice calls its first time step ``ic``, too.
    """
    if "ic" not in part.settings:
        return []
    start = names.value(part.settings["ic"])
    search = '(analysis("ic") || analysis("tran")) && $abstime <= 0.0'
    return [f"{through} <+ ({search} ? {number(HOLD)} : 0.0)*({across} - {start});"]


def _steady(part: Element) -> str:
    """Value of a source that never changes; a waveform that stays at zero is one."""
    words = [w for w in part.values if w.lower() != "dc"]
    if len(words) == 1 and "(" not in words[0].partition("{")[0]:
        return words[0]
    wave, _, inside = " ".join(words).rstrip(")").partition("(")
    listed = inside.replace(",", " ").split() if wave.strip().lower() == "pwl" else []
    points = [literal(word, where=part.where) for word in listed]
    if points and None not in points and not any(points[1::2]):
        return "0.0"
    raise UsageError("a module has no sources with waveforms", where=part.where, got=part.text[:80])


def _switch(part: Element, names: Names) -> str:
    """Resistance of a switch without hysteresis."""
    model = names.scope.model(part.model)
    found = {k.lower(): v for k, v in model.parameters.items()} if model else {}
    given = _SWITCH | found
    worth = {k: literal(v, where=names.where) for k, v in given.items()}
    if not model or worth.keys() != _SWITCH.keys() or None in worth.values() or worth["vh"]:
        raise UsageError("Verilog-A cannot say this switch", where=names.where, got=str(model))
    on, off, level = (names.value(given[k]) for k in ("ron", "roff", "vt"))
    return f"({names.across(part.nodes[2:])} > {level} ? {on} : {off})"


def _mutual(part: Element, names: Names, coupling: str) -> list[str]:
    """Two contributions of ``M = k sqrt(L1 L2)``."""
    inductors = {e.key: e for e in names.scope.elements if e.kind == "l"}
    coils = [inductors[s.lower()] for s in part.sources if s.lower() in inductors]
    if len(coils) != 2:
        raise _unsaid(part)
    first, second = coils
    product = "*".join(names.value(e.values[0]) for e in (first, second))
    one, two = names.branch(first.name), names.branch(second.name)
    mutual = f"{coupling}*sqrt({product})"
    return [f"V({one}) <+ ddt({mutual}*I({two}));", f"V({two}) <+ ddt({mutual}*I({one}));"]


def _table(name: str, x: list[float], f: list[float]) -> str:
    """Piecewise linear function, found by bisection; the outer segments go on."""
    lines = [f"  analog function real {name};", "    input x;", "    real x;", "    begin"]

    def search(low: int, high: int, indent: str) -> None:
        if high - low == 1:
            slope = (f[high] - f[low]) / (x[high] - x[low])
            value = f"{number(f[low])} + ({number(slope)})*(x - ({number(x[low])}))"
            lines.append(f"{indent}{name} = {value};")
            return
        middle = (low + high) // 2
        lines.append(f"{indent}if (x < {number(x[middle])}) begin")
        search(low, middle, indent + "  ")
        lines.append(f"{indent}end else begin")
        search(middle, high, indent + "  ")
        lines.append(f"{indent}end")

    search(0, len(x) - 1, "      ")
    return "\n".join([*lines, "    end", "  endfunction"])


def _currents(scope: Scope) -> set[str]:
    """Sources whose current others read: a compiler joins the nodes of any other one of 0 V."""
    read = {s.lower() for each in scope.elements for s in each.sources}
    laws = (each.law for each in scope.elements if each.expression)
    probes = (tree for law in laws for tree in walk(law) if isinstance(tree, Probe))
    return read | {probe.names[0].lower() for probe in probes if probe.kind == "i"}
