"""Compare the error estimate of reduced models with their true error on published models.

Needs tests/physics, tests/spice and the root of the repository on PYTHONPATH. The true error comes
from direct solutions by numpy at 300 equally spaced frequencies and at every natural frequency.
"""

import mor_families as families
import numpy as np
from tables import print_table

import kc2spice as kc

MODELS = {
    "clamped Euler beam": families.beam(),
    "three chains with dashpots": families.triple_chain(),
}
TOLERANCE = 1e-4


def response(matrices: dict[str, np.ndarray], frequencies: np.ndarray) -> np.ndarray:
    """Transfer matrices from loads to displacements by dense solutions."""
    M, E, K, B = (matrices[name] for name in "MEKB")
    s = 2j * np.pi * frequencies
    return np.array([B.T @ np.linalg.solve(K + p * E + p * p * M, B) for p in s])


def test_frequencies(matrices: dict[str, np.ndarray], top: float) -> np.ndarray:
    """Equally spaced frequencies, natural frequencies of the undamped model, and their flanks."""
    squares = np.linalg.eigvals(np.linalg.solve(matrices["M"], matrices["K"])).real
    natural = np.sqrt(squares) / (2 * np.pi)
    near = np.outer(natural, (0.999, 1.0)).ravel()
    frequencies = np.r_[np.linspace(0.0, top, 302)[1:-1], near]
    return frequencies[(frequencies > 0) & (frequencies < top)]


def row(name: str, norm: str) -> list[str]:
    """States, error estimate and true error of one reduction."""
    matrices, top = MODELS[name]
    frequencies = test_frequencies(matrices, top)
    full = kc.LinearModel(**matrices, name=name)
    reduced = kc.reduce(full, tolerance=TOLERANCE, band=(0.0, top), norm=norm)
    exact = response(matrices, frequencies)
    peak = np.abs(exact).max(axis=0)
    scale = np.maximum(np.abs(exact), 1e-6 * peak) if norm == "pointwise" else peak
    error = np.max(np.abs(reduced.transfer(frequencies) - exact) / scale)
    estimate = reduced.certificate.error_estimate
    form = "first order" if reduced.first_order else "second order"
    sizes = str(len(matrices["K"])), f"{reduced.order}, {form}"
    return [name, norm, *sizes, f"{estimate:.0e}", f"{error:.0e}"]


if __name__ == "__main__":
    head = ["model", "norm", "unknowns", "states", "error estimate", "true error"]
    print_table(head, (row(name, norm) for name in MODELS for norm in ("pointwise", "peak")))
