"""Polings of single elements from files, and local axes of materials."""

from itertools import pairwise

import gmsh
import numpy as np
import pytest
import skfem
from pydantic import ValidationError
from support import (
    BodyKeys,
    UsageError,
    build_fe_model,
    find_coarse_elements,
    find_extremes,
    recover_motion,
)

FR4 = {
    "density": 1900,
    "youngs_modulus": ["24 GPa", "21 GPa", "10 GPa"],
    "poisson_ratio": {"nu_xy": 0.13, "nu_xz": 0.3, "nu_yz": 0.25},
    "shear_modulus": {"g_yz": "2.5 GPa", "g_xz": "3 GPa", "g_xy": "5 GPa"},
}
COLUMNS = "element,px,py,pz"


def write_boxes(path, boxes, size, box_faces=()):
    """Write boxes (low corner, sides) [mm], groups b0, b1, …, and faces by (name, axis, value)."""
    gmsh.initialize([], readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    occ, model = gmsh.model.occ, gmsh.model
    solids = [(3, occ.addBox(*low, *sides)) for low, sides in boxes]
    if len(solids) > 1:
        occ.fragment(solids[:1], solids[1:])
    occ.synchronize()
    for k, (low, sides) in enumerate(boxes):
        ends = np.concatenate([np.subtract(low, 1e-6), np.add(np.add(low, sides), 1e-6)])
        inside = [tag for _, tag in model.getEntitiesInBoundingBox(*ends, 3)]
        model.addPhysicalGroup(3, inside, name=f"b{k}")
    for name, axis, value in box_faces:
        low, high = np.full(3, -99.0), np.full(3, 99.0)
        low[axis], high[axis] = value - 1e-6, value + 1e-6
        faces = [tag for _, tag in model.getEntitiesInBoundingBox(*low, *high, 2)]
        model.addPhysicalGroup(2, faces, name=name)
    gmsh.option.setNumber("Mesh.MeshSizeMax", size)
    model.mesh.generate(3)
    return write_mesh(path, 3)


def write_ring(path, dimension):
    """Write a ring about z, or its meridian section: radius 10 mm, 1 mm square."""
    gmsh.initialize([], readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    occ, model = gmsh.model.occ, gmsh.model
    occ.addRectangle(9.5, 0, 0, 1, 1)
    if dimension == 3:
        occ.rotate([(2, 1)], 0, 0, 0, 1, 0, 0, np.pi / 2)
        occ.revolve([(2, 1)], 0, 0, 0, 0, 0, 1, np.pi)
        occ.revolve([(2, 1)], 0, 0, 0, 0, 0, 1, -np.pi)
        occ.removeAllDuplicates()
    occ.synchronize()
    entities = [tag for _, tag in model.getEntities(dimension)]
    model.addPhysicalGroup(dimension, entities, name="ring")
    sides = {"inner": [], "outer": []}
    for d, tag in model.getEntities(dimension - 1):
        low, high = model.getParametrizationBounds(d, tag)
        place = np.reshape(model.getValue(d, tag, np.add(low, high) / 2), 3)
        radius = place[0] if dimension == 2 else np.hypot(*place[:2])
        for name, value in (("inner", 9.5), ("outer", 10.5)):
            if abs(radius - value) < 1e-6:
                sides[name].append(tag)
    for name, tags in sides.items():
        model.addPhysicalGroup(dimension - 1, tags, name=name)
    gmsh.option.setNumber("Mesh.MeshSizeMax", 3.0 if dimension == 3 else 0.5)
    model.mesh.generate(dimension)
    model.mesh.setOrder(2)
    return write_mesh(path, dimension)


def write_mesh(path, dimension):
    """Write the mesh, and return numbers and centres (n, 3) of its elements."""
    numbers, middles = [], []
    for kind in gmsh.model.mesh.getElementTypes(dimension):
        numbers.append(gmsh.model.mesh.getElementsByType(kind)[0])
        middles.append(gmsh.model.mesh.getBarycenters(kind, -1, False, True).reshape(-1, 3))
    gmsh.write(str(path))
    gmsh.finalize()
    return np.concatenate(numbers), np.concatenate(middles)


def write_table(path, columns, table):
    rows = [",".join(f"{value:.12g}" for value in row) for row in table]
    path.write_text("\n".join(["# polings", columns, *rows]) + "\n", encoding="utf-8")


def capacitances(model):
    """Capacitance at rest, responses at 0.8 and 0.9 of the breathing resonance (few modes near)."""
    response = np.abs(model.transfer(np.array([36e3, 40e3]))[:, 0, 0])
    return [model.facts["capacitance_free_f"], *response]


def bar(home, name, direction, axes, **changes):
    """A clamped bar of 20 x 3 x 2 mm along a ``direction``, the shorter sides in cyclic order."""
    sides = np.roll([20.0, 3.0, 2.0], direction)
    write_boxes(
        home / name,
        [((0, 0, 0), sides)],
        2.0,
        [
            ("root", direction, 0.0),
            ("end", direction, 20.0),
        ],
    )
    ports = []
    for k in range(3):
        axis = "xyz"[(direction + k) % 3]
        ports.append({"name": f"tip{k}", "group": "end", "axis": axis})
    table = {"mesh": name, "unit": "mm", "materials": {"b0": FR4}, "axes": {"b0": axes}}
    table |= {"fixed": ["root"], "ports": ports, "damping": {"ratio": 0}}
    model = build_fe_model({**table, **changes}, home).model
    return np.real(model.transfer(np.zeros(1))[0])


@pytest.mark.slow
def test_bar_with_turned_axes_is_the_bar_turned_in_space(tmp_path):
    """A cyclic change of x, y, z of the bar and of its material changes no compliance."""
    plain = bar(tmp_path, "x.msh", 0, {})
    turned = bar(tmp_path, "y.msh", 1, {"x": [0, 3, 0], "z": [2, 0, 0]})
    assert np.diag(turned) == pytest.approx(np.diag(plain), rel=5e-3)
    crossed = bar(tmp_path, "x.msh", 0, {"x": [0, 1, 0], "z": [0, 0, 1]})
    stretch = crossed[0, 0] / plain[0, 0]  # E_x becomes E_y
    assert stretch == pytest.approx(24 / 21, rel=2e-2)


def test_cylindrical_axes_far_away_are_cartesian_ones(tmp_path):
    plain = bar(tmp_path, "x.msh", 0, {"x": [0, 1, 0]})
    origin = [0, -1e3, 0]
    about = bar(tmp_path, "x.msh", 0, {"kind": "cylindrical", "origin": origin})
    assert np.diag(about) == pytest.approx(np.diag(plain), rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("form", ["element", "points", "section"])
def test_ring_poled_per_element_is_poled_radially(tmp_path, form):
    dimension = 2 if form == "section" else 3
    numbers, middles = write_ring(tmp_path / "ring.msh", dimension)
    if dimension == 2:
        write_table(tmp_path / "p.csv", COLUMNS, [(n, 1, 0, 0) for n in numbers])
    elif form == "element":
        radial = middles * [1, 1, 0]
        table = np.column_stack([numbers, radial])[::-1]
        write_table(tmp_path / "p.csv", COLUMNS, table)
    else:
        angles = np.linspace(0, 2 * np.pi, 200, endpoint=False)
        radial = np.column_stack([np.cos(angles), np.sin(angles), 0 * angles])
        points = 10 * radial + [0, 0, 0.5]
        write_table(tmp_path / "p.csv", "x,y,z,px,py,pz", np.hstack([points, radial]))
    table = {"mesh": "ring.msh", "unit": "mm", "materials": {"ring": "PZT-5A"}}
    table |= {"electrodes": {"anode": "inner", "cathode": "outer"}, "damping": {"ratio": 0}}
    table |= {"axisymmetric": dimension == 2}
    exact = build_fe_model({**table, "poling": {"ring": "radial"}}, tmp_path).model
    read = build_fe_model({**table, "poling": {"ring": {"file": "p.csv"}}}, tmp_path).model
    unpoled = build_fe_model(table, tmp_path).model
    wanted = capacitances(exact)
    rel = 1e-9 if dimension == 2 else 5e-3
    assert capacitances(read) == pytest.approx(wanted, rel=rel)
    assert capacitances(unpoled)[-1] != pytest.approx(wanted[-1], rel=5e-2)


@pytest.fixture(scope="module")
def bender(tmp_path_factory):
    """Two layers of 12 x 3 x 0.5 mm, with the numbers and centres of their elements."""
    home = tmp_path_factory.mktemp("bender")
    levels = (0.0, 0.5, 1.0)
    boxes = [((0, 0, a), (12, 3, b - a)) for a, b in pairwise(levels)]
    faces = [("root", 0, 0.0), ("end", 0, 12.0), ("bottom", 2, 0.0), ("top", 2, 1.0)]
    return home, *write_boxes(home / "bender.msh", boxes, 4.0, faces)


def bend(home, poling, **changes):
    table = {
        "mesh": "bender.msh",
        "unit": "mm",
        "materials": {"b0": "PZT-5A", "b1": "PZT-5A"},
        "poling": poling,
        "fixed": ["root"],
        "electrodes": {"anode": "top", "cathode": "bottom"},
        "ports": [{"name": "tip", "group": "end", "axis": "z"}],
        "damping": {"ratio": 0},
    }
    return build_fe_model(BodyKeys.model_validate({**table, **changes}), home)


@pytest.mark.slow
@pytest.mark.parametrize("refine", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_bimorph_poled_by_file_is_that_of_two_groups(bender, refine):
    home, numbers, middles = bender
    up = np.where(middles[:, 2] > 0.5, 3.0, -2.0)
    write_table(home / "p.csv", COLUMNS, np.column_stack([numbers, 0 * up, 0 * up, up]))
    file = {"file": "p.csv"}
    read = bend(home, {"b0": file, "b1": file}, refine=refine).model
    groups = bend(home, {"b0": [0, 0, -1], "b1": [0, 0, 1]}, refine=refine).model
    s = np.array([0.0, 900.0])
    scale = np.abs(groups.transfer(s)).max()
    assert read.transfer(s) == pytest.approx(groups.transfer(s), rel=1e-7, abs=1e-12 * scale)
    assert groups.facts["free_stroke_tip_m_per_v"] != pytest.approx(0, abs=1e-9)


@pytest.mark.slow
def test_field_against_the_poling_of_each_element(bender):
    home, numbers, _ = bender
    write_table(home / "p.csv", COLUMNS, [(n, 0, 0, -1) for n in numbers])
    extremes = []
    for poling in ({"file": "p.csv"}, [0, 0, -1], [0, 0, 1]):
        solid = bend(home, {"b0": poling, "b1": poling})
        motion = recover_motion(solid, np.linspace(0, 1e-6, 3), {"anode": np.full(3, 30.0)})
        extremes.append([extreme.value for extreme in find_extremes(motion)])
    assert extremes[0] == pytest.approx(extremes[1], rel=1e-6)
    assert extremes[0] != pytest.approx(extremes[2], rel=0.5)


@pytest.mark.parametrize(("poling", "message"), [
    ({}, "exactly one of the keys `direction` and `file`"),
    ({"file": "p.csv", "direction": [1, 0, 0]}, "exactly one of the keys `direction` and `file`"),
    ({"file": "p.csv", "axis": [0, 0, 1]}, "axis and through cannot be combined with a CSV file"),
    ({"direction": [0, 0, 0]}, "is a zero vector"),
])  # fmt: skip
def test_bad_tables_of_polings_are_refused(bender, poling, message):
    with pytest.raises(ValidationError, match=message):
        bend(bender[0], {"b1": poling})


@pytest.mark.parametrize("kind", [skfem.MeshTet, skfem.MeshHex, skfem.MeshTri, skfem.MeshQuad])
def test_parts_of_an_element_fill_it(kind):
    coarse = kind().refined(1)
    fine = coarse.refined(2)
    basis = [skfem.Basis(mesh, skfem.ElementVector(mesh.elem())) for mesh in (coarse, fine)]
    whole, parts = (each.dx.sum(axis=1) for each in basis)
    parents = find_coarse_elements(coarse, fine)
    assert np.bincount(parents, parts) == pytest.approx(whole, rel=1e-12)
    curved = {skfem.MeshTet: skfem.MeshTet2, skfem.MeshTri: skfem.MeshTri2}
    if kind in curved:
        assert (find_coarse_elements(curved[kind].from_mesh(coarse), fine) == parents).all()


@pytest.mark.parametrize(("lines", "message"), [
    (["element,px,py"], "wrong columns"),
    ([], "wrong columns"),
    ([COLUMNS], "no rows"),
    ([COLUMNS, "1,0,0"], "row 2 has the wrong number of columns"),
    ([COLUMNS, "1,0,up,1"], "row 2, column py: not a finite number"),
    ([COLUMNS, "1,0,0,nan"], "row 2, column pz: not a finite number"),
    ([COLUMNS, "# none", "1,0,0,0"], "row 3: the poling is a zero vector"),
    ([COLUMNS, "1.5,0,0,1"], "row 2, column element: not an element number"),
    ([COLUMNS, "700,0,0,1", "700,0,0,1"], "row 3: this element already has a row"),
    ([COLUMNS, "99999999,0,0,1"], "row 2: this element is not in the mesh"),
    ([COLUMNS, "FIRST,0,0,1"], "lacks elements"),
])  # fmt: skip
def test_bad_files_are_refused_by_row(bender, lines, message):
    home, numbers, _ = bender
    text = "\n".join(lines).replace("FIRST", str(numbers[0]))
    text = text.replace("700", str(numbers[3]))
    (home / "bad.csv").write_text(text, encoding="utf-8")
    with pytest.raises(UsageError, match=message) as caught:
        bend(home, {"b0": {"file": "bad.csv"}})
    assert "poling.b0" in str(caught.value)


def test_missing_file_is_refused(bender):
    with pytest.raises(UsageError, match="cannot be read"):
        bend(bender[0], {"b0": {"file": "none.csv"}})


def test_hoop_poling_of_a_section_is_refused(tmp_path):
    numbers, _ = write_ring(tmp_path / "ring.msh", 2)
    write_table(tmp_path / "p.csv", COLUMNS, [(n, 1, 1, 0) for n in numbers])
    table = {"mesh": "ring.msh", "unit": "mm", "axisymmetric": True}
    table |= {"materials": {"ring": "PZT-5A"}, "poling": {"ring": {"file": "p.csv"}}}
    table |= {"electrodes": {"anode": "inner", "cathode": "outer"}}
    with pytest.raises(UsageError, match="row 3: the poling direction is not in the plane"):
        build_fe_model(table, tmp_path)


@pytest.mark.parametrize(("axes", "message"), [
    ({"b0": {"z": [0, 0, 0]}}, "z has no length"),
    ({"b0": {"x": [0, 0, 0]}}, "x has no length"),
    ({"b0": {"x": [0, 1, 1]}}, "not perpendicular"),
    ({"b0": {"z": [1, 0, 0]}}, "state x beside z"),
    ({"b0": {"origin": [0, 0, 0]}}, "origin needs"),
    ({"b0": {"kind": "cylindrical", "x": [1, 0, 0]}}, "cannot have the key `x`"),
    ({"b7": {"z": [0, 0, 1]}}, "axes contains groups without a material"),
    ({"b1": {"z": [0, 0, 1]}}, "cannot apply to the same group"),
])  # fmt: skip
def test_bad_axes_are_refused(bender, axes, message):
    with pytest.raises(ValidationError, match=message):
        bend(bender[0], {"b1": [0, 0, 1]}, axes=axes)
