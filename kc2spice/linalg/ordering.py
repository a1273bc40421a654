"""Fill-reducing order of sparse symmetric matrices: nested dissection by METIS in gmsh."""

from __future__ import annotations

import hashlib
import warnings

import numpy as np
import scipy

from kc2spice.core.errors import MissingToolError
from kc2spice.core.gmsh_session import gmsh_session

_LINE = 1  # gmsh's number of the element type with two nodes
_KEPT = 2  # orders: a reduction factorises matrices of one pattern, or of two
_orders: dict[bytes, np.ndarray | None] = {}


def nested_dissection(matrix: scipy.sparse.csc_array) -> np.ndarray | None:
    """Order ``p`` (n,) in which factors of ``matrix[p][:, p]`` stay sparse; None, with a warning,
    where gmsh is missing.

    Unknowns whose columns have the same pattern (those of one node) are kept together, so that the
    graph is that of the mesh. Only time and memory depend on the order, never a result's accuracy.
    Orders of the last patterns are kept.

    Source: G. Karypis, V. Kumar, SIAM J. Sci. Comput. 20 (1998) 359.
    """
    matrix = scipy.sparse.csc_array(matrix)
    pattern = hashlib.blake2b(matrix.indptr.tobytes())
    pattern.update(matrix.indices.tobytes())
    key = pattern.digest()
    if key not in _orders:
        _orders[key] = _dissected(matrix)
        for old in list(_orders)[:-_KEPT]:
            del _orders[old]
    return _orders[key]


def _dissected(matrix: scipy.sparse.csc_array) -> np.ndarray | None:
    group, first = _nodes(matrix)
    columns = scipy.sparse.coo_array(matrix[:, first])
    pairs = np.sort(np.column_stack([group[columns.row], columns.col]), axis=1).astype(np.int64)
    pairs = pairs[pairs[:, 0] != pairs[:, 1]]
    key = np.sort(pairs[:, 0] * first.size + pairs[:, 1])
    key = key[np.diff(key, prepend=-1) > 0]  # numpy's unique takes as long as METIS
    place = np.full(first.size, first.size)
    if key.size:
        try:
            old, new = _renumbered(np.column_stack([key // first.size, key % first.size]))
        except MissingToolError as error:
            warnings.warn(f"large matrices are factorised in a slower order: {error}", stacklevel=2)
            return None
        place[old] = new
    return np.argsort(place[group], kind="stable")


def _nodes(matrix: scipy.sparse.csc_array) -> tuple[np.ndarray, np.ndarray]:
    """Group of every unknown and the first unknown of each, by a hash of the columns' patterns."""
    words = np.random.default_rng(0).integers(0, 2**63, matrix.shape[0], dtype=np.uint64)
    total = np.r_[np.uint64(0), np.cumsum(words[matrix.indices], dtype=np.uint64)]
    mark = total[matrix.indptr[1:]] - total[matrix.indptr[:-1]]
    _, first, group = np.unique(mark, return_index=True, return_inverse=True)
    return group, first


def _renumbered(edges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nodes of a graph of ``edges`` (m, 2) and their places, from a mesh of lines."""
    nodes = int(edges.max()) + 1
    with gmsh_session("graph") as gmsh:
        gmsh.model.addDiscreteEntity(1, 1)
        gmsh.model.mesh.addNodes(1, 1, np.arange(1, nodes + 1), np.zeros(3 * nodes))
        numbers = np.arange(1, len(edges) + 1)
        gmsh.model.mesh.addElementsByType(1, _LINE, numbers, (edges + 1).ravel())
        old, new = gmsh.model.mesh.computeRenumbering("Metis")
    return np.asarray(old, dtype=np.int64) - 1, np.asarray(new, dtype=np.int64) - 1
