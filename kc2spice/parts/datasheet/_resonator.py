"""Resonators as Butterworth-Van Dyke circuits.

Data sheets of piezoelectric ceramics and crystals use Butterworth-Van Dyke circuits. A clamped
capacitance ``c0`` is in parallel with a series branch of ``lm``, ``cm`` and ``rm`` for each mode.
The admittance is

    Y(s) = s c0 + sum_n s cm_n / (1 + s rm_n cm_n + s^2 lm_n cm_n)

(K. S. Van Dyke, Proc. IRE 16 (1928) 742; IEEE Std 177-1966). Each part type defines its keys as
functions of the circuit elements. The module :mod:`._stated_values` computes circuit elements whose
properties equal the data-sheet values in the keys.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from pydantic import Field

from kc2spice.core import constitutive_laws as laws
from kc2spice.core.domains import HEAT, HEAT_PINS
from kc2spice.core.figure import Figure
from kc2spice.core.naming import list_names
from kc2spice.core.quantities import Section, Voltage
from kc2spice.core.si_prefix_format import format_quantity
from kc2spice.core.untrusted_files import make_identifier
from kc2spice.core.waveforms import Waveforms, average_over_window, integrate_cumulatively
from kc2spice.netlist.circuit import Circuit, Element, Item, Param, Parameters, Pin
from kc2spice.netlist.number_and_name_spelling import LEAK_RATE, format_comment
from kc2spice.netlist.scale_factors import abbreviate_number
from kc2spice.netlist.shared_cards import (
    STOP_COMMENT,
    attach_comments,
    list_range_conditions,
    write_condition_stops,
)
from kc2spice.netlist.subcircuit_library import Header, Subcircuit
from kc2spice.parts.datasheet._stated_values import Relation
from kc2spice.physics.conductors import HEAT_TERMINALS, OPTIONAL_HEAT_PINS, is_heated
from kc2spice.physics.loss_heat import add_loss_heat, list_heat_vectors
from kc2spice.scene.checks import Check, RunEnergyBalance
from kc2spice.scene.part_records import EquilibriumConditions, NeglectedEffect, PartResult
from kc2spice.scene.scene_classes import (
    BuiltScene,
    GovernedScene,
    JoinedScene,
    KeysT,
    Part,
    PartType,
    Scene,
    Terminal,
    WiredScene,
)
from kc2spice.scene.settings import PartNumber
from kc2spice.synthesis.heat_sources import (
    HEAT_PIN_ROWS,
    METER,
    write_heat_meter,
    write_heat_source,
)

if TYPE_CHECKING:
    from kc2spice.rom.linear_model import LinearModel

TWO_PI = 2 * math.pi
MAX_BALANCE_ERROR = 0.02  # largest permitted energy error, relative to the energy exchanged
# Smallest peak-to-peak voltage [V] of a part whose energy balance is checked after a run.
# The value is the default ``vntol`` of ngspice.
SMALLEST_VOLTAGE = 1e-6
RATING_ADVICE = "the data sheet does not permit this voltage: lower the drive"


class PartNumberKeys(Section):
    """Base class of data-sheet keys with the key ``number``, the part number."""

    number: PartNumber | None = Field(
        None,
        description=(
            "Part number (text), also the name of the exported library; by default the part type"
        ),
    )


class RatedKeys(PartNumberKeys):
    """Base class for the keys of electrical parts with a rated voltage."""

    rated_voltage: Voltage | None = Field(
        None,
        gt=0,
        description=(
            "Largest permitted voltage between the pins; a run warns about a higher voltage. By "
            "default the voltage is not checked"
        ),
    )


@dataclass(frozen=True)
class Resonator:
    """Circuit elements of a resonator in SI units.

    The elements are the clamped capacitance ``c0``, and for each mode the series resonance
    frequency ``fs``, the motional capacitance ``cm`` and the motional resistance ``rm``.
    """

    c0: float
    fs: tuple[float, ...]
    cm: tuple[float, ...]
    rm: tuple[float, ...]

    @classmethod
    def from_unknowns(cls, values: np.ndarray) -> Resonator:
        """Make a resonator from the unknowns of a fit.

        The unknowns are ``(c0, fs_1, …, cm_1, …, rm_1, …)``.
        """
        c0, *others = map(float, values)
        modes = len(others) // 3
        columns = (tuple(others[k * modes : (k + 1) * modes]) for k in range(3))
        return cls(c0, *columns)

    @cached_property
    def lm(self) -> tuple[float, ...]:
        """Motional inductance [H] of each mode, ``1 / ((2 pi fs)^2 cm)``."""
        return tuple(1 / ((TWO_PI * f) ** 2 * c) for f, c in zip(self.fs, self.cm, strict=True))

    @cached_property
    def fp(self) -> tuple[float, ...]:
        """Antiresonance frequencies [Hz] of the circuit without losses.

        The k-th lowest antiresonance frequency has the same index in the result as the k-th lowest
        series resonance frequency in ``fs``. The unknowns are the charges of the branches. The
        squared angular antiresonance frequencies are the eigenvalues of ``diag(w^2) + g g' / c0``
        with ``w_n = 2 pi fs_n`` and ``g_n = lm_n^(-1/2)``.
        """
        w, g = TWO_PI * np.array(self.fs), 1 / np.sqrt(self.lm)
        squares = np.linalg.eigvalsh(np.diag(w**2) + np.outer(g, g) / self.c0)
        result = np.empty(len(self.fs))
        result[np.argsort(self.fs)] = np.sqrt(squares) / TWO_PI
        return tuple(map(float, result))

    def admittance(self, frequency: np.ndarray) -> np.ndarray:
        """Return the complex admittance [S] at each frequency [Hz], an array (n,)."""
        s = 2j * np.pi * np.asarray(frequency, float)
        result = s * self.c0
        for cm, lm, rm in zip(self.cm, self.lm, self.rm, strict=True):
            result = result + s * cm / (1 + s * rm * cm + s**2 * lm * cm)
        return np.asarray(result)

    def compute_capacitance(self, frequency: float) -> float:
        """Return the capacitance [F] of the circuit without losses at ``frequency`` [Hz].

        The capacitance is ``c0 + sum cm / (1 - (f / fs)^2)``.
        """
        modes = zip(self.cm, self.fs, strict=True)
        return self.c0 + sum(c / (1 - (frequency / f) ** 2) for c, f in modes)

    def compute_coupling(self, mode: int) -> float:
        """Return the effective coupling coefficient of a mode, ``sqrt(1 - (fs / fp)^2)``."""
        return math.sqrt(max(0.0, 1 - (self.fs[mode] / self.fp[mode]) ** 2))

    def compute_q_factor(self, mode: int) -> float:
        """Return the Q factor of a mode, ``1 / (2 pi fs rm cm)``."""
        return 1 / (TWO_PI * self.fs[mode] * self.rm[mode] * self.cm[mode])


@dataclass(frozen=True)
class ResonatorNetlist:
    """Netlist parameters of a resonator, and expressions of its circuit elements.

    The expressions of the circuit elements contain the netlist parameters. ``modes`` contains the
    suffix of the element names for each mode. ``conditions`` contains expressions that are
    finite only for valid parameters, keyed by words for the error message of the simulator.
    ``conditions`` does not contain the ranges of ``params``, which the netlist checks in addition.
    """

    params: tuple[Param, ...]
    constants: Mapping[str, str]
    modes: tuple[str, ...]
    conditions: Mapping[str, str]


class PartWithPartNumber(PartType[KeysT]):
    """Base class of parts whose subcircuit is named after their part number."""

    def subcircuit_name(self, part: Part[KeysT], scene: Scene) -> str:
        """Return the name of the subcircuit, which is the part number if there is one."""
        number = getattr(part.keys, "number", None)
        if not number:
            return super().subcircuit_name(part, scene)
        result = make_identifier(number, part.name)
        return f"heated_{result}" if is_heated(part, scene) else result


class ResonatorPart(PartWithPartNumber[KeysT]):
    """Base class of parts with a Butterworth-Van Dyke circuit between two pins."""

    source = "data sheet"
    noise = ("Rm*",)
    optional_pins: ClassVar[Mapping[str, str]] = OPTIONAL_HEAT_PINS
    ends: ClassVar[tuple[str, str]] = ("anode", "cathode")
    rating = "not known; the current through rm heats the part"

    @abstractmethod
    def resonator(self, part: Part[KeysT]) -> Resonator:
        """Return the resonator circuit that the keys of the part determine.

        Raise a UsageError if the keys do not determine the elements.
        """

    @abstractmethod
    def make_resonator_netlist(self, part: Part[KeysT], circuit: Resonator) -> ResonatorNetlist:
        """Make the resonator netlist: parameters, and expressions of the elements."""

    def shared_data(self, part: Part[KeysT], scene: GovernedScene) -> Resonator:
        """Return the circuit elements of the resonator, for use by other parts."""
        return self.resonator(part)

    def circuit(self, part: Part[KeysT], scene: GovernedScene) -> Resonator:
        """Return the resonator circuit that the scene stores, or compute the circuit."""
        record = scene.get_record(part)
        if record is None or not isinstance(record.shared_data, Resonator):
            return self.resonator(part)
        return record.shared_data

    def pins(self, part: Part[KeysT], scene: JoinedScene) -> tuple[Terminal, ...]:
        """Return the pins of the part in the order of its subcircuit."""
        plus, minus = self.ends
        rated = getattr(part.keys, "rated_voltage", None)
        joined = scene.is_target(part.name, minus)
        return (
            Terminal(plus, "V", "A", required=True, rated=rated),
            Terminal(minus, "V", "A", None if joined else "gnd", required=joined, rated=rated),
            *(HEAT_TERMINALS if is_heated(part, scene) else ()),
        )

    def equilibrium_conditions(self, part: Part[KeysT], scene: WiredScene) -> EquilibriumConditions:
        """Return the equilibrium conditions: pin pairs with a possible constant force.

        Pairs with the pin ``heat`` are removed, because the part does not connect ``heat`` to
        ground.
        """
        paths = super().equilibrium_conditions(part, scene).paths
        return EquilibriumConditions(tuple(path for path in paths if HEAT not in path))

    def subcircuits(
        self, part: Part[KeysT], build: BuiltScene, header: Header
    ) -> tuple[Subcircuit, ...]:
        """Return the subcircuit of the part, as a tuple of length 1."""
        from kc2spice.synthesis.library_headers import (
            format_parameter_defaults,
            write_part_header,
        )  # loads slowly

        content = self.make_resonator_netlist(part, self.circuit(part, build.scene))
        name, pins = build.libraries[part.name], tuple(Pin(end, "V", "A") for end in self.ends)
        heated = is_heated(part, build.scene)
        pins += HEAT_PIN_ROWS if heated else ()
        title = f"{name}: {self.title}"
        words: dict[str, Any] = {"rating": self.rating, "heat": HEAT_PINS if heated else ""}
        head = write_part_header(header, title, pins, content.params, **words)
        items = (*_list_cards(content, *self.ends), *(_list_heat_cards(content) if heated else ()))
        ends, defaults = tuple(list_names(pins)), format_parameter_defaults(content.params)
        circuit = Circuit(name, ends, defaults, items, notes=head)
        tree = Circuit(items=(circuit,))
        return (
            Subcircuit(
                name,
                pins,
                content.params,
                tree,
                title=format_comment(title),
                header_lines=len(head),
            ),
        )

    # --- results ----------------------------------------------------------------------------------

    def vectors(self, part: Part[KeysT], build: BuiltScene) -> Mapping[str, PartResult]:
        """Return the ngspice vectors: expressions of the part's results, keyed by name."""
        result, (plus, minus) = {}, self.ends
        nets = (
            (sign, build.get_net(part, end)) for sign, end in zip(("", "-"), self.ends, strict=True)
        )
        if across := "".join(f"{sign}v({net})" for sign, net in nets if net != "0"):
            result[f"{part.name}.voltage"] = PartResult(across, 1.0, "V")
        meter = f"i(v.x{part.name.lower()}.vmeter)"
        result[f"{part.name}.current"] = PartResult(meter, 1.0, "A", (minus,), (plus,))
        if is_heated(part, build.scene):
            result |= list_heat_vectors(part, build, METER)
        return result

    def law(self, part: Part[KeysT], build: BuiltScene) -> laws.Equations:
        """Return the part's law: its model equations, solved by kc2spice without ngspice."""
        n, (plus, minus) = part.name, self.ends
        model = self._make_linear_model(part, build)
        body = laws.SecondOrderBody(n, model, (laws.LawPort(plus, "electrical", minus),))
        results = {
            f"{n}.voltage": laws.subtract_waves(f"{n}.{plus}", f"{n}.{minus}"),
            f"{n}.current": laws.scale_wave(f"{n}.{plus}.through"),
        }
        result = laws.Equations((body,), tuple((end, f"{n}.{end}") for end in self.ends), results)
        return add_loss_heat(result, body) if is_heated(part, build.scene) else result

    def _make_linear_model(self, part: Part[KeysT], build: BuiltScene) -> LinearModel:
        """Return the circuit as a linear model with one electrical port.

        The unknowns are the charges of the motional branches.
        """
        from kc2spice.rom.linear_model import LinearModel, Port  # loads slowly

        circuit = self.circuit(part, build.scene)
        ones = np.ones((len(circuit.fs), 1))
        return LinearModel(
            M=np.diag(circuit.lm),
            E=np.diag(circuit.rm),
            K=np.diag(1 / np.array(circuit.cm)),
            B=ones,
            C=ones.T,
            D=np.array([[circuit.c0]]),
            ports=(Port(self.ends[0], "electrical", pins=self.ends),),
            name=part.name,
        )

    def checks(
        self, part: Part[KeysT], build: BuiltScene, waves: Waveforms
    ) -> Iterator[Check | RunEnergyBalance]:
        """Yield the checks of the part after a run: its voltage and its energy balance."""
        name, voltage = part.name, waves.data.get(f"{part.name}.voltage")
        if voltage is None:
            return
        rated = getattr(part.keys, "rated_voltage", None)
        if rated is not None:
            largest, label = float(np.abs(voltage).max()), f"peak voltage of {name}"
            yield Check(
                f"rating of {name}", largest, rated, "V", RATING_ADVICE, "warn", label=label
            )
        moves = "time" in waves and float(np.ptp(voltage)) > SMALLEST_VOLTAGE
        if moves and f"{name}.current" in waves:
            yield self._balance_energy(part, build, waves)

    def _balance_energy(
        self, part: Part[KeysT], build: BuiltScene, waves: Waveforms
    ) -> RunEnergyBalance:
        """Return the energy balance of the part in a transient.

        The exact charge is the response of the circuit to the recorded voltage. The losses are the
        work of the voltage on the exact charge minus the increase of the stored energy.
        """
        # imported here, because the module loads scipy
        from kc2spice.rom.modal_models import compute_resonators, simulate_resonators

        time, voltage = waves["time"], waves[f"{part.name}.voltage"]
        current = waves[f"{part.name}.current"]
        model = compute_resonators(self._make_linear_model(part, build))
        assert model is not None
        outputs, stored = simulate_resonators(model, time, voltage[:, None])
        exact = outputs[:, 0]
        error = integrate_cumulatively(current, time) + exact[0] - exact
        # Each jump of the current adds a constant error to the charge, the integral of the current.
        # The mean charge error during a period of the slowest mode is therefore subtracted.
        period = 1 / min(self.circuit(part, build.scene).fs)
        error -= average_over_window(error, time, period)
        exact_work = integrate_cumulatively(voltage, exact)
        work = integrate_cumulatively(voltage * current, time)
        entries = {
            "electrical work": float(work[-1]),
            "stored": float(stored[-1]),
            "damped": float(exact_work[-1] + stored[0] - stored[-1]),
        }
        return RunEnergyBalance(
            entries,
            float(np.abs(work - exact_work).max()),
            float(integrate_cumulatively(np.abs(voltage * current), time)[-1]),
            MAX_BALANCE_ERROR,
            exact={f"charge of {part.name}": (exact + error, exact)},
        )

    def metrics(
        self, part: Part[KeysT], build: BuiltScene, waves: Waveforms
    ) -> Mapping[str, object]:
        """Return the metrics of the part, keyed by name."""
        from kc2spice.parts.bodies._linear_body import (
            compute_impedance,
            compute_impedance_metrics,
            find_impedance_scope,
            warn_of_zero_voltage,
        )

        response = compute_impedance(part, waves)
        if response is None:
            warn_of_zero_voltage(part, build.scene, waves)
            return {}
        plus = build.scene.pins(part.name)[0].name
        scope = find_impedance_scope(part, plus, build.scene)
        return compute_impedance_metrics(part.name, *response, scope=scope)

    def figures(self, part: Part[KeysT], build: BuiltScene, waves: Waveforms) -> Iterator[Figure]:
        """Yield the figures of the part for the report."""
        from kc2spice.parts.bodies._body_figures import IMPEDANCE_CAPTION, plot_impedances
        from kc2spice.parts.bodies._linear_body import compute_impedance

        response = compute_impedance(part, waves)
        if response is not None:
            frequency, z = response
            how = f"of the impedance at the pins of {part.name}{IMPEDANCE_CAPTION}"
            yield plot_impedances(part.name, frequency, {"": z}, how)

    def notes(self, part: Part[KeysT], scene: Scene) -> Iterator[str | NeglectedEffect]:
        """Yield the assumptions of the model and the effects that it neglects."""
        circuit = self.circuit(part, scene)
        yield f"c0 {format_quantity(circuit.c0, 'F')}"
        for n, fs in enumerate(circuit.fs):
            yield (
                f"mode {n + 1}: fs {format_quantity(fs, 'Hz', 6)}, "
                f"fp {format_quantity(circuit.fp[n], 'Hz', 6)}, "
                f"Q {circuit.compute_q_factor(n):.4g}, coupling {circuit.compute_coupling(n):.4g}, "
                f"rm {format_quantity(circuit.rm[n], 'Ohm')}"
            )
        yield NeglectedEffect("further modes", "the data sheet states none", "not estimated")
        yield NeglectedEffect(
            "dielectric loss",
            "the clamped capacitance c0 has no loss",
            "the loss current that is missing is tan delta times the current through c0",
        )
        yield NeglectedEffect(
            "nonlinearity and temperature", "small-signal model at one temperature", "not estimated"
        )


def make_unknowns_relation(value: Callable[[Resonator], float]) -> Relation:
    """Return a function that computes a ``value`` of the resonator from the unknowns."""
    return lambda unknowns: value(Resonator.from_unknowns(unknowns))


def _list_cards(content: ResonatorNetlist, plus: str, minus: str) -> Iterator[Item]:
    """Yield the cards of the resonator and of a leakage conductance across its pins.

    The leakage current is proportional to the stored charge. Therefore, the sum of floating charges
    is conserved.
    """
    for name, text in content.constants.items():
        yield Parameters({name: f"{{{text}}}"})
    conditions = list_range_conditions(content.params) | dict(content.conditions)
    yield from attach_comments((STOP_COMMENT, *write_condition_stops(conditions, minus)))
    yield Element.from_words("Vmeter", plus, "inner", "0")
    yield Element.from_words("C0", "inner", minus, "{c0}")
    for n in content.modes:
        # The inductor separates the capacitor from the large conductance of the resistor.
        # At a common node, the large conductance would cause rounding errors.
        inductor, capacitor = f"motion{n}", f"charge{n}"
        yield Element.from_words(f"Rm{n}", "inner", inductor, f"{{rm{n}}}")
        yield Element.from_words(f"Lm{n}", inductor, capacitor, f"{{lm{n}}}")
        yield Element.from_words(f"Cm{n}", capacitor, minus, f"{{cm{n}}}")
    total = "+".join(("c0", *(f"cm{n}" for n in content.modes)))
    yield Element.from_words(
        "Gleak", "inner", minus, "inner", minus, f"{{{LEAK_RATE:g}*({total})}}"
    )


def _list_heat_cards(content: ResonatorNetlist) -> Iterator[Item]:
    """Yield the netlist cards of the pin ``heat``.

    The heat pin has an ammeter, and a heat source for each motional resistance.
    """
    yield from attach_comments(write_heat_meter())
    for n in content.modes:
        drop = f"V(inner,motion{n})"
        yield write_heat_source(n, f"{drop}*{drop}/rm{n}")


def write_tolerance_note(value: float, tolerance: float | None) -> str:
    """Return the tolerance range of a parameter as text for the library header.

    Without a tolerance, the text is empty.
    """
    if tolerance is None:
        return ""
    low, high = (abbreviate_number(value * (1 + sign * tolerance)) for sign in (-1, 1))
    return f", tolerance {100 * tolerance:.4g} % ({low} to {high})"


def list_mode_suffixes(modes: int) -> Sequence[str]:
    """Return the suffix of element names for each mode; empty for a single mode."""
    return ("",) if modes == 1 else [str(n + 1) for n in range(modes)]
