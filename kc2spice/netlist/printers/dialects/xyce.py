"""Dialect of the simulator Xyce (Sandia National Laboratories)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import filterfalse

from kc2spice.netlist.circuit import Directive, Element
from kc2spice.netlist.deck import Deck
from kc2spice.netlist.expression import Number, Tree, parse_literal
from kc2spice.netlist.name_scopes import GROUND_NAMES
from kc2spice.netlist.number_and_name_spelling import format_number, format_rounded
from kc2spice.netlist.printers.dialect import COMMON, Dialect
from kc2spice.netlist.printers.dialect_registry import register_dialect

LOOP_TIME_STEP = 1e-6  # largest time step [s] if a controller may close a feedback loop
# Largest ``reltol`` for Xyce.
# For Xyce, ``reltol`` is the smaller of MAX_RELTOL and a tenth of the ``reltol`` of ngspice.
# With a larger ``reltol``, Xyce computes contacts with relative errors above 1e-5.
MAX_RELTOL = 1e-5
# Half the width [V] of a switch's transition around its threshold. In Xyce, a switch needs a
# transition.
SWITCH_BAND = 1e-3


# name of the independent variable on measurement cards
_SCALE_NAMES = {"tran": "TIME", "ac": "FREQ"}


@register_dialect
class Xyce(Dialect):
    """Dialect of the simulator Xyce.

    Xyce 7.5 differentiates ``uramp`` without the chain rule, so ``uramp`` is replaced by another
    expression. Of several cards ``.options timeint``, Xyce uses only the last card.
    """

    dialect = "xyce"
    title = "Xyce"
    command = "Xyce"
    keyword = "PARAMS:"
    option_prefix = ".options timeint"
    known_options = frozenset({"reltol", "abstol", "method"})
    joined = frozenset({".save", ".options"})  # Xyce uses only the last ``.options timeint`` card
    functions = COMMON - {"uramp"}
    rewritten = Dialect.rewritten | {"uramp"}
    temperature = "TEMP"
    measure_keyword = ".measure"

    def write_call(self, function: str, arguments: tuple[Tree, ...]) -> str:
        """Return a function call; ``max(0, x)`` replaces ``uramp(x)``."""
        if function == "uramp":
            return super().write_call("max", (Number("0"), *arguments))
        return super().write_call(function, arguments)

    def format_element(self, part: Element) -> str:
        """Return the card of an element, with ``IC=`` only in an analysis with ``uic``.

        Without ``uic``, ngspice ignores ``IC=``, but Xyce does not.
        """
        if not _starts_from_initial_states(self.analysis) and part.kind in "cl":
            parameters = {k: v for k, v in part.parameters.items() if k.lower() != "ic"}
            part = replace(part, parameters=parameters)
        return super().format_element(part)

    def directive(self, card: Directive) -> str:
        """Return a dot card with which Xyce has the same results as ngspice.

        The card extends a logarithmic frequency range to the first frequency point at or above the
        stated end, because Xyce would otherwise omit this point. If a controller may close a
        feedback loop, the card limits the time steps. With unlimited time steps, Xyce computed the
        launch velocity of a sphere with a relative error of 5e-4.
        """
        if card.keyword == ".tran":
            nodes = (
                _list_nodes_with_initial_state(self.deck)
                if self.deck and not _starts_from_initial_states(card)
                else ()
            )
            guesses = " ".join(map("V({})=0".format, dict.fromkeys(nodes)))
            return (f".nodeset {guesses}\n" if guesses else "") + self._limit_steps(card)
        if card.keyword != ".ac" or not card.words:
            return card.text
        numbers = [parse_literal(word, where=card.where) for word in card.words[1:]]
        per = {"dec": 10.0, "oct": 2.0}.get(card.words[0].lower())
        if per is None or len(numbers) != 3 or None in numbers:
            return card.text
        count, start, stop = (float(value or 0.0) for value in numbers)
        steps = math.ceil(count * math.log(stop / start, per) - 1e-6)
        beyond = start * per ** ((steps + 1e-6) / count)  # 1e-6 compensates rounding errors
        return " ".join([card.keyword, *card.words[:3], format_number(beyond)])

    def format_options(self, words: Sequence[str]) -> str:
        """Return the card of the options, with the smaller ``reltol`` that Xyce needs."""
        timed = self.analysis.keyword == ".tran"
        return super().format_options([*map(_tighten_reltol, words)] if timed else words)

    def _limit_steps(self, card: Directive) -> str:
        """Limit the time step of a transient card if the circuit may have a feedback loop."""
        if self.deck and not self.deck.may_have_loop:
            return card.text
        words = [w for w in card.words if w.lower() == "uic"]
        numbers = [w for w in card.words if w not in words]
        step, stop, start, ceiling = [
            *numbers,
            *["0", format_number(LOOP_TIME_STEP)][len(numbers) - 2 :],
        ]
        largest = parse_literal(ceiling, where=card.where)
        if largest is None or largest > LOOP_TIME_STEP:
            ceiling = format_number(LOOP_TIME_STEP)
        return " ".join([card.keyword, step, stop, start, ceiling, *words])

    def format_law(self, part: Element) -> str:
        """Format the law of a behavioural source as an expression in braces."""
        quantity = part.quantity if part.kind == "b" else "value"
        return f"{quantity}={{{self.write_tree(part.law)}}}"

    def format_derived_measure(self, kind: str, name: str, expression: str) -> str:
        """Return the card of a measurement that is an expression of other measurements."""
        return f"{self.measure_keyword} {kind.upper()} {name} EQN {{{expression}}}"

    def format_magnitude(self, vector: str) -> str:
        """Return the Xyce expression for the magnitude of a complex vector."""
        return f"VM{vector.removeprefix('V')}"

    def format_real_part(self, vector: str) -> str:
        """Return the text for the real part of a complex vector."""
        return f"{vector[0]}R{vector[1:]}"

    def locate_extreme(self, extreme: str, vector: str, kind: str) -> tuple[str, ...]:
        """Return the words of a measurement card that locate an extremum.

        For a dc sweep, the result is empty, because Xyce would print a scaled position.
        """
        return (extreme, vector, f"OUTPUT={_SCALE_NAMES[kind]}") if kind in _SCALE_NAMES else ()

    def save(self, vectors: list[str]) -> str:
        """Return the ``.print`` card, which selects the vectors that a run saves.

        Xyce writes these vectors to the raw file.
        """
        kind = self.analysis.keyword.removeprefix(".").upper()
        return "\n+ ".join([f".print {kind} format=raw", *vectors])

    def switch(self, name: str, values: Mapping[str, str]) -> str:
        """Return the card of a switch model; in Xyce, ``VON`` must differ from ``VOFF``.

        Xyce has no hysteresis.
        """
        parameters = " ".join(f"{key.upper()}={value}" for key, value in values.items())
        band = parse_literal(values.get("vh", "0"), where=self.where)
        middle = parse_literal(values.get("vt", "0"), where=self.where)
        if band != 0.0:
            raise self.make_unsupported_error(parameters, "a switch with hysteresis")
        if middle is None:
            raise self.make_unsupported_error(
                parameters, "a switch whose threshold is an expression"
            )
        return (
            f".model {name} VSWITCH(VON={format_number(middle + SWITCH_BAND)} "
            f"VOFF={format_number(middle - SWITCH_BAND)} "
            f"RON={values.get('ron', '1')} ROFF={values.get('roff', '1e12')})"
        )


def _starts_from_initial_states(card: Directive) -> bool:
    """Return whether an analysis starts from initial states (``uic``)."""
    return card.keyword == ".tran" and "uic" in map(str.lower, card.words)


def _list_nodes_with_initial_state(deck: Deck) -> Iterator[str]:
    """Yield the instance nodes to which an element with an initial state is connected."""
    for instance in deck.scope.select_elements("x").values():
        called = deck.scope.find_subcircuit(instance.model)
        if called is None:
            continue
        joined = dict(zip(called.pins, instance.lower_case_nodes, strict=False))
        for part in called.elements:
            outer = map(joined.get, part.lower_case_nodes if "ic" in part.settings else ())
            yield from filterfalse(GROUND_NAMES.__contains__, filter(None, outer))


def _tighten_reltol(word: str) -> str:
    """Tighten the option ``reltol`` for Xyce; return all other options unchanged."""
    name, _, value = word.partition("=")
    if name.lower() != "reltol":
        return word
    reltol = parse_literal(value, where="reltol")
    return (
        f"{name}={format_rounded(MAX_RELTOL if reltol is None else min(reltol / 10, MAX_RELTOL))}"
    )
