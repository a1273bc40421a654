"""Heat in solids: published problems, closed forms, convergence, and energy.

The problems ``VMnnn`` are those of the Ansys Mechanical APDL Verification Manual, whose inputs are
in ``ansys/pymapdl`` under ``src/ansys/mapdl/core/examples/verif``. Their numbers, in feet, hours,
pounds, British thermal units and degrees Fahrenheit, are used as if they were SI: the equation of
heat is the same in all units. A scene computes the rise over the initial temperature. Targets of
the manual that were read off charts differ from the series by up to 3 %.
"""

from pathlib import Path

import gmsh
import meshio
import numpy as np
import pytest
import scipy
from pydantic import Field
from scipy.special import erfc
from skfem.mesh import MeshHex, MeshLine, MeshQuad, MeshTri
from support import (
    Declaration,
    DeclaredPart,
    HeatBoundaryConditions,
    HeatSolid,
    Port,
    Solid,
    UsageError,
    assemble_faces,
    assemble_heat,
    branch,
    compute_node_shares,
    duplicate_face_nodes,
    evaluate_functions_at_point,
    find_common_faces,
    find_face_nodes,
    find_thermal_material,
    load_thermal_library,
    make_heat_model,
    parttype,
    recover_temperatures,
    write_temperatures,
)

import kc2spice as kc

STEP = {"width": "1e9 s", "edge": "1e-5 s"}


def substance(k, density, specific_heat):
    return {"conductivity": k, "density": density, "specific_heat": specific_heat}


def wall(material, thickness, **keys):
    """A wall of unit area; pins along its height take in no heat."""
    layers = [{"material": material, "thickness": thickness, "area": 1.0}]
    return {"part": "heat_body", "layers": layers, "refine": 8, **keys}


def step(kind, high, **keys):
    return {"part": "source", "kind": kind, "pulse": {"high": high, **STEP}, **keys}


def points(**heights):
    return {pin: {"at": [0, 0, height]} for pin, height in heights.items()}


def final_rises(stop, *pins, **parts):
    """Temperature rises of pins of the part ``wall`` at the end of a transient."""
    solver = {"stop": stop, "reltol": 1e-6, "max_step": stop / 2000}
    probes = {pin: {"of": f"wall.temperature.{pin}", "take": "final"} for pin in pins}
    scene = {"name": "heated", "gravity": 0.0, "solver": solver, "probes": probes, **parts}
    metrics = kc.run(scene).metrics
    return np.array([metrics[pin] for pin in pins])


def film_roots(biot, count=200):
    """Roots of ``z tan z = biot``: decay of a slab that is insulated at x = 0."""
    return np.array([
        scipy.optimize.brentq(lambda z: z * np.tan(z) - biot, n * np.pi, (n + 0.5 - 1e-12) * np.pi)
        for n in range(count)
    ])  # fmt: skip


def film_decay(biot, x, fourier):
    """Decay of a slab in a film, at x between 0 (insulated) and 1 (film)."""
    roots = film_roots(biot)
    parts = 4 * np.sin(roots) / (2 * roots + np.sin(2 * roots)) * np.exp(-(roots**2) * fourier)
    return np.cos(np.multiply.outer(x, roots)) @ parts


def test_a_thick_slab_under_a_film_follows_the_error_function():
    """VM28: nodes of a line of eleven intervals, the one at the surface a tenth of the first."""
    sizes = np.geomspace(1.0, 0.1, 11)
    nodes = np.concatenate([[0.0], np.cumsum(sizes) / sizes.sum()])
    heights = {f"n{k}": float(nodes[k - 1]) for k in (11, 9, 7, 5)}
    values = final_rises(
        2000.0, *heights,
        wall=wall(
            substance(54.0, 7833.0, 465.0), 1.0, sources=points(**heights),
            films=[{"group": "top", "coefficient": 50.0, "pin": "gas"}],
            pins={"gas": "fire.out"},
        ),
        fire=step("temperature", 1000.0),
    )  # fmt: skip
    # of a half-space (H. S. Carslaw, J. C. Jaeger, Conduction of Heat in Solids, 2.7)
    h, root = 50.0 / 54.0, np.sqrt(54.0 / (7833.0 * 465.0) * 2000.0)
    x = 1.0 - np.array([*heights.values()])
    exact = erfc(x / (2 * root)) - np.exp(h * x + (h * root) ** 2) * erfc(x / (2 * root) + h * root)
    assert np.abs(values / (1000.0 * exact) - 1).max() < 2e-3
    assert values[:2] == pytest.approx([140.0, 98.9], rel=0.01)
    assert values[2:] == pytest.approx([51.8, 14.5], rel=0.05)


def test_a_wall_under_hot_gas_is_that_of_vm110():
    found = 100.0 + final_rises(
        14.5, *"acegik",
        wall=wall(
            substance(0.54, 144.0, 0.2), 1.0,
            sources=points(a=0, c=0.2, e=0.4, g=0.6, i=0.8, k=1.0),
            films=[{"group": "top", "coefficient": 5.0, "pin": "gas"}],
            pins={"gas": "fire.out"},
        ),
        fire=step("temperature", 1500.0),
    )  # fmt: skip
    decay = film_decay(5.0 / 0.54, np.linspace(0, 1, 6), 0.54 / (144.0 * 0.2) * 14.5)
    assert found == pytest.approx(1600.0 - 1500.0 * decay, rel=1e-4)
    assert found == pytest.approx([505.0, 550.0, 670.0, 865.0, 1135.0, 1435.0], rel=0.013)


def exact_slab(material, thickness, x, t, start, surface, generated):
    """Series of a slab with one insulated face, at the depth x below the other one."""
    k, density, c = material.values()
    beta = (np.arange(200) + 0.5) * np.pi / thickness
    rest = surface + generated / k * (thickness * x - x**2 / 2)
    parts = 2 / (beta * thickness) * ((start - surface) - generated / (k * beta**2))
    decay = np.exp(-k / (density * c) * beta**2 * t)
    return rest + (parts * np.sin(np.multiply.outer(x, beta)) * decay).sum(axis=-1)


def test_a_slab_that_generates_heat_is_that_of_vm115():
    """The surface cools from 60 to 32 degrees while every unit of volume generates 4e4."""
    material = substance(20.0, 500.0, 0.2)
    places = {"n3": 0.1, "n4": 0.2, "n5": 0.3, "n6": 0.4, "n2": 0.5}
    found = 60.0 + final_rises(
        0.2, *places,
        wall=wall(
            material, 0.5, sources={"inside": "layer1", **points(**places)},
            isothermal={"surface": "bottom"}, rom={"tolerance": 1e-6, "band": [0, 1e5]},
            pins={"inside": "heater.out", "surface": "cold.out"},
        ),
        heater=step("heat_flow", 4e4 * 0.5),
        cold=step("temperature", -28.0),
    )  # fmt: skip
    exact = exact_slab(material, 0.5, np.array([*places.values()]), 0.2, 60.0, 32.0, 4e4)
    assert found == pytest.approx(exact, rel=3e-5)
    assert found == pytest.approx([75.75, 103.99, 120.80, 129.46, 132.1], rel=1e-3)


class FilmKeys(kc.Section):
    """Film whose coefficient grows with the temperature rise."""

    linear: float = Field(description="Heat flow of each kelvin")
    square: float = Field(description="Heat flow of each kelvin squared")


def test_a_plate_with_a_cooled_face_is_that_of_vm116(monkeypatch):
    """From 500 to 100 degrees across the plate; then a film to 100 degrees cools the hot face.

    Its coefficient is 2 + 0.02 (T - 100), which a declared part states. At first a source supplies
    the heat of the plate and of the film.
    """
    film = Declaration(
        "film", "film", FilmKeys, (branch("temperature"),),
        content="linear*temperature^2/2 + square*temperature^3/3",
    )  # fmt: skip
    monkeypatch.setitem(parttype._types, "film", DeclaredPart(film))
    material = substance(2.0, 800.0, 0.833)
    flow = 2.0 * 400.0 / (8 / 12) + 2.0 * 400.0 + 0.02 * 400.0**2
    found = final_rises(
        7.0, "hot",
        wall=wall(
            material, 8 / 12, sources={"hot": "top"}, fixed=["bottom"], pins={"hot": "oven.out"}
        ),
        oven={"part": "source", "kind": "heat_flow", "pulse": {"low": flow, "high": 0.0, **STEP}},
        film={"part": "film", "linear": 2.0, "square": 0.02, "pins": {"a": "wall.hot"}},
    )  # fmt: skip
    assert 100.0 + found == pytest.approx([285.0], rel=0.01)


def write_mesh(path, draw, size, dimension):
    """Write a mesh by gmsh; ``draw(gmsh)`` returns groups {(dimension, name): tags}."""
    gmsh.initialize([], readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    for (of_group, name), tags in draw(gmsh).items():
        gmsh.model.addPhysicalGroup(of_group, tags, name=name)
    gmsh.option.setNumber("Mesh.MeshSizeMax", size)
    gmsh.model.mesh.generate(dimension)
    gmsh.model.mesh.setOrder(2)
    gmsh.write(str(path))
    gmsh.finalize()


def inside(gmsh, dimension, low, high):
    """Tags of the entities within a box."""
    box = [*(np.array(low) - 1e-6), *(np.array(high) + 1e-6)]
    return [tag for _, tag in gmsh.model.getEntitiesInBoundingBox(*box, dimension)]


def run_text(home, text):
    (home / "heated.toml").write_text('name = "heated"\ngravity = 0.0\n' + text)
    return kc.run(home / "heated.toml").metrics


def test_a_sphere_in_cold_air_is_that_of_vm111(tmp_path):
    """A sphere cools from 65 to 28 degrees at its centre within six hours."""
    radius = 1 / 6

    def draw(gmsh):
        """Half a disc, whose x is the radius and y the height."""
        add = gmsh.model.geo
        low, centre, high = (add.addPoint(0, y, 0) for y in (-radius, 0, radius))
        side = add.addPoint(radius, 0, 0)
        arcs = [add.addCircleArc(low, centre, side), add.addCircleArc(side, centre, high)]
        axis = add.addLine(high, low)
        face = add.addPlaneSurface([add.addCurveLoop([*arcs, axis])])
        add.synchronize()
        return {(2, "ball"): [face], (1, "skin"): arcs}

    write_mesh(tmp_path / "ball.msh", draw, radius / 6, 2)
    metrics = run_text(tmp_path, f"""
[ball]
part = "heat_body"
mesh = "ball.msh"
unit = "m"
axisymmetric = true
materials = {{ ball = {{ conductivity = {1 / 3}, density = 62.0, specific_heat = 1.0752677 }} }}
sources = {{ centre = {{ at = [0, 0, 0] }} }}
films = [{{ group = "skin", coefficient = 2.0, pin = "air" }}]
pins = {{ air = "cold.out" }}

[cold]
part = "source"
kind = "temperature"
pulse = {{ high = "-40 K", width = "1e9 s", edge = "1e-5 s" }}

[solver]
stop = 6.0
max_step = 0.003
reltol = 1e-6

[probes]
centre = {{ of = "ball.temperature.centre", take = "final" }}
""")  # fmt: skip
    biot, rate = 2.0 * radius / (1 / 3), (1 / 3) / (62.0 * 1.0752677) / radius**2
    roots = np.array([
        scipy.optimize.brentq(
            lambda z: 1 - z / np.tan(z) - biot, n * np.pi + 1e-9, (n + 1) * np.pi - 1e-9
        )
        for n in range(50)
    ])  # fmt: skip
    parts = 4 * (np.sin(roots) - roots * np.cos(roots)) / (2 * roots - np.sin(2 * roots))
    exact = 25.0 + 40.0 * np.sum(parts * np.exp(-(roots**2) * rate * 6.0))
    assert 65.0 + metrics["centre"] == pytest.approx(exact, rel=1e-4)
    assert 65.0 + metrics["centre"] == pytest.approx(28.0, rel=0.03)  # from a chart


def test_a_wire_that_carries_1000_a_is_that_of_vm118(tmp_path):
    """A length of 1 of the wire generates heat; its surface gives it off to air of 70 degrees."""
    radius, generated = 0.375 / 12, 111311.7

    def draw(gmsh):
        face = gmsh.model.occ.addRectangle(0, 0, 0, radius, 1.0)
        gmsh.model.occ.synchronize()
        skin = inside(gmsh, 1, [radius, 0, 0], [radius, 1, 0])
        return {(2, "wire"): [face], (1, "skin"): skin}

    write_mesh(tmp_path / "wire.msh", draw, radius / 4, 2)
    metrics = run_text(
        tmp_path,
        f"""
[wire]
part = "heat_body"
mesh = "wire.msh"
unit = "m"
axisymmetric = true
materials = {{ wire = {{ conductivity = 13.0, density = 1.0, specific_heat = 1.0 }} }}
sources = {{ heat = "wire", axis = {{ at = [0, 0, 0.5] }}, face = "skin" }}
films = [{{ group = "skin", coefficient = 5.0 }}]
pins = {{ heat = "current.out" }}

[current]
part = "source"
kind = "heat_flow"
dc = "{generated * np.pi * radius**2} W"

[analysis]
type = "op"

[probes]
axis = {{ of = "wire.temperature.axis", take = "final" }}
face = {{ of = "wire.temperature.face", take = "final" }}
""",
    )
    surface = generated * radius / (2 * 5.0)
    centre = surface + generated * radius**2 / (4 * 13.0)
    assert metrics["face"] == pytest.approx(surface, rel=1e-4)
    assert metrics["axis"] == pytest.approx(centre, rel=1e-4)
    assert 70 + metrics["axis"] == pytest.approx(419.9, rel=1e-3)
    assert 70 + metrics["face"] == pytest.approx(417.9, rel=1e-3)


@pytest.mark.slow
def test_an_orthotropic_bar_is_that_of_vm113(tmp_path):
    """A quarter of a bar of 4 by 2 inches cools from 500 degrees in air of 100 within 3 s."""
    length, width, depth = 2 / 12, 1 / 12, 1 / 36

    def draw(gmsh):
        bar = gmsh.model.occ.addBox(0, 0, 0, length, width, depth)
        gmsh.model.occ.synchronize()
        skin = inside(gmsh, 2, [length, 0, 0], [length, width, depth])
        skin += inside(gmsh, 2, [0, width, 0], [length, width, depth])
        return {(3, "bar"): [bar], (2, "skin"): skin}

    write_mesh(tmp_path / "bar.msh", draw, width / 4, 3)
    places = {"n1": (0, 0), "n7": (length, width), "n13": (length, 0), "n2": (0, width)}
    sources = "".join(f"{n} = {{ at = [{x}, {y}, 0] }}\n" for n, (x, y) in places.items())
    probes = "".join(f'{n} = {{ of = "bar.temperature.{n}", take = "final" }}\n' for n in places)
    metrics = run_text(
        tmp_path,
        f"""
[bar]
part = "heat_body"
mesh = "bar.msh"
unit = "m"
films = [{{ group = "skin", coefficient = 240.0, pin = "air" }}]
pins = {{ air = "cold.out" }}

[bar.materials.bar]
conductivity = [20.0, 3.6036, 20.0]
density = 400.0
specific_heat = 0.009009

[bar.sources]
{sources}
[cold]
part = "source"
kind = "temperature"
pulse = {{ high = "-400 K", width = "1e6 s", edge = "1e-9 s" }}

[solver]
stop = {3 / 3600}
max_step = 5e-7
reltol = 1e-6

[probes]
{probes}
""",
    )
    found = 500.0 + np.array([metrics[name] for name in places])
    time = (3 / 3600) / (400.0 * 0.009009)
    along = film_decay(240.0 * length / 20.0, np.array([0.0, 1.0]), 20.0 * time / length**2)
    across = film_decay(240.0 * width / 3.6036, np.array([0.0, 1.0]), 3.6036 * time / width**2)
    exact = [along[int(x > 0)] * across[int(y > 0)] for x, y in places.values()]
    assert found == pytest.approx(100.0 + 400.0 * np.array(exact), rel=2e-3)
    assert found == pytest.approx([459.0, 151.0, 279.0, 202.0], rel=0.025)  # from charts


def cylinder(cells, material):
    """A cylinder of 10 mm by 10 mm in ``cells`` squares along each side."""
    side = np.linspace(0.0, 1e-2, cells + 1)
    mesh = MeshTri.init_tensor(side, side)
    solid = HeatSolid(Solid(mesh, (), np.zeros(mesh.nelements, int), True), (material,))
    bottom = mesh.facets_satisfying(lambda x: x[1] < 1e-9)
    top = mesh.facets_satisfying(lambda x: (x[1] > 1e-2 - 1e-9) & (x[0] < 0.5e-2 + 1e-9))
    return solid, bottom, top


COPPER = find_thermal_material("copper")


def test_quadratic_elements_converge_with_the_fourth_power_of_their_size():
    """Lowest decay rate of a cylinder whose faces are cold: (j01/R)^2 + (pi/h)^2."""
    exact = (scipy.special.jn_zeros(0, 1)[0] / 1e-2) ** 2 + (np.pi / 1e-2) ** 2
    errors = []
    for cells in (4, 8):
        solid, *_ = cylinder(cells, COPPER)
        mesh = solid.geometry.mesh
        cold = mesh.facets_satisfying(
            lambda x: (x[0] > 1e-2 - 1e-9) | (x[1] < 1e-9) | (x[1] > 1e-2 - 1e-9)
        )
        free = np.setdiff1d(np.arange(solid.node_count), find_face_nodes(solid.geometry, cold))
        E, K = (matrix[free][:, free].toarray() for matrix in assemble_heat(solid))
        rate = scipy.linalg.eigh(K, E, eigvals_only=True, subset_by_index=[0, 0])[0]
        errors.append(rate * COPPER.capacity / 401.0 / exact - 1)
    assert 0 < errors[1] < errors[0] / 13
    assert errors[1] < 1e-4


@pytest.mark.slow
@pytest.mark.parametrize("isothermal", [False, True], ids=["even flow", "one temperature"])
def test_the_mesh_error_of_a_resistance_is_that_of_a_finer_mesh(isothermal):
    """Heat from a disc in a cylinder: half of the error to twice of it."""
    values = []
    for cells in (8, 64):
        solid, bottom, top = cylinder(cells, COPPER)
        port = Port("disc", "thermal")
        setup = HeatBoundaryConditions(fixed=find_face_nodes(solid.geometry, bottom))
        if isothermal:
            nodes = find_face_nodes(solid.geometry, top)
            setup = HeatBoundaryConditions(fixed=setup.fixed, isothermal=[(port, nodes)])
        else:
            shares = compute_node_shares(solid.geometry, facets=top)
            setup = HeatBoundaryConditions(fixed=setup.fixed, sources=[(port, shares)])
        values.append(make_heat_model(solid, setup).model.facts)
    coarse, fine = values
    name = "thermal_resistance_disc_k_per_w"
    error = abs(coarse[name] / fine[name] - 1)
    assert 0.5 < coarse["mesh_error_resistance"] / error < 2.5


def test_split_nodes_separate_two_materials_and_no_others():
    """A plate in four quarters, of which two touch across an interface."""
    side = np.linspace(0.0, 1.0, 5)
    mesh = MeshTri.init_tensor(side, side)
    x, y = mesh.p[:, mesh.t].mean(axis=1)
    geometry = Solid(mesh, (), (2 * (y > 0.5) + (x > 0.5)).astype(int))
    first, second = (np.flatnonzero(geometry.owner == k) for k in (2, 3))
    between = find_common_faces(geometry, first, second)
    split = duplicate_face_nodes(geometry, between)
    # quadratic nodes on the line, without the one that the other quarters join
    assert split.node_positions.shape[1] - geometry.node_positions.shape[1] == 2 * 2
    pieces = HeatSolid(split, tuple([COPPER] * 4))
    _, K = assemble_heat(pieces)
    assert np.abs(K @ np.ones(pieces.node_count)).max() < 1e-9


def test_a_point_has_no_resistance_and_no_mesh_error():
    """The temperature of a point that takes in heat grows without bound as the mesh is refined."""
    solid, bottom, top = cylinder(8, COPPER)
    fixed = find_face_nodes(solid.geometry, bottom)
    disc = Port("disc", "thermal"), compute_node_shares(solid.geometry, facets=top)
    spot = Port("spot", "thermal"), np.eye(solid.node_count)[-1]
    alone = make_heat_model(solid, HeatBoundaryConditions(fixed=fixed, sources=[disc])).model.facts
    setup = HeatBoundaryConditions(fixed=fixed, sources=[disc, spot], points=frozenset({"spot"}))
    assert make_heat_model(solid, setup).model.facts == pytest.approx(alone, rel=1e-12)


def test_areas_of_faces_are_those_of_a_cylinder():
    solid, bottom, top = cylinder(4, COPPER)
    assert assemble_faces(solid, bottom).sum() == pytest.approx(np.pi * 1e-4, rel=1e-12)
    assert assemble_faces(solid, top).sum() == pytest.approx(np.pi * 0.25e-4, rel=1e-12)


def test_layers_are_resistances_in_series():
    materials = {"silicon": (0.3e-3, 25e-6), "solder": (80e-6, 25e-6), "copper": (2e-3, 100e-6)}
    layers, expected = [], 1e-5 / 25e-6 + 1 / (500.0 * 100e-6)
    for name, (thickness, area) in materials.items():
        layers.append({"material": name, "thickness": thickness, "area": area})
        expected += thickness / (load_thermal_library()[name]["conductivity"] * area)
    layers[1]["resistance"] = "1e-5 m2 K/W"
    scene = {
        "name": "layers", "gravity": 0.0,
        "die": {"part": "heat_body", "layers": layers, "sources": {"junction": "top"},
                "films": [{"group": "bottom", "coefficient": "500 W/(m2 K)"}],
                "pins": {"junction": "drive.out"}},
        "drive": {"part": "source", "kind": "heat_flow", "dc": "2 W"},
        "analysis": {"type": "op"},
        "probes": {"rise": {"of": "die.temperature.junction", "take": "final"}},
    }  # fmt: skip
    metrics = kc.run(scene).metrics
    assert metrics["rise"] == pytest.approx(2.0 * expected, rel=1e-6)
    resistance = metrics["thermal_resistance_junction_k_per_w"]
    assert resistance == pytest.approx(expected, rel=1e-9)


def test_constants_of_the_library_have_sources():
    path = Path(__file__).parents[2] / "docs" / "reference" / "thermal_materials.md"
    rows = path.read_text("utf-8").splitlines()
    for name, table in load_thermal_library().items():
        (row,) = [row for row in rows if row.startswith(f"| `{name}` |")]
        assert f"| {table['density']:g} | {table['source']} |" in row
        material = find_thermal_material(name)
        assert table["source"], name
        assert 1e5 < material.capacity < 1e7, name
        assert 0.1 < material.conductivity.max() < 500, name


DIE = {
    "part": "heat_body",
    "layers": [{"material": "silicon", "thickness": "0.3 mm", "area": "25 mm2"}],
    "sources": {"junction": "top"},
    "fixed": ["bottom"],
}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"fixed": []}, "heat cannot leave the body"),
        ({"sources": {"junction": "lid"}}, "layers have no such group"),
        ({"sources": {"ambient": "top"}}, "pin of the surroundings"),
        ({"sources": {"bottom": "top"}, "isothermal": {"bottom": "bottom"}},
         "pins have the same name"),
        ({"isothermal": {"case": "bottom"}}, "common nodes"),
        ({"isothermal": {"case": "layer1"}}, "not a face"),
        ({"films": [{"group": "top", "coefficient": "-1 W/(m2 K)"}]}, "out of range"),
        ({"films": [{"group": "top", "coefficient": "5 W/m2"}]}, "wrong unit"),
        ({"materials": {"a": "copper"}}, "layers cannot be combined with"),
        ({"mesh": "a.msh"}, "either the key `mesh` or the key `layers`"),
        ({"layers": [{"material": "unobtainium", "thickness": "1 mm", "area": "1 mm2"}]},
         "has no thermal constants"),
        ({"layers": [{"material": substance(-1.0, 1.0, 1.0), "thickness": 1, "area": 1}]},
         "conductivity"),
    ],
)  # fmt: skip
def test_bad_bodies_are_refused_by_key(changes, words):
    pin = "case" if "isothermal" in changes else "junction"
    scene = {
        "name": "bad",
        "gravity": 0.0,
        "die": {**DIE, **changes, "pins": {pin: "drive.out"}},
        "drive": {"part": "source", "kind": "heat_flow", "dc": "1 W"},
        "analysis": {"type": "op"},
    }
    with pytest.raises(UsageError) as caught:
        kc.run(scene)
    assert words in str(caught.value), str(caught.value)
    assert "die" in str(caught.value)


def test_pins_of_heat_and_of_voltage_are_not_joined():
    scene = {
        "name": "bad", "gravity": 0.0, "die": {**DIE, "pins": {"junction": "drive.out"}},
        "drive": {"part": "source", "dc": "1 V"}, "analysis": {"type": "op"},
    }  # fmt: skip
    with pytest.raises(UsageError, match=r"unit|different"):
        kc.run(scene)


def test_a_body_without_ambient_conserves_energy():
    """Heat of 2 W for 3 s between two isothermal faces of a body that nothing cools."""
    layers = [{"material": "copper", "thickness": "5 mm", "area": "100 mm2"}]
    scene = {
        "name": "closed", "gravity": 0.0,
        "bar": {"part": "heat_body", "layers": layers,
                "isothermal": {"hot": "top", "cold": "bottom"}, "pins": {"hot": "drive.out"}},
        "store": {"part": "thermal_capacitor", "capacity": "1 J/K",
                  "pins": {"a": "bar.cold", "b": "gnd"}},
        "path": {"part": "thermal_resistor", "resistance": "1e9 K/W", "pins": {"a": "bar.cold"}},
        "drive": {"part": "source", "kind": "heat_flow",
                  "pulse": {"high": "2 W", "width": "3 s", "edge": "1 ms"}},
        "solver": {"stop": 20.0, "reltol": 1e-6, "max_step": 5e-3},
        "probes": {"rise": {"of": "bar.temperature.cold", "take": "final"}},
    }  # fmt: skip
    capacity = 1.0 + COPPER.capacity * 5e-3 * 1e-4
    assert kc.run(scene).metrics["rise"] == pytest.approx(2.0 * 3.0 / capacity, rel=1e-5)


def test_a_line_of_layers_has_the_capacity_of_its_volume():
    mesh = MeshLine(np.linspace(0.0, 1e-2, 5))
    solid = HeatSolid(Solid(mesh, (), np.zeros(4, int)), (COPPER,), areas=np.full(4, 2e-4))
    E, _ = assemble_heat(solid)
    assert E.sum() == pytest.approx(COPPER.capacity * 2e-6, rel=1e-12)


def test_the_file_of_temperatures_holds_right_handed_hexahedra(tmp_path):
    """Corners and nodes in the middle of edges have the order that VTK states."""
    side = np.linspace(0.0, 1e-2, 3)
    geometry = Solid(MeshHex.init_tensor(side, side, side), (), np.zeros(8, int))
    solid = HeatSolid(geometry, (COPPER,))
    bottom = geometry.mesh.facets_satisfying(lambda p: p[2] < 1e-9)
    source, fixed = (Port("in", "thermal"), np.ones(125) / 125), find_face_nodes(geometry, bottom)
    heat = make_heat_model(solid, HeatBoundaryConditions(sources=[source], fixed=fixed))
    write_temperatures(tmp_path / "a.vtu", heat, 300.0 * geometry.node_positions[2])
    found = meshio.read(tmp_path / "a.vtu")
    (block,) = found.cells
    assert block.type == "hexahedron27"
    corners = found.points[block.data[:, :8]]
    assert (np.linalg.det(corners[:, (1, 3, 4)] - corners[:, :1]) > 0).all()
    rises = found.point_data["temperature_rise"]
    assert rises == pytest.approx(300.0 * found.points[:, 2], abs=1e-12)
    edges = [(0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4)]
    for k, (a, b) in enumerate(edges):
        halfway = (found.points[block.data[:, a]] + found.points[block.data[:, b]]) / 2
        assert found.points[block.data[:, 8 + k]] == pytest.approx(halfway, abs=1e-12)


def heated_wall(**changes):
    """5 cm of copper under a heat flow of 1e5 W from t = 0 on, cold on the other face."""
    return {
        "name": "heated", "gravity": 0.0, "solver": {"stop": 20.0, "max_step": 0.01},
        "wall": wall(substance(400.0, 8960.0, 385.0), 0.05, sources={"face": "top"},
                     fixed=["bottom"], fields=[5.0], pins={"face": "fire.out"}),
        "fire": step("heat_flow", 1e5),
    } | changes  # fmt: skip


def test_temperatures_inside_a_wall_follow_the_series(tmp_path):
    """H. S. Carslaw, J. C. Jaeger, Conduction of Heat in Solids, 3.8: a flux into one face."""
    k, rate, L, q = 400.0, 400.0 / (8960.0 * 385.0), 0.05, 1e5
    beta = (np.arange(200) + 0.5) * np.pi / L

    def exact(x, t):
        parts = 2 * (-1.0) ** np.arange(200) / (beta**2 * L) * np.exp(-rate * beta**2 * t)
        return q / k * (x - np.sin(np.multiply.outer(x, beta)) @ parts)

    done = kc.run(heated_wall(), out=tmp_path / "out")
    for stem, instant in {"": 20.0, "_1": 5.0}.items():
        found = meshio.read(tmp_path / "out" / f"wall_temperatures{stem}.vtu")
        heights = found.points[:, 2]
        assert np.ptp(heights) == pytest.approx(L)
        wanted = exact(heights, instant)
        assert found.point_data["temperature_rise"] == pytest.approx(wanted, abs=2e-3 * q * L / k)
    assert done.metrics["hottest_rise_layer1_material"] == pytest.approx(exact(L, 20.0), rel=2e-3)
    assert done.metrics["hottest_time_layer1_material"] == pytest.approx(20.0)


def cooled_line():
    """A line of copper of 5 cm and 1 m2, cold at the bottom, with a heat flow into the top."""
    geometry = Solid(MeshLine(np.linspace(0.0, 0.05, 9)), (), np.zeros(8, int))
    heights = geometry.node_positions[0]
    top = np.asarray(heights == heights.max(), float)
    setup = HeatBoundaryConditions(
        fixed=np.flatnonzero(heights == 0), sources=[(Port("face", "thermal"), top)]
    )
    return make_heat_model(HeatSolid(geometry, (COPPER,), np.ones(8)), setup), heights


def test_temperatures_under_a_ramp_do_not_depend_on_steps():
    """Heat flows are linear between samples, so that fine and coarse steps are both exact."""
    heat, _ = cooled_line()
    ends = []
    for count in (5, 20_000):  # steps above and below the limit for short steps
        t = np.linspace(0.0, 10.0, count)
        ends.append(recover_temperatures(heat, t, {"face": 1e4 * t}).find_nearest_rises(10.0))
    assert ends[1] == pytest.approx(ends[0], rel=1e-8, abs=1e-8 * ends[0].max())


def test_a_body_starts_in_equilibrium_with_the_first_heat_flow():
    heat, heights = cooled_line()
    t = np.linspace(0.0, 10.0, 11)
    field = recover_temperatures(heat, t, {"face": np.full(11, 1e5)})
    for instant in (0.0, 10.0):
        wanted = 1e5 / COPPER.conductivity[0] * heights
        assert field.find_nearest_rises(instant) == pytest.approx(wanted, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize(("changes", "words"), [
    ({"solver": {"stop": 1.0}}, "outside the simulated time range"),
    ({"analysis": {"type": "ac", "start": 1.0, "stop": 2.0, "points": 2},
      "fire": {"part": "source", "kind": "heat_flow", "ac": 1.0}},
     "needs a transient analysis"),
], ids=["instant", "analysis"])  # fmt: skip
def test_fields_that_a_run_cannot_have_are_refused(changes, words):
    with pytest.raises(UsageError, match=words) as error:
        kc.run(heated_wall(**changes))
    assert error.value.where == "scene, key wall.fields"


def test_points_are_found_in_their_quadrilateral():
    """The nearest centre is that of another cell, whose coordinates of the point are outside."""
    mesh = MeshQuad.init_tensor(np.array([0.0, 1.0, 1.2, 1.4]), np.array([0.0, 1.0]))
    solid = HeatSolid(Solid(mesh, (), np.zeros(3, int)), (COPPER,))
    point = np.array([0.95, 0.3])
    shares = evaluate_functions_at_point(solid, point)
    assert shares.sum() == pytest.approx(1.0)
    assert solid.geometry.node_positions @ shares == pytest.approx(point, abs=1e-12)
