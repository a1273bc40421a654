"""Contact transients of the full model in the shape of every other road's waveforms."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from kc2spice.core.waveforms import Waveforms
from kc2spice.fem.piezo.assembly import assemble_kick
from kc2spice.fem.piezo.contact import contact_surface
from kc2spice.fem.piezo.mesh import kick_mesh
from kc2spice.fem.piezo.system import PiezoSystem
from kc2spice.fem.piezo.transient import Ball, Road, TransientResult, Voltage, transient
from kc2spice.scene.need import need
from kc2spice.scene.schema import Scene


@dataclass(frozen=True)
class FullRun:
    """A converged transient: Richardson's limit of two step sizes, and what the finer one took."""

    waves: Waveforms
    step: float
    wall_s: float


def full_system(scene: Scene) -> PiezoSystem:
    """The full model of the scene's chip."""
    kick = need(scene.kick, "kick")
    return assemble_kick(kick, kick_mesh(kick))


def full_transient(
    scene: Scene,
    system: PiezoSystem,
    ball: Ball,
    *,
    step: float,
    stop: float,
    voltage: Voltage | None,
    resting: bool = False,
    road: Road = "low_rank",
    progress: Callable[[float], None] | None = None,
) -> TransientResult:
    """Transient of one sector with the grouped contact springs of the scene."""
    surface = contact_surface(
        need(scene.kick, "kick"), need(scene.contact, "contact"), need(scene.sphere, "sphere")
    )
    return transient(
        system, surface, ball, step=step, stop=stop, voltage=voltage, resting=resting, road=road,
        progress=progress,
    )  # fmt: skip


def converged(
    coarse: TransientResult, fine: TransientResult, radius: float, sectors: int
) -> FullRun:
    """Richardson's limit of average acceleration (second order) from steps 2 h and h."""
    ours, theirs = (as_waveforms(result, radius, sectors).data for result in (coarse, fine))
    data = {name: theirs[name][::2] + (theirs[name][::2] - ours[name]) / 3 for name in ours}
    data["time"] = ours["time"]
    for name in data:
        if name.startswith("contact.force"):
            # Extrapolation would leave false load where one step size has just lost contact.
            data[name] = theirs[name][::2]
    return FullRun(Waveforms(data, {}), float(np.diff(fine.time[:2])[0]), fine.wall_s)


def as_waveforms(result: TransientResult, radius: float, sectors: int) -> Waveforms:
    """Whole-device waveforms of a sector's transient; ``radius`` [m] of the sphere."""
    forces = sectors * result.ring_force
    data = {
        "time": result.time,
        "sphere.y": result.height + radius,
        "sphere.v": result.velocity,
        "contact.force": forces.sum(axis=1),
    }
    for k in range(forces.shape[1]):
        data[f"contact.force.R{k}"] = forces[:, k]
        data[f"kick.u.R{k}"] = result.spring_displacement[:, k]
    return Waveforms(data, {})
