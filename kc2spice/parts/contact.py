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
from kc2spice.core.waveforms import Waveforms, running
from kc2spice.netlist.cards import distinct
from kc2spice.netlist.circuit import Param, Subcircuit, positive
from kc2spice.parts.sphere import made_of
from kc2spice.physics.contact import Normal, contact_law
from kc2spice.scene.judge import PAIRS, Balance, Check, Gate, stepping
from kc2spice.scene.model import GROUND, Part, Scene, Terminal
from kc2spice.scene.parttype import (
    Build,
    LocalCompliance,
    Neglected,
    Numerics,
    PartType,
    Penetration,
    Rest,
    Surface,
    Vector,
    begins,
    mover,
    register,
)
from kc2spice.spice.header import Header
from kc2spice.spice.library import library

if TYPE_CHECKING:
    from kc2spice.bodies.pressure import Indented, PressureBasis

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
    source = "closed form"

    def pins(self, part: Part, scene: Scene) -> tuple[Terminal, ...]:
        a, b = sides(part, scene)
        ports, carried = kept_ports(part, scene), bool(b.elastic)
        return _terminals(ports, (a.rigid, b.rigid), carried, bool(part.keys.friction))

    def default_joins(self, part: Part, scene: Scene) -> Mapping[str, str]:
        a, b = sides(part, scene)
        first = ("va", "a") if a.rigid else kept_ports(part, scene)
        joins = _meets(first, a, scene) | _meets(("v", "bottom") if b.rigid else ("b",), b, scene)
        return joins | ({CARRIED: f"{b.elastic}.{PATCH}"} if b.elastic else {})

    def at_rest(self, part: Part, scene: Scene, model: Any | None = None) -> Rest:
        """Surfaces that touch at rest: what presses on them finds its place."""
        a, b = sides(part, scene)
        held = [(pin, GROUND) for pin in ("base", *["va"] * a.rigid, *["v"] * b.rigid)]
        if part.keys.gap <= 0.0 and not a.rigid and not b.rigid:
            held += [(port, "b") for port in kept_ports(part, scene)]
        return Rest(tuple(held))

    def numerics(self, part: Part, scene: Scene) -> Iterator[Numerics]:
        """A trapezoid's errors of closing and opening cancel for a linear spring alone. Rebounds
        that lose 0 to 70 % of their energy are then good to 1.5e-4 at the usual reltol."""
        curved = part.keys.law == "hertz" or part.keys.shape == "pressure"
        reltol = DAMPED if part.keys.damping else CURVED if curved else 1.0
        what = "contact, as far as a body has motions"
        yield Numerics(what, content=EXCITED, reltol=reltol)

    def problems(self, part: Part, scene: Scene) -> Iterator[UsageError]:
        a, b = sides(part, scene)
        if a.part == b.part != GROUND and set(a.pushed) & set(b.pushed):
            got, expected = f"{a.part} on both sides", "two parts, or two ports of a body"
            yield part.wrong("b", "nothing touches itself", got, expected)
        if b.radius is not None and max(a.distance) >= b.radius:
            yield UsageError(
                "the outermost contact port lies beyond the sphere, which can never touch it",
                where=f"{a.part}.mesh.ring_spacing",
                got=f"ring radius {max(a.distance):g} m",
                expected=f"less than {b.part}.radius, {b.radius:g} m",
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
        made = contact_subcircuit(
            header,
            ports,
            added,
            normal(part, build.scene),
            under=under,
            rigid=(a.rigid, b.rigid),
            elastic=bool(b.elastic),
            groove=part.keys.groove,
            name=build.libraries[part.name],
        )
        return (made,)

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
        _, b = sides(part, build.scene)
        v = waves.data.get(f"{b.part}.v")
        if "time" not in waves or v is None or thrown(part, build.scene):
            return {}
        force, busy = waves[f"{part.name}.force"], busy_until(build.scene)
        power = normal(part, build.scene).power
        launch = separation(waves["time"], force, v, busy, power)
        return {
            "launch_velocity_m_s": launch[1] if launch else None,
            "launch_time_s": launch[0] if launch else None,
        }

    def checks(self, part: Part, build: Build, waves: Waveforms) -> Iterator[Check | Balance]:
        if "time" in waves:
            yield from _balance(part, build, waves)
            yield from _start(part, build, waves)
            yield from _penetration(part, build, waves)
            yield from _events(part, build, waves)
        yield from _open_ports(part, build, waves)
        yield from _within_law(part, build, waves)

    def figures(self, part: Part, build: Build, waves: Waveforms) -> Iterator[Figure]:
        force = waves.data.get(f"{part.name}.force")
        if force is None:
            return
        ports = kept_ports(part, build.scene)
        inside = _loaded(force) if "time" in waves else slice(None)
        scale = next(iter(waves.data.values()))
        x, factor = time_axis(scale[inside])
        if (depth := _depth(part, build.scene, waves)) is not None:
            scale, (x, factor) = depth, ("depth in µm", 1e6)
        curves = [
            Curve(port, factor * scale[inside], waves[f"{part.name}.force.{port}"][inside])
            for port in ports
            if waves[f"{part.name}.force.{port}"].max() > 0
        ]
        if len(ports) > 1:
            curves.append(Curve("sum", factor * scale[inside], force[inside], "--"))
        one, other = (side.part for side in sides(part, build.scene))
        panel = Panel(x, "contact force in N", tuple(curves))
        caption = f"Force between {one} and {other}, whole device, at each port that closes."
        yield Figure(f"{part.name}_force", f"Contact of {one} and {other}", caption, (panel,))

    def gates(self, part: Part, build: Build) -> Iterator[Gate]:
        if build.scene.analysis.type == "transient" and not thrown(part, build.scene):
            gates, steps = build.scene.gates, stepping(build.scene.solver)
            a, _ = sides(part, build.scene)
            certificate = getattr(build.models.get(a.part), "certificate", None)
            reduced = REDUCED * certificate.error_estimate if certificate else BEYOND
            full = gates.launch_full_model or steps + reduced
            limits = dict.fromkeys(PAIRS, full)
            limits["ngspice_vs_rom"] = gates.launch_velocity or steps
            yield Gate("launch velocity", "launch_velocity_m_s", limits, leads=True)

    def law(self, part: Part, build: Build) -> laws.Equations:
        n, scene = part.name, build.scene
        ports = kept_ports(part, scene)
        (a, b), own = sides(part, scene), normal(part, scene)
        law = contact_law(n, ports, own, gaps(part, scene), CARRIED if b.elastic else "")
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

    def detail(self, part: Part, scene: Scene) -> str:
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
        return detail

    def neglected(self, part: Part, scene: Scene) -> Iterator[Neglected]:
        a, b = sides(part, scene)
        kept = len(kept_ports(part, scene))
        if len(a.ports) > 1:
            why = f"one force per port of {a.part} stands for it"
            yield Neglected(
                "pressure between the ports", why, "run again with a finer mesh to see it"
            )
        if part.keys.inertia == "massless":
            yield Neglected(
                f"inertia of the residual modes behind the ports of {part.name}",
                "stiff modes above the band that keep the ports' compliance exact; their mass is "
                "the mesh's and rattles behind the springs",
                "part of the reduced model's certified error",
            )
        dry = "" if part.keys.friction else "friction, "
        what = f"{dry}adhesion and plastic flow between {a.part} and {b.part}"
        yield Neglected(what, "the law is elastic and normal to the surface", "not estimated")
        if kept < len(a.ports):
            gap, estimate = (
                float(gaps(part, scene, every=True)[kept]),
                largest_penetration(part, scene),
            )
            why = f"open up to {gap:.3g} m; {estimate.why}: {estimate.depth:.3g} m"
            if part.keys.rings != "needed":
                why = f"{part.name}.rings = {part.keys.rings}"
            last = f" to {a.ports[-1]}" if kept + 1 < len(a.ports) else ""
            error = "none while they stay open, checked after the run"
            yield Neglected(f"contact at {a.ports[kept]}{last}", why, error)


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
            got = f"{len(a.ports)} ports, {len(round_)} spheres"
            expected, hint = "a sphere against one port or another sphere", 'law = "linear"'
            problem = "Hertz's law is that of a sphere at one point"
            raise part.wrong("law", problem, got, expected, hint)
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
    along = keys.damping, keys.friction, keys.creep
    curve = tuple(c / first for c in found.coefficients)
    stiffness = first / found.depth**1.5
    return Normal(stiffness, 1.5, *along, curve, found.depth, dents.pace, b.radius)


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


def _dents(part: Part, scene: Scene, shape: PressureBasis) -> LocalCompliance:
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
    return LocalCompliance(whole, found.patch + other.patch, pace)


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
        depth = np.linspace(0.5, 1.0, 50) * min(
            largest_penetration(part, scene).depth or math.inf, law.depth
        )
        forces.append(law.force(depth))
    return float(np.abs(forces[1] / forces[0] - 1).max())


def unresolved(part: Part, scene: Scene) -> float:
    """Gate of the law against a full model with finer hats, relative: 0 for rings."""
    return HATS * spacing_error(part, scene) if part.keys.shape == "pressure" else 0.0


@lru_cache(maxsize=8)
def _dented(nodes: bytes, compliance: bytes, radius: float) -> Indented:
    from kc2spice.bodies.pressure import PressureBasis, dented

    shape = PressureBasis(np.frombuffer(nodes))
    matrix = np.frombuffer(compliance).reshape(len(shape.nodes) - 1, -1)
    return dented(shape, matrix, ring_gaps(shape.distances, radius))


def _pressure_problems(part: Part, a: Surface, b: Surface) -> Iterator[UsageError]:
    hint = 'shape = "rings" takes ports as they are'
    if a.dents is None:
        expected = "a piezo_stack, whose contact names no port"
        yield part.wrong("shape", "no port of pressure on this body", a.ports[0], expected, hint)
    elif not part.keys.spacing < a.patch / 4:
        got, expected = f"{part.keys.spacing:g} m", f"less than {a.patch / 4:g} m"
        problem = "hats of pressure wider than the patch that they are in"
        yield part.wrong("spacing", problem, got, expected)
    if b.radius is None or b.radius <= a.patch:
        got = "no sphere" if b.radius is None else f"a radius of {b.radius:g} m"
        expected = f"a sphere of more than {a.patch:g} m, the outermost ring"
        yield part.wrong("shape", "pressure is that under a sphere", got, expected, hint)
    for key, usual in (("law", "linear"), ("groove", None)):
        if (got := getattr(part.keys, key)) != usual:
            yield part.wrong(key, f"pressure has its own law, without {key}", got, hint=hint)


def _modulus(part: Part, scene: Scene) -> float:
    """``E*`` [Pa] of both sides."""
    if part.keys.modulus is not None:
        return float(part.keys.modulus)
    compliance = 0.0
    for side in sides(part, scene):
        if side.modulus is None:
            expected = 'a pressure such as "110 GPa", or a material of both sides'
            raise part.wrong("modulus", f"no modulus of {side.part} is known", expected=expected)
        compliance += 1 / side.modulus
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
    return _side(part, scene, "a", round_=False), _side(part, scene, "b", round_=True)


def _side(part: Part, scene: Scene, key: str, *, round_: bool) -> Surface:
    chosen: str | tuple[str, ...] | None = getattr(part.keys, key)
    if chosen is None:
        others = (other for other in scene.parts.values() if other is not part)
        every = (other.type.surface(other, scene) for other in others)
        offers = [each for each in every if each and (each.radius is not None) == round_]
        if len(offers) != 1:
            kind, table = ("a sphere", "sphere") if round_ else ("a body with a surface", "kick")
            raise part.wrong(
                key,
                f"{part.name} needs to know what touches",
                ", ".join(each.part for each in offers) or f"no part that is {kind}",
                f'{key} = "PART" or "PART.PORT"',
                None if offers else f"add [{table}]; an empty table takes the defaults",
            )
        return offers[0]
    if chosen == GROUND:
        return Surface(GROUND, (FLOOR,), (0.0,))
    targets = [t.partition(".") for t in ((chosen,) if isinstance(chosen, str) else chosen)]
    names = {name for name, _, _ in targets}
    if len(names) != 1:
        raise part.wrong(key, "one body on each side", ", ".join(sorted(names)))
    other = scene.part(names.pop(), f"{part.name}.{key}")
    surface = other.type.surface(other, scene, tuple(port for _, dot, port in targets if dot))
    if surface is None:
        problem = f"{other.type.name} offers nothing to touch"
        raise part.wrong(key, problem, repr(other.name), "a body, a sphere or a mass")
    return surface


def _meets(pins: Iterable[str], side: Surface, scene: Scene) -> dict[str, str]:
    """What its pins are joined to on one side: those of the part that moves it."""
    if side.part == GROUND:
        return dict.fromkeys(pins, GROUND)
    owner = mover(side.part, scene) or side.part
    ends = (*side.pushed, *side.ports) if side.rigid else side.ports
    return {pin: f"{owner}.{end}" for pin, end in zip(pins, ends, strict=False)}


def kept_ports(part: Part, scene: Scene) -> tuple[str, ...]:
    """Ports of ``a`` that get a spring, the nearest to the axis first."""
    a, _ = sides(part, scene)
    rings = part.keys.rings
    if rings == "all" or len(a.ports) == 1 or list(a.distance) != sorted(a.distance):
        return a.ports
    if rings != "needed":
        return a.ports[: min(rings, len(a.ports))]
    near = int(
        np.count_nonzero(gaps(part, scene, every=True) < largest_penetration(part, scene).depth)
    )
    return a.ports[: max(1, near)]


def largest_penetration(part: Part, scene: Scene) -> Penetration:
    """The largest of what the parts of the scene can do; a prescribed one beats all."""
    found = [
        each for other in scene.parts.values() for each in other.type.penetrations(other, scene)
    ]
    for each in found:
        if each.prescribed:
            return each
    return max([Penetration(0.0, "its weight"), *found], key=lambda each: each.depth)


def thrown(part: Part, scene: Scene) -> bool:
    """Whether one side starts with a prescribed velocity, or each may."""
    a, b = sides(part, scene)  # a ceiling stays where it is
    return b.part == GROUND or a.rigid or b.part in begins(scene)


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


def _height(side: Surface, port: str, waves: Waveforms) -> np.ndarray | None:
    """Position [m] of one side at a port, zero where it touches."""
    name = side.part
    if name == GROUND:
        return np.zeros(next(iter(waves.data.values())).size)
    if side.radius is not None and side.rigid:
        y = waves.data.get(f"{name}.y")
        return None if y is None else y - side.radius
    return waves.data.get(f"{name}.u.{port}", waves.data.get(f"{name}.x"))


def _depth(part: Part, scene: Scene, waves: Waveforms) -> np.ndarray | None:
    """How deep [m] another part pushes side ``b``; None where it moves freely."""
    _, b = sides(part, scene)
    return waves.data.get(f"{mover(b.part, scene)}.depth")


def _place(part: Part, build: Build, waves: Waveforms) -> np.ndarray | None:
    """Position [m] of side ``b`` at its lowest point, zero where it touches."""
    _, b = sides(part, build.scene)
    depth = _depth(part, build.scene, waves)
    found = _height(b, b.ports[0], waves) if depth is None else -depth
    if not b.elastic or found is None:
        return found
    dent_ = waves.data.get(f"{b.elastic}.u.{PATCH}")
    return None if dent_ is None else found + dent_


def _balance(part: Part, build: Build, waves: Waveforms) -> Iterator[Balance]:
    """Work that closes the springs against what they store, and what their damping takes.

    Springs give back all they took: energy gained here is a bounce higher than the last. The scale
    is the work that went into the springs, or what they hold where nothing moves.
    """
    (a, b), own = sides(part, build.scene), normal(part, build.scene)
    place, ports = _place(part, build, waves), kept_ports(part, build.scene)
    heights = [each for port in ports if (each := _height(a, port, waves)) is not None]
    if place is None or len(heights) < len(ports):
        return
    closing = np.array(heights) - place  # as all of these (ports, n)
    force, p = np.array([waves[f"{part.name}.force.{port}"] for port in ports]), own.power
    elastic, energy = force, force ** (1 + 1 / p) / ((p + 1) * own.stiffness ** (1 / p))
    if own.damping or own.radius:  # the force is not that of the depth alone
        x = closing - gaps(part, build.scene)[:, None]
        elastic, energy = own.force(x), own.energy(x)
    resting, gained = float(energy.max()), energy - energy[:, :1]
    missing = (running(elastic, closing) - gained).sum(axis=0)
    turnover = float(np.abs(np.diff(gained)).sum())
    entries = {"stored in the contact": float(gained[:, -1].sum())}
    if own.damping or own.pace:
        lost = running(force - elastic, closing)[:, -1]
        entries["damped in the contact"] = float(lost.sum())
    scale = max(turnover, resting, _kinetic(b.part, build, waves))
    advice = "the steps are too coarse for the contact: lower solver.reltol or max_step"
    yield Balance(entries, float(np.abs(missing).max()), scale, MISSING, advice)


def _kinetic(other: str, build: Build, waves: Waveforms) -> float:
    v = waves.data.get(f"{other}.v")
    if v is None or other == GROUND:
        return 0.0
    mass = getattr(build.scene.parts[other].keys, "mass", 0.0)
    return mass * float((v**2).max()) / 2


def _start(part: Part, build: Build, waves: Waveforms) -> Iterator[Check]:
    """The operating point may hold the sphere elsewhere: other forces balance its weight there."""
    a, b = sides(part, build.scene)
    other = b.part
    place, force = _place(part, build, waves), waves.data.get(f"{part.name}.force")
    free = mover(other, build.scene) is None and not thrown(part, build.scene)
    if b.radius is None or place is None or force is None or not free:
        return
    above = 0.0 if force[0] > 0 else float(place[0]) + part.keys.gap
    advice = f"forces on {other} balance there before anything moves: change them (magnets: "
    advice += f"polarity, remanence or position), or give {other}.height and velocity at t = 0"
    name, action = f"{other} starts at rest on {a.part}", build.scene.checks.start
    yield Check(name, above, ALOFT, "m above it", advice, action)


def _penetration(part: Part, build: Build, waves: Waveforms) -> Iterator[Check]:
    _, b = sides(part, build.scene)
    every = gaps(part, build.scene, every=True)
    if b.radius is None or every.size < 2:
        return
    ports = kept_ports(part, build.scene)
    deepest = max(float(waves[f"{part.name}.force.{r}"].max()) for r in ports)
    depth = deepest / normal(part, build.scene).stiffness
    advice = f"the penalty springs give more than the surfaces curve: raise {part.name}.penalty"
    limit, action = float(every[1]), build.scene.checks.penetration
    yield Check("penetration", depth, limit, "m", advice, action)


def _events(part: Part, build: Build, waves: Waveforms) -> Iterator[Check]:
    """Contacts of the port that has most of them, while the drive moves."""
    a, _ = sides(part, build.scene)
    body = build.scene.parts.get(a.part)
    drive = getattr(body.keys, "drive", None) if body else None
    if drive is None:
        return
    t, end = waves["time"], drive.start + drive.width + drive.edge
    during = (t >= drive.start) & (t <= end)
    ports = kept_ports(part, build.scene)
    closed = [waves[f"{part.name}.force.{ring}"][during] > 0.0 for ring in ports]
    most = max(int(np.count_nonzero(now[1:] & ~now[:-1])) for now in closed)
    reltol = waves.stats.get("reltol", build.scene.solver.reltol)
    advice = "so many decide the launch that the errors of their steps add up: lower "
    advice += "solver.reltol; a launch after hundreds of contact events may be ill-conditioned"
    limit, action = max(FEW, EVENTS / reltol), build.scene.checks.touches
    yield Check("touches", most, limit, "contact events", advice, action, coarse=True)


def _open_ports(part: Part, build: Build, waves: Waveforms) -> Iterator[Check]:
    """*outer_ring* or *ring_left_out*: the first port without a spring stays open.

    Nothing records that port. Without contact it would rise with the outermost kept one and the
    dents that the recorded forces press into that one, ``u_K + sum_j S_Kj F_j``, and its own dent
    only takes it farther from the sphere. S is the static compliance: over one ring's spacing the
    chip answers at once. Against models with all rings this lies 10 to 100 % above what the next
    ring does at worst, and never more than 5 % of its gap below.
    """
    scene = build.scene
    (a, b), place = sides(part, scene), _place(part, build, waves)
    if b.radius is None or len(a.ports) < 2 or place is None:
        return
    ports, action = kept_ports(part, scene), scene.checks.range
    force = np.array([waves[f"{part.name}.force.{name}"] for name in ports])
    compliance = getattr(scene.parts[a.part].type, "static_compliance", None)
    if len(ports) < len(a.ports) and compliance is not None:
        static = compliance(scene.parts[a.part], build, ports)[:, -1]
        rise = waves[f"{a.part}.u.{ports[-1]}"] + static @ force - place
        gap = float(gaps(part, scene, every=True)[len(ports)])
        advice = f"set {part.name}.rings to more than {len(ports)}, or to 'all'"
        mend = (f"{part.name}.rings", len(ports) + 1) if part.keys.rings == "needed" else None
        highest = float(rise.max())
        yield Check("ring_left_out", highest, OPEN * gap, "m", advice, action, mend=mend)
    elif _depth(part, scene, waves) is None:
        advice = "the contact outgrows the modelled rings: more rings or a wider ring_spacing"
        yield Check("outer_ring", float(force[-1].max()), 0.0, "N", advice, action)


def _within_law(part: Part, build: Build, waves: Waveforms) -> Iterator[Check]:
    """The law of a pressure ends where the contact is as wide as half of its patch, and knows
    little of one that a few hats carry (:data:`CARRYING`)."""
    if part.keys.shape != "pressure":
        return
    a, b = sides(part, build.scene)
    own, place = normal(part, build.scene), _place(part, build, waves)
    height = _height(a, a.ports[0], waves)
    if place is None or height is None:
        return
    deepest, checks = float((height - place - part.keys.gap).max()), build.scene.checks
    advice = f"no law of the pressure is known so deep: more {a.part}.mesh.rings, or wider ones"
    yield Check("depth of the contact", deepest, own.depth, "m", advice, checks.range)
    if deepest > 0.0 and b.radius is not None:
        widest, spacing = math.sqrt(deepest * b.radius) / CARRYING, part.keys.spacing
        advice = "so few of them carry that the force is more than 5e-3 off: lower "
        advice += f"{part.name}.spacing"
        yield Check("hats of the contact", spacing, widest, "m", advice, checks.penetration)


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
    pins = _terminals(rings, rigid, elastic, bool(law.friction))
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
        *([positive("friction", law.friction, "1", friction)] if law.friction else []),
        *([positive("creep", law.creep, "m/s", "speed of full friction")] if law.friction else []),
    )
    return library(
        "contact",
        header,
        name,
        "penalty contact",
        pins,
        params,
        rating=RATING,
        validity=_validity(law),
        no_module=SLIPS if law.friction else "",
        rings=rings,
        ends={ring: ("va", "a") if rigid[0] else (ring, ring) for ring in rings},
        squares=[] if law.radius else [float(r) ** 2 for r in radii],
        force="v" if rigid[1] else "b",
        place="bottom" if rigid[1] else "b",
        carried=CARRIED if elastic else "",
        law=law,
        rubbed=law.rubbed,
        series=[c / (1e6 * law.depth) ** (k / 2) for k, c in enumerate(law.curve)],
        rates={ring: "va" if rigid[0] else f"rate{ring}" for ring in rings if law.damping},
        rate="v" if rigid[1] else "rateb",
    )


def _terminals(
    rings: tuple[str, ...], rigid: tuple[bool, bool], elastic: bool, friction: bool
) -> tuple[Terminal, ...]:
    """Pins of a contact: both sides, what a rigid one that is elastic carries, along, the base."""
    speeds = Terminal("va", "m/s", "N"), Terminal("v", "m/s", "N")
    heights = Terminal("a", "um", "-"), Terminal("bottom", "um", "-")
    pins = [speeds[0], heights[0]] if rigid[0] else [Terminal(ring, "um", "N") for ring in rings]
    pins += [speeds[1], heights[1]] if rigid[1] else [Terminal("b", "um", "N")]
    pins += [Terminal(CARRIED, "um", "N")] if elastic else []
    slide, rail = Terminal("slide", "um", "N", required=True), Terminal("rail", "um", "N", "gnd")
    return (*pins, *([slide, rail] if friction else []), Terminal("base", "um", "N", "gnd"))


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


def landing(sphere: Part, scene: Scene, speed: float, why: str) -> Iterator[Penetration]:
    """How deep a sphere that arrives with ``speed`` [m/s] goes into the bodies that it touches."""
    for contact in scene.of("contact"):
        a, b = sides(contact, scene)
        if b.part == sphere.name and b.radius and (modulus := a.modulus) is not None:
            if b.elastic:
                modulus = 1 / (1 / modulus + 1 / made_of(sphere).indentation_modulus)
            yield Penetration(dent(modulus, sphere.keys.mass, speed, b.radius), why)


register(Contact())
