"""The catch actuator's field equations at one height of the sphere, from reusable pieces.

Only the lattice in the bore changes with the height: cells make way for the mover. What surrounds
the lattice is assembled once, and :func:`condense` even eliminates it once (substructuring; exact),
which leaves a quarter of the unknowns to each height.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import SuperLU, splu
from scipy.spatial import cKDTree

from kc2spice.core.errors import SimulationError
from kc2spice.fem.magnetics import forms as magforms
from kc2spice.fem.magnetics import mesh as magmesh
from kc2spice.fem.magnetics.forms import Body
from kc2spice.fem.magnetics.keys import Catch

_MAX_RESIDUAL = 1e-9
_COLUMNS = 64  # right-hand sides at a time in condense(): bounds its memory


@dataclass(frozen=True)
class System:
    """Equations at one height: ``matrix a = loads`` on the ``free`` unknowns."""

    matrix: sparse.csc_array
    loads: np.ndarray  # (n, 4)
    free: np.ndarray
    mover: np.ndarray
    stretch: sparse.csr_array

    def solve(self, loads: np.ndarray) -> np.ndarray:
        """Fields (n, k) of the loads (n, k).

        Raises
        ------
        SimulationError : the fields do not satisfy their equations.
        """
        a = np.zeros(loads.shape)
        a[self.free] = _checked_solve(_factorise(self.matrix), self.matrix, loads[self.free])
        return a

    def force(self, a: np.ndarray) -> np.ndarray:
        """Symmetric (k, k) [N]: fields ``a`` (n, k) of amplitudes q push with ``q' force q``."""
        near = a[self.mover]
        return -0.5 * near.T @ (self.stretch @ near)


@dataclass(frozen=True)
class Pieces:
    """All that does not depend on the sphere's height: stator, mover and how they join.

    ``energy`` (4, 4) is what the ``eliminated`` unknowns add to the products ``loads' a``.
    """

    stator: Body
    mover: Body
    stretch: sparse.csr_array  # force = -1/2 a' stretch a on the mover's unknowns
    lattice: np.ndarray  # stator elements that may make way
    surrounding: sparse.coo_array  # the others, on the stator's unknowns
    loads: np.ndarray  # (n_stator, 4)
    energy: np.ndarray
    eliminated: int
    rim: np.ndarray  # mover unknowns on its outline
    lookup: cKDTree  # of the stator's points
    bore: magmesh.Bore

    def system(self, y: float) -> System:
        """Equations with the sphere's centre at height ``y`` [m], a lattice point."""
        n_stator = self.stator.points.shape[1]
        mover = n_stator + np.arange(self.mover.points.shape[1])
        rim = self.mover.points[:, self.rim] + [[0], [y]]
        distance, mover[self.rim] = self.lookup.query(rim.T)
        if not np.max(distance) < 1e-6 * self.bore.pitch:
            raise SimulationError("mover and lattice do not fit", where="magnetics", got=f"y={y:g}")
        keep = self.lattice[np.abs(self.stator.centres[1, self.lattice] - y) > self.bore.half]
        inner, around = self.stator, self.surrounding
        rows = [inner.rows[:, keep].ravel(), mover[self.mover.rows].ravel(), around.row]
        cols = [inner.cols[:, keep].ravel(), mover[self.mover.cols].ravel(), around.col]
        data = [inner.local[:, keep].ravel(), self.mover.local.ravel(), around.data]
        n = n_stator + self.mover.points.shape[1]
        row = np.concatenate(rows)
        active = np.zeros(n, dtype=bool)
        active[row] = True
        free = np.flatnonzero(active)
        number = np.cumsum(active) - 1
        places = (number[row], number[np.concatenate(cols)])
        matrix = sparse.coo_array((np.concatenate(data), places), shape=(free.size, free.size))
        loads = np.zeros((n, 4))
        loads[:n_stator] = self.loads
        loads[mover] += self.mover.loads
        return System(matrix.tocsc(), loads, free, mover, self.stretch)


def assemble(catch: Catch, bore: magmesh.Bore) -> Pieces:
    """Mesh and assemble stator and mover for the lattice ``bore``."""
    mover_mesh, sphere = magmesh.mover_mesh(bore)
    stator = magforms.stator_body(catch, magmesh.stator_mesh(catch, bore))
    mover = magforms.mover_body(catch, mover_mesh, sphere)
    r, y = mover.points
    edge = 1e-6 * bore.pitch
    rim = np.flatnonzero((r > bore.wall - edge) | (np.abs(y) > bore.half - edge))
    r, y = stator.centres
    movable = (r < bore.wall) & (y > bore.bottom) & (y < bore.bottom + bore.rows * bore.pitch)
    return Pieces(
        stator=stator,
        mover=mover,
        stretch=magforms.force_form(
            mover_mesh, sphere, magforms.shell_weight(mover_mesh, sphere, rim)
        ),
        lattice=np.flatnonzero(movable),
        surrounding=_surrounding(catch, stator, np.flatnonzero(~movable)),
        loads=stator.loads,
        energy=np.zeros((4, 4)),
        eliminated=0,
        rim=rim,
        lookup=cKDTree(stator.points.T),
        bore=bore,
    )


def condense(pieces: Pieces) -> Pieces:
    """Eliminate the surrounding's unknowns that the lattice does not touch; exact.

    With ``o`` eliminated and ``b`` on the lattice's outline: ``S = K_bb - K_bo K_oo^-1 K_ob``,
    ``f_b - K_bo K_oo^-1 f_o`` and ``energy = f_o' K_oo^-1 f_o``.
    """
    k = pieces.surrounding.tocsc()
    touched = np.zeros(k.shape[0], dtype=bool)
    touched[pieces.surrounding.row] = True
    inside = np.zeros(k.shape[0], dtype=bool)
    inside[pieces.stator.rows[:, pieces.lattice]] = True
    o, b = np.flatnonzero(touched & ~inside), np.flatnonzero(touched & inside)
    k_oo, k_ob = k[o][:, o].tocsc(), k[o][:, b].tocsc()
    factors = _factorise(k_oo)
    outside = _checked_solve(factors, k_oo, pieces.loads[o])
    schur = k[b][:, b].toarray()
    for start in range(0, b.size, _COLUMNS):
        columns = slice(start, start + _COLUMNS)
        schur[:, columns] -= k_ob.T @ _checked_solve(factors, k_oo, k_ob[:, columns].toarray())
    schur = (schur + schur.T) / 2
    loads = pieces.loads.copy()
    loads[b] -= k_ob.T @ outside
    loads[o] = 0.0
    places = (np.repeat(b, b.size), np.tile(b, b.size))
    surrounding = sparse.coo_array((schur.ravel(), places), shape=k.shape)
    return replace(
        pieces,
        surrounding=surrounding,
        loads=loads,
        energy=pieces.loads[o].T @ outside,
        eliminated=o.size,
    )


def _surrounding(catch: Catch, stator: Body, elements: np.ndarray) -> sparse.coo_array:
    """Stiffness of ``elements`` without the unknowns on the air cylinder, where a = 0."""
    _, low, right, high = magmesh.air(catch)
    r, y = stator.points
    edge = 1e-9 * (high - low)
    free = (r < right - edge) & (y > low + edge) & (y < high - edge)
    row, col = stator.rows[:, elements].ravel(), stator.cols[:, elements].ravel()
    both = free[row] & free[col]
    entries = (stator.local[:, elements].ravel()[both], (row[both], col[both]))
    return sparse.coo_array(entries, shape=(r.size, r.size)).tocsr().tocoo()


def _factorise(matrix: sparse.csc_array) -> SuperLU:
    """Symmetric positive definite: minimum degree on A'+A and no pivoting."""
    options = {"SymmetricMode": True, "Equil": False}
    return splu(matrix, "MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)


def _checked_solve(factors: SuperLU, matrix: sparse.csc_array, loads: np.ndarray) -> np.ndarray:
    fields = factors.solve(loads)
    residual = np.linalg.norm(matrix @ fields - loads, axis=0)
    allowed = _MAX_RESIDUAL * np.linalg.norm(loads, axis=0)
    if not np.all(residual <= allowed):
        raise SimulationError(
            "the magnetic field does not satisfy its equations",
            where="magnetics",
            got=f"residual {np.max(residual):.1e}",
            expected=f"at most {np.max(allowed):.1e}",
        )
    return fields
