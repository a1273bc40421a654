"""Fields of a body as VTU, for ParaView and its like."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from skfem.mesh import MeshHex, MeshQuad, MeshTet

from kc2spice.bodies.device import Device
from kc2spice.bodies.fields import Probe, principal
from kc2spice.core.errors import MissingToolError
from kc2spice.fem.solid import Solid

_HEX_EDGES = ((0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5),
              (2, 6), (3, 7))  # fmt: skip
_HEX_FACES = ((0, 7), (1, 6), (0, 5), (3, 6), (0, 2), (4, 6))  # opposite corners


def write_vtu(path: Path, device: Device, z: np.ndarray, voltages: np.ndarray) -> None:
    """Displacement [m], potential [V], field [V/m], stress [Pa] and largest principal stress at
    the nodes of every element, as a VTU file of cells that share no points.

    Raises
    ------
    MissingToolError : meshio is not installed.
    """
    try:
        import meshio
    except ImportError as error:
        raise MissingToolError(
            "meshio cannot be loaded", where="fields", got=str(error), hint="pip install meshio"
        ) from error
    probe = Probe(device, gauss=False)
    fields = probe(z, voltages)
    mesh = device.solid.mesh
    where = np.moveaxis(mesh.mapping().F(device.solid.element.doflocs.T), 0, -1)
    where = where.reshape(-1, mesh.dim())
    if mesh.dim() == 2:
        where = np.column_stack([where[:, 0], np.zeros(len(where)), where[:, 1]])
    kind, order = _vtk(device.solid)
    cells = np.arange(len(where)).reshape(mesh.nelements, -1)[:, order]
    data = {
        "displacement": fields.displacement,
        "potential": fields.potential,
        "field": fields.field,
        "stress": fields.stress,
        "principal_stress": principal(fields.stress),
        "material": probe.owner.astype(float),
    }
    meshio.Mesh(where, [(kind, cells)], point_data=data).write(path, file_format="vtu")


def _vtk(solid: Solid) -> tuple[str, np.ndarray]:
    """meshio's name of the cell and the places of VTK's nodes among scikit-fem's."""
    mesh = solid.mesh
    if isinstance(mesh, MeshTet):
        return "tetra10", np.arange(10)
    if isinstance(mesh, MeshQuad):
        return "quad9", np.arange(9)
    if not isinstance(mesh, MeshHex):
        return "triangle6", np.arange(6)
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0],
                        [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]], float)  # fmt: skip
    middles = [corners[list(pair)].mean(axis=0) for pair in (*_HEX_EDGES, *_HEX_FACES)]
    wanted = np.vstack([corners, middles, [[0.5, 0.5, 0.5]]])[: 27 if solid.order == 2 else 8]
    order = np.argmin(np.abs(wanted[:, None] - solid.element.doflocs).sum(axis=-1), axis=1)
    return f"hexahedron{27 if solid.order == 2 else ''}", order
