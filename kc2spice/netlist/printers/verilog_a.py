"""Printer of parts as Verilog-A modules, one statement for each element.

Every element of a part becomes a contribution statement between the same nodes. A module therefore
has the same equations as the ``.subckt`` of the part (Verilog-AMS Language Reference Manual 2.4,
chapters 4 and 5). Inner instances are expanded, because Verilog-A compilers for simulators do not
support hierarchy.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from operator import attrgetter, itemgetter

from kc2spice.core.errors import UsageError
from kc2spice.netlist.circuit import (
    Directive,
    Element,
    Item,
    ModelCard,
    Parameters,
    key_by_lower_name,
    select_items,
)
from kc2spice.netlist.deck import Deck
from kc2spice.netlist.expression import (
    COMMON_FUNCTIONS,
    BinaryOperation,
    CircuitVariable,
    ExpressionWriter,
    Name,
    Number,
    Tree,
    find_probed_names,
    parse_expression,
    parse_literal,
    parse_vector,
    substitute_names,
    walk_tree,
)
from kc2spice.netlist.name_scopes import GROUND_NAMES, INCLUDES, Scope, build_scope
from kc2spice.netlist.number_and_name_spelling import format_number
from kc2spice.netlist.printers.ngspice import Printer
from kc2spice.netlist.subcircuit_library import Subcircuit

# Reserved words of the Verilog-AMS Language Reference Manual 2.4, annex B, and names in the header
# of each module.
_RESERVED_WORDS = (
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
_RESERVED_NAMES = frozenset(_RESERVED_WORDS.split())
_NO_EQUIVALENT = "Verilog-A has no equivalent of this card"
# conductance [S] that enforces an initial condition; larger than all other conductances
HOLD_CONDUCTANCE = 1e9
SOURCE_RESISTANCE = 1e-15  # resistance [Ohm] in series with a voltage source
# cards that may refer to nodes that a Verilog-A module does not have
_OUTPUT_CARDS = (".print", ".meas")
_FUNCTION_TEMPLATES = {
    "uramp": "max(0.0, {0})",
    "sgn": "({0} > 0.0 ? 1.0 : ({0} < 0.0 ? -1.0 : 0.0))",
}
_SWITCH_DEFAULTS = {"vt": "0.0", "vh": "0.0", "ron": "1.0", "roff": "1e12"}


@dataclass
class Module:
    """Declarations and statements of a Verilog-A module."""

    declarations: list[str] = field(default_factory=list)
    functions: list[str] = field(default_factory=list)
    branches: list[str] = field(default_factory=list)
    laws: list[str] = field(default_factory=list)
    nodes: dict[str, str] = field(default_factory=dict)
    identifiers: set[str] = field(default_factory=set)

    def allocate_identifier(self, name: str) -> str:
        """Return an unused identifier, with ``_`` appended to the name if necessary."""
        while name in _RESERVED_NAMES or name in self.identifiers:
            name += "_"
        self.identifiers.add(name)
        return name

    def declare_variable(self, name: str, value: str) -> str:
        """Declare a variable with a value, such as a charge; return its Verilog-A name."""
        spelled = self.allocate_identifier(name)
        self.declarations.append(f"real {spelled};")
        self.laws.append(f"{spelled} = {value};")
        return spelled


@dataclass
class VerilogWriter(ExpressionWriter):
    """Writer that translates the names and expressions of a subcircuit to Verilog-A."""

    module: Module
    scope: Scope
    pins: Mapping[str, str]
    params: dict[str, str]
    prefix: str
    where: str = ""
    part: str = ""

    def declare_node(self, name: str) -> str:
        """Return the Verilog-A name of a node, and declare the node if it is new."""
        key, nodes = name.lower(), self.module.nodes
        if key in self.pins:
            return self.pins[key]
        if key in GROUND_NAMES:
            raise UsageError(
                "a Verilog-A module cannot use the global ground node",
                where=self.where,
                got=name,
                hint="export this scene with --dialect ngspice",
            )
        local = self.prefix + key
        if local not in nodes:
            nodes[local] = self.module.allocate_identifier(local)
        return nodes[local]

    def write_voltage(self, names: Iterable[str]) -> str:
        """Return the Verilog-A text of the voltage between two nodes."""
        return f"V({','.join(map(self.declare_node, names))})"

    def format_word(self, text: str) -> str:
        """Return the Verilog-A text of a number or an ``{expression}`` on a card."""
        return self.format_law(parse_expression(text, where=self.where))

    def format_law(self, tree: Tree) -> str:
        """Format a law's expression as Verilog-A text, in parentheses if necessary."""
        return self.write_tree(tree, 5)

    def write_tree(self, tree: Tree, level: int = 0) -> str:
        """Write an expression tree as Verilog-A text.

        As in ngspice, a power is computed from the absolute value of its base. Every number has a
        decimal point or an exponent, because Verilog-A truncates quotients of integers.
        """
        match tree:
            case Number(text):
                return text if set(".eE").intersection(text) else f"{text}.0"
            case CircuitVariable("v", names):
                return self.write_voltage(names)
            case CircuitVariable("i", (source, *_)):
                return f"I({self.name_branch(source)})"
            case BinaryOperation("^", left, right):
                return f"pow(abs({self.write_tree(left)}), {self.write_tree(right)})"
        return super().write_tree(tree, level)

    def name_branch(self, source: str) -> str:
        """Return the name of the Verilog-A branch of a voltage source."""
        return f"br_{self.prefix}{source.lower()}"

    def format_name(self, text: str) -> str:
        """Return the Verilog-A spelling of a parameter or keyword."""
        if text.lower() not in self.params:
            raise UsageError(
                "Verilog-A has no equivalent of this name",
                where=self.where,
                got=text,
                hint="export this scene with --dialect ngspice",
            )
        return self.params[text.lower()]

    def write_call(self, function: str, arguments: tuple[Tree, ...]) -> str:
        """Return the Verilog-A text of a function call."""
        if function == "pwl":
            name = f"table_{self.prefix}{self.part}_{len(self.module.functions)}"
            numbers = [parse_literal(self.write_tree(a), where=self.where) for a in arguments[1:]]
            points = [value for value in numbers if value is not None]
            at, f = points[::2], points[1::2]
            if len(points) < max(4, len(numbers)) or len(at) != len(f) or at != sorted(set(at)):
                raise UsageError(
                    (
                        "a table in a Verilog-A module needs at least two points with constant "
                        "values, sorted by increasing argument"
                    ),
                    where=self.where,
                    got=f"a table in {self.part}",
                )
            self.module.functions.append(_write_table_function(name, at, f))
            return f"{name}({self.write_tree(arguments[0])})"
        if defined := self.scope.functions.get(function):
            bound = dict(zip(map(str.lower, defined.arguments), arguments, strict=False))
            body = parse_expression(defined.expression, where=defined.where)
            inserted = {}
            for leaf in select_items(walk_tree(body), Name):
                if leaf.text.lower() in bound:
                    inserted[leaf.text] = bound[leaf.text.lower()]
            return f"({self.write_tree(substitute_names(body, inserted))})"
        if function == "pow" and len(arguments) == 2:
            return self.write_tree(BinaryOperation("^", *arguments))
        if spelled := _FUNCTION_TEMPLATES.get(function):
            return spelled.format(self.write_tree(arguments[0]))
        spelled = "ln" if function == "log" else function
        if spelled not in COMMON_FUNCTIONS:
            raise UsageError(
                "Verilog-A has no equivalent of this function", where=self.where, got=function
            )
        return super().write_call(spelled, arguments)


def format_module(part: Subcircuit) -> dict[str, str]:
    """Return the Verilog-A module of a part as ``{name.va: text}``.

    Raises
    ------
    UsageError : the part contains a card without an equivalent in Verilog-A, such as a waveform, a
        switch with hysteresis, or a global ground.
    """
    if part.no_module:
        raise UsageError(
            f"this part cannot be written as a Verilog-A module: {part.no_module}",
            where=part.filename,
            got="--dialect verilog-a",
            expected="ngspice, xyce or ltspice",
            hint="export this scene with --dialect ngspice",
        )
    scope = build_scope(part.located_tree).subcircuits[part.name.lower()]
    module = Module()
    pins, params = {}, {}
    for pin in part.pins:
        pins[pin.key] = module.allocate_identifier(pin.name)
    for p in part.params:
        spelled = params[p.name.lower()] = module.allocate_identifier(p.name)
        line = f"parameter real {spelled} = {format_number(p.default)};"
        module.declarations.append(f"{line}  // {p.unit}: {p.doc}")
    names = VerilogWriter(module, scope, pins, params, "")
    for key, default in scope.defaults.items():  # a user's subcircuit may have no header
        if key.lower() not in params:
            spelled, value = module.allocate_identifier(key), names.format_word(default)
            module.declarations.append(f"parameter real {spelled} = {value};")
            params[key.lower()] = spelled
    _expand_circuit(names)
    ports = ", ".join(pins.values())
    inner = ", ".join(module.nodes.values())
    notes = part.circuit.items[0].notes if part.circuit.items else ()
    body = [
        *(line.replace("*", "//", 1) for line in notes),
        "// A transient analysis starts from an operating point that enforces the initial "
        "conditions.",
        '`include "disciplines.vams"',
        "",
        f"module {Module().allocate_identifier(part.name)}({ports});",
        f"  inout {ports};",
        f"  electrical {ports};",
        *([f"  electrical {inner};"] if inner else []),
        *map("  {}".format, module.declarations),
        *map("  {}".format, module.branches),
        *module.functions,
        "  analog begin",
        *map("    {}".format, module.laws),
        "  end",
        "endmodule",
    ]
    return {part.filename.removesuffix(".lib") + ".va": "\n".join(body) + "\n"}


def _expand_circuit(names: VerilogWriter) -> None:
    """Add the statements of an instance, and of its inner instances, to the module."""
    scope, module, prefix = names.scope, names.module, names.prefix
    for card in scope.commands:
        names.where = card.where
        if isinstance(card, Directive) or card.written.startswith(".csparam"):
            raise card.make_error(_NO_EQUIVALENT)
        for key, text in card.values.items() if isinstance(card, Parameters) else ():
            names.params[key.lower()] = module.declare_variable(
                prefix + key, names.format_word(text)
            )
    for part in scope.elements:
        if part.kind == "r" and len(set(part.lower_case_nodes)) == 1:
            # In SPICE, a resistor with both terminals on one node checks the range of a parameter:
            # its resistance is not a number outside of the range. In Verilog-A, the error of the
            # resistor would not name the parameter, so the module omits the resistor.
            continue
        names.where, names.part = part.where, part.key
        module.laws += map(_convert_comment, part.notes)
        if part.kind == "x":
            _expand_instance(part, names)
        else:
            _add_contribution(part, names)


def _convert_comment(line: str) -> str:
    """Return a netlist comment as a Verilog-A comment."""
    return f"// {line[1:].strip()}" if line else ""


def _expand_instance(part: Element, outer: VerilogWriter) -> None:
    """Add the statements of an inner instance to the module."""
    called = outer.scope.find_subcircuit(part.model)
    if called is None or len(called.pins) != len(part.nodes):
        raise part.make_error("no such subcircuit", part.model)
    prefix = f"{outer.prefix}{part.key}_"
    pins = dict(zip(called.pins, map(outer.declare_node, part.nodes), strict=True))
    params = {}
    for key, default in called.defaults.items():
        value = outer.format_word(part.settings.get(key, default))
        params[key] = outer.module.declare_variable(prefix + key, value)
    _expand_circuit(VerilogWriter(outer.module, called, pins, params, prefix))


def _add_contribution(part: Element, names: VerilogWriter) -> None:
    """Add the contribution statement of one element to the module.

    The statement contributes a current between the nodes of the element, or a voltage to a named
    branch.
    """
    module = names.module
    if part.kind == "k":
        module.laws += _couple_inductors(part, names)
        return
    a, b = map(names.declare_node, part.nodes[:2]) if part.nodes else ("", "")
    through, across = f"I({a},{b})", f"V({a},{b})"
    if part.quantity == "V" or (part.kind in "vleh" and not part.quantity):
        branch = names.name_branch(part.name)
        through = f"V({branch})"
        module.branches.append(f"branch ({a},{b}) {branch};")
    right = (
        names.format_law(part.law)
        if part.quantity
        else _write_element_contribution(part, names, across)
    )
    module.laws.append(f"{through} <+ {right};")
    if part.kind == "c" and "ic" in part.settings:
        # The condition includes the time, because ngspice reports the analysis type ``ic`` also in
        # the first time step.
        at_start = '(analysis("ic") || analysis("tran")) && $abstime <= 0.0'
        start = names.format_word(part.settings["ic"])
        clamp = f"({at_start} ? {format_number(HOLD_CONDUCTANCE)} : 0.0)*({across} - {start})"
        module.laws.append(f"{through} <+ {clamp};")


def _write_element_contribution(part: Element, names: VerilogWriter, across: str) -> str:
    """Return the contribution text of an element whose card has no expression."""
    current = f"I({names.name_branch(part.name)})"
    match part.kind:
        case "r":
            return f"{across}/{_read_card_value(part, names)}"
        case "c":
            # If several ddt operators have the same argument, OpenVAF (Reloaded, 2026-08) may
            # assign one derivative to the node of another.
            charge = f"{_read_card_value(part, names)}*{across}"
            return (
                f"ddt({names.module.declare_variable(f'charge_{names.prefix}{part.key}', charge)})"
            )
        case "l":
            return f"ddt({_read_card_value(part, names)}*{current})"
        case "e" | "g":
            return f"{_read_card_value(part, names)}*{names.write_voltage(part.nodes[2:])}"
        case "f" | "h":
            return f"{_read_card_value(part, names)}*I({names.name_branch(part.sources[0])})"
        case "s":
            return f"{across}/{_write_switch_resistance(part, names)}"
        case "i":
            return _read_constant_value(part, names)
        case "v":
            # OpenVAF merges the two nodes of a 0 V source, and sets the current of the source to
            # zero
            series = f" + {format_number(SOURCE_RESISTANCE)}*{current}"
            return _read_constant_value(part, names) + (
                series if _is_current_sensed(part, names.scope) else ""
            )
    raise part.make_error(_NO_EQUIVALENT)


def _is_current_sensed(source: Element, scope: Scope) -> bool:
    """Return whether a card of the scope reads the current of a voltage source."""
    for item in scope.elements:
        if source.key in map(str.lower, item.sources):
            return True
        if item.expression and source.key in find_probed_names(item.law, "i"):
            return True
    return False


def _read_card_value(part: Element, names: VerilogWriter) -> str:
    """Return the only value on a card; reject multipliers and models."""
    if len(part.values) != 1 or set(part.settings) - ({"ic"} if part.kind == "c" else set()):
        raise part.make_error(_NO_EQUIVALENT)
    return names.format_word(part.values[0])


def _read_constant_value(part: Element, names: VerilogWriter) -> str:
    """Return the value of a constant source, or zero for a waveform of zeros."""
    words = [w for w in part.values if w.lower() != "dc"]
    if len(words) == 1 and "(" not in words[0].partition("{")[0]:
        return names.format_word(words[0])
    wave, _, inside = " ".join(words).rstrip(")").partition("(")
    listed = inside.replace(",", " ").split() if wave.strip().lower() == "pwl" else []
    points = [parse_literal(word, where=part.where) for word in listed]
    if points and None not in points and not any(points[1::2]):
        return "0.0"
    raise part.make_error("sources with waveforms are not supported in Verilog-A modules")


def _write_switch_resistance(part: Element, names: VerilogWriter) -> str:
    """Return the resistance of a switch as an expression of its control voltage."""
    model = names.scope.models.get(part.model.lower())
    parameters = _SWITCH_DEFAULTS | (key_by_lower_name(model.parameters) if model else {})
    numbers = {k: parse_literal(v, where=names.where) for k, v in parameters.items()}
    if (
        not model
        or numbers.keys() != _SWITCH_DEFAULTS.keys()
        or None in numbers.values()
        or numbers["vh"]
    ):
        raise part.make_error("Verilog-A has no equivalent of this switch")
    on, off, level = map(names.format_word, itemgetter("ron", "roff", "vt")(parameters))
    return f"({names.write_voltage(part.nodes[2:])} > {level} ? {on} : {off})"


def _couple_inductors(part: Element, names: VerilogWriter) -> list[str]:
    """Return the statements for the voltages that a coupling (``K`` card) induces."""
    inductors = names.scope.select_elements("l")
    coils = list(filter(None, map(inductors.get, map(str.lower, part.sources))))
    if len(coils) != 2:
        raise part.make_error(_NO_EQUIVALENT)
    first, second = coils
    product = f"{names.format_word(first.values[0])}*{names.format_word(second.values[0])}"
    mutual = f"{_read_card_value(part, names)}*sqrt({product})"
    one, two = names.name_branch(first.name), names.name_branch(second.name)
    return [f"V({one}) <+ ddt({mutual}*I({two}));", f"V({two}) <+ ddt({mutual}*I({one}));"]


def _write_table_function(name: str, x: list[float], f: list[float]) -> str:
    """Return a piecewise linear function as text, linearly extrapolated at its ends."""
    lines = [f"  analog function real {name};", "    input x;", "    real x;", "    begin"]

    def append_search(low: int, high: int, indent: str) -> None:
        """Append statements that search for ``x`` among the points ``low`` to ``high``."""
        if high - low == 1:
            slope = (f[high] - f[low]) / (x[high] - x[low])
            value, start = format_number(f[low]), format_number(x[low])
            value = f"{value} + ({format_number(slope)})*(x - ({start}))"
            lines.append(f"{indent}{name} = {value};")
            return
        middle = (low + high) // 2
        lines.append(f"{indent}if (x < {format_number(x[middle])}) begin")
        append_search(low, middle, indent + "  ")
        lines.append(f"{indent}end else begin")
        append_search(middle, high, indent + "  ")
        lines.append(f"{indent}end")

    append_search(0, len(x) - 1, "      ")
    return "\n".join([*lines, "    end", "  endfunction"])


# --- deck for an ngspice that loads modules compiled to OSDI ---


def make_testbench(deck: Deck, modules: Collection[Subcircuit]) -> dict[str, str]:
    """Make a test bench: files of a deck with Verilog-A modules of its parts.

    To run the deck, the user first compiles each ``NAME.va`` to ``NAME.osdi`` with the command
    ``openvaf-r NAME.va``. Parts without a module remain subcircuits in library files. The deck
    saves no vectors inside modules, because ngspice cannot save them. The transient has no ``uic``,
    because the modules contain their initial conditions.
    """
    stems = {p.name.lower(): p.filename.removesuffix(".lib") for p in modules}
    replaced = set(map(attrgetter("filename"), modules))
    main = f"{deck.name}_osdi.cir"
    compiled = " && ".join(f"openvaf-r {stem}.va" for stem in stems.values())
    tree = deck.add_usage_comment(
        f"* Run it with:  {compiled} && ngspice -b -r {deck.name}.raw {main}",
        "* Each part is a Verilog-A module, compiled by OpenVAF and loaded by ngspice 39 or later.",
    )
    items = [_adapt_to_modules(item, stems, replaced) for item in tree.items]
    loads = tuple(map("pre_osdi {}.osdi".format, stems.values()))
    control = Directive(".control", loads, notes=items[0].notes)
    models = []
    for item in select_items(tree.items, Element):
        if item.model.lower() in stems:
            models.append(ModelCard(f"m{item.key}", item.model, item.parameters))
    tree = replace(tree, items=(control, *models, replace(items[0], notes=()), *items[1:]))
    files = {main: Printer().format_file(tree)}
    return files | {
        n: text for n, text in deck.files.items() if n not in {deck.main_file_name, *replaced}
    }


def _adapt_to_modules(item: Item, stems: Mapping[str, str], replaced: Collection[str]) -> Item:
    """Change a deck item so that it refers to Verilog-A modules, not to subcircuits.

    The card of a module's instance is an N card with a ``.model`` card that contains the
    parameters. A card without an equivalent is replaced by an empty card.
    """
    if isinstance(item, Element) and item.model.lower() in stems:
        name = f"N{item.name[1:]}"
        return replace(item, kind="n", name=name, model=f"m{item.key}", parameters={})
    if not isinstance(item, Directive):
        return item
    words = item.words
    if item.keyword == ".save":
        words = tuple(filter(_is_outside_subcircuits, words))
    elif item.keyword == ".tran":
        words = tuple(word for word in words if word.lower() != "uic")
    elif item.keyword in _OUTPUT_CARDS or (item.keyword in INCLUDES and words[0] in replaced):
        words = ()
    if item.words and not words:
        # the ``.save`` cards determine the printed vectors
        notes = () if item.keyword in _OUTPUT_CARDS else item.notes
        return replace(item, keyword="", words=(), notes=notes)
    return replace(item, words=words)


def _is_outside_subcircuits(text: str) -> bool:
    """Return whether all nodes and devices of a vector are outside of subcircuits."""
    result = parse_vector(text)
    if result is None or result.path or result.parameter or "." in result.names[0]:
        return False
    return result.quantity == "v" or result.names[0].lower().startswith("v")
