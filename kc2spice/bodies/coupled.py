"""Facts of electromechanical bodies with any ports, supported or free to move."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.sparse.linalg import LinearOperator, eigsh

from kc2spice.rom.linear import LinearModel

RESIDUAL = 1e-5  # of a mode; its frequency is off by the square of that
MODES = (4, 8, 40)  # asked for in turn; a body that is free to move has more than four rigid ones
# A mode is excited by a port if it has more than this part of the static answer (mass norm).
COUPLED = 0.03
REFINEMENTS = 3
Operator = Callable[[np.ndarray], np.ndarray]


def electromechanical(model: LinearModel, shift: float = 0.0) -> dict[str, float]:
    """Capacitances (of the first electrical port, those of others under their names, each with the
    rest shorted), static stroke of the first mechanical port, by its name, per volt, and the lowest
    resonances that the electrical ports excite (of a body without any: the others), all electrodes
    shorted and all open, without damping.

    ``shift`` [rad^2/s^2] makes ``K + shift M`` regular; 0 for a supported body. A resonance that is
    not among the lowest modes is left out.
    """
    kinds = [port.kind for port in model.ports]
    e = [k for k, kind in enumerate(kinds) if kind == "electrical"]
    force = next((k for k, kind in enumerate(kinds) if kind == "mechanical"), None)
    solve = model.pencil.pencil_solver(-shift).solve
    if not e:
        lowest = _resonance(model, solve, range(len(kinds)), shift)
        return {} if lowest is None else {"resonance_hz": lowest}
    load = model.B[:, e]
    shifted = solve(load)
    rest = shifted
    for _ in range(REFINEMENTS if shift else 0):  # loads in equilibrium: exact in the limit
        rest = solve(load + shift * (model.M @ rest))
    weight = np.linalg.inv(model.D[np.ix_(e, e)] + load.T @ shifted)

    def opened(f: np.ndarray) -> np.ndarray:
        """``(K + b C0^-1 b')^-1``: without charge the electrodes float to ``V = -C0^-1 b'u``."""
        u = solve(f)
        return np.asarray(u - shifted @ (weight @ (load.T @ u)))

    free = np.diag(model.D)[e] + np.sum(load * rest, axis=0)
    facts: dict[str, float | None] = {"capacitance_free_f": float(free[0])}
    facts["capacitance_clamped_f"] = float(model.D[e[0], e[0]])
    for port, capacitance in zip(e[1:], free[1:], strict=True):
        facts[f"{model.ports[port].name}_capacitance_f"] = float(capacitance)
    if force is not None:
        stroke = f"free_stroke_{model.ports[force].name}_m_per_v"
        facts[stroke] = float(model.B[:, force] @ rest[:, 0])
    facts["resonance_short_hz"] = _resonance(model, solve, e, shift)
    facts["resonance_open_hz"] = _resonance(model, opened, e, shift)
    return {name: value for name, value in facts.items() if value is not None}


def _resonance(
    model: LinearModel, solve: Operator, ports: range | list[int], shift: float
) -> float | None:
    """Lowest frequency [Hz] above rigid motion that the ports excite, None if it is not among the
    lowest modes. Lanczos starts from their static answers, so it stays with what they excite.
    """
    n, M = model.order, model.M
    inverse = LinearOperator((n, n), matvec=solve, dtype=float)
    ports = [k for k in ports if model.B[:, k].any()]
    if not ports:  # a dielectric moves nothing
        return None
    static = np.array([solve(model.B[:, k]) for k in ports])
    start = (static / np.linalg.norm(static, axis=1, keepdims=True)).sum(axis=0)
    for count in (min(count, n - 1) for count in MODES[shift > 0 :]):
        options = {"v0": start, "tol": RESIDUAL, "ncv": min(2 * count + 1, n)}
        values, modes = eigsh(inverse, count, M=M, sigma=-shift, OPinv=inverse, **options)
        rigid = modes[:, values <= 10 * shift]
        elastic = static - (static @ (M @ rigid)) @ rigid.T
        size = np.sqrt(np.sum(elastic * (M @ elastic.T).T, axis=1))
        share = np.abs(elastic @ (M @ modes)) / size[:, None]
        found = values[(share.max(axis=0) > COUPLED) & (values > 10 * shift)]
        if found.size:
            return float(np.sqrt(found.min()) / (2 * np.pi))
    return None
