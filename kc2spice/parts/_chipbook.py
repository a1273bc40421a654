"""Energy balance of a reduced body against its exact response to the loads of a run."""

from __future__ import annotations

import numpy as np

from kc2spice.core.waveforms import Waveforms
from kc2spice.parts.sphere import integral
from kc2spice.rom.linear import Port
from kc2spice.rom.march import chip_response
from kc2spice.rom.modal import Resonators
from kc2spice.scene.judge import Balance
from kc2spice.scene.model import Part
from kc2spice.scene.parttype import Build

STORED = 0.1  # of the stored energy: a chip rings on after a pulse at up to 30 MHz
STILL = 1e-9  # of the energy stored, far above its rounding


def port_forces(part: Part, build: Build, waves: Waveforms) -> dict[str, np.ndarray] | None:
    """Force [N] over time on every mechanical pin; None where one of them is not recorded."""
    found: dict[str, np.ndarray] = {}
    pins = part.type.pins(part, build.scene)
    mechanical = {pin.name for pin in pins if pin.unit == "um" and pin.name != "base"}
    for (name, pin), net in build.scene.nets.items():
        if name != part.name or net == "0" or pin not in mechanical:
            continue
        found[pin] = np.zeros(waves["time"].size)
        for other, theirs in build.scene.joined(part.name, pin):
            neighbour = build.scene.parts[other]
            force = neighbour.type.force_on(neighbour, theirs, build, waves)
            if force is None:
                return None
            found[pin] = found[pin] + force
    return found


def recorded(
    name: str, model: Resonators, waves: Waveforms, forces: dict[str, np.ndarray]
) -> np.ndarray:
    """Loads (n, ports) that a run put on the body: volts and newtons."""
    none = np.zeros(waves["time"].size)
    return np.column_stack(
        [
            waves[f"{terminal(name, model, p)}.voltage"]
            if p.kind == "electrical"
            else forces.get(p.name, none)
            for p in model.ports
        ]
    )


def terminal(name: str, model: Resonators, port: Port) -> str:
    """What the waves of an electrical port begin with: the part's name at the first of them."""
    first = next(p for p in model.ports if p.kind == "electrical")
    return name if port == first else f"{name}.{port.name}"


def exact_outputs(
    name: str, model: Resonators, waves: Waveforms, forces: dict[str, np.ndarray]
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """What the run has and what the body answers exactly to the run's loads, each (n,), by wave:
    displacements [m] and, where a current was recorded, charges [C]."""
    t = waves["time"]
    response = chip_response(model, t, recorded(name, model, waves, forces))
    found = {}
    for k, port in enumerate(model.ports):
        exact = response.output[:, k]
        if port.kind == "mechanical" and f"{name}.u.{port.name}" in waves:
            found[f"{name}.u.{port.name}"] = waves[f"{name}.u.{port.name}"], exact
        elif port.kind == "electrical":
            at = terminal(name, model, port)
            if f"{at}.current" in waves:
                charge = integral(waves[f"{at}.current"], t)
                found[f"charge of {at}"] = charge + exact[0], exact
    return found


def balance(
    name: str,
    model: Resonators,
    waves: Waveforms,
    forces: dict[str, np.ndarray],
    *,
    pressed: bool,
) -> Balance:
    """Work of voltage and forces on the body against its exact response to the same loads.

    What the exact response takes in and does not store is damped. The electrical part needs the
    body's current among the waveforms. The scale is the largest change of the energy stored, or of
    what rounds it where nothing moves.
    ``pressed`` judges until nothing presses on the body any more: the ringing after that is coarse.
    """
    t, loads = waves["time"], recorded(name, model, waves, forces)
    response = chip_response(model, t, loads)
    entries: dict[str, float] = {}
    gap, damped = np.zeros(t.size), response.stored[0] - response.stored
    for k, port in enumerate(model.ports):
        load, exact = loads[:, k], response.output[:, k]
        electrical = port.kind == "electrical"
        took = integral(load, exact)
        damped = damped + took
        current = f"{terminal(name, model, port)}.current" if electrical else ""
        if current in waves:
            found = integral(load * waves[current], t)
        elif electrical:
            found = took
        else:
            found = integral(load, waves[f"{name}.u.{port.name}"])
        what = "electrical work" if electrical else "work of the contact"
        entries[what] = entries.get(what, 0.0) + float(found[-1])
        gap += found - took
    entries |= {"stored": float(response.stored[-1]), "damped": float(damped[-1])}
    if pressed:
        load = np.abs(list(forces.values())).max(axis=0, initial=0.0)
        gap = gap[: int(np.flatnonzero(load > 1e-9 * load.max()).max(initial=0)) + 1]
    scale = max(float(np.ptp(response.stored)), STILL * float(response.stored.max()))
    return Balance(entries, float(np.abs(gap).max()), scale, STORED)
