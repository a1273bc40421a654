"""Quadrilaterals, hexahedra, prisms and pyramids of files, against closed forms and tetrahedra."""

import gmsh
import numpy as np
import pytest
from scipy.sparse.linalg import eigsh
from scipy.special import j1, jnp_zeros
from support import (
    CellBlock,
    Material,
    Solid,
    UsageError,
    assemble_solid,
    build_fe_model,
    find_material,
    make_quadratic_mesh,
    read_mesh,
    reject_folded_elements,
)

SIDES = (6.0, 2.0, 1.0)  # mm
COUNTS = (6, 2, 2)


def write_box(path, *, order=1, full=True, kind="hexahedra", counts=COUNTS, sides=SIDES):
    """Write a box of hexahedra, prisms or tetrahedra in one piece, its faces as groups."""
    gmsh.initialize([], readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Verbosity", 0)
    geo, straight = gmsh.model.geo, kind == "hexahedra"
    point = geo.addPoint(0, 0, 0)
    line = geo.extrude([(0, point)], sides[0], 0, 0, [counts[0]], recombine=True)[1]
    face = geo.extrude([line], 0, sides[1], 0, [counts[1]], recombine=straight)[1]
    recombine = kind != "tetrahedra"
    geo.extrude([face], 0, 0, sides[2], [counts[2]], recombine=recombine)
    geo.synchronize()
    gmsh.model.addPhysicalGroup(3, [tag for _, tag in gmsh.model.getEntities(3)], name="box")
    for axis, letter in enumerate("xyz"):
        for end, place in (("low", 0), ("high", sides[axis])):
            low, high = np.full(3, -1e-6), np.array(sides) + 1e-6
            low[axis], high[axis] = place - 1e-6, place + 1e-6
            tags = [tag for _, tag in gmsh.model.getEntitiesInBoundingBox(*low, *high, 2)]
            gmsh.model.addPhysicalGroup(2, tags, name=f"{letter}_{end}")
    gmsh.model.mesh.generate(3)
    gmsh.option.setNumber("Mesh.SecondOrderIncomplete", 0 if full else 1)
    gmsh.model.mesh.setOrder(order)
    gmsh.write(str(path))
    gmsh.finalize()


def body(home, made_of="PZT-5A", **changes):
    """Model of ``box.msh``, poled along z, driven at its faces and clamped at x = 0."""
    table = {
        "mesh": "box.msh", "unit": "mm", "materials": {"box": made_of}, "fixed": ["x_low"],
        "electrodes": {"anode": "z_high", "cathode": "z_low"},
        "ports": [{"name": "tip", "group": "x_high", "axis": "z"},
                  {"name": "long", "group": "x_high", "axis": "x"}],
    }  # fmt: skip
    return build_fe_model({**table, **changes}, home).model


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    """The box of tetrahedra, twice as fine."""
    home = tmp_path_factory.mktemp("tetrahedra")
    write_box(home / "box.msh", kind="tetrahedra", counts=(12, 4, 4))
    return body(home)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "order", "full"),
    [("hexahedra", 1, True), ("hexahedra", 2, False), ("hexahedra", 2, True),
     ("prisms", 1, True), ("prisms", 2, True)],
)  # fmt: skip
def test_solids_agree_with_tetrahedra(tmp_path, reference, kind, order, full):
    write_box(tmp_path / "box.msh", kind=kind, order=order, full=full)
    found = body(tmp_path)
    assert found.facts["mass_kg"] == pytest.approx(7750 * 12e-9, rel=1e-9)
    # tetrahedra on these cells deviate by 2.3 %, prisms are divided into tetrahedra
    tolerance = 1e-2 if kind == "hexahedra" else 2.5e-2
    rest, driven = (found.transfer(f) / reference.transfer(f) for f in (0.0, 50e3))
    for row, column in ((0, 0), (1, 1), (1, 2), (2, 2)):
        assert abs(rest[0, row, column] - 1) < tolerance
    if kind == "prisms":  # not symmetric: bending modes near 50 kHz are excited as well
        return
    for row, column in ((1, 1), (1, 2), (2, 2)):  # the rod resonates at 118 kHz
        assert abs(driven[0, row, column] - 1) < tolerance


def annulus(path, *, order=1, full=True, recombine=True):
    """Write a ring of radius 5 to 10 mm and height 1 mm in the half plane."""
    gmsh.initialize([], readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Verbosity", 0)
    geo = gmsh.model.geo
    point = geo.addPoint(5, 0, 0)
    line = geo.extrude([(0, point)], 5, 0, 0, [8], recombine=True)[1]
    top, face, *_ = geo.extrude([line], 0, 1, 0, [3], recombine=recombine)
    geo.synchronize()
    for dimension, name, tag in ((2, "ring", face[1]), (1, "top", top[1]), (1, "bottom", line[1])):
        gmsh.model.addPhysicalGroup(dimension, [tag], name=name)
    gmsh.model.mesh.generate(2)
    gmsh.option.setNumber("Mesh.SecondOrderIncomplete", 0 if full else 1)
    gmsh.model.mesh.setOrder(order)
    gmsh.write(str(path))
    gmsh.finalize()


@pytest.mark.slow
@pytest.mark.parametrize(("order", "full"), [(1, True), (2, False), (2, True)])
def test_quadrilaterals_of_a_ring_agree_with_triangles(tmp_path, order, full):
    facts = []
    for recombine in (True, False):
        home = tmp_path / str(recombine)
        home.mkdir()
        annulus(home / "ring.msh", order=order, full=full, recombine=recombine)
        table = {
            "mesh": "ring.msh", "unit": "mm", "axisymmetric": True,
            "materials": {"ring": "PZT-5A"}, "electrodes": {"anode": "top", "cathode": "bottom"},
        }  # fmt: skip
        facts.append(build_fe_model(table, home).model.facts)
    ring, other = facts
    assert ring["mass_kg"] == pytest.approx(7750 * np.pi * 75e-9, rel=1e-9)
    for name in ("resonance_short_hz", "capacitance_free_f"):
        assert ring[name] == pytest.approx(other[name], rel=1e-4), name


# gmsh's reference elements of first order.
CUBE = np.array([[-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, -1],
                 [-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]], float)  # fmt: skip
PRISM = np.array([[0, 0, -1], [1, 0, -1], [0, 1, -1], [0, 0, 1], [1, 0, 1], [0, 1, 1]], float)
PYRAMID = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0], [0, 0, 1]], float)


def grid(counts, sides, bend=0.0):
    """Points and hexahedra of a box, its inner nodes moved by ``bend`` of a cell."""
    axes = [np.linspace(0, side, n + 1) for side, n in zip(sides, counts, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    inner = np.ones(len(points), bool)
    for axis, side in enumerate(sides):
        inner &= (points[:, axis] > 1e-9 * side) & (points[:, axis] < side * (1 - 1e-9))
    cell = np.divide(sides, counts)
    points[inner] += bend * cell * np.sin(1 + 97 * np.arange(inner.sum())[:, None] + np.arange(3))
    number = np.arange(len(points)).reshape(np.add(counts, 1))
    corners = []
    for i, j, k in ((CUBE + 1) / 2).astype(int):
        ends = [slice(s, n + s) for s, n in zip((i, j, k), counts, strict=True)]
        corners.append(number[tuple(ends)].ravel())
    return points, np.array(corners).T


def blocks_of(points, hexahedra, kind):
    """The same body of another kind of element; every hexahedron is divided."""
    if kind == "hexahedra":
        return points, [CellBlock(hexahedra, 8, CUBE)]
    if kind == "prisms":
        halves = hexahedra[:, [0, 1, 2, 4, 5, 6]], hexahedra[:, [0, 2, 3, 4, 6, 7]]
        return points, [CellBlock(np.concatenate(halves), 6, PRISM)]
    centre = points[hexahedra].mean(axis=1)
    tip = len(points) + np.arange(len(hexahedra))
    faces = (0, 1, 2, 3), (7, 6, 5, 4), (0, 4, 5, 1), (1, 5, 6, 2), (2, 6, 7, 3), (3, 7, 4, 0)
    half = 0 if kind == "pyramids" else len(hexahedra) // 2
    parts = [np.column_stack([hexahedra[half:, face], tip[half:]]) for face in faces]
    pyramids = CellBlock(np.concatenate(parts), 5, PYRAMID)
    return np.concatenate([points, centre]), [CellBlock(hexahedra[:half], 8, CUBE), pyramids]


@pytest.mark.parametrize("kind", ["hexahedra", "prisms", "pyramids beside hexahedra"])
def test_patch_of_distorted_elements_has_constant_strain_and_field(kind):
    """Linear displacements and potentials load no inner node, and have the energy of the box."""
    points, blocks = blocks_of(*grid((3, 3, 2), SIDES, bend=0.15), kind)
    reject_folded_elements(points, blocks, "m")
    mesh, _, parent = make_quadratic_mesh(points, blocks)
    assert len(parent) == mesh.nelements
    solid = Solid(mesh, (find_material("PZT-5A"),), np.zeros(mesh.nelements, int))
    full, places = assemble_solid(solid), solid.node_positions.T
    slope = np.array([[1.0, 0.3, -0.2], [0.1, -0.4, 0.5], [0.2, 0.6, 0.7]])
    field = np.array([0.4, -0.3, 0.8])
    u, phi = (places @ slope.T).ravel(), places @ field
    inner = ((places > 1e-9) & (places < np.array(SIDES) - 1e-9)).all(axis=1)
    force = (full.K_uu @ u + full.K_up @ phi).reshape(-1, 3)
    charge = full.K_up.T @ u - full.K_pp @ phi
    assert np.abs(force[inner]).max() < 1e-10 * np.abs(force).max()
    assert np.abs(charge[inner]).max() < 1e-10 * np.abs(charge).max()
    S = np.array([slope[0, 0], slope[1, 1], slope[2, 2], slope[1, 2] + slope[2, 1],
                  slope[0, 2] + slope[2, 0], slope[0, 1] + slope[1, 0]])  # fmt: skip
    C, volume = solid.materials[0].C, float(np.prod(SIDES))
    assert u @ (full.K_uu @ u) == pytest.approx(volume * S @ C @ S, rel=1e-10)
    mass = full.M.sum() / 3
    assert mass == pytest.approx(7750 * volume, rel=1e-10)


def unit_material():
    """A material with the speed 1 of waves in all directions, without transverse strain."""
    C = np.diag([1.0, 1, 1, 0.5, 0.5, 0.5])
    return Material("rod", 1.0, C=C, e=np.zeros((3, 6)), eps_S=np.eye(3))


def mode_errors(solid, free, exact, wave_number):
    """Relative error of the lowest frequency along x, and error of its shape (L2).

    ``free`` are the nodes that move, along x only. ``exact`` is the shape over x. The amplitude is
    that of the least error.
    """
    full, x = assemble_solid(solid), solid.node_positions[0]
    d = solid.component_count
    M, K = (matrix[::d, ::d][free][:, free] for matrix in (full.M, full.K_uu))
    values, modes = eigsh(K, 2, M, sigma=0.0)
    lowest = values.argmin()
    shape = np.zeros(len(x))
    shape[free] = modes[:, lowest]
    basis = solid.basis(8)
    places = basis.global_coordinates()[0]
    weight = basis.dx * (places if solid.axisymmetric else 1.0)
    u, target = np.asarray(basis.interpolate(shape)), exact(places)
    u *= np.sum(weight * u * target) / np.sum(weight * u * u)
    error = np.sum(weight * (u - target) ** 2)
    return np.sqrt(values[lowest]) / wave_number - 1, np.sqrt(error)


def rod(count, kind, order=2):
    """Errors of the first longitudinal mode of a rod, clamped at x = 0.

    ``order`` 1 uses trilinear shape functions.
    """
    cells = count, count // 2, count // 2
    points, blocks = blocks_of(*grid(cells, np.divide(cells, count)), kind)
    mesh, *_ = make_quadratic_mesh(points, blocks)
    solid = Solid(mesh, (unit_material(),), np.zeros(mesh.nelements, int), order=order)
    free = np.flatnonzero(solid.node_positions[0] > 1e-9)
    return mode_errors(solid, free, lambda x: np.sin(np.pi / 2 * x), np.pi / 2)


def disc(count, kind, order=2):
    """Errors of the first radial mode of a disc: u = J1(k r) with J1'(k) = 0."""
    rows = count // 2 + 1
    points = np.array([(i / count, k / count) for i in range(count + 1) for k in range(rows)])
    number = np.arange(len(points)).reshape(-1, rows)
    corners = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    cells = np.array([*map(np.ravel, corners)]).T
    square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], float)
    block = CellBlock(cells, 4, square)
    if kind == "triangles":
        halves = np.concatenate([cells[:, [0, 1, 2]], cells[:, [0, 2, 3]]])
        block = CellBlock(halves, 3, np.array([[0, 0], [1, 0], [0, 1]], float))
    mesh, *_ = make_quadratic_mesh(points, [block])
    solid = Solid(mesh, (unit_material(),), np.zeros(mesh.nelements, int), axisymmetric=True)
    free = np.flatnonzero(solid.node_positions[0] > 1e-9)
    wave_number = jnp_zeros(1, 1)[0]
    return mode_errors(solid, free, lambda r: j1(wave_number * r), wave_number)


@pytest.mark.parametrize(
    ("body_errors", "kind", "order", "displacement", "frequency"),
    [
        (rod, "hexahedra", 1, 2, 2),
        pytest.param(rod, "hexahedra", 2, 3, 4, marks=pytest.mark.slow),
        (rod, "prisms", 2, 3, 4),
        pytest.param(rod, "pyramids", 2, 3, 4, marks=pytest.mark.slow),
        (disc, "quadrilaterals", 2, 3, 4),
        (disc, "triangles", 2, 3, 4),
    ],
)
def test_elements_converge_to_closed_forms(body_errors, kind, order, displacement, frequency):
    count = 8 if body_errors is rod else 16
    coarse, fine = (np.array(body_errors(n, kind, order)) for n in (count, 2 * count))
    rates = np.log2(coarse / fine)
    assert rates == pytest.approx([frequency, displacement], abs=0.1)


@pytest.mark.parametrize("kind", ["hexahedra", "prisms"])
def test_folded_elements_are_refused(kind):
    points, blocks = blocks_of(*grid((1, 1, 1), SIDES), kind)
    points = points.copy()
    points[0] = [4, 1.5, 0.8]
    with pytest.raises(UsageError, match="negative volume"):
        reject_folded_elements(points, blocks, "mesh")


def test_mesh_of_shells_is_refused(tmp_path):
    annulus(tmp_path / "ring.msh")
    with pytest.raises(UsageError, match="shell elements are not supported"):
        read_mesh(tmp_path / "ring.msh", unit=1e-3)
