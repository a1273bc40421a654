"""Energy books of a transient: what came in, what is stored, what was damped, what nobody explains.

All sums are trapezoidal over the accepted points. ngspice's own trapezoidal rule keeps the energy
of everything linear, so what a book misses was made or lost by steps too coarse for the contact,
the field or the pulse.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kc2spice.core.waveforms import Waveforms
from kc2spice.fem.magnetics.table import EMTable, force
from kc2spice.rom.modal import Resonators
from kc2spice.scene.need import need
from kc2spice.scene.schema import Scene
from kc2spice.sim.chip import chip_response


@dataclass(frozen=True)
class Book:
    """One balance: ``entries`` [J] at the end of the run, ``missing`` [J] the largest gap at any
    time, ``scale`` [J] what it is measured against."""

    entries: dict[str, float]
    missing: float
    scale: float

    @property
    def share(self) -> float:
        """``missing`` as a share of ``scale``."""
        return self.missing / self.scale if self.scale else self.missing


def sphere_book(waves: Waveforms, scene: Scene, table: EMTable | None) -> Book:
    """Work of contact, field and weight on the sphere against its kinetic energy.

    The scale is all work that was turned over, in whichever direction.
    """
    t, v, mass = waves["time"], waves["sphere.v"], need(scene.sphere, "sphere").mass
    forces = {"weight": np.full_like(t, -mass * scene.gravity)}
    if "contact.force" in waves:
        forces["contact"] = waves["contact.force"]
    if table is not None:
        zero = np.zeros_like(t)
        lower = waves.data.get("coil.lower.current", zero)
        upper = waves.data.get("coil.upper.current", zero)
        forces["field"] = force(table, waves["sphere.y"], lower, upper)
    work = {name: integral(f * v, t) for name, f in forces.items()}
    kinetic = mass * (v**2 - v[0] ** 2) / 2
    turnover = sum(float(np.trapezoid(np.abs(f * v), t)) for f in forces.values())
    entries = {f"work of the {name}": float(w[-1]) for name, w in work.items()}
    gap = kinetic - sum(work.values())
    return Book(entries | {"kinetic": float(kinetic[-1])}, abs(float(gap[-1])), turnover)


def contact_book(waves: Waveforms, scene: Scene) -> Book:
    """Work that closes the contact springs against what they store, ``F^2 / (2 eps)`` each.

    Springs give back all they took: energy gained here is a bounce higher than the last. The scale
    is the work that went into the springs.
    """
    stiffness = 4 * need(scene.contact, "contact").penalty
    y, missing, turnover, stored = waves["sphere.y"], np.zeros(waves["time"].size), 0.0, 0.0
    for ring in contact_rings(waves):
        f = waves[f"contact.force.{ring}"]
        closing = integral(f, waves[f"kick.u.{ring}"] - y)
        energy = (f**2 - f[0] ** 2) / (2 * stiffness)
        missing += closing - energy
        turnover += float(np.abs(np.diff(energy)).sum())
        stored += float(energy[-1])
    net = float(np.abs(missing).max())
    kinetic = need(scene.sphere, "sphere").mass * float((waves["sphere.v"] ** 2).max()) / 2
    return Book({"stored in the contact": stored}, net, max(turnover, kinetic))


def chip_book(waves: Waveforms, model: Resonators) -> Book:
    """Work of voltage and contact on the chip against its exact response to the same loads.

    What the exact response (:mod:`kc2spice.sim.chip`) takes in and does not store is damped. The
    electrical part needs the chip's current among the waveforms. The scale is the largest energy
    stored at any time.
    """
    t = waves["time"]
    loads = chip_loads(waves, model)
    response = chip_response(model, t, loads)
    entries: dict[str, float] = {}
    gap, damped = np.zeros(t.size), response.stored[0] - response.stored
    for k, port in enumerate(model.ports):
        load, exact = loads[:, k], response.output[:, k]
        electrical = port.kind == "electrical"
        took = integral(load, exact)
        damped = damped + took
        if electrical and "kick.current" in waves:
            found = integral(load * waves["kick.current"], t)
        elif electrical:
            found = took
        else:
            found = integral(load, waves[f"kick.u.{port.name}"])
        what = "electrical work" if electrical else "work of the contact"
        entries[what] = entries.get(what, 0.0) + float(found[-1])
        gap += found - took
    entries |= {"stored": float(response.stored[-1]), "damped": float(damped[-1])}
    scale = float(np.ptp(response.stored))
    return Book(entries, float(np.abs(gap).max()), scale)


def chip_loads(waves: Waveforms, model: Resonators) -> np.ndarray:
    """Loads on the model's ports (n, ports): contact presses the rings down, the anode has a
    voltage."""
    none = np.zeros(waves["time"].size)
    columns = [
        waves["kick.voltage"]
        if port.kind == "electrical"
        else -waves.data.get(f"contact.force.{port.name}", none)
        for port in model.ports
    ]
    return np.column_stack(columns)


def contact_rings(waves: Waveforms) -> list[str]:
    """Rings with a recorded contact force, R0 first."""
    prefix = "contact.force.R"
    numbers = sorted(int(k.removeprefix(prefix)) for k in waves.data if k.startswith(prefix))
    return [f"R{number}" for number in numbers]


def integral(values: np.ndarray, over: np.ndarray) -> np.ndarray:
    """Running trapezoidal integral of ``values`` d ``over``, zero at the first point."""
    steps = (values[1:] + values[:-1]) / 2 * np.diff(over)
    return np.concatenate([[0.0], np.cumsum(steps)])
