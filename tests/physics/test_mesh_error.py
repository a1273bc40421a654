"""Estimated mesh errors of bodies, against the same bodies on finer meshes."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from drawn_meshes import box_groups, drawn, rows
from support import (
    Header,
    StackKeys,
    StageTimer,
    Waveforms,
    bimorph,
    build_fe_model,
    build_models,
    compute_energy_products,
    compute_undamped_responses,
    describe_plan,
    disc,
    find_material,
    langevin,
    load_scene,
    make_stack,
)
from test_body import section, slabs, write

DATA = Path(__file__).parents[1] / "data"
SMALL = 1e-3  # errors of a thousandth and less are no reason to refine: both must be
REST = 0.6  # of the change from half as fine to fine, that is left: from quadratics to corners


def round_body(**table):
    return lambda refine, _: disc.make_disc_blocks(
        {**table, "mesh": {"refine": refine}}
    ).build_fe_model()


def beam(**table):
    return lambda refine, _: bimorph.make_bimorph_blocks(
        {**table, "mesh": {"refine": refine}}
    ).build_fe_model()


def sandwich(**table):
    return lambda refine, _: langevin.make_langevin_blocks(
        {**table, "mesh": {"refine": refine}}
    ).build_fe_model()


def chip(**table):
    mesh = {"sectors": 6, "outer_rings": 8}
    return lambda refine, _: make_stack(
        StackKeys(side=5e-3, height=5e-3, layers=8, mesh={**mesh, "refine": refine}, **table)
    )


def own(draw, size, mesh=3, order=1, **table):
    def make(refine, home):
        write(home / "own.msh", draw, size=size, order=order, mesh=mesh)
        return build_fe_model({"mesh": "own.msh", "unit": "mm", "refine": refine, **table}, home)

    return make


def solids(boxes, names):
    """Bonded boxes in millimetres, with the faces below and above each as groups."""

    def draw(gmsh):
        occ = gmsh.model.occ
        made = [(3, occ.addBox(*low, *np.subtract(high, low))) for low, high in boxes]
        if len(made) > 1:
            occ.fragment(made[:1], made[1:])
        occ.synchronize()
        return box_groups(gmsh, dict(zip(names, boxes, strict=True)), 1e-6)

    return draw


def long_hexahedra(gmsh):
    """A clamped unimorph of 60 hexahedra, which are 2 mm long, 2 mm wide and 0.15 mm thick."""
    groups = slabs([0, 0.25, 0.55], 30, 4)(gmsh)
    for _, tag in gmsh.model.getEntities(1):
        low, high = np.split(np.array(gmsh.model.getBoundingBox(1, tag)), 2)
        length = np.linalg.norm(high - low)
        count = 15 if length > 10 else 2 if length > 1 else 1
        gmsh.model.mesh.setTransfiniteCurve(tag, count + 1)
    for _, tag in gmsh.model.getEntities(2):
        gmsh.model.mesh.setTransfiniteSurface(tag)
        gmsh.model.mesh.setRecombine(2, tag)
    for _, tag in gmsh.model.getEntities(3):
        gmsh.model.mesh.setTransfiniteVolume(tag)
    return groups


def cup(gmsh):
    """Half of a cup with a ceramic under its floor, in a meridian plane."""
    occ = gmsh.model.occ
    pieces = [(2, occ.addRectangle(*corner, 0, *sides)) for corner, sides in (
        ((0, 0), (8, 1)), ((7, 1), (1, 6)), ((0, -0.5), (5, 0.5)))]  # fmt: skip
    occ.fragment(pieces[:1], pieces[1:])
    occ.synchronize()

    def inside(dimension, x, y):
        box = (x[0] - 1e-6, y[0] - 1e-6, -1, x[1] + 1e-6, y[1] + 1e-6, 1)
        return [tag for _, tag in gmsh.model.getEntitiesInBoundingBox(*box, dimension)]

    return {
        (2, "steel"): inside(2, (0, 8), (0, 7)), (2, "pzt"): inside(2, (0, 5), (-0.5, 0)),
        (1, "rim"): inside(1, (7, 8), (7, 7)), (1, "up"): inside(1, (0, 5), (0, 0)),
        (1, "low"): inside(1, (0, 5), (-0.5, -0.5)), (1, "floor"): inside(1, (0, 7), (1, 1)),
    }  # fmt: skip


PZT, METAL = "PZT-5A", "steel"
BENDER = {
    "materials": {"layer0": METAL, "layer1": PZT}, "fixed": ["root"],
    "electrodes": {"anode": "level2", "cathode": "level1"},
    "ports": [{"name": "tip", "group": "end", "axis": "z"}],
}  # fmt: skip
PAIR = [((0, 0, 0), (6, 2, 1)), ((0, 0, 1), (6, 2, 1.5))]
BRACKET = [((0, 0, 0), (20, 6, 2)), ((0, 0, 2), (2, 6, 16)), ((6, 0, 2), (16, 6, 2.6))]
TUBE = {"materials": {"ring": PZT}, "axisymmetric": True, "poling": {"ring": "radial"}}


def layers(*rows, **others):
    """Layers of a disc or a beam: material, thickness in mm, diameter in mm of a disc."""
    keys = ("material", "thickness", "diameter")
    table = [dict(zip(keys, (m, *(f"{x} mm" for x in sizes)), strict=False)) for m, *sizes in rows]
    return {"layers": table, **others}


def pieces(*rows):
    return [{"material": m, "diameter": d * 1e-3, "length": x * 1e-3} for m, d, x in rows]


# The body, and by how much the mesh of its reference is finer.
QUICK = {
    "buzzer": (round_body(**layers(("brass", 0.2, 20), (PZT, 0.22, 14))), 4),
    "clamped": (round_body(**layers(("brass", 0.3, 27), (PZT, 0.25, 20)), support="clamped"), 4),
    "node": (round_body(**layers((METAL, 0.3, 30), (PZT, 0.2, 25)), support={"node": 20e-3}), 4),
    "knife_edge": (
        round_body(**layers((METAL, 0.5, 20), (PZT, 0.5, 12)), support="simply_supported"), 4,
    ),
    "cup": (own(
        cup, 1.5, 2, materials={"steel": METAL, "pzt": PZT}, axisymmetric=True, fixed=["rim"],
        electrodes={"anode": "low", "cathode": "up"},
        ports=[{"name": "floor", "group": "floor", "axis": "z"}],
    ), 4),
}  # fmt: skip
SLOW = {
    "langevin": (sandwich(
        front=pieces(("aluminium", 20, 30)), back=pieces((METAL, 20, 20)),
        rings={"material": "PZT-8", "outer": 20e-3, "inner": 8e-3, "thickness": 3e-3},
        bolt={"material": METAL, "diameter": 6e-3},
    ), 3),
    "horn": (sandwich(
        front=pieces(("titanium", 30, 20), ("titanium", 12, 40)), back=pieces((METAL, 30, 25)),
        rings={"material": "PZT-8", "outer": 30e-3, "inner": 12e-3, "thickness": 5e-3},
        bolt={"material": METAL, "diameter": 8e-3},
    ), 3),
    "unimorph": (beam(**layers((METAL, 0.3), (PZT, 0.3)), length=20e-3, width=5e-3), 2),
    "parallel": (beam(
        **layers((PZT, 0.3), ("brass", 0.1), (PZT, 0.3)), length=30e-3, width=5e-3,
        wiring="parallel",
    ), 2),
    "bridge": (beam(
        **layers((METAL, 0.5), (PZT, 0.5)), length=20e-3, width=10e-3, support="clamped",
        points={"mid": 10e-3},
    ), 2),
    "free": (beam(**layers((METAL, 1), (PZT, 0.5)), length=30e-3, width=8e-3, support="free"), 2),
    "plate": (beam(**layers((METAL, 0.2), (PZT, 0.2)), length=5e-3, width=5e-3, support="quarter"),
              2),
    "bender": (own(slabs([0, 0.5, 0.8], 50, 10), 10, **BENDER), 2),
    "bender_fine": (own(slabs([0, 0.5, 0.8], 20, 5), 2.5, **BENDER), 2),
    "long_hexahedra": (own(long_hexahedra, 99, **BENDER), 4),
    "pair": (own(
        solids(PAIR, ["plate", "pzt"]), 3, materials={"plate": METAL, "pzt": PZT},
        fixed=["plate_left"], electrodes={"anode": "pzt_high", "cathode": "pzt_low"},
        ports=[{"name": "tip", "group": "pzt_right", "axis": "z"}],
    ), 2),
    "cube": (own(
        solids([((0, 0, 0), (5, 5, 5))], ["cube"]), 3, materials={"cube": PZT},
        fixed=["cube_low"], electrodes={"anode": "cube_high", "cathode": "cube_low"},
        ports=[{"name": "top", "group": "cube_high", "axis": "z"}],
    ), 2),
    "bracket": (own(
        solids(BRACKET, ["foot", "leg", "pzt"]), 4, order=2,
        materials={"foot": METAL, "leg": METAL, "pzt": PZT}, fixed=["leg_high"],
        electrodes={"anode": "pzt_high", "cathode": "pzt_low"},
        ports=[{"name": "tip", "group": "foot_right", "axis": "z"}],
    ), 2),
    "ring": (own(
        section, 0.5, 2, **TUBE, electrodes={"anode": "outer", "cathode": "inner"},
    ), 4),
    "stack": (chip(), 2),
    "stack_glued": (chip(mounting="glued"), 2),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(
    ("make", "finest"),
    [
        *(pytest.param(*row, id=name) for name, row in QUICK.items()),
        *(pytest.param(*row, id=name, marks=pytest.mark.slow) for name, row in SLOW.items()),
    ],
)
def test_error_estimates_are_within_two_of_the_error(tmp_path, make, finest):
    found, half, fine = (
        make(refine, tmp_path).model.facts for refine in (1, finest // 2 or 1, finest)
    )
    rows = {"resonance": "resonance_short_hz", "capacitance": "capacitance_free_f"}
    for name in fine:
        if name.startswith("free_stroke_") and abs(found[name] / fine[name] - 1) < 0.5:
            rows["stroke"] = name
    for word, name in rows.items():
        error = abs(found[name] / (fine[name] + REST * (fine[name] - half[name])) - 1)
        estimate = found[f"mesh_error_{word}"]
        near = max(error, estimate) < SMALL
        assert near or 0.5 < estimate / error < 2, f"{word}: {estimate:.2%} of {error:.2%}"


# Draws of fewer unknowns than the others.
SMALL_DRAWS = [0, 2, 4, 7, 11, 13, 14, 16, 18, 20, 25, 27, 28, 32, 33, 34, 35, 39, 41, 42, 46]


@pytest.mark.slow
@pytest.mark.parametrize(
    "number",
    [pytest.param(k, marks=[] if k in SMALL_DRAWS else [pytest.mark.campaign]) for k in range(48)],
)
def test_error_estimates_of_drawn_meshes_are_within_two_of_the_error(tmp_path, number):
    """Contributions to the error of a stroke have both signs: where they cancel by chance, the
    estimate is more than twice the error."""
    _, make, finest = drawn(number)
    for word, _, error, unsure, estimate in rows(make, tmp_path, finest):
        if max(error, estimate) < SMALL:
            continue
        told = f"{word}: {estimate:.2%} of {error:.2%} +- {unsure:.2%}"
        assert estimate > 0.5 * (error - unsure), told
        assert word == "stroke" or estimate < 2 * (error + unsure), told


@pytest.mark.slow
def test_fields_of_a_quadratic_stack_are_recovered_layer_by_layer(tmp_path):
    """Of the first mode strain and field jump at electrodes; averages across them make the estimate
    eight times too large."""
    _, make, _ = drawn(6)
    coarse, fine = (make(refine, tmp_path).model.facts for refine in (1, 2))
    error = abs(coarse["resonance_short_hz"] / fine["resonance_short_hz"] - 1)
    assert 0.5 < coarse["mesh_error_resonance"] / error < 2


# Errors of `long_hexahedra`, extrapolated from meshes of half and a quarter of the element size.
EXTRAPOLATED = {"resonance": 0.0075, "capacitance": 0.0056, "stroke": 0.0135}


def test_cubic_functions_detect_boundary_layers_in_long_hexahedra(tmp_path):
    """Recovery alone estimates 0.39 of the error of the stroke."""
    facts = own(long_hexahedra, 99, **BENDER)(1, tmp_path).model.facts
    assert facts["unknowns"] < 3000
    for word, error in EXTRAPOLATED.items():
        assert 0.5 < facts[f"mesh_error_{word}"] / error < 2, word


def test_energy_of_solutions_is_that_of_the_model():
    """``A(w, w)`` of a static answer is minus the free capacitance, of a mode its eigenvalue."""
    made = beam(**layers(("brass", 0.2), (PZT, 0.22)), length=4e-3, width=4e-3)(1, None)
    answers = compute_undamped_responses(made.model)
    z = np.hstack([answers.modes[:, :1], answers.static])
    products = compute_energy_products(
        made.solid, *made.compute_nodal_values(z, np.array([[0.0, 1.0]]))
    )
    omega = 2 * np.pi * made.model.facts["resonance_short_hz"]
    mass = answers.modes[:, 0] @ made.model.M @ answers.modes[:, 0]
    assert products.solution[0, 0] == pytest.approx(omega**2 * mass, rel=1e-6)
    assert -products.solution[1, 1] == pytest.approx(
        made.model.facts["capacitance_free_f"], rel=1e-6
    )


def test_uniform_strain_has_no_error():
    """A free plate in a uniform field: every element has the strain that recovery finds."""
    found = round_body(**layers((PZT, 1, 10)))(1, None).model.facts
    assert found["mesh_error_capacitance"] == pytest.approx(1e-4)  # the least that is stated
    exact = find_material(PZT).eps_T[2, 2] * np.pi * 25e-6 / 1e-3
    assert found["capacitance_free_f"] == pytest.approx(exact, rel=1e-4)


COARSE = """
[uni]
part = "body"
mesh = "coarse_unimorph.msh"
unit = "mm"
fixed = ["root"]
electrodes = { anode = "topel", cathode = "botel" }
ports = [{ name = "tip", group = "tip", axis = "z" }]
pins = { anode = "drive.out" }
[uni.materials]
steel = "steel"
[uni.materials.pzt]
density = 7800
symmetry = "6mm"
compliance = { s11 = 15.0e-12, s12 = -4.5e-12, s13 = -6.3e-12, s33 = 19.0e-12, s44 = 39e-12 }
strain_coupling = { d31 = -210e-12, d33 = 500e-12, d15 = 580e-12 }
permittivity = { eps11 = 1980, eps33 = 2400 }
permittivity_at = "stress"
[drive]
part = "source"
ac = "1 V"
[analysis]
type = "ac"
start = "50 Hz"
stop = "3 kHz"
points = 20
"""
# Of the same bender on meshes refined until nothing changed.
RIGHT = {"resonance_short_hz": 222.73, "free_stroke_tip_m_per_v": -700.08e-9,
         "capacitance_free_f": 11.848e-9}  # fmt: skip


def test_run_explain_and_header_state_the_error(tmp_path):
    """A mesh of 236 tetrahedra, 10 mm long and 0.3 mm thin."""
    shutil.copy(DATA / "coarse_unimorph.msh", tmp_path)
    (tmp_path / "s.toml").write_text(COARSE)
    build = build_models(load_scene(tmp_path / "s.toml"), StageTimer())
    part = build.scene.parts["uni"]
    facts = build.get_model_values(part)
    for word, (name, right) in zip(
        ("resonance", "stroke", "capacitance"), RIGHT.items(), strict=True
    ):
        error = abs(facts[name] / right - 1)
        assert error > 0.05
        assert 0.5 < facts[f"mesh_error_{word}"] / error < 2
    words = f"first resonance {100 * facts['mesh_error_resonance']:.2g} %"
    planned = describe_plan(build)
    assert words in planned["parts"][0]["detail"]
    (refine,) = [row for row in planned["settings"] if row["key"] == "uni.refine"]
    assert refine["error"] == max(v for k, v in facts.items() if k.startswith("mesh_error_"))
    (made,) = part.type.subcircuits(part, build, Header("s", "-"))
    assert f"* mesh: error estimate of the full model: {words}" in made.text
    f = np.array([50.0, 3e3])
    waves = Waveforms({"frequency": f, "uni.voltage": f * 0 + 1.0, "uni.current": 1j * f}, {})
    checks = {check.name: check for check in part.type.checks(part, build, waves)}
    stroke = checks["mesh of uni, stroke"]
    assert stroke.value == facts["mesh_error_stroke"] > 0.1
    assert not stroke.passed
    assert stroke.action == "warn"
