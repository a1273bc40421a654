"""How fast could any controller catch? Settling of PID gains against the bang-bang optimum.

    PYTHONPATH=tests/benchmarks python -m laboratory.catch_bound

The sphere as a point mass in the field table, launched at 0.3 … 2 m/s at t = 0: full current
upwards until a switching time, then full current downwards, so that the apex just touches the upper
edge of the settling band. No current within the limit enters the band sooner and stays in it. The
gains run through the same model, which has no chip and no amplifiers.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from kc2spice.core.progress import Clock
from kc2spice.fem.magnetics.table import EMTable, force
from kc2spice.parts.pid import SETTLING_BAND, settling_time
from kc2spice.scene.load import load_scene
from laboratory.setup import keys_of

STEP, STOP = 0.5e-6, 3e-3  # s
SPEEDS = (0.3, 0.5, 0.7, 0.9, 1.0, 1.05, 1.1, 1.13, 1.15, 1.2, 1.5, 2.0)
GAINS = {"paper": (5e4, 20.0, 1e-7), "tuned": (2511.0, 1.0199, 4.2337e-6)}  # KP, KD, roll-off

Current = Callable[[float, float, float], float]  # of time, height and speed


def fly(
    acceleration: Callable[[float, float], float], speed: float, current: Current
) -> np.ndarray:
    """Rows of time, height and speed from the launch at the chip, by the midpoint rule."""
    t, y, v = 0.0, 1e-3, speed
    rows = [(t, y, v)]
    while t < STOP and y > 0.5e-3:
        i = current(t, y, v)
        ahead = v + STEP / 2 * acceleration(y, i)
        y, v = y + STEP * ahead, v + STEP * acceleration(y + STEP / 2 * v, i)
        t += STEP
        rows.append((t, y, v))
    return np.array(rows).T


def field(table: EMTable, mass: float, gravity: float) -> Callable[[float, float], float]:
    """Acceleration at a height and a current, both coils opposed, from 4001 heights."""
    grid = np.linspace(table.y[0], table.y[-1], 4001)
    drop, push, pull = (force(table, grid, -i + 0 * grid, i + 0 * grid) for i in (0.0, 0.1, -0.1))
    odd, even = (push - pull) / 0.2, (push + pull - 2 * drop) / 0.02
    rows = np.column_stack([drop / mass - gravity, odd / mass, even / mass]).tolist()
    low, step = float(grid[0]), float(grid[1] - grid[0])

    def acceleration(y: float, i: float) -> float:
        place = min(max((y - low) / step, 0.0), 3999.0)
        k = int(place)
        w, (a, b) = place - k, rows[k : k + 2]
        return sum((p + w * (q - p)) * f for p, q, f in zip(a, b, (1.0, i, i * i), strict=True))

    return acceleration


def main() -> None:
    """Print settling from the launch on [ms], and its ratio to the paper's."""
    scene = load_scene("kick_and_catch")
    sphere, control = keys_of(scene, "sphere"), keys_of(scene, "pid")
    catch = scene.of("ring_magnet_coils")[0]
    table = catch.type.build(catch, scene, Clock())
    acceleration = field(table, sphere.mass, scene.gravity)
    goal, limit = control.setpoint, control.current_limit
    band = SETTLING_BAND * abs(goal - sphere.radius)

    def settled(path: np.ndarray) -> float:
        return settling_time(path[0], path[1], goal, band) or np.nan

    def pid(kp: float, kd: float, rolloff: float) -> Current:
        state = [1e-3]  # the height behind the differentiator's pole

        def current(t: float, y: float, v: float) -> float:
            lag = v * rolloff + (state[0] - y) if t else 0.0  # of a ramp, and what is left of it
            state[0] = y + v * STEP - v * rolloff + lag * np.exp(-STEP / rolloff)
            slope = v - lag / rolloff if t else v
            return float(np.clip(kp * (goal - y) - kd * slope, -limit, limit))

        return current

    def bang_bang(speed: float) -> float:
        early, late = 0.0, 2e-3
        for _ in range(16):
            switch = (early + late) / 2
            path = fly(acceleration, speed, lambda t, y, v: limit if t < switch else -limit)  # noqa: B023
            over = path[1].max() > goal + band
            early, late = (early, switch) if over else (switch, late)
        return float(
            np.interp(goal - band, path[1][: path[1].argmax()], path[0][: path[1].argmax()])
        )

    print("launch    settling in ms           ratio to the paper's")
    print("m/s    paper   tuned   bound     tuned   bound")
    for speed in SPEEDS:
        paper, tuned = (settled(fly(acceleration, speed, pid(*g))) for g in GAINS.values())
        bound = bang_bang(speed)
        times = "  ".join(f"{1e3 * t:6.4f}" for t in (paper, tuned, bound))
        print(f"{speed:4.2f}  {times}    {tuned / paper:.4f}  {bound / paper:.4f}")


if __name__ == "__main__":
    main()
