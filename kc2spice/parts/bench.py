"""Testbenches: a scene's parts wired to each other, with analysis, options and result names."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from kc2spice.errors import UsageError
from kc2spice.fem.emtable import EMTable
from kc2spice.netlist.cards import name, number
from kc2spice.netlist.circuit import Deck, Subcircuit
from kc2spice.netlist.header import Header
from kc2spice.netlist.realize import realize
from kc2spice.netlist.render import render
from kc2spice.parts.contact import contact_subcircuit, ring_gaps
from kc2spice.parts.electromagnet import catch_subcircuit
from kc2spice.parts.opamp import opamp_subcircuit
from kc2spice.parts.pid import SENSOR, pid_subcircuit
from kc2spice.parts.sphere import sphere_subcircuit
from kc2spice.rom.model import ResonatorModel
from kc2spice.scene.schema import Scene, Solver

QUARTERS = 4  # the finite-element model is one symmetry sector of this many

T = TypeVar("T")
Vectors = dict[str, tuple[str, float]]


@dataclass(frozen=True)
class Option:
    """One ``.options`` card and why it is there."""

    text: str
    reason: str


@dataclass(frozen=True)
class _Pulse:
    voltage: float
    start: float
    edge: float
    flat: float


def transient_options(solver: Solver) -> list[Option]:
    """Simulator settings of a transient run, each with its reason."""
    return [
        Option(f"reltol={number(solver.reltol)}", "error per step; decides the launch velocity"),
        Option("trtol=1", "trust the error estimate: contact needs every step it asks for"),
        Option("chgtol=1e-08", "C on 1 uF, thus 0.01 um: displacement error that a step may make"),
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
) -> Deck:
    """Transient deck of kick, contact, sphere, catch and controller, as far as the scene has them.

    Parameters
    ----------
    model : resonators of the *whole device*; needed where the scene has a kick.
    ring_radii : radii [m] of the model's rings, R0 (the centre) first.
    table : force of the catch; needed where the scene has a catch.

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
    if scene.catch:
        current = scene.control.current_limit if scene.control else 0.0
        parts.append(catch_subcircuit(header, need(table, "field table"), current))
    if scene.catch and scene.control:
        parts += [opamp_subcircuit(header), pid_subcircuit(header, scene.control)]
    vectors = _vectors(scene, rings)
    main = render(
        "loop.j2",
        **frontmatter(scene, header, parts, vectors),
        kick=scene.kick,
        drive=_pulse(scene),
        shorted=scene.kick is not None and scene.kick.electrical == "short",
        rings=rings,
        sphere=scene.sphere,
        contact=scene.contact,
        catch=scene.catch,
        control=scene.control,
        options=transient_options(scene.solver),
        print_step=min(scene.solver.max_step, scene.solver.stop / 1000),
        stop=scene.solver.stop,
        max_step=scene.solver.max_step,
        uic=scene.impact is not None,
    )
    return assemble(scene, main, parts, vectors, scene.solver.stop)


def frontmatter(
    scene: Scene, header: Header, parts: list[Subcircuit], vectors: Vectors
) -> dict[str, object]:
    """What every bench template has at its head and foot."""
    return {
        "title": f"{scene.name}: {scene.title}",
        "origin": header.origin(),
        "name": name(scene.name),
        "libraries": [part.filename for part in parts],
        "saved": list(dict.fromkeys(v for names, _ in vectors.values() for v in names.split("+"))),
    }


def assemble(
    scene: Scene, main: str, parts: list[Subcircuit], vectors: Vectors, stop: float | None
) -> Deck:
    """The bench and its libraries as one deck."""
    filename = f"{scene.name}.cir"
    files = {filename: main} | {part.filename: part.text for part in parts}
    return Deck(scene.name, filename, files, vectors, stop)


def ring_names(model: ResonatorModel) -> tuple[str, ...]:
    """Pins of the model's mechanical ports."""
    return tuple(p.name for p in model.ports if p.kind == "mechanical")


def contact(
    scene: Scene, header: Header, rings: tuple[str, ...], ring_radii: np.ndarray
) -> Subcircuit:
    """Contact of the scene's sphere with whole rings."""
    gaps = ring_gaps(ring_radii, need(scene.sphere, "sphere").radius)
    return contact_subcircuit(
        header, rings, gaps, QUARTERS * need(scene.contact, "contact").penalty
    )


def contact_vectors(rings: tuple[str, ...]) -> Vectors:
    """Contact force of every ring and their sum, of an instance ``Xcontact``."""
    forces = {f"contact.force.{r}": f"@b.xcontact.b{r.lower()}[i]" for r in rings}
    return {"contact.force": ("+".join(forces.values()), 1.0)} | {
        key: (vector, 1.0) for key, vector in forces.items()
    }


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


def _vectors(scene: Scene, rings: tuple[str, ...]) -> Vectors:
    """Result names to ngspice vectors (``a+b`` is their sum) and the factor to SI."""
    vectors: Vectors = {}
    if scene.sphere:
        vectors |= {"sphere.y": ("v(y)", 1e-6), "sphere.v": ("v(v)", 1.0)}
    if scene.sphere and scene.contact:
        vectors |= contact_vectors(rings)
    if scene.kick:
        vectors |= {f"kick.u.{r}": (f"v({r.lower()})", 1e-6) for r in rings}
        vectors["kick.voltage"] = ("v(anode)", 1.0)
        if scene.kick.electrical != "open":
            vectors["kick.current"] = ("i(vkick)", -1.0)
    if scene.catch and scene.control:
        vectors["coil.lower.current"] = ("v(xcatch.i1)", 1.0)
        vectors["coil.upper.current"] = ("v(xcatch.i2)", 1.0)
        vectors["control.error"] = ("v(xpid.e)", 1.0 / SENSOR)
    return vectors
