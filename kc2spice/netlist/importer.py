"""Translation of LTspice and PSpice subcircuits to equivalent ngspice subcircuits.

Input and output are syntax trees from :mod:`kc2spice.netlist.card_parser`. Each element, function
or operator that ngspice lacks or interprets differently is replaced by an equivalent. An error
states the line of each construct without an equivalent, and the reason. Sources: the help pages of
LTspice on circuit elements, and for the ideal diode the comparison with LTspice in the
documentation of SpiceSharpParser (article *LTspice-Style Ideal Diode*).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from itertools import pairwise
from textwrap import shorten
from typing import Literal

from kc2spice.netlist.card_parser import LAPLACE_HINT, split_operands
from kc2spice.netlist.circuit import (
    Card,
    Circuit,
    Element,
    FunctionCard,
    Item,
    ModelCard,
    Parameters,
    select_items,
)
from kc2spice.netlist.expression import (
    BinaryOperation,
    CircuitVariable,
    ConditionalExpression,
    ExpressionWriter,
    FunctionCall,
    Name,
    Number,
    Tree,
    UnaryOperation,
    map_operands,
    parse_expression,
    parse_literal,
)
from kc2spice.netlist.number_and_name_spelling import split_infix_unit

# Ohm, series resistance of an uncoupled inductor without the setting ``Rser`` (LTspice help, L)
INDUCTOR_RESISTANCE = "1m"
ABSOLUTE_ZERO = -273.15  # degrees Celsius
MIN_CONDUCTANCE = "1e-12"  # S, conductance of an ideal diode without the setting ``Roff``
IDEAL_DIODE_PARAMETERS = frozenset((
    "ron", "roff", "vfwd", "vrev", "rrev", "ilimit", "revilimit", "epsilon", "revepsilon",
))  # fmt: skip
# Model parameters that LTspice only displays, such as ratings and manufacturers.
# VDMOS models have further parameters that LTspice only displays.
DISPLAYED_PARAMETERS = frozenset(("iave", "icrating", "mfg", "type", "vceo", "vpk"))
VDMOS_DISPLAYED_PARAMETERS = DISPLAYED_PARAMETERS | {"qg", "ron", "vds"}
# Element parameters that LTspice only displays, such as ratings, manufacturers and part numbers.
# Source for the displayed element parameters: LTspice help, pages R, C and L.
DISPLAYED_RATINGS = {
    "r": frozenset(("tol", "pwr", "mfg", "pn", "type")),
    "c": frozenset(("v", "irms", "mfg", "pn", "type")),
    "l": frozenset(("ipk", "irms", "mfg", "pn", "type")),
}
PSPICE_SWITCHES = {"vswitch": "SW", "iswitch": "CSW"}  # ngspice types of switches with hysteresis
# Settings of a behavioural source that affect the time steps, but not its equation.
STEP_CONTROL_PARAMETERS = frozenset(("tripdv", "tripdt"))
Syntax = Literal["ngspice", "ltspice", "pspice"]
_COMPARISONS = ("<", ">", "<=", ">=", "==", "!=")
_LOGICAL_OPERATORS = ("&&", "||")
# Parasitics in parallel with an element, which carry a part of its terminal current.
_PARALLEL_PARASITICS = frozenset(("rpar", "cpar"))
# letters of elements whose measured current flows into the first node
_METERED_KINDS = frozenset("bcdefghilrv")
_MAX_COMMENT = 98  # largest number of characters of a comment line; longer comments are shortened
_MAX_PRODUCT_POWER = 9  # largest integer exponent of a power that is written as a product
_SETTING = re.compile(r"\s(\w+)\s*=(?!=)")
_NUMBER_IN_TABLE = re.compile(r"[^\s,(){}=]+")
_MICRO = str.maketrans({"\u00b5": "u", "\u03bc": "u"})
_UNSUPPORTED_FUNCTIONS = {
    "absdelay": "a delay of a voltage", "delay": "a delay of a voltage",
    "ddt": "a time derivative", "idt": "a time integral",
    "idtmod": "a time integral", "sdt": "a time integral",
    "rand": "a random signal", "random": "a random signal",
    "white": "a random signal", "smallsig": "a test for small-signal analysis",
}  # fmt: skip


def translate_circuit(circuit: Circuit, syntax: Syntax) -> Circuit:
    """Translate a circuit to the syntax of ngspice.

    Parameters
    ----------
    circuit : Circuit
        Tree of a file or of a subcircuit.
    syntax : "ngspice", "ltspice" or "pspice"
        Syntax of the input circuit.

    Returns
    -------
    Circuit
        Tree with the same pins, parameters and equations for ngspice.

    Raises
    ------
    UsageError : ngspice has no equivalent of a construct; the error contains file and line.

    Examples
    --------
    >>> from kc2spice.netlist.card_parser import LAPLACE_HINT, read_cards
    >>> text = ".subckt p a b\\nC1 a b 10n Rser=0.1\\nB1 a b I=if(V(a,b)>1, 1m, 0)\\n.ends"
    >>> for item in translate_circuit(read_cards(text, "p.lib"), "ltspice").subcircuits[0].items:
    ...     print(item.name, *item.nodes, *(item.values or [item.expression]))
    C1 C1_inner b 10n
    RC1_ser a C1_inner 0.1
    B1 a b (V(a,b)>1 ? 0.001 : 0)
    """
    if syntax == "ngspice":
        return circuit
    return _CircuitTranslator(circuit, {}, frozenset(), syntax).translate()


class _CircuitTranslator:
    """Translator of one circuit, with the models and functions that are defined there."""

    def __init__(
        self,
        circuit: Circuit,
        models: Mapping[str, ModelCard],
        functions: frozenset[str],
        syntax: Syntax,
    ) -> None:
        self.circuit, self.syntax = circuit, syntax
        defined = select_items(circuit.items, FunctionCard)
        self.functions = functions | {function.name.lower() for function in defined}
        local = {model.name.lower(): model for model in select_items(circuit.items, ModelCard)}
        self.models = {**models, **local}
        elements = select_items(circuit.items, Element)
        coupled = (element.sources for element in elements if element.kind == "k")
        self.coupled = {name.lower() for names in coupled for name in names}
        self.elements = {element.key: element for element in elements}
        # name of the ammeter for each element whose current occurs in an expression
        self.metered: dict[str, str] = {}

    def translate(self) -> Circuit:
        """Return the circuit in the syntax of ngspice."""
        groups = [(item, tuple(self._translate_item(item))) for item in self.circuit.items]
        items: list[Item] = []
        for item, group in groups:  # ``self.metered`` is complete after all translations
            if isinstance(item, Element) and item.key in self.metered:
                items += _add_meter(item, group, self.metered[item.key])
            else:
                items += group
        defaults = self._translate_values(self.circuit.defaults, self.circuit)
        return replace(self.circuit, items=tuple(items), defaults=defaults)

    def _translate_values(self, values: Mapping[str, str], card: Card) -> dict[str, str]:
        """Translate all values in a mapping of a card, such as its parameters."""
        return {name: self._translate_value(text, card) for name, text in values.items()}

    def _translate_value(self, text: str, card: Card) -> str:
        """Translate a value of a card; a value in braces or quotes is an expression."""
        text = text.translate(_MICRO)
        if self.syntax == "ltspice" and (parameter := split_infix_unit(text)):
            return "{0}.{2}{1}".format(*parameter)
        if text[:1] + text[-1:] not in ("{}", "''"):
            return text
        return f"{{{self._translate_expression(text[1:-1], card)}}}"

    def _translate_expression(self, text: str, card: Card) -> str:
        """Translate the text of an expression on a card to ngspice."""
        return _ExpressionTranslator(card, self).translate(text)

    def _translate_item(self, item: Item) -> Iterable[Item]:
        """Translate a netlist item, such as an element, to one or more ngspice items."""
        match item:
            case Circuit():
                return (
                    _CircuitTranslator(item, self.models, self.functions, self.syntax).translate(),
                )
            case ModelCard():
                return self._translate_model(item)
            case Parameters():
                return (replace(item, values=self._translate_values(item.values, item)),)
            case FunctionCard():
                return (
                    replace(item, expression=self._translate_expression(item.expression, item)),
                )
            case Element():
                return self._translate_element(item)
        return (item,)

    # --- models -----------------------------------------------------------------------------------

    def _resolve_model(self, model: ModelCard) -> ModelCard:
        """Return the model, completed with the parameters of its base model (``ako:``)."""
        if not model.type.lower().startswith("ako:"):
            return model
        base = self.models.get(model.type[4:].lower())
        if base is None or base is model:
            raise model.make_error(
                "the base model of this model is missing",
                model.type[4:],
                "a .model of this file",
                f"add the line  .model {model.type[4:]} …  from the library of the manufacturer",
            )
        base = self._resolve_model(base)
        parameters = _get_model_parameters(base) | _get_model_parameters(model)
        parameters.pop(base.type.lower(), None)  # a model may repeat its type after ``ako:``
        return replace(model, type=base.type, parameters=parameters)

    def _translate_model(self, model: ModelCard) -> Iterable[ModelCard]:
        """Return the translated model, or nothing if its elements become current sources."""
        model = self._resolve_model(model)
        kind = model.type.lower()
        if self._is_ideal_diode(model):
            return ()  # diodes of this model are translated to current sources
        if self._is_gradual_switch(model):
            return ()  # switches of this model are translated to current sources
        if kind in PSPICE_SWITCHES and self.syntax == "pspice":  # switch with hysteresis
            model = replace(model, type=PSPICE_SWITCHES[kind])
        if kind in ("sw", "csw"):
            _require_simple_switch(model)
        displayed = VDMOS_DISPLAYED_PARAMETERS if kind == "vdmos" else DISPLAYED_PARAMETERS
        if self.syntax == "pspice":
            # the elements of the model get the temperature ``T_ABS``
            displayed = displayed | {"t_abs"}
        computed = {k: v for k, v in model.parameters.items() if k.lower() not in displayed}
        return (replace(model, parameters=self._translate_values(computed, model)),)

    # --- elements ---------------------------------------------------------------------------------

    def _is_ideal_diode(self, model: ModelCard) -> bool:
        """Return whether the model is the piecewise linear diode of LTspice."""
        ideal = model.type.lower() == "d" and bool(
            _get_model_parameters(model).keys() & IDEAL_DIODE_PARAMETERS
        )
        return ideal and self.syntax == "ltspice"

    def _is_gradual_switch(self, model: ModelCard) -> bool:
        """Return whether the model is a PSpice switch with a smooth transition."""
        hysteresis = _get_model_parameters(model).keys() & {"vt", "vh", "it", "ih"}
        is_switch = model.type.lower() in PSPICE_SWITCHES and self.syntax == "pspice"
        return is_switch and not hysteresis

    def _translate_element(self, element: Element) -> Iterable[Item]:
        """Translate an element to the corresponding ngspice items."""
        if element.quantity:
            return self._translate_source(element)
        if element.kind == "r" and "r" in element.settings:
            return (self._translate_resistor(element),)
        if element.kind == "a":
            raise element.make_error(
                "an A device of LTspice has no equivalent in ngspice",
                hint="replace the A device by B sources, or by a subcircuit with the same function",
            )
        words = " ".join(map(str.lower, (*element.values, *element.parameters)))
        if element.kind in "eg" and (
            "laplace" in words or element.expression.lower().startswith("laplace")
        ):
            raise element.make_error(
                "a Laplace transform has no equivalent in ngspice", hint=LAPLACE_HINT
            )
        if element.kind == "i" and words.endswith(" load"):
            raise element.make_error(
                "a current source with the option `load` has no equivalent in ngspice",
                hint="delete the option `load` from this line, or replace the source by a resistor",
            )
        if element.kind in "fh":
            element = _complete_polynomial(element)
        if self.syntax == "ltspice":
            element = _move_ratings(element)
        element = replace(
            element,
            values=tuple(self._translate_value(text, element) for text in element.values),
            parameters=self._translate_values(element.parameters, element),
        )
        model = self.models.get(element.model.lower()) if element.kind == "d" else None
        if model is not None and self._is_ideal_diode(resolved := self._resolve_model(model)):
            return (
                _translate_ideal_diode(
                    element, self._translate_values(_get_model_parameters(resolved), resolved)
                ),
            )
        switch = self.models.get(element.model.lower()) if element.kind in "sw" else None
        if switch is not None and self._is_gradual_switch(switch):
            return (
                _translate_gradual_switch(
                    element, self._translate_values(_get_model_parameters(switch), switch)
                ),
            )
        if element.kind in "eg" and (points := _read_table_points(element)):
            law = self._translate_expression(
                f"table(V({','.join(element.nodes[2:])}), {points})", element
            )
            quantity = "V" if element.kind == "e" else "I"
            return (_make_source(element, quantity, law),)
        element = self._with_temperature(element)
        parasitic = {
            "c": _translate_capacitor,
            "l": self._translate_inductor,
            "v": _translate_voltage,
        }.get(element.kind)
        return parasitic(element) if parasitic else (element,)

    def _with_temperature(self, element: Element) -> Element:
        """Copy ``T_ABS``, the temperature of a PSpice model, to an element of this model.

        A resistor whose model is at absolute zero becomes noiseless instead.
        """
        names = (element.model, *element.values[:1])
        models = filter(None, (self.models.get(name.lower()) for name in names))
        for model in map(_get_model_parameters, models):
            if "t_abs" in model and self.syntax == "pspice":
                is_cold = element.kind == "r" and parse_literal(model["t_abs"]) == ABSOLUTE_ZERO
                setting = {"noisy": "0"} if is_cold else {"temp": model["t_abs"]}
                return replace(element, parameters={**element.parameters, **setting})
        return element

    def _translate_resistor(self, element: Element) -> Element:
        """Return a current source that replaces a resistor with a resistance expression."""
        law = self._translate_expression(element.settings["r"].strip("{}'"), element)
        plus, minus = element.nodes
        current = f"V({plus},{minus})/({law})"
        return Element.behavioural_source(f"B{element.name}", plus, minus, "I", current)

    def _translate_source(self, element: Element) -> Iterable[Item]:
        """Translate a behavioural source with its expression and its settings."""
        law, settings = _split_settings(element.expression)
        result = [replace(element, expression=self._translate_expression(law, element))]
        for name, value in settings.items():
            if name in STEP_CONTROL_PARAMETERS:
                continue
            across = {"rpar": "r", "cpar": "c"}.get(name)
            if across is None:
                raise element.make_error(
                    f"{name} of a behavioural source has no equivalent in ngspice",
                    hint=LAPLACE_HINT if name == "laplace" else f"delete {name} from this line",
                )
            card = f"{across.upper()}{element.name}_par"
            result.append(
                _make_parallel_element(
                    element, card, *element.nodes, self._translate_value(value, element)
                )
            )
        return result

    def _translate_inductor(self, element: Element) -> Iterable[Item]:
        """Translate an inductor with the parasitics ``Rser``, ``Rpar`` and ``Cpar``."""
        if "flux" in element.settings:
            raise element.make_error(
                "an inductor with a flux expression has no equivalent in ngspice",
                hint="write a constant inductance in place of the expression",
            )
        ideal = element.key in self.coupled or self.syntax == "pspice"
        default = "0" if ideal else INDUCTOR_RESISTANCE
        settings = {"rser": default, **element.settings}
        return _expand_parasitics(element, settings, ())


def _add_meter(element: Element, group: Iterable[Item], meter: str) -> Iterator[Item]:
    """Insert a 0 V ammeter in series with the translated items of an element."""
    plus, inner = element.nodes[0], f"{element.name}_metered"
    yield _make_parallel_element(element, meter, plus, inner, "0")
    for item in group:
        # An element is translated into one or several elements, and into no other netlist items.
        assert isinstance(item, Element)
        yield replace(item, nodes=tuple(inner if node == plus else node for node in item.nodes))


def _complete_polynomial(element: Element) -> Element:
    """Add the constant term 0 to an F or H source ``POLY(1)`` with a single coefficient.

    SPICE 2 multiplies the current by the single coefficient; ngspice reads a constant.
    """
    words = split_operands(" ".join(element.values))
    if len(words) != 4 or (words[0].lower(), words[1]) != ("poly", "1"):
        return element
    return replace(element, values=("POLY(1)", words[2], "0", words[3]))


def _move_ratings(element: Element) -> Element:
    """Move the ratings of a passive element to a comment above its card."""
    names = DISPLAYED_RATINGS.get(element.kind, frozenset())
    ratings = {name: text for name, text in element.parameters.items() if name.lower() in names}
    if not ratings:
        return element
    note = " ".join(map("=".join, ratings.items()))
    note = shorten(f"* {element.name}: the equations do not contain {note}", _MAX_COMMENT)
    values = {name: text for name, text in element.parameters.items() if name not in ratings}
    return replace(element, notes=(*element.notes, note), parameters=values)


def _make_parallel_element(element: Element, name: str, *words: str) -> Element:
    """Return a parasitic element with the same multiplicity ``m`` as its main element."""
    count = {key: text for key, text in element.parameters.items() if key.lower() == "m"}
    parasitic = Element.from_words(name, *words, **({} if name[0] in "Vv" else count))
    return replace(parasitic, where=element.where, written=element.written)


def _translate_capacitor(element: Element) -> Iterable[Item]:
    """Translate a capacitor with its parasitics."""
    settings = element.settings
    if "q" in settings or any(word.lower().startswith("q=") for word in element.values):
        raise element.make_error(
            "a capacitor with a charge expression has no equivalent in ngspice",
            hint="write a constant capacitance in place of the expression",
        )
    return _expand_parasitics(element, settings, ("lser", "rlshunt"))


def _translate_voltage(element: Element) -> Iterable[Item]:
    """Translate a voltage source with the parasitics ``Rser`` and ``Cpar``."""
    if any(word.lower().startswith("wavefile") for word in element.values):
        raise element.make_error(
            "a source that reads a sound file has no equivalent in ngspice",
            hint="write the waveform as  PWL(TIME VALUE TIME VALUE …)",
        )
    return _expand_parasitics(element, element.settings, ())


def _expand_parasitics(
    element: Element, settings: Mapping[str, str], more: tuple[str, ...]
) -> Iterator[Element]:
    """Yield the element without parasitics, then an element for each parasitic."""
    parasitic = ("rser", "rpar", "cpar", *more)
    values = {name: value for name in parasitic if not _is_zero(value := settings.get(name, "0"))}
    parameters = {k: v for k, v in element.parameters.items() if k.lower() not in parasitic}
    plus, minus = element.nodes
    inner = plus
    series: list[Element] = []
    if "rser" in values:
        inner = f"{element.name}_inner"
        series.append(
            _make_parallel_element(element, f"R{element.name}_ser", plus, inner, values["rser"])
        )
    if "lser" in values:
        before, inner = inner, f"{element.name}_core"
        series.append(
            _make_parallel_element(element, f"L{element.name}_ser", before, inner, values["lser"])
        )
        if "rlshunt" in values:
            shunt = f"R{element.name}_shunt"
            series.append(_make_parallel_element(element, shunt, before, inner, values["rlshunt"]))
    yield replace(element, nodes=(inner, minus), parameters=parameters)
    yield from series
    for name in ("rpar", "cpar"):
        if name in values:
            card = f"{name[0].upper()}{element.name}_par"
            yield _make_parallel_element(element, card, plus, minus, values[name])


def _is_zero(text: str) -> bool:
    """Return whether a text is the number zero."""
    return parse_literal(text) == 0


def _translate_ideal_diode(element: Element, model: Mapping[str, str]) -> Element:
    """Translate an ideal diode to a current source.

    The smooth ramp ``r(x, e)`` is zero for negative x, ``x^2 / (2 e)`` for x below e, and ``x -
    e/2`` for larger x. The current of the diode at the voltage v is ``i = goff v + (gon - goff) r(v
    - Vfwd, Epsilon) - (grev - goff) r(-v - Vrev, RevEpsilon)``. A positive current i is limited to
    ``Ilimit tanh(i / Ilimit)``, and a negative current is limited in the same way with
    ``RevIlimit``. There are ``m`` diodes in parallel and ``n`` diodes in series.
    """
    unknown = {*element.settings} - {"m", "n", "temp", "l", "w"}
    if unknown:
        raise element.make_error(
            f"an ideal diode has no parameter {', '.join(sorted(unknown))}",
            hint=f"delete {', '.join(sorted(unknown))} from this line",
        )

    def format_parameter(name: str, default: str = "0") -> str:
        """Return a model parameter or its default as text in parentheses."""
        return f"({model.get(name, default).strip('{}')})"

    off, count = format_parameter("roff", f"{{1/{MIN_CONDUCTANCE}}}"), element.settings
    volts = f"V({','.join(element.nodes)})"
    if "n" in count:
        volts = f"({volts}/({count['n'].strip('{}')}))"
    forward = _write_ramp(f"{volts}-{format_parameter('vfwd')}", model, "epsilon")
    current = f"{volts}/{off}+(1/{format_parameter('ron', '1')}-1/{off})*{forward}"
    if "vrev" in model:
        reverse = _write_ramp(f"-{volts}-abs({format_parameter('vrev')})", model, "revepsilon")
        current += f"-(1/{format_parameter('rrev', model.get('ron', '1'))}-1/{off})*{reverse}"
    ends = []
    for name, sign in (("ilimit", "max"), ("revilimit", "min")):
        part = f"{sign}({current}, 0)"
        ends.append(
            f"{format_parameter(name)}*tanh({part}/{format_parameter(name)})"
            if name in model
            else part
        )
    if "ilimit" in model or "revilimit" in model:
        current = "+".join(ends)
    if "m" in count:
        current = f"({count['m'].strip('{}')})*({current})"
    law = ExpressionWriter().write_tree(parse_expression(current, where=element.where))
    return replace(
        element, kind="b", name=f"B{element.name}", model="", values=(), parameters={},
        quantity="I", expression=law,
    )  # fmt: skip


def _translate_gradual_switch(element: Element, model: Mapping[str, str]) -> Element:
    """Translate a PSpice switch with a smooth transition of its resistance.

    The resistance is ``R = Roff exp(-ln(Roff / Ron) u^2 (3 - 2 u))``. The variable ``u`` rises
    linearly from 0 at ``Voff`` to 1 at ``Von`` (PSpice reference guide, voltage-controlled switch;
    the terms of its formula are combined).
    """
    if element.kind == "s":
        control, on, off, default = f"V({','.join(element.nodes[2:])})", "von", "voff", "1"
    else:
        control, on, off, default = f"I({element.sources[0]})", "ion", "ioff", "1m"

    def format_parameter(name: str, default: str) -> str:
        """Return a model parameter or its default as text in parentheses."""
        return f"({model.get(name, default).strip('{}')})"

    high, low = format_parameter(on, default), format_parameter(off, "0")
    opened, closed = format_parameter("roff", "1Meg"), format_parameter("ron", "1")
    share = f"min(max(({control}-{low})/({high}-{low}), 0), 1)"
    plus, minus = element.nodes[:2]
    law = f"V({plus},{minus})/{opened}*exp(ln({opened}/{closed})*{share}*{share}*(3-2*{share}))"
    return _make_source(
        element, "I", ExpressionWriter().write_tree(parse_expression(law, where=element.where))
    )


def _make_source(element: Element, quantity: str, law: str) -> Element:
    """Return a behavioural source between the first two nodes of an element."""
    plus, minus = element.nodes[:2]
    source = Element.behavioural_source(f"B{element.name}", plus, minus, quantity, law)
    return replace(source, notes=element.notes, where=element.where, written=element.written)


def _read_table_points(element: Element) -> str:
    """Return the points of an LTspice ``table=(x, y, ...)``; empty without a table."""
    text = element.settings.get("table", "")
    for word in element.values:
        text = word[len("table") :] if word.lower().startswith("table(") else text
    return ", ".join(_NUMBER_IN_TABLE.findall(text))


def _write_ramp(excess: str, model: Mapping[str, str], width: str) -> str:
    """Return the expression of a smooth ramp: zero, then a parabola, then slope 1."""
    text = model.get(width, "0")
    if _is_zero(text):
        return f"max({excess}, 0)"
    text = f"({text.strip('{}')})"
    inside = f"min(max({excess}, 0), {text})"
    return f"({inside}*{inside}/(2*{text})+max({excess}-{text}, 0))"


def _get_model_parameters(model: ModelCard) -> dict[str, str]:
    """Return the parameters of a model, keyed by names in lower case."""
    return {key.lower(): text for key, text in model.parameters.items()}


def _require_simple_switch(model: ModelCard) -> None:
    """Reject settings of a switch model that have no equivalent in ngspice."""
    words = _get_model_parameters(model)
    name = "vh" if model.type.lower() == "sw" else "ih"
    width = parse_literal(words.get(name, "0"), where=model.where)
    if width is not None and width < 0:
        got = f"{name}={words[name]}"
        raise model.make_error(
            "a switch that opens gradually has no equivalent in ngspice",
            got,
            hint=f"write  {name}=0",
        )
    extra = words.keys() & {"lser", "vser", "ilimit", "level", "epsilon", "oneway"}
    if extra:
        problem = f"{', '.join(sorted(extra))} of a switch has no equivalent in ngspice"
        raise model.make_error(problem, hint=f"delete {', '.join(sorted(extra))} from this line")


# --- numbers and expressions ----------------------------------------------------------------------


def _split_settings(law: str) -> tuple[str, dict[str, str]]:
    """Split a text into an expression and a mapping of settings ``name=value``."""
    starts = list(_SETTING.finditer(law))
    if not starts:
        return law, {}
    ends = [*(match.start() for match in starts[1:]), len(law)]
    settings = {
        match[1].lower(): law[match.end() : end].strip()
        for match, end in zip(starts, ends, strict=True)
    }
    return law[: starts[0].start()], settings


class _ExpressionTranslator:
    """Translator of the expressions of one card."""

    def __init__(self, card: Card, scope: _CircuitTranslator) -> None:
        self.card, self.scope = card, scope

    def translate(self, text: str) -> str:
        """Translate an expression to ngspice.

        Raises
        ------
        UsageError : ngspice has no equivalent of a function or an operator.
        """
        if "^" in text and self.scope.syntax == "ltspice":
            message = "LTspice reads ^ as exclusive or, PSpice and ngspice as a power"
            raise self.card.make_error(
                message, text[:80], "** for a power", "write ** in place of ^, if you mean a power"
            )
        text = re.sub(r"(?<!&)&(?!&)", "&&", re.sub(r"(?<!\|)\|(?!\|)", "||", text))
        text = text.replace("~", "!").translate(_MICRO)
        return ExpressionWriter().write_tree(
            self.translate_tree(parse_expression(text, where=self.card.where))
        )

    def translate_tree(self, tree: Tree) -> Tree:
        """Translate an expression tree to ngspice, operands first."""
        tree = map_operands(tree, self.translate_tree)
        match tree:
            case FunctionCall(function, arguments):
                return self._translate_call(function, arguments)
            case ConditionalExpression(test, yes, no):
                return ConditionalExpression(_translate_condition(test), yes, no)
            case UnaryOperation("!", inner):
                return ConditionalExpression(_translate_condition(inner), Number("0"), Number("1"))
            case BinaryOperation(op, left, right) if op in _LOGICAL_OPERATORS:
                return ConditionalExpression(
                    BinaryOperation(op, _translate_condition(left), _translate_condition(right)),
                    Number("1"),
                    Number("0"),
                )
            case BinaryOperation("^", base, power):
                return self._translate_power(base, power)
            case CircuitVariable("i", (name,)):
                return CircuitVariable("i", (self._find_meter(name),))
        return tree

    def _find_meter(self, name: str) -> str:
        """Return the name of the source whose current is the current of an element."""
        element = self.scope.elements.get(name.lower())
        if element is None or element.kind not in _METERED_KINDS:
            return name
        settings = _split_settings(element.expression)[1] | element.settings
        is_branch = element.kind in "vleh" or element.quantity == "V"
        # ngspice itself provides the current of an element with a branch current
        if is_branch and not settings.keys() & _PARALLEL_PARASITICS:
            return name
        return self.scope.metered.setdefault(element.key, f"V{element.name}_meter")

    def _translate_call(self, function: str, arguments: tuple[Tree, ...]) -> Tree:
        """Translate a function call to an ngspice expression tree."""
        # a ``.func`` of the user replaces the built-in function
        if function in self.scope.functions:
            return FunctionCall(function, arguments)
        if reason := _UNSUPPORTED_FUNCTIONS.get(function):
            got = ExpressionWriter().write_tree(FunctionCall(function, arguments))
            hint = f"replace {function}(…) by an expression that does not use {function}"
            raise self.card.make_error(
                f"{reason} has no equivalent in ngspice", got[:80], hint=hint
            )
        rule = _FUNCTION_RULES.get((function, len(arguments))) or _FUNCTION_RULES.get(
            (function, -1)
        )
        return FunctionCall(function, arguments) if rule is None else rule(*arguments)

    def _translate_power(self, base: Tree, power: Tree) -> Tree:
        """Translate ``base ** power``; ngspice would use the absolute value of the base."""
        exponent = float(power.text) if isinstance(power, Number) else None
        if (
            exponent is not None
            and exponent == int(exponent)
            and 0 < exponent <= _MAX_PRODUCT_POWER
        ):
            if exponent % 2 == 0:
                return BinaryOperation("^", base, power)
            even = Number(str(int(exponent) - 1))
            return (
                base
                if exponent == 1
                else BinaryOperation("*", base, BinaryOperation("^", base, even))
            )
        if _is_non_negative(base):
            return BinaryOperation("^", base, power)
        problem = "a power with a base that can be negative has a different value in ngspice"
        expected = "abs(…) around the base, or a whole number as exponent"
        raise self.card.make_error(
            problem,
            ExpressionWriter().write_tree(BinaryOperation("^", base, power))[:80],
            expected,
            "write abs(…) around the base",
        )


def _is_non_negative(tree: Tree) -> bool:
    """Return whether an expression can be assumed to be non-negative.

    Numbers, parameters, and functions without negative values count as non-negative.
    """
    return isinstance(tree, Number | Name) or (
        isinstance(tree, FunctionCall)
        and tree.function in ("abs", "cosh", "exp", "hypot", "sqrt", "uramp")
    )


def _translate_condition(tree: Tree) -> Tree:
    """Translate a condition, which LTspice treats as true if it is above one half."""
    compared = isinstance(tree, BinaryOperation) and tree.op in (*_COMPARISONS, *_LOGICAL_OPERATORS)
    return tree if compared else BinaryOperation(">", tree, Number("0.5"))


def _translate_limit(x: Tree, a: Tree, b: Tree) -> Tree:
    """Translate ``limit(x, a, b)``, which is the median of its three arguments."""
    low, high = FunctionCall("min", (a, b)), FunctionCall("max", (a, b))
    return FunctionCall("min", (FunctionCall("max", (x, low)), high))


def _translate_table(x: Tree, *points: Tree) -> Tree:
    """Translate a table to a piecewise linear function, constant beyond its ends.

    The function is ``y1 + sum((y[k+1] - y[k]) share[k])``, where ``share[k]`` is the fraction of
    the interval k below ``x``.
    """
    result = points[1]
    ends = list(zip(points[::2], points[1::2], strict=False))
    for (left, low), (right, high) in pairwise(ends):
        rise, width = BinaryOperation("-", high, low), BinaryOperation("-", right, left)
        inside = FunctionCall("min", (FunctionCall("max", (x, left)), right))
        share = BinaryOperation("/", BinaryOperation("-", inside, left), width)
        result = BinaryOperation("+", result, BinaryOperation("*", rise, share))
    return result


def _translate_signed_power(x: Tree, power: Tree) -> Tree:
    """Translate ``pwrs``: the power of the magnitude of ``x``, with the sign of ``x``."""
    return BinaryOperation(
        "*", FunctionCall("sgn", (x,)), BinaryOperation("^", FunctionCall("abs", (x,)), power)
    )


def _translate_whole_part(x: Tree) -> Tree:
    """Translate ``int``, which rounds a value towards zero."""
    return BinaryOperation(
        "*", FunctionCall("sgn", (x,)), FunctionCall("floor", (FunctionCall("abs", (x,)),))
    )


def _translate_hypot(x: Tree, y: Tree) -> Tree:
    """Translate ``hypot``, the square root of a sum of squares."""
    return FunctionCall(
        "sqrt", (BinaryOperation("+", BinaryOperation("*", x, x), BinaryOperation("*", y, y)),)
    )


def _translate_square(x: Tree) -> Tree:
    """Translate ``square(x)``."""
    return BinaryOperation("*", x, x)


def _translate_inverter(x: Tree) -> Tree:
    """Translate ``inv(x)``: 0 if the condition ``x`` is true, otherwise 1."""
    return ConditionalExpression(_translate_condition(x), Number("0"), Number("1"))


def _translate_buffer(x: Tree) -> Tree:
    """Translate ``buf(x)``: 1 if the condition ``x`` is true, otherwise 0."""
    return ConditionalExpression(_translate_condition(x), Number("1"), Number("0"))


_FUNCTION_RULES: dict[tuple[str, int], Callable[..., Tree]] = {
    ("if", 3): lambda test, yes, no: ConditionalExpression(_translate_condition(test), yes, no),
    ("limit", 3): _translate_limit,
    ("table", -1): _translate_table,
    ("pwr", 2): lambda x, power: BinaryOperation("^", FunctionCall("abs", (x,)), power),
    ("pwrs", 2): _translate_signed_power,
    ("int", 1): _translate_whole_part,
    ("round", 1): lambda x: FunctionCall("nint", (x,)),
    ("hypot", 2): _translate_hypot,
    ("sqr", 1): _translate_square,
    ("square", 1): _translate_square,
    ("buf", 1): _translate_buffer,
    ("inv", 1): _translate_inverter,
    ("log", 1): lambda x: FunctionCall("ln", (x,)),
    ("sign", 1): lambda x: FunctionCall("sgn", (x,)),
    ("stp", 1): lambda x: FunctionCall("u", (x,)),
    ("arctan", 1): lambda x: FunctionCall("atan", (x,)),
    ("arcsin", 1): lambda x: FunctionCall("asin", (x,)),
    ("arccos", 1): lambda x: FunctionCall("acos", (x,)),
}
