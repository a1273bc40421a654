"""Block Krylov subspace at one expansion point, s0 = 0.

The basis of a larger order contains the bases of all smaller orders. The static responses to all
ports are exact. For a model with definite matrices, each block of vectors matches two moments.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from kc2spice.rom.definiteness import is_definite
from kc2spice.rom.intermediate_model import IntermediateModel
from kc2spice.rom.pencil import Pencil
from kc2spice.rom.reduced_basis import ReducedBasis, ReductionTask
from kc2spice.rom.reductors.base import Reductor
from kc2spice.rom.response import Response

# Number of additional blocks for the error estimate, found by trials. The change of the response by
# the second additional block shows whether the first was sufficient.
EXTRA_BLOCKS = 2
# Ratio of the number of Krylov vectors to the number of states of the intermediate model. The ratio
# was found by trials. The intermediate model may have several expansion points.
VECTORS_PER_STATE = 2
# largest part of a dependent vector outside of the span of the basis, relative to its length
DEFLATION_LIMIT = 1e-10
Operator = Callable[[np.ndarray], np.ndarray]


class BlockKrylov(Reductor):
    """Block Krylov vectors at zero frequency, orthonormal in the inner product of K.

    The vectors span ``{X, A X, A^2 X, ...}`` with ``X = K^-1 B`` and ``A = K^-1 M`` (equations 6
    and 7 of the reference). The matrix K must be definite, and damping must be proportional or
    zero.

    Examples
    --------
    With one vector for one port, the static compliance of four springs of 2000 N/m in series is
    exact.

    >>> import numpy as np
    >>> import kc2spice as kc
    >>> K = 2e3 * (np.diag([2.0, 2, 2, 1]) - np.eye(4, k=1) - np.eye(4, k=-1))
    >>> chain = kc.LinearModel(M=1e-3 * np.eye(4), K=K, B=np.eye(4)[:, 3:])
    >>> rom = kc.reduce(chain, order=1, band=(0, 100), method="block Krylov")
    >>> print(f"{rom.transfer([0.0])[0, 0, 0].real:.9f} m/N")
    0.002000000 m/N
    """

    name = "block Krylov"
    reference = "Schütz, Maeter and Bechtold, Actuators 10 (2021) 279, section 2.3"

    def obstacle(self, task: ReductionTask) -> str:
        """Explain why the method does not apply to the model; return "" if it applies.

        The method needs a positive definite K, and proportional or no damping.
        """
        if is_definite(pencil := task.pencil, undamped_too=True):
            return ""
        if pencil.degree == 1:
            return "the model is of first order"
        if not task.is_collocated:
            return "its matrices are not symmetric, or C is not the transpose of B"
        if pencil.rayleigh is None and not pencil.is_undamped:
            return "its damping is not proportional to mass and stiffness"
        return "its stiffness matrix is not positive definite"

    def basis(self, task: ReductionTask) -> ReducedBasis:
        """Return the basis of Krylov vectors, with the projected full-order model."""
        # if the order is prescribed, the intermediate model already contains the Krylov basis
        if not task.intermediate.proof:
            V = task.intermediate.basis
            return ReducedBasis(task, task.intermediate.pencil, vectors=V, coordinates="full order")
        V = compute_krylov_vectors(task.pencil, VECTORS_PER_STATE * task.intermediate.pencil.size)
        return ReducedBasis(task, task.pencil.project(V), vectors=V, coordinates="full order")


def make_krylov_space(pencil: Pencil) -> BlockArnoldi:
    """Return the block Krylov subspace of a definite model at zero frequency."""
    K, _, M = pencil.coefficients
    solve = pencil.factorise_shifted_stiffness(0.0).solve
    return BlockArnoldi(lambda v: K @ v, solve, lambda v: M @ v, pencil.B)


def compute_krylov_vectors(pencil: Pencil, count: int) -> np.ndarray:
    """Return at most ``count`` block Krylov vectors of a definite model.

    The expansion point of the Krylov subspace is zero frequency.
    """
    return make_krylov_space(pencil).vectors(count)


def make_nested_model(
    pencil: Pencil, order: int, space: BlockArnoldi | None = None
) -> IntermediateModel:
    """Make a larger Krylov model whose basis contains the basis of order ``order``.

    The larger model serves as a reference for error estimates. ``space`` is the Krylov subspace of
    the model, if already known.
    """
    count = order + EXTRA_BLOCKS * pencil.B.shape[1]
    V = (space or make_krylov_space(pencil)).vectors(count)
    response = Response(pencil.project(V))
    return IntermediateModel(response, 0.0, True, "", basis=V, points=(0.0,))


def compute_block_krylov_basis(
    stiffness: Operator, solve: Operator, mass: Operator, B: np.ndarray, order: int
) -> np.ndarray:
    """Compute a K-orthonormal block Krylov basis of ``span{X, AX, A^2 X, ...}``.

    Here ``X = K^-1 B`` and ``A = K^-1 M``. The basis V has the shape (n, order), and
    ``V'KV = 1``. See :class:`BlockArnoldi`.
    """
    return BlockArnoldi(stiffness, solve, mass, B).vectors(order)


class BlockArnoldi:
    """Nested K-orthonormal block Krylov bases of ``span{X, AX, A^2 X, ...}``.

    Here ``X = K^-1 B`` and ``A = K^-1 M``. All bases satisfy ``V'KV = 1``. The first q columns of
    V are the basis of order q. The columns of a block are in the order of the ports. The last block
    may be incomplete. The first block contains the static responses to all ports. A one-sided
    projection matches two moments per block.
    """

    def __init__(self, stiffness: Operator, solve: Operator, mass: Operator, B: np.ndarray) -> None:
        self._solve, self._mass = solve, mass
        self._basis = OrthonormalBasis(stiffness, B.shape[0])
        # right-hand sides of the equations for the next block, empty after the last block
        self._right_sides: np.ndarray = B

    def vectors(self, count: int) -> np.ndarray:
        """Return the first ``count`` basis vectors, or all vectors if there are fewer."""
        while self._basis.vectors.shape[1] < count and self._right_sides.shape[1]:
            columns, _ = self._basis.extend(self._solve(self._right_sides))
            self._right_sides = self._mass(columns)
        return self._basis.vectors[:, :count]


class OrthonormalBasis:
    """Growing basis V (n, k) with ``V'KV = 1``, and the stored products ``K V``.

    Inner products ``V'K x`` use the stored products ``K V`` instead of new products with K.

    Examples
    --------
    >>> basis = OrthonormalBasis(lambda v: 4 * v, 3)
    >>> columns, images = basis.extend(np.array([[3.0, 3.0], [4.0, 4.0], [0.0, 0.0]]))
    >>> columns.T  # the second column depends on the first
    array([[0.3, 0.4, 0. ]])
    """

    def __init__(self, stiffness: Operator, size: int) -> None:
        self._stiffness = stiffness
        self._vectors, self._images = (np.empty((size, 0), order="F") for _ in range(2))
        self._count = 0

    @property
    def vectors(self) -> np.ndarray:
        """Basis vectors V (n, k), orthonormal in the stiffness matrix: ``V'KV = 1``."""
        return self._vectors[:, : self._count]

    @property
    def stiffness_products(self) -> np.ndarray:
        """Products ``K V`` (n, k) of the stiffness matrix and the basis vectors."""
        return self._images[:, : self._count]

    def extend(self, candidates: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Add vectors to the basis; return the new columns of V and of ``K V``.

        The vectors ``candidates`` (n, m) are first made orthonormal. Candidates that depend
        linearly on earlier vectors are omitted.
        """
        lengths = np.sqrt(np.einsum("ki,ki->i", candidates, self._stiffness(candidates)))
        # One matrix product for the whole block is much faster than one product for each column.
        candidates = candidates - self.vectors @ (self.stiffness_products.T @ candidates)
        self._reserve_columns(candidates.shape[1])
        old = self._count
        for vector, length in zip(candidates.T, lengths, strict=True):
            for first in (old, 0):  # two orthogonalisation passes are enough (Kahan and Parlett)
                V, KV = self.vectors[:, first:], self.stiffness_products[:, first:]
                vector = vector - V @ (KV.T @ vector)
            image = self._stiffness(vector)
            remaining = np.sqrt(max(vector @ image, 0.0))
            if remaining > DEFLATION_LIMIT * length:
                self._vectors[:, self._count] = vector / remaining
                self._images[:, self._count] = image / remaining
                self._count += 1
        return self.vectors[:, old:], self.stiffness_products[:, old:]

    def append(self, vectors: np.ndarray) -> None:
        """Append ``vectors`` (n, m), which are already orthonormal, to the basis."""
        self._reserve_columns(vectors.shape[1])
        both = slice(self._count, self._count + vectors.shape[1])
        self._vectors[:, both], self._images[:, both] = vectors, self._stiffness(vectors)
        self._count = both.stop

    def _reserve_columns(self, count: int) -> None:
        """Allocate memory for ``count`` more columns, and at least double the capacity."""
        if self._count + count <= self._vectors.shape[1]:
            return
        shape = len(self._vectors), 2 * self._count + count
        larger = np.empty((2, *shape[::-1])).swapaxes(1, 2)
        larger[:, :, : self._count] = self.vectors, self.stiffness_products
        self._vectors, self._images = larger
