"""Finite-element models of bodies, and their responses without damping.

The computed values are capacitances, strokes and the lowest resonances.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, eigsh

from kc2spice.core.domains import ACOUSTIC, TRANSLATION
from kc2spice.fem.solid import Solid
from kc2spice.rom.linear_model import LinearModel

MODE_RESIDUAL = 1e-5  # largest residual of a mode; the frequency error is the squared residual
# Numbers of computed modes, tried one after another. An unsupported body has up to six rigid-body
# modes.
MODE_COUNTS = (4, 8, 40)
# Smallest share of the static response (mass norm) in a mode that a port excites.
MIN_MODE_SHARE = 0.03
MAX_REFINEMENTS = 3
Operator = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True, eq=False)
class FiniteElementModel:
    """Linear model of a solid, and the conversion of its unknowns to values at the nodes.

    For the unknowns z and the voltages V, the displacements are ``u = displacement @ z`` (d
    nodes,), and the potentials are ``phi = potential @ p + drive @ V`` (nodes,) with ``K_pp p =
    K_up' z + lift V``. ``shift`` [rad^2/s^2] makes ``K + shift M`` regular. ``mass`` [kg] is the
    mass of the whole body, including fixed nodes. ``faces`` contains the facets of acoustic ports.
    """

    model: LinearModel
    solid: Solid
    displacement: sparse.csc_array
    potential: sparse.csc_array
    drive: sparse.csc_array
    lift: np.ndarray
    shift: float
    mass: float
    faces: Mapping[str, np.ndarray] = field(default_factory=dict)

    def compute_nodal_values(
        self, z: np.ndarray, voltages: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Compute displacements (d nodes, k) and potentials (nodes, k) at the nodes.

        Each column of the result is for a column of z (n, k) and of the voltages (e, k).
        """
        phi, K = self.drive @ voltages, self.model.K
        if self.potential.shape[1]:
            # K.pp is -K_pp: p = K_pp^-1 (K_up' z + lift V)
            phi = phi - self.potential @ K.inner.solve(K.pu @ z + self.lift @ voltages)
        return self.displacement @ z, phi


@dataclass(frozen=True, eq=False)
class UndampedResponses:
    """Responses of a model without damping.

    The responses are unknowns (n, …) of the model. ``static`` are the responses to 1 V at each
    electrical port. ``pushed`` (n, 1) is the response to 1 N at the first mechanical port; without
    such a port, it is (n, 0). ``modes`` are the lowest modes that these loads excite, with shorted
    electrical ports. Without electrical ports, ``modes`` are the lowest modes of the body.
    ``rigid`` are rigid-body modes. ``facts`` maps names to characteristic numbers. The function
    ``solve`` multiplies by the inverse of the shifted stiffness.
    """

    facts: dict[str, float]
    static: np.ndarray
    pushed: np.ndarray
    modes: np.ndarray
    rigid: np.ndarray
    solve: Operator


def compute_undamped_responses(model: LinearModel, shift: float = 0.0) -> UndampedResponses:
    """Compute static responses and the lowest resonances without damping.

    The facts are:

    * the capacitance of each electrical port with the other ports shorted. The name of the fact
      contains the name of the port, except for the first port.
    * the stroke per volt of the first mechanical port. The name of the fact contains the name of
      the port.
    * the lowest resonances that the electrical ports excite, with all electrodes shorted, and with
      all electrodes open. If there are no electrical ports, all ports except acoustic ports excite
      the modes. If all ports are acoustic, they excite the modes.

    ``shift`` [rad^2/s^2] makes ``K + shift M`` regular; it is 0 for a supported body. Resonances
    above the lowest modes are omitted.
    """
    e = [k for k, port in enumerate(model.ports) if port.electrical]
    force = [k for k, port in enumerate(model.ports) if port.domain is TRANSLATION][:1]
    solve = model.pencil.pencil_solver(-shift).solve
    if not e:
        ports = [k for k, port in enumerate(model.ports) if port.domain is not ACOUSTIC]
        ports = ports or [*range(len(model.ports))]
        lowest, modes, rigid = _find_resonance(model, solve, ports, shift)
        facts = {} if lowest is None else {"resonance_hz": lowest}
        pushed = _solve_static(model, solve, force, shift)[1]
        return UndampedResponses(facts, model.B[:, e], pushed, modes, rigid, solve)
    load = model.B[:, e]
    shifted, rest = _solve_static(model, solve, [*e, *force], shift)
    shifted, rest, pushed = shifted[:, : len(e)], rest[:, : len(e)], rest[:, len(e) :]
    weight = np.linalg.inv(model.D[np.ix_(e, e)] + load.T @ shifted)

    def solve_with_open_electrodes(f: np.ndarray) -> np.ndarray:
        """Multiply by ``(K + b C0^-1 b')^-1``; the voltages of open electrodes are -C0^-1 b'u."""
        u = solve(f)
        return np.asarray(u - shifted @ (weight @ (load.T @ u)))

    free = np.diag(model.D)[e] + np.sum(load * rest, axis=0)
    stated: dict[str, float | None] = {"capacitance_free_f": float(free[0])}
    stated["capacitance_clamped_f"] = float(model.D[e[0], e[0]])
    for port, capacitance in zip(e[1:], free[1:], strict=True):
        stated[f"{model.ports[port].name}_capacitance_f"] = float(capacitance)
    for port in force:
        stroke = f"free_stroke_{model.ports[port].name}_m_per_v"
        stated[stroke] = float(model.B[:, port] @ rest[:, 0])
    stated["resonance_short_hz"], modes, rigid = _find_resonance(model, solve, e, shift)
    stated["resonance_open_hz"], *_ = _find_resonance(model, solve_with_open_electrodes, e, shift)
    facts = {name: value for name, value in stated.items() if value is not None}
    return UndampedResponses(facts, rest, pushed, modes, rigid, solve)


def _solve_static(
    model: LinearModel, solve: Operator, ports: list[int], shift: float
) -> tuple[np.ndarray, np.ndarray]:
    """Compute displacements (n, ports) under a constant unit load at each port.

    The first result is for the shifted stiffness, and the second result for K.
    """
    load = model.B[:, ports]
    shifted = rest = solve(load) if ports else load
    # the loads are in equilibrium, so the iteration converges to the response without the shift
    for _ in range(MAX_REFINEMENTS if shift else 0):
        rest = solve(load + shift * (model.M @ rest)) if ports else load
    return shifted, rest


def _find_resonance(
    model: LinearModel, solve: Operator, ports: list[int], shift: float
) -> tuple[float | None, np.ndarray, np.ndarray]:
    """Find the lowest resonance [Hz] that the ports excite, and the modes.

    If none of the lowest modes is excited, the frequency is None. The other results are the modes
    (n, …) that the ports excite, and the rigid-body modes. The Lanczos method starts from the
    static responses, so that it finds only modes that the ports excite.
    """
    n, M = model.order, model.M
    inverse = LinearOperator((n, n), matvec=solve, dtype=float)
    ports = [k for k in ports if model.B[:, k].any()]
    none = rigid = np.empty((n, 0))
    if not ports:  # a dielectric has no mechanical response
        return None, none, rigid
    static = np.array([solve(model.B[:, k]) for k in ports])
    start = (static / np.linalg.norm(static, axis=1, keepdims=True)).sum(axis=0)
    for count in (min(count, n - 1) for count in MODE_COUNTS[shift > 0 :]):
        options = {"v0": start, "tol": MODE_RESIDUAL, "ncv": min(2 * count + 1, n)}
        values, modes = eigsh(inverse, count, M=M, sigma=-shift, OPinv=inverse, **options)
        rigid = modes[:, values <= 10 * shift]
        elastic = static - (static @ (M @ rigid)) @ rigid.T
        size = np.sqrt(np.sum(elastic * (M @ elastic.T).T, axis=1))
        share = np.abs(elastic @ (M @ modes)) / size[:, None]
        excited = np.flatnonzero((share.max(axis=0) > MIN_MODE_SHARE) & (values > 10 * shift))
        if excited.size:
            excited = excited[np.argsort(values[excited])]
            lowest = float(np.sqrt(values[excited[0]]) / (2 * np.pi))
            return lowest, modes[:, excited], rigid
    return None, none, rigid
