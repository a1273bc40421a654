"""Unilateral contact between a body's ports and a sphere or a port of another body (eq. 10)."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from functools import lru_cache
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import Field

from kc2spice.core import laws
from kc2spice.core.errors import UsageError
from kc2spice.core.figure import Curve, Figure, Panel, time_axis
from kc2spice.core.quantities import (
    Length,
    Notch,
    Pressure,
    Ratio,
    Rings,
    Section,
    Stiffness,
    Velocity,
    si,
)
from kc2spice.core.waveforms import Waveforms
from kc2spice.netlist.cards import distinct
from kc2spice.netlist.circuit import Param, Pin, Subcircuit, positive
from kc2spice.netlist.render import render
from kc2spice.parts.sphere import integral, made_of
from kc2spice.physics.contact import ContactLaw, Normal
from kc2spice.scene.gates import Gate, stepping
from kc2spice.scene.judge import Balance, Check
from kc2spice.scene.model import GROUND, Part, Scene, Terminal
from kc2spice.scene.parttype import (
    Build,
    Dents,
    LeftOut,
    Modelled,
    PartType,
    Reach,
    Surface,
    TimeScale,
    Vector,
    register,
)
from kc2spice.spice.header import Header, parameter_list, part_header

if TYPE_CHECKING:
    from kc2spice.bodies.pressure import Dented, Hats

# Gate of a launch against the full model: of the reduction's certified error, whose band it
# exceeds; what it is where there is no certificate.
REDUCED, BEYOND = 0.4, 1e-3
MISSING = 1e-3  # energy that the springs may make or lose, of what went through them
STIFFEST = 1e15  # N/m; a gram on it rings at 160 GHz, which no simulator ends to follow
RATING = "not known; compare the force with the strength of both surfaces (Hertz)"
HATS = 3.0  # of what hats half as wide move; 1.8 of it is found against hats a quarter as wide
CARRYING = 3.0  # hats of 10 um under a contact as wide are 5e-3 off, half as many 3e-2
OPEN = 0.95  # of its gap that the bound of a ring that was left out may reach
# Contact events of a kick that a reltol is good for, times that reltol: every event adds the error
# of a step. Of 37 kicks of chips damped by 0.01 to 0.05 %, those above launched wrong by 9e-4.
EVENTS = 4e-3
ALOFT = 1e-8  # m over the body at t = 0 that a sphere at rest on it may have
EXCITED = 500e3  # Hz that a contact excites bodies at
CURVED, DAMPED = 0.1, 0.01  # of solver.reltol under contacts by Hertz, and under damped ones
FEW = 20  # events that are not too many for any reltol
FLOOR = "floor"  # port of a rigid plane
# A block between compiled modules alone ended 35 mm away instead of 0.2, without an error message.
SLIPS = "compiled modules lose the digits that friction below its creep speed needs"
PATCH, CARRIED = "patch", "dent"  # port of an elastic sphere, and the pin that meets it
_FLIGHT = 20e-6  # several periods of the chip: a shorter gap is a bounce within the kick


class ContactKeys(Section):
    """Penalty contact, one spring per port of ``a`` (paper eq. 10)."""

    penalty: Stiffness = Field(
        1e8, gt=0, le=STIFFEST, description="of a ring of one symmetry sector"
    )
    rings: Rings = Field("needed", description="needed, all, or how many from the centre on")
    a: str | tuple[str, ...] | None = Field(
        None,
        description="side below, whose rise closes the gap: body, its ports, or gnd; the only body",
    )
    b: str | None = Field(
        None,
        description="side above, whose rise opens the gap: sphere, a port of a body, or "
        "gnd; the only sphere",
    )
    gap: Length = Field(0.0, description="at rest, on top of that of the geometry")
    inertia: Literal["massless", "lumped"] = Field(
        "massless", description="of the residual modes behind the ports: left out, or a mass each"
    )
    shape: Literal["rings", "pressure"] = Field(
        "rings", description="of the chip's ports: circles of the mesh, or pressure under a sphere"
    )
    spacing: Annotated[Length, Notch(0.5, model=True, when=(("shape", "pressure"),))] = Field(
        10e-6, gt=0, description="of the hats of pressure"
    )
    law: Literal["linear", "hertz"] = Field(
        "linear", description="penalty x, or 4/3 E* sqrt(R) x^(3/2) of a sphere at one port"
    )
    modulus: Pressure | None = Field(
        None, gt=0, description="E* of both sides under law = hertz; by default of their materials"
    )
    groove: Ratio | None = Field(
        None, gt=0, le=180, description="opening angle in degrees of the groove in a that b lies in"
    )
    damping: Annotated[float, si("s/m")] = Field(
        0.0,
        ge=0,
        description="of Hunt and Crossley: force times 1 + damping times closing speed",
    )
    friction: Ratio = Field(
        0.0, ge=0, description="Coulomb's coefficient, of pin slide over pin rail; on both flanks"
    )
    creep: Velocity = Field(
        1e-4, gt=0, description="speed below which friction is viscous, for sticking"
    )


class Contact(PartType):
    name = "contact"
    title = "unilateral penalty contact"
    schema = ContactKeys

    def pins(self, part: Part, scene: Scene) -> tuple[Terminal, ...]:
        a, b = sides(part, scene)
        first = [Terminal(port, "um", "N") for port in kept_ports(part, scene)]
        if a.rigid:
            first = [Terminal("va", "m/s", "N"), Terminal("a", "um", "-")]
        second = [Terminal("b", "um", "N")]
        if b.rigid:
            second = [Terminal("v", "m/s", "N"), Terminal("bottom", "um", "-")]
        second += [Terminal(CARRIED, "um", "N")] if b.elastic else []
        along = (Terminal("slide", "um", "N", required=True), Terminal("rail", "um", "N", "gnd"))
        base = Terminal("base", "um", "N", "gnd")
        return (*first, *second, *(along if part.keys.friction else ()), base)

    def links(self, part: Part, scene: Scene) -> Mapping[str, str]:
        (one, a), (other, b) = _names(part, scene)
        joins = {
            port: one if one == GROUND else f"{one}.{port}" for port in kept_ports(part, scene)
        }
        if a.rigid:
            one = moved_by(one, scene)
            joins = {"va": f"{one}.{a.force[0]}", "a": f"{one}.{a.place[0]}"}
        if b.elastic:
            joins[CARRIED] = f"{b.elastic}.{PATCH}"
        other = moved_by(other, scene)
        if b.rigid:
            return joins | {"v": f"{other}.{b.force[0]}", "bottom": f"{other}.{b.place[0]}"}
        return joins | {"b": other if other == GROUND else f"{other}.{b.force[0]}"}

    def holds(self, part: Part, scene: Scene, model: Any | None) -> Iterator[tuple[str, str]]:
        """Surfaces that touch at rest: what presses on them finds its place."""
        a, b = sides(part, scene)
        yield from ((pin, GROUND) for pin in ("base", *["va"] * a.rigid, *["v"] * b.rigid))
        if part.keys.gap <= 0.0 and not a.rigid and not b.rigid:
            yield from ((port, "b") for port in kept_ports(part, scene))

    def wants(self, part: Part, scene: Scene) -> tuple[str, ...]:
        (one, a), (other, b) = _names(part, scene)
        first = a.force if a.rigid else kept_ports(part, scene)
        carried = (f"{b.elastic}.{PATCH}",) if b.elastic else ()
        return (*(f"{one}.{port}" for port in first), f"{other}.{b.force[0]}", *carried)

    def time_scales(self, part: Part, scene: Scene) -> Iterator[TimeScale]:
        """A trapezoid's errors of closing and opening cancel for a linear spring alone. Rebounds
        that lose 0 to 70 % of their energy are then good to 1.5e-4 at the usual reltol."""
        curved = part.keys.law == "hertz" or part.keys.shape == "pressure"
        reltol = DAMPED if part.keys.damping else CURVED if curved else 1.0
        what = "contact, as far as a body has motions"
        yield TimeScale(what, content=EXCITED, reltol=reltol)

    def massless(self, part: Part, scene: Scene) -> tuple[str, ...]:
        return self.wants(part, scene) if part.keys.inertia == "massless" else ()

    def problems(self, part: Part, scene: Scene) -> Iterator[UsageError]:
        (one, a), (other, b) = _names(part, scene)
        if one == other != GROUND and set(a.force) & set(b.force):
            yield UsageError(
                "nothing touches itself",
                where=f"{part.name}.b",
                got=f"{one} on both sides",
                expected="two parts, or two ports of a body",
            )
        if b.radius is not None and max(a.distance) >= b.radius:
            (one, _), (other, _) = _names(part, scene)
            yield UsageError(
                "the outermost contact port lies beyond the sphere, which can never touch it",
                where=f"{one}.mesh.ring_spacing",
                got=f"ring radius {max(a.distance):g} m",
                expected=f"less than {other}.radius, {b.radius:g} m",
            )
        if part.keys.shape == "pressure":
            yield from _pressure_problems(part, a, b)
        else:
            normal(part, scene)  # says what it cannot know

    def subcircuits(self, part: Part, build: Build, header: Any) -> tuple[Any, ...]:
        ports = kept_ports(part, build.scene)
        a, b = sides(part, build.scene)
        added = np.full(len(ports), part.keys.gap)
        under = None if b.radius is None else (b.radius, np.array(a.distance[: len(ports)]))
        return (
            contact_subcircuit(
                header,
                ports,
                added,
                normal(part, build.scene),
                under=under,
                rigid=(a.rigid, b.rigid),
                elastic=bool(b.elastic),
                groove=part.keys.groove,
                name=build.libraries[part.name],
            ),
        )

    def vectors(self, part: Part, build: Build) -> Mapping[str, Vector]:
        forces = {
            f"{part.name}.force.{r}": f"@b.x{part.name.lower()}.b{r.lower()}[i]"
            for r in kept_ports(part, build.scene)
        }
        found = {f"{part.name}.force": Vector("+".join(forces.values()), 1.0, "N")}
        if part.keys.friction:
            text = f"@b.x{part.name.lower()}.bslide[i]"
            found[f"{part.name}.friction"] = Vector(text, 1.0, "N")
        if (s := flank(part)) is not None:
            found[f"{part.name}.flank"] = Vector("+".join(forces.values()), 1 / (2 * s), "N")
        return found | {name: Vector(text, 1.0, "N") for name, text in forces.items()}

    def force_on(self, part: Part, pin: str, build: Build, waves: Waveforms) -> np.ndarray | None:
        if pin in ("v", "b", CARRIED):
            return waves.data.get(f"{part.name}.force")
        if pin in ("slide", "rail"):
            force = waves.data.get(f"{part.name}.friction")
            return force if force is None or pin == "rail" else -force
        each = "force" if pin == "va" else f"force.{pin}"
        force = waves.data.get(f"{part.name}.{each}")
        return None if force is None else -force

    def metrics(self, part: Part, build: Build, waves: Waveforms) -> Mapping[str, Any]:
        (_, _), (other, _) = _names(part, build.scene)
        v = waves.data.get(f"{other}.v")
        if "time" not in waves or v is None or thrown(part, build.scene):
            return {}
        force, busy = waves[f"{part.name}.force"], busy_until(build.scene)
        power = normal(part, build.scene).power
        launch = separation(waves["time"], force, v, busy, power)
        return {
            "launch_velocity_m_s": launch[1] if launch else None,
            "launch_time_s": launch[0] if launch else None,
        }

    def checks(self, part: Part, build: Build, waves: Waveforms) -> Iterator[Check]:
        if "time" in waves:
            yield from _start(part, build, waves)
            yield from _penetration(part, build, waves)
            yield from _events(part, build, waves)
        yield from _open_ports(part, build, waves)
        yield from _within_law(part, build, waves)

    def energy(self, part: Part, build: Build, waves: Waveforms) -> Mapping[str, Balance]:
        return {} if "time" not in waves else _balance(part, build, waves)

    def figures(self, part: Part, build: Build, waves: Waveforms) -> Iterator[Figure]:
        force = waves.data.get(f"{part.name}.force")
        if force is None:
            return
        ports = kept_ports(part, build.scene)
        inside = _loaded(force) if "time" in waves else slice(None)
        scale = next(iter(waves.data.values()))
        x, factor = time_axis(scale[inside])
        if "imprint.depth" in waves:
            scale, (x, factor) = waves["imprint.depth"], ("depth in µm", 1e6)
        curves = [
            Curve(port, factor * scale[inside], waves[f"{part.name}.force.{port}"][inside])
            for port in ports
            if waves[f"{part.name}.force.{port}"].max() > 0
        ]
        if len(ports) > 1:
            curves.append(Curve("sum", factor * scale[inside], force[inside], "--"))
        (one, _), (other, _) = _names(part, build.scene)
        panel = Panel(x, "contact force in N", tuple(curves))
        caption = f"Force between {one} and {other}, whole device, at each port that closes."
        yield Figure(f"{part.name}_force", f"Contact of {one} and {other}", caption, (panel,))

    def gates(self, part: Part, build: Build) -> Iterator[Gate]:
        if build.scene.analysis.type == "transient" and not thrown(part, build.scene):
            gates, steps = build.scene.gates, stepping(build.scene.solver)
            (one, _), _ = _names(part, build.scene)
            certificate = getattr(build.models.get(one), "certificate", None)
            reduced = REDUCED * certificate.error_estimate if certificate else BEYOND
            full = gates.launch_full_model or steps + reduced
            limits = {
                "ngspice_vs_rom": gates.launch_velocity or steps,
                "rom_vs_fom": full,
                "ngspice_vs_fom": full,
            }
            yield Gate("launch velocity", "launch_velocity_m_s", limits, leads=True)

    def law(self, part: Part, build: Build) -> laws.Equations:
        n, scene = part.name, build.scene
        ports = kept_ports(part, scene)
        (a, b), own = sides(part, scene), normal(part, scene)
        law = ContactLaw(n, ports, own, gaps(part, scene), CARRIED if b.elastic else "")
        first = ("a",) if a.rigid else ports
        pins = tuple((pin, f"{n}.{port}") for pin, port in zip(first, ports, strict=True))
        pins += (("bottom" if b.rigid else "b", f"{n}.b"),)
        pins += ((CARRIED, f"{n}.{CARRIED}"),) if b.elastic else ()
        results = {f"{n}.force.{r}": laws.reading(f"{n}.{r}.through") for r in ports}
        if own.friction:
            pins += (("slide", f"{n}.slide"), ("rail", f"{n}.rail"))
            results[f"{n}.friction"] = laws.reading(f"{n}.slide.through")
        sums = {"force": 1.0} | ({} if (s := flank(part)) is None else {"flank": 1 / (2 * s)})
        for word, share in sums.items():
            every = tuple((share, f"{n}.{r}.through") for r in ports)
            results[f"{n}.{word}"] = laws.Reading(every)
        return laws.Equations((law,), pins, results)

    def modelled(self, part: Part, scene: Scene) -> Modelled:
        count, own = len(kept_ports(part, scene)), normal(part, scene)
        if part.keys.shape == "pressure":
            detail = f"pressure under a sphere, up to {own.depth:.3g} m deep; hats every "
            detail += f"{part.keys.spacing:g} m near the axis"
        elif own.power == 1.0:
            detail = f"{count} unilateral springs, {own.stiffness:g} N/m each"
        else:
            detail = f"Hertz's law, {own.stiffness:g} N/m^1.5"
        if part.keys.groove is not None:
            detail += f" along the axis of a groove of {part.keys.groove:g} degrees"
        if own.damping:
            detail += f", damping of Hunt and Crossley {part.keys.damping:g} s/m"
        if own.friction:
            detail += f", friction {part.keys.friction:g}, viscous below {own.creep:g} m/s"
        return Modelled(part.name, "closed form", detail)

    def left_out(self, part: Part, scene: Scene) -> Iterator[LeftOut]:
        a, _ = sides(part, scene)
        (one, _), (other, _) = _names(part, scene)
        kept = len(kept_ports(part, scene))
        if len(a.ports) > 1:
            yield LeftOut(
                "pressure between the ports",
                f"one force per port of {one} stands for it",
                "run again with a finer mesh to see it",
            )
        if part.keys.inertia == "massless":
            yield LeftOut(
                f"inertia of the residual modes behind the ports of {part.name}",
                "stiff modes above the band that keep the ports' compliance exact; their mass is "
                "the mesh's and rattles behind the springs",
                "part of the reduced model's certified error",
            )
        dry = "" if part.keys.friction else "friction, "
        what = f"{dry}adhesion and plastic flow between {one} and {other}"
        yield LeftOut(what, "the law is elastic and normal to the surface", "not estimated")
        if kept < len(a.ports):
            gap, estimate = float(gaps(part, scene, every=True)[kept]), reach(part, scene)
            why = f"open up to {gap:.3g} m; {estimate.why}: {estimate.depth:.3g} m"
            if part.keys.rings != "needed":
                why = f"{part.name}.rings = {part.keys.rings}"
            last = f" to {a.ports[-1]}" if kept + 1 < len(a.ports) else ""
            yield LeftOut(
                f"contact at {a.ports[kept]}{last}",
                why,
                "none while they stay open, checked after the run",
            )


# --- geometry: the one place for gap laws and symmetry factors ------------------------------------


def ring_gaps(distance: np.ndarray, sphere_radius: float) -> np.ndarray:
    """Gap [m] at each distance under a sphere that touches the axis: ``R - sqrt(R^2 - r^2)``.

    Written as ``r^2 / (R + sqrt(R^2 - r^2))``, which does not cancel.
    """
    r = np.asarray(distance, dtype=float)
    return r**2 / (sphere_radius + np.sqrt(sphere_radius**2 - r**2))


def normal(part: Part, scene: Scene) -> Normal:
    """The whole device's law at each port.

    A sphere of radius R on a plane: ``4/3 E* sqrt(R) x^(3/2)``, ``1/E* = 1/M_a + 1/M_b`` by the
    sides' indentation moduli, ``1/R = 1/R_a + 1/R_b`` of two spheres (Hertz 1881). In a groove of
    opening angle g both flanks are approached by ``s x``, ``s = sin(g/2)``, and push along the axis
    with ``s`` of their force: the stiffness is ``2 s^(1 + power)`` times that of one, the damping
    that of their closing speed ``s x'``. Each carries ``F / (2 s)``, so that friction along the
    groove is ``1 / s`` times its coefficient.
    """
    keys, (a, b) = part.keys, sides(part, scene)
    if keys.shape == "pressure":
        return _pressed(part, scene)
    value, power = a.sectors * float(keys.penalty), 1.0
    if keys.law == "hertz":
        round_ = [1 / side.radius for side in (a, b) if side.radius is not None]
        if not round_ or len(a.ports) > 1:
            raise UsageError(
                "Hertz's law is that of a sphere at one point",
                where=f"{part.name}.law",
                got=f"{len(a.ports)} ports, {len(round_)} spheres",
                expected="a sphere against one port or another sphere",
                hint='law = "linear"',
            )
        value, power = 4 / 3 * _modulus(part, scene) / math.sqrt(sum(round_)), 1.5
    if (s := flank(part)) is not None:
        value *= 2 * s ** (1 + power)
        return Normal(value, power, s * keys.damping, keys.friction / s, keys.creep)
    return Normal(value, power, keys.damping, keys.friction, keys.creep)


def flank(part: Part) -> float | None:
    """``sin(g/2)`` of a groove's opening angle g, by which its flanks lean; None without one."""
    groove = part.keys.groove
    return None if groove is None else math.sin(math.radians(groove) / 2)


def _pressed(part: Part, scene: Scene) -> Normal:
    """The law of hats of pressure under a sphere (:mod:`kc2spice.bodies.pressure`)."""
    from kc2spice.bodies.pressure import hats

    keys, (a, b) = part.keys, sides(part, scene)
    assert b.radius is not None
    shape = hats(keys.spacing, a.patch)
    dents = _dents(part, scene, shape)
    found = _dented(shape.nodes.tobytes(), dents.compliance.tobytes(), b.radius)
    first, *_ = found.coefficients
    return Normal(
        first / found.depth**1.5,
        1.5,
        keys.damping,
        keys.friction,
        keys.creep,
        tuple(c / first for c in found.coefficients),
        found.depth,
        dents.pace,
        b.radius,
    )


def hat_forces(part: Part, scene: Scene, force: float) -> np.ndarray:
    """(n,) [N] on each hat of pressure where they carry ``force`` together."""
    from kc2spice.bodies.pressure import hats, pressing

    (a, b), own = sides(part, scene), normal(part, scene)
    assert b.radius is not None
    depths = np.linspace(0.0, own.depth, 1000)
    depth = np.interp(force, own.force(depths), depths)
    shape = hats(part.keys.spacing, a.patch)
    gap = ring_gaps(shape.distances, b.radius)
    found = pressing(_dents(part, scene, shape).compliance, gap, np.array([depth]))[0]
    return np.asarray(force / found.sum() * found)


def _dents(part: Part, scene: Scene, shape: Hats) -> Dents:
    """Of both sides together, which follow the pressure within the mean of their times."""
    a, b = sides(part, scene)
    assert a.dents is not None
    found = a.dents(shape)
    if not b.elastic:
        return found
    carried = scene.parts[b.elastic]
    surface = carried.type.surface(carried, scene, (PATCH,))
    assert surface is not None
    assert surface.dents is not None
    other = surface.dents(shape)
    whole = found.compliance + other.compliance
    share = float(np.trace(other.compliance) / np.trace(whole))
    pace = (1 - share) * found.pace + share * other.pace
    return Dents(whole, found.patch + other.patch, pace)


def spacing_error(part: Part, scene: Scene) -> float:
    """By how much the force of the hats differs from that of hats half as wide, relative, at
    depths from half of what the scene can reach on; the patch's own give is part of both."""
    from kc2spice.bodies.pressure import hats

    a, b = sides(part, scene)
    assert b.radius is not None
    forces = []
    for wider in (1.0, 0.5):
        shape = hats(wider * part.keys.spacing, a.patch)
        found = _dents(part, scene, shape)
        law = _dented(shape.nodes.tobytes(), (found.compliance + found.patch).tobytes(), b.radius)
        depth = np.linspace(0.5, 1.0, 50) * min(reach(part, scene).depth or math.inf, law.depth)
        forces.append(law.force(depth))
    return float(np.abs(forces[1] / forces[0] - 1).max())


def unresolved(part: Part, scene: Scene) -> float:
    """Gate of the law against a full model with finer hats, relative: 0 for rings."""
    return HATS * spacing_error(part, scene) if part.keys.shape == "pressure" else 0.0


@lru_cache(maxsize=8)
def _dented(nodes: bytes, compliance: bytes, radius: float) -> Dented:
    from kc2spice.bodies.pressure import Hats, dented

    shape = Hats(np.frombuffer(nodes))
    matrix = np.frombuffer(compliance).reshape(len(shape.nodes) - 1, -1)
    return dented(shape, matrix, ring_gaps(shape.distances, radius))


def _pressure_problems(part: Part, a: Surface, b: Surface) -> Iterator[UsageError]:
    where, rings = f"{part.name}.shape", 'shape = "rings" takes ports as they are'
    if a.dents is None:
        yield UsageError(
            "no port of pressure on this body",
            where=where,
            got=a.ports[0],
            expected="a piezo_stack, whose contact names no port",
            hint=rings,
        )
    elif not part.keys.spacing < a.patch / 4:
        yield UsageError(
            "hats of pressure wider than the patch that they are in",
            where=f"{part.name}.spacing",
            got=f"{part.keys.spacing:g} m",
            expected=f"less than {a.patch / 4:g} m",
        )
    if b.radius is None or b.radius <= a.patch:
        got = "no sphere" if b.radius is None else f"a radius of {b.radius:g} m"
        yield UsageError(
            "pressure is that under a sphere",
            where=where,
            got=got,
            expected=f"a sphere of more than {a.patch:g} m, the outermost ring",
            hint=rings,
        )
    for key, usual in (("law", "linear"), ("groove", None)):
        if (got := getattr(part.keys, key)) != usual:
            yield UsageError(
                f"pressure has its own law, without {key}",
                where=f"{part.name}.{key}",
                got=got,
                hint=rings,
            )


def _modulus(part: Part, scene: Scene) -> float:
    """``E*`` [Pa] of both sides."""
    if part.keys.modulus is not None:
        return float(part.keys.modulus)
    compliance = 0.0
    for name, _ in _names(part, scene):
        body = scene.parts.get(name)
        modulus = None if body is None else body.type.indentation_modulus(body)
        if modulus is None:
            raise UsageError(
                f"no modulus of {name} is known",
                where=f"{part.name}.modulus",
                expected='a pressure such as "110 GPa", or a material of both sides',
            )
        compliance += 1 / modulus
    return 1 / compliance


def gaps(part: Part, scene: Scene, *, every: bool = False) -> np.ndarray:
    """Gap [m] at each kept port (or at ``every`` one) when both sides are at rest."""
    a, b = sides(part, scene)
    kept = len(a.ports) if every else len(kept_ports(part, scene))
    distance = np.array(a.distance[:kept])
    curved = np.zeros(kept) if b.radius is None else ring_gaps(distance, b.radius)
    return curved + part.keys.gap


def sides(part: Part, scene: Scene) -> tuple[Surface, Surface]:
    """What both parts offer: the side of several ports, and the other."""
    (_, a), (_, b) = _names(part, scene)
    return a, b


def _names(part: Part, scene: Scene) -> tuple[tuple[str, Surface], tuple[str, Surface]]:
    """Names and surfaces of both sides."""
    keys = part.keys
    return _side(part, scene, "a", keys.a, False), _side(part, scene, "b", keys.b, True)


def _side(
    part: Part, scene: Scene, key: str, chosen: str | tuple[str, ...] | None, round_: bool
) -> tuple[str, Surface]:
    where = f"{part.name}.{key}"
    if chosen is None:
        offers = [
            (other.name, surface)
            for other in scene.parts.values()
            if other is not part
            and (surface := other.type.surface(other, scene)) is not None
            and (surface.radius is not None) == round_
        ]
        if len(offers) != 1:
            kind = "a sphere" if round_ else "a body with a surface"
            raise UsageError(
                f"{part.name} needs to know what touches",
                where=where,
                got=", ".join(name for name, _ in offers) or f"no part that is {kind}",
                expected=f'{key} = "PART" or "PART.PORT"',
                hint=None
                if offers
                else f"add [{'sphere' if round_ else 'kick'}]; an empty table takes the defaults",
            )
        return offers[0]
    if chosen == GROUND:
        return GROUND, Surface((FLOOR,), (FLOOR,), (FLOOR,), (0.0,))
    targets = (chosen,) if isinstance(chosen, str) else chosen
    names = {target.partition(".")[0] for target in targets}
    if len(names) != 1:
        raise UsageError("one body on each side", where=where, got=", ".join(sorted(names)))
    other = scene.part(names.pop(), where)
    ports = tuple(target.partition(".")[2] for target in targets if "." in target)
    surface = other.type.surface(other, scene, ports)
    if surface is None:
        raise UsageError(
            f"{other.type.name} offers nothing to touch",
            where=where,
            got=repr(other.name),
            expected="a body, a sphere or a mass",
        )
    return other.name, surface


def kept_ports(part: Part, scene: Scene) -> tuple[str, ...]:
    """Ports of ``a`` that get a spring, the nearest to the axis first."""
    a, _ = sides(part, scene)
    rings = part.keys.rings
    if rings == "all" or len(a.ports) == 1 or not _nested(a):
        return a.ports
    if rings != "needed":
        return a.ports[: min(rings, len(a.ports))]
    near = int(np.count_nonzero(gaps(part, scene, every=True) < reach(part, scene).depth))
    return a.ports[: max(1, near)]


def _nested(a: Surface) -> bool:
    return list(a.distance) == sorted(a.distance)


def moved_by(name: str, scene: Scene) -> str:
    """The part that sets the motion of ``name``; ``name`` itself where it moves freely."""
    movers = [p.name for p in scene.parts.values() if name in p.type.drives(p, scene)]
    return movers[0] if movers else name


def reach(part: Part, scene: Scene) -> Reach:
    """The largest of what the parts of the scene can do; a prescribed one beats all."""
    found = [each for other in scene.parts.values() for each in other.type.reach(other, scene)]
    for each in found:
        if each.prescribed:
            return each
    return max([Reach(0.0, "its weight"), *found], key=lambda each: each.depth)


def thrown(part: Part, scene: Scene) -> bool:
    """Whether one side starts with a prescribed velocity, or each may."""
    (_, a), (other, _) = _names(part, scene)
    if other == GROUND:  # a ceiling stays where it is
        return True
    kind = scene.parts[other].type
    return a.rigid or kind.without_operating_point(scene.parts[other], scene)


# --- what the waveforms say -----------------------------------------------------------------------


def separation(
    t: np.ndarray, force: np.ndarray, v: np.ndarray, busy: float = math.inf, power: float = 1.0
) -> tuple[float, float] | None:
    """Time [s] and velocity [m/s] at the end of the contact that the flight follows, or None.

    ``power`` of the overlap is what the force is there.

    A gap is a flight if it lasts 20 us or until the data end. A body that draws back and strikes
    later leaves such a gap too: of the flights that begin until 20 us after ``busy`` [s], when the
    drive stops moving, the launch is the first with at least half of the largest speed. Without
    one it is the first of all; by default the drive is not known and all of them count.
    """
    loaded = force > 1e-9 * force.max(initial=0.0)
    force = np.maximum(force, 0.0) ** (1 / power)
    flights = []
    for last in np.flatnonzero(loaded[:-1] & ~loaded[1:]):
        again = np.flatnonzero(loaded[last + 1 :])
        if again.size == 0 or t[last + 1 + again[0]] - t[last] >= _FLIGHT:
            flights.append(_edge(t, v, force, int(last)))
    if not flights:
        return None
    kicked = [each for each in flights if each[0] <= busy + _FLIGHT] or flights[:1]
    fastest = max(speed for _, speed in kicked)
    return next(each for each in kicked if each[1] >= min(fastest, fastest / 2))


def busy_until(scene: Scene) -> float:
    """Time [s] at which the last source stops changing, but for those that only enable something.

    Infinite where one never does or there is none.
    """
    ends = [math.inf]
    for source in scene.of("source"):
        wave, joined = source.keys.waveform(scene.home), scene.joined(source.name, "out")
        if all(scene.parts[name].type.name == "pid" for name, _ in joined):
            continue
        corners = wave.corners(scene.stop)
        ends.append(math.inf if wave.kind == "sine" else float(max(corners, default=0.0)))
    known = [end for end in ends[1:] if end > 0]
    return max(known, default=ends[0])


def _edge(t: np.ndarray, v: np.ndarray, force: np.ndarray, last: int) -> tuple[float, float]:
    """Extrapolate the load to zero, and the velocity from the flight back to that instant.

    Between the last loaded sample and the next one the load still bends v; the flight does not.
    """
    time, free = float(t[last]), last + 1
    if last > 0 and force[last - 1] > force[last]:
        decay = (force[last - 1] - force[last]) / (t[last] - t[last - 1])
        time = min(time + force[last] / decay, float(t[free]))
    later = min(int(np.searchsorted(t, t[free] + 100e-9)), t.size - 1)
    slope = (v[later] - v[free]) / (t[later] - t[free]) if later > free else 0.0
    return float(time), float(v[free] + slope * (time - t[free]))


def _loaded(force: np.ndarray) -> slice:
    """From the first contact to the last of the first tenth of all that have a load."""
    loaded = np.flatnonzero(force > 1e-2 * force.max(initial=0.0))
    if loaded.size == 0:
        return slice(None)
    gaps = np.flatnonzero(np.diff(loaded) > 200)
    last = loaded[gaps[0]] if gaps.size else loaded[-1]
    return slice(max(int(loaded[0]) - 2, 0), int(last) + 3)


def _height(
    name: str, surface: Surface, port: str, build: Build, waves: Waveforms
) -> np.ndarray | None:
    """Position [m] of one side at a port, zero where it touches."""
    if name == GROUND:
        return np.zeros(next(iter(waves.data.values())).size)
    if surface.radius is not None and surface.rigid:
        y = waves.data.get(f"{name}.y")
        return None if y is None else y - surface.radius
    return waves.data.get(f"{name}.u.{port}", waves.data.get(f"{name}.x"))


def _place(part: Part, build: Build, waves: Waveforms) -> np.ndarray | None:
    """Position [m] of side ``b`` at its lowest point, zero where it touches."""
    (_, _), (other, b) = _names(part, build.scene)
    if "imprint.depth" in waves:
        found: np.ndarray | None = -waves["imprint.depth"]
    else:
        found = _height(other, b, b.place[0], build, waves)
    if not b.elastic or found is None:
        return found
    dent_ = waves.data.get(f"{b.elastic}.u.{PATCH}")
    return None if dent_ is None else found + dent_


def _balance(part: Part, build: Build, waves: Waveforms) -> dict[str, Balance]:
    """Work that closes the springs against what they store, and what their damping takes.

    Springs give back all they took: energy gained here is a bounce higher than the last. The scale
    is the work that went into the springs, or what they hold where nothing moves.
    """
    (one, a), (other, _) = _names(part, build.scene)
    place, ports = _place(part, build, waves), kept_ports(part, build.scene)
    found = [_height(one, a, port, build, waves) for port in ports]
    if place is None or any(each is None for each in found):
        return {}
    own = normal(part, build.scene)
    missing, resting = np.zeros(waves["time"].size), 0.0
    turnover, stored, damped = 0.0, 0.0, 0.0
    for port, height, gap in zip(ports, found, gaps(part, build.scene), strict=True):
        assert height is not None
        f, p = waves[f"{part.name}.force.{port}"], own.power
        elastic = f
        energy = f ** (1 + 1 / p) / ((p + 1) * own.stiffness ** (1 / p))
        if own.damping or own.radius:  # the force is not that of the depth alone
            x = height - place - gap
            elastic, energy = own.force(x), own.energy(x)
        closing = integral(elastic, height - place)
        resting = max(resting, float(energy.max()))
        energy = energy - energy[0]
        missing += closing - energy
        turnover += float(np.abs(np.diff(energy)).sum())
        stored += float(energy[-1])
        damped += float(integral(f - elastic, height - place)[-1])
    net = float(np.abs(missing).max())
    scale = max(turnover, resting, _kinetic(other, build, waves))
    advice = "the steps are too coarse for the contact: lower solver.reltol or max_step"
    entries = {"stored in the contact": stored}
    if own.damping or own.pace:
        entries["damped in the contact"] = damped
    return {part.name: Balance(entries, net, scale, MISSING, advice)}


def _kinetic(other: str, build: Build, waves: Waveforms) -> float:
    v = waves.data.get(f"{other}.v")
    if v is None or other == GROUND:
        return 0.0
    mass = getattr(build.scene.parts[other].keys, "mass", 0.0)
    return mass * float((v**2).max()) / 2


def _start(part: Part, build: Build, waves: Waveforms) -> Iterator[Check]:
    """The operating point may hold the sphere elsewhere: other forces balance its weight there."""
    (one, _), (other, b) = _names(part, build.scene)
    place, force = _place(part, build, waves), waves.data.get(f"{part.name}.force")
    free = moved_by(other, build.scene) == other and not thrown(part, build.scene)
    if b.radius is None or place is None or force is None or not free:
        return
    yield Check(
        f"{other} starts at rest on {one}",
        0.0 if force[0] > 0 else float(place[0]) + part.keys.gap,
        ALOFT,
        "m above it",
        f"forces on {other} balance there before anything moves: change them (magnets: polarity, "
        f"remanence or position), or give {other}.height and velocity at t = 0",
        build.scene.checks.start,
    )


def _penetration(part: Part, build: Build, waves: Waveforms) -> Iterator[Check]:
    _, b = sides(part, build.scene)
    every = gaps(part, build.scene, every=True)
    if b.radius is None or every.size < 2:
        return
    ports = kept_ports(part, build.scene)
    deepest = max(float(waves[f"{part.name}.force.{r}"].max()) for r in ports)
    yield Check(
        "penetration",
        deepest / normal(part, build.scene).stiffness,
        float(every[1]),
        "m",
        f"the penalty springs give more than the surfaces curve: raise {part.name}.penalty",
        build.scene.checks.penetration,
    )


def _events(part: Part, build: Build, waves: Waveforms) -> Iterator[Check]:
    """Contacts of the port that has most of them, while the drive moves."""
    (one, _), _ = _names(part, build.scene)
    body = build.scene.parts.get(one)
    drive = getattr(body.keys, "drive", None) if body else None
    if drive is None:
        return
    t, end = waves["time"], drive.start + drive.width + drive.edge
    during = (t >= drive.start) & (t <= end)
    ports = kept_ports(part, build.scene)
    closed = [waves[f"{part.name}.force.{ring}"][during] > 0.0 for ring in ports]
    most = max(int(np.count_nonzero(now[1:] & ~now[:-1])) for now in closed)
    reltol = waves.stats.get("reltol", build.scene.solver.reltol)
    yield Check(
        "touches",
        most,
        max(FEW, EVENTS / reltol),
        "contact events",
        "so many decide the launch that the errors of their steps add up: lower solver.reltol; "
        "a launch after hundreds of contact events may be ill-conditioned",
        build.scene.checks.touches,
        coarse=True,
    )


def _open_ports(part: Part, build: Build, waves: Waveforms) -> Iterator[Check]:
    """*outer_ring* or *ring_left_out*: the first port without a spring stays open.

    Nothing records that port. Without contact it would rise with the outermost kept one and the
    dents that the recorded forces press into that one, ``u_K + sum_j S_Kj F_j``, and its own dent
    only takes it farther from the sphere. S is the static compliance: over one ring's spacing the
    chip answers at once. Against models with all rings this lies 10 to 100 % above what the next
    ring does at worst, and never more than 5 % of its gap below.
    """
    scene = build.scene
    (one, a), (_, b) = _names(part, scene)
    place = _place(part, build, waves)
    if b.radius is None or len(a.ports) < 2 or place is None:
        return
    ports, action = kept_ports(part, scene), scene.checks.range
    force = np.array([waves[f"{part.name}.force.{name}"] for name in ports])
    compliance = getattr(scene.parts[one].type, "static_compliance", None)
    if len(ports) < len(a.ports) and compliance is not None:
        static = compliance(scene.parts[one], build, ports)[:, -1]
        rise = waves[f"{one}.u.{ports[-1]}"] + static @ force - place
        gap = float(gaps(part, scene, every=True)[len(ports)])
        advice = f"set {part.name}.rings to more than {len(ports)}, or to 'all'"
        ours = part.keys.rings == "needed"
        yield Check(
            "ring_left_out",
            float(rise.max()),
            OPEN * gap,
            "m",
            advice,
            action,
            mend=(f"{part.name}.rings", len(ports) + 1) if ours else None,
        )
    elif "imprint.depth" not in waves:
        advice = "the contact outgrows the modelled rings: more rings or a wider ring_spacing"
        yield Check("outer_ring", float(force[-1].max()), 0.0, "N", advice, action)


def _within_law(part: Part, build: Build, waves: Waveforms) -> Iterator[Check]:
    """The law of a pressure ends where the contact is as wide as half of its patch, and knows
    little of one that a few hats carry (:data:`CARRYING`)."""
    if part.keys.shape != "pressure":
        return
    (one, a), (_, b) = _names(part, build.scene)
    own, place = normal(part, build.scene), _place(part, build, waves)
    height = _height(one, a, a.place[0], build, waves)
    if place is None or height is None:
        return
    deepest = float((height - place - part.keys.gap).max())
    yield Check(
        "depth of the contact",
        deepest,
        own.depth,
        "m",
        f"no law of the pressure is known so deep: more {one}.mesh.rings, or wider ones",
        build.scene.checks.range,
    )
    if deepest > 0.0 and b.radius is not None:
        widest = math.sqrt(deepest * b.radius) / CARRYING
        yield Check(
            "hats of the contact",
            part.keys.spacing,
            widest,
            "m",
            f"so few of them carry that the force is more than 5e-3 off: lower {part.name}.spacing",
            build.scene.checks.penetration,
        )


# --- the subcircuit -------------------------------------------------------------------------------


def contact_subcircuit(
    header: Header,
    rings: tuple[str, ...],
    gaps: np.ndarray,
    law: Normal,
    *,
    rigid: tuple[bool, bool] = (False, True),
    under: tuple[float, np.ndarray] | None = None,
    elastic: bool = False,
    groove: float | None = None,
    name: str = "contact",
) -> Subcircuit:
    """``law`` of the penetration ``u - bottom - gap`` between ring pins and the other side.

    ``law`` is that of a whole ring, ``gaps`` [m] one per ring. Given the radius of the sphere that
    the rings are ``under`` and their own [m], the gaps follow from the parameter ``radius`` as
    ``r^2 / (R + sqrt(R^2 - r^2))``, and ``gaps`` are added to them. A side that is a ``rigid`` body
    has the pins ``v`` and ``bottom`` (the first ``va`` and ``a``), an elastic one its ports or
    ``b``. A rigid one that is ``elastic`` carries a patch, whose displacement adds to it.
    """
    first = tuple(Pin(ring, "um", "N") for ring in rings)
    if rigid[0]:
        first = (Pin("va", "m/s", "N"), Pin("a", "um", "-"))
    side = (Pin("v", "m/s", "N"), Pin("bottom", "um", "-")) if rigid[1] else (Pin("b", "um", "N"),)
    along = (Pin("slide", "um", "N"), Pin("rail", "um", "N")) if law.friction else ()
    carried = (Pin(CARRIED, "um", "N"),) if elastic else ()
    pins = (*first, *side, *carried, *along, Pin("base", "um", "N"))
    distinct([pin.name for pin in pins], _inner(rings), where=name)
    radii = () if under is None else under[1][: len(rings)]
    sphere = (
        []
        if under is None
        else [Param("radius", under[0], "m", "radius of the sphere", float(max(radii)))]
    )
    doc = "gap at {} when both sides are at rest" if under is None else "added to the gap at {}"
    what = "contact penalty of a whole ring" if law.power == 1 else "Hertz: 4/3 E* sqrt(R)"
    damping, friction = "of Hunt and Crossley", "Coulomb's coefficient"
    if groove is not None:
        s = f"s = sin({groove:g}/2 deg)"
        what = f"along the axis of a groove, 2 s^{1 + law.power:g} times one flank's, {s}"
        damping, friction = f"s times that of a flank, {s}", f"1/s times Coulomb's coefficient, {s}"
    if law.radius:
        sphere = [
            Param("radius", law.radius, "m", "radius of the sphere", law.depth),
            Param("pace", law.pace, "s", "in which the surfaces follow the pressure"),
        ]
    params = (
        positive("eps", law.stiffness, f"N/m{'' if law.power == 1 else '^1.5'}", what),
        *sphere,
        *(
            Param(f"gap_{ring}", float(gap), "m", doc.format(ring))
            for ring, gap in zip(rings, gaps, strict=True)
        ),
        *([positive("damping", law.damping, "s/m", damping)] if law.damping else []),
        *([positive("friction", law.friction, "1", friction)] if along else []),
        *([positive("creep", law.creep, "m/s", "speed of full friction")] if along else []),
    )
    text = render(
        "contact.j2",
        header=part_header(
            header,
            f"{name}: penalty contact",
            pins,
            params,
            rating=RATING,
            validity=_validity(law),
        ),
        name=name,
        pins=[pin.name for pin in pins],
        parameters=parameter_list(params),
        rings=rings,
        ends={ring: ("va", "a") if rigid[0] else (ring, ring) for ring in rings},
        squares=[] if law.radius else [float(r) ** 2 for r in radii],
        force=side[0].name,
        place=side[-1].name,
        carried=CARRIED if elastic else "",
        law=law,
        series=[c / (1e6 * law.depth) ** (k / 2) for k, c in enumerate(law.curve)],
        rates={ring: "va" if rigid[0] else f"rate{ring}" for ring in rings if law.damping},
        rate="v" if rigid[1] else "rateb",
    )
    return Subcircuit(name, pins, params, text, no_module=SLIPS if law.friction else "")


def _inner(rings: Iterable[str]) -> str:
    """Pattern of the nodes that the template names after a pin, in lower case."""
    pins = "|".join(re.escape(pin.lower()) for pin in (*rings, "b", "slide"))
    return rf"(f|x|near|edge|lag|late|copy|sensed|rate)({pins})"


def _validity(law: Normal) -> str:
    kind = "elastic but for its damping" if law.damping else "elastic"
    along, absent = ("", "friction, ") if not law.friction else (" and along", "")
    return (
        f"{kind} and normal to{along} the surface, at any temperature: no {absent}adhesion or "
        "plastic flow"
    )


def dent(modulus: float, mass: float, speed: float, radius: float) -> float:
    """Depth [m] at which a rigid sphere of this mass [kg] and speed [m/s] stops.

    No state of the body stores less energy under a dent than the static one, so what the static
    law needs to stop the sphere is a bound: ``m v^2 / 2 = 8/15 E sqrt(R) d^(5/2)`` (Hertz 1881).
    """
    energy = 0.5 * mass * speed**2
    spare = 1.25  # the body is neither a half-space nor pressed on more than a few rings
    return spare * float((15 * energy / (8 * modulus * math.sqrt(radius))) ** 0.4)


def fall(height: float, gravity: float) -> float:
    """Speed [m/s] gained over ``height`` [m]."""
    return math.sqrt(max(0.0, 2 * gravity * height))


def landing(sphere: Part, scene: Scene, speed: float, why: str) -> Iterator[Reach]:
    """How deep a sphere that arrives with ``speed`` [m/s] goes into the bodies that it touches."""
    for contact in scene.of("contact"):
        (one, _), (other, b) = _names(contact, scene)
        body = scene.parts.get(one)
        modulus = body.type.indentation_modulus(body) if body else None
        if other == sphere.name and b.radius and modulus is not None:
            if b.elastic:
                modulus = 1 / (1 / modulus + 1 / made_of(sphere).indentation_modulus)
            yield Reach(dent(modulus, sphere.keys.mass, speed, b.radius), why)


register(Contact())
