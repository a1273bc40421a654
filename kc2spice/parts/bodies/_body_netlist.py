"""Subcircuit, result vectors and model equations of a linear part."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import chain
from typing import Any

from kc2spice.core import constitutive_laws as laws
from kc2spice.core.progress import StageTimer
from kc2spice.core.untrusted_files import make_identifier
from kc2spice.netlist.number_and_name_spelling import format_voltage
from kc2spice.netlist.subcircuit_library import Header, Subcircuit
from kc2spice.parts.bodies._body_model import BodyModel
from kc2spice.parts.bodies._body_ports import get_flow_name, get_wave_name, select_paired_ports
from kc2spice.parts.bodies._linear_body_keys import LinearKeysT
from kc2spice.parts.bodies._varied_keys import list_varied_keys
from kc2spice.physics.loss_heat import add_loss_heat, list_heat_vectors
from kc2spice.rom.linear_model import LinearModel
from kc2spice.rom.modal_models import compute_resonators
from kc2spice.rom.pencil import convert_to_first_order
from kc2spice.scene.part_records import PartResult
from kc2spice.scene.parttype import find_current_into, find_flow_into
from kc2spice.scene.scene_classes import BuiltScene, DeclaredScene, Part, Scene
from kc2spice.synthesis.heat_netlist import diagonalise_heat_model, is_heat_model
from kc2spice.synthesis.heat_sources import METER
from kc2spice.synthesis.mode_cards import COARSE_WEIGHTS, RINGING_WEIGHTS, StepWeights
from kc2spice.synthesis.model_to_subcircuit import UNRATED, subcircuit

RATING_TEXT = (
    "the electrodes, from rated_voltage or the field limit of the ceramic; not enforced here"
)
# largest number of characters of a library name that consists of scene and part name
_MAX_NAME_LENGTH = 47


class BodyNetlist(BodyModel[LinearKeysT]):
    """Base class of bodies that adds their netlist, result vectors and equations."""

    noise = ("Rnoise",)
    # temperature of the material data, for the header of the library
    data_temperature = "20 to 25 C for built-in materials"

    def weights(self, part: Part[LinearKeysT], scene: DeclaredScene) -> StepWeights:
        """Return the weights of the body's modes in the simulator's time step control.

        If the time steps need not resolve the free ringing of the body, the weights are
        ``COARSE_WEIGHTS``.
        """
        return COARSE_WEIGHTS if scene.solver.ringing == "coarse" else RINGING_WEIGHTS

    def subcircuit_name(self, part: Part[LinearKeysT], scene: Scene) -> str:
        """Return the name of the subcircuit: its part number, or scene and part name."""
        scene_name = self.make_library_name(part, scene)
        if not part.keys.number:
            return scene_name
        number = make_identifier(part.keys.number, part.name)
        return f"heated_{number}" if self.gives_off_heat(part, scene) else number

    def make_library_name(self, part: Part[LinearKeysT], scene: Scene) -> str:
        """Return a library name that joins the scene name and the part name.

        The library name is unique in a folder with the libraries of several scenes.
        """
        name = f"{scene.name[: _MAX_NAME_LENGTH - len(part.name)]}_{part.name}"
        return make_identifier(name, part.name)

    def subcircuits(
        self, part: Part[LinearKeysT], build: BuiltScene, header: Header
    ) -> tuple[Subcircuit, ...]:
        """Return the subcircuit of the part, as a tuple of length 1."""
        name = build.libraries[part.name]
        volts = self.rated_voltage(part, build)
        rating = f"{volts:.4g} V between {RATING_TEXT}" if volts else UNRATED
        if not volts and select_paired_ports(build.model(part, LinearModel).ports):
            rating += "; with the key rated_voltage, a run warns about higher voltages"
        words: dict[str, Any] = {"title": self.headline(part), "rating": rating}
        words |= {"weights": self.weights(part, build.scene), "temperature": self.data_temperature}
        if keys := list_varied_keys(part):
            from kc2spice.synthesis.parametric_resonators import parametric_subcircuit

            result = self.reduce_body_over_ranges(part, build.scene, StageTimer())
            known = {item.key: item.netlist_parameter for item in keys}
            params = [*map(known.__getitem__, result.parameter_axes)]
            return (parametric_subcircuit(result, name, params, header, **words),)
        return (
            subcircuit(
                build.model(part, LinearModel),
                name,
                header,
                **words,
                noise=build.has_noise,
                heat=self.gives_off_heat(part, build.scene),
            ),
        )

    def vectors(self, part: Part[LinearKeysT], build: BuiltScene) -> Mapping[str, PartResult]:
        """Return the ngspice vectors: expressions of the part's results, keyed by name."""
        result: dict[str, PartResult] = {}
        ports = self.used_ports(part, build.scene)
        for port in ports:
            name, node = (
                get_wave_name(part.name, ports, port),
                build.get_net(part, port.terminals[0]),
            )
            if port.is_paired:
                plus, minus = port.terminals
                across = format_voltage(build.get_net(part, plus), build.get_net(part, minus))
                if across:
                    result[f"{name}.voltage"] = PartResult(across, 1.0, "V")
                if (meter := find_current_into(part, port.terminals[0], build)) is not None:
                    result[f"{name}.current"] = meter
            elif node != "0":
                known = None if port.domain is None else port.domain.across
                factor, unit = (known.factor, known.unit) if known else (1.0, port.across)
                result[name] = PartResult(f"v({node})", factor, unit)
                flow = (
                    find_flow_into(part, port.terminals[0], build)
                    if port.has_charge_output
                    else None
                )
                if flow is not None:
                    result[get_flow_name(part.name, ports, port)] = flow
        if self.gives_off_heat(part, build.scene):
            result |= list_heat_vectors(part, build, METER)
        return result

    def law(
        self, part: Part[LinearKeysT], build: BuiltScene
    ) -> laws.Equations | laws.MissingEquations:
        """Return the part's law: its model equations, or the reason why it has none."""
        model = build.model(part, LinearModel)
        ports, n, heated = model.ports, part.name, self.gives_off_heat(part, build.scene)
        heat, last = is_heat_model(model), self.reference_terminal(part, build.scene).name
        if build.get_net(part, last) != "0" and not heat:
            return laws.MissingEquations(f"its reference pin {last} is not connected to ground")
        pins = []
        for port in ports:
            kind = port.domain.name if port.domain else port.kind
            pins.append(
                laws.LawPort(port.name, kind, last if heat else "".join(port.terminals[1:]))
            )
        law_ports = tuple(pins)
        conservative = {port.conservative for port in ports}
        signals, mixed = True not in conservative, False in conservative
        if not signals and mixed:
            return laws.MissingEquations("it has both signal ports and ports of forces or currents")
        if not signals and model.first_order != heat:
            return laws.MissingEquations("its equations are of first order, without inertia")
        law: laws.Law
        modal = None
        if not model.pencil.is_dense:
            law = laws.PortBody(n, model, law_ports)
        elif signals:
            A = convert_to_first_order(model.pencil.make_dense(), 1.0)
            rest, E = A.coefficients
            law = laws.SignalBlock(n, E, -rest, A.B, A.C, A.D, model.inputs, model.outputs)
        elif heat:
            law = laws.SecondOrderBody(n, diagonalise_heat_model(model), law_ports)
        else:
            modal = compute_resonators(model)
            law = laws.SecondOrderBody(
                n, model if modal is None else modal.to_linear_model(), law_ports
            )
        joins = [(port.terminals[0], f"{n}.{port.name}") for port in ports]
        for pin in chain.from_iterable(port.terminals[1:] for port in ports):
            joins.append((pin, f"{n}.{pin}"))
        joins += [(last, f"{n}.{last}")] * heat
        # combinations of waveforms, keyed by result name
        results: dict[str, laws.WaveCombination] = {}
        for port in ports:
            mine, name = f"{n}.{port.name}", get_wave_name(n, ports, port)
            if port.is_paired:
                results[f"{name}.voltage"] = laws.subtract_waves(mine, f"{n}.{port.terminals[1]}")
            else:
                results[name] = laws.scale_wave(mine)
            if port.has_charge_output:
                results[get_flow_name(n, ports, port)] = laws.scale_wave(f"{mine}.through")
        result = laws.Equations((law,), tuple(joins), results)
        if not heated:
            return result
        if isinstance(law, laws.SecondOrderBody) and modal is not None:
            return add_loss_heat(result, law)
        return laws.MissingEquations(
            "the heat dissipated in modes that are coupled by damping is not computed"
        )
