"""Gain tuning: scipy's optimiser over runs, the worst of two launches counts."""

import numpy as np
from scipy.optimize import minimize

import kc2spice as kc

LAUNCHES = [100, 114]  # V on the chip
scene = kc.load_scene("kick_and_catch", {"solver.reltol": 1e-3, "solver.stop": "3.5 ms"})
keys = ("control.kp", "control.kd")
start = np.array([getattr(scene.parts["control"].keys, key.split(".")[1]) for key in keys])


def settling(gains: np.ndarray) -> np.ndarray:
    """Settling time [s] of each launch; one that is not caught counts as three times the run."""
    changed = kc.load_scene(scene, dict(zip(keys, gains, strict=True)))
    table = kc.sweep(changed, {"kick.drive.voltage": LAUNCHES})
    return np.array([t or 3 * scene.stop_time for t in table["settling_time_s"]])


before = settling(start)


def cost(shares: np.ndarray) -> float:
    ratio = settling(start * np.exp(shares)) / before
    print(f"gains {start * np.exp(shares)}: worst ratio {ratio.max():.4f}")
    return float(ratio.max() + 0.1 * ratio.mean())


# Logarithms of the gains, as a share: a first simplex of 3 %, refined for as long as you like.
simplex = 0.03 * np.vstack([np.zeros(2), np.eye(2)])
options = {"maxfev": 10, "initial_simplex": simplex}
found = minimize(cost, np.zeros(2), method="Nelder-Mead", options=options)
after = settling(start * np.exp(found.x))
print("tuned:", dict(zip(keys, start * np.exp(found.x), strict=True)), after / before)
assert found.fun <= 1.1
