"""Results, dc sweep and noise output of a scene.

The results are quantities of parts, and the flows and powers that probes read. Each result is
computed from vectors of the netlist. The function
:func:`kc2spice.scene.part_method_calls.add_results_and_sources` calls the functions of this module.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace

import numpy as np

from kc2spice.core.domains import FLOW_SYMBOLS, Domain
from kc2spice.core.errors import UsageError, unknown
from kc2spice.core.quantities import convert_quantity
from kc2spice.netlist.power_waveforms import PowerTerm
from kc2spice.scene.keys import list_schema_keys
from kc2spice.scene.net_formation import list_metered_pins, list_power_input_pins
from kc2spice.scene.part_records import DcSweep, PartResult, Powers, SceneResults, SweptSource
from kc2spice.scene.scene_classes import BuiltScene, Part
from kc2spice.scene.settings import Analysis

# Name of the spectral density of the output noise, and of the metric with the rms noise.
NOISE_WAVE = "noise"
GROUND_VOLTAGE = "v(0)"


def find_noise_output(build: BuiltScene) -> PartResult | None:
    """Return the output of a noise analysis: a result or a pin's across quantity.

    The result is None for all other analyses.

    Raises
    ------
    UsageError : the output of the noise analysis does not exist, or is not a voltage of the
        netlist.
    """
    if not build.has_noise:
        return None
    name = str(build.scene.analysis.output)
    known = build.vectors
    for part in build.scene.parts.values():
        for pin in build.scene.pins(part.name):
            if build.get_net(part, pin.name) != "0":
                known.setdefault(f"{part.name}.{pin.name}", build.get_pin_vector(part, pin.name))
    voltages = {}
    for item, result in known.items():
        if result.voltage is not None:
            voltages[item] = result
    if name not in voltages:
        owner = name.partition(".")[0]
        own = [item for item in voltages if item.startswith(f"{owner}.")]
        advice = f'write  output = "{own[0]}"' if own else None
        raise unknown(
            "the output of a noise analysis is not a voltage or a displacement",
            name,
            voltages,
            build.scene.where("analysis.output"),
            advice=advice,
        )
    return voltages[name]


def collect_results(build: BuiltScene) -> SceneResults:
    """Return the results of all parts, and the powers that probes read.

    The only result of a noise analysis is the spectral density of its output noise.
    """
    if build.noise_output is not None:
        return SceneResults({NOISE_WAVE: build.noise_output.noise_density})
    vectors = _collect_vectors(build)
    return SceneResults(vectors, collect_powers(build, vectors))


def _collect_vectors(build: BuiltScene) -> dict[str, PartResult]:
    """Return the vectors of all results, except noise densities.

    Device parameters such as ``@b1[i]`` are omitted in an ac analysis, because ngspice returns
    their value at the operating point in place of a response.
    """
    result = build.vectors
    for name, metered in _collect_metered_results(build, result).items():
        result.setdefault(name, metered)
    if build.scene.analysis.type == "ac":
        return {name: item for name, item in result.items() if "@" not in item.expression}
    return result


def _collect_metered_results(
    build: BuiltScene, known: Mapping[str, PartResult]
) -> dict[str, PartResult]:
    """Return the results at pins with an ammeter, in SI units.

    ``PART.PIN.current`` is the current into the part at the pin, and ``PART.PIN.v`` the voltage of
    the pin. ``PART.current`` is the current at the first pin. In all domains except the electrical
    domain, the names of the domain's flow and across quantity replace ``current`` and ``v``.
    """
    result: dict[str, PartResult] = {}
    for name, pin in build.scene.meters:
        part = build.scene.parts[name]
        domain = list_metered_pins(part, build.scene)[pin]
        through = domain.through_variable
        read = PartResult(f"i({build.find_meter_name(part, pin)})", through.factor, through.unit)
        result[f"{name}.{pin}.{through.name}"] = read
        across = build.get_pin_vector(part, pin)
        if across.expression != GROUND_VOLTAGE:
            result[f"{name}.{pin}.{domain.across.symbol}"] = across
        if not domain.reference and pin == next(iter(list_power_input_pins(part, build.scene))):
            result[f"{name}.{through.name}"] = read
    for quantity_name, symbol in FLOW_SYMBOLS.items():
        for part in _list_probed_parts(build, quantity_name):
            known_as = f"{part.name}.{symbol}"
            if known_as in known:  # PART.current, for example, is a second name of PART.i
                result.setdefault(f"{part.name}.{quantity_name}", known[known_as])
    for part in _list_probed_parts(build, "power"):
        result |= _collect_across_quantity(part, build)
    return result


def _collect_across_quantity(part: Part, build: BuiltScene) -> dict[str, PartResult]:
    """Return the voltage, or other across quantity, of a two-pin part.

    The result is empty for a subcircuit.
    """
    pins = [pin for pin in build.scene.pins(part.name) if pin.domain is not None]
    if build.scene.has_subcircuit(part) or len(pins) != 2 or pins[0].kind != pins[1].kind:
        return {}
    plus, minus = build.get_pin_vector(part, pins[0].name), build.get_pin_vector(part, pins[1].name)
    text = ""
    for sign, node in (("", plus.expression), ("-", minus.expression)):
        text += "" if node == GROUND_VOLTAGE else sign + node
    domain = pins[0].domain
    assert domain is not None
    name = f"{part.name}.{domain.across.symbol}"
    return {name: replace(plus, expression=text)} if text else {}


def collect_powers(build: BuiltScene, known: Collection[str]) -> dict[str, Powers]:
    """Collect the terms that add up to each probed power, keyed by result name.

    The power [W] of a source is positive if the source delivers it. The power of any other part is
    positive if the part absorbs it.
    """
    result: dict[str, Powers] = {}
    for part in _list_probed_parts(build, "power"):
        if power := _find_part_power(part, build, known):
            result[f"{part.name}.power"] = power
    for name, pin in build.scene.meters:
        part = build.scene.parts[name]
        domain = list_metered_pins(part, build.scene)[pin]
        moves = build.get_net(part, pin) != "0"
        if moves and f"{name}.{pin}.power" in build.scene.probed_results:
            result[f"{name}.{pin}.power"] = (_make_pin_power_term(part, pin, domain, build),)
    return result


def _find_part_power(part: Part, build: BuiltScene, known: Collection[str]) -> Powers:
    """Return the terms whose sum is the power of a part; empty if a result is missing.

    The terms are the powers at the pins of the part, or products of results of the part.
    """
    pins = list_power_input_pins(part, build.scene)
    at_pins = tuple(_make_pin_power_term(part, pin, domain, build) for pin, domain in pins.items())
    if at_pins and all(term.through in known for term in at_pins):
        power = at_pins
    else:
        power = tuple(
            _make_part_power_term(part.name, domain) for domain in dict.fromkeys(pins.values())
        )
    return power if all(term.result_names <= set(known) for term in power) else ()


def _make_part_power_term(name: str, domain: Domain) -> PowerTerm:
    """Return the product of a part's across and through quantity as a power term."""
    across, through = domain.across.symbol, domain.through_variable.symbol
    return PowerTerm(f"{name}.{across}", f"{name}.{through}", domain.power)


def _make_pin_power_term(part: Part, pin: str, domain: Domain, build: BuiltScene) -> PowerTerm:
    """Return the power that flows into a part at one of its pins, as a power term."""
    unit = build.scene.terminals[part.name, pin].unit
    power = domain.power if unit == domain.across.pin_unit else "across * through"
    across, through = domain.across.symbol, domain.through_variable.name
    return PowerTerm(f"{part.name}.{pin}.{across}", f"{part.name}.{pin}.{through}", power)


def _list_probed_parts(build: BuiltScene, quantity_name: str) -> Iterator[Part]:
    """Yield the parts whose result ``PART.QUANTITY`` a probe reads."""
    for result in build.scene.probed_results:
        name, _, read = result.partition(".")
        if read == quantity_name and name in build.scene.parts:
            yield build.scene.parts[name]


def resolve_dc_sweep(build: BuiltScene) -> DcSweep | None:
    """Return the dc sweep of a scene; None for other analyses.

    Raises
    ------
    UsageError : the analysis sweeps a key that sets no source, or the range of the sweep is empty.
    """
    scene, selected = build.scene, build.scene.analysis
    if selected.type != "dc":
        return None
    name, _, key = str(selected.sweep).partition(".")
    part = scene.get_part(name, "analysis.sweep")
    swept = build.records[part.name].settable.get(key)
    if not isinstance(swept, SweptSource):
        raise UsageError(
            "a dc analysis cannot sweep this key",
            where=scene.where("analysis.sweep"),
            got=str(selected.sweep),
            expected="the dc value of a source, such as push.dc",
            hint=f"kc2spice sweep SCENE --set {selected.sweep}=FROM:TO:POINTS sweeps this key",
        )
    unit = _find_key_unit(part, key)
    first, last = ends = swept.range or _require_sweep_ends(selected, unit)
    turns = 2 if selected.back else 1
    points = turns * (selected.points - 1) + 1
    values = np.linspace(first, first + turns * (last - first), points)
    return DcSweep(swept.source, swept.scale, unit, part.name, key, ends, values)


def _find_key_unit(part: Part, key: str) -> str:
    """Return the SI unit of a key that a dc analysis sweeps."""
    declared = (item.unit for item in list_schema_keys(type(part.keys)) if item.name == key)
    return getattr(part.keys, "unit", None) or next(declared, None) or ""


def _require_sweep_ends(selected: Analysis, unit: str) -> tuple[float, float]:
    """Return first and last value of the sweep in SI units; reject an empty range."""
    first, last = convert_quantity(selected.from_, unit), convert_quantity(selected.to, unit)
    if first == last:  # a sweep with an empty range would never end in a simulator
        raise UsageError(
            "the range of the sweep is empty",
            where="analysis.to",
            got=f"{first:g} … {last:g} {unit}",
            expected="two different values",
            hint="write different values for the keys `from` and `to`",
        )
    return first, last
