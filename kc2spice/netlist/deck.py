"""A deck as data: instances, options, analysis, results. Its text is made once, from these."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

from kc2spice.core.errors import UsageError
from kc2spice.core.foreign import lines_of
from kc2spice.netlist.cards import comment, number, tidy
from kc2spice.netlist.circuit import Circuit
from kc2spice.netlist.expression import terms
from kc2spice.netlist.library import Subcircuit
from kc2spice.netlist.read import OPTION_CARDS, read, statements
from kc2spice.netlist.scope import Scope, circuit

ANALYSES = frozenset((".tran", ".ac", ".dc", ".op", ".noise"))


@dataclass(frozen=True)
class Block:
    """Cards that belong together, under a comment."""

    title: str
    cards: tuple[str, ...]


@dataclass(frozen=True)
class Option:
    """One ``.options`` entry (``value`` is ``""`` for a flag) and why it is there."""

    key: str
    value: str
    reason: str

    @property
    def card(self) -> str:
        """The card."""
        return f".options {self.key}={self.value}" if self.value else f".options {self.key}"


LEAST_STEP = 1e-12  # V or A of a dc sweep; ngspice ends it within 2.2e-13
MOST_A_DECADE = 2**31 - 1  # points, which simulators count in 32 bits


@dataclass(frozen=True)
class Command:
    """The analysis: its kind and the numbers of its card."""

    kind: str
    words: tuple[str, ...]

    @property
    def card(self) -> str:
        """The card."""
        return " ".join((f".{self.kind}", *self.words))


def transient(stop: float, max_step: float, *, uic: bool) -> Command:
    """``.tran`` to ``stop`` [s] in steps of ``max_step`` [s] at most."""
    step = min(max_step, stop / 1000)
    words = (tidy(step), number(stop), "0", tidy(max_step))
    return Command("tran", (*words, "uic") if uic else words)


def ac(start: float, stop: float, points: int, scale: str) -> Command:
    """``.ac`` at about ``points`` frequencies [Hz], equally spaced on a log or linear scale."""
    return Command("ac", _range(start, stop, points, scale))


def noise(output: str, source: str, start: float, stop: float, points: int, scale: str) -> Command:
    """``.noise`` of the voltage ``output`` at frequencies as :func:`ac` has them, each with what
    every device adds; the simulator asks for a ``source`` that it could refer the noise to."""
    return Command("noise", (output, source, *_range(start, stop, points, scale), "1"))


def _range(start: float, stop: float, points: int, scale: str) -> tuple[str, ...]:
    decades = 0.0 if scale == "linear" else math.log10(stop / start)
    if points > MOST_A_DECADE * decades:  # a range so narrow is linear
        return "lin", str(points), number(start), number(stop)
    return "dec", str(math.ceil(points / decades)), number(start), number(stop)


def over(command: Command, start: float, stop: float, points: int) -> Command:
    """A small-signal ``command`` at other frequencies [Hz], equally spaced from ``start``."""
    kept = command.words[:2] if command.kind == "noise" else ()
    last = command.words[6:] if command.kind == "noise" else ()
    words = (*kept, *_range(start, stop, points, "linear"), *last)
    return Command(command.kind, words)


def dc(source: str, first: float, last: float, points: int) -> Command:
    """``.dc`` of a source, in its own unit.

    The simulator adds step to step; a quarter of one beyond the end keeps rounding from losing the
    last point.

    Raises
    ------
    UsageError : a step within what ngspice takes for the end of the range, behind which it goes on.
    """
    step = (last - first) / (points - 1)
    if abs(step) < LEAST_STEP:
        got, expected = f"{step:g}", f"at least {LEAST_STEP:g} in the source's unit"
        raise UsageError("steps too small for ngspice", where=source, got=got, expected=expected)
    return Command("dc", (source, number(first), number(last + step / 4), number(step)))


@dataclass(frozen=True, kw_only=True, repr=False)
class Deck:
    """A testbench with its libraries.

    ``parts`` are the subcircuits, each one library file; ``vectors`` maps result names to ngspice
    expressions and the factor to SI, ``units`` to SI units, ``powers`` to the voltages and currents
    that they are sums of products of. ``stop`` is the last time point [s] of
    a transient, None otherwise. ``refinements`` are further analyses of the kind of ``command``,
    whose points join its own. A dc analysis sweeps its source in ``sweep_scale`` volts or amperes
    per SI unit of the swept key. A deck that somebody wrote by hand has its ``text`` and the files
    that it includes in ``more``. ``controlled`` says whether a controller closes a loop, which some
    simulators only follow in short steps; it may if that is unknown. A ``trusted`` deck runs with a
    warning where the simulator ignores or replaces something in it.
    """

    name: str
    title: str = ""
    notes: tuple[str, ...] = ()
    parts: tuple[Subcircuit, ...] = ()
    blocks: tuple[Block, ...] = ()
    options: tuple[Option, ...] = ()
    command: Command = Command("op", ())
    vectors: Mapping[str, tuple[str, float]] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    powers: Mapping[str, tuple[tuple[str, str], ...]] = field(default_factory=dict)
    stop: float | None = None
    initial: Mapping[str, float] = field(default_factory=dict)
    refinements: tuple[Command, ...] = ()
    sweep_scale: float = 1.0
    text: str | None = None
    more: Mapping[str, str] = field(default_factory=dict)
    controlled: bool = True
    trusted: bool = False

    def __repr__(self) -> str:
        files = ", ".join(self.files)
        return (
            f"<Deck {self.name}: {self.command.card}; {files}; results {', '.join(self.vectors)}>"
        )

    @property
    def main(self) -> str:
        """Name of the file that a simulator reads."""
        return f"{self.name}.cir"

    @property
    def saved(self) -> tuple[str, ...]:
        """The ngspice vectors of all results, each once."""
        result = [v for text, _ in self.vectors.values() for _, v in terms(text)]
        return tuple(dict.fromkeys(result))

    @property
    def files(self) -> dict[str, str]:
        """``{file name: text}`` of the deck and its libraries."""
        own = {part.filename: part.text for part in self.parts}
        return {self.main: self._main} | own | dict(self.more)

    @cached_property
    def trees(self) -> dict[str, Circuit]:
        """``{file name: tree}`` of the deck and its libraries, each read once.

        Raises
        ------
        UsageError : a broken card.
        """
        more = {name: read(text, name) for name, text in self.more.items()}
        own = {part.filename: part.located for part in self.parts}
        return {self.main: read(self._main, self.main, title=True)} | own | more

    @cached_property
    def scope(self) -> Scope:
        """The whole circuit, its includes followed.

        Raises
        ------
        UsageError : a broken card, a missing or circular include, a name defined twice.
        """
        return circuit(self.trees[self.main], self.trees, self.main)

    @cached_property
    def _main(self) -> str:
        if self.text is not None:
            cards = [option.card for option in self.options]
            cards += [command.card for command in self.refinements]
            return _inserted(self.text, "".join(f"{card}\n" for card in cards))
        return "\n".join([*self._head(), *self._cards(), ".end", ""])

    def _head(self) -> Iterator[str]:
        raw, plot = f"{self.name}.raw {self.main}", f"{self.name}_plot.sp"
        yield f"* {comment(self.title)}"
        yield from self.notes or ("",)
        yield f"* Run it with:  ngspice -b {self.main}             (prints what .print asks for)"
        yield f"*           or  ngspice -b -r {raw}  (keeps every vector saved below)"
        yield f"*           or  ngspice {plot}          (plots the main curves)"
        yield (
            "* Units of the nodes: 1 V = 1 um (displacements), 1 V = 1 m/s (velocities), "
            "1 A = 1 N (forces)."
        )

    def _cards(self) -> Iterator[str]:
        yield from (f".include {part.filename}" for part in self.parts)
        for block in self.blocks:
            yield from ("", f"* {comment(block.title)}", *block.cards)
        yield ""
        if self.initial:
            yield "* Nothing holds these nodes before the run begins."
            yield " ".join((".ic", *(f"v({n})={number(v)}" for n, v in self.initial.items())))
        for option in self.options:
            yield from (f"* {option.key}: {comment(option.reason)}", option.card)
        yield from (command.card for command in (self.command, *self.refinements))
        totals = (
            ("onoise_total",) if self.command.kind == "noise" else ()
        )  # vector of the second plot
        yield from (f".save {vector}" for vector in (*self.saved, *totals))
        yield " ".join((".print", self.command.kind, *self.saved[:2]))

    def with_command(self, command: Command) -> Deck:
        """The same deck with this analysis instead of its own and of its refinements."""
        if self.text is None:
            return replace(self, command=command, refinements=())
        at = next((s.line for s in statements(self.text, "") if s.keyword in ANALYSES), None)
        if at is None:
            return self
        lines = [f"{line}\n" for line in lines_of(self.text)]
        after = at
        while after < len(lines) and lines[after].startswith("+"):
            after += 1
        text = "".join([*lines[: at - 1], f"{command.card}\n", *lines[after:]])
        return replace(self, text=text, command=command, refinements=())

    def option(self, key: str) -> str | None:
        """The value of an option, None where the deck says nothing."""
        cards = (s for s in statements(self._main, self.main) if s.keyword in OPTION_CARDS)
        pairs = (word.partition("=") for s in cards for word in s.words[1:])
        result = [value for name, _, value in pairs if name.lower() == key and value]
        return result[-1] if result else None

    def saving(self, vectors: Mapping[str, tuple[str, float]]) -> Deck:
        """The same deck with these results besides its own."""
        more = replace(self, vectors={**self.vectors, **vectors})
        if self.text is None or ".save" not in (s.keyword for s in statements(self.text, "")):
            return more
        line = ".save " + " ".join(vector for vector, _ in vectors.values()) + "\n"
        return replace(more, text=_inserted(self.text, line))

    def with_options(self, options: Mapping[str, str], reason: str) -> Deck:
        """The same deck with these options instead of its own."""
        kept = tuple(option for option in self.options if option.key not in options)
        new = tuple(Option(key, value, reason) for key, value in options.items())
        return replace(self, options=kept + new)

    def with_steps(self, factor: float) -> Deck:
        """The same deck with its largest time step times ``factor``."""
        if self.command.kind != "tran" or len(self.command.words) < 4:
            return self
        words = list(self.command.words)
        words[3] = tidy(factor * float(words[3]))
        return replace(self, command=Command("tran", tuple(words)))


def retold(tree: Circuit, *usage: str) -> Circuit:
    """The tree of a main file whose head tells how another program runs it than ngspice."""
    if not tree.items:
        return tree
    first, *rest = tree.items
    kept = [line for line in first.notes if " ngspice " not in line]
    at = next((k for k, line in enumerate(first.notes) if line not in kept), None)
    if at is not None:
        kept[at:at] = usage
    return replace(tree, items=(replace(first, notes=tuple(kept)), *rest))


def _inserted(text: str, lines: str) -> str:
    at = next((s.line for s in statements(text, "") if s.keyword in ANALYSES), None)
    if at is None or not lines:
        return text
    kept = [f"{line}\n" for line in lines_of(text)]
    return "".join([*kept[: at - 1], lines, *kept[at - 1 :]])
