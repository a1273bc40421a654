"""Finite-element models of bodies, and their responses without damping.

The undamped responses yield capacitances, strokes per volt and the lowest resonances.
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

# largest relative residual of an eigenmode; its square is the relative frequency error
MODE_RESIDUAL = 1e-5
# Numbers of modes to compute; a larger number is used if the ports excite none of the modes.
# An unsupported body has up to six rigid-body modes.
MODE_COUNTS = (4, 8, 40)
# A port excites a mode if the mode's share of the static response (mass norm) exceeds this value.
MIN_MODE_SHARE = 0.03
MAX_REFINEMENTS = 3  # number of iterations that correct static responses for the shift
Operator = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True, eq=False)
class FiniteElementModel:
    """Linear model of a solid, and the matrices that map its unknowns to nodal values.

    The unknowns z and the voltages V determine the values at the nodes. The displacements are ``u =
    displacement @ z``, an array of shape (d * nodes,) with d components per node. The potentials
    are ``phi = potential @ p + drive @ V``, an array of shape (nodes,). The free potentials p solve
    ``K_pp p = K_up' z + lift V``. ``shift`` [rad^2/s^2] is the factor that makes ``K + shift M``
    regular. ``mass`` [kg] is the mass of the whole body, including fixed nodes. ``faces`` maps the
    names of acoustic ports to facets.
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
        """Compute the displacements and the potentials at the nodes from the unknowns.

        The unknowns ``z`` have the shape (n, k), and the ``voltages`` the shape (e, k). Return
        displacements of shape (d * nodes, k), with d components per node, and potentials of shape
        (nodes, k). Column j of both returned arrays belongs to column j of ``z`` and of
        ``voltages``.
        """
        phi, K = self.drive @ voltages, self.model.K
        if self.potential.shape[1]:
            # The free potentials are p = K_pp^-1 (K_up' z + lift V).
            # The stored block ``K.pp`` is -K_pp, so the product with its inverse is subtracted.
            phi = phi - self.potential @ K.inner_factor.solve(K.pu @ z + self.lift @ voltages)
        return self.displacement @ z, phi


@dataclass(frozen=True, eq=False)
class UndampedResponses:
    """Static responses and lowest modes of a model without damping.

    Each column of ``static``, ``pushed``, ``modes`` and ``rigid`` contains the n unknowns of the
    model. A column of ``static`` is the response to 1 V at one electrical port. The column of
    ``pushed`` is the response to 1 N at the first mechanical port; ``pushed`` has no column if
    there is no such port. The columns of ``modes`` are the lowest modes that the electrical ports
    excite, with all electrical ports shorted. In a body without electrical ports, the columns of
    ``modes`` are the lowest modes that the other ports excite. The columns of ``rigid`` are
    rigid-body modes. ``facts`` contains characteristic values, such as capacitances, keyed by name.
    The function ``solve`` multiplies a vector by the inverse of the shifted stiffness ``K + shift
    M``.
    """

    facts: dict[str, float]
    static: np.ndarray
    pushed: np.ndarray
    modes: np.ndarray
    rigid: np.ndarray
    solve: Operator


def compute_undamped_responses(model: LinearModel, shift: float = 0.0) -> UndampedResponses:
    """Compute the static responses and the lowest modes of a model without damping.

    ``facts`` of the returned object contains:

    * the capacitance of each electrical port while the other electrical ports are shorted. The key
      of a capacitance contains the name of the port, except for the first port.
    * the stroke per volt of the first mechanical port. The key of a stroke contains the name of the
      mechanical port.
    * the lowest resonance that the electrical ports excite while all electrodes are shorted, and
      the lowest resonance while all electrodes are open. In a model without electrical ports, all
      ports except acoustic ports excite the modes. If all ports are acoustic, the acoustic ports
      excite the modes.

    ``shift`` [rad^2/s^2] makes ``K + shift M`` regular; it is 0 for a supported body. A resonance
    is omitted from ``facts`` if it is not among the lowest computed modes.
    """
    e = [k for k, port in enumerate(model.ports) if port.electrical]
    force = [k for k, port in enumerate(model.ports) if port.domain is TRANSLATION][:1]
    solve = model.pencil.factorise_shifted_stiffness(-shift).solve
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
        """Compute the displacements under given forces while all electrodes are open.

        The forces ``f`` are multiplied by ``(K + b C0^-1 b')^-1``. The voltages of open electrodes
        are ``-C0^-1 b' u`` for the displacement u, the load b of 1 V and the clamped capacitance
        C0.
        """
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
    """Compute the static displacements under a unit load at each of the given ports.

    Return two arrays of shape (n, ports): the displacements for the shifted stiffness ``K + shift
    M``, and the displacements for the stiffness K.
    """
    load = model.B[:, ports]
    shifted = rest = solve(load) if ports else load
    # Loads on an unsupported body are in equilibrium, so the iteration converges to the static
    # displacements for the unshifted stiffness K.
    for _ in range(MAX_REFINEMENTS if shift else 0):
        rest = solve(load + shift * (model.M @ rest)) if ports else load
    return shifted, rest


def _find_resonance(
    model: LinearModel, solve: Operator, ports: list[int], shift: float
) -> tuple[float | None, np.ndarray, np.ndarray]:
    """Find the lowest resonance excited by ports; also return excited and rigid modes.

    Return the frequency [Hz] of the resonance, the modes that the ports excite, and the rigid-body
    modes. The modes are the columns of arrays with n rows. If the ports excite none of the lowest
    modes, the frequency is None. The Lanczos method starts from the static responses, and therefore
    finds only modes that the ports excite.
    """
    n, M = model.order, model.M
    inverse = LinearOperator((n, n), matvec=solve, dtype=float)
    ports = [k for k in ports if model.B[:, k].any()]
    none = rigid = np.empty((n, 0))
    if not ports:  # no port excites a mode, for example in a dielectric that is not piezoelectric
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
