"""A device small enough for fast tests, made from formulas: no FE, no reduction."""

from dataclasses import replace
from typing import Any

import numpy as np
from support import (
    BuiltScene,
    Certificate,
    Deck,
    MagnetostaticTable,
    Port,
    Resonators,
    StageTimer,
    add_results_and_sources,
    build_models,
    choose_largest_step,
    form_verdict,
    ignore_progress,
    load_scene,
    make_deck,
    name_subcircuits,
    run_deck,
    solve_laws,
)

RADII = 50e-6 * np.arange(6)


def chip(modes=30, damping=0.01):
    """Modes from 270 kHz to 30 MHz with the chip's stroke, capacitance and compliances."""
    rng = np.random.default_rng(1)
    omega = 2 * np.pi * np.geomspace(270e3, 30e6, modes)
    gain = np.zeros((modes, 7))
    gain[0, :6] = 120.0  # the piston mode moves all rings alike
    gain[0, 6] = 2.35e-8 * omega[0] ** 2 / 120.0  # 2.35 um per 100 V
    for ring in range(6):
        share = rng.normal(size=modes - 1) * 0.5 + 0.5
        compliance = 2e-7 / (1 + ring)
        gain[1:, ring] = omega[1:] * np.sqrt(compliance) * share / np.linalg.norm(share)
    gain[1:, 6] = omega[1:] * 6e-6 * rng.normal(size=modes - 1)
    ports = tuple(Port(f"ring{i}", "mechanical", "um", "N") for i in range(6))
    return Resonators(
        omega,
        2 * damping / (2 * np.pi * 250e3) * omega**2,
        gain,
        np.diag([0.0] * 6 + [34.87e-9]),
        (*ports, Port("anode", "electrical", pins=("anode", "cathode"))),
        Certificate((0.0, 500e3), 1e-3, "made up", True, True),
    )


def magnets():
    """Two coils around 1 and 4 mm, 0.65 N/A together in the middle, a small magnet force."""
    y = np.linspace(-2.5e-3, 7.5e-3, 41)

    def coil(u):
        return -u / 1.5e-3 / (1 + (u / 2.5e-3) ** 2) ** 2.5

    scale = 0.325 / abs(coil(np.array(1.5e-3)))
    sizes = np.array([1e-4, scale, scale, 0.01, 0.0, 0.01])
    heights = np.array([2.5e-3, 1e-3, 4e-3, 1e-3, 0.0, 4e-3])
    return MagnetostaticTable(
        y=y, coefficients=sizes * coil(y[:, None] - heights), flux0=np.zeros((41, 2)),
        inductance=np.tile([[0.044, 0.007], [0.007, 0.044]], (41, 1, 1)),
        resistance=np.array([1596.0, 1596.0]), unknowns=0,
    )  # fmt: skip


def built(scene, model=None, table=None, others=False, **words):
    """The scene with made-up models: those ports of ``model`` that it needs, and ``table``.

    With ``others``, the parts without these have their real models. ``words`` are further fields of
    the build, such as ``trust``.
    """
    models: dict[str, Any] = {}
    for part in scene.parts.values():
        if part.type.name == "piezo_stack" and model is not None:
            kept = [port.name for port in part.type.used_ports(part, scene)]
            models[part.name] = model.to_linear_model().select(kept)
        if part.type.name == "ring_magnet_coils" and table is not None:
            models[part.name] = table
        if others and part.name not in models:
            models[part.name] = part.type.build(part, scene, StageTimer(ignore_progress))
    result = add_results_and_sources(BuiltScene(scene, models, name_subcircuits(scene), **words))
    timed = scene.analysis.type == "transient"
    return replace(result, largest_step=choose_largest_step(result)) if timed else result


def models(scene, *sets):
    """A scene, by its name, file or tables, with what its parts are made of."""
    return build_models(load_scene(scene, list(sets)), StageTimer(ignore_progress))


def both(scene, folder):
    """Waves of ngspice and of the independent integrator for a scene, and its failed checks."""
    build = models(scene)
    waves = run_deck(make_deck(build), folder)
    failed = [check for check in form_verdict(waves, build).checks if not check.passed]
    return waves, solve_laws(build, waves).results, failed


def deck_of(scene, model=None, table=None):
    """The testbench of a scene with made-up models."""
    return make_deck(built(scene, model, table))


def bench(parts, cards, vectors, stop=None):
    """A deck by hand around subcircuits."""
    text = "* bench\n" + "".join(f".include {p.filename}\n" for p in parts) + cards + "\n"
    text += "\n".join(f".save {v}" for n, _ in vectors.values() for v in n.split("+")) + "\n.end\n"
    more = {p.filename: p.text for p in parts}
    return Deck(name="bench", text=text, more=more, vectors=vectors, stop=stop)
