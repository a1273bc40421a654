"""Writes kc2spice/parts/acoustics/_radiation_networks.py: networks of radiation impedances.

python tools/radiation_networks.py

Each network is a series connection of sections, in units of rho c / S and c / a: a resistance r
parallel to an inductance, with the corner frequency w, or a resonator with the resistance r, the
resonance w and the relative bandwidth b. Their logarithms are fitted, so that all elements are
positive and the network is positive real. The fit minimises the largest of two relative errors up
to the largest ka: that of the impedance, and that of the resistance, which is the radiated power.
Errors of the impedance below ka = 0.4 count 30 times: there the mass of the fluid shifts the
resonances of loudspeakers. The script takes some minutes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.integrate import quad
from scipy.optimize import least_squares
from scipy.special import ive, j1, kve, struve, y1

TARGET = Path(__file__).parents[1] / "kc2spice" / "parts" / "acoustics" / "_radiation_networks.py"
LOWEST_KA = 1e-2  # below it, all errors are constant
SHARE_BEYOND = 0.03  # weight of the errors from the largest ka to four times the largest ka
# product of wave number and radius below which the impedance is that of a mass, and weight of its
# error there: the errors of resonances are then a twentieth of the largest error
MASS_KA, MASS_WEIGHT = 0.4, 30.0
ROUNDS = 40  # of the iteration that equalises the errors at all frequencies
STARTS = 8
LIMITS = (-12.0, 8.0)  # of the logarithms
HEADER = '''"""Networks of radiation impedances, which tools/radiation_networks.py computes."""

from __future__ import annotations

from kc2spice.parts.acoustics._network_sections import NetworkSection, RadiationNetwork

'''


def baffled_piston(ka: np.ndarray) -> np.ndarray:
    """Impedance of a piston in a baffle (Rayleigh; Kinsler et al., section 7.5)."""
    x = 2 * ka
    return np.asarray(1 - 2 * j1(x) / x + 2j * struve(1, x) / x)


def free_piston(ka: np.ndarray) -> np.ndarray:
    """Impedance of a piston in the end of a long tube without a flange.

    H. Levine and J. Schwinger, Phys. Rev. 73 (1948) 383, equations VI.4 and VI.5, exact below
    ka = 3.83, the cut-on of the first symmetric mode in the tube. Above, its limit rho c / S.
    """
    return np.array([_open_end(k) if k < 3.83 else 1.0 for k in ka])


def _open_end(k: float) -> complex:
    """Impedance of an open end from the reflection coefficient."""

    def phase(t: float) -> float:
        x = k * np.sin(t)
        return float(np.arctan2(j1(x), -y1(x)) / np.sin(t))

    def size(t: float) -> float:
        x = k * np.sin(t)
        return float(np.log(np.pi * j1(x) * np.hypot(j1(x), y1(x))) / np.sin(t))

    def outside(x: float) -> float:
        return float(-np.log(2 * ive(1, x) * kve(1, x)) / (x * np.hypot(x, k)))

    magnitude = np.exp(-2 / np.pi * quad(phase, 0, np.pi / 2, limit=200)[0])
    inner = quad(size, 0, np.pi / 2, limit=200)[0] / k
    outer = quad(outside, 0, 1, limit=200)[0] + quad(outside, 1, np.inf, limit=200)[0]
    reflection = -magnitude * np.exp(-2j * k * (inner + outer) / np.pi)
    return complex((1 + reflection) / (1 - reflection))


@dataclass(frozen=True)
class Case:
    """Impedance with the numbers of sections and the largest ka."""

    impedance: Callable[[np.ndarray], np.ndarray]
    corners: int
    resonators: int
    largest_ka: float


CASES = {
    "BAFFLED_PISTON": Case(baffled_piston, 1, 7, 15.0),
    "FREE_PISTON": Case(free_piston, 1, 3, 3.8),
}


def respond(logarithms: np.ndarray, corners: int, ka: np.ndarray) -> np.ndarray:
    """Impedance of a network from the logarithms of its numbers."""
    s, values = 1j * ka, np.exp(logarithms)
    result = np.zeros(ka.size, complex)
    for r, w in values[: 2 * corners].reshape(-1, 2):
        result += r * s / (s + w)
    for r, w, b in values[2 * corners :].reshape(-1, 3):
        result += r * b * w * s / (s * s + b * w * s + w * w)
    return result


def weigh(ka: np.ndarray) -> np.ndarray:
    """Weight of the error of the impedance."""
    return np.asarray(1 + MASS_WEIGHT / (1 + (ka / MASS_KA) ** 4))


def errors(network: np.ndarray, exact: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Relative errors of the impedance and of the resistance."""
    difference = network - exact
    return np.abs(difference) / np.abs(exact), np.abs(difference.real) / exact.real


def weighted_error(network: np.ndarray, exact: np.ndarray, ka: np.ndarray) -> np.ndarray:
    """Larger one of both weighted errors."""
    impedance, power = errors(network, exact)
    return np.maximum(weigh(ka) * impedance, np.sqrt(weigh(ka)) * power)


def fit(case: Case, seed: int) -> np.ndarray:
    """Logarithms of the network of one random start."""
    top, rng = case.largest_ka, np.random.default_rng(seed)
    ka = np.union1d(np.geomspace(LOWEST_KA, top, 120), np.linspace(top / 200, top, 200))
    beyond = np.linspace(1.01 * top, 4 * top, 60)
    exact, far = case.impedance(ka), case.impedance(beyond)
    corners = [(np.log(0.3), np.log(w)) for w in np.geomspace(0.8, top, case.corners + 1)[:-1]]
    places = np.sort(rng.uniform(0.8, 1.1 * top, case.resonators))
    resonators = [(np.log(0.3), np.log(w), np.log(rng.uniform(0.3, 2))) for w in places]
    numbers = np.concatenate([np.ravel(corners), np.ravel(resonators)])
    weight = np.ones(ka.size)
    result, least = numbers, np.inf

    def residual(x: np.ndarray) -> np.ndarray:
        d = respond(x, case.corners, ka) - exact
        out = SHARE_BEYOND * np.abs(respond(x, case.corners, beyond) - far)
        real = weight * np.sqrt(weigh(ka)) * d.real / exact.real
        return np.concatenate([real, weight * weigh(ka) * d.imag / np.abs(exact), out])

    for turn in range(ROUNDS):
        steps = 60 if turn else 300
        numbers = least_squares(residual, numbers, max_nfev=steps, bounds=LIMITS).x
        error = weighted_error(respond(numbers, case.corners, ka), exact, ka)
        if error.max() < least:
            result, least = numbers, error.max()
        weight = weight * (0.3 + error / error.max())
        weight = np.maximum(weight / weight.mean(), 0.03)
    return result


def write_case(name: str, case: Case) -> str:
    """Text of the best network of all starts."""
    ka = np.union1d(
        np.geomspace(LOWEST_KA, case.largest_ka, 400), np.linspace(0.01, case.largest_ka, 800)
    )
    exact = case.impedance(ka)
    best = min(
        (fit(case, seed) for seed in range(STARTS)),
        key=lambda x: weighted_error(respond(x, case.corners, ka), exact, ka).max(),
    )
    values = np.array([float(f"{v:.6g}") for v in np.exp(best)])
    impedance, power = (e.max() for e in errors(respond(np.log(values), case.corners, ka), exact))
    groups = [
        *values[: 2 * case.corners].reshape(-1, 2),
        *values[2 * case.corners :].reshape(-1, 3),
    ]
    lines = [
        f"        NetworkSection({', '.join(map(repr, map(float, group)))})," for group in groups
    ]
    largest = [f"    largest_ka={case.largest_ka},"]
    largest += [f"    impedance_error={np.ceil(impedance * 1e4) / 1e4:.4g},"]
    largest += [f"    power_error={np.ceil(power * 1e4) / 1e4:.4g},"]
    return "\n".join([f"{name} = RadiationNetwork(", "    (", *lines, "    ),", *largest, ")"])


if __name__ == "__main__":
    texts = [write_case(name, case) for name, case in CASES.items()]
    TARGET.write_text(HEADER + "\n" + "\n".join(texts) + "\n", encoding="utf-8")
    print("\n".join(texts))
