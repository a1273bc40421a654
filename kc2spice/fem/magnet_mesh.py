"""Two meshes of the catch actuator's half plane (r, y) that fit together at every position.

Remeshing for each position of the sphere would cost time and add noise to the force. Here the
sphere lives in a box (the *mover*) that is meshed once, mirrored about its equator; the rest (the
*stator*) is meshed once too, with a regular lattice in the bore. The mover's outline has the
lattice's nodes, so it replaces lattice cells wherever the sphere stands on a lattice point.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType

import numpy as np
from skfem import MeshTri, MeshTri2

from kc2spice.core.errors import wrong
from kc2spice.core.gmsh_session import gmsh_session
from kc2spice.fem.magnet_keys import Catch, Ring

# Mesh sizes at refine = 1 as fractions of the sphere's radius, and growth per distance. They put
# the force within 1e-5 of its maximum. The parts' surroundings matter most: an uneven mesh in the
# far field of the sphere makes it push itself.
_LATTICE, _SPHERE, _PART, _CORNER, _GROWTH = 1 / 8, 1 / 8, 1 / 10, 1 / 16, 0.12


@dataclass(frozen=True)
class Bore:
    """The regular lattice that the sphere moves in; lengths in m.

    ``bottom`` is the lattice's lowest line and ``rows`` its number of cells of height ``pitch``;
    ``columns`` cells reach from the axis to ``wall``. The mover spans ``half`` up and down from the
    sphere's centre. ``size`` is the mesh size that 1 stands for in the fractions above.
    """

    radius: float
    wall: float
    pitch: float
    columns: int
    half: float
    bottom: float
    rows: int
    size: float


def parts(catch: Catch) -> tuple[Ring, Ring, Ring]:
    """Ring magnet, lower coil, upper coil."""
    return catch.ring, catch.lower, catch.upper


def rectangle(part: Ring) -> tuple[float, float, float, float]:
    """Section of a part: r_min, y_min, r_max, y_max [m]."""
    return part.inner, part.y - part.height / 2, part.outer, part.y + part.height / 2


def air(catch: Catch) -> tuple[float, float, float, float]:
    """Section of the air cylinder, centred on the actuator's parts (paper 2.2.1)."""
    boxes = [rectangle(part) for part in parts(catch)]
    low, high = min(box[1] for box in boxes), max(box[3] for box in boxes)
    if high - low >= catch.air_height:
        expected = f"more than {high - low:g} m, several times that for a small error"
        problem = "the air cylinder is lower than what stands in it"
        raise wrong("catch.air_height", problem, f"{catch.air_height:g} m", expected)
    centre = (low + high) / 2
    return 0.0, centre - catch.air_height / 2, catch.air_radius, centre + catch.air_height / 2


def lattice_pitch(catch: Catch, radius: float, spacing: float) -> float:
    """Cell height [m] near the wanted size that ``spacing`` is a multiple, or a divisor, of."""
    wanted = min(_LATTICE * radius, _gap(catch, radius)) / catch.refine
    ratio = spacing / wanted
    return spacing / math.ceil(ratio) if ratio >= 1 else spacing * math.floor(1 / ratio)


def bore(catch: Catch, radius: float, pitch: float, lowest: float, highest: float) -> Bore:
    """Lattice on which ``lowest`` and ``highest`` are the outermost centres of the sphere.

    Raises
    ------
    UsageError : the sphere leaves the air cylinder.
    """
    gap = _gap(catch, radius)
    wall = radius + gap / 2
    half = pitch * math.ceil(wall / pitch)
    bottom, top = lowest - half, highest + half
    _, floor, _, ceiling = air(catch)
    if bottom <= floor + pitch or top >= ceiling - pitch:
        expected = f"within {floor + half + pitch:g} m to {ceiling - half - pitch:g} m"
        hint = "shorten the travel or raise catch.air_height"
        problem = "the sphere's travel leaves the air cylinder"
        got = f"{lowest:g} m to {highest:g} m"
        raise wrong("catch.y_min, catch.y_max", problem, got, expected, hint)
    size = radius / catch.refine
    columns = math.ceil(wall / (_LATTICE * size))
    return Bore(radius, wall, pitch, columns, half, bottom, round((top - bottom) / pitch), size)


def stator_mesh(catch: Catch, bore: Bore) -> MeshTri2:
    """Whole half plane without a sphere: free triangles around the bore's lattice."""
    top = bore.bottom + bore.rows * bore.pitch
    boxes = [rectangle(part) for part in parts(catch)]
    shapes = [air(catch), (0.0, bore.bottom, bore.wall, top), *boxes]
    corners = [(r, y) for box in boxes for r in box[::2] for y in box[1::2]]

    def size(r: float, y: float) -> float:
        to_corner = min(math.hypot(r - a, y - b) for a, b in corners)
        to_part = min(
            math.hypot(max(a - r, 0.0, r - c), max(b - y, 0.0, y - d)) for a, b, c, d in shapes[1:]
        )
        near = min(_CORNER * bore.size + _GROWTH * to_corner, _PART * bore.size)
        return near + _GROWTH * to_part / catch.refine

    with gmsh_session("stator") as gmsh:
        occ = gmsh.model.occ
        plates = [(2, occ.addRectangle(a, b, 0, c - a, d - b)) for a, b, c, d in shapes]
        _, made = occ.fragment(plates[:1], plates[1:])
        occ.synchronize()
        lattice = made[1][0]
        for _, curve in gmsh.model.getBoundary([lattice], oriented=False):
            _, low, _, _, high, _ = gmsh.model.getBoundingBox(1, curve)
            cells = bore.rows if high - low > bore.pitch / 2 else bore.columns
            gmsh.model.mesh.setTransfiniteCurve(curve, cells + 1)
        gmsh.model.mesh.setTransfiniteSurface(lattice[1], "AlternateLeft")
        points, triangles = _generate(gmsh, size)
    return MeshTri2.from_mesh(MeshTri(points, triangles))


def mover_mesh(bore: Bore) -> tuple[MeshTri2, np.ndarray]:
    """Box around a sphere centred at the origin, and a mask of its triangles inside the sphere.

    Edges of the sphere's surface are arcs: their mid-nodes lie on the circle.
    """
    outline = [(0, 0), (bore.radius, 0), (bore.wall, 0), (bore.wall, bore.half)]
    outline += [(0, bore.half), (0, bore.radius)]
    with gmsh_session("mover") as gmsh:
        geo = gmsh.model.geo
        p = [geo.addPoint(r, y, 0) for r, y in outline]
        lines = [geo.addLine(p[i], p[(i + 1) % 6]) for i in range(6)]
        arc = geo.addCircleArc(p[1], p[0], p[5])
        geo.addPlaneSurface([geo.addCurveLoop([lines[0], arc, lines[5]])])
        geo.addPlaneSurface([geo.addCurveLoop([*lines[1:5], -arc])])
        geo.synchronize()
        gmsh.model.mesh.setTransfiniteCurve(lines[2], round(bore.half / bore.pitch) + 1)
        gmsh.model.mesh.setTransfiniteCurve(lines[3], bore.columns + 1)
        points, triangles = _generate(gmsh, lambda r, y: _SPHERE * bore.size)
    flat = _mirrored(points, triangles)
    mesh = MeshTri2.from_mesh(flat)
    inside = np.hypot(*flat.p[:, flat.t].mean(axis=1)) < bore.radius * (1 - 1e-9)
    inside &= (np.hypot(*flat.p)[flat.t] <= bore.radius * (1 + 1e-9)).all(axis=0)
    left, right = flat.f2t
    surface = (right >= 0) & (inside[left] != inside[np.maximum(right, 0)])
    middle = mesh.dofs.facet_dofs[0, surface]
    mesh.doflocs[:, middle] *= bore.radius / np.hypot(*mesh.doflocs[:, middle])
    return mesh, inside


def _gap(catch: Catch, radius: float) -> float:
    """Between the sphere and the narrowest part."""
    return min(part.inner for part in parts(catch)) - radius


def _generate(
    gmsh: ModuleType, size: Callable[[float, float], float]
) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (2, n) and triangles (3, t) of the model's surfaces."""
    gmsh.option.setNumber("Mesh.MeshSizeExtendFromBoundary", 0)
    gmsh.model.mesh.setSizeCallback(lambda dim, tag, x, y, z, given: size(x, y))
    gmsh.model.mesh.generate(2)
    tags, flat, _ = gmsh.model.mesh.getNodes()
    _, nodes = gmsh.model.mesh.getElementsByType(2)
    used, triangles = np.unique(nodes, return_inverse=True)
    order = np.argsort(tags)
    points = flat.reshape(-1, 3)[order[np.searchsorted(tags, used, sorter=order)], :2]
    return points.T.copy(), triangles.reshape(-1, 3).T.copy()


def _mirrored(points: np.ndarray, triangles: np.ndarray) -> MeshTri:
    """Add the mirror image in y = 0, sharing the nodes on that line."""
    on_line = np.abs(points[1]) < 1e-9 * np.ptp(points[1])
    points = np.where(on_line, [points[0], np.zeros_like(points[0])], points)
    image = np.arange(points.shape[1])
    image[~on_line] = points.shape[1] + np.arange(np.count_nonzero(~on_line))
    both = np.hstack([points, points[:, ~on_line] * [[1], [-1]]])
    return MeshTri(both, np.hstack([triangles, image[triangles]]))
