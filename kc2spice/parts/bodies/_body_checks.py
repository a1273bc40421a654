"""Checks of a linear part after a run: model error, band, rating and energy."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from kc2spice.core.cache import load_or_build
from kc2spice.core.domains import TRANSLATION, Domain
from kc2spice.core.errors import SimulationError, UsageError
from kc2spice.core.naming import list_names
from kc2spice.core.progress import StageTimer
from kc2spice.core.si_prefix_format import format_quantity
from kc2spice.core.waveforms import Waveforms, integrate_cumulatively
from kc2spice.fem.body_keys import DampingKeys
from kc2spice.netlist.number_and_name_spelling import LEAK_RATE
from kc2spice.parts.bodies._body_model import get_reduction_settings
from kc2spice.parts.bodies._body_netlist import BodyNetlist
from kc2spice.parts.bodies._body_ports import (
    get_flow_name,
    get_wave_name,
    list_contacts_on_part,
    select_mechanical_ports,
    select_paired_ports,
)
from kc2spice.parts.bodies._linear_body_keys import LinearKeysT
from kc2spice.rom.linear_model import Certificate, LinearModel, Port
from kc2spice.rom.modal_models import compute_resonators, simulate_resonators, tabulate_modes
from kc2spice.rom.stability import prove_stability
from kc2spice.scene.checks import Check, RunEnergyBalance
from kc2spice.scene.parttype import compute_pin_forces
from kc2spice.scene.scene_classes import BuiltScene, Part, Scene
from kc2spice.synthesis.mode_cards import COARSE_WEIGHTS

DEPOLING_ADVICE = "the ceramic depolarises or breaks down; lower the drive, or state another limit"
OUTSIDE_BAND_ADVICE = "the reduced model has no error estimate above its band: set {band}"
# Recommended factor on the number of states of a model with too large an error.
STATE_FACTOR = 2
# Relative error estimates of a reduced model above which a run fails or prints a warning.
FAILURE_ERROR = 0.1
WARNING_ERROR = 0.01
# Largest permitted relative error of a port's compliance above the band.
# If a body in contact exceeds this error, the reduced model is checked under the loads of the run.
# In the built-in kick scenes, such as ``kick_slew``, the relative error of a port's compliance is
# at most 0.20.
# Under the loads of a run, the reduced models of the built-in kick scenes have rms errors below
# 0.3 %.
# Reduced models of small piezoelectric chips with only 7 to 12 states have a relative error of at
# least 0.53 in a port's compliance.
# In transient runs with a contact, reduced models of small piezoelectric chips with 7 to 12 states
# have errors of 2 to 3 %.
MAX_COMPLIANCE_ERROR = 0.3
REDUCED_ADVICE = "the reduced model of order {} is too inaccurate in its band: {}"
LOADED_UNIT = "rms of displacement or charge, under the loads of the run"
FEWER_STATES_ADVICE = (
    "under the loads of the run, the reduced model has this error relative to a model with {} "
    "states: set {}"
)
RESONANCE_ADVICE = (
    "the reduced model has this error at some frequency in its band, for example at a sharp "
    "resonance; free ringing after the loads have ended drifts out of phase: if this ringing "
    "matters, set rom.tolerance or a larger rom.order"
)
UNSTABLE_BODY_ADVICE = (
    "the body has unstable modes: check the signs of its matrices, and that the upper and lower "
    "triangles of each matrix are present"
)
UNSTABLE_FULL_ADVICE = (
    "the full model has unstable modes, and the reduced model does not contain them"
)
STEEP_EDGE_ADVICE = (
    "the current during a voltage edge is inaccurate: set {band}, which adds states to the model, "
    "or set the actual rise time of the drive"
)
CONTACT_ADVICE = (
    "a contact excites modes of the body that the reduced model lacks: set {band}, which adds "
    "states to the model"
)
BAND_MARGIN = 1.1  # ratio of the upper end of a proposed band to the required frequency
# Smallest ratio of the upper end of the band to the lowest resonance frequency.
# A band that ended below 1.5 times the lowest resonance caused an error of 2 % in a kick scene.
MIN_BAND_RATIO = 1.5
# Time points count as equal if their distance is below this fraction of the run's duration.
EQUAL_TIME_TOLERANCE = 1e-9
# Ratio of two natural frequencies up to which a stated Q factor applies to both modes. With viscous
# damping, the Q factor of the higher mode is at least 1 / 1.1 of the stated Q factor.
SAME_DAMPING_RATIO = 1.1
# Ratio of coupling factors above which the voltage drives one mode much more than another mode.
STRONG_COUPLING_RATIO = 3.0
# smallest coupling factor of a mode with a visible resonance in the impedance
VISIBLE_COUPLING = 0.01
# largest fraction of a floating electrode's charge that may leak away in the netlist
MAX_CHARGE_LOSS = 1e-4
# Largest permitted error of a body's energy balance, relative to the change of the stored energy.
# The limit is as large as 10 %, because the integration errors of ngspice are large if a small
# piezoelectric chip rings at frequencies of up to 30 MHz.
MAX_STORED_SHARE = 0.1
# A force or energy counts as zero if it is below this fraction of its largest value.
# The rounding errors of forces and energies are far below this fraction.
ZERO_LOAD = 1e-9
# Largest change of a constant voltage due to rounding errors, relative to the voltage.
ROUNDING_SHARE = 1e-12


class BodyChecks(BodyNetlist[LinearKeysT]):
    """Base class of linear parts that checks reduction, rating and energy balance."""

    def checks(
        self, part: Part[LinearKeysT], build: BuiltScene, waves: Waveforms
    ) -> Iterator[Check | RunEnergyBalance]:
        """Yield the checks of a reduced body after a run.

        The checks cover the error of the reduced model, the stability of the full model, the
        frequency band and the voltage rating. After a transient, the checks also cover the energy
        balance, the frequencies of the excitation and the charge of floating electrodes.
        """
        model = build.model(part, LinearModel)
        result = model.certificate
        if result is not None:
            yield from self._check_reduction(part, build, waves, result)
            if result.stable is False:
                full_is_stable = prove_stability(model.pencil.make_dense(), result.band_hz).stable
                advice, then = (
                    (UNSTABLE_FULL_ADVICE, "fail")
                    if full_is_stable
                    else (UNSTABLE_BODY_ADVICE, "warn")
                )
                yield Check(f"stability of {part.name}", 1.0, 0.0, "", advice, then)  # type: ignore[arg-type]
        if result is not None and "frequency" in waves:
            highest = float(waves["frequency"].real.max())
            # the factor 1 + 1e-9 allows for the rounding error of the highest frequency
            limit = (1 + 1e-9) * result.band_hz[1]
            name, label = f"band of {part.name}", f"highest analysis frequency, {part.name}"
            advice = OUTSIDE_BAND_ADVICE.format(
                band=_propose_band(part, build.scene, result, highest)
            )
            yield Check(name, highest, limit, "Hz", advice, "warn", label=label)
        yield from self._check_rating(part, build, waves)
        yield from self._check_damping_frequency(part, model, waves)
        if "time" not in waves:
            return
        if (balance := self._balance_energy(part, build, waves)) is not None:
            yield balance
        if result is not None:
            yield from self._check_band(part, build, waves, result)
        yield from self._check_leak(part, build)

    def _check_rating(
        self, part: Part[LinearKeysT], build: BuiltScene, waves: Waveforms
    ) -> Iterator[Check]:
        """Yield checks that the voltage at each electrode does not exceed the rating.

        In an ac analysis, the checked voltage is the amplitude that the sources of the scene cause
        at the electrode.
        """
        volts, ports = self.rated_voltage(part, build), self.used_ports(part, build.scene)
        if volts is None:
            return
        for port in ports:
            name = get_wave_name(part.name, ports, port)
            if port.is_paired and f"{name}.voltage" in waves:
                largest = float(np.abs(waves[f"{name}.voltage"]).max())
                yield Check(
                    f"rating of {name}",
                    largest,
                    volts,
                    "V",
                    DEPOLING_ADVICE,
                    "warn",
                    label=f"peak voltage of {name}",
                )

    def _check_damping_frequency(
        self, part: Part[LinearKeysT], model: LinearModel, waves: Waveforms
    ) -> Iterator[Check]:
        """Yield a warning if the damping frequency is that of a weakly coupled mode.

        The mode with the largest electrical coupling factor in the analysed band is compared with
        the first mode, at which the stated damping applies. The method yields a violated check if
        the first mode is outside of the analysed band. The method also yields a violated check if
        the coupling factor of the first mode is much smaller than the largest coupling factor.
        """
        damping = getattr(part.keys, "damping", None)
        key = damping.key_at_first_resonance if isinstance(damping, DampingKeys) else ""
        first = model.facts.get("resonance_short_hz", model.facts.get("resonance_hz"))
        electrodes = [port.name for port in model.ports if port.electrical]
        moves = "frequency" in waves or "time" in waves
        table = tabulate_modes(model) if key and first and electrodes and moves else None
        if table is None or first is None:
            return
        low, high = 0.0, math.inf
        if "frequency" in waves:
            low, high = waves["frequency"].real.min(), waves["frequency"].real.max()

        def find_coupling(mode: Mapping[str, Any]) -> float:
            """Return the largest coupling factor of a mode to an electrode."""
            return max(map(mode["couplings"].__getitem__, electrodes))

        inside = [mode for mode in table["modes"] if low <= mode["frequency_hz"] <= high]
        if not inside:
            return
        strongest = max(inside, key=find_coupling)
        ratio, size = strongest["frequency_hz"] / first, find_coupling(strongest)
        nearest = min(table["modes"], key=lambda mode: abs(mode["frequency_hz"] - first))
        largest = STRONG_COUPLING_RATIO * find_coupling(nearest)
        is_strongest = low <= first <= high and size <= largest
        if is_strongest or ratio <= SAME_DAMPING_RATIO or size < VISIBLE_COUPLING:
            return
        quality, frequency = strongest["quality"], strongest["frequency_hz"]
        at, applied = format_quantity(frequency, "Hz", 4), format_quantity(first, "Hz", 4)
        q_factor = f"a Q factor of {quality:.3g}" if quality else "no damping"
        advice = (
            f"{part.name}.damping.{key} applies to the mode at {applied}, but voltages in the "
            f"analysed band most strongly excite the mode at {at}, which has {q_factor}: "
            f'set {part.name}.damping.at = "{at}" if {key} is meant for this mode'
        )
        yield Check(
            f"damping of {part.name}",
            ratio,
            SAME_DAMPING_RATIO,
            "times the frequency for which the damping is stated",
            advice,
            "warn",
            label=f"frequency ratio, damping of {part.name}",
        )

    def _check_leak(self, part: Part[LinearKeysT], build: BuiltScene) -> Iterator[Check]:
        """Yield the check of the charge that leaks from each floating electrode.

        In the netlist, the charge of a floating electrode decays at the rate :data:`LEAK_RATE`.
        """
        leaked = -math.expm1(-build.scene.stop_time * LEAK_RATE)
        ports = list_names(select_paired_ports(build.model(part, LinearModel).ports))
        for port in ports if leaked > MAX_CHARGE_LOSS else ():
            name = f"charge lost by {part.name}.{port} if it floats"
            advice = (
                "the netlist contains an assumed leakage resistance: add a resistor with the real "
                "leakage resistance at the electrode"
            )
            yield Check(name, leaked, MAX_CHARGE_LOSS, "of the charge", advice, "warn")

    def _check_reduction(
        self, part: Part[LinearKeysT], build: BuiltScene, waves: Waveforms, certificate: Certificate
    ) -> Iterator[Check]:
        """Yield the check of the reduced model's error.

        The check limits the error at the worst frequency of the band. After a transient, the error
        under the recorded loads is checked instead in two cases: the error in the band is too
        large, or a contact excites modes above the band.

        An error in the band that occurs only at a sharp resonance may have no effect under the
        recorded loads. For loads with frequencies above the band, the error can be larger than the
        error in the band. To compute the error under load, the reduced model and a model with more
        states are driven by the recorded forces and voltages. The error under load is the
        difference between the responses of both models.
        """
        name, error = part.name, certificate.error_estimate
        unlike = max((size for _, size in certificate.above), default=0.0) > MAX_COMPLIANCE_ERROR
        contact = unlike and any(list_contacts_on_part(part, build.scene))
        loaded = None
        if "time" in waves and (error > FAILURE_ERROR or contact):
            loaded = self.estimate_error_under_load(
                part, build, waves, build.model(part, LinearModel)
            )
        if loaded is None:
            advice = self._advise_reduction(part, build)
            yield _make_reduction_check(name, error, "of a response", advice)
            return
        worst, states = loaded
        model, target = build.model(part, LinearModel), get_reduction_settings(part, build.scene)
        order = STATE_FACTOR * (target.order or model.order)
        default = (
            self._find_reduction_settings(part, build.scene) is None and not part.parameter_ranges
        )
        key = f"{_locate_reduction_table(part, build.scene)}.order"
        advice = FEWER_STATES_ADVICE.format(states, f"{key} = {order}")
        check = _make_reduction_check(name, worst, LOADED_UNIT, advice)
        more = {key: order, f"{name}.rom.band": list(certificate.band_hz)} if default else {}
        yield replace(check, suggested=more, loaded=True)
        yield Check(
            f"resonances of {name}",
            error,
            WARNING_ERROR,
            "of a response",
            RESONANCE_ADVICE,
            "warn",
            label=f"error of the reduced model of {name} in its band",
        )

    def _advise_reduction(self, part: Part[LinearKeysT], build: BuiltScene) -> str:
        """Return the advice for a body whose reduced model is too inaccurate in its band."""
        model, target = build.model(part, LinearModel), get_reduction_settings(part, build.scene)
        key = _locate_reduction_table(part, build.scene)
        action = f"lower {key}.tolerance"
        if target.order is not None:
            action = f"delete {key}.order, so that {key}.tolerance determines the number of states"
        return REDUCED_ADVICE.format(model.order, action)

    def estimate_error_under_load(
        self, part: Part[LinearKeysT], build: BuiltScene, waves: Waveforms, model: LinearModel
    ) -> tuple[float, int] | None:
        """Estimate the error of the reduced ``model`` under the recorded loads of a run.

        The first returned value is the largest relative rms error of all outputs up to the last
        change of the loads. The second returned value is the number of states of the reference
        model. The result is None if a load was not recorded, or if no model with more states
        exists.
        """
        loads, certificate = self.list_port_loads(part, build, waves), model.certificate
        if certificate is None or not set(model.inputs) <= loads.keys():
            return None
        band = certificate.band_hz
        from kc2spice.rom.time_domain_errors import compute_time_errors, find_last_change

        t, load = waves["time"], np.column_stack([*map(loads.__getitem__, model.inputs)])
        count = find_last_change(load) + 1
        key = {**self.model_key(part, build.scene), "enriched": model.order}

        def build_larger_model() -> LinearModel | None:
            """Build a reduced model with more states; return None if no such model exists."""
            if self._has_constant_loss_factors(part):
                return None
            try:
                return self.get_reductions_by_order(
                    part, build.scene, StageTimer()
                ).make_enriched_model(key["enriched"], band)
            except (SimulationError, UsageError):
                return None

        kinds = (LinearModel, Certificate, Port)
        rich = load_or_build(
            "enriched", key, build_larger_model, classes=kinds, sources=self.source_modules()
        )
        if rich is None or count < 2:
            return None
        driven = [port for port in model.ports if port.kind != "output"]
        groups = dict[Domain | None, np.ndarray]()
        for k, port in enumerate(driven):
            domain = port.domain if port.has_charge_output else None
            groups.setdefault(domain, np.zeros(len(driven), dtype=bool))[k] = True
        errors = compute_time_errors(model, rich, t[:count], load[:count], [*groups.values()])
        return None if errors is None else (max(errors.values(), default=0.0), rich.order)

    def _check_band(
        self, part: Part[LinearKeysT], build: BuiltScene, waves: Waveforms, certificate: Certificate
    ) -> Iterator[Check]:
        """Yield checks that the drive frequencies lie within the model's band.

        The frequency of a drive voltage v is computed as ``max |v'| / (pi (max v - min v))``. For a
        sinusoidal drive voltage v, ``max |v'| / (pi (max v - min v))`` is the frequency of the
        sine. For a voltage edge, the computed frequency is about a third of the reciprocal of the
        edge time. In a scene with a contact, the function only checks that the band contains the
        first resonance. A contact excites the first resonance more than any drive voltage does.
        """
        scene, t, high = build.scene, waves["time"], certificate.band_hz[1]
        rows = scene.numerics
        if any(row.overrides_others for row in rows):
            lowest = build.model(part, LinearModel).facts.get("resonance_short_hz")
            if lowest is not None:
                yield Check(
                    f"band of {part.name}, first resonance",
                    MIN_BAND_RATIO * lowest,
                    high,
                    "Hz",
                    CONTACT_ADVICE.format(
                        band=_propose_band(part, scene, certificate, MIN_BAND_RATIO * lowest)
                    ),
                    "warn",
                    label=f"band required by the contact, {part.name}",
                )
            return
        apart = np.diff(t) > EQUAL_TIME_TOLERANCE * t[-1]
        for port in self.used_ports(part, scene):
            if not port.is_paired or not apart.any():
                continue
            name = get_wave_name(part.name, build.model(part, LinearModel).ports, port)
            voltage = waves.data.get(f"{name}.voltage")
            # a constant voltage changes only by rounding errors
            if voltage is None or np.ptp(voltage) <= ROUNDING_SHARE * np.abs(voltage).max():
                continue
            slope = np.abs(np.diff(voltage)[apart] / np.diff(t)[apart]).max()
            name = f"band of {part.name}, drive of {port.name}"
            content = float(slope / (np.pi * np.ptp(voltage)))
            label = f"frequency content, {part.name}.{port.name}"
            advice = STEEP_EDGE_ADVICE.format(band=_propose_band(part, scene, certificate, content))
            yield Check(name, content, high, "Hz", advice, "warn", label=label)

    def list_port_loads(
        self, part: Part[LinearKeysT], build: BuiltScene, waves: Waveforms
    ) -> dict[str, np.ndarray]:
        """Return the load of each port versus time or frequency, in SI units.

        A load is a voltage, an acceleration, or the sum of the forces of all parts that are
        connected to the port. Ports with an unrecorded force are left out.
        """
        ports, result = self.used_ports(part, build.scene), dict[str, np.ndarray]()
        names = [get_wave_name(part.name, ports, port) for port in ports]
        still, acting = np.zeros(waves.scale.size), compute_pin_forces(build, waves)
        for name, port in zip(names, ports, strict=True):
            if not port.is_flow_driven:
                wave = f"{name}.voltage" if port.is_paired else name
                result[port.name] = waves.data.get(wave, still)
                continue
            joined = build.scene.list_joined_pins(part.name, port.terminals[0])
            if acting.keys() >= set(joined) and build.get_net(part, port.terminals[0]) != "0":
                result[port.name] = sum(map(acting.__getitem__, joined), start=still)
        return result

    def _balance_energy(
        self, part: Part[LinearKeysT], build: BuiltScene, waves: Waveforms
    ) -> RunEnergyBalance | None:
        """Return a body's energy balance in a run, with losses computed from the loads.

        The exact response is the response of the reduced model to the recorded loads. The losses
        are the work of the loads minus the increase of the stored energy, both computed from the
        exact response. If the current of the body is among the waveforms, the electrical work is
        computed from this current. The balance is relative to the largest change of the stored
        energy. If the stored energy is constant, the balance is relative to the rounding error of
        the stored energy. If the time steps do not resolve the ringing, the comparison stops at the
        end of the last force on the body.
        """
        model, t = compute_resonators(build.model(part, LinearModel)), waves["time"]
        ports = self.used_ports(part, build.scene)
        if model is None or not all(p.has_charge_output or p.domain is TRANSLATION for p in ports):
            return None
        loads = self.list_port_loads(part, build, waves)
        if len(loads) < len(model.ports):
            return None
        inputs = np.column_stack([*map(loads.__getitem__, list_names(model.ports))])
        outputs, stored = simulate_resonators(model, t, inputs)
        entries: dict[str, float] = {}
        answers: dict[str, tuple[np.ndarray, np.ndarray]] = {}
        gap, damped = np.zeros(t.size), stored[0] - stored
        for port, load, exact in zip(model.ports, inputs.T, outputs.T, strict=True):
            took, name = (
                integrate_cumulatively(load, exact),
                get_wave_name(part.name, model.ports, port),
            )
            damped = damped + took
            if port.has_charge_output and port.domain is not None:
                what, result = f"{port.domain.name} work", took
                current = waves.data.get(get_flow_name(part.name, model.ports, port))
                if current is not None:
                    result = integrate_cumulatively(load * current, t)
                    answers[f"charge of {name}"] = (
                        integrate_cumulatively(current, t) + exact[0],
                        exact,
                    )
            else:
                what, result = "work of the contact", integrate_cumulatively(load, waves[name])
                answers[name] = waves[name], exact
            entries[what] = entries.get(what, 0.0) + float(result[-1])
            gap += result - took
        entries |= {"stored": float(stored[-1]), "damped": float(damped[-1])}
        if pressed := self.weights(part, build.scene) == COARSE_WEIGHTS:
            forces = [*map(loads.__getitem__, list_names(select_mechanical_ports(model.ports)))]
            largest = np.abs(forces).max(axis=0, initial=0.0)
            last = np.flatnonzero(largest > ZERO_LOAD * largest.max(initial=0.0)).max(initial=0)
            gap = gap[: int(last) + 1]
        scale = max(float(np.ptp(stored)), ZERO_LOAD * float(stored.max()))
        exactly = {} if pressed else answers
        return RunEnergyBalance(
            entries, float(np.abs(gap).max()), scale, MAX_STORED_SHARE, exact=exactly
        )


def _locate_reduction_table(part: Part[LinearKeysT], scene: Scene) -> str:
    """Return the key of the table with the reduction settings: of the scene or of the body."""
    shared = part.keys.rom is None and "rom" in scene.frame.model_fields_set
    return "rom" if shared else f"{part.name}.rom"


def _propose_band(
    part: Part[LinearKeysT], scene: Scene, certificate: Certificate, frequency: float
) -> str:
    """Return the setting of a band that contains a frequency [Hz] with a margin."""
    unit = 10.0 ** (math.floor(math.log10(frequency)) - 1)  # two significant digits
    high = math.ceil(BAND_MARGIN * frequency / unit) * unit
    ends = (format_quantity(end, "Hz", 3) for end in (certificate.band_hz[0], high))
    quoted = ", ".join(map('"{}"'.format, ends))
    return f"{_locate_reduction_table(part, scene)}.band = [{quoted}]"


def _make_reduction_check(name: str, error: float, unit: str, advice: str) -> Check:
    """Return the check that limits the error of a reduced model."""
    limit, action = (FAILURE_ERROR, "fail") if error > FAILURE_ERROR else (WARNING_ERROR, "warn")
    return Check(
        f"reduction of {name}",
        error,
        limit,
        unit,
        advice,
        action,  # type: ignore[arg-type]
        label=f"error of the reduced model of {name}",
    )
