"""Fits of synthetic measurements: the values that made the data are found within their errors."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import kc2spice as kc
from kc2spice.bodies.readers.measured import Measured
from kc2spice.cli.main import main
from kc2spice.rom.parametric import modal_transfer
from kc2spice.workflow.fit import fit

DISC = {
    "part": "disc",
    "layers": [
        {"material": "brass", "diameter": 20e-3, "thickness": 0.2e-3},
        {"material": "PZT-5A", "diameter": 14e-3, "thickness": 0.22e-3},
    ],
    "damping": {"quality": 50},
}
BENDER = {
    "part": "bimorph",
    "length": 30e-3,
    "width": 6e-3,
    "layers": [
        {"material": "PZT-5A", "thickness": 0.25e-3},
        {"material": "brass", "thickness": 0.1e-3},
        {"material": "PZT-5A", "thickness": 0.25e-3},
    ],
    "damping": {"quality": 60},
}
TRANSDUCER = {
    "part": "langevin",
    "front": [{"material": "aluminium", "diameter": 40e-3, "length": 30e-3}],
    "back": [{"material": "steel", "diameter": 40e-3, "length": 25e-3}],
    "rings": {"material": "PZT-4", "outer": 38e-3, "inner": 15e-3, "thickness": 5e-3, "count": 2},
    "bolt": {"material": "steel", "diameter": 12e-3},
    "damping": {"quality": 200},
}
STACK = {
    "part": "piezo_stack",
    "side": 3e-3,
    "depth": 2e-3,
    "layers": 60,
    "layer_thickness": 60e-6,
    "material": {"like": "PIC255", "density": 7800.0},
    "mounting": "free",
    "mesh": {"sectors": 4, "rings": 1, "ring_spacing": 0.3e-3, "outer_rings": 2},
    "damping": {"ratio": 0.01, "at": 135e3},
}
BAR = Path(__file__).parents[2] / "docs" / "examples" / "bar" / "bar.toml"
# Part, keys whose truth is near the scene's values, frequencies [Hz].
PARTS = {
    "disc": (DISC, ("layers[0].thickness", "damping.quality"), (2e3, 9e3)),
    "disc by its ceramic": (DISC, ("layers[1].diameter", "damping.quality"), (3e3, 12e3)),
    "transducer": (TRANSDUCER, ("front[0].length", "damping.quality"), (20e3, 34e3)),
    "stack": (STACK, ("layer_thickness", "damping.ratio"), (100e3, 500e3)),
    "bender": (BENDER, ("length", "damping.quality"), (200.0, 900.0)),
    "bar": (
        BAR, ("materials.ceramic.compliance.s11", "damping.quality"), (115e3, 138e3),
    ),
}  # fmt: skip


def scene_of(body, overrides=()):
    """A scene of the part alone, under the name it has there."""
    if isinstance(body, Path):
        return kc.load_scene(body, {f"bar.{key}": v for key, v in dict(overrides).items()}), "bar"
    changes = {f"body.{key}": value for key, value in dict(overrides).items()}
    return kc.load_scene({"name": "part", "body": body}, changes), "body"


def measured(body, true, band, noise, seed, points=150):
    """What an analyser would see of a body: its full model solved at every frequency."""
    scene, name = scene_of(body, true)
    model = kc.build(scene)[name]
    f = np.linspace(*band, points)
    solved = model.select(["anode"])
    Y = 2j * np.pi * f * (solved.transfer if solved.order < 3000 else modes_of(solved))(f)[:, 0, 0]
    draw = np.random.default_rng(seed).normal(size=(2, points))
    Y = Y * (1 + noise * (draw[0] + 1j * draw[1]))
    return Measured("part", "part.csv", f, Y[:, None, None])


def modes_of(model):
    """Responses of a large model by its modes: solving it at every frequency takes minutes."""
    return lambda f: modal_transfer(model, f)


def truth(body, keys, seed):
    """Values up to 8 % from the scene's, of losses up to twice."""
    draw = np.random.default_rng(seed)
    scene, name = scene_of(body)
    found = {}
    for key in keys:
        value = scene.part(name).keys.model_dump()
        for word in key.replace("[", ".").replace("]", "").split("."):
            value = value[int(word) if word.isdigit() else word]
        found[key] = value * np.exp(draw.uniform(-1, 1) * (0.7 if "damping" in key else 0.08))
    return found


def inside(name, seed, noise):
    body, keys, band = PARTS[name]
    true = truth(body, keys, seed)
    data = measured(body, true, band, noise, seed)
    found = fit(*scene_of(body), data, keys)
    rows = found["parameters"]
    off = {key: abs(rows[key]["value"] - true[key]) / rows[key]["sigma"] for key in keys}
    small = {key: abs(rows[key]["value"] / true[key] - 1) for key in keys}
    return found, off, small


def test_a_fit_finds_the_values_that_made_the_data():
    found, off, small = inside("disc", 1, 0.01)
    assert found["identifiable"]
    assert found["other_minima"] < len(found["starts"])
    assert max(off.values()) < 3
    assert small["layers[0].thickness"] < 2e-3
    assert found["error"]["rms"] == pytest.approx(0.01, rel=0.3)  # what is left is the noise
    matched = found["resonances"][0]
    assert matched["fitted_hz"] == pytest.approx(matched["measured_hz"], rel=0.01)


@pytest.mark.slow
@pytest.mark.campaign
@pytest.mark.parametrize("noise", [0.001, 0.005, 0.01, 0.03])
@pytest.mark.parametrize("name", PARTS)
def test_campaign_of_parts(name, noise):
    """Two standard errors, and a thousandth for what meshes are worth."""
    _, off, small = inside(name, int(1e4 * noise), noise)
    assert all(off[key] < 2 or small[key] < 2e-3 for key in off), (off, small)


def test_keys_that_the_data_cannot_tell_apart_are_named():
    """Far below any resonance there is a capacitance alone: area over thickness."""
    body, band = DISC, (300.0, 600.0)
    data = measured(body, {}, band, 0.002, 4)
    found = fit({"name": "part", "body": body}, "body", data,
                ("layers[1].thickness", "layers[1].diameter"))  # fmt: skip
    assert not found["identifiable"]
    assert found["undetermined"]


def test_the_command_writes_values_for_set_and_a_page(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    data = measured(DISC, {"layers[0].thickness": 0.21e-3}, (3e3, 8e3), 0.005, 6)
    rows = [f"{f},{z.real},{z.imag}" for f, z in zip(data.f, 1 / data.Y[:, 0, 0], strict=True)]
    (tmp_path / "part.csv").write_text("\n".join(["f_hz,r_ohm,x_ohm", *rows]))
    layers = [f"{{ material = '{x['material']}', diameter = {x['diameter']}, "
              f"thickness = {x['thickness']} }}" for x in DISC["layers"]]  # fmt: skip
    (tmp_path / "part.toml").write_text(
        f"[disc]\npart = 'disc'\nlayers = [{', '.join(layers)}]\ndamping.quality = 50\n"
    )
    words = ["fit", "part.toml:disc", "part.csv", "--vary", "layers[0].thickness=1e-4:4e-4"]
    monkeypatch.setattr("sys.argv", ["kc2spice", *words, "-o", "out", "--json", "--quiet"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert not ended.value.code
    found = json.loads(capsys.readouterr().out)
    assert found["overrides"] == "out/fit.toml"
    assert "measured" in (tmp_path / found["page"]).read_text()
    scene = kc.load_scene("part.toml", ["out/fit.toml"])
    fitted = scene.part("disc").keys.layers[0].thickness
    assert fitted == found["parameters"]["layers[0].thickness"]["value"]
    assert fitted == pytest.approx(0.21e-3, rel=3e-3)


@pytest.mark.parametrize(
    ("vary", "said"),
    [
        (["rated_voltage"], "no value to vary"),
        (["layers[0].material"], "no value to vary"),
        (["layers[7].thickness"], "no value to vary"),
        (["layers[0].thickness=1e-3:2e-3"], "not a range"),
        (["layers[0].thickness=1"], "not a range"),
        (["layers[0].thickness", "layers[0].thickness"], None),
        ([], "nothing to vary"),
        (["centre"], "no value to vary"),
    ],
)
def test_keys_that_cannot_be_varied(vary, said):
    f = np.linspace(3e3, 8e3, 50)
    data = Measured("part", "part.csv", f, (2e-9j * np.pi * f)[:, None, None])
    with pytest.raises(kc.errors.UsageError, match=said):
        fit({"name": "part", "body": DISC}, "body", data, vary)


def test_another_part_is_not_taken_for_this_one():
    """A resonance that no value in the ranges reaches."""
    data = measured(DISC, {"layers[0].diameter": 9e-3, "layers[1].diameter": 8e-3}, (15e3, 40e3),
                    0.01, 8)  # fmt: skip
    with pytest.raises(kc.errors.UsageError, match=r"no values in the ranges|does not settle"):
        fit({"name": "part", "body": DISC}, "body", data, ["layers[0].thickness"])


def test_several_ports_are_refused():
    f = np.linspace(1e3, 2e3, 20)
    data = Measured("two", "two.s2p", f, np.tile(np.eye(2), (20, 1, 1)))
    with pytest.raises(kc.errors.UsageError, match="several ports"):
        fit({"name": "part", "body": DISC}, "body", replace(data), ["layers[0].thickness"])
