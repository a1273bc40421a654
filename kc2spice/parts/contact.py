"""Unilateral contact between a body's ports and a sphere or a port of another body (eq. 10)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any, Literal

import numpy as np
from pydantic import Field

from kc2spice.core import laws
from kc2spice.core.errors import UsageError
from kc2spice.core.figure import Curve, Figure, Panel, time_axis
from kc2spice.core.quantities import Length, Rings, Section, Stiffness
from kc2spice.core.waveforms import Waveforms
from kc2spice.parts.sphere import integral
from kc2spice.scene.gates import Gate
from kc2spice.scene.judge import Balance, Check
from kc2spice.scene.model import Part, Scene, Terminal
from kc2spice.scene.parttype import (
    Build,
    LeftOut,
    Modelled,
    PartType,
    Reach,
    Surface,
    Vector,
    register,
)
from kc2spice.spice.circuit import Param, Pin, Subcircuit, positive
from kc2spice.spice.header import Header, parameter_list, part_header
from kc2spice.spice.render import render

MISSING = 1e-3  # energy that the springs may make or lose, of what went through them
RATING = "not known; compare the force with the strength of both surfaces (Hertz)"
OPEN = 0.95  # of its gap that the bound of a ring that was left out may reach
# Contact events of a kick that a reltol is good for, times that reltol: every event adds the error
# of a step. Of 37 kicks of chips damped by 0.01 to 0.05 %, those above launched wrong by 9e-4.
EVENTS = 4e-3
ALOFT = 1e-8  # m over the body at t = 0 that a sphere at rest on it may have
FEW = 20  # events that are not too many for any reltol
_FLIGHT = 20e-6  # several periods of the chip: a shorter gap is a bounce within the kick


class ContactKeys(Section):
    """Penalty contact, one spring per port of ``a`` (paper eq. 10)."""

    penalty: Stiffness = Field(1e8, gt=0, description="of a ring of one symmetry sector")
    rings: Rings = Field("needed", description="needed, all, or how many from the centre on")
    a: str | tuple[str, ...] | None = Field(
        None, description="body, or its ports; the only body that offers a surface"
    )
    b: str | None = Field(None, description="sphere, or a port of a body; the only sphere")
    gap: Length = Field(0.0, description="at rest, on top of that of the geometry")
    inertia: Literal["massless", "lumped"] = Field(
        "massless", description="of the residual modes behind the ports: left out, or a mass each"
    )


class Contact(PartType):
    name = "contact"
    title = "unilateral penalty contact"
    schema = ContactKeys
    throws = True

    def pins(self, part: Part, scene: Scene) -> tuple[Terminal, ...]:
        _, b = sides(part, scene)
        rings = tuple(Terminal(port, "um", "N") for port in kept_ports(part, scene))
        if b.force == b.place:
            return (*rings, Terminal("b", "um", "N"), Terminal("base", "um", "N", "gnd"))
        return (
            *rings,
            Terminal("v", "m/s", "N"),
            Terminal("bottom", "um", "-"),
            Terminal("base", "um", "N", "gnd"),
        )

    def links(self, part: Part, scene: Scene) -> Mapping[str, str]:
        (one, _), (other, b) = _names(part, scene)
        other = moved_by(other, scene)
        joins = {port: f"{one}.{port}" for port in kept_ports(part, scene)}
        if b.force == b.place:
            return joins | {"b": f"{other}.{b.force[0]}"}
        return joins | {"v": f"{other}.{b.force[0]}", "bottom": f"{other}.{b.place[0]}"}

    def wants(self, part: Part, scene: Scene) -> tuple[str, ...]:
        (one, _), (other, b) = _names(part, scene)
        return (*(f"{one}.{port}" for port in kept_ports(part, scene)), f"{other}.{b.force[0]}")

    def massless(self, part: Part, scene: Scene) -> tuple[str, ...]:
        return self.wants(part, scene) if part.keys.inertia == "massless" else ()

    def problems(self, part: Part, scene: Scene) -> Iterator[UsageError]:
        a, b = sides(part, scene)
        if b.radius is not None and max(a.distance) >= b.radius:
            (one, _), (other, _) = _names(part, scene)
            yield UsageError(
                "the outermost contact port lies beyond the sphere, which can never touch it",
                where=f"{one}.mesh.ring_spacing",
                got=f"ring radius {max(a.distance):g} m",
                expected=f"less than {other}.radius, {b.radius:g} m",
            )

    def subcircuits(self, part: Part, build: Build, header: Any) -> tuple[Any, ...]:
        ports = kept_ports(part, build.scene)
        a, b = sides(part, build.scene)
        added = np.full(len(ports), part.keys.gap)
        under = None if b.radius is None else (b.radius, np.array(a.distance[: len(ports)]))
        return (
            contact_subcircuit(
                header, ports, added, stiffness(part, build.scene), under=under,
                rigid=self._velocity(part, build.scene), name=build.libraries[part.name],
            ),
        )  # fmt: skip

    def _velocity(self, part: Part, scene: Scene) -> bool:
        _, b = sides(part, scene)
        return b.force != b.place

    def vectors(self, part: Part, build: Build) -> Mapping[str, Vector]:
        forces = {
            f"{part.name}.force.{r}": f"@b.x{part.name.lower()}.b{r.lower()}[i]"
            for r in kept_ports(part, build.scene)
        }
        found = {f"{part.name}.force": Vector("+".join(forces.values()), 1.0, "N")}
        return found | {name: Vector(text, 1.0, "N") for name, text in forces.items()}

    def force_on(self, part: Part, pin: str, build: Build, waves: Waveforms) -> np.ndarray | None:
        if pin in ("v", "b"):
            return waves.data.get(f"{part.name}.force")
        force = waves.data.get(f"{part.name}.force.{pin}")
        return None if force is None else -force

    def metrics(self, part: Part, build: Build, waves: Waveforms) -> Mapping[str, Any]:
        (_, _), (other, _) = _names(part, build.scene)
        v = waves.data.get(f"{other}.v")
        if "time" not in waves or v is None or thrown(part, build.scene):
            return {}
        force, busy = waves[f"{part.name}.force"], busy_until(build.scene)
        launch = separation(waves["time"], force, v, busy)
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
            gates = build.scene.gates
            limits = {
                "ngspice_vs_rom": gates.launch_velocity,
                "rom_vs_fom": gates.launch_full_model,
                "ngspice_vs_fom": gates.launch_full_model,
            }
            yield Gate("launch velocity", "launch_velocity_m_s", limits, leads=True)

    def law(self, part: Part, build: Build) -> laws.Equations:
        n, scene = part.name, build.scene
        ports = kept_ports(part, scene)
        law = laws.Contact(n, ports, np.full(len(ports), stiffness(part, scene)), gaps(part, scene))
        place = "bottom" if self._velocity(part, scene) else "b"
        pins = (*((port, f"{n}.{port}") for port in ports), (place, f"{n}.b"))
        results = {f"{n}.force.{r}": laws.reading(f"{n}.{r}.through") for r in ports}
        every = tuple((1.0, f"{n}.{r}.through") for r in ports)
        return laws.Equations((law,), pins, {f"{n}.force": laws.Reading(every)} | results)

    def modelled(self, part: Part, scene: Scene) -> Modelled:
        count = len(kept_ports(part, scene))
        detail = f"{count} unilateral springs, {stiffness(part, scene):g} N/m each"
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
            )  # fmt: skip
        what = f"friction, adhesion and plastic flow between {one} and {other}"
        yield LeftOut(what, "the law is elastic and normal to the surface", "not estimated")
        if kept < len(a.ports):
            gap, estimate = float(gaps(part, scene, every=True)[kept]), reach(part, scene)
            why = f"open up to {gap:.3g} m; {estimate.why}: {estimate.depth:.3g} m"
            if part.keys.rings != "needed":
                why = f"{part.name}.rings = {part.keys.rings}"
            last = f" to {a.ports[-1]}" if kept + 1 < len(a.ports) else ""
            yield LeftOut(
                f"contact at {a.ports[kept]}{last}", why,
                "none while they stay open, checked after the run",
            )  # fmt: skip


# --- geometry: the one place for gap laws and symmetry factors ------------------------------------


def ring_gaps(distance: np.ndarray, sphere_radius: float) -> np.ndarray:
    """Gap [m] at each distance under a sphere that touches the axis: ``R - sqrt(R^2 - r^2)``.

    Written as ``r^2 / (R + sqrt(R^2 - r^2))``, which does not cancel.
    """
    r = np.asarray(distance, dtype=float)
    return r**2 / (sphere_radius + np.sqrt(sphere_radius**2 - r**2))


def stiffness(part: Part, scene: Scene) -> float:
    """Stiffness [N/m] of the whole device's spring at each port."""
    a, _ = sides(part, scene)
    return a.sectors * float(part.keys.penalty)


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
            if other is not part and (surface := other.type.surface(other, scene)) is not None
            and (surface.radius is not None) == round_
        ]  # fmt: skip
        if len(offers) != 1:
            kind = "a sphere" if round_ else "a body with a surface"
            raise UsageError(
                f"{part.name} needs to know what touches", where=where,
                got=", ".join(name for name, _ in offers) or f"no part that is {kind}",
                expected=f'{key} = "PART" or "PART.PORT"',
                hint=None if offers else f"add [{'sphere' if round_ else 'kick'}]; an empty "
                "table takes the defaults",
            )  # fmt: skip
        return offers[0]
    targets = (chosen,) if isinstance(chosen, str) else chosen
    names = {target.partition(".")[0] for target in targets}
    if len(names) != 1:
        raise UsageError("one body on each side", where=where, got=", ".join(sorted(names)))
    other = scene.part(names.pop(), where)
    ports = tuple(target.partition(".")[2] for target in targets if "." in target)
    surface = other.type.surface(other, scene, ports)
    if surface is None:
        raise UsageError(
            f"{other.type.name} offers nothing to touch", where=where, got=repr(other.name),
            expected="a body, a sphere or a mass",
        )  # fmt: skip
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
    found = [
        each for other in scene.parts.values() for each in other.type.reach(other, scene)
    ]  # fmt: skip
    for each in found:
        if each.prescribed:
            return each
    return max([Reach(0.0, "its weight"), *found], key=lambda each: each.depth)


def thrown(part: Part, scene: Scene) -> bool:
    """Whether one side starts with a prescribed velocity."""
    (_, _), (other, _) = _names(part, scene)
    kind = scene.parts[other].type
    return kind.without_operating_point(scene.parts[other], scene)


# --- what the waveforms say -----------------------------------------------------------------------


def separation(
    t: np.ndarray, force: np.ndarray, v: np.ndarray, busy: float = math.inf
) -> tuple[float, float] | None:
    """Time [s] and velocity [m/s] at the end of the contact that the flight follows, or None.

    A gap is a flight if it lasts 20 us or until the data end. A body that draws back and strikes
    later leaves such a gap too: of the flights that begin until 20 us after ``busy`` [s], when the
    drive stops moving, the launch is the first with at least half of the largest speed. Without
    one it is the first of all; by default the drive is not known and all of them count.
    """
    loaded = force > 1e-9 * force.max(initial=0.0)
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


def _place(part: Part, build: Build, waves: Waveforms) -> np.ndarray | None:
    """Position [m] of side ``b`` at its lowest point, zero where it touches."""
    (_, _), (other, b) = _names(part, build.scene)
    if "imprint.depth" in waves:
        return -waves["imprint.depth"]
    if b.radius is not None:
        y = waves.data.get(f"{other}.y")
        return None if y is None else y - b.radius
    return waves.data.get(f"{other}.u.{b.place[0]}", waves.data.get(f"{other}.x"))


def _balance(part: Part, build: Build, waves: Waveforms) -> dict[str, Balance]:
    """Work that closes the springs against what they store, ``F^2 / (2 eps)`` each.

    Springs give back all they took: energy gained here is a bounce higher than the last. The scale
    is the work that went into the springs.
    """
    (one, _), (other, _) = _names(part, build.scene)
    place = _place(part, build, waves)
    ports = kept_ports(part, build.scene)
    if place is None or f"{one}.u.{ports[0]}" not in waves:
        return {}
    eps = stiffness(part, build.scene)
    missing, turnover, stored = np.zeros(waves["time"].size), 0.0, 0.0
    for port in ports:
        f = waves[f"{part.name}.force.{port}"]
        closing = integral(f, waves[f"{one}.u.{port}"] - place)
        energy = (f**2 - f[0] ** 2) / (2 * eps)
        missing += closing - energy
        turnover += float(np.abs(np.diff(energy)).sum())
        stored += float(energy[-1])
    net = float(np.abs(missing).max())
    scale = max(turnover, _kinetic(other, build, waves))
    advice = "the steps are too coarse for the contact: lower solver.reltol or max_step"
    entries = {"stored in the contact": stored}
    return {part.name: Balance(entries, net, scale, MISSING, advice)}


def _kinetic(other: str, build: Build, waves: Waveforms) -> float:
    mass = getattr(build.scene.parts[other].keys, "mass", 0.0)
    v = waves.data.get(f"{other}.v")
    return 0.0 if v is None else mass * float((v**2).max()) / 2


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
        "penetration", deepest / stiffness(part, build.scene), float(every[1]), "m",
        f"the penalty springs give more than the surfaces curve: raise {part.name}.penalty",
        build.scene.checks.penetration,
    )  # fmt: skip


def _events(part: Part, build: Build, waves: Waveforms) -> Iterator[Check]:
    """Contacts of the port that has most of them, while the drive moves."""
    (one, _), _ = _names(part, build.scene)
    drive = getattr(build.scene.parts[one].keys, "drive", None)
    if drive is None:
        return
    t, end = waves["time"], drive.start + drive.width + drive.edge
    during = (t >= drive.start) & (t <= end)
    ports = kept_ports(part, build.scene)
    closed = [waves[f"{part.name}.force.{ring}"][during] > 0.0 for ring in ports]
    most = max(int(np.count_nonzero(now[1:] & ~now[:-1])) for now in closed)
    reltol = waves.stats.get("reltol", build.scene.solver.reltol)
    yield Check(
        "touches", most, max(FEW, EVENTS / reltol), "contact events",
        "so many decide the launch that the errors of their steps add up: lower solver.reltol; "
        "a launch after hundreds of contact events may be ill-conditioned",
        build.scene.checks.touches, coarse=True,
    )  # fmt: skip


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
        yield Check("ring_left_out", float(rise.max()), OPEN * gap, "m", advice, action)
    elif "imprint.depth" not in waves:
        advice = "the contact outgrows the modelled rings: more rings or a wider ring_spacing"
        yield Check("outer_ring", float(force[-1].max()), 0.0, "N", advice, action)


# --- the subcircuit -------------------------------------------------------------------------------


def contact_subcircuit(
    header: Header,
    rings: tuple[str, ...],
    gaps: np.ndarray,
    eps: float,
    *,
    rigid: bool = True,
    under: tuple[float, np.ndarray] | None = None,
    name: str = "contact",
) -> Subcircuit:
    """``force = eps max(0, u - bottom - gap)`` between ring pins and the other side.

    ``eps`` [N/m] is the stiffness of a whole ring, ``gaps`` [m] one per ring. Given the radius of
    the sphere that the rings are ``under`` and their own [m], the gaps follow from the parameter
    ``radius`` as ``r^2 / (R + sqrt(R^2 - r^2))``, and ``gaps`` are added to them. The other side is
    a ``rigid`` body with the pins ``v`` and ``bottom``, or the port ``b`` of an elastic one.
    """
    side = (Pin("v", "m/s", "N"), Pin("bottom", "um", "-")) if rigid else (Pin("b", "um", "N"),)
    pins = (*(Pin(ring, "um", "N") for ring in rings), *side, Pin("base", "um", "N"))
    radii = () if under is None else under[1][: len(rings)]
    sphere = [] if under is None else [
        Param("radius", under[0], "m", "radius of the sphere", float(max(radii)))
    ]  # fmt: skip
    doc = "gap at {} when both sides are at rest" if under is None else "added to the gap at {}"
    params = (
        positive("eps", eps, "N/m", "contact penalty of a whole ring"),
        *sphere,
        *(
            Param(f"gap_{ring}", float(gap), "m", doc.format(ring))
            for ring, gap in zip(rings, gaps, strict=True)
        ),
    )
    text = render(
        "contact.j2",
        header=part_header(
            header,
            f"{name}: penalty contact",
            pins,
            params,
            rating=RATING,
            validity="elastic and normal to the surface, at any temperature: no friction, adhesion "
            "or plastic flow",
        ),
        name=name,
        pins=[pin.name for pin in pins],
        parameters=parameter_list(params),
        rings=rings,
        squares=[float(r) ** 2 for r in radii],
        force=side[0].name,
        place=side[-1].name,
    )
    return Subcircuit(name, pins, params, text)


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
        body = scene.parts[one]
        modulus = body.type.indentation_modulus(body)
        if other == sphere.name and b.radius and modulus is not None:
            yield Reach(dent(modulus, sphere.keys.mass, speed, b.radius), why)


register(Contact())
