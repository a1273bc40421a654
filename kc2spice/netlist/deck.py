"""Decks (main netlist files) as data: instances, options, analysis and results."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain
from operator import attrgetter, itemgetter
from typing import Any, ClassVar

from kc2spice.core.attribute_advice import WRITING_METHODS, AdvisesOnAttributes
from kc2spice.core.domains import describe_units
from kc2spice.core.errors import UsageError
from kc2spice.netlist.card_parser import OPTION_CARDS, read_cards
from kc2spice.netlist.circuit import Circuit, Directive, Element, Item, select_items
from kc2spice.netlist.expression import parse_literal, split_terms
from kc2spice.netlist.name_scopes import Scope
from kc2spice.netlist.name_scopes import build_scope as scoped
from kc2spice.netlist.number_and_name_spelling import format_comment, format_number, format_rounded
from kc2spice.netlist.power_waveforms import PowerTerm
from kc2spice.netlist.printers.ngspice import Printer, locate_cards
from kc2spice.netlist.shared_cards import Line, attach_comments
from kc2spice.netlist.subcircuit_library import Subcircuit

ANALYSES = frozenset((".tran", ".ac", ".dc", ".op", ".noise"))


@dataclass(frozen=True)
class Option:
    """Simulator option on an ``.options`` card, with the reason for its value.

    A flag has an empty ``value``.
    """

    key: str
    value: str | float
    reason: str

    @property
    def text(self) -> str:
        """Text of the value on the ``.options`` card."""
        if isinstance(self.value, str):
            return self.value
        return format_rounded(self.value).removesuffix(".0")

    @property
    def card(self) -> Directive:
        """``.options`` card of the option, below a comment with the reason."""
        word = f"{self.key}={self.text}" if self.text else self.key
        return Directive(
            ".options", (word,), notes=(f"* {self.key}: {format_comment(self.reason)}",)
        )


# default options of ngspice
RELTOL = 1e-3
CHGTOL = 1e-14
# V or A, smallest step of a dc sweep; ngspice detects the end of a sweep to within 2.2e-13 V or A
SMALLEST_SWEEP_STEP = 1e-12
MAX_POINTS_PER_DECADE = 2**31 - 1  # simulators store the number of points per decade in 32 bits


@dataclass(frozen=True)
class AnalysisCommand:
    """Analysis command: the kind of analysis, and the following words on the card."""

    kind: str
    words: tuple[str, ...]

    @property
    def card(self) -> str:
        """Text of the analysis card, such as ``.tran``."""
        return self.directive.text

    @property
    def directive(self) -> Directive:
        """SPICE directive of the analysis, such as ``.tran 1u 1m``."""
        return Directive(f".{self.kind}", self.words)


@dataclass(frozen=True)
class MeasureCard:
    """``.meas`` card for one kind of analysis, with a conversion factor to SI units.

    The ``words`` follow the name of the measurement. For an ``op`` analysis, no ``.meas`` card is
    written. The ``words`` of an ``op`` measurement contain only the name of the vector that the
    deck prints.
    """

    name: str
    kind: str
    words: tuple[str, ...]
    factor: float = 1.0

    @property
    def cards(self) -> Iterator[Directive]:
        """``.meas`` card, followed if necessary by a card that converts to SI units."""
        if self.kind == "op":
            return
        if self.factor == 1.0:
            yield Directive(".meas", (self.kind, self.name, *self.words))
            return
        plain = f"{self.name}_raw"
        scaled = f"param='{format_number(self.factor)}*{plain}'"
        yield Directive(".meas", (self.kind, plain, *self.words))
        yield Directive(".meas", (self.kind, self.name, scaled))


def make_transient_command(stop: float, max_step: float, *, uic: bool) -> AnalysisCommand:
    """Return a ``.tran`` command with an end time [s] and a step limit [s]."""
    step = min(max_step, stop / 1000)
    words = (format_rounded(step), format_number(stop), "0", format_rounded(max_step))
    return AnalysisCommand("tran", (*words, "uic") if uic else words)


def make_ac_command(start: float, stop: float, points: int, scale: str) -> AnalysisCommand:
    """Return an ``.ac`` command for a range of frequencies [Hz]."""
    return AnalysisCommand("ac", _format_range(start, stop, points, scale))


def make_noise_command(
    output: str, source: str, start: float, stop: float, points: int, scale: str
) -> AnalysisCommand:
    """Return a ``.noise`` command for an output voltage.

    The frequencies are the same as for :func:`make_ac_command`. At each frequency, the simulator
    computes the noise of each device. The equivalent input noise is referred to the source with the
    name ``source``.
    """
    return AnalysisCommand(
        "noise", (output, source, *_format_range(start, stop, points, scale), "1")
    )


def _format_range(start: float, stop: float, points: int, scale: str) -> tuple[str, ...]:
    """Return the words that state a frequency range on an analysis card."""
    decades = 0.0 if scale == "linear" else math.log10(stop / start)
    if points > MAX_POINTS_PER_DECADE * decades:  # linear spacing in a narrow range
        return "lin", str(points), format_number(start), format_number(stop)
    return "dec", str(math.ceil(points / decades)), format_number(start), format_number(stop)


def with_frequencies(
    command: AnalysisCommand, start: float, stop: float, points: int
) -> AnalysisCommand:
    """Return a small-signal command with other, equally spaced frequencies [Hz]."""
    reference = command.words[:2] if command.kind == "noise" else ()
    last = command.words[6:] if command.kind == "noise" else ()
    words = (*reference, *_format_range(start, stop, points, "linear"), *last)
    return AnalysisCommand(command.kind, words)


def make_dc_command(source: str, first: float, last: float, points: int) -> AnalysisCommand:
    """Return a ``.dc`` command that sweeps the value of a source.

    The limits ``first`` and ``last`` are in the unit of the source (V or A). The command states an
    end that is a quarter of a step beyond ``last``. If the end were exactly ``last``, accumulated
    rounding errors of the simulator could omit the last point.

    Raises
    ------
    UsageError : the step is so small that ngspice would continue beyond the end of the range.
    """
    step = (last - first) / (points - 1)
    if abs(step) < SMALLEST_SWEEP_STEP:
        raise UsageError(
            "the steps of this dc sweep are too small for ngspice",
            where=source,
            got=f"{step:g}",
            expected=f"at least {SMALLEST_SWEEP_STEP:g} in the source's unit",
            hint="write fewer points or a wider range",
        )
    return AnalysisCommand(
        "dc", (source, format_number(first), format_number(last + step / 4), format_number(step))
    )


@dataclass(frozen=True, kw_only=True, repr=False)
class Deck(AdvisesOnAttributes):
    """Deck (main netlist file) of a simulation, with its libraries.

    ``parts`` are the subcircuits, each in a library file. ``vectors`` maps the name of each result
    to an ngspice expression and to the factor that converts the expression to SI units. ``units``
    contains the SI unit of each result. ``powers`` maps the name of each computed power [W] to the
    terms whose sum is the power.

    In a transient, ``stop`` is the last time point [s] and ``max_step`` the largest time step [s].
    ``step_reason`` is the reason for the largest time step, unless the user has chosen the step.
    ``refinements`` are further analyses of the same kind as ``command``. The frequency points of
    the analyses ``command`` and ``refinements`` are merged. In a dc analysis, ``sweep_scale`` volts
    or amperes of the source correspond to one SI unit of the swept key. ``measures`` are
    measurements that the simulator evaluates and prints, for users who save no raw file.

    If the user has written the deck, ``text`` is the text of the deck, ``tree`` its syntax tree if
    known, and ``more`` contains the included files. If ``may_have_loop`` is true, a controller may
    close a feedback loop, for which some simulators need short time steps. If a simulator ignores
    or replaces statements of a ``trusted`` deck, a run prints a warning instead of an error. Nets
    in ``free_nets`` may have only one connection. ``edits`` are short descriptions of the cards by
    which an edited deck differs from the deck of its scene.
    """

    _attribute_advice: ClassVar[Mapping[str, str]] = {
        **dict.fromkeys(
            WRITING_METHODS, 'kc.export(SCENE, "DIRECTORY") writes the deck of a scene'
        ),
        **dict.fromkeys(("run", "simulate", "plot"), "kc.simulate(DECK) returns the results"),
    }

    name: str
    title: str = ""
    notes: tuple[str, ...] = ()
    parts: tuple[Subcircuit, ...] = ()
    items: tuple[Item, ...] = ()
    options: tuple[Option, ...] = ()
    command: AnalysisCommand = AnalysisCommand("op", ())
    vectors: Mapping[str, tuple[str, float]] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    powers: Mapping[str, tuple[PowerTerm, ...]] = field(default_factory=dict)
    measures: tuple[MeasureCard, ...] = ()
    stop: float | None = None
    max_step: float | None = None
    step_reason: str = ""
    initial_voltages: Mapping[str, float] = field(default_factory=dict)
    refinements: tuple[AnalysisCommand, ...] = ()
    sweep_scale: float = 1.0
    text: str | None = None
    tree: Circuit | None = field(default=None, compare=False)
    more: Mapping[str, str] = field(default_factory=dict)
    may_have_loop: bool = True
    trusted: bool = False
    free_nets: frozenset[str] = frozenset()
    edits: tuple[str, ...] = ()

    def __repr__(self) -> str:
        """Return a short description of the deck."""
        files = ", ".join(self.files)
        return (
            f"<Deck {self.name}: {self.command.card}; {files}; results {', '.join(self.vectors)}>"
        )

    @property
    def main_file_name(self) -> str:
        """Name of the file that the simulator reads."""
        return f"{self.name}.cir"

    @property
    def saved_vectors(self) -> tuple[str, ...]:
        """Names of the ngspice vectors of all results, without duplicates."""
        result = dict[str, None]()
        for expression, _ in self.vectors.values():
            result |= dict.fromkeys(map(itemgetter(1), split_terms(expression)))
        return tuple(result)

    @property
    def files(self) -> dict[str, str]:
        """Texts of the deck file and of its libraries, keyed by file name."""
        libraries = dict(map(attrgetter("filename", "text"), self.parts))
        return {self.main_file_name: self._main_file_text} | libraries | dict(self.more)

    @cached_property
    def circuit(self) -> Circuit:
        """Syntax tree of the deck's main file.

        Raises
        ------
        UsageError : an invalid card.
        """
        if self.text is None:
            return self.add_usage_comment(*self._usage_comment)
        return _insert_cards(self._parsed_text, [*self._option_cards, *self._refinement_cards])

    @cached_property
    def trees(self) -> dict[str, Circuit]:
        """Syntax trees of the deck file and of its libraries, keyed by file name.

        Raises
        ------
        UsageError : an invalid card.
        """
        more = {name: read_cards(text, name) for name, text in self.more.items()}
        libraries = dict(map(attrgetter("filename", "circuit"), self.parts))
        return {self.main_file_name: self.circuit} | libraries | more

    @cached_property
    def located_trees(self) -> Mapping[str, Circuit]:
        """Syntax trees in which each card has its line number in the written files."""
        libraries = dict(map(attrgetter("filename", "located_tree"), self.parts))
        main = (
            locate_cards(self.circuit, self.main_file_name) if self.text is None else self.circuit
        )
        return {**self.trees, **libraries, self.main_file_name: main}

    @cached_property
    def scope(self) -> Scope:
        """Scope of the complete circuit with all included files.

        Raises
        ------
        UsageError : a card is invalid, an included file is missing or includes itself, or a name
            has two definitions.
        """
        return scoped(self.circuit, self.trees, self.main_file_name)

    @cached_property
    def _parsed_text(self) -> Circuit:
        """Syntax tree of the netlist text that the user has written."""
        return self.tree or read_cards(self.text or "", self.main_file_name, title=True)

    @cached_property
    def _main_file_text(self) -> str:
        """Text of the deck's main file."""
        if self.text is not None and not self.options and not self.refinements:
            return self.text
        return Printer().format_file(self.circuit)

    @property
    def _usage_comment(self) -> tuple[str, ...]:
        """Comment with the commands that run the deck in ngspice."""
        raw, plot = f"{self.name}.raw {self.main_file_name}", f"{self.name}_plot.sp"
        return (
            f"* Run it with:  ngspice -b {self.main_file_name}  (prints results)",
            f"*           or  ngspice -b -r {raw}  (saves all vectors)",
            f"*           or  ngspice {plot}  (plots the main curves)",
        )

    def add_usage_comment(self, *usage: str) -> Circuit:
        """Return the syntax tree of the main file with a comment on how to run the file.

        For a deck that the user has written, the syntax tree is returned unchanged.
        """
        if self.text is not None:
            return self.circuit
        return Circuit(items=attach_comments(self._list_main_lines(usage)))

    def _list_main_lines(self, usage: Iterable[str]) -> Iterator[Line]:
        """Yield the lines of the deck's main file."""
        yield f"* {format_comment(self.title)}"
        yield from self.notes or ("",)
        yield from usage
        if units := describe_units(self._pin_units):
            yield f"* Units of the nodes: {units}."
        for part in self.parts:
            yield Directive(".include", (part.filename,))
        yield from self.items
        yield ""
        if self.initial_voltages:
            yield "* No part determines the initial voltages of these nodes."
            yield Directive(
                ".ic", tuple(f"v({n})={format_number(v)}" for n, v in self.initial_voltages.items())
            )
        yield from self._option_cards
        yield self.command.directive
        yield from self._refinement_cards
        for vector in self.saved_vectors:
            yield Directive(".save", (vector,))
        if self.command.kind == "noise":
            yield Directive(".save", ("onoise_total",))  # this vector is in the second ngspice plot
        yield from self._write_measures(
            "" if usage != self._usage_comment else ", which ngspice prints without -r"
        )
        yield from self._print_card_lines
        yield Directive(".end")

    @property
    def _option_cards(self) -> Iterator[Item]:
        """``.options`` cards of the deck."""
        return map(attrgetter("card"), self.options)

    @property
    def _refinement_cards(self) -> Iterator[Item]:
        """Cards of the further analyses, which refine the points of the main analysis."""
        return map(attrgetter("directive"), self.refinements)

    @property
    def _pin_units(self) -> set[str]:
        """Set of the units of all library pins and element values in the deck."""
        pins = chain.from_iterable(part.pins for part in self.parts)
        elements = select_items(self.items, Element)
        return set(map(attrgetter("unit"), chain(pins, elements)))

    @property
    def _available_measures(self) -> list[MeasureCard]:
        """Measurements that apply to the deck's kind of analysis."""
        return [measure for measure in self.measures if measure.kind == self.command.kind]

    def _write_measures(self, printed: str) -> Iterator[Line]:
        """Yield a title comment and the measurement cards that suit the analysis.

        The argument ``printed`` is the text at the end of the title comment.
        """
        cards = list(chain.from_iterable(map(attrgetter("cards"), self._available_measures)))
        if cards:
            yield f"* Main metrics in SI units{printed}"
        yield from cards

    @property
    def _print_card_lines(self) -> Iterator[Line]:
        """Lines of the ``.print`` card, below comments that state factors to SI units."""
        columns = []
        for row in self._available_measures if self.command.kind == "op" else ():
            yield f"* {row.name} in SI units is {format_number(row.factor)} times {row.words[0]}"
            columns.append(row.words[0])
        columns += self.saved_vectors[:2]
        yield Directive(".print", (self.command.kind, *dict.fromkeys(columns)))

    def with_command(self, command: AnalysisCommand) -> Deck:
        """Return a copy of the deck in which ``command`` replaces the analysis command.

        The returned deck has no ``refinements``, because these further analyses belong to the old
        command.
        """
        if self.text is None:
            return replace(self, command=command, refinements=())
        items = self._parsed_text.items
        at = _find_analysis(items)
        if at is None:
            return self
        analysis = replace(command.directive, notes=items[at].notes)
        tree = replace(self._parsed_text, items=(*items[:at], analysis, *items[at + 1 :]))
        return self._replace_tree(tree, command=command, refinements=())

    def read_option(self, key: str, default: float) -> float:
        """Return the value of a numeric option, which may be written with a scale factor."""
        text = self.find_option_text(key)
        value = parse_literal(text, where=self.main_file_name) if text else None
        return default if value is None else value

    @property
    def reltol(self) -> float:
        """Relative error limit of a time step (option ``reltol``)."""
        return self.read_option("reltol", RELTOL)

    @property
    def chgtol(self) -> float:
        """Limit of the charge error of a time step [C] (option ``chgtol``)."""
        return self.read_option("chgtol", CHGTOL)

    def find_option_text(self, key: str) -> str | None:
        """Return the text of an option's value; None if the deck does not set the option."""
        result = None
        for card in select_items(self.circuit.items, Directive):
            for word in card.words if card.keyword in OPTION_CARDS else ():
                name, _, value = word.partition("=")
                if name.lower() == key and value:
                    result = value  # the last value of a repeated option applies
        return result

    def with_results(self, vectors: Mapping[str, tuple[str, float]]) -> Deck:
        """Return the deck with additional saved results."""
        result = replace(self, vectors={**self.vectors, **vectors})
        if self.text is None or ".save" not in map(_get_keyword, self._parsed_text.items):
            return result
        card = Directive(".save", tuple(map(itemgetter(0), vectors.values())))
        return result._replace_tree(_insert_cards(self._parsed_text, [card]))

    def _replace_tree(self, tree: Circuit, **changes: Any) -> Deck:
        """Return the deck with another syntax tree of its main file."""
        return replace(self, tree=tree, text=Printer().format_file(tree), **changes)

    def with_options(self, options: Mapping[str, str], reason: str) -> Deck:
        """Return a copy of the deck with new values of some simulator options.

        ``reason`` is the reason for the new values, which the copy stores with each new option.
        """
        unchanged = tuple(option for option in self.options if option.key not in options)
        new = tuple(Option(key, value, reason) for key, value in options.items())
        return replace(self, options=unchanged + new)

    def scale_max_step(self, factor: float) -> Deck:
        """Return the deck with its largest time step multiplied by a factor."""
        if self.max_step is None:
            return self
        step, words = factor * self.max_step, list(self.command.words)
        words[3] = format_rounded(step)
        return replace(self, command=AnalysisCommand("tran", tuple(words)), max_step=step)


def _get_keyword(item: Item) -> str:
    """Return the keyword of a card that begins with a dot; empty for other items."""
    return item.keyword if isinstance(item, Directive) else ""


def _find_analysis(items: Sequence[Item]) -> int | None:
    """Return the index of the first analysis; None if the items contain no analysis."""
    return next((k for k, item in enumerate(items) if _get_keyword(item) in ANALYSES), None)


def _insert_cards(tree: Circuit, cards: Sequence[Item]) -> Circuit:
    """Return the syntax tree with cards inserted above its first analysis."""
    at = _find_analysis(tree.items)
    if at is None or not cards:
        return tree
    return replace(tree, items=(*tree.items[:at], *cards, *tree.items[at:]))
