"""The layered piezoelectric chip: FE model, reduction, a subcircuit with rings as contact ports."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from functools import lru_cache
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import Field

from kc2spice.core.cache import cached
from kc2spice.core.errors import UsageError
from kc2spice.core.figure import Shape
from kc2spice.core.quantities import Count, Section, Time, Voltage, si
from kc2spice.core.waveform import Waveform, pulse
from kc2spice.core.waveforms import Waveforms
from kc2spice.fem.materials import Material, material
from kc2spice.fem.piezo.keys import PATCH, SECTORS, Chip
from kc2spice.parts._linear_body import SOURCES
from kc2spice.parts._meshed import FieldKeys, MeshedBody
from kc2spice.parts.netlist import first_netlist
from kc2spice.rom.linear import Port
from kc2spice.scene.model import Part, Scene
from kc2spice.scene.parttype import (
    Build,
    Dents,
    LeftOut,
    Modelled,
    Reach,
    Surface,
    TimeScale,
    register,
)
from kc2spice.scene.plausible import within
from kc2spice.scene.settings import Rom
from kc2spice.spice.realize import STRIKING, Watch

# What builds is imported where it builds: most runs find their models in the cache.
if TYPE_CHECKING:
    from kc2spice.bodies.device import Device
    from kc2spice.bodies.pressure import Hats, Pressed

USUAL = 250e3  # Hz, where the paper's chip is damped by 1 %
# Damping ratio there below which modes ring on through a kick, so that the errors of steps add up:
# launches of chips damped by 0.01 to 0.1 % miss by up to 2.6e-4 at the reltol of those of 1 %.
RINGING, UNDAMPED = 4e-3, 2e-4
LOW_KICK = 0.03  # of reltol: what kicks of 40 to 60 V need to launch as exactly as those of 100 V
# The same of a kick downwards: the chip leaves the sphere, rings, and strikes it at a phase that
# every step since has moved. -100 V: 1.2e-2 at reltol 1e-4, 6e-4 at 1e-6, 1.1e-4 at 1e-7.
DOWNWARDS, SLOWER = 2e-3, 0.1
SWING = 2.0  # an elastic body overshoots a step of its load by as much again
FLIGHT = 10e-6  # s, the longest step: a kick, its contact and the flight after it are resolved


PAPER_ORDER = 30
GEOMETRY = (  # what makes it the paper's chip
    "side",
    "depth",
    "diameter",
    "height",
    "layers",
    "bottom_cap",
    "top_cap",
    "material",
    "poling",
)


class Drive(Section):
    """Kick pulse: rises from ``start`` within ``edge``; ``width`` is measured at half height."""

    voltage: Voltage = Field(100.0, description="height of the pulse")
    width: Time = Field(25e-6, gt=0, description="at half height")
    edge: Time = Field(0.1e-6, gt=0, description="rise and fall time")
    start: Time = Field(0.5e-3, ge=0, description="of the rise")
    period: Time | None = Field(None, gt=0, description="of a train of pulses")
    count: Count | None = Field(None, ge=1, description="pulses of a train; without end if absent")

    @property
    def waveform(self) -> Waveform:
        """The pulse as a function of time."""
        return pulse(0.0, self.voltage, self.start, self.width, self.edge, self.period, self.count)


class Stack(Chip, FieldKeys):
    """Piezoelectric chip actuator, with its drive where nothing else is joined to the anode."""

    electrical: Literal["open", "short", "driven"] = Field(
        "driven", description="of an anode that nothing is joined to"
    )
    rated_field: Annotated[float, si("V/m")] = Field(
        2e6,
        gt=0,
        description="largest field in a layer along its poling: an assumption, 120 V at 60 um; "
        "set what the maker of the stack allows",
    )
    drive: Drive | None = Field(None, description="pulse of an ideal source on the anode")
    driver: dict[str, dict[str, Any]] | None = Field(
        None, description="electronics between the pulse and the chip: { TYPE = { keys } }"
    )


class PiezoStack(MeshedBody):
    name = "piezo_stack"
    title = "layered piezoelectric chip (3-D FE, reduced)"
    schema = Stack
    source = "FE (piezoelectric, linear)"

    def defaults(self, table: Mapping[str, Any], others: Mapping[str, Any]) -> dict[str, Any]:
        driven = table.get("electrical", "driven") == "driven"
        return {"drive": {}} if driven and "harmonic" not in others else {}

    def expand(self, part: Part, data: Mapping[str, Any]) -> Mapping[str, Mapping[str, Any]]:
        keys: Stack = part.keys
        if keys.electrical == "short":
            pins = {"out": f"{part.name}.anode"}
            return {f"{part.name}_drive": {"part": "source", "dc": 0.0, "pins": pins}}
        if keys.drive is None or keys.electrical == "open":
            return {}
        found: dict[str, Mapping[str, Any]] = {}
        target = f"{part.name}.anode"
        if keys.driver is not None:
            if len(keys.driver) != 1:
                raise UsageError(
                    "needs one driver",
                    where=f"{part.name}.driver",
                    got=", ".join(keys.driver),
                    expected="one table of half_bridge, amplifier, charge, user",
                )
            ((kind, table),) = keys.driver.items()
            name, chosen = f"{part.name}_driver", _driver_type(part, kind)
            at = (part.name, "driver", kind)
            found[name] = {**_driver(part, kind, table, data), "part": chosen, "at": at}
            target = f"{name}.command"
        d = keys.drive
        wave = {"high": d.voltage, **d.model_dump(exclude={"voltage"})}
        source = {"part": "source", "pulse": wave, "pins": {"out": target}}
        return {f"{part.name}_drive": source} | found

    def ports(self, part: Part, scene: Scene) -> tuple[Port, ...]:
        names = [f"ring{k}" for k in range(rings(part))]
        if pressure_hats(part, scene) is not None:
            names = [PATCH]
        own = (Port(name, "mechanical") for name in names)
        return (*own, Port("anode", "electrical", pins=("anode", "cathode")))

    def kept(self, part: Part, scene: Scene) -> tuple[Port, ...]:
        """Rings up to the last that is needed, so that every scene's are nested."""
        if pressure_hats(part, scene) is not None:
            return super().kept(part, scene)
        *own, anode = self.ports(part, scene)
        return (*own[: kept_rings(part, scene)], anode)

    def problems(self, part: Part, scene: Scene) -> Iterator[UsageError]:
        yield from super().problems(part, scene)
        yield from _problems(part, scene)

    def implausible(self, part: Part, scene: Scene) -> Iterator[UsageError]:
        keys, name = part.keys, part.name
        made = "multilayer ceramics are sintered from 0.1 mm to 0.1 m"
        wide = "side" if keys.diameter is None else "diameter"
        yield from within(f"{name}.{wide}", 2 * max(keys.half), "m", 1e-4, 0.1, made)
        yield from within(f"{name}.height", keys.height, "m", 1e-5, 0.2, made)
        layer = keys.height / keys.layers
        tape = "ceramic tape is cast from 1 um to some millimetres; height over layers"
        yield from within(f"{name}.layers", layer, "m a layer", 1e-6, 5e-3, tape)
        if keys.drive is not None and keys.driver is None:
            field = abs(keys.drive.voltage) / layer
            why = f"{keys.drive.voltage:g} V across {layer:.3g} m; the ceramic breaks down"
            yield from within(f"{name}.drive.voltage", field, "V/m", 0.0, 2e7, why)

        yield from super().implausible(part, scene)

    def surface(self, part: Part, scene: Scene, ports: tuple[str, ...] = ()) -> Surface:
        if part.keys.poling == "x":
            raise UsageError(
                "the top of a stack that shears moves sideways: nothing can press on it",
                where=f"{part.name}.poling",
                got="x",
                expected="z under a contact",
            )
        shape, radii = pressure_hats(part, scene), ring_radii(part.keys)
        if shape is not None:
            return Surface(
                (PATCH,),
                (PATCH,),
                (PATCH,),
                (0.0,),
                sectors=SECTORS,
                patch=float(shape.nodes[-1]),
                dents=lambda hats: _dents(part, hats),
            )
        names = ports or tuple(f"ring{k}" for k in range(len(radii)))
        distance = tuple(float(radii[_ring(part, name)]) for name in names)
        return Surface(names, names, names, distance, sectors=SECTORS)

    def time_scales(self, part: Part, scene: Scene) -> Iterator[TimeScale]:
        """A trapezoid's error of phase adds up as long as a mode rings while something touches.

        A low kick closes fewer rings and its launch depends more on every step: from 40 to 60 V
        the relative error of one setting is ten times that at 100 V. It falls as reltol^0.55.
        """
        if not scene.of("contact"):
            return
        close = math.sqrt(min(1.0, max(_damped(part), UNDAMPED) / RINGING))
        speed = _kick_speed(part, scene)
        if self.coarse(part, scene) and speed is not None:
            slow = LOW_KICK if _behind_driver(part, scene) else max(speed**8, LOW_KICK)
            close *= min(1.0, slow)
        if _downwards(part):
            close = min(close, DOWNWARDS)
        what = f"contacts of {part.name}, within which error control decides"
        chgtol = min(1.0, speed or 1.0)
        yield TimeScale(what, FLIGHT, decides=True, reltol=close, chgtol=chgtol)

    def coarse(self, part: Part, scene: Scene) -> bool:
        """Its ringing is what strikes the sphere if the kick begins downwards."""
        return super().coarse(part, scene) and not _downwards(part)

    def watch(self, part: Part, scene: Scene) -> Watch:
        return STRIKING if _downwards(part) else super().watch(part, scene)

    def reach(self, part: Part, scene: Scene) -> Iterator[Reach]:
        voltage = highest_voltage(part, scene)
        if voltage:
            stroke = free_stroke(part.keys, voltage)
            why = f"{SWING:g} times the free stroke of {part.name} at {voltage:g} V"
            yield Reach(SWING * stroke, why)

    def outline(self, part: Part, scene: Scene) -> Iterator[Shape]:
        keys = part.keys
        label = f"{part.name}: {1e3 * keys.side:g} mm wide, {1e3 * keys.height:g} mm high, "
        label += f"{keys.layers} layers"
        yield Shape(0.0, -keys.height / 2, keys.side, keys.height, "ceramic", label, keys.layers)

    def headline(self, part: Part) -> str:
        return f"{self.title}; {mounted(part.keys)}"

    def by_material(self, part: Part) -> float:
        return float(part.keys.rated_field * part.keys.height / part.keys.layers)

    def full_key(self, part: Part, scene: Scene) -> Mapping[str, Any]:
        shape = pressure_hats(part, scene)
        found = {"chip": chip_of(part.keys).model_dump(mode="json")}
        return found if shape is None else found | {"hats": shape.nodes.tolist()}

    def reduction(self, part: Part, scene: Scene) -> Rom:
        """As asked; else the paper's chip has the paper's order, and any other stack a tolerance
        over the band that is to it what the paper's is to the paper's chip."""
        asked = part.keys.rom or scene.rom
        if not asked.left_open:
            return asked
        plain = type(part.keys)()
        if all(getattr(part.keys, key) == getattr(plain, key) for key in GEOMETRY):
            return Rom(order=PAPER_ORDER, band=asked.band)
        if "band" in asked.model_fields_set:
            return asked
        low, high = asked.band
        return Rom(band=(low, high * plain.height / part.keys.height))

    def device(self, part: Part, scene: Scene) -> Device:
        chip, shape = chip_of(part.keys), pressure_hats(part, scene)
        if shape is None:
            return _device(chip, part.keys.rated_field)
        from kc2spice.bodies.pressure import patched_device

        return patched_device(chip, shape, _pressed(chip, shape), part.keys.rated_field)

    def metrics(self, part: Part, build: Build, waves: Waveforms) -> Mapping[str, Any]:
        found = dict(super().metrics(part, build, waves))
        if "time" not in waves:
            return found
        pressed = bool(build.scene.of("contact"))
        centre = f"{part.name}.u.{self.ports(part, build.scene)[0].name}"
        if pressed and centre in waves:
            found["kick_stroke_m"] = float(waves[centre].max())
        found |= self._under_pressure(part, build, waves)
        current = waves.data.get(f"{part.name}.current")
        if part.keys.electrical == "driven" and (part.keys.driver or not pressed):
            found["kick_voltage_peak_v"] = float(np.abs(waves[f"{part.name}.voltage"]).max())
            if current is not None:
                charge = np.cumsum(np.diff(waves["time"]) * (current[1:] + current[:-1]) / 2)
                found["kick_current_peak_a"] = float(np.abs(current).max())
                found["kick_charge_peak_c"] = float(np.abs(charge).max())
        return found

    def _under_pressure(self, part: Part, build: Build, waves: Waveforms) -> dict[str, float]:
        """Stresses under the hats when they carry most, which the mesh of the stack does not
        resolve."""
        shape, scene = pressure_hats(part, build.scene), build.scene
        if not part.keys.fields or shape is None:
            return {}
        from kc2spice.bodies.pressure import stressed
        from kc2spice.parts.contact import hat_forces

        name = next(c.name for c in scene.of("contact") if c.keys.shape == "pressure")
        most = float(waves[f"{name}.force"].max())
        if most <= 0:
            return {}
        found = stressed(chip_of(part.keys), shape, hat_forces(scene.parts[name], scene, most))
        return {
            f"{name}_pressure_pa": found.pressure,
            f"{name}_shear_pa": found.shear,
            f"{name}_shear_depth_m": found.depth,
        }

    def indentation_modulus(self, part: Part) -> float:
        return top_material(part.keys).indentation_modulus

    def modelled(self, part: Part, scene: Scene) -> Modelled:
        keys, rom = part.keys, self.reduction(part, scene)
        target = (
            f"order {rom.order}"
            if rom.order is not None
            else f"as many states as keep the error below {rom.tolerance:g}"
        )
        low, high = rom.band
        ports = f"{kept_rings(part, scene)} rings as ports"
        if pressure_hats(part, scene) is not None:
            ports = "a patch of pressure as port"
        detail = (
            f"quarter chip, {keys.layers} layers, {mounted(keys)}, "
            f"reduced to {target}, band {low:g} … {high:g} Hz, anode {keys.electrical}, "
            f"{ports}"
        )
        return Modelled(part.name, "FE (piezoelectric, linear)", detail)

    def left_out(self, part: Part, scene: Scene) -> Iterator[LeftOut]:
        yield from self.unfollowed(part, scene)
        yield LeftOut("electrodes, coating and glue", "thin and compliant", "not estimated")
        if part.keys.mounting == "roller":
            yield LeftOut(
                f"what holds {part.name}",
                "its bottom face slides without friction on a plane",
                f"compare with {part.name}.mounting = 'glued'; the usual chip: stroke -16 %, first "
                "resonance +14 %",
            )
        yield LeftOut("hysteresis and depolarisation", "linear material law", "not estimated")
        if part.keys.fields and pressure_hats(part, scene) is not None:
            yield LeftOut(
                f"tension around the contact on {part.name}",
                "its own mesh is too coarse for it; pressure and shear are those of a graded one",
                "not estimated",
            )
        if (several := part.keys.mesh.layers_per_element) > 1:
            yield LeftOut(
                f"layers of {part.name} within an element",
                f"{several} layers share one: mesh.layers_per_element",
                f"{(several / part.keys.layers) ** 2:.2g} of the first resonances, at most; stroke "
                "and capacitance are those of the layers",
            )
        kept, every = kept_rings(part, scene), rings(part)
        if kept < every and pressure_hats(part, scene) is None:
            effect = f"{part.name}: ports at ring{kept}"
            effect += f" to ring{every - 1}" if kept + 1 < every else ""
            yield LeftOut(effect, "nothing of the scene needs them", "checked after the run")


def _kick_speed(part: Part, scene: Scene) -> float | None:
    """Speed [m/s] of a kick that lasts as the stack's quarter wave, or as the edge of its pulse:
    the free stroke over ``4 H / c`` or the edge; None without a voltage."""
    voltage = highest_voltage(part, scene)
    if not voltage:
        return None
    sound = math.sqrt(part.keys.material.stiffness[3] / part.keys.material.density)
    stroke = free_stroke(part.keys, voltage)
    edge = 0.0 if part.keys.drive is None else part.keys.drive.edge
    speed = stroke / max(4 * part.keys.height / sound, edge)
    return max(1e-3, SLOWER * speed if _downwards(part) else speed)


def _downwards(part: Part) -> bool:
    """Whether its pulse draws the top face back before it rises."""
    drive = part.keys.drive
    return drive is not None and part.keys.electrical == "driven" and drive.voltage < 0


def _behind_driver(part: Part, scene: Scene) -> bool:
    """Whether anything but sources acts on its anode, which may make any kick a slow one: 0.67 m/s
    behind an amplifier of 5 A, which is 1.5e-3 off at the settings of 1 m/s."""
    joined = scene.joined(part.name, "anode")
    return any(scene.parts[name].type.name != "source" for name, _ in joined)


def _damped(part: Part) -> float:
    """Its damping ratio at the usual frequency."""
    return float(math.pi * USUAL * part.keys.damping.beta)


def mounted(keys: Chip) -> str:
    """What holds the bottom face, and what else is not the plain stack, in words."""
    said = [_held(keys)]
    if keys.poling == "x":
        said.append("poled along x: it shears")
    for place, cap in (("below", keys.bottom_cap), ("on top", keys.top_cap)):
        if cap is not None:
            made_of = cap.material if isinstance(cap.material, str) else "material of its own"
            named = "unpoled ceramic" if cap.material is None else made_of
            said.append(f"{1e3 * cap.thickness:g} mm of {named} {place}")
    if keys.preload_spring is not None:
        said.append(f"a spring of {keys.preload_spring:g} N/m on the top face")
    return ", ".join(said)


def _held(keys: Chip) -> str:
    if isinstance(keys.mounting, float):
        return f"bottom face on springs of {keys.mounting:g} N/m per m2 along each axis"
    words = {
        "roller": "frictionless roller under its bottom face",
        "glued": "bottom face glued down, u = 0",
        "free": "nothing holds its bottom face",
    }
    return words[keys.mounting]


def chip_of(keys: Stack) -> Chip:
    """What the FE model depends on: pulse, driver and electrical boundary act on the circuit."""
    given = Chip.model_fields.keys() & keys.model_fields_set
    return Chip(**{name: getattr(keys, name) for name in given})


def pressure_hats(part: Part, scene: Scene) -> Hats | None:
    """Hats of pressure on the top where a contact wants them, as far out as the rings are."""
    for contact in scene.of("contact"):
        if contact.keys.shape == "pressure" and contact.keys.a in (None, part.name):
            from kc2spice.bodies.pressure import hats

            return hats(contact.keys.spacing, float(ring_radii(part.keys)[-1]))
    return None


def ring_radii(keys: Chip) -> np.ndarray:
    """Radii [m] of the chip's rings, ring0 (the centre node) first."""
    return keys.mesh.ring_spacing * np.arange(keys.mesh.rings + 1)


def kept_rings(part: Part, scene: Scene) -> int:
    """How many rings, ring0 first, are ports: up to the last that another part or a probe wants."""
    wanted = [
        _ring(part, name.partition(".")[2])
        for other in scene.parts.values()
        for name in (*other.pins.values(), *other.type.wants(other, scene))
        if name.startswith(f"{part.name}.ring")
    ]
    wanted += [_ring(part, pin) for pin in part.pins if pin.startswith("ring")]
    wanted += [
        _ring(part, probe.of.rpartition(".")[2])
        for probe in scene.probes.values()
        if probe.of.startswith((f"{part.name}.u.ring", f"{part.name}.ring"))
    ]
    return 1 + max(wanted, default=-1)


def rings(part: Part) -> int:
    """How many rings there are, the centre counted."""
    return int(part.keys.mesh.rings) + 1


def _ring(part: Part, name: str) -> int:
    match, count = re.fullmatch(r"ring(\d{1,3})", name), rings(part)
    if match is None or int(match[1]) >= count:
        raise UsageError(
            f"{part.name} has no such port",
            where=part.name,
            got=repr(name),
            expected=f"ring0 to ring{count - 1}",
        )
    return int(match[1])


def highest_voltage(part: Part, scene: Scene) -> float:
    """Largest voltage [V] that the drive asks for; 0 where the anode is not driven."""
    keys = part.keys
    if keys.drive is not None and keys.electrical == "driven":
        return abs(keys.drive.voltage)
    sources = [p for p in scene.of("source") if p.keys.kind == "voltage"]
    tops = [
        float(np.abs(np.array(p.keys.waveform(scene.home).points)[:, 1]).max()) for p in sources
    ]
    rails = [p.keys.rail for p in scene.of("half_bridge", "amplifier", "charge_drive")]
    return max([*tops, *rails], default=0.0)


def free_stroke(keys: Chip, voltage: float) -> float:
    """Static stroke [m] of the free stack: ``layers |d voltage|``, ``d = e C^-1``: d33, or d15 of
    one that shears."""
    C, e, _ = keys.material.tensors()
    axis, strain = (2, 2) if keys.poling == "z" else (0, 4)
    return keys.layers * abs(np.linalg.solve(C, e[axis])[strain] * voltage)


def top_material(keys: Chip) -> Material:
    """What something on the top face presses on."""
    if keys.top_cap is not None and keys.top_cap.material is not None:
        return material(keys.top_cap.material, "top_cap.material")
    return Material("ceramic", keys.material.density, *keys.material.tensors())


def _driver(
    part: Part, kind: str, table: Mapping[str, Any], data: Mapping[str, Any]
) -> dict[str, Any]:
    pins = {"out": f"{part.name}.anode"}
    if kind == "charge":
        pins = {"anode": f"{part.name}.anode", "cathode": f"{part.name}.cathode"}
    if kind in ("user", "netlist"):
        file = table.get("file") or first_netlist(f"{part.name}.driver.{kind}", data)
        return {**table, "file": file, "pins": pins}
    return {**table, "pins": pins}


def _driver_type(part: Part, kind: str) -> str:
    known = {"charge": "charge_drive", "user": "netlist"}
    known |= {name: name for name in ("half_bridge", "amplifier", "charge_drive", "netlist")}
    if kind not in known:
        raise UsageError(
            "no such driver",
            where=f"{part.name}.driver",
            got=repr(kind),
            expected="one of half_bridge, amplifier, charge, user",
        )
    return known[kind]


def _problems(part: Part, scene: Scene) -> Iterator[UsageError]:
    keys = part.keys
    outermost = keys.mesh.rings * keys.mesh.ring_spacing
    half = min(keys.half)
    if outermost >= half:
        yield UsageError(
            f"the outermost of {keys.mesh.rings} contact rings lies beyond the chip",
            where=f"{part.name}.mesh.ring_spacing",
            got=f"ring radius {outermost:g} m",
            expected=f"less than half the chip's smaller side, {half:g} m",
        )
    c11, c12, c13, c33, c44, c66 = keys.material.stiffness
    if min(c11 - c12, (c11 + c12) * c33 - 2 * c13**2, c33, c44, c66) <= 0:
        limit = "C11 > |C12|, (C11 + C12) C33 > 2 C13^2, C33, C44 and C66 > 0"
        yield UsageError(
            "no such material", where=f"{part.name}.material.stiffness", expected=limit
        )
    if keys.mounting == "free" and scene.of("contact") and scene.analysis.type == "transient":
        yield UsageError(
            "nothing holds the chip under what rests on it",
            where=f"{part.name}.mounting",
            got="free",
            expected="roller, glued or a stiffness per area",
        )
    mesh = keys.mesh
    if keys.fields and (mesh.order != 1 or mesh.layers_per_element != 1):
        yield UsageError(
            "fields need linear elements of one layer each",
            where=f"{part.name}.mesh",
            got=f"order {mesh.order}, layers_per_element {mesh.layers_per_element}",
            expected="order = 1, layers_per_element = 1",
        )
    drive = keys.drive
    if keys.driver and keys.electrical != "driven":
        yield UsageError(
            "the chip's electrodes are not driven",
            where=f"{part.name}.driver",
            got=keys.electrical,
            expected=f"{part.name}.electrical = 'driven'",
        )
    if drive is None:
        return
    if drive.edge > drive.width:
        yield UsageError(
            "the edges of the pulse are longer than the pulse",
            where=f"{part.name}.drive.edge",
            got=f"{drive.edge:g} s",
            expected=f"at most {part.name}.drive.width, {drive.width:g} s",
        )
    late = scene.analysis.type == "transient" and drive.start >= scene.stop
    if keys.electrical == "driven" and late:
        yield UsageError(
            "the kick starts after the simulation ends",
            where=f"{part.name}.drive.start",
            got=f"{drive.start:g} s",
            expected=f"before the end of the simulation, {scene.stop:g} s",
        )


# The last chip stays in memory: the next scene often asks for another reduction of the same one.
@lru_cache(maxsize=1)
def _device(chip: Chip, breakdown: float) -> Device:
    from kc2spice.bodies.piezo_stack import stack_device

    return stack_device(chip, breakdown)


def _dents(part: Part, shape: Hats) -> Dents:
    found = _pressed(chip_of(part.keys), shape)
    return Dents(found.compliance, found.patch, part.keys.damping.beta)


def _pressed(chip: Chip, shape: Hats) -> Pressed:
    from kc2spice.bodies.pressure import Pressed, pressed

    found, _ = cached(
        "pressed",
        _hatted(chip, shape),
        lambda: pressed(chip, shape),
        classes=(Pressed,),
        sources=SOURCES,
    )
    return found


def _hatted(chip: Chip, shape: Hats) -> dict[str, Any]:
    """What the statics of a chip under hats depend on."""
    own = chip.model_dump(mode="json", exclude={"damping"})
    return {"chip": own, "hats": shape.nodes.tolist()}


register(PiezoStack())
