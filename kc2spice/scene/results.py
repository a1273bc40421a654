"""Results of a scene, and its dc sweep.

A build with the records of its parts goes in. Vectors of the netlist come out: results of parts,
and the flows and powers that probes read. A dc sweep moves one source; a noise
analysis has one output.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from kc2spice.core.domains import FLOW_SYMBOLS, Domain
from kc2spice.core.equality import EqualByContent
from kc2spice.core.errors import UsageError, unknown
from kc2spice.core.quantities import quantity
from kc2spice.netlist.deck import PowerTerm
from kc2spice.netlist.expression import parse_vector, terms
from kc2spice.scene.compose import metered_pins, powered_pins
from kc2spice.scene.keys import list_schema_keys
from kc2spice.scene.model import Build, Part, Scene
from kc2spice.scene.resolve import resolve, with_vectors
from kc2spice.scene.rows import Swept, Vector
from kc2spice.scene.settings import Analysis

NOISE_WAVE = "noise"  # spectral density of the output, and the metric of its rms value
DENSITY_UNIT = "/sqrt(Hz)"  # behind the unit of a spectral density
WATT = "W"
GROUND_VOLTAGE = "v(0)"


def find_noise_output(build: Build) -> Vector:
    """Return the output of the noise analysis: a result, or the quantity across a pin.

    Raises
    ------
    UsageError : there is no such result, or it is no voltage of the netlist.
    """
    name = str(build.scene.analysis.output)
    known = build.vectors
    for part in build.scene.parts.values():
        for pin in build.scene.pins(part.name):
            if build.net(part, pin.name) != "0":
                known.setdefault(f"{part.name}.{pin.name}", build.across(part, pin.name))
    voltages = {}
    for item, result in known.items():
        if format_voltage(result) is not None:
            voltages[item] = result
    if name not in voltages:
        message = "noise is that of a voltage or a motion"
        raise unknown(message, name, voltages, build.scene.where("analysis.output"))
    return voltages[name]


def format_voltage(result: Vector) -> str | None:
    """Return a voltage in the syntax of the simulator, None for other results."""
    plus: list[str] = []
    minus: list[str] = []
    for sign, text in terms(result.expression):
        read = parse_vector(text)
        if read is None or read.quantity != "v" or len(read.names) > 1:
            return None
        (plus if sign > 0 else minus).append(read.names[0])
    if max(len(plus), len(minus)) > 1:
        return None
    return f"v({','.join(plus + minus)})"


Powers = tuple[PowerTerm, ...]  # terms whose sum is the power of a part or pin


def collect_results(build: Build) -> dict[str, Vector]:
    """Return the results of all parts; of a noise analysis the density alone.

    Parameters of devices such as ``@b1[i]`` are no results of an ac analysis: ngspice returns
    their value at the operating point there, not a response.
    """
    if build.noisy:
        of = find_noise_output(build)
        return {NOISE_WAVE: Vector("onoise_spectrum", abs(of.factor), f"{of.unit}{DENSITY_UNIT}")}
    result = build.vectors
    for name, metered in _collect_metered(build, result).items():
        result.setdefault(name, metered)
    if build.scene.analysis.type == "ac":
        return {name: item for name, item in result.items() if "@" not in item.expression}
    return result


def collect_units(build: Build) -> dict[str, str]:
    """Return the SI units of all results, including powers."""
    results = collect_results(build)
    units = {name: result.unit for name, result in results.items()}
    return units | dict.fromkeys(collect_powers(build, results), WATT)


def require_probed_results(build: Build) -> None:
    """Refuse probes of results that the scene does not have.

    A part whose results follow from its model is not checked before that model is built.

    Raises
    ------
    UsageError : names the key of the probe, and the results that it may read.
    """
    scene = build.scene
    if not scene.probes or build.noisy:
        return
    waiting = set()
    for name, part in scene.parts.items():
        if part.type.results_of_model and build.models.get(name) is None:
            waiting.add(name)
    build = build if build.records else with_vectors(build, without=waiting)
    results = collect_results(build)
    known = {*results, *collect_powers(build, results)}
    for name, probe in scene.probes.items():
        owner, dot, _ = probe.of.partition(".")
        if probe.of in known or owner in waiting or not (dot or owner in scene.parts):
            continue  # without a dot: time, frequency
        where = scene.where(f"probes.{name}.of")
        if owner not in scene.parts:
            raise unknown(f"this scene has no part {owner!r}", probe.of, scene.parts, where)
        choices = _select_prefixed(_list_results(build, waiting), f"{owner}.")
        error = unknown("no such result", probe.of, choices, where)
        error.hint = error.hint or _suggest_result(probe.of, choices)
        raise error


def _select_prefixed(names: Iterable[str], prefix: str) -> list[str]:
    return [name for name in names if name.startswith(prefix)]


def _suggest_result(name: str, choices: Sequence[str]) -> str | None:
    """Suggest a result that begins like an unknown one: ``r2.v`` for ``r2.voltage``."""
    near = list(filter(name.startswith, choices))
    near = near or _select_prefixed(choices, f"{name}.")[:1]
    return f"did you mean {max(near, key=len)!r}?" if near else None


def _list_results(build: Build, waiting: Collection[str]) -> list[str]:
    """List all results that a probe may read.

    They include motions at ports that are not joined, and currents and powers that have a meter
    only if a probe reads them.
    """
    scene = resolve(replace(build.scene, ports="all"))
    result = dict.fromkeys(collect_results(with_vectors(replace(build, scene=scene), waiting)))
    for part in scene.parts.values():
        result |= dict.fromkeys(_list_metered(part, scene, result))
    return list(result)


def _list_metered(part: Part, scene: Scene, known: Collection[str]) -> Iterator[str]:
    """Yield flows and powers of a part that probes may read besides ``known`` results."""
    n, pins, powered = part.name, metered_pins(part, scene), powered_pins(part, scene)
    for domain in dict.fromkeys(powered.values()):
        through = domain.quantity("through")
        if part.is_subcircuit or f"{n}.{through.symbol}" in known:
            yield f"{n}.power"
        if (part.is_subcircuit and not domain.reference) or f"{n}.{through.symbol}" in known:
            yield f"{n}.{through.name}"
    if part.is_subcircuit:
        for pin, domain in pins.items():
            yield from (f"{n}.{pin}.{domain.quantity('through').name}", f"{n}.{pin}.power")


def _collect_metered(build: Build, known: Mapping[str, Vector]) -> dict[str, Vector]:
    """Return the results of pins with a meter, in SI units.

    ``PART.PIN.current`` is the current into the part, ``PART.PIN.v`` the voltage. ``PART.current``
    is the current of the first pin. Other domains have other names for both quantities.
    """
    result: dict[str, Vector] = {}
    for name, pin in build.scene.meters:
        part = build.scene.parts[name]
        domain = metered_pins(part, build.scene)[pin]
        through = domain.quantity("through")
        read = Vector(f"i({build.meter(part, pin)})", through.factor, through.unit)
        result[f"{name}.{pin}.{through.name}"] = read
        result[f"{name}.{pin}.{domain.across.symbol}"] = build.across(part, pin)
        if not domain.reference and pin == next(iter(powered_pins(part, build.scene))):
            result[f"{name}.{through.name}"] = read
    for quantity_name, symbol in FLOW_SYMBOLS.items():
        for part in _probed_parts(build, quantity_name):
            known_as = f"{part.name}.{symbol}"
            if known_as in known:  # flow of an element, under the name that bodies use
                result.setdefault(f"{part.name}.{quantity_name}", known[known_as])
    for part in _probed_parts(build, "power"):
        result |= _collect_across(part, build)
    return result


def _collect_across(part: Part, build: Build) -> dict[str, Vector]:
    """Return the quantity across a part of two pins that is no subcircuit."""
    pins = [pin for pin in build.scene.pins(part.name) if pin.domain is not None]
    if part.is_subcircuit or len(pins) != 2 or pins[0].kind != pins[1].kind:
        return {}
    plus, minus = build.across(part, pins[0].name), build.across(part, pins[1].name)
    text = ""
    for sign, node in (("", plus.expression), ("-", minus.expression)):
        text += "" if node == GROUND_VOLTAGE else sign + node
    domain = pins[0].domain
    assert domain is not None
    name = f"{part.name}.{domain.across.symbol}"
    return {name: replace(plus, expression=text)} if text else {}


def collect_powers(build: Build, known: Collection[str]) -> dict[str, Powers]:
    """Return the terms of each power of a part or pin that a probe reads.

    A source delivers its power [W]; any other part absorbs it.
    """
    result: dict[str, Powers] = {}
    for part in _probed_parts(build, "power"):
        if power := _find_part_power(part, build, known):
            result[f"{part.name}.power"] = power
    for name, pin in build.scene.meters:
        part = build.scene.parts[name]
        domain = metered_pins(part, build.scene)[pin]
        if f"{name}.{pin}.power" in build.scene.probed:
            result[f"{name}.{pin}.power"] = (_pin_power(part, pin, domain, build),)
    return result


def _find_part_power(part: Part, build: Build, known: Collection[str]) -> Powers:
    """Return the terms of the power of a part; none if a result is missing.

    They are the powers at its pins, or products of its own results.
    """
    pins = powered_pins(part, build.scene)
    at_pins = tuple(_pin_power(part, pin, domain, build) for pin, domain in pins.items())
    if at_pins and all(term.through in known for term in at_pins):
        power = at_pins
    else:
        power = tuple(_part_power(part.name, domain) for domain in dict.fromkeys(pins.values()))
    return power if all(term.names <= set(known) for term in power) else ()


def _part_power(name: str, domain: Domain) -> PowerTerm:
    """Return the product of the quantities across and through a part."""
    across, through = domain.across.symbol, domain.quantity("through").symbol
    return PowerTerm(f"{name}.{across}", f"{name}.{through}", domain.power)


def _pin_power(part: Part, pin: str, domain: Domain, build: Build) -> PowerTerm:
    """Return the power into a part at a pin; a velocity needs no derivative."""
    unit = build.scene.terminals[part.name, pin].unit
    power = domain.power if unit == domain.across.pin_unit else "across * through"
    across, through = domain.across.symbol, domain.quantity("through").name
    return PowerTerm(f"{part.name}.{pin}.{across}", f"{part.name}.{pin}.{through}", power)


def _probed_parts(build: Build, quantity_name: str) -> Iterator[Part]:
    """Yield the parts whose result ``PART.QUANTITY`` a probe reads."""
    for result in build.scene.probed:
        name, _, read = result.partition(".")
        if read == quantity_name and name in build.scene.parts:
            yield build.scene.parts[name]


@dataclass(frozen=True, eq=False)
class DcSweep(EqualByContent):
    """The dc sweep of a scene: the key that it moves, and the source that moves it.

    Attributes
    ----------
    source : str
        Name of the source in the netlist.
    scale : float
        Volts or amperes of the source for one SI unit of the key.
    unit : str
        SI unit of the key.
    part, key : str
        Key of the scene that the sweep moves.
    ends : tuple of two floats
        First and last value in SI units.
    values : ndarray
        Values in SI units. ngspice sweeps in one direction only. Values of the return sweep are
        therefore beyond the last one of ``ends``. The source has ``2 last - value`` there.
    """

    source: str
    scale: float
    unit: str
    part: str
    key: str
    ends: tuple[float, float]
    values: np.ndarray


def resolve_dc_sweep(build: Build) -> DcSweep:
    """Resolve the dc sweep of a scene.

    Raises
    ------
    UsageError : no source has the key that the analysis sweeps, or the range is empty.
    """
    scene, selected = build.scene, build.scene.analysis
    name, _, key = str(selected.sweep).partition(".")
    part = scene.part(name, "analysis.sweep")
    moved = build.records[part.name].settable.get(key)
    if not isinstance(moved, Swept):
        raise UsageError(
            "a dc analysis cannot sweep this key",
            where=scene.where("analysis.sweep"),
            got=str(selected.sweep),
            expected="the dc value of a source, such as push.dc",
            hint=f"kc2spice sweep SCENE --set {selected.sweep}=FROM:TO:POINTS sweeps any key",
        )
    unit = _unit_of_key(part, key)
    first, last = ends = moved.range or _sweep_ends(selected, unit)
    turns = 2 if selected.back else 1
    points = turns * (selected.points - 1) + 1
    values = np.linspace(first, first + turns * (last - first), points)
    return DcSweep(moved.source, moved.scale, unit, part.name, key, ends, values)


def _unit_of_key(part: Part, key: str) -> str:
    """Return the SI unit of a key that a dc analysis sweeps."""
    declared = (item.unit for item in list_schema_keys(type(part.keys)) if item.name == key)
    return getattr(part.keys, "unit", None) or next(declared, None) or ""


def _sweep_ends(selected: Analysis, unit: str) -> tuple[float, float]:
    """Return first and last value of the sweep in SI units; refuse an empty range."""
    first, last = quantity(selected.from_, unit), quantity(selected.to, unit)
    if first == last:  # a simulator would step on the spot without end
        got, expected = f"{first:g} … {last:g} {unit}", "two values"
        raise UsageError("empty range", where="analysis.to", got=got, expected=expected)
    return first, last
