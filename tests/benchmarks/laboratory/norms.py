"""States and processor time of reductions in both norms, on models like those that are public.

``python -m laboratory.norms`` prints the table of docs/reduction.md.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterator

import numpy as np

from kc2spice.core.errors import Kc2spiceError
from kc2spice.rom.linear import LinearModel, Norm
from kc2spice.rom.reduce import reduce
from laboratory.beam import steel_cantilever

Case = tuple[LinearModel, float, tuple[float, float]]  # model, tolerance, band [Hz]


def heat(cells: int = 200) -> Case:
    """A rod, heated at a third, measured at two thirds."""
    n = cells
    A = 1e-2 * (n + 1) ** 2 * (np.eye(n, k=1) + np.eye(n, k=-1) - 2 * np.eye(n))
    model = LinearModel(A=A, B=(n + 1) * np.eye(n)[:, [n // 3]], C=np.eye(n)[[2 * n // 3]])
    return model, 1e-4, (0.0, 1e3 / (2 * np.pi))


def beam(elements: int, *, first_order: bool = False) -> Case:
    """Clamped Hermite beam of steel, force and displacement at its free end."""
    M, K, B = steel_cantilever(elements)
    n = 2 * elements
    E = 2.0 * M + 1e-5 * K
    if not first_order:
        return LinearModel(M=M, E=E, K=K, B=B), 1e-5, (1.0, 800.0)
    inner = np.linalg.solve(M, np.hstack([K, E, B]))
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-inner[:, :n], -inner[:, n : 2 * n]]])
    drive, read = np.vstack([0 * B, inner[:, 2 * n :]]), np.hstack([B.T, 0 * B.T])
    return LinearModel(A=A, B=drive, C=read), 1e-4, (1.0, 800.0)


def structure(states: int, ports: int) -> Case:
    """Random lightly damped modes over two decades in first order, none left out by symmetry."""
    rng = np.random.default_rng(states)
    n = states // 2
    w, ratio = np.exp(np.linspace(0, 5, n)), rng.uniform(1e-3, 5e-3, n)
    A = np.zeros((states, states))
    A[::2, 1::2], A[1::2, ::2], A[1::2, 1::2] = np.diag(w), -np.diag(w), -2 * np.diag(ratio * w)
    B, C = np.zeros((states, ports)), np.zeros((ports, states))
    B[1::2] = rng.standard_normal((n, ports)) / w[:, None]
    C[:, ::2] = rng.standard_normal((ports, n)) / w
    return LinearModel(A=A, B=B, C=C), 1e-4, (0.0, w[-1] / (2 * np.pi))


CASES: dict[str, Callable[[], Case]] = {
    "heat equation, 200 states": heat,
    "random structure, 120 states, 2 x 2": lambda: structure(120, 2),
    "random structure, 270 states, 3 x 3": lambda: structure(270, 3),
    "clamped beam, 200 unknowns, second order": lambda: beam(100),
    "clamped beam, 348 states, first order": lambda: beam(174 // 2, first_order=True),
}


def rows() -> Iterator[str]:
    """Lines of the table: first-order states, certified error and processor seconds per norm."""
    yield "| model | tolerance | pointwise: states | error | s | peak: states | error | s |"
    yield "|---|---|---|---|---|---|---|---|"
    norms: tuple[Norm, ...] = ("pointwise", "peak")
    for name, make in CASES.items():
        model, tolerance, band = make()
        cells = [name, f"{tolerance:g}"]
        for norm in norms:
            started = time.process_time()
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    rom = reduce(model, tolerance=tolerance, band=band, norm=norm)
            except Kc2spiceError as refused:
                cells += [f"refused: {refused.message}", "", ""]
                continue
            spent = time.process_time() - started
            states = rom.order * (1 if rom.first_order else 2)
            assert rom.certificate is not None
            cells += [str(states), f"{rom.certificate.error_estimate:.1e}", f"{spent:.1f}"]
        yield "| " + " | ".join(cells) + " |"


if __name__ == "__main__":
    for row in rows():
        print(row, flush=True)
