"""Bodies from files: against parametric bodies of the same geometry, and every bad group named."""

from itertools import pairwise

import gmsh
import numpy as np
import pytest
from pydantic import ValidationError
from scipy.sparse.linalg import eigsh
from support import BodyKeys, UsageError, bimorph, build_fe_model, disc, find_material


def write(path, draw, *, size, order=2, mesh=3):
    """A file made by gmsh: ``draw(gmsh)`` returns groups {(dimension, name): tags}."""
    gmsh.initialize([], readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.option.setNumber("General.Verbosity", 0)
    groups = draw(gmsh)
    for (dimension, name), tags in groups.items():
        gmsh.model.addPhysicalGroup(dimension, tags, name=name)
    if path.suffix == ".msh":
        gmsh.option.setNumber("Mesh.MeshSizeMax", size)
        gmsh.model.mesh.generate(mesh)
        gmsh.model.mesh.setOrder(order)
    gmsh.write(str(path))
    gmsh.finalize()
    return path.name


def slabs(heights, length, width):
    """Layers of a beam in millimetres, with faces by their height as groups."""

    def draw(gmsh):
        occ = gmsh.model.occ
        bodies = [(3, occ.addBox(0, 0, a, length, width, b - a)) for a, b in pairwise(heights)]
        if len(bodies) > 1:
            occ.fragment(bodies[:1], bodies[1:])
        occ.synchronize()
        groups = {}
        for k, (a, b) in enumerate(pairwise(heights)):
            inside = gmsh.model.getEntitiesInBoundingBox(-1, -1, a - 1e-6, 99, 99, b + 1e-6, 3)
            groups[3, f"layer{k}"] = [t for _, t in inside]
        for k, z in enumerate(heights):
            flat = gmsh.model.getEntitiesInBoundingBox(-1, -1, z - 1e-6, 99, 99, z + 1e-6, 2)
            groups[2, f"level{k}"] = [t for _, t in flat]
        for name, x in (("root", 0), ("end", length)):
            flat = gmsh.model.getEntitiesInBoundingBox(x - 1e-6, -1, -1, x + 1e-6, 99, 99, 2)
            groups[2, name] = [t for _, t in flat]
        edge = gmsh.model.getEntitiesInBoundingBox(
            length - 1e-6, -1, heights[-1] - 1e-6, 99, 99, heights[-1] + 1e-6, 1
        )
        groups[1, "edge"] = [t for _, t in edge]
        corner = gmsh.model.getEntitiesInBoundingBox(
            length - 1e-6, -1e-6, heights[-1] - 1e-6, 99, 1e-6, 99, 0
        )
        groups[0, "corner"] = [t for _, t in corner]
        return groups

    return draw


@pytest.fixture(scope="module")
def beam(tmp_path_factory):
    """A unimorph of 12 x 3 mm: 0.4 mm of steel under 0.3 mm of PZT-5A."""
    home = tmp_path_factory.mktemp("beam")
    write(home / "beam.msh", slabs([0, 0.4, 0.7], 12, 3), size=0.8)
    return home


@pytest.fixture(scope="module")
def coarse(tmp_path_factory):
    """The same with one element or two across."""
    home = tmp_path_factory.mktemp("coarse")
    write(home / "beam.msh", slabs([0, 0.4, 0.7], 12, 3), size=2.5)
    return home


def keys(**changes):
    table = {
        "mesh": "beam.msh",
        "unit": "mm",
        "materials": {"layer0": "steel", "layer1": "PZT-5A"},
        "poling": {"layer1": [0, 0, -1]},
        "fixed": ["root"],
        "electrodes": {"anode": "level2", "cathode": "level1"},
        "ports": [
            {"name": "tip", "group": "end", "axis": "z"},
            {"name": "base", "kind": "base", "axis": "z"},
        ],
        "damping": {"ratio": 0},
    }
    return BodyKeys.model_validate({**table, **changes})


@pytest.mark.slow
def test_mesh_of_a_unimorph_is_the_parametric_one(beam):
    parametric = bimorph.make_bimorph_blocks({
        "length": "12 mm", "width": "3 mm", "damping": {"ratio": 0}, "mesh": {"refine": 2},
        "layers": [{"material": "steel", "thickness": "0.4 mm"},
                   {"material": "PZT-5A", "thickness": "0.3 mm"}],
    }).build_fe_model().model  # fmt: skip
    found = build_fe_model(keys(), beam).model
    parametric = parametric.select([p.name for p in found.ports])
    for name, value in parametric.facts.items():
        if name != "unknowns" and not name.startswith(("mesh_", "area_")):  # not joined faces
            assert found.facts[name] == pytest.approx(value, rel=1e-2), name
    s = np.array([0.0, 900.0])
    ours, theirs = found.transfer(s), parametric.transfer(s)
    assert np.abs(ours / theirs - 1).max() < 1e-2


def test_ports_on_every_kind_of_group(coarse):
    ports = [
        {"name": "face", "group": "end", "axis": [0, 0, 2]},
        {"name": "edge", "group": "edge", "axis": "z"},
        {"name": "corner", "group": "corner", "axis": "z"},
        {"name": "near", "at": ["12 mm", 0, "0.7 mm"], "axis": "z"},
        {"name": "bulk", "group": "layer0", "axis": "z"},
    ]
    model = build_fe_model(keys(ports=ports), coarse).model
    n = len(model.ports)
    stroke = np.real(model.transfer(np.zeros(1))[0][:-1, n - 1])
    assert stroke[0] == pytest.approx(stroke[1], rel=1e-2)
    assert stroke[2] == pytest.approx(stroke[3], rel=1e-9)
    assert 0.2 < stroke[4] / stroke[0] < 0.5  # a parabola has a third of its end as mean


def test_a_mesh_beyond_memory_is_refused_before_its_factor(coarse, monkeypatch):
    monkeypatch.setattr("kc2spice.linalg.factor.find_available_bytes", lambda: 1000.0)
    monkeypatch.setattr("kc2spice.bodies.solid_models.compute_undamped_responses", pytest.fail)
    with pytest.raises(UsageError, match="needs more memory") as caught:
        build_fe_model(keys(), coarse)
    assert "coarser mesh" in str(caught.value)
    assert "reduction" not in str(caught.value)


def test_file_unit_scales_the_body(coarse):
    small, large = (
        build_fe_model(keys(unit=unit, damping={"alpha": 0, "ratio": 0}), coarse).model.facts
        for unit in ("mm", "cm")
    )
    assert large["mass_kg"] == pytest.approx(1000 * small["mass_kg"])
    assert large["resonance_short_hz"] == pytest.approx(small["resonance_short_hz"] / 10)


def test_step_file_states_its_own_unit(tmp_path):
    write(tmp_path / "a.step", slabs([0, 4], 12, 3), size=1)
    table = {
        "mesh": "a.step", "size": "3 mm", "materials": {"all": "steel"},
        "groups": {"all": {"solids": [["6 mm", "1 mm", "1 mm"]]}},
        "ports": [{"name": "tip", "at": ["12 mm", 0, 0], "axis": "z"}],
    }  # fmt: skip
    steel = find_material("steel").density
    assert build_fe_model(table, tmp_path).model.facts["mass_kg"] == pytest.approx(144e-9 * steel)
    with pytest.raises(UsageError, match="own unit"):
        build_fe_model({**table, "unit": "m"}, tmp_path)
    text = (tmp_path / "a.step").read_text()
    assert "SI_UNIT(.MILLI.,.METRE.)" in text
    (tmp_path / "a.step").write_text(
        text.replace("SI_UNIT(.MILLI.,.METRE.)", "SI_UNIT(.CENTI.,.METRE.)")
    )
    larger = {
        **table,
        "size": "30 mm",
        "groups": {"all": {"solids": [["60 mm", "10 mm", "10 mm"]]}},
    }
    assert build_fe_model(larger, tmp_path).model.facts["mass_kg"] == pytest.approx(144e-6 * steel)


def test_axisymmetric_mesh_is_the_disc(tmp_path):
    def draw(gmsh):
        gmsh.model.occ.addRectangle(0, 0, 0, 5, 0.5)
        gmsh.model.occ.synchronize()
        around = {
            name: [t for _, t in gmsh.model.getEntitiesInBoundingBox(*box, 1)]
            for name, box in {
                "low": (-1, -1e-6, -1, 9, 1e-6, 1), "high": (-1, 0.5 - 1e-6, -1, 9, 0.6, 1),
            }.items()
        }  # fmt: skip
        return {(2, "disc"): [1], **{(1, name): tags for name, tags in around.items()}}

    write(tmp_path / "disc.msh", draw, size=0.25, mesh=2)
    found = build_fe_model({
        "mesh": "disc.msh", "unit": "mm", "axisymmetric": True, "materials": {"disc": "PZT-5A"},
        "electrodes": {"anode": "high", "cathode": "low"}, "damping": {"ratio": 0},
    }, tmp_path).model.facts  # fmt: skip
    own = disc.make_disc_blocks({
        "layers": [{"material": "PZT-5A", "diameter": "10 mm", "thickness": "0.5 mm"}],
        "damping": {"ratio": 0},
    }).build_fe_model().model.facts  # fmt: skip
    for name in ("mass_kg", "capacitance_free_f", "capacitance_clamped_f",
                 "resonance_short_hz", "resonance_open_hz"):  # fmt: skip
        assert found[name] == pytest.approx(own[name], rel=1e-3), name


def column(gmsh):
    """The half section of a column of 5 mm radius and 4 mm height in the x-y plane, in mm."""
    gmsh.model.occ.addRectangle(0, 0, 0, 5, 4)
    gmsh.model.occ.synchronize()
    boxes = {"low": (-1, -1e-6, -1, 9, 1e-6, 1), "high": (-1, 4 - 1e-6, -1, 9, 5, 1)}
    edges = {
        (1, name): [t for _, t in gmsh.model.getEntitiesInBoundingBox(*box, 1)]
        for name, box in boxes.items()
    }
    return {(2, "steel"): [1], **edges}


COLUMN = {
    "mesh": "column.msh", "unit": "mm", "axisymmetric": True,
    "materials": {"steel": {"density": 7800, "youngs_modulus": 2e11, "poisson_ratio": 0.3}},
    "fixed": [{"group": "low", "axes": "z"}],
    "ports": [{"name": "top", "group": "high", "axis": "z"}],
}  # fmt: skip


@pytest.mark.parametrize("place", [{"group": "high"}, {"at": (0.0, 0.0, 4e-3)}])
def test_the_height_of_a_half_section_is_z(tmp_path, place):
    """A force F shortens a column on rollers by F h / (E A); y of the file is z of the keys."""
    write(tmp_path / "column.msh", column, size=1.0, mesh=2)
    model = build_fe_model(
        COLUMN | {"ports": [{"name": "top", "axis": "z", **place}]}, tmp_path
    ).model
    facts = model.facts
    assert facts["extent_outer_radius_mm"] == pytest.approx(5.0)
    assert facts["extent_height_mm"] == pytest.approx(4.0)
    assert "extent_inner_radius_mm" not in facts
    if "group" in place:
        moved = model.transfer(np.array([1e-3]))[0, 0, 0].real
        assert moved == pytest.approx(4e-3 / (2e11 * np.pi * 5e-3**2), rel=1e-6)


@pytest.mark.parametrize(
    ("keys", "where", "advice"),
    [
        ({"ports": [{"name": "top", "group": "high", "axis": "y"}]}, "ports[0].axis", 'axis = "z"'),
        ({"ports": [{"name": "top", "group": "high", "axis": (1, 1, 0)}]}, "ports[0].axis",
         'axis = "z"'),
        ({"ports": [{"name": "b", "kind": "base", "axis": "x"}]}, "ports[0].axis", 'axis = "z"'),
        ({"ports": [{"name": "top", "at": (0, 4e-3, 0), "axis": "z"}]}, "ports[0].at",
         "third coordinate"),
        ({"fixed": [{"group": "low", "axes": "y"}]}, "fixed[0].axes", 'axes = "z"'),
        ({"fixed": ["low", {"group": "low", "axes": "xy"}]}, "fixed[1].axes", 'axes = "xz"'),
        ({"poling": {"steel": (0, 1, 0)}}, "poling.steel", "[0, 0, 1]"),
    ],
)  # fmt: skip
def test_a_half_section_has_no_direction_y(tmp_path, keys, where, advice):
    with pytest.raises(UsageError) as caught:
        build_fe_model(COLUMN | keys, tmp_path)
    assert caught.value.where == f"body.{where}"
    assert advice in caught.value.hint
    assert "the mesh file contains the height as y" in caught.value.hint


def test_points_of_poling_vectors_of_a_half_section_have_no_y(tmp_path):
    write(tmp_path / "column.msh", column, size=1.0, mesh=2)
    table = COLUMN | {"materials": {"steel": "PZT-5A"}, "poling": {"steel": {"file": "p.csv"}}}
    table["electrodes"] = {"anode": "high", "cathode": "low"}
    (tmp_path / "p.csv").write_text("x,y,z,px,py,pz\n1,2,0,0,0,1\n")
    with pytest.raises(UsageError, match="row 2: the point is not in the plane"):
        build_fe_model(table, tmp_path)
    (tmp_path / "p.csv").write_text("x,y,z,px,py,pz\n1,0,2,0,0,1\n")
    build_fe_model(table, tmp_path)


RING = {"radius": 10.0, "wall": 0.5, "height": 0.5}  # mm, the radius that of the middle


def ring(gmsh):
    """A ring about z through (20, 0, 0) mm, with its two curved faces as groups."""
    occ, middle, half = gmsh.model.occ, RING["radius"], RING["wall"] / 2
    solid = occ.addCylinder(20, 0, 0, 0, 0, RING["height"], middle + half)
    bore = occ.addCylinder(20, 0, 0, 0, 0, RING["height"], middle - half)
    occ.cut([(3, solid)], [(3, bore)])
    occ.synchronize()
    groups = {(3, "ring"): [t for _, t in gmsh.model.getEntities(3)]}
    for name, radius in (("outer", middle + half), ("inner", middle - half)):
        area = 2 * np.pi * radius * RING["height"]
        faces = [t for _, t in gmsh.model.getEntities(2)]
        groups[2, name] = [t for t in faces if abs(occ.getMass(2, t) / area - 1) < 1e-3]
        assert groups[2, name]
    return groups


def section(gmsh):
    """The same in a meridian plane."""
    middle, half, height = RING["radius"], RING["wall"] / 2, RING["height"]
    gmsh.model.occ.addRectangle(middle - half, 0, 0, 2 * half, height)
    gmsh.model.occ.synchronize()
    groups = {(2, "ring"): [1]}
    for name, x in (("outer", middle + half), ("inner", middle - half)):
        lines = gmsh.model.getEntitiesInBoundingBox(x - 1e-6, -1, -1, x + 1e-6, 9, 1, 1)
        groups[1, name] = [t for _, t in lines]
    return groups


@pytest.mark.parametrize(
    ("draw", "size", "mesh", "own"),
    [
        (section, 0.3, 2, {"axisymmetric": True, "poling": {"ring": "radial"}}),
        (section, 0.3, 2, {"axisymmetric": True, "poling": {"ring": [1, 0, 0]}}),
        (ring, 1.5, 3,
         {"poling": {"ring": {"direction": [1, 0, 0], "through": ["20 mm", 0, 0]}}}),
    ],
)  # fmt: skip
def test_ring_poled_radially(tmp_path, draw, size, mesh, own):
    """A thin ring has hoop stress alone: its breathing mode lies at ``1/(2 pi a sqrt(rho s11))``,
    a field along the poling moves its wall by ``d31 a V/t``, its outer face by ``d33 V/2`` more,
    and the permittivity at constant stress gives its capacitance."""
    write(tmp_path / "ring.msh", draw, size=size, mesh=mesh)
    table = {"mesh": "ring.msh", "unit": "mm", "materials": {"ring": "PZT-5A"}, **own}
    table |= {"electrodes": {"anode": "inner", "cathode": "outer"}, "damping": {"ratio": 0}}
    port = {"name": "wall", "axis": "x", "group": "outer"}
    if mesh == 3:  # the mean over a whole turn is zero: a point of the wall
        port = {"name": "wall", "axis": "x", "at": [30.25e-3, 0, 0.25e-3]}
    facts = build_fe_model({**table, "ports": [port]}, tmp_path).model.facts
    pzt, (a, t, height) = find_material("PZT-5A"), (1e-3 * value for value in RING.values())
    breathing = 1 / (2 * np.pi * a * np.sqrt(pzt.density * np.linalg.inv(pzt.C)[0, 0]))
    assert facts["resonance_short_hz"] == pytest.approx(breathing, rel=5e-3)
    area = 2 * np.pi * a * height
    assert facts["capacitance_free_f"] == pytest.approx(pzt.eps_T[2, 2] * area / t, rel=5e-3)
    if mesh == 2:  # in space the ring is free to move, and so is a point of it
        stroke = pzt.d[2, 0] * a / t + pzt.d[2, 2] / 2
        assert facts["free_stroke_wall_m_per_v"] == pytest.approx(stroke, rel=2e-3)


def test_poling_that_twists_needs_three_dimensions(tmp_path):
    write(tmp_path / "ring.msh", section, size=0.3, mesh=2)
    table = {"mesh": "ring.msh", "unit": "mm", "materials": {"ring": "PZT-5A"}}
    table |= {"axisymmetric": True, "electrodes": {"anode": "inner", "cathode": "outer"}}
    with pytest.raises(UsageError, match="twists"):
        build_fe_model({**table, "poling": {"ring": "tangential"}}, tmp_path)
    table["materials"] = {"ring": "quartz"}
    with pytest.raises(UsageError, match="isotropic about its axis"):
        build_fe_model(table, tmp_path)


def stacked(boxes, *, join=False, sizes=()):
    """Boxes (x, y, z, dx, dy, dz) in millimetres, each with nodes of its own unless ``join``; the
    group of each is ``box0`` and so on, those of the faces below and above it ``low0``, ``high0``.
    """

    def draw(gmsh):
        occ, groups = gmsh.model.occ, {}
        solids = [occ.addBox(*box) for box in boxes]
        if join:
            occ.fragment([(3, solids[0])], [(3, tag) for tag in solids[1:]])
        occ.synchronize()
        for k, (tag, (_, _, z, _, _, dz)) in enumerate(zip(solids, boxes, strict=True)):
            groups[3, f"box{k}"] = [tag]
            faces = [t for _, t in gmsh.model.getBoundary([(3, tag)], oriented=False)]
            for name, height in (("low", z), ("high", z + dz)):
                flat = [t for t in faces if abs(occ.getCenterOfMass(2, t)[2] - height) < 1e-6]
                groups[2, f"{name}{k}"] = flat
        for k, size in enumerate(sizes):
            points = gmsh.model.getBoundary([(3, solids[k])], recursive=True)
            gmsh.model.mesh.setSize(points, size)
        return groups

    return draw


PLATES = [(0, 0, 0, 6, 2, 1), (0, 0, 1, 6, 2, 0.5)]


def plates(home, **changes):
    return build_fe_model({
        "mesh": "plates.msh", "unit": "mm", "materials": {"box0": "steel", "box1": "PZT-5A"},
        "fixed": ["low0"], "electrodes": {"anode": "high1", "cathode": "low1"}, **changes,
    }, home)  # fmt: skip


@pytest.mark.slow
def test_solids_that_share_no_nodes_are_refused_or_merged(tmp_path):
    """gmsh itself counts and removes the nodes that are twice there."""
    write(tmp_path / "plates.msh", stacked(PLATES), size=1, order=1)
    gmsh.initialize([], readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Verbosity", 0)
    gmsh.open(str(tmp_path / "plates.msh"))
    before = len(gmsh.model.mesh.getNodes()[0])
    gmsh.model.mesh.removeDuplicateNodes()
    twice = before - len(gmsh.model.mesh.getNodes()[0])
    (tmp_path / "joined").mkdir()
    gmsh.write(str(tmp_path / "joined" / "plates.msh"))
    gmsh.finalize()
    with pytest.raises(UsageError, match="solids touch but share no nodes") as error:
        plates(tmp_path)
    place = "x 0 … 6 mm, y 0 … 2 mm, z = 1 mm, groups box0, box1"
    assert error.value.got == f"{twice} pairs of coincident nodes, {place}"
    merged, joined = plates(tmp_path, merge="1 um"), plates(tmp_path / "joined")
    for name in ("unknowns", "capacitance_free_f", "resonance_short_hz"):
        assert merged.model.facts[name] == pytest.approx(joined.model.facts[name], rel=1e-9), name
    with pytest.raises(UsageError, match="the merge distance exceeds the shortest edge"):
        plates(tmp_path, merge="1.2 mm")


def test_solids_whose_meshes_do_not_match_are_refused(tmp_path):
    inside = [(0, 0, 0, 6, 2, 1), (1.3, 0.3, 1, 4, 1.1, 0.5)]
    write(tmp_path / "plates.msh", stacked(inside), size=1)
    with pytest.raises(UsageError, match="their meshes do not match") as error:
        plates(tmp_path)
    assert "x 1.3 … 5.3 mm, y 0.3 … 1.4 mm, z = 1 mm" in error.value.got
    write(tmp_path / "plates.msh", stacked([(0, 0, 0, 6, 2, 1), (0, 0, 1.1, 6, 2, 0.5)]), size=1)
    assert plates(tmp_path).model.facts["unknowns"]  # a gap between them: nothing touches


def test_rigid_motion_of_a_piece_is_no_resonance(tmp_path):
    """A ceramic that lies loose on a plate: its lowest resonance is that of a free bar poled across
    its thickness, ``1 / (2 length sqrt(density s11))``; damping is stated there."""
    write(tmp_path / "plates.msh", stacked(PLATES), size=1)
    pzt = find_material("PZT-5A")
    free_bar = 1 / (2 * 6e-3 * np.sqrt(pzt.density * np.linalg.inv(pzt.C)[0, 0]))
    model = plates(tmp_path, merge=0, damping={"ratio": 0.01}).model
    assert model.facts["resonance_short_hz"] == pytest.approx(free_bar, rel=0.03)
    assert model.rayleigh[1] == pytest.approx(0.01 / (np.pi * free_bar), rel=0.03)


def test_solids_hinged_at_an_edge_have_no_resonance_there(tmp_path):
    """Two blocks that share one edge: the second turns about it without any force."""
    corner = [(0, 0, 0, 3, 2, 1), (3, 0, 1, 3, 2, 0.5)]
    write(tmp_path / "plates.msh", stacked(corner, join=True), size=1)
    found = plates(tmp_path)
    assert found.shift > 0
    lowest = find_material("PZT-5A")
    bending = 0.5e-3 / (3e-3) ** 2 * np.sqrt(lowest.C[0, 0] / lowest.density)
    assert found.model.facts["resonance_short_hz"] > 0.05 * bending


@pytest.mark.parametrize(
    ("damping", "wanted"),
    [
        ({"loss_factor": 0.04}, lambda f: 0.02 * f / f[0]),
        ({"loss_factor": 0.04, "at": 5e3}, lambda f: 0.02 * f / 5e3),
        ({"quality": 25}, lambda f: 0.02 * f / f[0]),
        ({"ratio": 0.01, "at": 2e3, "alpha": 30.0},
         lambda f: 30 / (4 * np.pi * f) + 0.01 * f / 2e3),
        # zeta = a/f + b f through (1 kHz, 2 %) and (1.5 kHz, 1.5 %)
        ({"ratio": [0.02, 0.015], "at": [1e3, 1.5e3]}, lambda f: 18 / f + 2e-6 * f),
    ],
)  # fmt: skip
def test_modes_have_the_specified_damping(coarse, damping, wanted):
    """Ratios of the eigenvectors of the undamped body, ``phi' E phi / (2 omega)``."""
    ports = [{"name": "tip", "group": "end", "axis": "z"}]
    plain = {"materials": {"layer0": "steel", "layer1": "steel"}, "poling": {}, "electrodes": {}}
    model = build_fe_model(keys(**plain, ports=ports, damping=damping), coarse).model
    squares, modes = eigsh(model.K, 4, M=model.M, sigma=0.0)
    E = model.rayleigh[0] * model.M + model.rayleigh[1] * model.K
    omega = np.sqrt(squares)
    found = np.einsum("ni,ni->i", modes, E @ modes) / (2 * omega)
    order = np.argsort(omega)
    frequency = omega[order] / (2 * np.pi)
    frequency[0] = model.facts["resonance_hz"]
    np.testing.assert_allclose(found[order], wanted(frequency), rtol=1e-6)


@pytest.mark.slow
def test_damping_of_each_material(coarse):
    lossy = {"density": 7800, "youngs_modulus": "200 GPa", "poisson_ratio": 0.3, "quality": 50}
    table = {"layer0": lossy, "layer1": {**lossy, "quality": 50}}
    ports = [{"name": "tip", "group": "end", "axis": "z"}]
    changes = {"materials": table, "poling": {}, "electrodes": {}, "ports": ports}
    each = build_fe_model(keys(**changes, damping={"per_material": True}), coarse).model
    whole = build_fe_model(keys(**changes, damping={"quality": 50}), coarse).model
    f = np.array([each.facts["resonance_hz"]])
    # rounding of entries, times the square of the highest natural frequency over the first
    assert each.transfer(f) == pytest.approx(whole.transfer(f), rel=5e-10)


@pytest.mark.parametrize(("changes", "message"), [
    ({"fixed": ["foot"]}, "no such group"),
    ({"materials": {"layer0": "steel"}, "poling": {}}, "elements have no material"),
    ({"fixed": ["root"], "electrodes": {"anode": "level0", "cathode": "level2"}},
     "not piezoelectric"),
    ({"electrodes": {"anode": "layer1", "cathode": "level1"}}, "does not consist of faces"),
    ({"electrodes": {"anode": "level2", "cathode": ["level1", "root"]}}, "have common nodes|fixed"),
    ({"floating": ["level2"]}, "have common nodes"),
    ({"ports": [{"name": "a", "group": "root", "kind": "rigid"}]}, "touches a support"),
    ({"size": "1 mm"}, "size has no effect"),
    ({"mesh": "absent.msh"}, "does not exist"),
    ({"mesh": "coarse.stl"}, "not a mesh or CAD file"),
    ({"groups": {"a": {"faces": [[0, 0, 0]]}}}, "only to CAD files"),
    ({"unit": "kg"}, "this text is not a unit of length"),
])  # fmt: skip
def test_errors_name_the_group(coarse, changes, message):
    with pytest.raises(UsageError, match=message):
        build_fe_model(keys(**changes), coarse)


def test_pick_that_misses_names_its_point(tmp_path):
    write(tmp_path / "beam.step", slabs([0, 0.4], 12, 3), size=1)
    table = {
        "mesh": "beam.step", "size": "2 mm", "materials": {"all": "steel"},
        "groups": {"all": {"solids": [["1 mm", "1 mm", "0.1 mm"]]}, "foot": {"faces": [[1, 0, 0]]}},
        "ports": [{"name": "tip", "at": ["12 mm", 0, 0], "axis": "z"}],
    }  # fmt: skip
    with pytest.raises(UsageError, match="no face contains") as error:
        build_fe_model(table, tmp_path)
    assert error.value.where == "body: groups.foot.at"


@pytest.mark.parametrize(("changes", "message"), [
    ({"electrodes": {"anode": "level2"}}, "at least two electrodes"),
    ({"poling": {"layer7": [0, 0, 1]}}, "without a material"),
    ({"ports": [{"name": "a", "group": "end", "axis": "rx"}]}, "needs the key `axis`"),
    ({"ports": [{"name": "a", "axis": "x"}]}, "needs the key `group`"),
    ({"ports": [{"name": "a b", "group": "end", "axis": "x"}]}, "pattern"),
    ({"electrodes": {}, "ports": []}, "electrodes or ports"),
])  # fmt: skip
def test_bad_tables(changes, message):
    with pytest.raises(ValidationError, match=message):
        keys(**changes)


def test_the_electrode_called_ground_is_the_return_of_all_others():
    keys = BodyKeys(
        mesh="x.msh", materials={"a": "PZT-5A"}, electrodes={"ground": "low", "anode": "top"}
    )
    assert [port.pins for port in keys.all_ports] == [("anode", "ground")]
