"""``verify`` holds what a run truncates against more of it, not against the same."""

import importlib
import json
import re

import pytest
from films import FILM
from support import (
    MESH_QUANTITIES,
    BuiltScene,
    RefinementRule,
    RomKeys,
    SceneLaws,
    StageTimer,
    app,
    build_models,
    find_part_type,
    find_section,
    ignore_progress,
    list_type_names,
    load_scene,
)
from typer.testing import CliRunner

verify = importlib.import_module("kc2spice.workflow.verify.scene_verification")


@pytest.mark.parametrize(
    ("branches", "code"), [(3, 4), pytest.param(None, 0, marks=pytest.mark.slow)]
)
def test_verify_doubles_the_branches_of_a_film(tmp_path, branches, code):
    scene = tmp_path / "film.toml"
    scene.write_text(FILM)
    words = ["verify", str(scene), "-o", str(tmp_path / "out"), "--json", "--quiet"]
    if branches:
        words += ["--set", f"g.film.branches={branches}"]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == code, done.output
    checks = {c["name"]: c for c in json.loads(done.stdout)["checks"]}
    (film,) = (c for name, c in checks.items() if "gas-film branches" in name)
    assert film["passed"] is (code == 0)
    assert (film["value"] > 0.05) is (code == 4)


SMALL_SIGNAL_ANALYSES = FILM[FILM.index("[analysis]") :]
IN_TIME = """[analysis]
type = "transient"
stop = "2 us"
[solver]
max_step = "5 ns"
"""


@pytest.mark.slow
@pytest.mark.parametrize(("branches", "passed"), [(3, False), (100, True)])
def test_verify_counts_in_time_the_films_error_at_the_frequencies_of_the_run(
    tmp_path, monkeypatch, branches, passed
):
    """The integrator takes minutes for this film; as for parts without a law it is left out."""
    monkeypatch.setattr(SceneLaws, "parts_without_law", ("g",))
    monkeypatch.setattr(verify, "find_replayed_nets", lambda laws: None)
    text = FILM.replace(SMALL_SIGNAL_ANALYSES, IN_TIME)
    sine = 'sine = { amplitude = "1 mN", frequency = "2 MHz" }'
    (tmp_path / "film.toml").write_text(text.replace('ac = "1 uN"', sine))
    scene = load_scene(tmp_path / "film.toml", [f"g.film.branches={branches}"])
    record = verify.verify_scenes([scene], tmp_path / "out")["scenes"]["film"]
    (film,) = (c for c in record["checks"] if "branches of the film" in c["name"])
    assert film["passed"] is passed
    assert (film["value"] > 0.05) is not passed
    assert any("not in the time domain" in n for n in record["notes"])


# --- every key that divides a part into pieces ----------------------------------------------------


def discretisations(schema, prefix=""):
    """Dotted keys of a schema that are marked as the fineness of a model."""
    for name, declared in schema.model_fields.items():
        inner = find_section(declared.annotation)
        if inner is not None and inner is not RomKeys:
            yield from discretisations(inner, f"{prefix}{name}.")
        if any(isinstance(mark, RefinementRule) and mark.model for mark in declared.metadata):
            yield f"{prefix}{name}"


@pytest.mark.parametrize("name", list_type_names())
def test_verify_refines_each_key_of_a_discretisation(name):
    kind = find_part_type(name)
    assert set(discretisations(kind.schema)) <= set(kind.discretisations)


DISC = {
    "disc": {"part": "disc", "support": "clamped", "pins": {"anode": "drive.out", "cathode": "gnd"},
             "layers": [{"material": "brass", "diameter": "20 mm", "thickness": "0.2 mm"},
                        {"material": "PZT-5A", "diameter": "15 mm", "thickness": "0.22 mm"}]},
    "drive": {"part": "source", "ac": 1.0},
    "analysis": {"type": "ac", "start": 1e3, "stop": 2e3, "points": 2},
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(("refine", "passed"), [(1, False), (3, True)])
def test_verify_halves_the_mesh_of_a_body(refine, passed, tmp_path, monkeypatch):
    """The error of the resonance is one of the size of an element, squared: against a mesh of a
    quarter of its size by what verify finds."""
    stricter = MESH_QUANTITIES["resonance"]._replace(warning_limit=1e-3)
    monkeypatch.setitem(MESH_QUANTITIES, "resonance", stricter)
    scene = load_scene(DISC, {"disc.mesh.refine": refine})
    record = verify.verify_scenes([scene], tmp_path / "out")["scenes"][scene.name]
    words = "half the element size, first resonance"
    (found,) = (c for c in record["checks"] if words in c["name"])
    assert found["passed"] is passed
    assert {"capacitance", "stroke"} <= {c["name"].split(", ")[-1] for c in record["checks"]}
    hertz = [
        build_models(load_scene(DISC, {"disc.mesh.refine": n}), StageTimer(ignore_progress)).models[
            "disc"
        ]
        for n in (refine, 2 * refine)
    ]
    coarse, fine = (model.facts["resonance_short_hz"] for model in hertz)
    assert found["value"] == pytest.approx(abs(coarse / fine - 1), rel=1e-6)


def test_a_mesh_that_is_too_large_to_halve_is_noted(tmp_path, monkeypatch):
    monkeypatch.setattr(verify, "MAX_FINER_UNKNOWNS", 100)
    scene = load_scene(DISC)
    record = verify.verify_scenes([scene], tmp_path / "out")["scenes"][scene.name]
    assert not any("half the element size" in check["name"] for check in record["checks"])
    start = "disc: no mesh with half the element size"
    (note,) = (note for note in record["notes"] if note.startswith(start))
    assert re.search(r"\(\d+ unknowns, more than 400\); error estimate of its mesh", note)


FLIGHT = {
    "sphere": {"radius": "1 mm", "velocity": "0.3 m/s", "height": "1.5 mm"},
    "catch": {"y_min": "-1 mm", "y_max": "6 mm", "air_radius": "8 mm", "air_height": "20 mm"},
    "analysis": {"stop": "4 ms"},
}


@pytest.mark.slow
@pytest.mark.parametrize(("positions", "passed"), [(5, False), (41, True)])
def test_verify_has_more_heights_of_a_field_in_time(positions, passed, tmp_path):
    """A spline through five heights misses the field between them, and with it the flight."""
    scene = load_scene(FLIGHT, {"catch.positions": positions})
    record = verify.verify_scenes([scene], tmp_path / "out")["scenes"][scene.name]
    (flight,) = (c for c in record["checks"] if "times as many catch.positions" in c["name"])
    assert flight["passed"] is passed
    words = "mesh of catch with half the element size"
    meshes = {c["name"]: c for c in record["checks"] if words in c["name"]}
    assert all(check["passed"] for check in meshes.values())
    assert len(meshes) == 2


SHAKER = {
    "magnet": {"part": "moving_magnet", "radius": "3 mm", "thickness": "4 mm", "remanence": "1.2 T",
               "y_min": "-2 mm", "y_max": "2 mm", "pins": {"coil_p": "drive.out", "a": "spring.a"},
               "coils": {"coil": {"radius": "4 mm", "width": "2 mm", "height": "3 mm", "y": "-6 mm",
                                  "turns": 200, "resistance": "10 Ohm"}}},
    "mass": {"part": "mass", "mass": "1 g", "pins": {"a": "spring.a"}},
    "spring": {"part": "spring", "stiffness": "400 N/m"},
    "drive": {"part": "source", "sine": {"amplitude": "3 V", "frequency": "100 Hz"}},
    "analysis": {"stop": "10 ms"},
    "gravity": 0.0,
}  # fmt: skip


@pytest.mark.parametrize(("tolerance", "passed"), [(0.09, False), (1e-5, True)])
def test_verify_has_a_closer_field_of_a_magnet_in_time(tolerance, passed, tmp_path):
    scene = load_scene(SHAKER, {"magnet.tolerance": tolerance})
    record = verify.verify_scenes([scene], tmp_path / "out")["scenes"][scene.name]
    (height,) = (c for c in record["checks"] if "ten times smaller tolerance" in c["name"])
    assert height["passed"] is passed


@pytest.mark.slow
@pytest.mark.parametrize(("spacing", "passed"), [("20 um", False), ("10 um", True)])
def test_verify_halves_the_basis_of_a_pressure(spacing, passed):
    scene = load_scene("impact", {"contact.shape": "pressure", "contact.spacing": spacing})
    (part,) = scene.list_parts("contact")
    (check,) = part.type.compare_with_finer_mesh(
        part, BuiltScene(scene, {}), StageTimer(ignore_progress), 1e9
    )
    assert check.passed is passed
