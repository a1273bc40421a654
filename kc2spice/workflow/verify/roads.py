"""The three roads of a contact transient, each timed: full model, scipy and ngspice."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from kc2spice.core.progress import Clock
from kc2spice.core.waveforms import Waveforms
from kc2spice.fem.piezo.system import PiezoSystem
from kc2spice.fem.piezo.transient import Ball, TransientResult, Voltage
from kc2spice.reference import Reference
from kc2spice.report.distance import compare
from kc2spice.report.verdict import Check, OutputError
from kc2spice.scene.need import need
from kc2spice.scene.schema import Scene
from kc2spice.sim.ngspice import find_ngspice, run_deck
from kc2spice.workflow.decks import make_deck
from kc2spice.workflow.models import Models
from kc2spice.workflow.verify.fullmodel import FullRun, converged, full_transient

FULL_STEP = 10e-9  # finer of the two steps whose limit counts as converged [s]

Pairs = Mapping[str, Mapping[str, float | None]]


def full_road(
    scene: Scene,
    system: PiezoSystem,
    ball: Ball,
    stop: float,
    voltage: Voltage | None,
    clock: Clock,
    *,
    resting: bool = False,
) -> FullRun:
    """Full model at two step sizes, one factorisation each, contact as a low-rank update."""

    def run(step: float) -> TransientResult:
        with clock.stage("full model", f"steps of {step * 1e9:g} ns") as share:
            return full_transient(
                scene, system, ball, step=step, stop=stop, voltage=voltage, resting=resting,
                progress=share,
            )  # fmt: skip

    coarse, fine = run(2 * FULL_STEP), run(FULL_STEP)
    return converged(coarse, fine, need(scene.sphere, "sphere").radius, system.sectors)


def scipy_road(integrate: Callable[[], Reference], clock: Clock) -> tuple[Reference, float]:
    """The reduced model with located events; returns the reference and its wall time."""
    start = time.perf_counter()
    with clock.stage("scipy", "reduced model, events located"):
        result = integrate()
    return result, time.perf_counter() - start


def ngspice_road(scene: Scene, models: Models, clock: Clock, work: Path) -> tuple[Waveforms, float]:
    """The emitted netlist in ngspice; returns waveforms and wall time with start-up."""
    simulator = find_ngspice()
    deck = make_deck(scene, models)
    start = time.perf_counter()
    with clock.stage("simulate", f"{simulator.name} {simulator.version}") as share:
        waves = run_deck(deck, work, progress=share)
    return waves, time.perf_counter() - start


def compared(fom: Waveforms, rom: Waveforms, netlist: Waveforms) -> Pairs:
    """Each road against each more exact one."""
    return {
        "rom_vs_fom": compare(rom, fom),
        "ngspice_vs_rom": compare(netlist, rom),
        "ngspice_vs_fom": compare(netlist, fom),
    }


def gated(name: str, pairs: Pairs, key: str, limit: float, unit: str = "1") -> list[Check]:
    """One check per pair of roads."""
    words = {"rom_vs_fom": "ROM to FOM", "ngspice_vs_rom": "ngspice to ROM"}
    return [
        Check(f"{name}, {words.get(pair, 'ngspice to FOM')}", errors[key], limit, unit)
        for pair, errors in pairs.items()
    ]


def contact_energy(waves: Waveforms, scene: Scene) -> float:
    """Part of the sphere's kinetic energy that the contact's books cannot account for.

    Over the whole run the sphere's kinetic and potential energy must have gone into the work of
    the contact forces on the rings' displacements and into the springs,

        m (v0^2 - v^2) / 2 + m g (y0 - y) = sum_k int F_k (-du_k) + F_k^2 / (2 eps),

    integrated over the run's own points by the trapezoidal rule.
    """
    sphere, contact = need(scene.sphere, "sphere"), need(scene.contact, "contact")
    v, y = waves["sphere.v"], waves["sphere.y"]
    kinetic = sphere.mass * (v[0] ** 2 - v[-1] ** 2) / 2
    weight = sphere.mass * scene.gravity * (y[0] - y[-1])
    spent = 0.0
    rings = [key.rpartition(".")[2] for key in waves.data if key.startswith("contact.force.")]
    for ring in rings:
        force, u = waves[f"contact.force.{ring}"], waves[f"kick.u.{ring}"]
        spent -= float(np.trapezoid(force, u))
        spent += float(force[-1] ** 2 - force[0] ** 2) / (2 * 4 * contact.penalty)
    scale = sphere.mass * float((v**2).max()) / 2
    return abs(kinetic + weight - spent) / scale


def output_errors(
    pair: str, waves: Waveforms, against: Waveforms, *prefixes: str
) -> list[OutputError]:
    """Errors of the outputs that both roads have and whose names start with one of ``prefixes``.

    Differences are taken at the points of ``against``, relative to its largest value; an output
    that never moves is left out.
    """
    found = []
    for name in sorted(set(waves.data) & set(against.data)):
        exact = against[name]
        if not name.startswith(prefixes) or not np.ptp(exact):
            continue
        ours = waves[name]
        if "time" in waves:
            ours = np.interp(against["time"], waves["time"], ours)
        error = np.abs(ours - exact) / np.abs(exact).max()
        found.append(OutputError(pair, name, float(error.max()), float(np.sqrt(np.mean(error**2)))))
    return found
