"""Piezoelectric operators before and after their massless potentials are eliminated.

With displacements u (n), free potentials p (m) and electrode voltages V (k) against ground::

    M u'' + K_uu u + K_up p + k_uV V = f
            K_up' u - K_pp p - k_pV V = 0
        Q = c_VV V + k_pV' p - k_uV' u
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from kc2spice.core.errors import UsageError


@dataclass(frozen=True, repr=False)
class PiezoOperators:
    """What an FE assembly hands over: sparse, SI, of the whole device, supports already applied.

    Attributes
    ----------
    M, K_uu : (n, n) mass and stiffness at zero field.
    K_up, K_pp : (n, m) coupling and (m, m) permittivity of the free potentials.
    k_uV, k_pV, c_VV : (n, k), (m, k), (k, k) the same for the electrodes that have terminals.
    electrodes : names of these k electrodes.
    B : (n, p) force shapes of the mechanical ports; ``B' u`` are their displacements.
    parts : stiffness by block, whose sum is K_uu (for damping by material).
    mass : kg, without constraints.
    points : (n, 3) where each unknown sits, r, z [m], and its direction (0 radial, 1 axial).
    potential_points : (m, 2) r, z [m] of each free potential, nan for a floating electrode.
    """

    M: sparse.csc_array
    K_uu: sparse.csc_array
    K_up: sparse.csc_array
    K_pp: sparse.csc_array
    k_uV: np.ndarray
    k_pV: np.ndarray
    c_VV: np.ndarray
    electrodes: tuple[str, ...]
    B: np.ndarray
    parts: Sequence[sparse.csc_array]
    mass: float
    points: np.ndarray
    potential_points: np.ndarray

    def __repr__(self) -> str:
        n, m = self.K_up.shape
        return f"PiezoOperators({n} displacements, {m} potentials, {len(self.electrodes)} voltages)"

    @property
    def unknowns(self) -> int:
        """Displacements, free potentials and electrode voltages."""
        return sum(self.K_up.shape) + len(self.electrodes)


@dataclass(frozen=True, repr=False)
class Condensed:
    """``M u'' + K u = B f + b V``, ``Q = b' u + C0 V``: symmetric, potentials gone."""

    K: sparse.csc_array
    b: np.ndarray
    C0: np.ndarray


def condense_potentials(operators: PiezoOperators) -> Condensed:
    """Eliminate the free potentials exactly: the Schur complement of K_pp.

    ``K = K_uu + K_up K_pp^-1 K_up'``, ``b = K_up K_pp^-1 k_pV - k_uV``,
    ``C0 = c_VV - k_pV' K_pp^-1 k_pV``. K is dense among the displacements of the ceramic, which
    axisymmetric models afford (hundreds to a few thousand unknowns).

    Raises
    ------
    UsageError : a piece of ceramic touches no electrode, so that its potential is undetermined.
    """
    o = operators
    if o.K_pp.shape[0] == 0:
        return Condensed(o.K_uu, -o.k_uV, o.c_VV)
    _require_grounded(o.K_pp)
    factor = splu(o.K_pp)
    coupled = np.unique(o.K_up.indices)
    K_up = o.K_up[coupled].toarray()
    dense = K_up @ factor.solve(K_up.T.copy())
    places = [np.repeat(coupled, len(coupled)), np.tile(coupled, len(coupled))]
    added = sparse.coo_array(((dense + dense.T).ravel() / 2, places), shape=o.K_uu.shape)
    voltages = factor.solve(o.k_pV)
    C0 = o.c_VV - o.k_pV.T @ voltages
    return Condensed((o.K_uu + added).tocsc(), o.K_up @ voltages - o.k_uV, (C0 + C0.T) / 2)


def solver(
    operators: PiezoOperators, shift: float = 0.0, first: int = 0
) -> Callable[[np.ndarray], np.ndarray]:
    """``f -> (K - shift M)^-1 f`` without forming K: potentials stay in the sparse system.

    Displacements before the number ``first`` are held at zero (to hold a body that is free).
    """
    o = operators
    n = o.K_uu.shape[0]
    K_up = o.K_up[first:]
    whole = sparse.block_array(
        [[(o.K_uu - shift * o.M)[first:][:, first:], K_up], [K_up.T, -o.K_pp]], format="csc"
    )
    # Newtons and coulombs differ by twenty orders of magnitude: equilibrate before pivoting.
    scale = 1 / np.sqrt(np.abs(whole.diagonal()))
    equal = sparse.diags_array(scale)
    factor = splu((equal @ whole @ equal).tocsc())

    def solve(f: np.ndarray) -> np.ndarray:
        x, load = np.zeros(n), np.zeros(len(scale))
        load[: n - first] = f[first:]
        x[first:] = (scale * factor.solve(scale * load))[: n - first]
        return x

    return solve


def _require_grounded(K_pp: sparse.csc_array) -> None:
    """A piece whose constant potential stores no energy is tied to no electrode."""
    count, labels = connected_components(K_pp, directed=False)
    energy = np.bincount(labels, K_pp @ np.ones(K_pp.shape[0]), count)
    if np.any(energy < 1e-10 * np.bincount(labels, K_pp.diagonal(), count)):
        raise UsageError(
            "a ceramic touches no electrode: its potential is undetermined",
            hint="every piezoelectric layer needs an electrode on one face at least",
        )
