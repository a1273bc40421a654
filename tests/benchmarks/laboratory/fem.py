"""Plane ``fem``: finite elements and reduction of the chip, each mesh in a process of its own."""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import time

import numpy as np

from kc2spice.bodies.piezo_stack import from_sector
from kc2spice.core.errors import SimulationError
from kc2spice.rom.reduce import reduce
from kc2spice.scene.load import load_scene
from laboratory.fullmodel import full_system
from laboratory.points import Outcome, Plane, Point, Scaling, Timing
from laboratory.setup import Setup

# In-plane cells: sectors of the quarter circle, rings from the contact to the edge.
MESHES = ((6, 6), (10, 11), (14, 16), (20, 24), (24, 30))
COARSE = ((2, 2), (4, 3))


def fem(setup: Setup) -> Outcome:
    """Error of the first resonance against the finest mesh, time and memory to the ROM."""
    meshes = COARSE if setup.quick else MESHES
    found = []
    for k, (sectors, outer) in enumerate(meshes):
        setup.clock.progress("fem", k / len(meshes), f"{sectors} sectors, {outer} outer rings")
        found.append(_run(sectors, outer))
    finest = found[-1]["resonance"]
    points = tuple(
        Point(
            "chip", f"{sectors} sectors, {outer} outer rings", error := _error(item, finest),
            _single(item), {"resonance": error},
            {"unknowns": item["unknowns"], "memory_bytes": item["memory"]},
        )
        for (sectors, outer), item in zip(meshes, found, strict=True)
    )  # fmt: skip
    plane = Plane(
        "fem", "Chip: mesh, matrices, factorisation and reduction to 1e-4",
        "error of the first resonance", "CPU time [s]", points[:-1],
        (f"against the finest mesh, {finest:.0f} Hz, which is left out",
         "time from an empty process to the reduced model, imports included"),
    )  # fmt: skip
    sizes = [item["unknowns"] for item in found]
    times = [item["time"] for item in found]
    scaling = Scaling(
        "chip", "unknowns of the chip", tuple(sizes), tuple(_single(item) for item in found),
        power(sizes, times), tuple(item["memory"] for item in found),
    )  # fmt: skip
    return Outcome((plane,), (), (scaling,))


def power(sizes: list[float], times: list[float]) -> float:
    """Exponent of the power law through the larger half of the points."""
    from_here = len(sizes) // 2 if len(sizes) > 3 else 0
    x, y = np.log(sizes[from_here:]), np.log(times[from_here:])
    return float(np.polyfit(x, y, 1)[0])


def _error(item: dict[str, float], finest: float) -> float:
    return abs(item["resonance"] / finest - 1.0)


def _single(item: dict[str, float]) -> Timing:
    return Timing(item["time"], item["time"], item["time"], 1)


def _run(sectors: int, outer: int) -> dict[str, float]:
    command = [sys.executable, "-m", __name__, str(sectors), str(outer)]
    ran = subprocess.run(command, capture_output=True, text=True, check=False)
    if ran.returncode:
        said = ran.stderr.strip().splitlines()[-1:] or ["it was killed"]
        raise SimulationError("the chip failed", where=f"{sectors} sectors", got=said[0])
    found: dict[str, float] = json.loads(ran.stdout)
    return found


def _measure(sectors: int, outer: int) -> dict[str, float]:
    sets = [f"kick.mesh.sectors={sectors}", f"kick.mesh.outer_rings={outer}", "rom.tolerance=1e-4"]
    scene = load_scene("harmonic", sets)
    model = from_sector(full_system(scene))
    reduce(model, tolerance=scene.rom.tolerance, band=scene.rom.band)
    seconds, facts = time.process_time(), model.facts
    return {
        "unknowns": facts["unknowns"], "resonance": facts["resonance_short_hz"], "time": seconds,
        "memory": 1024.0 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss,
    }  # fmt: skip


if __name__ == "__main__":
    print(json.dumps(_measure(int(sys.argv[1]), int(sys.argv[2]))))
