"""Film coefficients of meshes over their ranges: netlists against the full model in scipy."""

import re

import numpy as np
import pytest
import scipy
from support import HeatBodyKeys, assemble_heat_model
from test_heat_parameters import with_parameters

import kc2spice as kc

gmsh = pytest.importorskip("gmsh")
RANGE = (20.0, 2000.0)  # W/(m2 K)
SIZE = 0.01  # m
COPPER = {"conductivity": 390.0, "density": 8900.0, "specific_heat": 385.0}
EPOXY = {"conductivity": 0.3, "density": 1200.0, "specific_heat": 1100.0}


def draw_block():
    """Two blocks on one another; the heat enters a part of the top."""
    lower = gmsh.model.occ.addBox(0, 0, 0, SIZE, SIZE, 0.3 * SIZE)
    upper = gmsh.model.occ.addBox(0, 0, 0.3 * SIZE, 0.5 * SIZE, 0.5 * SIZE, 0.2 * SIZE)
    gmsh.model.occ.fragment([(3, lower)], [(3, upper)])
    gmsh.model.occ.synchronize()
    return 3


def draw_disc():
    """The same as a body of revolution."""
    lower = gmsh.model.occ.addRectangle(0, 0, 0, SIZE, 0.3 * SIZE)
    upper = gmsh.model.occ.addRectangle(0, 0.3 * SIZE, 0, 0.5 * SIZE, 0.2 * SIZE)
    gmsh.model.occ.fragment([(2, lower)], [(2, upper)])
    gmsh.model.occ.synchronize()
    return 2


def write_body(folder, draw):
    gmsh.initialize([], readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    dimension = draw()
    up = dimension - 1  # coordinate along the height
    parts = sorted(
        gmsh.model.getEntities(dimension), key=lambda e: gmsh.model.occ.getCenterOfMass(*e)[up]
    )
    for name, (_, tag) in zip(("base", "chip"), parts, strict=True):
        gmsh.model.addPhysicalGroup(dimension, [tag], name=name)
    faces = {}
    for face in gmsh.model.getEntities(dimension - 1):
        height = gmsh.model.occ.getCenterOfMass(*face)[up]
        for name, place in (("bottom", 0.0), ("top", 0.5 * SIZE)):
            if abs(height - place) < 1e-9:
                faces.setdefault(name, []).append(face[1])
    for name, tags in faces.items():
        gmsh.model.addPhysicalGroup(dimension - 1, tags, name=name)
    gmsh.option.setNumber("Mesh.MeshSizeMax", 0.2 * SIZE)
    gmsh.model.mesh.generate(dimension)
    gmsh.model.mesh.setOrder(2)
    gmsh.write(str(folder / "body.msh"))
    gmsh.finalize()
    return {
        "mesh": "body.msh",
        "unit": "m",
        "axisymmetric": dimension == 2,
        "materials": {"base": COPPER, "chip": EPOXY},
        "sources": {"junction": "top", "inside": "chip"},
        "films": [{"group": "bottom", "coefficient": 200.0}],
    }


def full_response(keys, home, coefficient, frequency):
    """Temperature of the junction [K] for 1 W into it."""
    films = [{**keys["films"][0], "coefficient": coefficient}]
    model = assemble_heat_model(HeatBodyKeys.model_validate({**keys, "films": films}), home).model
    K, E = map(scipy.sparse.csc_array, model.pencil.coefficients)
    b = model.B[:, [port.name for port in model.ports].index("junction")]
    result = []
    for f in frequency:
        solve = scipy.sparse.linalg.splu(scipy.sparse.csc_array(K + 2j * np.pi * f * E))
        result.append(b @ solve.solve(b.astype(complex)))
    return np.array(result), model.order


@pytest.mark.slow
@pytest.mark.parametrize("draw", [draw_block, draw_disc], ids=["3-D", "axisymmetric"])
def test_the_stated_error_holds_over_the_film_of_a_mesh(draw, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    keys = write_body(tmp_path, draw)
    ranged = {**keys, "rom": {"parameters": {"films[0].coefficient": list(RANGE)}}}
    scene = {
        "name": "ranged",
        "gravity": 0.0,
        "body": {"part": "heat_body", **ranged, "pins": {"junction": "loss.out"}},
        "loss": {"part": "source", "kind": "heat_flow", "ac": "1 W"},
        "analysis": {"type": "ac", "start": 1e-4, "stop": 1.0, "points": 9},
    }
    deck = kc.deck(scene)
    text = deck.files["ranged_body.lib"]
    order, norm, stated = re.search(r"order=(\d+) .*norm=(\w+) error=(\S+)", text).groups()
    size = []
    for coefficient in (RANGE[0], 90.0, 700.0, RANGE[1]):
        waves = kc.simulate(with_parameters(deck, {"films_0_coefficient": coefficient})).waves
        exact, unknowns = full_response(keys, tmp_path, coefficient, waves["frequency"].real)
        base = np.abs(exact) if norm == "pointwise" else np.abs(exact).max()
        error = np.abs(waves["body.temperature.junction"] - exact) / base
        assert error.max() <= 1.05 * float(stated) + 1e-7, coefficient
        size.append(abs(exact[0]))
    assert int(order) < unknowns / 10
    assert size[0] > 2 * size[-1]  # the film matters
