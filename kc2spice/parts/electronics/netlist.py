"""The part ``netlist``: subcircuit from a netlist of the user.

The netlist is checked before a simulator reads it.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import chain, filterfalse
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, Field

from kc2spice.core.constitutive_laws import MissingEquations
from kc2spice.core.domains import PIN_UNITS, SIGNAL
from kc2spice.core.errors import UsageError, did_you_mean, list_candidates, unknown
from kc2spice.core.quantities import (
    Section,
    Slew,
    Voltage,
    convert_quantity,
    make_invalid_value_error,
)
from kc2spice.core.user_warnings import warn_user
from kc2spice.core.waveforms import Waveforms
from kc2spice.netlist.card_parser import read_cards
from kc2spice.netlist.circuit import Pin
from kc2spice.netlist.importer import Syntax, translate_circuit
from kc2spice.netlist.include_scan import read_included_netlist, read_untrusted_netlist
from kc2spice.netlist.name_scopes import (
    GROUND_NAMES,
    Scope,
    build_scope,
    conducts_to_ground,
    find_currentless_pins,
    has_vector,
)
from kc2spice.netlist.number_and_name_spelling import (
    RESERVED_NAMES,
    format_number,
    is_valid_name,
    suggest_name,
)
from kc2spice.netlist.scale_factors import read_user_number
from kc2spice.netlist.subcircuit_library import Header, Subcircuit
from kc2spice.parts.electronics._parts_with_netlist_template import (
    RAIL_MARGIN,
    list_pin_voltages,
    make_rails_check,
)
from kc2spice.scene.checks import Check
from kc2spice.scene.part_records import PartResult
from kc2spice.scene.parttype import register_part_type
from kc2spice.scene.scene_classes import (
    BuiltScene,
    DeclaredScene,
    GovernedScene,
    JoinedScene,
    Part,
    PartType,
    Scene,
    Terminal,
)
from kc2spice.scene.settings import FileName

# Device parameter of ngspice for the current of an element, keyed by the element's first letter.
# The parameter is empty for the elements V, E and H: ngspice reads their current as ``i(name)``.
_CURRENT_PARAMETERS = {
    **dict.fromkeys("rclb", "i"),
    **dict.fromkeys("dmj", "id"),
    **dict.fromkeys("veh", ""),
    "q": "ic",
}
# Units of potential and flow for each kind of pin. A signal pin carries no current.
PIN_KINDS = {f"{unit}/{flow}": (unit, flow) for unit, flow in PIN_UNITS} | {"V": ("V", SIGNAL)}
OTHER_KINDS = ", ".join(kind for kind in PIN_KINDS if kind not in ("V/A", "V"))

# Names of nodes that are usually pins. A circuit inside a subcircuit may use another pin as the
# reference of voltages, so other nodes without a path to a second pin are no mistake.
_REFERENCE_NAMES = frozenset({"ref", "vss", "com", "common", "agnd", "dgnd", "pgnd", "ground"})


RATING_ADVICE = (
    "the circuit exceeds the limits in its key `ratings`: check the circuit for a glitch, or for a "
    "diode drop beyond the rails"
)


def _read_parameter_value(si: str, value: object) -> float:
    """Convert a number, or a text such as ``3.3m``, to the value of a parameter."""
    try:
        return read_user_number(value) if isinstance(value, str) else convert_quantity(value, si)
    except UsageError as error:
        raise make_invalid_value_error(error.message, error.expected, hint=error.hint) from None


# value of a netlist parameter, which has no unit in the scene
ParameterValue = Annotated[float, BeforeValidator(partial(_read_parameter_value, ""))]


class PinRating(Section):
    """Voltage and slew-rate limits at a pin of a user's subcircuit.

    The voltages are relative to the pin ``ref`` if the circuit has such a pin.
    """

    low: Voltage | None = Field(
        None,
        description=(
            "Lowest permitted voltage at the pin, relative to the pin `ref` if the circuit "
            "has this pin"
        ),
    )
    high: Voltage | None = Field(
        None,
        description=(
            "Highest permitted voltage at the pin, relative to the pin `ref` if the circuit "
            "has this pin"
        ),
    )
    slew: Slew | None = Field(
        None, gt=0, description="Largest permitted rate of change of the voltage at the pin"
    )


class NetlistKeys(Section):
    """Keys of a user's subcircuit ``.subckt SUBCKT`` in a netlist file.

    The netlist file is in the folder of the scene.
    """

    file: FileName = Field(
        examples=['"FILE"'],
        description="Netlist file in the scene's folder that contains the subcircuit",
    )
    subckt: str = Field(
        examples=['"NAME"'],
        pattern=r"^[A-Za-z][A-Za-z0-9_]{0,63}$",
        description="Name of the subcircuit in the netlist file",
    )
    syntax: Syntax = Field(
        "ngspice",
        description=(
            "Simulator for which the netlist file was written: ngspice, ltspice or pspice"
        ),
    )
    parameters: dict[str, ParameterValue] = Field(
        default_factory=dict,
        description=(
            "Values of the subcircuit's parameters, a table { NAME = VALUE }. VALUE is a number, a "
            'text with a SPICE suffix such as "3.3m", or a text with a unit such as "3.3 mH". All '
            "other parameters have the default values of the netlist file"
        ),
    )
    units: dict[str, str] = Field(
        default_factory=dict,
        description=(
            "Two units of each pin that is not electrical, UNIT/UNIT: first the unit of the "
            "quantity that the voltage of the pin represents, then the unit of the quantity that "
            f"its current represents. Accepted are {OTHER_KINDS}, and V alone for a signal pin. "
            "Pins without an entry are electrical (V/A)"
        ),
    )
    ratings: dict[str, PinRating] = Field(
        default_factory=dict,
        description=(
            "Permitted voltages and slew rates of the pins, which each run checks: a "
            "table { PIN = { low, high, slew } }"
        ),
    )


# Kind of pin that an error message suggests, for each unit that the user may have written.
_UNITS_OF_PINS = {
    "K": "K/W", "degC": "K/W", "C": "K/W", "V": "V/A", "A": "V/A", "um": "um/N", "m": "um/N",
    "mm": "um/N", "N": "um/N", "m/s": "m/s/N", "Pa": "Pa/cm3/s", "rad": "rad/Nm",
    "m/s2": "m/s2/N", "W": "K/W",
}  # fmt: skip


class Netlist(PartType[NetlistKeys]):
    """Part type ``netlist``: subcircuit from a netlist file of the user."""

    name = "netlist"
    noise = "noise of the elements in its netlist"
    title = "the user's own subcircuit"
    origin_of_pins = (
        "The pins of a part are the pins of its `.subckt` in the netlist file, in the same order."
    )
    schema = NetlistKeys
    source = "user netlist"

    def pins(self, part: Part[NetlistKeys], scene: JoinedScene) -> tuple[Terminal, ...]:
        """Return the pins of the part in the order of its subcircuit."""
        result = []
        for name in _read_pins(part, scene):
            unit, flow = PIN_KINDS[part.keys.units.get(name, "V/A")]
            ground = name in ("ref", "base")
            result.append(
                Terminal(name, unit, flow, "gnd" if ground else None, required=not ground)
            )
        return tuple(result)

    def default_joins(self, part: Part[NetlistKeys], scene: GovernedScene) -> Mapping[str, str]:
        """Return the default connection of the pin ``command`` to the controller.

        The result is empty if the part is not a user-supplied driver circuit, or if the driver
        circuit has no pin ``command``.
        """
        control = scene.find_only_part("pid")
        commanded = part.at[1:2] == ("driver",) and "drive" in part.pins
        if control is None or not commanded or "command" not in _read_pins(part, scene):
            return {}
        return {"command": f"{control.name}.command"}

    def conducts_to_ground(self, part: Part[NetlistKeys], scene: DeclaredScene) -> bool:
        """Return whether the subcircuit, or a nested subcircuit, conducts to ground."""
        return conducts_to_ground(_read_subcircuit(part, scene))

    def problems(self, part: Part[NetlistKeys], scene: GovernedScene) -> Iterator[UsageError]:
        """Yield an error for each invalid key of the part."""
        pins = _read_pins(part, scene)
        for name, kind in part.keys.units.items():
            if name not in pins or kind not in PIN_KINDS:
                where, message = f"units.{name}", "this unit of a pin is not supported"
                error = unknown(message, kind, PIN_KINDS, advice="write one of these units")
                if name not in pins:
                    error = unknown("the subcircuit has no such pin", name, pins)
                elif (unit := _UNITS_OF_PINS.get(kind)) is not None:
                    error.hint = f'write  {name} = "{unit}"'
                yield part.wrong(
                    where, error.message, got=error.got, expected=error.expected, hint=error.hint
                )
        scope = _read_subcircuit(part, scene) if part.keys.parameters else None
        defaults = {} if scope is None else scope.defaults
        spellings: dict[str, str] = {}
        for name in part.keys.parameters:
            other = spellings.setdefault(name.lower(), name)
            if other != name:
                yield part.wrong(
                    f"parameters.{name}",
                    "the names of two parameters differ in letter case only",
                    got=f"{other} and {name}",
                    expected="names that differ in more than letter case",
                    hint=(
                        f"delete {other} or {name}; to override {other}, write {other} in place "
                        f"of {name}"
                    ),
                )
            if name.lower() not in map(str.lower, defaults):
                error = unknown("the subcircuit has no such parameter", name, defaults)
                hint = error.hint if defaults else f"add  {name}=VALUE  to its .subckt card"
                yield part.wrong(
                    f"parameters.{name}",
                    error.message,
                    got=name,
                    expected=error.expected if defaults else "a parameter of the .subckt card",
                    hint=hint,
                )
        for name, node in _list_probed_nodes(part, scene):
            scope = scope or _read_subcircuit(part, scene)
            if node in pins or has_vector(scope, _write_inner_vector(node)):
                if scene.analysis.is_small_signal and "@" in _write_inner_vector(node):
                    yield UsageError(
                        "this element has no small-signal current",
                        where=f"probes.{name}.of",
                        got=repr(f"{part.name}.{node}"),
                        expected="i(…) of a V, E or H element",
                        hint="add a 0 V source in series with the element, and read the current "
                        "of the source",
                    )
                continue
            nodes = dict.fromkeys(
                (*pins, *chain.from_iterable(e.lower_case_nodes for e in scope.elements))
            )
            choices = [*filter("0".__ne__, nodes)]
            choices += [f"i({e.key})" for e in scope.elements if e.kind in _CURRENT_PARAMETERS]
            yield UsageError(
                "the netlist has no such pin, node or current",
                where=f"probes.{name}.of",
                got=repr(f"{part.name}.{node}"),
                expected=f"one of the pins, nodes and currents of {part.name}: "
                f"{list_candidates(node, choices)}",
                hint=did_you_mean(node, choices) or f'write  of = "{part.name}.{choices[0]}"',
            )
        _warn_of_missing_pins(part, scene)
        if part.keys.ratings and scene.analysis.type != "transient":
            warn_user(
                f"{part.name}: the key `ratings` has no effect in the {scene.analysis.type} "
                "analysis: only a transient compares voltages with the ratings"
            )
        for name in part.keys.ratings:
            if name not in pins:
                yield part.wrong(
                    "ratings",
                    "the subcircuit has no such pin",
                    got=name,
                    expected=list_candidates(name, pins),
                    hint=did_you_mean(name, pins) or f"write {pins[0]} in place of {name}",
                )

    def instance_parameters(self, part: Part[NetlistKeys]) -> Mapping[str, str]:
        """Return the parameters on the instance card of the part, keyed by name."""
        return {name: format_number(value) for name, value in part.keys.parameters.items()}

    def has_ac_source(self, part: Part[NetlistKeys], scene: DeclaredScene) -> bool:
        """Return whether the netlist contains a source with an ``ac`` amplitude."""
        return _read_subcircuits(
            part.keys.file, scene.get_folder(part), _read_modification_time(part, scene)
        ).excites

    def subcircuit_name(self, part: Part[NetlistKeys], scene: Scene) -> str:
        """Return the name of the user's subcircuit."""
        return str(part.keys.subckt)

    def subcircuits(
        self, part: Part[NetlistKeys], build: BuiltScene, header: Header
    ) -> tuple[Subcircuit, ...]:
        """Return the subcircuit of the part, as a tuple of length 1."""
        folder = build.scene.get_folder(part)
        result = read_included_netlist(part.keys.file, folder, trust=build.trust)
        pins = tuple(Pin(t.name, t.unit, t.flow) for t in build.scene.pins(part.name))
        text, file = result.text, result.file
        title = text.partition("\n")[0].lstrip("* ")
        tree = translate_circuit(read_cards(text, file), part.keys.syntax)
        source = text if part.keys.syntax == "ngspice" else ""
        name = part.keys.subckt
        return (Subcircuit(name, pins, (), tree, title=title, file=file, source=source),)

    def law(self, part: Part[NetlistKeys], build: BuiltScene) -> MissingEquations:
        """Return no law, but the reason why the part has no model equations."""
        return MissingEquations("its equations are given only as a user-supplied netlist")

    def vectors(self, part: Part[NetlistKeys], build: BuiltScene) -> Mapping[str, PartResult]:
        """Return the ngspice vectors: expressions of the part's results, keyed by name.

        The results are the voltages of all pins with ratings, and all voltages and currents that
        probes measure.
        """
        scene, pins = build.scene, {t.name: t for t in build.scene.pins(part.name)}
        rated = part.keys.ratings if scene.analysis.type == "transient" else ()
        probed = dict.fromkeys(node for _, node in _list_probed_nodes(part, scene))
        volts = [p for p in probed if p in pins and pins[p].unit == "V"]
        result = list_pin_voltages(part, build, dict.fromkeys((*rated, *volts)))
        base = build.get_net(part, "ref") if "ref" in pins else "0"
        for node in probed:
            name = f"{part.name}.{node}"
            if node in volts:
                continue
            if node in pins:
                result[name] = build.get_pin_vector(part, node)
            elif node.lower().startswith("i("):
                result[name] = PartResult(_write_inner_vector(node, part.name), 1.0, "A")
            else:
                inner = f"v(x{part.name.lower()}.{node.lower()})"
                result[name] = PartResult(inner if base == "0" else f"{inner}-v({base})", 1.0, "V")
        return result

    def checks(
        self, part: Part[NetlistKeys], build: BuiltScene, waves: Waveforms
    ) -> Iterator[Check]:
        """Yield the checks of the part after a run."""
        for pin, rating in part.keys.ratings.items():
            name, volts = f"{part.name}.{pin}", waves.data.get(f"{part.name}.{pin}")
            if volts is None or "time" not in waves:
                continue
            slack = RAIL_MARGIN * float(np.abs(volts).max())
            low = -np.inf if rating.low is None else rating.low
            high = np.inf if rating.high is None else rating.high
            yield make_rails_check(name, volts, low, high, slack, RATING_ADVICE)
            if rating.slew is not None:
                ahead = np.stack([volts, -volts]) - rating.slew * waves["time"]
                most = float((ahead - np.minimum.accumulate(ahead, axis=1)).max())
                yield Check(
                    f"{name} within its slew rate",
                    most,
                    slack,
                    "V beyond",
                    RATING_ADVICE,
                    wiring=True,
                    label=f"{name}, voltage change beyond its slew rate",
                )

    def notes(self, part: Part[NetlistKeys], scene: Scene) -> Iterator[str]:
        """Yield the assumptions of the model and the effects that it neglects."""
        yield f".subckt {part.keys.subckt} of {part.keys.file}"
        for pin in scene.pins(part.name):
            joined = pin.name in part.pins or scene.is_target(part.name, pin.name)
            if pin.default is not None and not joined:
                yield f"{pin.name} of {part.name} is connected to {pin.default} by default"


def make_driver_table(
    part: Part,
    drivers: Mapping[str, dict[str, Any]],
    known: Mapping[str, str],
    data: Mapping[str, Any],
) -> dict[str, Any]:
    """Return the scene table of the part that the key ``driver`` describes.

    ``known`` maps the names of drivers to their part types. A driver of type ``netlist`` without a
    file uses the first file of the scene's key ``include``.

    Raises
    ------
    UsageError : the key does not contain exactly one driver, the type of the driver does not exist,
        or the driver has no file.
    """
    expected = "one table of " + ", ".join(known)
    if len(drivers) != 1:
        raise part.wrong(
            "driver",
            "the key `driver` does not contain exactly one driver",
            got=", ".join(drivers),
            expected=expected,
            hint=f"delete the tables other than {part.name}.driver.{next(iter(drivers))}"
            if drivers
            else f"add the table [{part.name}.driver.{next(iter(known))}]",
        )
    ((kind, table),) = drivers.items()
    if kind not in {*known, *known.values()}:
        raise part.wrong(
            "driver",
            "this type of driver does not exist",
            got=repr(kind),
            expected=expected,
            hint=did_you_mean(kind, known) or f"write {next(iter(known))} in place of {kind}",
        )
    selected = known.get(kind, kind)
    if selected == "netlist" and not table.get("file"):
        include = data.get("include")
        if not isinstance(include, (list, tuple)) or not include:
            raise part.wrong(
                f"driver.{kind}",
                "this driver needs a netlist",
                expected='include = ["FILE"], a file beside the scene',
                hint='add  include = ["FILE"]  at the top of the scene',
            )
        table = {**table, "file": str(include[0])}
    return {**table, "part": selected, "at": (part.name, "driver", kind)}


def _read_pins(part: Part[NetlistKeys], scene: DeclaredScene) -> tuple[str, ...]:
    """Return the pins of the subcircuit in the order of the netlist file.

    Raises
    ------
    UsageError : the file cannot be read, or does not contain the subcircuit.
    """
    file, folder = part.keys.file, scene.get_folder(part)
    try:
        netlist = _read_subcircuits(file, folder, _read_modification_time(part, scene))
    except UsageError as error:
        if error.where in (
            Path(file).name,
            (folder / file).name,
        ):  # the error concerns the whole file, not a single line
            error.where, error.got = f"{part.name}.file", error.got or repr(file)
        raise
    known = netlist.pins
    pins = known.get(part.keys.subckt.lower())
    if pins is None:
        raise part.wrong(
            "subckt",
            "no such subcircuit",
            got=repr(part.keys.subckt),
            expected=list_candidates(part.keys.subckt, known) or f"a .subckt in {part.keys.file}",
            hint=did_you_mean(part.keys.subckt, known)
            or (f'write  subckt = "{next(iter(known))}"' if known else None)
            or f"add a .subckt {part.keys.subckt} to {part.keys.file}",
        )
    for pin in pins:
        if not is_valid_name(pin):
            raise _make_pin_name_error(part, pin, pins, netlist.places[part.keys.subckt.lower()])
    missing = [*filterfalse(pins.__contains__, part.pins)]
    if missing and part.at[1:2] == ("driver",):
        raise UsageError(
            f"the subcircuit of a driver has no pin {missing[0]}",
            where=".".join(map(str, (*part.at, "subckt"))),
            got=f"pins {' '.join(pins)}",
            expected=f"command, {', '.join(part.pins)}, and ref if the driver has a reference",
            hint=f"rename a pin of .subckt {part.keys.subckt} to {missing[0]}",
        )
    return pins


def _make_pin_name_error(
    part: Part[NetlistKeys], pin: str, pins: Sequence[str], where: str
) -> UsageError:
    """Return the error for a pin of a user's subcircuit whose name is not valid.

    ``where`` is the file and line of the ``.subckt`` card with the ``pins``.
    """
    name, low = suggest_name(pin), [*map(str.lower, pins)]
    message = f"the pin {pin} of .subckt {part.keys.subckt} has no valid name"
    if pin.lower() in GROUND_NAMES:
        message = f"the pin {pin} of .subckt {part.keys.subckt} is node 0, the global ground"
        # an unconnected pin ref is connected to node 0
        name = next(item for item in ("ref", "vss", "ground") if item not in low)
    elif pin.lower() in RESERVED_NAMES:
        message = f"the pin {pin} of .subckt {part.keys.subckt} has a reserved name of ngspice"
    return UsageError(
        message,
        where=where,
        got=pin,
        expected="a letter, then letters, digits or _ (64 at most); no reserved name such as "
        "gnd, time or temper",
        hint=f"rename the node {pin} to {name} in all lines of .subckt {part.keys.subckt}",
    )


def _list_probed_nodes(part: Part[NetlistKeys], scene: DeclaredScene) -> Iterator[tuple[str, str]]:
    """List the probed pins, nodes and element currents of a part, with their probes.

    Probes of the current or power at a pin are omitted.
    """
    for name, probe in scene.probes.items():
        owner, dot, node = probe.of.partition(".")
        if owner == part.name and dot and node.rpartition(".")[2] not in ("current", "power"):
            yield name, node


def _write_inner_vector(node: str, part: str = "") -> str:
    """Return the ngspice vector of a node or element current inside a subcircuit.

    ``node`` is the name of a node, or a current ``i(ELEMENT)`` or ``i(x1.ELEMENT)``. With ``part``,
    the vector belongs to the instance of the part in the deck.
    """
    low, instance = node.lower(), f"x{part.lower()}." if part else ""
    match = re.fullmatch(r"i\((?:(.+)\.)?(\w+)\)", low)
    if match is None:
        return f"v({instance}{low})"
    path, element = instance + (f"{match[1]}." if match[1] else ""), match[2]
    name = f"{element[0]}.{path}{element}" if path else element
    read = _CURRENT_PARAMETERS.get(element[0], "i")
    return f"i({name})" if read == "" else f"@{name}[{read}]"


def _warn_of_missing_pins(part: Part[NetlistKeys], scene: DeclaredScene) -> None:
    """Warn about reference nodes that the ``.subckt`` line probably lacks as pins."""
    pins: dict[str, list[str]] = {}
    with suppress(UsageError):  # later checks report an invalid netlist
        pins = find_currentless_pins(_read_subcircuit(part, scene))
    for pin, inner in pins.items():
        for node in filter(_REFERENCE_NAMES.__contains__, inner):
            warn_user(
                f"{part.name}: no current can flow through the pin {pin}, because no element "
                f"of .subckt {part.keys.subckt} connects {pin} to another pin or to ground; if "
                f"{node} is a pin, add {node} to the .subckt line"
            )


def _read_subcircuit(part: Part[NetlistKeys], scene: DeclaredScene) -> Scope:
    """Return the elements and nodes of the part's subcircuit."""
    flat = read_untrusted_netlist(part.keys.file, scene.get_folder(part))
    tree = translate_circuit(read_cards(flat.text, flat.file), part.keys.syntax)
    result = build_scope(tree).find_subcircuit(part.keys.subckt)
    if result is None:
        raise part.wrong("subckt", "no such subcircuit", got=part.keys.subckt)
    return result


def _read_modification_time(part: Part[NetlistKeys], scene: DeclaredScene) -> int:
    """Return the modification time [ns] of the netlist file; 0 without the file."""
    path = scene.get_folder(part) / part.keys.file
    return path.stat().st_mtime_ns if path.is_file() else 0


@dataclass(frozen=True)
class _NetlistFile:
    """Subcircuit pins in a netlist file, and whether the file has an ``ac`` source.

    ``places`` contains the file and the line of each ``.subckt`` card.
    """

    pins: dict[str, tuple[str, ...]]
    places: dict[str, str]
    excites: bool


@lru_cache(maxsize=64)
def _read_subcircuits(file: str, home: Path, stamp: int) -> _NetlistFile:
    """Return the pins of all subcircuits in a netlist file.

    ``stamp`` is the modification time of the file, and is part of the cache key.
    """
    result, places, excites = {}, {}, False
    for card in read_untrusted_netlist(file, home).cards():
        words = list(map(str.lower, card.words))
        excites = excites or (card.keyword[:1] in ("v", "i") and "ac" in words[3:])
        if card.keyword == ".subckt" and len(card.words) > 1:
            pins = [w for w in card.words[2:] if "=" not in w and w.lower() != "params:"]
            result[card.words[1].lower()] = tuple(pins)
            places[card.words[1].lower()] = card.where
    return _NetlistFile(result, places, excites)


register_part_type(Netlist())
