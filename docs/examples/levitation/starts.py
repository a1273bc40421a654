"""TEAM problem 28: what the text leaves open, and what each of it does to the disc's path.

python docs/examples/levitation/starts.py

First table: turns of the scene `levitated_disc` by how its supply begins, and the mean distance to
the 26 measured heights of the first 248 ms. Second table: where the mean force of a steady current
holds the disc and the period of small swings, 2 pi / sqrt(g d ln F / dy), by one changed quantity.
Some minutes.
"""

import math
import tomllib
from pathlib import Path

import numpy as np
from scipy.optimize import brentq

import kc2spice as kc
from kc2spice.fem.magnet_rings import Winding, divide_section
from kc2spice.parts.magnetics.moving_conductor import find_turning_points

ROOT = Path(__file__).parents[3]
SCENE = tomllib.loads((ROOT / "kc2spice/scenes/levitated_disc.toml").read_text("utf-8"))
CURVE = tomllib.loads((ROOT / "docs/published.toml").read_text("utf-8"))["levitated_disc"]["curve"]
MEASURED = np.array(CURVE["points"])[:26]
WEIGHT, OMEGA = 0.107 * 9.80665, 2 * math.pi * 50
COPPER = {"inner": 3.65, "outer": 4.67}  # Ohm, of 1.2 mm wire on both
VOLTS = 20 * abs(complex(sum(COPPER.values()) + 0.07, 23.20))  # of 20 A with the disc at 11 mm
# A disc that lies on something until it is lifted: what a gap without voltage has as its stop.
SHELF = {
    "shelf": {"part": "gap", "a": "disc.a", "area": 1e-6, "gap": 2e-4, "travel": 1e-4,
              "stop": 1e5, "pins": {"plus": "nothing.out", "b": "place.out"}},
    "nothing": {"part": "source", "dc": 0.0},
    "place": {"part": "source", "kind": "displacement", "dc": "3.9 mm"},
}  # fmt: skip


def supplied(size: float, phase: float = 0.0, rise: float = 0.0, late: float = 0.0) -> list:
    """Points of a sine from ``late`` on that grows to its ``size`` within ``rise`` [s]."""
    t = np.arange(0.0, 0.4602, 2e-4)
    grown = np.minimum(t / rise, 1.0) if rise else 1.0
    values = size * grown * np.sin(OMEGA * t + math.radians(phase))
    return [[0.0, 0.0], *zip((t + late + 1e-5).tolist(), values.tolist(), strict=True)]


def path(kind: str, **shape: float) -> tuple[np.ndarray, np.ndarray]:
    """Times and heights of the disc."""
    supply = {"part": "source", "kind": kind, "pwl": supplied(**shape)}
    coils = {
        name: coil | ({"resistance": COPPER[name]} if kind == "voltage" else {})
        for name, coil in SCENE["conductor"]["coils"].items()
    }
    conductor = SCENE["conductor"] | {"coils": coils, "y_max": "30 mm"}
    solver = {"reltol": 1e-4, "max_step": "0.2 ms", "stop": "0.45 s"}
    more = {"supply": supply, "conductor": conductor, "solver": solver, "checks": {"energy": "off"}}
    lies = SHELF if shape.get("rise") or shape.get("late") else {}
    waves = kc.run(SCENE | lies | more | {"name": "starts"}).waves
    return waves["time"], waves["conductor.y"]


def steady(current=20.0, conductivity=3.4e7, radius=65e-3, thickness=3e-3, turns=(960, 576),
           outer=87.5e-3, inner=41e-3, frequency=50.0):  # fmt: skip
    """Height and period of small swings where the mean force is the weight, by all rings."""
    body = divide_section(0.0, radius, 0.0, thickness, 300)
    coils = (
        Winding(inner, 28e-3, 52e-3, -26e-3, turns[0]),
        Winding(outer, 15e-3, 52e-3, -26e-3, turns[1]),
    )
    s = 2j * math.pi * frequency
    admittance = np.linalg.inv(np.diag(body.resistance / conductivity) + s * body.inductance)

    def ratio(y: float) -> float:
        flux = [np.subtract(*(c.couple_circles(body.r, body.z + h) for c in coils))
                for h in (y - 2e-5, y, y + 2e-5)]  # fmt: skip
        induced = -admittance @ (s * flux[1] * current)
        force = 0.5 * np.real(np.conj(induced) @ (flux[2] - flux[0]) / 4e-5 * current)
        return math.log(force / WEIGHT)

    y = brentq(ratio, 5e-3, 16e-3, xtol=1e-8)
    slope = (ratio(y - 1e-4) - ratio(y + 1e-4)) / 2e-4
    return y, 2 * math.pi / math.sqrt(9.80665 * slope)


STARTS = {
    "20 A at once, from zero": {"kind": "current", "size": 20},
    "20 A at once, from its peak": {"kind": "current", "size": 20, "phase": 90},
    "the same from zero, 9.9 ms later": {"kind": "current", "size": 20, "late": 9.9e-3},
    "voltage at once, from zero": {"kind": "voltage", "size": VOLTS},
    "voltage at once, from its peak": {"kind": "voltage", "size": VOLTS, "phase": 90},
    "current that grows over 20 ms": {"kind": "current", "size": 20, "rise": 20e-3},
    "current that grows over 40 ms": {"kind": "current", "size": 20, "rise": 40e-3},
}
CHANGES = {
    "as the text has it": {},
    "current 20.5 A": {"current": 20.5},
    "conductivity + 10 %": {"conductivity": 3.74e7},
    "thickness 3.1 mm": {"thickness": 3.1e-3},
    "disc's radius 66 mm": {"radius": 66e-3},
    "inner radius 42 mm": {"inner": 42e-3},
    "outer radius 88.5 mm": {"outer": 88.5e-3},
    "outer turns 590": {"turns": (960, 590)},
    "51 Hz": {"frequency": 51.0},
}

if __name__ == "__main__":
    print("| start | turn 1 | turn 2 | turn 3 | turn 5 | rms |\n|---|---|---|---|---|---|")
    for label, shape in STARTS.items():
        t, y = path(**shape)
        found = find_turning_points(t, y)
        off = 1e3 * np.sqrt(np.mean((np.interp(MEASURED[:, 0], t, y) - MEASURED[:, 1]) ** 2))
        cells = [f"{1e3 * h:.1f} mm at {1e3 * at:.0f} ms" for at, h in (*found[:3], found[4])]
        print(f"| {label} | {' | '.join(cells)} | {off:.2f} mm |", flush=True)
    print("\n| changed | floats at | period |\n|---|---|---|")
    for label, change in CHANGES.items():
        y, period = steady(**change)
        print(f"| {label} | {1e3 * y:.2f} mm | {1e3 * period:.1f} ms |", flush=True)
