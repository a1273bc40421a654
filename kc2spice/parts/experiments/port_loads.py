"""The part ``port_loads``: frequency responses between all ports of a body.

The deck contains one copy of the body for each loaded port. Source: Fig. 7 of Schütz, Maeter and
Bechtold, Actuators 10 (2021) 279.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from itertools import product
from typing import Annotated

import numpy as np
from pydantic import Field

from kc2spice.core import constitutive_laws as laws
from kc2spice.core.domains import BASE, DISPLACEMENT, TRANSLATION
from kc2spice.core.errors import UsageError
from kc2spice.core.figure import Curve, Figure, Panel
from kc2spice.core.naming import list_names
from kc2spice.core.quantities import Count, Frequency, RefinementRule, Section
from kc2spice.core.si_prefix_format import format_quantity
from kc2spice.core.waveforms import Waveforms, make_constant_waveform
from kc2spice.netlist.circuit import Element, Item
from kc2spice.netlist.shared_cards import Line, attach_comments
from kc2spice.parts.bodies.piezo_stack import PiezoStackKeys
from kc2spice.parts.electronics.two_terminal_types import make_element_law
from kc2spice.scene.checks import SOLUTION_PAIRS, Gate, Metric
from kc2spice.scene.part_records import Governed, PartResult
from kc2spice.scene.parttype import register_part_type
from kc2spice.scene.scene_classes import (
    BuiltScene,
    DeclaredScene,
    GovernedScene,
    Part,
    PartType,
    Scene,
    WiredScene,
)

# Capacitance [F] in series with a source of 1 C / CHARGE_CAPACITANCE = 1e24 V, which together apply
# a charge of 1 C to the anode. The anode voltage is negligible against 1e24 V, so that the applied
# charge is constant.
CHARGE_CAPACITANCE = 1e-24


class PortLoadsKeys(Section):
    """Keys of a load experiment: the body, and the frequencies of the unit loads."""

    start: Frequency = Field(
        0.0,
        ge=0,
        description="Lowest frequency of the responses to unit loads on the ports of the body",
    )
    stop: Frequency = Field(
        500e3,
        gt=0,
        description="Highest frequency of the responses to unit loads on the ports of the body",
    )
    steps: Annotated[Count, RefinementRule(2.0)] = Field(
        200,
        ge=2,
        le=100_000,
        description="Number of frequencies at which the responses to unit loads are computed",
    )
    of: str | None = Field(
        None,
        description=(
            "Name of the body whose ports carry the unit loads; by default the only body "
            "with a contact surface"
        ),
    )


class PortLoads(PartType[PortLoadsKeys]):
    """Part type ``port_loads``: responses of a body to a unit load on each port."""

    name = "port_loads"
    title = "unit load on every port of a body in turn, all responses"
    schema = PortLoadsKeys
    source = "unit loads"

    def generate_tables(
        self, part: Part[PortLoadsKeys], data: Mapping[str, object]
    ) -> Mapping[str, Mapping[str, object]]:
        """Return a mapping with one table, ``analysis``: a linear frequency sweep."""
        start, stop, points = part.keys.start, part.keys.stop, part.keys.steps
        linear = {"scale": "linear", "points": points, "stop": stop}
        return {"analysis": {"type": "ac", "start": start + (stop - start) / points, **linear}}

    def has_ac_source(self, part: Part[PortLoadsKeys], scene: DeclaredScene) -> bool:
        """Return True, because the unit loads are ac sources."""
        return True

    def problems(self, part: Part[PortLoadsKeys], scene: GovernedScene) -> Iterator[UsageError]:
        """Yield an error if the frequency range is empty."""
        find_loaded_body(part, scene)
        if part.keys.start >= part.keys.stop:
            yield part.wrong(
                "stop",
                "the frequency range is empty",
                got=f"{part.keys.start:g} … {part.keys.stop:g} Hz",
                expected="start < stop",
                hint=f'write for example  stop = "{10 * (part.keys.start or 100):g} Hz"',
            )

    def governed_parts(
        self, part: Part[PortLoadsKeys], scene: DeclaredScene
    ) -> Mapping[str, Governed]:
        """Return the body, which this experiment copies for each loaded port."""
        return {find_loaded_body(part, scene).name: "copied"}

    def cards(self, part: Part[PortLoadsKeys], build: BuiltScene) -> tuple[Item, ...]:
        """Return the cards of the part at the top level of the deck."""
        body, name = find_loaded_body(part, build.scene), partial(build.get_inner_name, part)
        rings, library = _list_loaded_rings(body, build.scene), build.libraries[body.name]
        is_open = body.keys.electrical == "open"
        cards: list[Line] = []
        for load in (*rings, "anode"):
            nodes = [name(ring, load) for ring in rings]
            anode, charge, source = name("anode", load), name("charge", load), name("Vanode", load)
            instance = Element.from_words(name(f"X{load}"), anode, "0", *nodes, "0", library)
            cards += [f"* Load on {load}", instance]
            if load != "anode":
                drive = Element.from_words(name(f"I{load}"), "0", name(load, load), "AC", "1")
                cards.append(drive.with_unit(TRANSLATION.flow_unit))
            if is_open and load == "anode":
                unit, node = name("Vload"), name("load")
                cards += [
                    Element.from_words(unit, node, "0", "AC", "1"),
                    Element.from_words(name("Cload"), node, "0", "1"),
                    Element.from_words(name("Fload"), "0", anode, unit, "-1"),
                ]
            if not is_open:
                cards += [
                    Element.from_words(source, anode, "0", "AC", f"{load == 'anode':d}"),
                    Element.from_words(name("Fcharge", load), charge, "0", source, "1"),
                    Element.from_words(name("Ccharge", load), charge, "0", "1"),
                    Element.from_words(name("Rcharge", load), charge, "0", 1e9),
                ]
        return attach_comments(cards)

    def list_inner_names(
        self, part: Part[PortLoadsKeys], scene: WiredScene
    ) -> Iterator[tuple[str, ...]]:
        """Yield the names of the copies of the body, and of their loads and inner nodes."""
        rings = _list_loaded_rings(find_loaded_body(part, scene), scene)
        for load in (*rings, "anode"):
            yield (f"X{load}",)
            yield (f"I{load}",)
            words = ("anode", "charge", "Vanode", "Fcharge", "Ccharge", "Rcharge")
            yield from product((*rings, *words), (load,))
        yield from zip(("Vload", "load", "Cload", "Fload"))

    def vectors(self, part: Part[PortLoadsKeys], build: BuiltScene) -> Mapping[str, PartResult]:
        """Return the ngspice vectors: expressions of responses, keyed by ``INPUT>OUTPUT``.

        The response of a contact ring is its displacement [m]. The response of the anode is its
        charge [C], or its voltage [V] if the anode is open.
        """
        body = find_loaded_body(part, build.scene)
        rings = _list_loaded_rings(body, build.scene)
        meter, unit = ("anode", "V") if body.keys.electrical == "open" else ("charge", "C")
        result = {}
        for load in (*rings, "anode"):
            for ring in rings:
                node = build.get_inner_name(part, ring, load).lower()
                result[f"{load}>{ring}"] = PartResult(
                    f"v({node})", DISPLACEMENT.factor, DISPLACEMENT.unit
                )
            result[f"{load}>anode"] = PartResult(
                f"v({build.get_inner_name(part, meter, load).lower()})", 1.0, unit
            )
        return result

    def metrics(
        self, part: Part[PortLoadsKeys], build: BuiltScene, waves: Waveforms
    ) -> Mapping[str, object]:
        """Return the response amplitudes at all frequencies for each unit load.

        The metric ``amplitude[input][output]`` contains the amplitude of an output for a unit load
        on an input.
        """
        amplitude: dict[str, dict[str, Metric]] = {}
        vectors = build.records[part.name].vectors
        for name, response in waves.data.items():
            source, arrow, sink = name.partition(">")
            if arrow:
                row = amplitude.setdefault(source, {})
                row[sink] = Metric(np.abs(response).tolist(), vectors[name].unit)
        return {"frequency_hz": Metric(waves["frequency"].tolist(), "Hz"), "amplitude": amplitude}

    def checks(
        self, part: Part[PortLoadsKeys], build: BuiltScene, waves: Waveforms
    ) -> Iterator[Gate]:
        """Yield checks that compare errors of the responses to unit loads with their limits.

        The permitted errors include the tolerance of the model reduction.
        """
        gates, target = (
            build.scene.gates,
            find_loaded_body(part, build.scene).keys.rom or build.scene.rom,
        )
        rom = min(gates.harmonic_rom, target.tolerance or gates.harmonic_rom)
        limits = dict.fromkeys(SOLUTION_PAIRS, rom) | {"ngspice_vs_rom": gates.harmonic_ngspice}
        yield Gate("response, whole band", "*>*", limits, "spectral", is_main=True)
        low = {"rom_vs_fom": gates.harmonic_low}
        yield Gate("response, lowest fifth of the band", "*>*", low, "spectral", share=0.2)

    def figures(
        self, part: Part[PortLoadsKeys], build: BuiltScene, waves: Waveforms
    ) -> Iterator[Figure]:
        """Yield the figures of the part for the report."""
        f = waves["frequency"].real / 1e3
        rings = _list_loaded_rings(find_loaded_body(part, build.scene), build.scene)
        curves = tuple(Curve(ring, f, np.abs(waves[f"{ring}>{ring}"])) for ring in rings)
        panel = Panel("frequency in kHz", "|response| in m/N", curves, log_y=True)
        caption = "Displacement response of each contact ring to a unit force on the same ring."
        yield Figure(f"{part.name}_responses", "Frequency response", caption, (panel,))

    def law(
        self, part: Part[PortLoadsKeys], build: BuiltScene
    ) -> laws.Equations | laws.MissingEquations | None:
        """Return the model equations of copies of the body, each loaded at one port.

        A large voltage source in series with a very small capacitance applies a unit charge.
        """
        body = find_loaded_body(part, build.scene)
        equations = body.type.law(body, build)
        if not isinstance(equations, laws.Equations):
            return equations
        (law,) = equations.laws
        assert isinstance(law, laws.SecondOrderBody | laws.PortBody)
        rings, is_open = _list_loaded_rings(body, build.scene), body.keys.electrical == "open"
        result: list[laws.Law] = []
        nets: list[tuple[str, ...]] = []
        results: dict[str, laws.WaveCombination] = {}
        still = make_constant_waveform(0.0)
        for load in (*rings, "anode"):
            name = f"{body.name} {load}"  # with a space, the name differs from all part names
            result.append(replace(law, name=name))
            volts = laws.IdealSource(f"{name}_volts", "voltage", still, float(load == "anode"))
            if load != "anode":
                result.append(laws.IdealSource(f"{name}_force", "force", still, 1.0))
                nets.append((f"{name}.{load}", f"{name}_force.out"))
            if not is_open:
                result.append(volts)
                nets.append((f"{name}.anode", f"{name}_volts.out"))
            elif load == "anode":
                speck = make_element_law(f"{name}_speck", "capacitor", CHARGE_CAPACITANCE)
                result += [replace(volts, ac=1.0 / CHARGE_CAPACITANCE), speck]
                nets += [(f"{name}_volts.out", f"{name}_speck.a")]
                nets += [(f"{name}.anode", f"{name}_speck.b")]
            for ring in rings:
                results[f"{load}>{ring}"] = laws.scale_wave(f"{name}.{ring}")
            charge = laws.WaveCombination(((1.0, f"{name}.anode.through"),), charge=True)
            results[f"{load}>anode"] = laws.scale_wave(f"{name}.anode") if is_open else charge
        return laws.Equations(tuple(result), (), results, nets=tuple(nets))

    def notes(self, part: Part[PortLoadsKeys], scene: Scene) -> Iterator[str]:
        """Yield the assumptions of the model and the effects that it neglects."""
        keys = part.keys
        ends = " … ".join(format_quantity(f, "Hz") for f in (keys.start, keys.stop))
        yield f"{keys.steps} frequencies, {ends}"


def find_loaded_body(part: Part[PortLoadsKeys], scene: DeclaredScene) -> Part[PiezoStackKeys]:
    """Return the piezo stack on which the unit loads act.

    Raises
    ------
    UsageError : the key ``of`` is missing and the scene does not have exactly one body, or the body
        has no contact rings.
    """
    stacks = [other.name for other in scene.list_parts("piezo_stack")]
    hint = 'add the table [kick], which defines a piezo_stack, and write  of = "kick"'
    if stacks:
        hint = f'write  of = "{stacks[0]}"'
    if part.keys.of is not None:
        body = scene.get_part(part.keys.of, f"{part.name}.of")
        if not isinstance(body.keys, PiezoStackKeys):
            raise part.wrong(
                "of",
                "this part has no rings to load",
                got=f"{body.name}, a {body.type.name}",
                expected="the name of a part of type piezo_stack",
                hint=hint,
            )
        return body.with_schema(PiezoStackKeys)
    result = scene.bodies
    if len(result) != 1 or not isinstance(result[0].keys, PiezoStackKeys):
        got = ", ".join(list_names(result)) or "no body"
        raise part.wrong(
            "of",
            f"{part.name} does not state which piezo_stack it loads",
            got=got,
            expected="the name of a part of type piezo_stack",
            hint=hint,
        )
    return result[0].with_schema(PiezoStackKeys)


def _list_loaded_rings(body: Part, scene: WiredScene) -> tuple[str, ...]:
    """Return the names of the loaded rings of nodes on ``body``, which act as ports."""
    pins = scene.pins(body.name)
    return tuple(pin.name for pin in pins if pin.unit == DISPLACEMENT.pin_unit and pin.name != BASE)


register_part_type(PortLoads())
