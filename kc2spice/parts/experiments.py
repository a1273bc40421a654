"""Benches of the paper's static and harmonic experiments (Figs 6, 7, 8 and A1)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from kc2spice.fem.magnetics.table import EMTable
from kc2spice.parts.bench import (
    Vectors,
    assemble,
    contact,
    contact_vectors,
    frontmatter,
    loop_deck,
    need,
    ring_names,
)
from kc2spice.parts.electromagnet import catch_subcircuit
from kc2spice.rom.modal import Resonators
from kc2spice.scene.schema import Scene
from kc2spice.spice.circuit import Deck
from kc2spice.spice.header import Header
from kc2spice.spice.realize import realize
from kc2spice.spice.render import render

HEIGHTS = 2001  # at which em_force reads the lookup: five per segment


@dataclass(frozen=True)
class _Copy:
    """One chip of the harmonic bench: its loaded port, its ring nodes, the node of a force."""

    input: str
    rings: list[str]
    force: str | None


@dataclass(frozen=True)
class _Case:
    """Coil currents [A]."""

    lower: float
    upper: float


def scene_deck(
    scene: Scene,
    header: Header,
    model: Resonators | None = None,
    ring_radii: np.ndarray | None = None,
    table: EMTable | None = None,
    included: Mapping[str, str] | None = None,
) -> Deck:
    """The deck of ``scene.experiment``; parameters as in :func:`kc2spice.parts.bench.loop_deck`."""
    if scene.experiment == "imprint":
        return imprint_deck(scene, header, need(model, "kick model"), need(ring_radii, "radii"))
    if scene.experiment == "harmonic":
        return harmonic_deck(scene, header, need(model, "kick model"))
    if scene.experiment == "em_force":
        return em_force_deck(scene, header, need(table, "field table"))
    return loop_deck(scene, header, model, ring_radii, table, included)


def imprint_deck(
    scene: Scene, header: Header, model: Resonators, ring_radii: np.ndarray
) -> Deck:
    """Static contact force while the sphere is pushed in, 0 to ``imprint.depth`` (Fig. 8).

    Results ``imprint.depth`` [m], ``contact.force`` and one force per ring [N], whole device.
    """
    push = need(scene.imprint, "imprint")
    closed = need(scene.kick, "kick").electrical != "open"
    rings = ring_names(model)
    parts = [realize(model, header), contact(scene, header, rings, ring_radii)]
    vectors: Vectors = {"imprint.depth": ("v(bottom)", -1e-6), **contact_vectors(rings)}
    vectors |= {f"kick.u.{r}": (f"v({r.lower()})", 1e-6) for r in rings}
    vectors["kick.voltage"] = ("v(anode)", 1.0)
    main = render(
        "imprint.j2",
        **frontmatter(scene, header, parts, vectors),
        closed=closed,
        rings=rings,
        depth=push.depth * 1e6,
        step=push.depth * 1e6 / push.steps,
    )
    return assemble(scene, main, parts, vectors, None)


def harmonic_deck(scene: Scene, header: Header, model: Resonators) -> Deck:
    """Responses of all ports to a unit load on each (Figs 7 and A1).

    Results ``INPUT>OUTPUT``, complex over ``frequency``: displacements [m] and, of the anode,
    charge [C] per N and V, or voltage [V] per N and C where ``kick.electrical`` is ``open``.
    """
    sweep = need(scene.harmonic, "harmonic")
    is_open = need(scene.kick, "kick").electrical == "open"
    parts = [realize(model, header)]
    rings = ring_names(model)
    anode = next(p.name for p in model.ports if p.kind == "electrical")
    copies = [
        _Copy(port, [f"{r}_{port}" for r in rings], f"{port}_{port}" if port in rings else None)
        for port in (*rings, anode)
    ]
    vectors: Vectors = {}
    for copy in copies:
        for ring, node in zip(rings, copy.rings, strict=True):
            vectors[f"{copy.input}>{ring}"] = (f"v({node.lower()})", 1e-6)
        meter = "anode" if is_open else "charge"
        vectors[f"{copy.input}>{anode}"] = (f"v({meter}_{copy.input.lower()})", 1.0)
    spacing = (sweep.stop - sweep.start) / sweep.steps
    main = render(
        "harmonic.j2",
        **frontmatter(scene, header, parts, vectors),
        copies=copies,
        open=is_open,
        steps=sweep.steps,
        first=sweep.start + spacing,
        stop=sweep.stop,
    )
    return assemble(scene, main, parts, vectors, None)


def em_force_deck(scene: Scene, header: Header, table: EMTable) -> Deck:
    """Force on the sphere over its height for every pair of coil currents (Fig. 6).

    Results ``sphere.y`` [m] and ``catch.force.K`` [N], K counting the pairs of
    :func:`current_cases`.
    """
    cases = current_cases(scene)
    largest = max(abs(current) for case in cases for current in (case.lower, case.upper))
    points = need(scene.catch, "catch").points
    parts = [catch_subcircuit(header, table, largest, points=points)]
    vectors: Vectors = {"sphere.y": ("v(y)", 1e-6)}
    vectors |= {f"catch.force.{k}": (f"v(force{k})", 1.0) for k in range(len(cases))}
    low, high = 1e6 * float(table.y[0]), 1e6 * float(table.y[-1])
    main = render(
        "em_force.j2",
        **frontmatter(scene, header, parts, vectors),
        cases=cases,
        low=low,
        high=high,
        step=(high - low) / (HEIGHTS - 1),
    )
    return assemble(scene, main, parts, vectors, None)


def current_cases(scene: Scene) -> list[_Case]:
    """Every pair of the scene's currents, the lower coil's slowest."""
    currents = need(scene.em_force, "em_force").currents
    return [_Case(lower, upper) for lower in currents for upper in currents]
