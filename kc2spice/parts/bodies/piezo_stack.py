"""The part ``piezo_stack``: a multilayer piezoelectric chip with contact rings."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, ValidationInfo, model_validator

from kc2spice.bodies.stack_keys import PAPER_CERAMIC, PATCH_PORT, SECTORS, StackKeys
from kc2spice.core.cache import load_or_build
from kc2spice.core.domains import ELECTRICAL, TRANSLATION
from kc2spice.core.errors import UsageError
from kc2spice.core.figure import Shape
from kc2spice.core.key_actions import ChangeKey
from kc2spice.core.quantities import Count, Section, Time, Voltage, make_invalid_value_error, si
from kc2spice.core.user_warnings import warn_user
from kc2spice.core.waveforms import Waveforms, integrate_cumulatively
from kc2spice.fem.materials import find_material
from kc2spice.parts.bodies._body_model import (
    MODEL_SOURCES,
    describe_reduction_target,
    get_reduction_settings,
)
from kc2spice.parts.bodies._body_ports import find_required_ports
from kc2spice.parts.bodies._linear_body_keys import FieldKeys
from kc2spice.parts.bodies._material_losses import describe_unused_loss_tangents
from kc2spice.parts.bodies._meshed_bodies import MeshedBody, check_q_factor
from kc2spice.parts.bodies._neglected_effects import Envelope, compute_disc_air_mass
from kc2spice.parts.electronics.netlist import make_driver_table
from kc2spice.parts.mechanics._contact_keys import ContactKeys
from kc2spice.parts.mechanics._contact_surfaces import ContactSurface, LargestIndentation, make_pair
from kc2spice.rom.linear_model import Port
from kc2spice.scene.checks import Metric
from kc2spice.scene.part_records import NeglectedEffect, NumericalRequirements
from kc2spice.scene.parttype import register_part_type
from kc2spice.scene.plausibility import check_range
from kc2spice.scene.scene_classes import (
    BuiltScene,
    DeclaredScene,
    GovernedScene,
    JoinedScene,
    Part,
    Scene,
    WiredScene,
)
from kc2spice.scene.settings import RomKeys
from kc2spice.synthesis.mode_cards import COARSE_WEIGHTS, THROWING_WEIGHTS, StepWeights

# The modules with meshes and solvers are imported at first use, because most runs read their models
# from the cache and do not need these modules.
# Most runs do not need these modules, because they read their models from the cache.
if TYPE_CHECKING:
    from kc2spice.bodies.contact_pressure import LocalCompliance, PressureBasis
    from kc2spice.bodies.undamped_models import FiniteElementModel

# Frequency [Hz] at which the chip of Schütz et al. (2021) has a damping ratio of 1 % by default.
DAMPING_FREQUENCY = 250e3
# A piezoelectric chip rings during the whole kick if its damping ratio at ``DAMPING_FREQUENCY`` is
# below this value.
# During the ringing of a piezoelectric chip, the errors of the time steps add up.
# With the reltol for a damping ratio of 1 %, chips with a damping ratio of 0.01 to 0.1 % have
# launch velocity errors of up to 2.6e-4.
RINGING_DAMPING = 4e-3
MIN_DAMPING = 2e-4  # reltol is the same for all damping ratios below this value
# Factor on reltol for kicks of 40 to 60 V. A kick is a voltage pulse that launches the sphere.
# With LOW_KICK_FACTOR, simulated kicks of 40 to 60 V are as accurate as simulated kicks of 100 V.
LOW_KICK_FACTOR = 0.03
# Factor on reltol for a downward kick.
# In a downward kick, the chip leaves the sphere, vibrates freely, and strikes the sphere again.
# The errors of all time steps change the phase of the ringing at the impact.
# In a kick of -100 V, a reltol of 1e-4 is too large: it causes a relative error of the launch
# velocity of 1.2e-2.
# In a kick of -100 V, a reltol of 1e-6 reduces the relative error of the launch velocity to 6e-4.
# In a kick of -100 V, a reltol of 1e-7 reduces the relative error of the launch velocity to 1.1e-4.
DOWNWARD_RELTOL_FACTOR = 2e-3
# ratio of the top face's speed in a downward kick to its speed in an upward kick
DOWNWARD_SPEED_RATIO = 0.1
OVERSHOOT = 2.0  # ratio of the largest to the static displacement under a sudden load
MAX_TIME_STEP = 10e-6  # time step [s] that resolves a kick, its contact and the flight after it


DRIVER_TYPES = {  # part type of each driver, by its name in the key ``driver``
    "half_bridge": "half_bridge",
    "amplifier": "amplifier",
    "charge": "charge_drive",
    "user": "netlist",
}
MOUNTING_TEXTS = {  # description of each value of the key ``mounting``
    "roller": "frictionless roller under its bottom face",
    "glued": "bottom face glued down, u = 0",
    "free": "bottom face free",
}
# Relative decrease of the stroke of a typical chip whose bottom face is glued instead of sliding.
GLUED_STROKE_DROP = 0.16
PAPER_ORDER = 30  # number of unknowns of the reduced model in Schütz et al. (2021)
# Keys that determine the finite-element model.
# All other keys, such as ``drive``, only affect the circuit.
CHIP_KEYS = set(StackKeys.model_fields)
# The comparison of a chip with the chip of Schütz et al. (2021) ignores the values of these keys.
KEYS_IGNORED_FOR_PAPER_CHIP = {"mesh", "damping", "mounting", "preload_spring", "layer_thickness"}


class KickPulse(Section):
    """Keys of the drive pulse at the anode of a piezo stack.

    The pulse begins to rise at ``start`` and has the edge time ``edge``. ``width`` is the width of
    the pulse at half its height.
    """

    voltage: Voltage = Field(100.0, description="Peak voltage of the drive pulse")
    width: Time = Field(25e-6, gt=0, description="Width of the drive pulse at half of its height")
    edge: Time = Field(
        0.1e-6, gt=0, description="Rise time of the drive pulse, equal to the fall time"
    )
    start: Time = Field(
        0.5e-3, ge=0, description="Time at which the first drive pulse begins to rise"
    )
    period: Time | None = Field(
        None,
        gt=0,
        description="Period of the train of drive pulses; by default there is only one pulse",
    )
    count: Count | None = Field(
        None,
        ge=1,
        description="Number of pulses of the train of drive pulses; by default unlimited",
    )

    @model_validator(mode="after")
    def _require_edges_within_width(self) -> KickPulse:
        """Reject a pulse whose edge time is longer than the pulse width."""
        if self.edge > self.width:
            raise make_invalid_value_error(
                "the edge time of the pulse is longer than the pulse width",
                None,
                hint=f"lower the key `edge` to {self.width / 10:g} s",
            )
        return self


class PiezoStackKeys(StackKeys, FieldKeys):
    """Keys of a piezoelectric stack; by default, a voltage pulse drives the anode."""

    unsupported_key_hints: ClassVar[Mapping[str, str]] = {
        "voltage": "did you mean 'drive.voltage'?"
    }

    electrical: Literal["open", "short", "driven"] = Field(
        "driven",
        description=(
            "Electrical state of the stack's anode if no other part is connected to the "
            "anode: open, short-circuited (short), or driven by the pulse `drive` "
            "(driven)"
        ),
    )
    rated_field: Annotated[float, si("V/m")] = Field(
        2e6,
        gt=0,
        description=(
            "Largest permitted electric field in a layer in the poling direction, as stated "
            "in the data sheet; the default is 120 V across 60 um"
        ),
    )
    drive: KickPulse | None = Field(
        None, description="Voltage pulse that an ideal source applies to the anode of the stack"
    )
    driver: dict[str, dict[str, Any]] | None = Field(
        None,
        description=(
            "Driver circuit between the pulse source and the stack: a table { TYPE = { keys "
            "} }, where TYPE is the part type of a driver"
        ),
    )

    @model_validator(mode="before")
    @classmethod
    def _set_default_drive(cls, data: Any, info: ValidationInfo) -> Any:
        """Set the default drive pulse of a stack whose scene table has no key ``part``.

        A stack that is not driven gets no pulse. In a scene with a table ``harmonic``, the stack
        gets no pulse, because unit loads drive the stack.
        """
        short = (info.context or {}).get("short", ())
        if not short or "harmonic" in short or data.get("electrical", "driven") != "driven":
            return data
        return {"drive": {}, **data}

    @model_validator(mode="after")
    def _require_compatible_keys(self) -> PiezoStackKeys:
        """Reject the key ``fields`` on a coarse mesh, and ``driver`` for undriven stacks."""
        if self.fields and (self.mesh.order != 1 or self.mesh.layers_per_element != 1):
            raise make_invalid_value_error(
                (
                    "the key `fields` needs first-order elements that each contain one layer: "
                    "mesh.order = 1, mesh.layers_per_element = 1"
                ),
                None,
                hint="write  mesh = { order = 1, layers_per_element = 1 }",
            )
        if self.driver and self.electrical != "driven":
            raise make_invalid_value_error(
                'the key `driver` needs electrical = "driven"',
                None,
                hint='write  electrical = "driven"',
            )
        return self


class PiezoStack(MeshedBody[PiezoStackKeys]):
    """Part type ``piezo_stack``: multilayer piezoelectric chip, a reduced 3-D FE model."""

    name = "piezo_stack"
    origin_of_pins = (
        "The number of pins `ring…` follows from the key `mesh.rings` and from the parts that "
        "touch the chip."
    )
    title = "multilayer piezoelectric chip (3-D FE, reduced)"
    discretisations = ("mesh.refine",)
    base_material = PAPER_CERAMIC
    schema = PiezoStackKeys
    source = "FE (piezoelectric, 3-D)"

    def generate_tables(
        self, part: Part[PiezoStackKeys], data: Mapping[str, object]
    ) -> Mapping[str, Mapping[str, object]]:
        """Return the scene tables of the source and driver that the stack's keys imply."""
        keys: PiezoStackKeys = part.keys
        anode = f"{part.name}.anode"
        if keys.electrical == "short":
            return {f"{part.name}_drive": {"part": "source", "dc": 0.0, "pins": {"out": anode}}}
        if keys.drive is None or keys.electrical == "open":
            return {}
        d = keys.drive
        wave = {"high": d.voltage, **d.model_dump(exclude={"voltage"})}
        source: dict[str, Any] = {"part": "source", "pulse": wave, "pins": {"out": anode}}
        if keys.driver is None:
            return {f"{part.name}_drive": source}
        table, name = (
            make_driver_table(part, part.keys.driver or {}, DRIVER_TYPES, data),
            f"{part.name}_driver",
        )
        pins = {"out": anode}
        if table["part"] == "charge_drive":
            pins = {"anode": anode, "cathode": f"{part.name}.cathode"}
        source["pins"] = {"out": f"{name}.command"}
        return {f"{part.name}_drive": source, name: {**table, "pins": pins}}

    def ports(self, part: Part[PiezoStackKeys], scene: DeclaredScene) -> tuple[Port, ...]:
        """Return the ports of the part's model."""
        names = list_ring_names(part.keys.mesh.rings + 1)
        if find_pressure_basis(part, scene) is not None:
            names = [PATCH_PORT]
        ring_ports = (Port(name, TRANSLATION.port) for name in names)
        return (*ring_ports, Port("anode", ELECTRICAL.port, pins=("anode", "cathode")))

    def used_ports(self, part: Part[PiezoStackKeys], scene: JoinedScene) -> tuple[Port, ...]:
        """Return the used ports: anode and rings, up to the last ring that the scene uses."""
        if find_pressure_basis(part, scene) is not None:
            return super().used_ports(part, scene)
        *ring_ports, anode = self.ports(part, scene)
        return (*ring_ports[: count_used_rings(part, scene)], anode)

    def problems(self, part: Part[PiezoStackKeys], scene: GovernedScene) -> Iterator[UsageError]:
        """Yield an error for each invalid key of the part."""
        yield from super().problems(part, scene)
        keys, name, drive = part.keys, part.name, part.keys.drive
        transient = scene.analysis.type == "transient"
        if keys.mounting == "free" and scene.list_parts("contact") and transient:
            yield part.wrong(
                "mounting",
                "the mounting of the chip is free, but another part rests on the chip",
                got="free",
                expected="roller, glued or a stiffness per area",
                hint='write  mounting = "glued"',
            )
        if drive and keys.electrical == "driven" and transient and drive.start >= scene.stop_time:
            yield part.wrong(
                "drive.start",
                "the kick starts after the simulation ends",
                got=f"{drive.start:g} s",
                expected=f"before the end of the simulation, {scene.stop_time:g} s",
                hint=ChangeKey("lower", "drive.start", "below", f"{scene.stop_time:g} s"),
            )
        if drive and keys.electrical != "driven":
            warn_user(
                f'{name}: the key `drive` has no effect with electrical = "{keys.electrical}": '
                f'write  {name}.electrical = "driven"'
            )
        yield from check_q_factor(name, keys.damping, [keys.ceramic])
        reason = "multilayer ceramics are sintered from 0.1 mm to 0.1 m"
        wide = "side" if keys.diameter is None else "diameter"
        yield from check_range(f"{name}.{wide}", 2 * max(keys.half_widths), "m", 1e-4, 0.1, reason)
        yield from check_range(f"{name}.height", keys.height, "m", 1e-5, 0.2, reason)
        layer = keys.height / keys.layers
        tape = "ceramic tape is 1 um to a few millimetres thick; this is height / layers"
        yield from check_range(f"{name}.layers", layer, "m a layer", 1e-6, 5e-3, tape)
        if drive is not None and keys.driver is None:
            field = abs(drive.voltage) / layer
            why = f"{drive.voltage:g} V across {layer:.3g} m; the ceramic breaks down"
            yield from check_range(f"{name}.drive.voltage", field, "V/m", 0.0, 2e7, why)

    def contact_surface(
        self, part: Part[PiezoStackKeys], scene: GovernedScene, ports: tuple[str, ...] = ()
    ) -> ContactSurface:
        """Return the contact surface: a port on each node ring, or one pressure port."""
        if part.keys.poling == "x":
            raise part.wrong(
                "poling",
                'a stack with poling = "x" moves sideways and cannot have a contact',
                got="x",
                expected="poling = z for a stack with a contact",
                hint='write  poling = "z"',
            )
        shape, radii = find_pressure_basis(part, scene), compute_ring_radii(part.keys)
        modulus = self.indentation_modulus(part)
        if shape is None:
            names = ports or tuple(list_ring_names(len(radii)))
            rings = list(map(partial(_read_ring_number, part), names))
            distance = tuple(radii[rings].tolist())
            return ContactSurface(part.name, names, distance, sectors=SECTORS, modulus=modulus)
        return ContactSurface(
            part.name,
            (PATCH_PORT,),
            (0.0,),
            sectors=SECTORS,
            patch=float(shape.nodes[-1]),
            compliance=partial(_find_compliance, part),
            pace=part.keys.damping.beta,
            modulus=modulus,
        )

    def numerics(
        self, part: Part[PiezoStackKeys], scene: WiredScene
    ) -> Iterator[NumericalRequirements]:
        """Yield requirements on time step and tolerances for contacts with a piezo stack.

        Tighter tolerances are necessary if the chip rings, or if the drive pulse has a low voltage.
        Ringing increases the phase error of the trapezoidal rule. If the drive pulse has a low
        voltage, fewer contact rings of the chip touch the sphere. With fewer touching contact
        rings, the launch velocity is more sensitive to the error of each time step. At 40 to 60 V,
        the relative error of the launch velocity is ten times the error at 100 V with the same
        tolerances. The error of the launch velocity is proportional to reltol^0.55.
        """
        if not scene.list_parts("contact"):
            return
        ratio = math.pi * DAMPING_FREQUENCY * part.keys.damping.beta
        close = math.sqrt(min(1.0, max(ratio, MIN_DAMPING) / RINGING_DAMPING))
        speed = _estimate_kick_speed(part, scene)
        if self.weights(part, scene) == COARSE_WEIGHTS and speed is not None:
            # A driver at the anode may slow down a kick, so the tolerances for slow kicks are used.
            # For example, an amplifier of 5 A reduces the launch velocity to 0.67 m/s.
            # With the tolerances for kicks of 1 m/s, a launch velocity of 0.67 m/s has a relative
            # error of 1.5e-3. LOW_KICK_FACTOR therefore tightens the tolerances for slow kicks.
            driven = not scene.list_joined_types(part.name, "anode") <= {"source"}
            close *= min(1.0, LOW_KICK_FACTOR if driven else max(speed**8, LOW_KICK_FACTOR))
        if _moves_down_first(part):
            close = min(close, DOWNWARD_RELTOL_FACTOR)
        what = f"contacts of {part.name}; error control chooses shorter steps"
        chgtol = min(1.0, speed or 1.0)
        yield NumericalRequirements(
            what, MAX_TIME_STEP, overrides_others=True, reltol=close, chgtol=chgtol
        )

    def weights(self, part: Part[PiezoStackKeys], scene: DeclaredScene) -> StepWeights:
        """Return the weights of the body's modes in the simulator's time step control.

        If the drive pulse is negative, the chip first moves downwards, and then vibrates until it
        hits the sphere. The vibration of the chip before the impact affects the launch velocity. To
        resolve the vibration before the impact, the weights for a negative drive pulse are
        ``THROWING_WEIGHTS``.
        """
        return THROWING_WEIGHTS if _moves_down_first(part) else super().weights(part, scene)

    def largest_indentations(
        self, part: Part[PiezoStackKeys], scene: GovernedScene
    ) -> Iterator[LargestIndentation]:
        """Yield an upper bound of the indentation: a multiple of the chip's free stroke."""
        voltage = find_highest_voltage(part, scene)
        if voltage:
            stroke = compute_free_stroke(part.keys, voltage)
            why = f"{OVERSHOOT:g} times the free stroke of {part.name} at {voltage:g} V"
            yield LargestIndentation(OVERSHOOT * stroke, why)

    def outline(self, part: Part[PiezoStackKeys], scene: Scene) -> Iterator[Shape]:
        """Yield the side view of the stack."""
        keys = part.keys
        label = f"{part.name}: {1e3 * keys.side:g} mm wide, {1e3 * keys.height:g} mm high, "
        label += f"{keys.layers} layers"
        yield Shape(0.0, -keys.height / 2, keys.side, keys.height, "ceramic", label, keys.layers)

    def headline(self, part: Part[PiezoStackKeys]) -> str:
        """Return the headline of a library header, which states the stack's mounting."""
        return f"{self.title}; {describe_mounting(part.keys)}"

    def material_voltage_rating(self, part: Part[PiezoStackKeys]) -> float:
        """Return the material's voltage rating [V]: rated field times layer thickness."""
        return float(part.keys.rated_field * part.keys.height / part.keys.layers)

    def make_full_model_key(
        self, part: Part[PiezoStackKeys], scene: GovernedScene
    ) -> Mapping[str, Any]:
        """Return the cache key of the full model."""
        shape, chip = (
            find_pressure_basis(part, scene),
            part.keys.model_dump(mode="json", include=CHIP_KEYS),
        )
        result = {"chip": chip, "field": part.keys.rated_field}
        return result if shape is None else result | {"pressure_basis": shape.nodes.tolist()}

    def choose_reduction(self, part: Part[PiezoStackKeys], scene: Scene) -> RomKeys:
        """Return the reduction settings that the scene states, or default settings.

        For the chip of Schütz et al. (2021), the default is the number of unknowns that these
        authors use. For other stacks, the default is a tolerance in a band whose upper end is
        inversely proportional to the height of the stack.
        """
        specified = part.keys.rom or scene.rom
        if not specified.is_default:
            return specified
        plain = type(part.keys)()
        if all(
            getattr(part.keys, key) == getattr(plain, key)
            for key in CHIP_KEYS - KEYS_IGNORED_FOR_PAPER_CHIP
        ):
            return RomKeys(order=PAPER_ORDER, band=specified.band)
        if "band" in specified.model_fields_set:
            return specified
        low, high = specified.band
        return RomKeys(band=(low, high * plain.height / part.keys.height))

    def envelope(self, part: Part[PiezoStackKeys], scene: DeclaredScene) -> Envelope:
        """Return the outer size of the stack, used to estimate neglected effects."""
        keys = part.keys
        (x, y), caps = keys.half_widths, (keys.bottom_cap, keys.top_cap)
        height = keys.height + sum(cap.thickness for cap in caps if cap is not None)
        area, rim = 4 * x * y, 4 * (x + y)
        if keys.diameter is not None:
            area, rim = math.pi * x**2, 2 * math.pi * x
        surface = 2 * area + rim * height
        return Envelope(
            compute_disc_air_mass(math.sqrt(area / math.pi)),
            area * height * keys.ceramic.density,
            surface,
        )

    def describe_support(self, part: Part[PiezoStackKeys]) -> str:
        """Describe how the body is supported, for the list of neglected effects."""
        return "" if part.keys.mounting == "roller" else describe_mounting(part.keys)

    def make_fe_model(self, part: Part[PiezoStackKeys], scene: GovernedScene) -> FiniteElementModel:
        """Build the full finite-element model of the stack."""
        from kc2spice.bodies.stack import make_stack

        shape = find_pressure_basis(part, scene)
        pressure = (
            None
            if shape is None
            else shape.compute_pressure(_find_compliance(part, shape).rigid_force_shares)
        )
        return make_stack(part.keys, part.keys.rated_field, pressure)

    def metrics(
        self, part: Part[PiezoStackKeys], build: BuiltScene, waves: Waveforms
    ) -> Mapping[str, object]:
        """Return the metrics of the part, keyed by name."""
        result = dict(super().metrics(part, build, waves))
        if "time" not in waves:
            return result
        pressed = bool(build.scene.list_parts("contact"))
        centre = f"{part.name}.u.{self.ports(part, build.scene)[0].name}"
        if pressed and centre in waves:
            result["kick_stroke_m"] = Metric(float(waves[centre].max()), "m")
        shape, scene = find_pressure_basis(part, build.scene), build.scene
        # The stress under the contact is computed separately, because the mesh of the chip does not
        # resolve it.
        if part.keys.fields and shape is not None:
            from kc2spice.bodies.contact_pressure import UNITS, compute_stresses_under_force

            contacts = scene.list_parts_with_schema("contact", ContactKeys)
            name = next(c.name for c in contacts if c.keys.shape == "pressure")
            if (most := float(waves[f"{name}.force"].max())) > 0:
                forces = make_pair(scene.parts[name], scene).compute_basis_forces(most)
                inside = compute_stresses_under_force(part.keys, shape, forces)
                for key, value in inside.items():
                    result[f"{name}_{key}"] = Metric(value, UNITS[key])
        current = waves.data.get(f"{part.name}.current")
        if part.keys.electrical == "driven" and (part.keys.driver or not pressed):
            peak = float(np.abs(waves[f"{part.name}.voltage"]).max())
            result["kick_voltage_peak_v"] = Metric(peak, "V")
            if current is not None:
                charge = integrate_cumulatively(current, waves["time"])
                result["kick_current_peak_a"] = Metric(float(np.abs(current).max()), "A")
                result["kick_charge_peak_c"] = Metric(float(np.abs(charge).max()), "C")
        return result

    def indentation_modulus(self, part: Part[PiezoStackKeys]) -> float:
        """Return the indentation modulus [Pa] of the material at the top surface.

        If the stack has a top cap, the material is the material of the top cap. Otherwise, the
        material is the ceramic.
        """
        keys, cap = part.keys, part.keys.top_cap
        stated = None if cap is None else cap.material
        top = keys.ceramic if stated is None else find_material(stated, "top_cap.material")
        return float(top.indentation_modulus)

    def notes(self, part: Part[PiezoStackKeys], scene: Scene) -> Iterator[str | NeglectedEffect]:
        """Yield the assumptions of the model and the effects that it neglects."""
        keys, rom = part.keys, get_reduction_settings(part, scene)
        pressed = find_pressure_basis(part, scene) is not None
        used, last = count_used_rings(part, scene), keys.mesh.rings
        ports = "pressure on a patch as port" if pressed else f"{used} rings as ports"
        yield f"quarter chip, {keys.layers} layers, {describe_mounting(keys)}"
        yield f"reduced model with {describe_reduction_target(rom)}"
        yield f"ports: anode {keys.electrical}, {ports}"
        yield from describe_unused_loss_tangents(keys, keys.damping, self.base_material)
        yield from self.list_neglected_effects(part, scene)
        if keys.mounting == "roller":
            why = "the bottom face slides without friction on a plane"
            error = f'with {part.name}.mounting = "glued": stroke about '
            error += f"{100 * GLUED_STROKE_DROP:g} % smaller, first resonance about 14 % higher "
            error += "(computed for a typical chip)"
            yield NeglectedEffect(f"mounting of {part.name}", why, error, size=GLUED_STROKE_DROP)
        if keys.fields and pressed:
            why = "mesh of the part too coarse; pressure and shear stress are from a graded mesh"
            yield NeglectedEffect(
                f"tensile stress around the contact on {part.name}", why, "not estimated"
            )
        if (several := keys.mesh.layers_per_element) > 1:
            why = f"{several} layers share one element: mesh.layers_per_element"
            size = (several / keys.layers) ** 2
            error = f"first resonances: error at most {100 * size:.2g} %; "
            error += "stroke and capacitance unchanged"
            yield NeglectedEffect(
                f"individual layers of {part.name} in one finite element", why, error, size=size
            )
        if used <= last and not pressed:
            effect = f"{part.name}: ports at ring{used}" + f" to ring{last}" * (used < last)
            yield NeglectedEffect(effect, "no part or probe uses them", "checked after the run")


def _estimate_kick_speed(part: Part[PiezoStackKeys], scene: GovernedScene) -> float | None:
    """Return the estimated speed [m/s] of the top face in a kick; None without one.

    The speed is the free stroke divided by ``4 H / c``, where H is the height of the chip and c is
    the speed of sound. If the edge time of the pulse is longer than ``4 H / c``, the estimated
    speed is the free stroke divided by the edge time.
    """
    voltage = find_highest_voltage(part, scene)
    if not voltage:
        return None
    ceramic = part.keys.ceramic
    sound = math.sqrt(ceramic.C[2, 2] / ceramic.density)
    stroke = compute_free_stroke(part.keys, voltage)
    edge = 0.0 if part.keys.drive is None else part.keys.drive.edge
    speed = stroke / max(4 * part.keys.height / sound, edge)
    return max(1e-3, DOWNWARD_SPEED_RATIO * speed if _moves_down_first(part) else speed)


def _moves_down_first(part: Part[PiezoStackKeys]) -> bool:
    """Return whether the drive pulse is negative, so that the top face moves down."""
    drive = part.keys.drive
    return drive is not None and part.keys.electrical == "driven" and drive.voltage < 0


def describe_mounting(keys: StackKeys) -> str:
    """Describe the support of the chip, and additions such as caps, as text."""
    words = [MOUNTING_TEXTS.get(str(keys.mounting), "")]
    if isinstance(keys.mounting, float):
        words = [f"bottom face on springs of {keys.mounting:g} N/m per m2 along each axis"]
    if keys.poling == "x":
        words.append("poled along x, shear mode")
    for place, cap in (("below", keys.bottom_cap), ("on top", keys.top_cap)):
        if cap is not None:
            made_of = cap.material if isinstance(cap.material, str) else "a user-defined material"
            material_name = "unpoled ceramic" if cap.material is None else made_of
            words.append(f"{1e3 * cap.thickness:g} mm of {material_name} {place}")
    if keys.preload_spring is not None:
        words.append(f"a spring of {keys.preload_spring:g} N/m on the top face")
    return ", ".join(words)


def find_pressure_basis(part: Part[PiezoStackKeys], scene: DeclaredScene) -> PressureBasis | None:
    """Return basis functions of the contact pressure on the top face, or None.

    Return None if no contact has ``shape = "pressure"``. The basis functions extend from the centre
    to the radius of the largest contact ring.
    """
    for contact in scene.list_parts_with_schema("contact", ContactKeys):
        if contact.keys.shape == "pressure" and contact.keys.a in (None, part.name):
            from kc2spice.bodies.contact_pressure import choose_pressure_basis

            return choose_pressure_basis(
                contact.keys.spacing, float(compute_ring_radii(part.keys)[-1])
            )
    return None


def compute_ring_radii(keys: StackKeys) -> np.ndarray:
    """Return the radii [m] of the rings of nodes; ``ring0``, the centre, is first."""
    return keys.mesh.ring_spacing * np.arange(keys.mesh.rings + 1)


def count_used_rings(part: Part[PiezoStackKeys], scene: JoinedScene) -> int:
    """Return the number of rings of nodes that are ports, counted from ``ring0``.

    The last counted ring is the outermost ring that another part or a probe uses. If the stack is
    the only part, all rings are ports.
    """
    if len(scene.parts) == 1 or scene.ports == "all":
        return 1 + int(part.keys.mesh.rings)
    names = find_required_ports(part, scene)
    for probe in scene.probes.values():
        owner, dot, rest = probe.of.partition(".")
        if owner == part.name and dot:
            names.add(rest.partition(".")[0])
    rings = [_read_ring_number(part, name) for name in names if name.startswith("ring")]
    return 1 + max(rings, default=-1)


def list_ring_names(count: int) -> list[str]:
    """List the names of the ``count`` innermost rings, each of which is a port."""
    return list(map("ring{}".format, range(count)))


def _read_ring_number(part: Part[PiezoStackKeys], name: str) -> int:
    """Return the number of the ring in a port name, such as 3 in ``ring3``."""
    match, last = re.fullmatch(r"ring(\d{1,3})", name), part.keys.mesh.rings
    if match is None or int(match[1]) > last:
        raise part.wrong(
            "",
            f"{part.name} has no port of this name",
            got=repr(name),
            expected=f"ring0 to ring{last}",
            hint=f"write ring{last}, or raise {part.name}.mesh.rings",
        )
    return int(match[1])


def find_highest_voltage(part: Part[PiezoStackKeys], scene: DeclaredScene) -> float:
    """Return the largest voltage [V] of the anode's drive; 0 without a drive."""
    keys = part.keys
    if keys.drive is not None and keys.electrical == "driven":
        return abs(keys.drive.voltage)
    drivers = scene.list_parts("half_bridge", "amplifier", "charge_drive")
    result = [max(map(abs, part.type.rails(part))) for part in drivers]
    for source in scene.parts.values():
        wave = source.type.voltage(source, scene)
        if wave is not None:
            result.append(float(np.abs(np.array(wave.points)[:, 1]).max()))
    return max(result, default=0.0)


def compute_free_stroke(keys: StackKeys, voltage: float) -> float:
    """Return the static free stroke [m] of a piezoelectric stack at a voltage [V].

    The piezoelectric constant d is d33, or d15 if the stack deforms in shear.
    """
    axis, strain = (2, 2) if keys.poling == "z" else (0, 4)
    return keys.layers * abs(keys.ceramic.d[axis, strain] * voltage)


def _find_compliance(part: Part[PiezoStackKeys], shape: PressureBasis) -> LocalCompliance:
    """Return the local compliance of the top face, from the cache if possible."""
    from kc2spice.bodies.contact_pressure import LocalCompliance, compute_local_compliance

    chip = part.keys.model_dump(mode="json", include=CHIP_KEYS - {"damping"})
    return load_or_build(
        "indented",
        {"chip": chip, "pressure_basis": shape.nodes.tolist()},
        lambda: compute_local_compliance(part.keys, shape),
        classes=(LocalCompliance,),
        sources=MODEL_SOURCES,
    )


register_part_type(PiezoStack())
