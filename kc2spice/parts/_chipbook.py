"""Energy balance of a reduced body against its exact response to the loads of a run."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kc2spice.core.waveforms import Waveforms, running
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
            waves[f"{terminal(name, model.ports, p)}.voltage"]
            if p.kind == "electrical"
            else forces.get(p.name, none)
            for p in model.ports
        ]
    )


def terminal(name: str, ports: Sequence[Port], port: Port) -> str:
    """What the waves of an electrical port begin with: the part's name at the first of them."""
    first = next(p for p in ports if p.kind == "electrical")
    return name if port == first else f"{name}.{port.name}"


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
    what rounds it where nothing moves. ``pressed`` judges until nothing presses on the body any
    more, as the ringing after that is coarse; else displacements [m] and charges [C] are exact.
    """
    t, loads = waves["time"], recorded(name, model, waves, forces)
    response = chip_response(model, t, loads)
    entries: dict[str, float] = {}
    answers: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    gap, damped = np.zeros(t.size), response.stored[0] - response.stored
    for k, port in enumerate(model.ports):
        load, exact = loads[:, k], response.output[:, k]
        took = running(load, exact)
        damped = damped + took
        if port.kind == "electrical":
            what, at, found = "electrical work", terminal(name, model.ports, port), took
            current = waves.data.get(f"{at}.current")
            if current is not None:
                found = running(load * current, t)
                answers[f"charge of {at}"] = running(current, t) + exact[0], exact
        else:
            what, moved = "work of the contact", waves[f"{name}.u.{port.name}"]
            found = running(load, moved)
            answers[f"{name}.u.{port.name}"] = moved, exact
        entries[what] = entries.get(what, 0.0) + float(found[-1])
        gap += found - took
    entries |= {"stored": float(response.stored[-1]), "damped": float(damped[-1])}
    if pressed:
        load = np.abs(list(forces.values())).max(axis=0, initial=0.0)
        gap = gap[: int(np.flatnonzero(load > 1e-9 * load.max()).max(initial=0)) + 1]
    scale = max(float(np.ptp(response.stored)), STILL * float(response.stored.max()))
    known = {} if pressed else answers
    return Balance(entries, float(np.abs(gap).max()), scale, STORED, exact=known)
