"""Estimated mesh errors of other parts, against finer meshes or rings."""

import tomllib

import numpy as np
import pytest
from support import (
    SPACING_NOTE,
    TEST_CURRENTS,
    CatchKeys,
    DampingKeys,
    Header,
    LoopModel,
    RingKeys,
    StageTimer,
    TransverselyIsotropicSphere,
    build_models,
    choose_compared_height_count,
    choose_pressure_basis,
    compare_loops_with_rings,
    compute_magnetostatic_table,
    compute_sphere_compliance,
    compute_test_forces,
    describe_plan,
    export_rom,
    find_material,
    list_mesh_errors,
    list_model_values,
    load_part_types,
    load_scene,
    make_sphere_model,
    moving_conductor,
    read_rom,
    write_rom,
)

import kc2spice as kc

UNKNOWN = "mesh: error not estimated, because the matrices come without a mesh"


def stated(tables, name, overrides=None):
    """Statements of ``explain``, of the result and of the header about one part."""
    build = build_models(load_scene(tables, overrides or {}), StageTimer())
    part = build.scene.parts[name]
    (detail,) = (row["detail"] for row in describe_plan(build)["parts"] if row["part"] == name)
    (made,) = part.type.subcircuits(part, build, Header("s", "-"))
    head = made.text[: made.text.index(".subckt")].replace("\n*  ", "")
    (line,) = (line for line in head.splitlines() if line.startswith("* mesh: "))
    return detail, list_model_values(build).get(name, {}), line.removeprefix("* ")


def chain(tmp_path):
    K = 1e4 * (2 * np.eye(4) - np.eye(4, k=1) - np.eye(4, k=-1))
    np.savez(tmp_path / "chain.npz", M=1e-3 * np.eye(4), K=K, B=np.eye(4)[:, :1])
    return tmp_path / "chain.npz"


def test_matrices_state_that_their_mesh_is_not_known(tmp_path):
    chain(tmp_path)
    (tmp_path / "s.toml").write_text(
        '[body]\npart = "matrices"\nfile = "chain.npz"\n'
        '[analysis]\ntype = "ac"\nstart = "10 Hz"\nstop = "1 kHz"\n'
    )
    detail, _, header = stated(tmp_path / "s.toml", "body")
    assert UNKNOWN in detail
    assert header == UNKNOWN


def exported(file):
    """Text of the library of a reduced model."""
    (path,) = (p for p in export_rom(file, file.parent / "out") if p.name == f"{file.stem}.lib")
    return path.read_text()


@pytest.mark.slow
def test_a_reduced_file_contains_the_facts_of_its_model(tmp_path):
    """Matrices alone, and matrices of a body whose mesh has an estimate."""
    model = kc.read_model(chain(tmp_path))
    small = kc.reduce(model, order=4, band=(0.0, 1e3))
    (file, *_) = write_rom(small, tmp_path, "chain_rom")
    assert f"* {UNKNOWN}\n" in exported(tmp_path / file)
    disc = {
        "part": "disc",
        "layers": [{"material": "PZT-5A", "diameter": "10 mm", "thickness": "1 mm"}],
    }
    scene = load_scene({"name": "s", "disc": disc, "analysis": {"type": "op"}}, {})
    body = kc.reduce(kc.build(scene)["disc"], order=4, band=(0.0, 1e6))
    (file, *_) = write_rom(body, tmp_path, "disc_rom")
    kept = list_mesh_errors(read_rom(tmp_path / file).facts)
    assert kept == list_mesh_errors(body.facts) != {}
    assert "* mesh: error estimate of the full model: first resonance" in exported(tmp_path / file)


LARGER = {
    "ring": RingKeys(height=4e-3, outer=9e-3, inner=5e-3, y=4e-3),
    "lower": RingKeys(height=3e-3, outer=5e-3, inner=3e-3, y=2e-3),
    "upper": RingKeys(height=3e-3, outer=5e-3, inner=3e-3, y=6e-3),
    "air_radius": 25e-3, "air_height": 60e-3,
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changes", "radius"),
    [
        pytest.param({}, 1e-3, id="paper"),
        pytest.param({"remanence": 1.2, "mu_r": 1.05}, 1e-3, id="strong"),
        pytest.param({**LARGER, "remanence": 1.0}, 2.5e-3, id="larger"),
    ],
)
def test_error_of_the_force_table_is_that_of_its_mesh(changes, radius):
    """Against a mesh three times as fine."""
    coarse = CatchKeys(positions=9, y_min=-2e-3, y_max=6e-3, **changes)
    table, exact = (
        compute_magnetostatic_table(CatchKeys(**{**coarse.model_dump(), "refine": n}), radius)
        for n in (1, 3)
    )
    errors = {
        "force": compute_test_forces(table, TEST_CURRENTS)
        - compute_test_forces(exact, TEST_CURRENTS),
        "inductance": table.inductance - exact.inductance,
    }
    largest = {"force": compute_test_forces(exact, TEST_CURRENTS), "inductance": exact.inductance}
    for name, error in errors.items():
        true = np.abs(error).max() / np.abs(largest[name]).max()
        assert 0.5 < table.facts[f"mesh_error_{name}"] / true < 2, (name, true)


def test_heights_of_the_coarser_mesh_are_some_of_the_table():
    assert [choose_compared_height_count(count) for count in (4, 5, 9, 24, 41, 161)] == [
        4,
        5,
        5,
        24,
        5,
        5,
    ]


def test_a_field_states_its_mesh():
    detail, facts, header = stated("em_force", "catch", {"catch.positions": 9})
    force = f"force {100 * facts['mesh_error_force']:.2g} %"
    assert f"error estimate of its mesh: {force}, inductance" in detail
    assert header.startswith(f"mesh: error estimate of the field: {force}, inductance")


@pytest.mark.slow
def test_a_conductor_states_its_rings():
    """Of 100 rings, against 1600; its settings show it at the key that refines them."""
    rings = {"conductor.rings": 100}
    detail, facts, header = stated("levitated_disc", "conductor", rings)
    text = f"flux, force and loss {100 * facts['mesh_error_rings']:.2g} %"
    assert f"error estimate of its {facts['rings']:.0f} rings: {text}" in detail
    assert header == f"mesh: error estimate of its {facts['rings']:.0f} rings: {text}"
    build = build_models(load_scene("levitated_disc", rings), StageTimer())
    errors = {row["key"]: row["error"] for row in describe_plan(build)["settings"]}
    assert errors["conductor.rings"] == facts["mesh_error_rings"]
    assert errors["conductor.tolerance"] is None
    part = build.scene.parts["conductor"]
    found, keys = build.model(part, LoopModel), part.keys
    fixed = [
        s
        for m in keys.magnets.values()
        for s in moving_conductor.compute_surface_currents(m, m.remanence)
    ]
    body = moving_conductor._divide_body(keys, 1600, found.frequency)
    coils = moving_conductor.make_windings(keys)
    true = compare_loops_with_rings(body, found, coils, fixed, keys.conductivity)
    assert 0.5 < found.ring_error / true < 2


def test_a_magnet_states_that_it_has_no_mesh():
    tables = {"name": "s", **tomllib.loads(load_part_types()["moving_magnet"].example)}
    tables["analysis"] = {"type": "op"}
    detail, facts, header = stated(tables, "moving_magnet")
    assert "no mesh: closed-form inductances of coaxial current loops" in detail
    assert header == "mesh: none: closed-form inductances of coaxial current loops"
    assert facts == {}


def test_a_contact_by_pressure_states_that_its_mesh_has_no_estimate():
    settings = {"contact.shape": "pressure", "kick.electrical": "open", "kick.layers": 3}
    detail, _, header = stated("impact", "contact", settings)
    assert header in detail
    assert header == f"mesh: {SPACING_NOTE}"


@pytest.mark.slow
def test_an_elastic_sphere_states_its_mesh():
    """Against cells half as large: its compliance under a patch, and its first mode."""
    body, shape = (
        TransverselyIsotropicSphere(1e-3, find_material("steel"), DampingKeys(ratio=1e-3)),
        choose_pressure_basis(20e-6, 2e-4),
    )
    shares = compute_sphere_compliance(body, shape).rigid_force_shares
    coarse, fine = (make_sphere_model(body, shares, shape, refine) for refine in (1, 2))
    soft = [
        m.B[:, 0] @ m.pencil.factorise_shifted_stiffness(0.0).solve(m.B[:, 0])
        for m in (coarse, fine)
    ]
    errors = {
        "compliance": abs(soft[0] / soft[1] - 1),
        "resonance": abs(coarse.facts["resonance_hz"] / fine.facts["resonance_hz"] - 1),
    }
    for name, error in errors.items():
        estimate = coarse.facts[f"mesh_error_{name}"]
        assert max(error, estimate) < 1e-3 or 0.5 < estimate / error < 2
        assert estimate > 0.5 * error
