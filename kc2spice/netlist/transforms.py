"""Transformations of decks and libraries, such as copies with new parameters."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from typing import TypeVar

from kc2spice.core.errors import UsageError, unknown
from kc2spice.netlist.circuit import (
    SMALLEST_POSITIVE,
    Circuit,
    Element,
    Item,
    Param,
    key_by_lower_name,
)
from kc2spice.netlist.deck import Deck
from kc2spice.netlist.expression import join_terms, parse_literal, parse_vector, split_terms
from kc2spice.netlist.name_scopes import Scope
from kc2spice.netlist.number_and_name_spelling import format_number
from kc2spice.netlist.shared_cards import add_title
from kc2spice.netlist.subcircuit_library import (
    Subcircuit,
    write_instance_comment,
    write_parameter_line,
)

Parameters = tuple[tuple[str, float], ...]  # ("PART.NAME", value)
Value = TypeVar("Value")
MAX_COPIES = 10_000  # largest number of copies in an array deck
DIGITS = "0123456789"


def merge_helpers(part: Subcircuit, helpers: Iterable[Subcircuit]) -> Subcircuit:
    """Return ``part`` with the subcircuits ``helpers`` added to its library file.

    The merged subcircuits are named ``PART_HELPER``. As a result, a user includes only one library
    file, and two library files never define the same name.
    """
    tree = part.circuit
    for helper in helpers:
        name = f"{part.name}_{helper.name}"
        tree = rename_subcircuits(tree, {helper.name: name})
        items = list(rename_subcircuits(helper.circuit, {helper.name: name}).items)
        for k, item in enumerate(items):
            if isinstance(item, Circuit) and item.name == name:
                title = f"* {name}:{helper.title.partition(':')[2]}"
                head = ("", title, write_instance_comment(name, item.pins, item.defaults))
                items[k] = replace(item, notes=(*head, *item.notes[helper.header_lines :]))
        tree = replace(tree, items=(*tree.items, *items))
    return part.with_circuit(tree)


def rename_subcircuits(circuit: Circuit, names: Mapping[str, str]) -> Circuit:
    """Rename subcircuits of a circuit; ``names`` maps old names to new names."""
    new_names = key_by_lower_name(names)

    def replace_subcircuit_name(entry: Item) -> Item:
        """Replace the old name of a subcircuit by the new name in a netlist item."""
        if isinstance(entry, Circuit):
            return replace(entry, name=new_names.get(entry.name.lower(), entry.name))
        if isinstance(entry, Element) and entry.kind == "x":
            return replace(entry, model=new_names.get(entry.model.lower(), entry.model))
        return entry

    return circuit.map_items(replace_subcircuit_name)


# --- new values of the netlist parameters param.PART.NAME ---


def make_library_stem(part: Subcircuit) -> str:
    """Return the file name of a part's library, without suffix."""
    return part.filename.rpartition(".")[0] or part.filename


def list_parameterised_subcircuits(part: Subcircuit) -> Iterator[tuple[str, Circuit]]:
    """Yield pairs of a name and a parameterised subcircuit.

    In a key ``param.SUBCIRCUIT.PARAMETER``, the yielded name stands for ``SUBCIRCUIT``. The main
    subcircuit has the name of the library file. A helper subcircuit has the same name in all
    libraries, such as ``opamp`` for an amplifier.
    """
    for item in part.circuit.subcircuits:
        main = item.name.lower() == part.name.lower()
        yield (make_library_stem(part) if main else item.name.removeprefix(f"{part.name}_")), item


def list_parameter_defaults(deck: Deck) -> dict[str, float]:
    """Return the default value of each parameter, keyed by ``PART.NAME``.

    The default value of a parameter may have a SPICE suffix, as in ``3.3m``. If the default value
    is an expression, the result contains NaN.
    """
    result = {}
    for part in deck.parts:
        for library, item in list_parameterised_subcircuits(part):
            for name, text in item.defaults.items():
                value = None
                with contextlib.suppress(UsageError):  # the text is not an expression of ngspice
                    value = parse_literal(text.strip("{}' "), where=item.where)
                result[f"{library}.{name}"] = math.nan if value is None else value
    return result


def with_parameters(deck: Deck, values: Iterable[tuple[str, float]]) -> Deck:
    """Return a copy of ``deck`` in which parameters have new default values.

    ``values`` contains pairs ``("PART.NAME", value)``. The new values are also written into the
    headers of the libraries.

    Raises
    ------
    UsageError : no part of the deck has the parameter, or the value is outside of the parameter's
        range.
    """
    known, parts = list_parameter_defaults(deck), list(deck.parts)
    for key, value in values:
        if key not in known:
            raise unknown(
                "no part of this scene has a parameter of this name", key, known, f"param.{key}"
            )
        library, _, name = key.partition(".")
        parts = [_change_parameter(part, library, name, value) for part in parts]
    return replace(deck, parts=tuple(parts))


def _change_parameter(part: Subcircuit, library: str, name: str, value: float) -> Subcircuit:
    """Return a part in which a parameter of one subcircuit has a new default value.

    ``library`` is the name of the subcircuit in the keys ``param.NAME.…``.
    """
    changed_circuits = dict[int, Circuit]()
    params = list(part.params)
    for k, param in enumerate(params if library == make_library_stem(part) else ()):
        if param.name.lower() == name.lower():
            _require_in_range(param, library, value)
            params[k] = replace(param, default=value)
    lines = dict(
        zip(map(write_parameter_line, part.params), map(write_parameter_line, params), strict=True)
    )
    for where, item in list_parameterised_subcircuits(part):
        if where == library and name in item.defaults:
            defaults = {**item.defaults, name: format_number(value)}
            before = write_instance_comment(item.name, item.pins, item.defaults)
            lines[before] = write_instance_comment(item.name, item.pins, defaults)
            notes = tuple(lines.get(line, line) for line in item.notes)
            changed_circuits[id(item)] = replace(item, defaults=defaults, notes=notes)
    items = tuple(changed_circuits.get(id(item), item) for item in part.circuit.items)
    if not changed_circuits:
        return part
    changed = part.with_circuit(replace(part.circuit, items=items))
    return replace(changed, params=tuple(params))


def _require_in_range(param: Param, library: str, value: float) -> None:
    """Raise an error if a value is outside of the parameter's range."""
    least, most = param.low, param.high
    if least <= value <= most and math.isfinite(value):
        return
    low = 0.0 if least == SMALLEST_POSITIVE else least
    expected = f"{low:g} … {most:g}" if math.isfinite(least) else "a finite number"
    if most == math.inf and least > -math.inf:
        expected = "above zero" if least == SMALLEST_POSITIVE else f"at least {least:g}"
    raise UsageError(
        "the value is outside of the range of this parameter",
        where=f"param.{library}.{param.name}",
        got=f"{value:g} {param.unit}",
        expected=expected,
    )


# --- array of copies with separate sources ---


def make_array_deck(deck: Deck, count: int) -> Deck:
    """Return a deck with ``count`` copies of ``deck`` as subcircuit instances.

    The copies ``X1``, ``X2``, … have only node 0 in common. The results of copy k have the names
    ``k.NAME``.

    Raises
    ------
    UsageError : the number of copies is out of range, or the deck has a dc sweep, which varies only
        one source.
    """
    if not 1 <= count <= MAX_COPIES:
        raise UsageError(
            "the number of copies is not valid",
            where="--count",
            got=count,
            expected=f"1 to {MAX_COPIES}",
            hint="for example --count 2",
        )
    if deck.command.kind == "dc":
        raise UsageError(
            "one deck cannot contain several copies of a scene with a dc sweep, because the sweep "
            "varies only one source",
            where="--count",
            got=deck.command.card,
            expected="a scene with a transient or an ac analysis",
            hint="leave out --count",
        )
    unit, numbers = f"{deck.name}_unit", range(1, count + 1)
    copy = add_title("one copy", [Circuit(unit, ("common",), items=deck.items)])
    copies = add_title(f"{count} copies", [Element.from_words(f"X{k}", "0", unit) for k in numbers])
    vectors, units, initial = dict[str, tuple[str, float]](), dict[str, str](), dict[str, float]()
    for k in numbers:
        for name, (expression, factor) in deck.vectors.items():
            vectors[f"{k}.{name}"] = _move_into_instance(expression, f"x{k}"), factor
        units |= _prefix_keys(f"{k}.", deck.units)
        initial |= _prefix_keys(f"x{k}.", deck.initial_voltages)
    title, items = f"{deck.title}, {count} copies", (*copy, *copies)
    deck = replace(deck, measures=())
    return replace(
        deck, title=title, items=items, vectors=vectors, units=units, initial_voltages=initial
    )


def _prefix_keys(prefix: str, values: Mapping[str, Value]) -> dict[str, Value]:
    """Return a copy of a dictionary with ``prefix`` before each key."""
    return {f"{prefix}{key}": value for key, value in values.items()}


def _move_into_instance(expression: str, instance: str) -> str:
    """Return an expression with all its vectors moved into a subcircuit instance."""
    signed = []
    for sign, text in split_terms(expression):
        item = parse_vector(text)
        signed.append((sign, str(item.qualify_with_instance(instance)) if item else text))
    return join_terms(signed)


def add_noise_results(
    deck: Deck, output: str, owners: Iterable[str], noisy: Mapping[str, Iterable[str]]
) -> Deck:
    """Return the deck with the noise density of each noisy resistor as a new result.

    Such a result has the name ``OUTPUT.OWNER.RESISTOR``. The result ``output`` itself is the
    density of the total noise. ``OWNER`` is the part in ``owners`` whose name is the beginning of
    the card name. For each library file, ``noisy`` contains the names of the physical resistors
    with noise. All other resistors of these libraries only perform calculations and become
    noiseless.
    """
    libraries = []
    for library in deck.parts:
        names = noisy.get(library.filename)
        libraries.append(library if names is None else _remove_arithmetic_noise(library, names))
    deck = replace(deck, parts=tuple(libraries))
    parts = sorted(owners, key=len, reverse=True)
    _, factor = deck.vectors[output]
    vectors = {}
    for name, path in _list_noisy_resistors(deck.scope):
        device = path.partition(".")[0][1:]
        part = next((part for part in parts if device.startswith(part.lower())), None)
        if part is not None:
            vectors[f"{output}.{part}.{path.rpartition('.')[2]}"] = f"onoise_{name}", factor
    units = dict.fromkeys(vectors, deck.units[output])
    return replace(deck, vectors={**deck.vectors, **vectors}, units={**deck.units, **units})


def _remove_arithmetic_noise(part: Subcircuit, noisy: Iterable[str]) -> Subcircuit:
    """Remove the thermal noise of auxiliary resistors, which only compute values.

    A resistor keeps its noise if its name begins with ``Rnoise`` or is listed in ``noisy``. A name
    in ``noisy`` also applies to resistors whose names have additional digits at the end.
    """
    names = set(map(str.lower, noisy))

    def silence_resistor(entry: Item) -> Item:
        """Return a netlist item, without thermal noise if it is an auxiliary resistor.

        An auxiliary resistor only computes a value and represents no physical resistance.
        """
        if not isinstance(entry, Element) or entry.kind != "r" or entry.key.startswith("rnoise"):
            return entry
        if names & {entry.key, entry.key.rstrip(DIGITS)}:
            return entry
        return replace(entry, parameters={**entry.parameters, "noisy": "0"})

    return part.with_circuit(part.circuit.map_items(silence_resistor))


def _list_noisy_resistors(scope: Scope, path: str = "") -> Iterator[tuple[str, str]]:
    """Yield the simulator name and the netlist path of each noisy resistor."""
    for item in scope.elements:
        if item.kind == "x" and (inner := scope.find_subcircuit(item.model)) is not None:
            yield from _list_noisy_resistors(inner, f"{path}{item.key}.")
        elif item.kind == "r" and item.settings.get("noisy") != "0":
            yield f"r.{path}{item.key}" if path else item.key, f"{path}{item.key}"
