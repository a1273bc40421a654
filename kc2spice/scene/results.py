"""Results of a scene, and its dc sweep.

A build with the records of its parts goes in. Vectors of the netlist come out: results of parts,
and the flows and powers that probes read. A dc sweep moves one source; a noise
analysis has one output.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from kc2spice.core.domains import FLOW_SYMBOLS, Domain
from kc2spice.core.equality import EqualByContent
from kc2spice.core.errors import UsageError, unknown
from kc2spice.core.quantities import quantity
from kc2spice.netlist.deck import PowerTerm
from kc2spice.netlist.expression import terms, vector
from kc2spice.scene.compose import metered_pins, powered_pins
from kc2spice.scene.keys import model_keys
from kc2spice.scene.model import Build, Part, PartType, Scene
from kc2spice.scene.resolve import resolve, with_vectors
from kc2spice.scene.rows import Swept, Vector
from kc2spice.scene.settings import Analysis

WAVE = "noise"  # spectral density of the output, and the metric of its rms value
DENSITY = "/sqrt(Hz)"
WATT = "W"


def noise_output(build: Build) -> Vector:
    """Return the output of the noise analysis: a result, or the across quantity of a pin.

    Raises
    ------
    UsageError : there is no such result, or it is no voltage of the netlist.
    """
    parts, name = build.scene.parts, str(build.scene.analysis.output)
    known = {k: v for record in build.records.values() for k, v in record.vectors.items()}
    for part in parts.values():
        pins = [pin.name for pin in build.scene.pins(part.name)]
        live = [pin for pin in pins if build.net(part, pin) != "0"]
        across = {f"{part.name}.{pin}": build.across(part, pin) for pin in live}
        known |= {item: result for item, result in across.items() if item not in known}
    voltages = {item: result for item, result in known.items() if output_nodes(result) is not None}
    if name not in voltages:
        message = "noise is that of a voltage or a motion"
        raise unknown(message, name, voltages, build.scene.where("analysis.output"))
    return voltages[name]


def output_nodes(probe_vector: Vector) -> str | None:
    """Write the voltage in the syntax of the simulator; None if the vector is no voltage."""
    read = [(sign, vector(text)) for sign, text in terms(probe_vector.expression)]
    if any(v is None or v.quantity != "v" or len(v.names) > 1 for _, v in read) or len(read) > 2:
        return None
    nodes = [v.names[0] for sign, v in sorted(read, key=lambda row: -row[0]) if v is not None]
    return f"v({','.join(nodes)})" if sum(sign for sign, _ in read) in (0, 1, -1) else None


Powers = tuple[PowerTerm, ...]  # terms whose sum is the power of a part or pin


def result_vectors(build: Build) -> dict[str, Vector]:
    """Return the results of all parts that have cards; of noise its density alone.

    Parameters of devices such as ``@b1[i]`` are no results of an ac analysis: ngspice returns
    their value at the operating point there, not a response.
    """
    if build.noisy:
        of = noise_output(build)
        return {WAVE: Vector("onoise_spectrum", abs(of.factor), f"{of.unit}{DENSITY}")}
    result: dict[str, Vector] = {}
    for record in build.records.values():
        result |= record.vectors
    result |= _meter_vectors(build, result)
    if build.scene.analysis.type == "ac":
        return {name: item for name, item in result.items() if "@" not in item.expression}
    return result


def result_units(build: Build) -> dict[str, str]:
    """Return the SI units of all results, including powers."""
    results = result_vectors(build)
    units = {name: vector.unit for name, vector in results.items()}
    return units | dict.fromkeys(powers(build, results), WATT)


def require_probed(build: Build) -> None:
    """Refuse probes of results that the scene does not have.

    A part whose results follow from its model is not checked before that model is built.

    Raises
    ------
    UsageError : names the key of the probe, and the results that it may read.
    """
    scene = build.scene
    if not scene.probes or build.noisy:
        return
    unbuilt = (p for name, p in scene.parts.items() if build.models.get(name) is None)
    waiting = {part.name for part in unbuilt if part.type.results_of_model}
    build = build if build.records else with_vectors(build, without=waiting)
    results = result_vectors(build)
    known = {*results, *powers(build, results)}
    for name, probe in scene.probes.items():
        owner, dot, _ = probe.of.partition(".")
        if probe.of in known or owner in waiting or not (dot or owner in scene.parts):
            continue  # without a dot: time, frequency
        where = scene.where(f"probes.{name}.of")
        if owner not in scene.parts:
            raise unknown(f"this scene has no part {owner!r}", probe.of, scene.parts, where)
        choices = [each for each in _list_results(build, waiting) if each.startswith(f"{owner}.")]
        error = unknown("no such result", probe.of, choices, where)
        error.hint = error.hint or _suggest_result(probe.of, choices)
        raise error


def _suggest_result(name: str, choices: Sequence[str]) -> str | None:
    """Suggest a result for an unknown name that begins alike: ``r2.v`` for ``r2.voltage``."""
    near = list(filter(name.startswith, choices))
    near = near or [choice for choice in choices if choice.startswith(f"{name}.")][:1]
    return f"did you mean {max(near, key=len)!r}?" if near else None


def _list_results(build: Build, waiting: Collection[str]) -> list[str]:
    """List all results that a probe may read.

    They include motions at unconnected ports, and the currents and powers that have a meter only if
    a probe reads them.
    """
    scene = resolve(replace(build.scene, ports="all"))
    result = dict.fromkeys(result_vectors(with_vectors(replace(build, scene=scene), waiting)))
    for part in scene.parts.values():
        result |= dict.fromkeys(_list_metered(part, scene, result))
    return list(result)


def _list_metered(part: Part, scene: Scene, known: Collection[str]) -> Iterator[str]:
    """List flows and powers of a part that probes may read besides the ``known`` results."""
    n, pins, powered = part.name, metered_pins(part, scene), powered_pins(part, scene)
    for domain in dict.fromkeys(powered.values()):
        through = domain.quantity("through")
        library = type(part.type).cards is PartType.cards
        if library or f"{n}.{through.symbol}" in known:
            yield f"{n}.power"
        if (library and not domain.reference) or f"{n}.{through.symbol}" in known:
            yield f"{n}.{through.name}"
    if type(part.type).cards is PartType.cards:
        for pin, domain in pins.items():
            yield from (f"{n}.{pin}.{domain.quantity('through').name}", f"{n}.{pin}.power")


def _meter_vectors(build: Build, known: Mapping[str, Vector]) -> dict[str, Vector]:
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
        result |= _element_vectors(part, build)
    return {name: vector for name, vector in result.items() if name not in known}


def _element_vectors(part: Part, build: Build) -> dict[str, Vector]:
    """Return the across quantity of a part with cards of its own and two pins of one domain."""
    pins = [pin for pin in build.scene.pins(part.name) if pin.domain is not None]
    if type(part.type).cards is PartType.cards or len(pins) != 2 or pins[0].kind != pins[1].kind:
        return {}
    domain, ends = pins[0].domain, [build.across(part, pin.name) for pin in pins]
    assert domain is not None
    pairs = zip(("", "-"), (end.expression for end in ends), strict=True)
    text = "".join(sign + node for sign, node in pairs if node != "v(0)")
    name = f"{part.name}.{domain.across.symbol}"
    return {name: replace(ends[0], expression=text)} if text else {}


def powers(build: Build, known: Collection[str]) -> dict[str, Powers]:
    """Return the terms of each ``PART.power`` and ``PART.PIN.power`` [W] that a probe reads.

    A source delivers its power; any other part absorbs it.
    """
    result: dict[str, Powers] = {}
    for part in _probed_parts(build, "power"):
        n, pins = part.name, powered_pins(part, build.scene)
        terms = tuple(_pin_power(part, pin, domain, build) for pin, domain in pins.items())
        if not terms or not all(term.through in known for term in terms):
            domains = dict.fromkeys(pins.values())
            terms = tuple(
                PowerTerm(f"{n}.{d.across.symbol}", f"{n}.{d.quantity('through').symbol}", d.power)
                for d in domains
            )
        if terms and all(term.names <= set(known) for term in terms):
            result[f"{n}.power"] = terms
    for name, pin in build.scene.meters:
        part = build.scene.parts[name]
        result[f"{name}.{pin}.power"] = (
            _pin_power(part, pin, metered_pins(part, build.scene)[pin], build),
        )
    probed = {probe.of for probe in build.scene.probes.values()}
    return {name: terms for name, terms in result.items() if name in probed}


def _pin_power(part: Part, pin: str, domain: Domain, build: Build) -> PowerTerm:
    """Return the power that enters a part through a pin; a velocity needs no derivative."""
    unit = build.scene.terminals[part.name, pin].unit
    power = domain.power if unit == domain.across.pin_unit else "across * through"
    across, through = domain.across.symbol, domain.quantity("through").name
    return PowerTerm(f"{part.name}.{pin}.{across}", f"{part.name}.{pin}.{through}", power)


def _probed_parts(build: Build, what: str) -> list[Part]:
    """Return the parts whose result ``PART.what`` a probe reads."""
    names = dict.fromkeys(
        p.of.partition(".")[0]
        for p in build.scene.probes.values()
        if p.of.partition(".")[2] == what
    )
    return [build.scene.parts[name] for name in names if name in build.scene.parts]


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
    units = {item.name: item.unit for item in model_keys(type(part.keys))}
    return getattr(part.keys, "unit", None) or units.get(key) or ""


def _sweep_ends(selected: Analysis, unit: str) -> tuple[float, float]:
    """Return first and last value of the sweep in SI units; refuse an empty range."""
    first, last = (quantity(getattr(selected, name), unit) for name in ("from_", "to"))
    if first == last:  # a simulator would step on the spot without end
        got, expected = f"{first:g} … {last:g} {unit}", "two values"
        raise UsageError("empty range", where="analysis.to", got=got, expected=expected)
    return first, last
