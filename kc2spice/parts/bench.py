"""Testbenches: a scene's parts wired to each other, with analysis, options and result names."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from kc2spice.core.errors import UsageError
from kc2spice.fem.magnetics.table import EMTable
from kc2spice.parts.coil import coil_subcircuit
from kc2spice.parts.contact import contact_subcircuit
from kc2spice.parts.drivers import Driver, coil_driver, coil_load, kick_driver
from kc2spice.parts.electromagnet import catch_subcircuit
from kc2spice.parts.pid import SENSE, SENSOR, pid_subcircuit
from kc2spice.parts.sphere import sphere_subcircuit
from kc2spice.rom.model import ResonatorModel
from kc2spice.scene.plan import plan
from kc2spice.scene.rings import ring_gaps
from kc2spice.scene.schema import Scene, Solver
from kc2spice.spice.cards import name, number
from kc2spice.spice.circuit import Deck, Subcircuit
from kc2spice.spice.header import Header, plan_lines
from kc2spice.spice.realize import realize
from kc2spice.spice.render import render

QUARTERS = 4  # the finite-element model is one symmetry sector of this many

T = TypeVar("T")
Vectors = dict[str, tuple[str, float]]


@dataclass(frozen=True)
class Option:
    """One ``.options`` card and why it is there."""

    text: str
    reason: str


@dataclass(frozen=True)
class Sampled:
    """A controller outside of ngspice that sees the loop every ``period`` [s], first at zero.

    Its answer is held from ``delay`` [s] later on. ngspice gets a time point at both instants.
    """

    period: float
    delay: float


@dataclass(frozen=True)
class _Pulse:
    voltage: float
    start: float
    edge: float
    flat: float


def _speed(scene: Scene) -> float:
    """Speed [m/s] at which an impact begins, at least 1 mm/s; 1 m/s for a kick."""
    if (throw := scene.impact) is None:
        return 1.0
    return max(1e-3, math.sqrt(throw.velocity**2 + 2.0 * max(scene.gravity, 0.0) * throw.gap))


def transient_options(solver: Solver, speed: float = 1.0) -> list[Option]:
    """Simulator settings of a transient run, each with its reason.

    Displacements shrink with the ``speed`` [m/s] of an impact, and so does what a step may miss.
    """
    chgtol = solver.chgtol * min(1.0, speed)
    return [
        Option(f"reltol={number(solver.reltol)}", "error per step; decides the launch velocity"),
        Option("trtol=1", "trust the error estimate: contact needs every step it asks for"),
        Option(
            f"chgtol={number(chgtol)}",
            f"C on 1 uF, thus {1e6 * chgtol:g} um: displacement error of a step",
        ),
        Option(f"method={solver.method}", "of integration"),
        Option("acct", "print accepted and rejected steps, iterations and time"),
    ]


def need(value: T | None, what: str) -> T:
    """``value``, which the scene or its models must have for this bench."""
    if value is None:
        raise UsageError("the scene's netlist needs more than it has", got=f"no {what}")
    return value


def loop_deck(
    scene: Scene,
    header: Header,
    model: ResonatorModel | None = None,
    ring_radii: np.ndarray | None = None,
    table: EMTable | None = None,
    included: Mapping[str, str] | None = None,
    sampled: Sampled | None = None,
) -> Deck:
    """Transient deck of kick, contact, sphere, catch and controller, as far as the scene has them.

    Parameters
    ----------
    model : resonators of the *whole device*; needed where the scene has a kick.
    ring_radii : radii [m] of the model's rings, R0 (the centre) first.
    table : force of the catch; needed where the scene has a catch.
    included : text of the scene's ``netlists`` and of what they include, by file name.
    sampled : a function outside of ngspice sets ``Vexternal``, 100 V per ampere of coil current;
        the deck has no controller of its own and runs in the shared engine only.

    Raises
    ------
    UsageError : the scene has a part whose model is not given.
    """
    parts: list[Subcircuit] = []
    rings: tuple[str, ...] = ()
    if scene.kick:
        parts.append(realize(need(model, "kick model"), header))
        rings = ring_names(need(model, "kick model"))
    if scene.sphere:
        parts.append(_sphere(scene, header))
    if scene.sphere and scene.contact:
        parts.append(contact(scene, header, rings, need(ring_radii, "ring radii")))
    drivers = _drivers(scene, header, table)
    if scene.catch and drivers.coil:
        table = need(table, "field table")
        parts.append(coil_subcircuit(header, table, points=scene.catch.points))
    elif scene.catch:
        current = scene.control.current_limit if scene.control else 0.0
        table, points = need(table, "field table"), scene.catch.points
        parts.append(catch_subcircuit(header, table, current, series=True, points=points))
    if scene.catch and scene.control and not sampled:
        parts.append(pid_subcircuit(header, scene.control, output=drivers.coil is None))
    parts += [part for part in drivers.parts() if part.name not in {p.name for p in parts}]
    vectors = _vectors(scene, rings, drivers, sampled is not None)
    main = render(
        "loop.j2",
        **frontmatter(scene, header, parts, vectors, included=bool(included)),
        kick=scene.kick,
        kick_driver=drivers.kick,
        coil_driver=drivers.coil,
        sampled=sampled,
        cathode="cathode" if drivers.floating else "0",
        drive=_pulse(scene),
        shorted=scene.kick is not None and scene.kick.electrical == "short",
        rings=rings,
        sphere=scene.sphere,
        contact=scene.contact,
        catch=scene.catch,
        control=scene.control,
        options=transient_options(scene.solver, _speed(scene)),
        print_step=min(scene.solver.max_step, scene.solver.stop / 1000),
        stop=scene.solver.stop,
        max_step=scene.solver.max_step,
        uic=scene.impact is not None,
    )
    deck = assemble(scene, main, parts, vectors, scene.solver.stop)
    return with_included(deck, included or {})


def with_included(deck: Deck, included: Mapping[str, str]) -> Deck:
    """``deck`` with the user's files beside its own.

    Raises
    ------
    UsageError : a file of the user has the name of one of the deck's.
    """
    for file in included:
        if file.lower() in {own.lower() for own in deck.files}:
            hint = "rename the included file"
            raise UsageError("a library of the scene has this name", where=file, hint=hint)
    return replace(deck, files=deck.files | dict(included))


def frontmatter(
    scene: Scene,
    header: Header,
    parts: list[Subcircuit],
    vectors: Vectors,
    *,
    included: bool = False,
) -> dict[str, object]:
    """What every bench template has at its head and foot."""
    return {
        "title": f"{scene.name}: {scene.title}",
        "origin": f"{header.origin()}\n{plan_lines(plan(scene))}",
        "name": name(scene.name),
        "libraries": [part.filename for part in parts]
        + [path.name for path in scene.netlists if included],
        "saved": list(dict.fromkeys(v for names, _ in vectors.values() for v in names.split("+"))),
    }


def assemble(
    scene: Scene, main: str, parts: list[Subcircuit], vectors: Vectors, stop: float | None
) -> Deck:
    """The bench and its libraries as one deck."""
    filename = f"{scene.name}.cir"
    files = {filename: main} | {part.filename: part.text for part in parts}
    return Deck(scene.name, filename, files, vectors, stop, tuple(parts))


def ring_names(model: ResonatorModel) -> tuple[str, ...]:
    """Pins of the model's mechanical ports."""
    return tuple(p.name for p in model.ports if p.kind == "mechanical")


def contact(
    scene: Scene, header: Header, rings: tuple[str, ...], ring_radii: np.ndarray
) -> Subcircuit:
    """Contact of the scene's sphere with whole rings."""
    radius = need(scene.sphere, "sphere").radius
    return contact_subcircuit(
        header,
        rings,
        ring_gaps(ring_radii, radius),
        QUARTERS * need(scene.contact, "contact").penalty,
        under=(radius, ring_radii),
    )


def contact_vectors(rings: tuple[str, ...]) -> Vectors:
    """Contact force of every ring and their sum, of an instance ``Xcontact``."""
    forces = {f"contact.force.{r}": f"@b.xcontact.b{r.lower()}[i]" for r in rings}
    return {"contact.force": ("+".join(forces.values()), 1.0)} | {
        key: (vector, 1.0) for key, vector in forces.items()
    }


@dataclass(frozen=True)
class _Drivers:
    """The electronics that a loop has; None where ideal sources drive."""

    kick: Driver | None
    coil: Driver | None
    floating: bool  # is the chip's cathode not at ground?

    def parts(self) -> list[Subcircuit]:
        found = {p.name: p for driver in (self.kick, self.coil) if driver for p in driver.parts}
        return list(found.values())


def _drivers(scene: Scene, header: Header, table: EMTable | None) -> _Drivers:
    kick = coil = None
    if scene.kick and scene.kick.driver:
        kick = kick_driver(header, scene.kick.driver)
    if scene.catch and scene.catch.driver:
        control = need(scene.control, "control")
        load = coil_load(need(table, "field table"), control.setpoint)
        coil = coil_driver(header, scene.catch.driver, load, control.current_limit)
    return _Drivers(kick, coil, kick is not None and "cathode" in kick.nodes)


def _sphere(scene: Scene, header: Header) -> Subcircuit:
    sphere, impact = need(scene.sphere, "sphere"), scene.impact
    return sphere_subcircuit(
        header,
        sphere.mass,
        sphere.radius,
        scene.gravity,
        velocity=impact.velocity if impact else 0.0,
        height=impact.gap if impact else 0.0,
    )


def _pulse(scene: Scene) -> _Pulse | None:
    """The kick's PULSE; ``width`` is measured at half height, the flat top lasts width - edge."""
    if scene.kick is None or scene.kick.electrical != "driven":
        return None
    d = scene.kick.drive
    return _Pulse(d.voltage, d.start, d.edge, d.width - d.edge)


def _vectors(scene: Scene, rings: tuple[str, ...], drivers: _Drivers, sampled: bool) -> Vectors:
    """Result names to ngspice vectors (``a+b`` is their sum) and the factor to SI."""
    vectors: Vectors = {}
    if scene.sphere:
        vectors |= {"sphere.y": ("v(y)", 1e-6), "sphere.v": ("v(v)", 1.0)}
    if scene.sphere and scene.contact:
        vectors |= contact_vectors(rings)
    if scene.kick:
        vectors |= {f"kick.u.{r}": (f"v({r.lower()})", 1e-6) for r in rings}
        vectors["kick.voltage"] = ("v(voltage)" if drivers.kick else "v(anode)", 1.0)
        if drivers.kick and drivers.kick.known:
            vectors["kick.current"] = ("@r.xkickdriver.rout[i]", 1.0)
        elif not drivers.kick and scene.kick.electrical != "open":
            vectors["kick.current"] = ("i(vkick)", -1.0)
    if scene.catch and scene.control:
        lower, upper = ("i1", "i2") if drivers.coil else ("i", "i")
        vectors["coil.lower.current"] = (f"v(xcatch.{lower})", 1.0 if drivers.coil else -1.0)
        vectors["coil.upper.current"] = (f"v(xcatch.{upper})", 1.0)
        if not sampled:
            vectors["control.error"] = ("v(xpid.e)", 1.0 / SENSOR)
    if drivers.coil:
        vectors["coil.voltage"] = ("v(terminals)", 1.0)
    if drivers.coil or sampled:
        vectors["coil.wanted"] = ("v(wanted)", 1.0 / SENSE)
    return vectors
