"""Correction of the mesh error of a body by additional cubic shape functions.

The cubic functions of :mod:`kc2spice.fem.enrichment` are added to the model ``S w = f`` of the
displacements and potentials w, where ``S = [[K, C], [C', -P]]``. For a static response w of the
mesh without the cubic functions, the residual is ``r = f - S w``. The correction e of this response
is the solution of ``S e = r``. From the correction e_v of the response to a voltage, and the
correction e_p of the response to a force, the corrections of capacitance, stroke and compliance are

    dC = e_v' S e_v,    d(stroke) = e_p' S e_v,    d(compliance) = e_p' S e_p.

All corrections are computed in one low-dimensional space (Galerkin, Rayleigh-Ritz). The corrected
frequency of a mode is the frequency of the eigenvector in this space that is nearest to the mode.
In each round, solutions for the residuals extend the low-dimensional space. Each round solves first
for the coefficients of the cubic functions alone, and then for the unknowns of the mesh alone. If a
support or electrode fixes all nodes of an edge or face, it also fixes the cubic functions of this
edge or face. Loads on the cubic functions are neglected. Sources: R. E. Bank and R. K. Smith, SIAM
J. Numer. Anal. 30 (1993) 921; R. Becker and R. Rannacher, Acta Numerica 10 (2001) 1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import linalg, sparse

from kc2spice.bodies.undamped_models import FiniteElementModel, UndampedResponses
from kc2spice.fem.enrichment import (
    EnrichedOperators,
    Enrichment,
    assemble_enrichment,
    make_enrichment,
)
from kc2spice.linalg.factor import Factor, factorise, make_indefinite_error
from kc2spice.rom.pencil import SchurComplement

# Largest number of rounds of the iteration. Each round first computes corrections with the
# additional shape functions only, then corrections with the unknowns of the mesh only.
MAX_ROUNDS = 4
# the iteration ends after a round in which the relative change of the corrections is at most this
CONVERGED_CHANGE = 0.1
# A vector is omitted from a basis if less than this share of it is outside of the basis's span.
DEPENDENCE_LIMIT = 1e-8

# displacements and potentials of solutions, or forces and charges; one column for each solution
Pair = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True, eq=False)
class Corrections:
    """Corrections of modes and static responses due to additional shape functions.

    ``frequencies`` contains the relative frequency change of each mode, an array of shape (k,).
    ``products`` contains the energy product ``e_i' S e_j`` of the corrections of each pair of
    static responses, an array of shape (a, a).
    """

    frequencies: np.ndarray
    products: np.ndarray

    def is_near(self, other: Corrections) -> bool:
        """Return whether two corrections of modes and static responses are nearly equal."""
        pairs = (
            (self.frequencies, other.frequencies),
            (np.diag(self.products), np.diag(other.products)),
        )
        return all((np.abs(a - b) <= CONVERGED_CHANGE * np.abs(a)).all() for a, b in pairs)


def correct_responses(
    device: FiniteElementModel,
    answers: UndampedResponses,
    sectors: int = 1,
    rounds: int = MAX_ROUNDS,
) -> Corrections:
    """Correct modes and static responses of a mesh by additional shape functions.

    The static responses are responses to voltages and to a force. In ``products`` of the returned
    object, the responses to voltages precede the response to a force. The body consists of
    ``sectors`` equal solids, of which one is meshed. ``rounds`` is the largest number of rounds of
    the iteration.
    """
    model, modes = enrich_model(device, answers.solve, sectors), answers.modes
    z = np.hstack([modes, answers.static, answers.pushed])
    k, volts = modes.shape[1], answers.static.shape[1]
    voltages = np.zeros((volts, z.shape[1]))
    voltages[:, k : k + volts] = np.eye(volts)
    shapes, residuals = model.extend_responses(z, voltages)
    static = residuals[0][:, k:], residuals[1][:, k:]
    functions = np.zeros((len(shapes[0]) - len(z), answers.rigid.shape[1]))
    space = _CorrectionSpace(
        model, np.vstack([answers.rigid, functions]), (shapes[0][:, :k], shapes[1][:, :k])
    )
    initial = space.solve_ritz()[0]
    result = None
    for _ in range(rounds):
        for solve in (model.solve_coefficients, model.solve_mesh):
            space.extend(solve(space.compute_residuals(static)))
        before, result = result, space.compute_corrections(initial, static)
        if before is not None and result.is_near(before):
            break
    assert result is not None
    return result


class BlockMatrix(NamedTuple):
    """Matrix of four sparse blocks, for mesh unknowns and additional shape functions.

    The first rows and columns of the matrix are for the unknowns of the mesh. The last rows and
    columns of the matrix are for the coefficients of the additional shape functions.
    """

    mesh: sparse.sparray
    right: sparse.sparray
    left: sparse.sparray
    functions: sparse.sparray

    @property
    def T(self) -> BlockMatrix:
        """Transpose of the matrix, as four blocks."""
        return BlockMatrix(self.mesh.T, self.left.T, self.right.T, self.functions.T)

    def __matmul__(self, x: np.ndarray) -> np.ndarray:
        above, below = np.vsplit(x, [self.mesh.shape[1]])
        top = self.mesh @ above + self.right @ below
        return np.vstack([top, self.left @ above + self.functions @ below])


@dataclass(frozen=True, eq=False)
class EnrichedModel:
    """Finite-element model with additional cubic shape functions.

    The docstring of the module defines the matrices K, C and P. M is the mass matrix.

    ``operators`` are the matrices of the additional shape functions. ``factors`` are the factorised
    blocks of K and P of the additional shape functions; a factor is None if its block is empty. The
    function ``solve_shifted`` multiplies vectors by ``(K + shift M)^-1``, where K and M are the
    matrices of the mesh without the additional shape functions.
    """

    device: FiniteElementModel
    operators: EnrichedOperators
    K: BlockMatrix
    C: BlockMatrix
    P: BlockMatrix
    M: BlockMatrix
    factors: tuple[Factor | None, Factor | None]
    solve_shifted: Callable[[np.ndarray], np.ndarray]

    def extend_responses(self, z: np.ndarray, voltages: np.ndarray) -> tuple[Pair, Pair]:
        """Extend responses by zeros for added shape functions, and compute the residuals.

        The additional shape functions have the coefficient zero in the extended responses. ``z`` of
        shape (n, k) contains the responses of the mesh under the ``voltages`` of shape (e, k).
        Return two pairs of arrays with k columns. The first pair of arrays contains the
        displacements and potentials of the responses; its rows for the additional shape functions
        are zero. The second pair of arrays contains the residuals of the equations of displacements
        and potentials.
        """
        K, lift = self.device.model.K, self.device.lift @ voltages
        p = np.zeros((self.P.mesh.shape[0], z.shape[1]))
        if isinstance(K, SchurComplement):  # the block ``pp`` of K is the matrix -P
            load = K.pu @ z
            p = -K.inner_factor.solve(load + lift if len(lift) else load)
        (u, phi), more = self.device.compute_nodal_values(z, voltages), self.operators
        r_u = -(more.K_nodes @ u + more.C_nodes @ phi)
        r_p = -(more.D_nodes @ u - more.P_nodes @ phi)
        zeros = 0.0 * r_u, 0.0 * r_p
        shapes = np.vstack([z, zeros[0]]), np.vstack([p, zeros[1]])
        return shapes, (np.vstack([0.0 * z, r_u]), np.vstack([0.0 * p, r_p]))

    def solve_coefficients(self, residual: Pair) -> Pair:
        """Solve for the coefficients of added shape functions; all mesh unknowns are zero."""
        (z, r_u), (q, r_p) = self._split_blocks(residual)
        (of_u, of_p), C = self.factors, self.operators.C
        u, p = of_u.solve(r_u) if of_u else r_u, r_p
        if of_p:
            p = of_p.solve(C.T @ u - r_p)
            u = of_u.solve(r_u - C @ p) if of_u else u
        return np.vstack([0.0 * z, u]), np.vstack([0.0 * q, p])

    def solve_mesh(self, residual: Pair) -> Pair:
        """Solve for the mesh unknowns; all coefficients of added shape functions are zero."""
        ((z, more_u), (q, more_p)), K = self._split_blocks(residual), self.device.model.K
        if isinstance(K, SchurComplement):
            q = K.inner_factor.solve(q)
            z = self.solve_shifted(z - K.up @ q)
            q = q - K.inner_factor.solve(K.pu @ z)
        else:
            z = self.solve_shifted(z)
        return np.vstack([z, 0.0 * more_u]), np.vstack([q, 0.0 * more_p])

    def _split_blocks(self, pair: Pair) -> list[list[np.ndarray]]:
        """Split displacements and potentials into mesh rows and rows of added functions."""
        counts = self.K.mesh.shape[0], self.P.mesh.shape[0]
        return [np.vsplit(part, [count]) for part, count in zip(pair, counts, strict=True)]


def enrich_model(
    device: FiniteElementModel,
    solve_shifted: Callable[[np.ndarray], np.ndarray],
    sectors: int = 1,
) -> EnrichedModel:
    """Add cubic shape functions to the finite-element model of a solid.

    The function ``solve_shifted`` multiplies vectors by ``(K + shift M)^-1``, where K and M are the
    matrices of the mesh without the additional shape functions. The device consists of ``sectors``
    equal solids, of which one is meshed.
    """
    model, enrichment = device.model, make_enrichment(device.solid)
    more = assemble_enrichment(enrichment, *_find_free_functions(device, enrichment)).scale(sectors)
    K, C, P = _get_mesh_blocks(model.K)
    to_u, to_phi = device.displacement, device.potential
    # The auxiliary unknown that is eliminated from a free sphere's model is not an electric
    # potential.
    # Therefore, the matrix from the auxiliary unknown to the nodal potentials is zero.
    if to_phi.shape[1] != P.shape[0]:
        to_phi = sparse.csc_array((to_phi.shape[0], P.shape[0]))
    k, m, p = more.K_nodes @ to_u, more.M_nodes @ to_u, more.P_nodes @ to_phi
    return EnrichedModel(
        device,
        more,
        BlockMatrix(K, k.T, k, more.K),
        BlockMatrix(C, (more.D_nodes @ to_u).T, more.C_nodes @ to_phi, more.C),
        BlockMatrix(P, p.T, p, more.P),
        BlockMatrix(model.M, m.T, m, more.M),
        (_factorise(more.K), _factorise(more.P)),
        solve_shifted,
    )


def _get_mesh_blocks(K: SchurComplement | sparse.csc_array) -> tuple[sparse.csc_array, ...]:
    """Return the elastic, coupling and dielectric blocks of a stiffness matrix.

    The docstring of the module defines these blocks as K, C and P.
    """
    if isinstance(K, SchurComplement):
        return K.uu, K.up, -K.pp
    return K, sparse.csc_array((K.shape[0], 0)), sparse.csc_array((0, 0))


def _factorise(matrix: sparse.csr_array) -> Factor | None:
    """Factorise a sparse matrix; return None if the matrix is empty."""
    return factorise(sparse.csc_array(matrix), definite=True) if matrix.shape[0] else None


def _find_free_functions(
    device: FiniteElementModel, enrichment: Enrichment
) -> tuple[np.ndarray, np.ndarray]:
    """Return masks of the additional shape functions that are free unknowns.

    The first returned mask is for displacements and has the shape (functions, d). The second
    returned mask is for potentials and has the shape (functions,).
    """
    solid, count = device.solid, enrichment.function_count
    nodes = solid.basis(1).element_dofs
    free_nodes = _mask_separate_unknowns(device.displacement).reshape(-1, solid.component_count)
    electrode = _number_electrodes(device)
    free, live = (
        np.ones((count, solid.component_count), bool),
        enrichment.mask_dielectric_functions(),
    )
    for numbers, local in zip(enrichment.numbers, enrichment.nodes, strict=True):
        on = electrode[nodes[local]]
        free[numbers] &= free_nodes[nodes[local]].any(axis=0)
        live[numbers] &= (on < 0).any(axis=0) | (on != on[0]).any(axis=0)
    return free, live


def _mask_separate_unknowns(prolongation: sparse.csc_array) -> np.ndarray:
    """Return a mask of the nodal values that are independent unknowns of the model.

    ``prolongation`` is the matrix that maps the unknowns of the model to nodal values.
    """
    rows = sparse.csr_array(prolongation)
    counts = np.diff(sparse.csc_array(prolongation).indptr)
    result = np.diff(rows.indptr) == 1
    result[result] = counts[rows.indices[rows.indptr[:-1][result]]] == 1
    return result


def _number_electrodes(device: FiniteElementModel) -> np.ndarray:
    """Return the electrode number of each node, an array of shape (nodes,).

    The electrode number is -1 at nodes with a free potential.
    """
    rows = sparse.csr_array(device.potential)
    column = np.full((rows.shape[0], 1), -1.0)
    tied = np.diff(rows.indptr) == 1
    column[tied, 0] = rows.indices[rows.indptr[:-1][tied]]
    table = np.hstack([column, device.drive.toarray()])
    return np.where(
        _mask_separate_unknowns(device.potential),
        -1,
        np.unique(table, axis=0, return_inverse=True)[1],
    )


class _CorrectionSpace:
    """Subspaces of displacements and potentials in which mesh errors are corrected.

    The basis vectors of both spaces are orthonormal. The first basis vectors span the ``rigid``
    modes and the ``shapes`` of the other modes. The products of the basis vectors with K, M, C and
    P are stored.
    """

    def __init__(self, model: EnrichedModel, rigid: np.ndarray, shapes: Pair) -> None:
        self.model, self.modes = model, shapes[0]
        self.u, self.p = (part[:, :0] for part in shapes)
        self.Ku, self.Mu, self.Cu = self.u, self.u, self.p
        self.Cp, self.Pp = self.u, self.p
        self.extend((rigid, self.p))
        self.rigid = self.u.shape[1]
        self.extend(shapes)

    def extend(self, parts: Pair) -> None:
        """Add displacement and potential vectors to the bases of the two subspaces."""
        model = self.model
        u, p = _orthonormalise(self.u, parts[0]), _orthonormalise(self.p, parts[1])
        self.u, self.p = np.hstack([self.u, u]), np.hstack([self.p, p])
        self.Mu = np.hstack([self.Mu, model.M @ u])
        self.Ku = np.hstack([self.Ku, model.K @ u])
        self.Cu = np.hstack([self.Cu, model.C.T @ u])
        self.Cp, self.Pp = np.hstack([self.Cp, model.C @ p]), np.hstack([self.Pp, model.P @ p])

    def solve_ritz(self) -> tuple[np.ndarray, Pair]:
        """Compute the corrected eigenvalues of the modes by the Rayleigh-Ritz method.

        Return the eigenvalues of shape (k,), and the weights of the basis vectors in the
        eigenvectors. The weights are two arrays with k columns each, for displacements and for
        potentials.
        """
        if not self.modes.size:
            return np.zeros(0), (self.u.T[:, :0], self.p.T[:, :0])
        C, P = self.u.T @ self.Cp, self.p.T @ self.Pp
        X = solve_definite(P, C.T)
        K, M = self.u.T @ self.Ku + C @ X, self.u.T @ self.Mu
        values, vectors = linalg.eigh((K + K.T) / 2, (M + M.T) / 2)
        overlap = np.abs(vectors.T @ (self.Mu.T @ self.modes))
        nearest = overlap.argmax(axis=0)
        return values[nearest], (vectors[:, nearest], X @ vectors[:, nearest])

    def solve_galerkin(self, loads: Pair) -> Pair:
        """Compute the corrections of static responses by the Galerkin method.

        Return the weights of the basis vectors of displacements and of potentials, with one column
        for each load. The ``loads`` are residuals. The loads must not accelerate the body as a
        rigid body.
        """
        elastic = self.u[:, self.rigid :]
        r_u, r_p = elastic.T @ loads[0], self.p.T @ loads[1]
        C, P = elastic.T @ self.Cp, self.p.T @ self.Pp
        X, y = solve_definite(P, C.T), solve_definite(P, r_p)
        K = elastic.T @ self.Ku[:, self.rigid :] + C @ X
        u = solve_definite(K, r_u + C @ y)
        return np.vstack([np.zeros((self.rigid, u.shape[1])), u]), X @ u - y

    def compute_corrections(self, eigenvalues: np.ndarray, loads: Pair) -> Corrections:
        """Compute corrections of modes and static responses due to added shape functions.

        ``eigenvalues`` are the eigenvalues of the modes before the correction. ``loads`` are the
        residuals of the static responses.
        """
        u, p = self.solve_galerkin(loads)
        products = loads[0].T @ (self.u @ u) + loads[1].T @ (self.p @ p)
        return Corrections(np.sqrt(self.solve_ritz()[0] / eigenvalues) - 1, products)

    def compute_residuals(self, loads: Pair) -> Pair:
        """Compute the residuals of the corrected modes and static responses."""
        values, (mode_u, mode_p) = self.solve_ritz()
        u, p = self.solve_galerkin(loads)
        return (
            np.hstack([
                (self.Mu @ mode_u) * values - self.Ku @ mode_u - self.Cp @ mode_p,
                loads[0] - self.Ku @ u - self.Cp @ p,
            ]),
            np.hstack([
                self.Pp @ mode_p - self.Cu @ mode_u, loads[1] - self.Cu @ u + self.Pp @ p
            ]),
        )  # fmt: skip


_UNITS_HINT = "check the units of the materials: the constants of one material differ too much"


def solve_definite(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve a linear system with a symmetric positive definite matrix.

    Raises
    ------
    SimulationError : the matrix is not positive definite.
    """
    if not matrix.size:
        return right
    try:
        factor = linalg.cho_factor((matrix + matrix.T) / 2)
    except linalg.LinAlgError as error:
        raise make_indefinite_error(str(error), _UNITS_HINT) from error
    return np.asarray(linalg.cho_solve(factor, right))


def _orthonormalise(basis: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Compute an orthonormal basis of ``columns`` that is orthogonal to ``basis``."""
    size = np.linalg.norm(columns, axis=0)
    rest = columns[:, size > 0] / size[size > 0]
    for _ in range(2):
        rest = rest - basis @ (basis.T @ rest)
    if not rest.size:
        return rest
    Q, R, _ = linalg.qr(rest, mode="economic", pivoting=True)
    return np.asarray(Q[:, np.abs(np.diag(R)) > DEPENDENCE_LIMIT])
