"""Base of all parts whose model is linear: FE bodies and matrices, reduced, with typed ports."""

from __future__ import annotations

import hashlib
import json
import math
import stat
import warnings
from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from fnmatch import fnmatch
from functools import lru_cache
from functools import reduce as reduce_with
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import Field, StringConstraints

from kc2spice.core import laws
from kc2spice.core.cache import cached
from kc2spice.core.domains import BASE, PORTS, REFERENCES, TRANSLATION
from kc2spice.core.errors import SimulationError, UsageError, unknown, wrong
from kc2spice.core.figure import Figure, Written
from kc2spice.core.mesh_error import IN_PLANE, NOT_ESTIMATED
from kc2spice.core.progress import Clock
from kc2spice.core.quantities import Section, Voltage
from kc2spice.core.untrusted_files import identifier
from kc2spice.core.waveforms import Waveforms, running
from kc2spice.netlist.library import Header, Subcircuit
from kc2spice.netlist.spelling import LEAK_RATE
from kc2spice.parts.bodies import _pictures
from kc2spice.parts.bodies._box import PARAMETERS, corners, varied, with_values
from kc2spice.parts.mechanics._touching import Surface, Touching
from kc2spice.rom.complex_constants import ComplexConstants
from kc2spice.rom.linear_model import Certificate, LinearModel, Port
from kc2spice.rom.modal import chip_response, resonators
from kc2spice.rom.parametric import Loss, ParameterAxis
from kc2spice.rom.pencil import first_order
from kc2spice.rom.stability import prove_stability
from kc2spice.rom.varying import Varying
from kc2spice.scene.checks import Balance, Check, Metric
from kc2spice.scene.model import (
    GROUND,
    Build,
    DeclaredScene,
    GovernedScene,
    JoinedScene,
    Part,
    Scene,
    Terminal,
    WiredScene,
)
from kc2spice.scene.parttype import current_into, pin_forces
from kc2spice.scene.plausible import dimensions
from kc2spice.scene.rows import LargestRealPart, Neglected, Rest, Vector
from kc2spice.scene.settings import Probe, Rom
from kc2spice.synthesis.heat import is_heat
from kc2spice.synthesis.realize import (
    COARSE,
    RINGING,
    UNRATED,
    StepWeights,
    reference_pin,
    subcircuit,
)

if TYPE_CHECKING:
    from kc2spice.rom.enriched import Orders

# Kinds of ports with one pin against the common reference, and the short words of their waves.
ANSWERS = {kind: domain for kind, domain in PORTS.items() if domain.reference}
_FILLED = (domain for domain in ANSWERS.values() if domain.charged)
FLOWS = {domain.port: domain.quantity("through").symbol for domain in _FILLED}
WORDS = (*(domain.word for domain in ANSWERS.values()), *FLOWS.values())
RATED = "electrodes, as stated or by the field in its ceramic; the netlist itself has no limit"
BEYOND = "the ceramic depolarises or breaks down; lower the drive, or state another limit"
OUTSIDE = "nothing certifies what a reduced model says above its band: widen rom.band"
TWICE = 2  # states of a reduced model that is advised, per state of one that is too coarse
WRONG, COARSE_ROM = 0.1, 0.01  # certified relative errors that fail a run, or are warned of
# Error of a port's compliance above the band. A body in contact with a larger one is judged by
# the loads of the run. Measured: at most 0.20 for shipped kicks, whose error is below 0.3 % (rms);
# at least 0.53 for chips of 7 to 12 states, whose error is 2 to 3 %.
UNLIKE = 0.3
REDUCED = "the reduced model is that far off somewhere in its band: set rom.tolerance, or rom.order"
LOADED = "rms of displacement or charge, under the run's own loads"
FEWER = "a model of {} states answers the run's own forces and voltages that differently: set {}"
SHARP = (
    "the reduced model is that far off at some frequency of its band, such as a sharp resonance, "
    "and what rings on after the loads of this run drifts out of phase: set rom.tolerance, or a "
    "larger rom.order, if that ringing matters"
)
GROWS = "the body has motions that grow by themselves: check signs and halves of its matrices"
LOST = "the full model has motions that grow by themselves, and the reduced one does not hold them"
STEEP = "its current within an edge is off: widen rom.band, or give the drive the edge that it has"
TOUCHED = "what touches the body excites motions that the reduced one does not have: widen rom.band"
RESONANT = 1.5  # times its lowest resonance: a kick whose band ended below that was 2 % off
STILL = 1e-9  # distance of equal time points, relative to the duration of a run
FEEDING = 1e-3  # negative share of an impedance that is no rounding of a lossless body
KEPT = 1e-4  # share of a floating electrode's charge that a run may lose by the netlist's leak
STEP = 1e-2  # relative, of a parameter: its sensitivities are central differences
UNASKED = 1e-4  # tolerance over a box of parameters where an order is the default
NO_ENERGY = 1e-13  # rounding error of an energy, relative to that of the stiffest motion
LEAST = 10e3  # Hz of a transient's band at least: what switches in the circuit is not known
MOTIONS = 20  # natural frequencies that a band reaches unasked: above them the mesh decides
# Relative error of a mesh above which a run warns and ``verify`` fails: what a data sheet states of
# a part. By the facts of a model that it is an error of.
COARSE_MESH = {"first resonance": 0.03, "capacitance": 0.05, "stroke": 0.1}
MESH_FACTS = {
    "first resonance": "resonance_short_hz",
    "capacitance": "capacitance_free_f",
    "stroke": "free_stroke_*",
}
STORED = 0.1  # limit relative to the stored energy; after a pulse a chip rings at up to 30 MHz
UNPRESSED = 1e-9  # zero load, relative to the largest force or energy; far above rounding


_LONGEST = 47  # letters of a scene's and a part's name in that of a library
# Keys of a body that change no model of it.
_NO_MODEL = {"rom", "fields", "rated_voltage", "number"}
# Packages and modules that every full and reduced model depends on.
SOURCES = (
    "kc2spice.linalg", "kc2spice.fem", "kc2spice.rom", "kc2spice.bodies",
    "kc2spice.core.domains", "kc2spice.core.quantities", "kc2spice.core.gmsh_session",
    "kc2spice.core.untrusted_files", "kc2spice.parts.bodies._box",
)  # fmt: skip


class LinearKeys(Section):
    """Keys of every linear body."""

    rom: Rom | None = None
    number: Annotated[str, StringConstraints(min_length=1, max_length=40)] | None = Field(
        None, description="Part number, the name of the exported library; SCENE_PART by default"
    )
    rated_voltage: Voltage | None = Field(
        None,
        gt=0,
        description="Largest voltage between electrodes; by default that of the materials",
    )


class LinearBody(Touching):
    """A part whose model is a :class:`kc2spice.rom.linear_model.LinearModel`.

    A subclass says which :meth:`ports` its keys give and builds the :meth:`full` model of the
    whole device with them.
    """

    noise = ("Rnoise",)
    #: what the reduced model's head and ``explain`` call it
    source = "FE, linear"

    # --- what a subclass says -------------------------------------------------------------------

    @abstractmethod
    def ports(self, part: Part, scene: DeclaredScene) -> tuple[Port, ...]:
        """All ports that the body offers."""

    @abstractmethod
    def full(self, part: Part, scene: GovernedScene, clock: Clock) -> LinearModel:
        """The full model of the whole device."""

    def varied(self, part: Part, scene: GovernedScene, clock: Clock, like: Part) -> LinearModel:
        """:meth:`full` on the mesh that ``like`` has, a part of other values, moved to these."""
        return self.full(part, scene, clock)

    def headline(self, part: Part) -> str:
        """First line of its library: what it is and what it assumes."""
        return self.title

    def by_material(self, part: Part) -> float | None:
        """Largest voltage [V] that the material stands between electrodes, None if not known."""
        return None

    def rated(self, part: Part, build: Build | None = None) -> float | None:
        """Largest voltage [V] between electrodes: as its keys, its layers or its mesh say."""
        mesh = {} if build is None else build.model(part, LinearModel).facts
        known = part.keys.rated_voltage or self.by_material(part)
        return known or mesh.get("depoling_voltage_v")

    def full_key(self, part: Part, scene: GovernedScene) -> Mapping[str, Any]:
        """Keys on which the full model depends."""
        return {"keys": part.keys.model_dump(mode="json", exclude=_NO_MODEL)}

    # --- scene ----------------------------------------------------------------------------------

    def used_ports(self, part: Part, scene: JoinedScene) -> tuple[Port, ...]:
        """The ports that the scene needs: electrical ones, and others that something names.

        Return all ports if the body is the only part, because such a scene exists to export the
        body. In an export, return all declared ports.
        """
        every = self.ports(part, scene)
        if len(scene.parts) == 1 or scene.ports == "all":
            return every
        names = required_ports(part, scene)
        known = {"ground", *REFERENCES, *(t for p in every for t in (p.name, *p.terminals))}
        _require_ports(part, sorted(names - known), [port.name for port in every])
        if scene.ports == "declared" and part.declares:
            return every
        used = [p for p in every if p.kind not in ANSWERS or names & {p.name, *p.terminals}]
        return tuple(used) or every[:1]

    def pins(self, part: Part, scene: JoinedScene) -> tuple[Terminal, ...]:
        """In the order of the subcircuit."""
        ports, rated = self.used_ports(part, scene), self.rated(part)
        electrical = [p for p in ports if p.paired]
        moved = [p for p in ports if p.kind in ANSWERS]
        result: list[Terminal] = []
        shared: set[str] = set()
        for port in electrical:
            plus, minus = port.terminals
            result.append(Terminal(plus, port.across, port.flow, rated=rated))
            if minus not in shared:
                floating = minus in required_ports(part, scene) - set(part.pins)
                result.append(Terminal(minus, port.across, port.flow, None if floating else "gnd"))
            shared.add(minus)
        result += [Terminal(port.terminals[0], port.across, port.flow) for port in moved]
        for port in ports:
            if not port.conservative:
                out = port.kind == "output"
                result.append(Terminal(port.terminals[0], port.across, "-", signal_out=out))
        last = reference_pin(ports)
        return (*result, Terminal(last.name, last.unit, last.flow, "gnd"))

    def at_rest(self, part: Part, scene: WiredScene) -> Rest:
        """Holds all pins against its reference."""
        last = scene.pins(part.name)[-1]
        end = GROUND if last.name in (BASE, "ground") else last.name
        pins = (pin for pin, _ in super().at_rest(part, scene).paths)
        return Rest(tuple((pin, end) for pin in pins if pin != end))

    def rest_with_model(self, part: Part, build: Build) -> Rest:
        """Holds all pins against its reference; those of a free body against each other.

        A port that takes up volume for a pressure is a path for flow only if the body gives way
        without end.
        """
        model, rest = build.models.get(part.name), build.scene.records[part.name].rest
        if not isinstance(model, LinearModel):
            return rest
        ports, result = self.used_ports(part, build.scene), rest.paths
        inert, free = inert_ports(model), free_to_move(model)
        filled = set() if free else {port.terminals[0] for port in ports if port.charged}
        result = tuple(pair for pair in result if pair[0] not in filled)
        if not free:
            return Rest(result, inert=inert)
        names = {port.name for port in ports if not port.charged}
        first, *others = [pin for pin, _ in result if pin in names] or [GROUND]
        fixed = tuple(pair for pair in result if pair[0] not in names)
        return Rest(fixed + tuple((first, other) for other in others), inert=inert)

    def inertial(self, part: Part, scene: JoinedScene) -> tuple[str, ...]:
        ports = (port for port in self.used_ports(part, scene) if port.domain is TRANSLATION)
        return tuple(port.terminals[0] for port in ports)

    def problems(self, part: Part, scene: GovernedScene) -> Iterator[UsageError]:
        yield from dimensions(part.name, part.keys)
        yield from corners(part, scene)

    def surface(
        self, part: Part, scene: GovernedScene, ports: tuple[str, ...] = ()
    ) -> Surface | None:
        mechanical = [p.name for p in self.ports(part, scene) if p.domain is TRANSLATION]
        names = ports or tuple(mechanical[:1])
        _require_ports(part, [n for n in names if n not in mechanical], mechanical, "mechanical ")
        if not names:
            return None
        modulus = self.indentation_modulus(part)
        return Surface(part.name, names, (0.0,) * len(names), modulus=modulus)

    def indentation_modulus(self, part: Part) -> float | None:
        """Modulus [Pa] of the half-space that a contact presses on; None where it is not one."""
        return None

    def weights(self, part: Part, scene: DeclaredScene) -> StepWeights:
        """Weights of the modes in time step control.

        ``COARSE`` if time steps need not resolve the ringing of the body without load.
        """
        return COARSE if scene.solver.ringing == "coarse" else RINGING

    def neglected(self, part: Part, scene: Scene) -> Iterator[Neglected]:
        """Effect that ``solver.ringing = "coarse"`` neglects."""
        if self.weights(part, scene) == COARSE:
            why = "solver.ringing lets go of it once nothing presses on the body"
            yield Neglected(
                f"free ringing of {part.name}", why, "all of its own current and motion"
            )

    # --- model and netlist ----------------------------------------------------------------------

    def _chosen(self, part: Part, scene: Scene) -> Rom | None:
        """The reduction that somebody chose: the body's own, which may as well say no more than
        which keys are parameters of the netlist, else the scene's."""
        specified: Rom | None = part.keys.rom
        if specified is not None and specified.model_fields_set != {"parameters"}:
            return specified
        return scene.rom if "rom" in scene.frame.model_fields_set else None

    def reduction(self, part: Part, scene: Scene) -> Rom:
        """Settings of the keys; by default a tolerance over the band that the analysis uses.

        In ``ac``, the band ends 20 % above the last frequency. In a transient, it contains what the
        scene excites (:meth:`PartType.numerics`), up to the first :data:`MOTIONS` natural
        frequencies of the body. The tolerance of 1e-3 is a tenth of usual mesh errors. It is above
        the effect of rounding on a free thin plate, some 1e-4 at its resonances.
        """
        specified, result = part.keys.rom, self._chosen(part, scene)
        if result is None and scene.analysis.small:
            low, high = scene.analysis.start, float(scene.analysis.stop or 1.0)
            result = Rom(tolerance=1e-3, band=(0.8 * low, 1.2 * high))
        elif result is None:
            content = max((row.content for row in scene.numerics), default=0.0)
            result = Rom(tolerance=1e-4, band=(0.0, max(content, LEAST)))
        if specified is None or result is specified:
            return result
        return result.model_copy(update={"parameters": specified.parameters})

    def least_band_end(self, part: Part, scene: Scene) -> float | None:
        """Least upper end of the band of a transient [Hz]; None if the user set the band.

        It does not depend on the natural frequencies of the body.
        """
        if self._chosen(part, scene) is not None or scene.analysis.type != "transient":
            return None
        return max([LEAST, *(r.content for r in scene.numerics if math.isfinite(r.step))])

    def model_key(self, part: Part, scene: Scene) -> Mapping[str, Any]:
        rom = reduction_target(part, scene)
        port_names = [port.name for port in self.used_ports(part, scene)]
        settings = rom.model_dump(mode="json")
        result = {
            "type": self.name,
            "full": self.full_key(part, scene),
            "ports": port_names,
            "rom": settings,
        }
        least_end = self.least_band_end(part, scene)
        reached = {} if least_end is None else {"sure": least_end, "motions": MOTIONS}
        return result | reached | {"massless": massless(part, scene)}

    def varying(self, part: Part, scene: Scene, clock: Clock) -> Varying:
        """The resonators over the box of ``rom.parameters``, which no value of these changes."""
        keys = varied(part)
        middle = with_values(part, {item.key: item.axis.middle for item in keys})
        target, key = reduction_target(part, scene), self.model_key(middle, scene)
        if loss_tangent(part):
            problem = "a netlist with parameters has no loss of its dielectric"
            raise wrong(f"{part.name}.damping.loss_tangent", problem, loss_tangent(part), "0")
        if by_complex_constants(part):
            problem = "a netlist with parameters has viscous damping"
            raise wrong(f"{part.name}.damping.model", problem, "ieee176", "rayleigh")
        if scene.analysis.type == "noise":
            problem = "a netlist with parameters has no thermal noise of its losses"
            raise wrong(
                f"{part.name}.{PARAMETERS}", problem, ", ".join(i.key for i in keys), "none"
            )
        if target.order is not None and "order" in target.model_fields_set and part.keys.rom.order:
            problem = "a netlist with parameters has as many states as its tolerance takes"
            raise wrong(f"{part.name}.rom.order", problem, target.order, "rom.tolerance")
        key = {**key, "box": [[item.key, item.low, item.high] for item in keys]}

        def build() -> Varying:
            from kc2spice.rom.varying import over_box

            def full(values: Mapping[str, float]) -> LinearModel:
                other = with_values(part, values)
                return self.varied(other, scene, clock, middle).select(key["ports"])

            band = _reaching(
                target.band, key, lambda: full({item.key: item.axis.middle for item in keys})
            )
            text = f"model of {part.name} over {len(keys)} parameters"
            with clock.stage("reduce", text) as share:
                return over_box(
                    full,
                    [item.axis for item in keys],
                    band,
                    target.tolerance or UNASKED,
                    lambda done, of: share(done / of),
                    target.norm or "pointwise",
                )

        def load() -> Varying:
            classes = (Varying, ParameterAxis, Loss, Certificate, Port)
            return cached("box", key, build, classes=classes, sources=self.sources())

        return scene.workspace.latest(f"range of {part.name}", key, load)

    def _lossy(self, part: Part) -> bool:
        """Whether it has losses that the matrices of a full model cannot have."""
        return bool(loss_tangent(part)) or by_complex_constants(part)

    def _full_model(self, part: Part, scene: Scene, clock: Clock) -> LinearModel:
        """The full model with the ports of the scene, in a box on the mesh of all its values."""
        keys, names = varied(part), [port.name for port in self.used_ports(part, scene)]
        if not keys:
            return self.full(part, scene, clock).select(names)
        middle = with_values(part, {item.key: item.axis.middle for item in keys})
        return self.varied(part, scene, clock, middle).select(names)

    def build(
        self, part: Part, scene: Scene, clock: Clock, full: bool = False
    ) -> LinearModel | None:
        if full:
            # the matrices of a full model cannot have some losses
            return None if self._lossy(part) else self._full_model(part, scene, clock)
        if keys := varied(part):
            return self.varying(part, scene, clock).at({item.key: item.value for item in keys})
        # Asked here, as parts of the key: what runs within ``build`` is hashed with its modules.
        target, model_key = reduction_target(part, scene), self.model_key(part, scene)
        tangent, constants = loss_tangent(part), by_complex_constants(part)

        def build() -> LinearModel:
            from kc2spice.rom.complex_constants import complex_constants
            from kc2spice.rom.error_estimate import default_norm
            from kc2spice.rom.modal import lossy, without_inertia
            from kc2spice.rom.reduce import reduce_model

            orders = self.orders(part, scene, clock)
            selected = orders.model
            with clock.stage("reduce", f"reduction of {part.name}"):
                order = None if target.order is None else min(target.order, selected.order)
                band = _reaching(target.band, model_key, lambda: selected)
                norm = target.norm or default_norm(selected)
                if constants:
                    selected = _barely_damped(part, selected, band)
                # a contact, a switch or a table excites modes above the band
                if order is not None and selected is orders.model:
                    small = orders.reduce(order, band, norm)
                else:
                    aims: dict[str, Any] = {"order": order, "tolerance": target.tolerance}
                    small = reduce_model(selected, **aims, band=band, norm=norm, contact=True)
            modal = resonators(small)  # whose later use needs no eigenvalues
            if modal is None and (tangent or constants):
                got = "damping that couples its modes, or a motion that nothing holds"
                problem, key = "a loss tangent needs a body of resonators", "loss_tangent"
                if constants:
                    problem, key = "complex constants need a body of resonators", "model"
                expected = "ratio, quality or loss_factor"
                raise wrong(f"{part.name}.damping.{key}", problem, got, expected)
            if modal is None:
                return small
            if model_key["massless"]:
                modal = without_inertia(modal, target.tolerance)
            labels: dict[str, Any] = {"name": small.name, "facts": small.facts, "band": small.band}
            if constants:
                losses = losses_of(part, selected)
                return replace(complex_constants(modal, losses), **labels)
            if tangent:
                modal = lossy(modal, tangent)
            return replace(modal.linear(), **labels)

        kinds = (LinearModel, Certificate, Port)
        return cached("body", model_key, build, classes=kinds, sources=self.sources())

    def orders(self, part: Part, scene: Scene, clock: Clock) -> Orders:
        """Reductions of the full model with the ports of the scene to prescribed orders; the next
        scene often asks for a larger one of the same body."""
        from kc2spice.rom.enriched import Orders

        names = [port.name for port in self.used_ports(part, scene)]
        key = json.dumps(
            [part.name, self.full_key(part, scene), names], sort_keys=True, default=str
        )

        def make() -> Orders:
            return Orders(self._full_model(part, scene, clock))

        return scene.workspace.latest(f"orders {self.name}", key, make)

    def library(self, part: Part, scene: Scene) -> str:
        """Its part number, else :meth:`scene_library`."""
        scene_name = self.scene_library(part, scene)
        return identifier(part.keys.number, part.name) if part.keys.number else scene_name

    def scene_library(self, part: Part, scene: Scene) -> str:
        """The names of scene and part: libraries of many scenes may stand in one folder."""
        name = f"{scene.name[: _LONGEST - len(part.name)]}_{part.name}"
        return identifier(name, part.name)

    def subcircuits(self, part: Part, build: Build, header: Header) -> tuple[Subcircuit, ...]:
        name = build.libraries[part.name]
        volts = self.rated(part, build)
        rating = f"{volts:.4g} V between {RATED}" if volts else UNRATED
        if not volts and any(port.paired for port in build.model(part, LinearModel).ports):
            rating += "; key rated_voltage states the largest voltage, a run then warns beyond it"
        words: dict[str, Any] = {"title": self.headline(part), "rating": rating}
        words["weights"] = self.weights(part, build.scene)
        if keys := varied(part):
            from kc2spice.synthesis.parametric_resonators import parametric_subcircuit

            result = self.varying(part, build.scene, Clock())
            known = {item.key: item.param for item in keys}
            params = [known[key] for key in result.box]
            return (parametric_subcircuit(result, name, params, header, **words),)
        return (
            subcircuit(build.model(part, LinearModel), name, header, **words, noise=build.noisy),
        )

    def vectors(self, part: Part, build: Build) -> Mapping[str, Vector]:
        result: dict[str, Vector] = {}
        ports = self.used_ports(part, build.scene)
        for port in ports:
            name, node = wave_name(part.name, ports, port), build.net(part, port.terminals[0])
            if port.paired:
                nets = zip(("", "-"), (build.net(part, pin) for pin in port.terminals), strict=True)
                if across := "".join(f"{sign}v({net})" for sign, net in nets if net != "0"):
                    result[f"{name}.voltage"] = Vector(across, 1.0, "V")
                if (meter := current_into(part, port.terminals[0], build)) is not None:
                    result[f"{name}.current"] = meter
            elif node != "0":
                known = None if port.domain is None else port.domain.across
                factor, unit = (known.factor, known.unit) if known else (1.0, port.across)
                result[name] = Vector(f"v({node})", factor, unit)
                flow = current_into(part, port.terminals[0], build) if port.charged else None
                if flow is not None:
                    result[flow_name(part.name, ports, port)] = flow
        return result

    # --- what a run says ------------------------------------------------------------------------

    def metrics(self, part: Part, build: Build, waves: Waveforms) -> Mapping[str, object]:
        z = measured(part, waves)
        if z is None:
            return {}
        from kc2spice.bodies.impedance import analyse

        frequency = waves["frequency"].real
        figures: dict[str, Any] = {
            "frequency_hz": Metric(frequency.tolist(), "Hz"),
            "impedance_ohm": Metric(np.abs(z).tolist(), "Ohm"),
        }
        try:
            result = figures | _with_units(asdict(analyse(frequency, z)))
        except UsageError:  # no resonance in the range: nothing to read off but the curve
            return figures
        if not (keys := varied(part)):
            return result
        # d ln(metric) / d ln(key), by key and metric: central differences within the ranges
        box = self.varying(part, build.scene, Clock())
        port = next(port.name for port in box.ports if port.paired)
        result["sensitivity"] = {}
        for key in keys:
            ends = np.clip(key.value * (1 + STEP * np.array([-1, 1])), key.low, key.high)
            read = []
            for end in ends:
                model = box.at({item.key: item.value for item in keys} | {key.key: float(end)})
                H = model.select([port]).transfer(frequency)[:, 0, 0]
                try:
                    read.append(asdict(analyse(frequency, 1 / (2j * np.pi * frequency * H))))
                except UsageError:
                    warnings.warn(
                        f"{part.name}.{key.key}: no sensitivity, because {end:g} moves the "
                        "resonance out of the band: widen the range of the analysis",
                        stacklevel=2,
                    )
                    break
            if len(read) < 2:
                continue
            change = math.log(ends[1] / ends[0])
            result["sensitivity"][key.param.name] = {
                name.removesuffix("_hz").removesuffix("_f"): math.log(read[1][name] / low) / change
                for name, low in read[0].items()
                if name != "bvd"
            }
        return result

    def main_metrics(self, part: Part, build: Build) -> Mapping[str, Probe | LargestRealPart]:
        """The resonance of an impedance, where the model's conductance is largest there.

        It is that of the current of a voltage source at its first electrode, nothing else loading
        the body.
        """
        result = f"{part.name}.current"
        if build.scene.analysis.type != "ac" or result not in build.records[part.name].vectors:
            return {}
        return {"resonance_hz": LargestRealPart(result)} if self._leads(part, build) else {}

    def _leads(self, part: Part, build: Build) -> bool:
        """Whether a source alone drives the body, and the resonance that an analyser reads off is
        the largest conductance of all."""
        from kc2spice.bodies.impedance import analyse

        scene, model = build.scene, build.model(part, LinearModel)
        pins = [pin.name for pin in scene.pins(part.name)]
        joined = {pin: scene.joined(part.name, pin) for pin in pins}
        port = next(port for port in model.ports if port.paired)
        plus, minus = port.terminals
        ((name, _),) = joined.pop(plus)
        drive = scene.parts[name].type.law(scene.parts[name], build)
        sources = drive.laws if drive is not None else ()
        ideal = [law for law in sources if isinstance(law, laws.IdealSource) and law.ac.real > 0]
        if any(joined.values()) or scene.net(part.name, minus) != "0" or len(ideal) != 1:
            return False
        selected = scene.analysis
        if selected.start == 0.0:
            return False
        space = np.geomspace if selected.scale == "log" else np.linspace
        f = space(selected.start, float(selected.stop or 0.0), selected.points)
        Y = 2j * np.pi * f * model.select([port.name]).transfer(f)[:, 0, 0]
        try:
            resonance = analyse(f, 1 / Y).resonance_hz
        except UsageError:  # no resonance in the range
            return False
        largest = int(Y.real.argmax())
        return bool(f[max(largest - 1, 0)] <= resonance <= f[min(largest + 1, len(f) - 1)])

    def checks(self, part: Part, build: Build, waves: Waveforms) -> Iterator[Check | Balance]:
        """Yield the checks of a reduced body after a run.

        They are the error of the reduced model, the stability of the full model, the band and the
        rating. After a transient, the energy balance, the band of the excitation and the charge of
        floating electrodes follow.
        """
        model = build.model(part, LinearModel)
        result = model.certificate
        if result is not None:
            yield from self._reduced(part, build, waves, result)
            if result.stable is False:
                full_is_stable = prove_stability(model.pencil.dense(), result.band_hz).stable
                advice, then = (LOST, "fail") if full_is_stable else (GROWS, "warn")
                yield Check(f"stability of {part.name}", 1.0, 0.0, "", advice, then)  # type: ignore[arg-type]
        if result is not None and "frequency" in waves:
            highest = float(waves["frequency"].real.max())
            limit = (1 + 1e-9) * result.band_hz[1]  # a last point that is rounded
            yield Check(f"band of {part.name}", highest, limit, "Hz", OUTSIDE, "warn")
        yield from self._within_rating(part, build, waves)
        if "time" not in waves:
            return
        if (balance := self._balance(part, build, waves)) is not None:
            yield balance
        if result is not None:
            yield from self._excited(part, build, waves, result)
        yield from self._leaked(part, build)

    def _within_rating(self, part: Part, build: Build, waves: Waveforms) -> Iterator[Check]:
        """Whether the voltage at each electrode stays within its rating.

        Of a response to small signals the amplitude counts, at the voltages that the scene states.
        """
        volts, ports = self.rated(part, build), self.used_ports(part, build.scene)
        if volts is None:
            return
        for port in ports:
            name = wave_name(part.name, ports, port)
            if port.paired and f"{name}.voltage" in waves:
                largest = float(np.abs(waves[f"{name}.voltage"]).max())
                yield Check(f"rating of {name}", largest, volts, "V", BEYOND, "warn")

    def _leaked(self, part: Part, build: Build) -> Iterator[Check]:
        """Check of the charge that a floating electrode loses through the netlist's leak."""
        leaked = -math.expm1(-build.scene.stop * LEAK_RATE)
        ports = [p.name for p in build.model(part, LinearModel).ports if p.paired]
        for port in ports if leaked > KEPT else ():
            name = f"charge kept by {part.name}.{port} if it floats"
            advice = "the netlist's leak: a resistor across the electrode states the real one"
            yield Check(name, leaked, KEPT, "of it lost", advice, "warn")

    def _reduced(
        self, part: Part, build: Build, waves: Waveforms, certificate: Certificate
    ) -> Iterator[Check]:
        """How far its reduced model is off: at the worst frequency of its band; in a transient,
        where that is too much or a contact excites what the model lacks, under the recorded loads.

        A pointwise error at a sharp resonance is no error of what the loads do, and a small one is
        no error of what loads above the band do. The recorded forces and voltages weight the error
        by their spectrum: a model of more states answers them too.
        """
        name, error = part.name, certificate.error_estimate
        unlike = max((size for _, size in certificate.above), default=0.0) > UNLIKE
        contact = unlike and any(contacts_on(part, build.scene))
        loaded = None
        if "time" in waves and (error > WRONG or contact):
            loaded = self.error_under_load(part, build, waves, build.model(part, LinearModel))
        if loaded is None:
            yield _reduction_check(name, error, "", REDUCED)
            return
        worst, states = loaded
        model, target = build.model(part, LinearModel), reduction_target(part, build.scene)
        order = TWICE * (target.order or model.order)
        default = self._chosen(part, build.scene) is None and not varied(part)
        key = "rom.order" if part.keys.rom is None and not default else f"{name}.rom.order"
        advice = FEWER.format(states, f"{key} = {order}")
        check = _reduction_check(name, worst, LOADED, advice)
        more = {key: order, f"{name}.rom.band": list(certificate.band_hz)} if default else {}
        yield replace(check, suggested=more, loaded=True)
        yield Check(f"resonances of {name}", error, COARSE_ROM, "of a response", SHARP, "warn")

    def error_under_load(
        self, part: Part, build: Build, waves: Waveforms, model: LinearModel
    ) -> tuple[float, int] | None:
        """Largest error of the reduced ``model`` under the loads of a run while these change.

        Also returns the states of the model that it is compared with. None if a load is not known,
        or if no model with more states is known.
        """
        loads, certificate = self.loads(part, build, waves), model.certificate
        if certificate is None or not all(name in loads for name in model.inputs):
            return None
        band = certificate.band_hz
        from kc2spice.rom.enriched import last_change, time_errors

        t, load = waves["time"], np.column_stack([loads[name] for name in model.inputs])
        count = last_change(load) + 1
        key = {**self.model_key(part, build.scene), "enriched": model.order}

        def richer() -> LinearModel | None:
            if self._lossy(part):
                return None
            try:
                return self.orders(part, build.scene, Clock()).enriched(key["enriched"], band)
            except (SimulationError, UsageError):
                return None

        kinds = (LinearModel, Certificate, Port)
        rich = cached("enriched", key, richer, classes=kinds, sources=self.sources())
        if rich is None or count < 2:
            return None
        driven = [port for port in model.ports if port.kind != "output"]
        answered = [port.domain if port.charged else None for port in driven]
        groups = [np.array([item is kind for item in answered]) for kind in dict.fromkeys(answered)]
        errors = time_errors(model, rich, t[:count], load[:count], groups)
        return None if errors is None else (max(errors.values(), default=0.0), rich.order)

    def _excited(
        self, part: Part, build: Build, waves: Waveforms, certificate: Certificate
    ) -> Iterator[Check]:
        """Whether its band holds what drives it: ``max |v'| / (pi (max v - min v))``, the frequency
        of a sine and a third of the reciprocal of an edge; or its first resonance, which a contact
        excites more than any drive."""
        scene, t, high = build.scene, waves["time"], certificate.band_hz[1]
        rows = scene.numerics
        if any(row.decides for row in rows):
            lowest = build.model(part, LinearModel).facts.get("resonance_short_hz")
            if lowest is not None:
                name = f"band of {part.name}, first resonance"
                yield Check(name, RESONANT * lowest, high, "Hz", TOUCHED, "warn")
            return
        apart = np.diff(t) > STILL * t[-1]
        for port in self.used_ports(part, scene):
            if not port.paired or not apart.any():
                continue
            name = wave_name(part.name, build.model(part, LinearModel).ports, port)
            voltage = waves.data.get(f"{name}.voltage")
            if voltage is None or not np.ptp(voltage):
                continue
            slope = np.abs(np.diff(voltage)[apart] / np.diff(t)[apart]).max()
            name = f"band of {part.name}, drive of {port.name}"
            content = float(slope / (np.pi * np.ptp(voltage)))
            yield Check(name, content, high, "Hz", STEEP, "warn")

    def loads(self, part: Part, build: Build, waves: Waveforms) -> dict[str, np.ndarray]:
        """Loads of every kept port over time, in SI.

        A load is a voltage, an acceleration, or the force of all parts joined to the port. Ports
        whose force is not recorded are left out.
        """
        ports, result = self.used_ports(part, build.scene), dict[str, np.ndarray]()
        still, acting = np.zeros(waves["time"].size), pin_forces(build, waves)
        for port in ports:
            name = wave_name(part.name, ports, port)
            if not port.loaded:
                wave = f"{name}.voltage" if port.paired else name
                result[port.name] = waves.data.get(wave, still)
                continue
            joined = build.scene.joined(part.name, port.terminals[0])
            if acting.keys() >= set(joined) and build.net(part, port.terminals[0]) != "0":
                result[port.name] = sum((acting[end] for end in joined), start=still)
        return result

    def _balance(self, part: Part, build: Build, waves: Waveforms) -> Balance | None:
        """Work of voltage and forces on the body against its exact response to the same loads.

        What the exact response takes in and does not store is damped. The electrical part needs the
        body's current among the waveforms. The scale is the largest change of the energy stored, or
        of what rounds it where nothing moves. Where the ringing is coarse, that is judged until
        nothing presses on the body any more; else displacements [m] and charges [C] are exact.
        """
        model, t = resonators(build.model(part, LinearModel)), waves["time"]
        domains = {port.domain for port in self.used_ports(part, build.scene)}
        if model is None or not all(d is TRANSLATION or (d and d.charged) for d in domains):
            return None
        loads = self.loads(part, build, waves)
        if len(loads) < len(model.ports):
            return None
        inputs = np.column_stack([loads[port.name] for port in model.ports])
        outputs, stored = chip_response(model, t, inputs)
        entries: dict[str, float] = {}
        answers: dict[str, tuple[np.ndarray, np.ndarray]] = {}
        gap, damped = np.zeros(t.size), stored[0] - stored
        for port, load, exact in zip(model.ports, inputs.T, outputs.T, strict=True):
            took, name = running(load, exact), wave_name(part.name, model.ports, port)
            damped = damped + took
            if port.charged and port.domain is not None:
                what, result = f"{port.domain.name} work", took
                current = waves.data.get(flow_name(part.name, model.ports, port))
                if current is not None:
                    result = running(load * current, t)
                    answers[f"charge of {name}"] = running(current, t) + exact[0], exact
            else:
                what, result = "work of the contact", running(load, waves[name])
                answers[name] = waves[name], exact
            entries[what] = entries.get(what, 0.0) + float(result[-1])
            gap += result - took
        entries |= {"stored": float(stored[-1]), "damped": float(damped[-1])}
        if pressed := self.weights(part, build.scene) == COARSE:
            forces = [loads[port.name] for port in model.ports if port.domain is TRANSLATION]
            largest = np.abs(forces).max(axis=0, initial=0.0)
            last = np.flatnonzero(largest > UNPRESSED * largest.max(initial=0.0)).max(initial=0)
            gap = gap[: int(last) + 1]
        scale = max(float(np.ptp(stored)), UNPRESSED * float(stored.max()))
        exactly = {} if pressed else answers
        return Balance(entries, float(np.abs(gap).max()), scale, STORED, exact=exactly)

    def figures(self, part: Part, build: Build, waves: Waveforms) -> Iterator[Figure | Written]:
        yield from _pictures.port_figures(part.name, waves)
        z = measured(part, waves)
        if z is not None:
            how = f"as the circuit shows it at {part.name}"
            f = waves["frequency"].real
            yield _pictures.impedances(part.name, f, {"": z}, how + _pictures.PEAKS)
            return
        yield from _pictures.response_figures(part.name, waves)
        model = build.model(part, LinearModel)
        yield from _pictures.own_impedances(part.name, model, resonators(model))

    def law(self, part: Part, build: Build) -> laws.Equations | None:
        model = build.model(part, LinearModel)
        ports, n = model.ports, part.name
        heat, last = is_heat(model), build.scene.pins(part.name)[-1].name
        if build.net(part, last) != "0" and not heat:  # its reference
            return None
        signals = not any(port.conservative for port in ports)
        law_ports = tuple(
            laws.LawPort(
                p.name,
                p.domain.name if p.domain else p.kind,
                last if heat else "".join(p.terminals[1:]),
            )
            for p in ports
        )
        mixed = not all(port.conservative for port in ports)
        if not signals and (mixed or model.first_order != heat):
            return None
        law: laws.Law
        if not model.pencil.is_dense:
            law = laws.PortBody(n, model, law_ports)
        elif signals:
            A = first_order(model.pencil.dense(), 1.0)
            rest, E = A.coefficients
            law = laws.SignalBlock(n, E, -rest, A.B, A.C, A.D, model.inputs, model.outputs)
        else:
            modal = resonators(model)
            law = laws.SecondOrderBody(n, model if modal is None else modal.linear(), law_ports)
        joins = [(port.terminals[0], f"{n}.{port.name}") for port in ports]
        joins += [(pin, f"{n}.{pin}") for port in ports for pin in port.terminals[1:]]
        joins += [(last, f"{n}.{last}")] * heat
        results: dict[str, laws.Reading] = {}  # under the names of vectors
        for port in ports:
            mine, name = f"{n}.{port.name}", wave_name(n, ports, port)
            if port.paired:
                results[f"{name}.voltage"] = laws.difference(mine, f"{n}.{port.terminals[1]}")
            else:
                results[name] = laws.reading(mine)
            if port.charged:
                results[flow_name(n, ports, port)] = laws.reading(f"{mine}.through")
        return laws.Equations((law,), tuple(joins), results)

    def notes(self, part: Part, scene: Scene) -> Iterator[str | Neglected]:
        rom = reduction_target(part, scene)
        used = self.used_ports(part, scene)
        ports = ", ".join(port.name for port in used)
        reach = (
            ""
            if self.least_band_end(part, scene) is None
            else f", or {MOTIONS} natural frequencies"
        )
        yield f"reduced to {aim(rom)}{reach}; ports {ports}"
        rest = [port.name for port in self.ports(part, scene) if port not in used]
        if rest:
            what = f"{part.name}: ports {', '.join(rest)}"
            why = "nothing of the scene needs them"
            if part.declares:
                why = "nothing joins them: a run leaves them out, an export keeps them"
            yield Neglected(what, why, "none")
        if by_complex_constants(part):
            what = f"{part.name}: losses of shear and of piezoelectric constants of their own"
            yield Neglected(what, "one Q for all compliances, real d of IEEE 176", "not estimated")
        elif tangent := loss_tangent(part):
            what = f"{part.name}: what a lossy dielectric changes of its stiffness"
            why = "its loss acts on the clamped capacitance"
            yield Neglected(
                what, why, f"{tangent:g} of the energy of fields inside at open electrodes"
            )
        yield from self.neglected(part, scene)

    def dimensions(self, part: Part) -> int:
        """Number of dimensions of the mesh."""
        return 3

    def finer_mesh(
        self, part: Part, build: Build, clock: Clock, most: float
    ) -> Iterator[Check | str]:
        if not self.discretisations:
            return
        (key,), facts = self.discretisations, build.facts(part)
        dimensions = self.dimensions(part)
        unknowns = facts.get("unknowns", 0.0) * TWICE**dimensions
        most *= IN_PLANE if dimensions == 2 else 1.0
        cause = f"{unknowns:.0f} unknowns, more than {most:.0f}"
        finer = None
        if unknowns <= most:
            try:
                doubled = with_values(part, {key: TWICE * _value_of(part, key)})
                with clock.stage("full model", f"{part.name}: mesh half as wide"):
                    finer = self.full(doubled, build.scene, clock).facts
            except UsageError as error:
                cause = str(error.message)
        if finer is None:
            yield f"{part.name}: no mesh half as wide ({cause}); {self.discretisation(part, build)}"
            return
        for words, limit in COARSE_MESH.items():
            changes = (
                abs(value / finer[name] - 1)
                for name, value in facts.items()
                if fnmatch(name, MESH_FACTS[words]) and finer.get(name)
            )
            change = max(changes, default=None)
            if change is not None:
                yield Check(f"mesh of {part.name} half as wide, {words}", change, limit)

    def discretisation(self, part: Part, build: Build) -> str:
        """Error estimate of its mesh, or why there is none."""
        return super().discretisation(part, build) or f"mesh: {NOT_ESTIMATED}"

    def sources(self) -> tuple[str, ...]:
        """Modules whose text the models of this type depend on, for the cache."""
        classes = (kind.__module__ for kind in type(self).__mro__ if issubclass(kind, LinearBody))
        return (*SOURCES, *classes)


def _value_of(part: Part, key: str) -> int:
    """The value of a dotted key of a part, a number of pieces."""
    return int(reduce_with(getattr, key.split("."), part.keys))


def _with_units(figures: Mapping[str, Any]) -> dict[str, Any]:
    """Values of an impedance analyser by name, with units."""
    from kc2spice.bodies.impedance import UNITS

    return {
        name: _with_units(value)
        if isinstance(value, Mapping)
        else Metric(value, UNITS.get(name, ""))
        for name, value in figures.items()
    }


def _reduction_check(name: str, error: float, unit: str, advice: str) -> Check:
    """A check of a reduced model's error, which warns before it fails."""
    limit, action = (WRONG, "fail") if error > WRONG else (COARSE_ROM, "warn")
    return Check(f"reduction of {name}", error, limit, unit, advice, action)  # type: ignore[arg-type]


def loss_tangent(part: Part) -> float:
    """tan delta of the dielectric that a body's damping states."""
    return float(getattr(getattr(part.keys, "damping", None), "loss_tangent", None) or 0.0)


def by_complex_constants(part: Part) -> bool:
    """Whether a body's losses are complex constants of IEEE 176."""
    return getattr(getattr(part.keys, "damping", None), "model", None) == "ieee176"


def losses_of(part: Part, model: LinearModel) -> ComplexConstants:
    """Complex constants of a body's damping, as stated at a frequency or at a resonance of its
    ``model``.

    Raises
    ------
    UsageError : there is no resonance that says at which frequency.
    """
    damping, facts = part.keys.damping, model.facts
    at = damping.frequency(facts.get("resonance_short_hz", facts.get("resonance_hz")))
    if at is None:
        where = f"{part.name}.damping.at"
        raise wrong(where, "no resonance at which stiffness is stated", None, "a frequency")
    return ComplexConstants(2 * damping.zeta, loss_tangent(part), at)


def _barely_damped(part: Part, model: LinearModel, band: tuple[float, float]) -> LinearModel:
    """``model`` with viscous damping that nowhere in the band exceeds that of complex constants, so
    that the error of a reduction is no larger with these."""
    loss = losses_of(part, model).loss_factor
    return replace(model, E=None, rayleigh=(0.0, loss / (2 * math.pi * band[1])))


def full_model(part: Part, scene: Scene, clock: Clock) -> LinearModel | None:
    """The full model of a body in its scene, None where a full model cannot have its losses."""
    kind = part.type
    assert isinstance(kind, LinearBody)
    return kind.build(part, scene, clock, full=True)


def full_alone(part: Part, scene: GovernedScene, clock: Clock) -> LinearModel:
    """The full model of a body outside its scene, with a warning of what matrices cannot hold."""
    if tangent := loss_tangent(part):
        warnings.warn(
            f"{part.name}.damping.loss_tangent: {tangent:g}: matrices have no constant loss of a "
            "dielectric: this model is without it; run and export the scene to have it",
            stacklevel=3,
        )
    if by_complex_constants(part):
        warnings.warn(
            f"{part.name}.damping.model: ieee176: matrices have no loss that is constant over "
            "frequency: this model has viscous damping; run and export the scene to have it",
            stacklevel=3,
        )
    kind = part.type
    assert isinstance(kind, LinearBody)
    return kind.full(part, scene, clock)


def scene_band(part: Part, scene: Scene, full: LinearModel) -> tuple[float, float]:
    """Band [Hz] over which a scene reduces the ``full`` model of its body."""
    kind = part.type
    assert isinstance(kind, LinearBody)
    target, key = reduction_target(part, scene), kind.model_key(part, scene)
    return _reaching(target.band, key, lambda: full)


def _require_ports(
    part: Part, missing: Sequence[str], known: Sequence[str], kind: str = ""
) -> None:
    for name in missing:
        raise unknown(f"{part.name} has no such {kind}port", name, known, part.name)


def _reaching(
    band: tuple[float, float], key: Mapping[str, Any], full: Callable[[], LinearModel]
) -> tuple[float, float]:
    """The band up to natural frequencies of the full model in it, see ``least_band_end``."""
    from kc2spice.rom.band import band_end

    (low, high), least_end = band, key.get("sure")
    if least_end is not None and high > least_end:
        high = min(high, max(least_end, band_end(full().pencil, MOTIONS, high)))
    return low, high


def aim(rom: Rom) -> str:
    """Target of a reduction in words: order or tolerance, and band."""
    low, high = rom.band
    target = f"order {rom.order}"
    if rom.order is None:
        target = f"as many states as keep the error below {rom.tolerance:g}"
    return f"{target}, band {low:g} … {high:g} Hz"


def reduction_target(part: Part, scene: Scene) -> Rom:
    """Settings of a body's reduction, as its record in the scene has them."""
    result = scene.records[part.name].reduction
    assert result is not None
    return result


def required_ports(part: Part, scene: JoinedScene) -> set[str]:
    """Names of ports or pins of ``part`` that other parts, its own pins or probes name."""
    prefix = f"{part.name}."
    assert isinstance(part.type, LinearBody)
    result = set(part.pins)
    for other in scene.parts.values():
        names = (*other.pins.values(), *scene.joins[other.name].values())
        result |= {name.removeprefix(prefix) for name in names if name.startswith(prefix)}
        # copies of it, with loads on all ports
        if scene.records[other.name].governs.get(part.name) == "copied":
            result |= {port.name for port in part.type.ports(part, scene) if port.kind in ANSWERS}
    for probe in scene.probes.values():
        if probe.of.startswith(tuple(f"{prefix}{word}." for word in WORDS)):
            result.add(probe.of.rpartition(".")[2])
    return result


def contacts_on(part: Part, scene: JoinedScene) -> Iterator[Part]:
    """The contacts that press on ports of ``part``."""
    for contact in scene.of("contact"):
        targets = scene.joins[contact.name].values()
        if any(target.startswith(f"{part.name}.") for target in targets):
            yield contact


def massless(part: Part, scene: JoinedScene) -> bool:
    """Whether a contact presses on ``part`` and wants no inertia behind its ports."""
    return any(contact.keys.inertia == "massless" for contact in contacts_on(part, scene))


def file_stamp(path: Path) -> str:
    """Identification of the content of a file; a copy elsewhere has the same."""
    try:
        result = path.stat()
        if not stat.S_ISREG(result.st_mode):
            return "no regular file"
        return _content(path, result.st_size, result.st_mtime_ns)
    except OSError:
        return "absent"


@lru_cache(maxsize=64)
def _content(path: Path, size: int, changed: int) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def inert_ports(model: LinearModel) -> tuple[str, ...]:
    """Pins of displacements where inertia alone answers a sudden force: D is zero there, and no
    state without mass moves them."""
    if model.first_order or not model.symmetric:
        return ()
    mass = model.pencil.dense().coefficients[2]
    yields = np.diag(model.D) + np.abs(model.B[~mass.any(axis=0)]).sum(axis=0)
    driven = (port for port in model.ports if port.kind != "output")
    return tuple(
        port.terminals[0]
        for port, yielding in zip(driven, yields, strict=True)
        if port.domain is TRANSLATION and yielding <= 0
    )


def free_to_move(model: LinearModel) -> bool:
    """Whether some motion of it costs no energy at rest, such as that of a body without support."""
    if resonators(model) is not None:
        return False
    rest = model.pencil.dense().coefficients[0]
    for axis in (1, 0):
        size = np.abs(rest).max(axis=axis, keepdims=True, initial=0.0)
        rest = rest / np.where(size > 0, size, 1.0)
    values = np.linalg.svd(rest, compute_uv=False)
    return bool(values.min(initial=np.inf) <= NO_ENERGY * values.max(initial=0.0))


def measured(part: Part, waves: Waveforms) -> np.ndarray | None:
    """``V / I`` (frequencies,) [Ohm] at the first electrical port, where both were recorded.

    None as well where the body feeds the circuit, so that V / I is not its own impedance.
    """
    voltage = waves.data.get(f"{part.name}.voltage")
    current = waves.data.get(f"{part.name}.current")
    if "frequency" not in waves or voltage is None or current is None:
        return None
    if not np.abs(current).min() > 0:
        return None
    result = np.asarray(voltage / current)
    return None if (result.real < -FEEDING * np.abs(result)).any() else result


def wave_name(name: str, ports: Sequence[Port], port: Port) -> str:
    """Name of a port's wave in results.

    For an electrical port it is the prefix of voltage and current. The first electrical port has
    the name of the part.
    """
    if port.paired:
        first = next(p for p in ports if p.paired)
        return name if port == first else f"{name}.{port.name}"
    word = "" if port.domain is None else port.domain.word
    return ".".join(filter(None, (name, word, port.name)))


def flow_name(name: str, ports: Sequence[Port], port: Port) -> str:
    """Name of the wave of the flow through a port's pin: the current of an electrode."""
    if port.paired:
        return f"{wave_name(name, ports, port)}.current"
    return f"{name}.{FLOWS[port.kind]}.{port.name}"
