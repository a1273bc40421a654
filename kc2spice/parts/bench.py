"""Testbenches: a scene's parts wired to each other, with analysis, options and result names."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kc2spice.fem.emtable import EMTable
from kc2spice.netlist.cards import number
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


def options(solver: Solver) -> list[Option]:
    """Simulator settings of a transient run, each with its reason."""
    return [
        Option(f"reltol={number(solver.reltol)}", "error per step; decides the launch velocity"),
        Option("trtol=1", "trust the error estimate: contact needs every step it asks for"),
        Option("chgtol=1e-10", "C on 1 uF, thus 1e-4 um: the displacement that does not matter"),
        Option(f"method={solver.method}", "of integration"),
        Option("acct", "print accepted and rejected steps, iterations and time"),
    ]


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
    """
    parts = _parts(scene, header, model, ring_radii, table)
    rings = _rings(model) if scene.kick else ()
    vectors = _vectors(scene, rings)
    impact = scene.impact is not None
    main = render(
        "loop.j2",
        title=f"{scene.name}: {scene.title}",
        origin=header.origin(),
        name=scene.name,
        libraries=[part.filename for part in parts],
        kick=scene.kick,
        drive=_pulse(scene),
        shorted=scene.kick is not None and scene.kick.electrical == "short",
        rings=rings,
        sphere=scene.sphere,
        contact=scene.contact,
        catch=scene.catch,
        control=scene.control,
        options=options(scene.solver),
        print_step=min(scene.solver.max_step, scene.solver.stop / 1000),
        stop=scene.solver.stop,
        max_step=scene.solver.max_step,
        uic=impact,
        saved=dict.fromkeys(v for vector, _ in vectors.values() for v in vector.split("+")),
    )
    filename = f"{scene.name}.cir"
    files = {filename: main} | {part.filename: part.text for part in parts}
    return Deck(scene.name, filename, files, vectors, scene.solver.stop)


def _rings(model: ResonatorModel) -> tuple[str, ...]:
    return tuple(p.name for p in model.ports if p.kind == "mechanical")


def _pulse(scene: Scene) -> _Pulse | None:
    """The kick's PULSE: ``width`` is measured at half height, so the flat top lasts width - edge."""
    if scene.kick is None or scene.kick.electrical != "driven":
        return None
    d = scene.kick.drive
    return _Pulse(d.voltage, d.start, d.edge, d.width - d.edge)


def _parts(
    scene: Scene,
    header: Header,
    model: ResonatorModel | None,
    ring_radii: np.ndarray | None,
    table: EMTable | None,
) -> list[Subcircuit]:
    """The libraries that the deck includes: nothing that the scene does not have."""
    parts = []
    if scene.kick:
        parts.append(realize(model, header))
    if scene.sphere:
        impact = scene.impact
        parts.append(
            sphere_subcircuit(
                header,
                scene.sphere.mass,
                scene.sphere.radius,
                scene.gravity,
                velocity=impact.velocity if impact else 0.0,
                height=impact.gap if impact else 0.0,
            )
        )
        if scene.contact:
            gaps = ring_gaps(ring_radii, scene.sphere.radius)
            eps = QUARTERS * scene.contact.penalty
            parts.append(contact_subcircuit(header, _rings(model), gaps, eps))
    if scene.catch:
        limit = scene.control.current_limit if scene.control else 0.0
        parts.append(catch_subcircuit(header, table, limit))
        if scene.control:
            parts.append(opamp_subcircuit(header))
            parts.append(pid_subcircuit(header, scene.control))
    return parts


def _vectors(scene: Scene, rings: tuple[str, ...]) -> dict[str, tuple[str, float]]:
    """Result names to ngspice vectors (``a+b`` is their sum) and the factor to SI."""
    vectors: dict[str, tuple[str, float]] = {}
    if scene.sphere:
        vectors["sphere.y"] = ("v(y)", 1e-6)
        vectors["sphere.v"] = ("v(v)", 1.0)
        if scene.contact:
            forces = {f"contact.force.{r}": f"@b.xcontact.b{r.lower()}[i]" for r in rings}
            vectors["contact.force"] = ("+".join(forces.values()), 1.0)
            vectors |= {key: (vector, 1.0) for key, vector in forces.items()}
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
