"""Base class of parts with a reduced linear model, from meshes or matrices."""

from __future__ import annotations

import fnmatch
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from itertools import filterfalse
from typing import Any

import numpy as np

from kc2spice.core import constitutive_laws as laws
from kc2spice.core.errors import UsageError
from kc2spice.core.figure import Figure, FileWriter
from kc2spice.core.mesh_error_descriptions import (
    MESH_QUANTITIES,
    NOT_ESTIMATED,
    PLANE_UNKNOWN_RATIO,
)
from kc2spice.core.naming import list_names
from kc2spice.core.progress import StageTimer
from kc2spice.core.si_prefix_format import format_quantity
from kc2spice.core.user_warnings import warn_user
from kc2spice.core.waveforms import Waveforms
from kc2spice.parts.bodies import _body_figures
from kc2spice.parts.bodies._body_checks import STATE_FACTOR, BodyChecks
from kc2spice.parts.bodies._body_model import (
    BAND_MODES,
    describe_reduction_target,
    find_largest_loss_tangent,
    get_reduction_settings,
    has_complex_constants,
)
from kc2spice.parts.bodies._body_ports import select_paired_ports
from kc2spice.parts.bodies._linear_body_keys import LinearKeysT
from kc2spice.parts.bodies._varied_keys import list_varied_keys, read_key_values, with_values
from kc2spice.rom.linear_model import LinearModel
from kc2spice.rom.modal_models import compute_resonators
from kc2spice.scene.checks import Check, Metric
from kc2spice.scene.net_formation import find_short_circuit
from kc2spice.scene.part_records import LargestRealPartFrequency, NeglectedEffect
from kc2spice.scene.scene_classes import BuiltScene, Part, Scene
from kc2spice.scene.settings import ProbeKeys
from kc2spice.synthesis.mode_cards import COARSE_WEIGHTS

# A negative real part of an impedance below this fraction of the magnitude is a rounding error.
MAX_ACTIVE_SHARE = 1e-3
SENSITIVITY_STEP = 1e-2  # relative change of a key for the central difference of a metric


class LinearBody(BodyChecks[LinearKeysT]):
    """Base class of linear bodies, with metrics, figures and notes.

    Each base class of ``LinearBody`` covers one subject: ports, models, netlist or checks. A
    subclass derives the :meth:`ports` from the keys of the part, and builds the model of the whole
    device (:meth:`make_full_model`).
    """

    def metrics(
        self, part: Part[LinearKeysT], build: BuiltScene, waves: Waveforms
    ) -> Mapping[str, object]:
        """Return the metrics of the part, keyed by name."""
        response = compute_impedance(part, waves)
        if response is None:
            warn_of_zero_voltage(part, build.scene, waves)
            return {}
        from kc2spice.bodies.impedance import analyse_impedance

        frequency, z = response
        first = build.get_model_values(part).get("resonance_short_hz")
        plus, _ = select_paired_ports(build.model(part, LinearModel).ports)[0].terminals
        scope = find_impedance_scope(part, plus, build.scene)
        result = compute_impedance_metrics(part.name, frequency, z, first, scope)
        keys = list_varied_keys(part)
        if not keys or "bvd" not in result:
            return result
        # The sensitivities d ln(metric) / d ln(key) are central differences within the parameter
        # ranges.
        box = self.reduce_body_over_ranges(part, build.scene, StageTimer())
        port = select_paired_ports(box.ports)[0].name
        result["sensitivity"] = {}
        for key in keys:
            ends = np.clip(
                key.value * (1 + SENSITIVITY_STEP * np.array([-1, 1])), key.low, key.high
            )
            read = []
            for end in ends:
                model = box.evaluate(read_key_values(keys) | {key.key: float(end)})
                H = model.select([port]).transfer(frequency)[:, 0, 0]
                try:
                    read.append(
                        asdict(analyse_impedance(frequency, 1 / (2j * np.pi * frequency * H)))
                    )
                except UsageError:
                    warn_user(
                        f"{part.name}.{key.key}: the sensitivity is not computed, because the "
                        f"value {end:g} moves the resonance out of the band; use a wider "
                        f"frequency range"
                    )
                    break
            if len(read) < 2:
                continue
            change = math.log(ends[1] / ends[0])
            slopes = result["sensitivity"][key.netlist_parameter.name] = {}
            for name, low in read[0].items():
                if name != "bvd":
                    symbol = name.removesuffix("_hz").removesuffix("_f")
                    slopes[symbol] = math.log(read[1][name] / low) / change
        return result

    def main_metrics(
        self, part: Part[LinearKeysT], build: BuiltScene
    ) -> Mapping[str, ProbeKeys | LargestRealPartFrequency]:
        """Return the metric ``resonance_hz`` if a single source excites a resonance.

        At ``resonance_hz``, a voltage source at the first electrode delivers the largest current in
        phase with the voltage.
        """
        result = f"{part.name}.current"
        if build.scene.analysis.type != "ac" or result not in build.records[part.name].vectors:
            return {}
        return (
            {"resonance_hz": LargestRealPartFrequency(result)}
            if self._has_single_resonant_drive(part, build)
            else {}
        )

    def lightly_loaded_pins(self, part: Part[LinearKeysT], scene: Scene) -> set[str]:
        """Return the pins whose loads hardly change the resonances; none by default."""
        return set()

    def _has_single_resonant_drive(self, part: Part[LinearKeysT], build: BuiltScene) -> bool:
        """Return whether a single source drives the body and can excite a resonance."""
        from kc2spice.bodies.impedance import analyse_impedance

        scene, model = build.scene, build.model(part, LinearModel)
        pins = set(list_names(scene.pins(part.name))) - self.lightly_loaded_pins(part, scene)
        joined = {pin: scene.list_joined_pins(part.name, pin) for pin in pins}
        port = select_paired_ports(model.ports)[0]
        plus, minus = port.terminals
        ((name, _),) = joined.pop(plus)
        drive = scene.parts[name].type.law(scene.parts[name], build)
        sources = drive.laws if isinstance(drive, laws.Equations) else ()
        ideal = [law for law in sources if isinstance(law, laws.IdealSource) and law.ac.real > 0]
        if any(joined.values()) or scene.get_net(part.name, minus) != "0" or len(ideal) != 1:
            return False
        selected = scene.analysis
        if selected.start == 0.0:
            return False
        space = np.geomspace if selected.scale == "log" else np.linspace
        f = space(selected.start, float(selected.stop or 0.0), selected.points)
        Y = 2j * np.pi * f * model.select([port.name]).transfer(f)[:, 0, 0]
        try:
            resonance = analyse_impedance(f, 1 / Y).resonance_hz
        except UsageError:  # the frequency range contains no resonance
            return False
        largest = int(Y.real.argmax())
        return bool(f[max(largest - 1, 0)] <= resonance <= f[min(largest + 1, len(f) - 1)])

    def figures(
        self, part: Part[LinearKeysT], build: BuiltScene, waves: Waveforms
    ) -> Iterator[Figure | FileWriter]:
        """Yield the figures of the part for the report."""
        yield from _body_figures.plot_port_waves(part.name, waves)
        response = compute_impedance(part, waves)
        if response is not None:
            how = f"from the simulated voltage and current at {part.name}"
            f, z = response
            yield _body_figures.plot_impedances(
                part.name, f, {"": z}, how + _body_figures.IMPEDANCE_CAPTION
            )
            return
        yield from _body_figures.plot_responses(part.name, waves)
        model = build.model(part, LinearModel)
        yield from _body_figures.plot_port_impedances(part.name, model, compute_resonators(model))

    def notes(self, part: Part[LinearKeysT], scene: Scene) -> Iterator[str | NeglectedEffect]:
        """Yield the assumptions of the model and the effects that it neglects."""
        rom = get_reduction_settings(part, scene)
        used = self.used_ports(part, scene)
        ports = ", ".join(list_names(used))
        reach = (
            ""
            if self.find_least_band_end(part, scene) is None
            else f", or to natural frequency {BAND_MODES} if it is lower"
        )
        yield f"reduced model with {describe_reduction_target(rom)}{reach}"
        yield f"ports {ports}"
        unused = list_names(filterfalse(used.__contains__, self.ports(part, scene)))
        if unused:
            what = f"{part.name}: ports {', '.join(unused)}"
            why = "no part or probe uses them"
            if part.has_declared_ports:
                why = "not connected: a run omits them, an export includes them"
            yield NeglectedEffect(what, why, "none")
        if has_complex_constants(part):
            what = f"{part.name}: separate loss factors of shear and of piezoelectric constants"
            yield NeglectedEffect(
                what, "one Q factor for all compliances; d is real, as in IEEE 176", "not estimated"
            )
        elif tangent := find_largest_loss_tangent(part):
            what = f"{part.name}: effect of dielectric loss on its stiffness"
            why = "dielectric loss acts only on the clamped capacitance"
            yield NeglectedEffect(
                what,
                why,
                f"with open electrodes, a loss of {tangent:g} of the electric field energy",
            )
        yield from self.list_neglected_effects(part, scene)

    def list_neglected_effects(
        self, part: Part[LinearKeysT], scene: Scene
    ) -> Iterator[NeglectedEffect]:
        """Yield free ringing as a neglected effect if the time steps do not resolve it."""
        if self.weights(part, scene) == COARSE_WEIGHTS:
            why = "solver.ringing: time steps resolve ringing only while a force acts on the body"
            yield NeglectedEffect(
                f"free ringing of {part.name}", why, "up to 100 % of the ringing current and motion"
            )

    def prescribed_temperature_ports(
        self, part: Part[LinearKeysT], model: LinearModel
    ) -> Sequence[str]:
        """Return the ports with prescribed temperatures; none by default.

        The certificate of the model includes the responses to prescribed temperatures.
        """
        return ()

    def dimensions(self, part: Part[LinearKeysT]) -> int:
        """Return the number of spatial dimensions of the mesh."""
        return 3

    def estimate_mesh_growth(self, part: Part[LinearKeysT], old: float, new: float) -> float:
        """Estimate the ratio of the numbers of unknowns for two refinement factors."""
        return (new / old) ** self.dimensions(part)

    def compare_with_finer_mesh(
        self, part: Part[LinearKeysT], build: BuiltScene, clock: StageTimer, most: float
    ) -> Iterator[Check | str]:
        """Yield checks that resonances and other results hardly change on a finer mesh.

        The finer mesh has half the element size.
        """
        if not self.discretisations:
            return
        (key,), facts = self.discretisations, build.get_model_values(part)
        dimensions = self.dimensions(part)
        unknowns = facts.get("unknowns", 0.0) * STATE_FACTOR**dimensions
        most *= PLANE_UNKNOWN_RATIO if dimensions == 2 else 1.0
        cause = f"{unknowns:.0f} unknowns, more than {most:.0f}"
        finer = None
        if unknowns <= most:
            try:
                doubled = with_values(part, {key: STATE_FACTOR * _read_count(part, key)})
                with clock.time_stage(
                    "full model", f"{part.name}: mesh with half the element size"
                ):
                    finer = self.make_full_model(doubled, build.scene, clock).facts
            except UsageError as error:
                cause = str(error.message)
        if finer is None:
            mesh = self.describe_discretisation(part, build)
            yield f"{part.name}: no mesh with half the element size ({cause}); {mesh}"
            return
        for item in MESH_QUANTITIES.values():
            if item.warning_limit is None:
                continue
            names = fnmatch.filter(facts, item.value_names)
            changes = [abs(facts[name] / finer[name] - 1) for name in names if finer.get(name)]
            if changes:
                name = f"mesh of {part.name} with half the element size, {item.description}"
                label = (
                    f"mesh of {part.name}: relative error of the {item.description}, versus half "
                    "the element size"
                )
                yield Check(name, max(changes), item.warning_limit, "relative", label=label)

    def describe_discretisation(self, part: Part[LinearKeysT], build: BuiltScene) -> str:
        """Return the error estimate of the mesh, or the reason for a missing estimate."""
        return super().describe_discretisation(part, build) or f"mesh: {NOT_ESTIMATED}"


def _read_count(part: Part, key: str) -> int:
    """Return the integer value of a dotted key of the part, such as ``mesh.refine``."""
    value: Any = part.keys
    for name in key.split("."):
        value = getattr(value, name)
    return int(value)


def find_impedance_scope(part: Part, pin: str, scene: Scene) -> str:
    """Return the scope of an impedance: a part alone, or "" if a source is at its pin.

    Other parts between the source and the ``pin`` change the resonances of the circuit. The
    impedance of the part does not contain these other parts.
    """
    return "" if "source" in scene.list_joined_types(part.name, pin) else part.name


def compute_impedance_metrics(
    name: str,
    frequency: np.ndarray,
    impedance: np.ndarray,
    first: float | None = None,
    scope: str = "",
) -> dict[str, Any]:
    """Return the metrics of an impedance [Ohm], such as its resonance frequency.

    The metrics are the values that an impedance analyser would derive, and the impedance versus
    frequency. Without a resonance in the frequency range, the impedance versus frequency is the
    only metric, and a warning states the reason. ``frequency`` [Hz] and ``impedance`` [Ohm] are
    arrays of shape (frequencies,). ``name`` is the name of the part, and ``first`` [Hz] is its
    lowest resonance if known. ``scope`` is the name of the part if other parts between the part and
    its source change the resonances of the circuit.
    """
    from kc2spice.bodies.impedance import MIN_SAMPLES, analyse_impedance

    curve: dict[str, Any] = {
        "frequency_hz": Metric(frequency.tolist(), "Hz", curve=True),
        "impedance_ohm": Metric(np.abs(impedance).tolist(), "Ohm", curve=True),
    }
    try:
        return curve | _convert_to_metrics(asdict(analyse_impedance(frequency, impedance)), scope)
    except UsageError as error:  # the frequency range contains no resonance
        reason = error.message
        if frequency.size < MIN_SAMPLES:
            reason = f"they require at least {MIN_SAMPLES} frequencies; raise analysis.points"
        elif first is not None and not frequency[0] <= first <= frequency[-1]:
            above = first > frequency[-1]
            reason = (
                f"the first resonance, near {format_quantity(first, 'Hz')}, is "
                f"{'above' if above else 'below'} the frequency range; "
                f"{'raise analysis.stop' if above else 'lower analysis.start'}"
            )
        warn_user(f"{name}: the metrics of its resonance are missing: {reason}")
        return curve


def warn_of_zero_voltage(part: Part, scene: Scene, waves: Waveforms) -> None:
    """Warn about an ac analysis in which voltage and current of a part are zero.

    If the part is short-circuited, a warning about the short circuit is already printed.
    """
    if find_short_circuit(part, scene):
        return
    waveforms = [waves.data.get(f"{part.name}.{word}") for word in ("voltage", "current")]
    recorded = [wave for wave in waveforms if wave is not None]
    if "frequency" in waves and recorded and not any(wave.any() for wave in recorded):
        warn_user(
            f"{part.name}: the metrics of its impedance are missing: voltage and current are zero "
            f"at all frequencies; connect a source with the key `ac` to {part.name}"
        )


def _convert_to_metrics(figures: Mapping[str, Any], scope: str) -> dict[str, Any]:
    """Return the values of an impedance analysis as metrics with units and a scope."""
    from kc2spice.bodies.impedance import METRIC_UNITS

    result: dict[str, Any] = {}
    for name, value in figures.items():
        nested = isinstance(value, Mapping)
        result[name] = (
            _convert_to_metrics(value, scope)
            if nested
            else Metric(value, METRIC_UNITS.get(name, ""), scope=scope)
        )
    return result


def compute_impedance(part: Part, waves: Waveforms) -> tuple[np.ndarray, np.ndarray] | None:
    """Return frequencies [Hz] and impedances [Ohm] at the first electrical port.

    Both arrays have the shape (frequencies,). An impedance is ``V / I``, in which the voltage V and
    the current I are complex waveforms of the port. The frequency 0 Hz is left out, because the
    impedance of a capacitance is infinite there. The result is None if V or I was not recorded. The
    result is also None if the body supplies power, because V / I is then not the impedance of the
    body.
    """
    voltage = waves.data.get(f"{part.name}.voltage")
    current = waves.data.get(f"{part.name}.current")
    if "frequency" not in waves or voltage is None or current is None:
        return None
    frequency = waves["frequency"].real
    varies = frequency > 0
    frequency, voltage, current = frequency[varies], voltage[varies], current[varies]
    if not frequency.size or not np.abs(current).min() > 0:
        return None
    result = np.asarray(voltage / current)
    supplies = (result.real < -MAX_ACTIVE_SHARE * np.abs(result)).any()
    return None if supplies else (frequency, result)
