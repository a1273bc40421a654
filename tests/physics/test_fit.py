"""Fits of synthetic measurements: the values that made the data are found within their errors."""

import json
import os
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from scipy.special import jv
from support import (
    MeasuredAdmittance,
    app,
    body_fit,
    compute_modal_transfer,
    format_calibrated_ranges,
)

import kc2spice as kc

BAR = Path(__file__).parents[2] / "docs" / "examples" / "bar" / "bar.toml"
TRANSDUCER = {
    "part": "langevin",
    "front": [{"material": "aluminium", "diameter": 40e-3, "length": 30e-3}],
    "back": [{"material": "steel", "diameter": 40e-3, "length": 25e-3}],
    "rings": {"material": "PZT-4", "outer": 38e-3, "inner": 15e-3, "thickness": 5e-3, "count": 2},
    "bolt": {"material": "steel", "diameter": 12e-3},
    "damping": {"quality": 200},
}
BUZZER = "buzzer_7bb_20_3"
# Scene, part, keys, frequencies [Hz].
PARTS = {
    "disc": (BUZZER, "disc", ("layers[0].thickness", "damping.quality"), (2e3, 9e3)),
    "its ceramic": (BUZZER, "disc", ("layers[1].thickness", "damping.quality"), (2e3, 9e3)),
    "transducer": (
        {"horn": TRANSDUCER}, "horn", ("front[0].length", "damping.quality"), (20e3, 34e3),
    ),
    "stack": ("stack_p882", "stack", ("layer_thickness", "damping.ratio"), (60e3, 240e3)),
    "bender": ("harvester", "beam", ("length", "damping.ratio"), (20.0, 90.0)),
    "bar": (BAR, "bar", ("materials.ceramic.compliance.s11", "damping.quality"), (115e3, 138e3)),
}  # fmt: skip


def measured(scene, part, true, band, noise, seed, points=150):
    """Admittance of a body: a small model is solved at every frequency."""
    changed = kc.load_scene(scene, {f"{part}.{key}": value for key, value in true.items()})
    model = kc.build(changed)[part].select(["anode"])
    f = np.linspace(*band, points)
    H = model.transfer(f) if model.order < 3000 else compute_modal_transfer(model, f)
    draw = np.random.default_rng(seed).normal(size=(2, points))
    Y = 2j * np.pi * f * H[:, 0, 0] * (1 + noise * (draw[0] + 1j * draw[1]))
    return MeasuredAdmittance("part", "part.csv", f, Y[:, None, None])


def found_and_off(name, noise):
    """A fit of a part whose sizes are up to 8 % from the scene's, its losses up to twice, and how
    many standard errors each value is from the truth."""
    scene, part, keys, band = PARTS[name]
    seed = [int(1e4 * noise), len(name)]
    draw, true = np.random.default_rng(seed), {}
    for key in keys:
        value = kc.load_scene(scene).get_part(part).keys.model_dump()
        for word in key.replace("[", ".").replace("]", "").split("."):
            value = value[int(word) if word.isdigit() else word]
        true[key] = value * np.exp(draw.uniform(-1, 1) * (0.7 if "damping" in key else 0.08))
    found = kc.fit(scene, part, measured(scene, part, true, band, noise, seed), keys)
    rows = found["parameters"]
    return found, max(abs(rows[key]["value"] - true[key]) / rows[key]["sigma"] for key in keys)


@pytest.mark.slow
def test_a_fit_finds_the_values_that_made_the_data():
    found, off = found_and_off("disc", 0.01)
    assert off < 3
    assert found["identifiable"]
    assert found["other_minima"] < len(found["starts"])
    assert found["error"]["rms"] == pytest.approx(0.01, rel=0.3)  # what is left is the noise
    matched = found["resonances"][0]
    assert matched["fitted_hz"] == pytest.approx(matched["measured_hz"], rel=0.01)
    assert found["misfit"] == pytest.approx(1.0, abs=0.15)
    assert found["caution"] is None


def test_damping_at_two_frequencies_is_checked_without_finite_elements():
    """Rayleigh's two coefficients by three resonances: the model of the start and of the end."""
    start = {"disc.damping": {"ratio": [0.01, 0.03], "at": [3e3, 30e3]}}
    scene = kc.load_scene(BUZZER, start)
    true = {"damping.ratio[0]": 0.012, "damping.ratio[1]": 0.024}
    data = measured(scene, "disc", true, (2e3, 40e3), 0.005, 3, points=300)
    vary = ["damping.ratio[0]=0.007:0.014", "damping.ratio[1]=0.015:0.05"]
    found = kc.fit(scene, "disc", data, vary)
    assert found["models"] == 2
    for key, value in true.items():
        row = found["parameters"][key]
        assert abs(row["value"] - value) < 3 * row["sigma"] < 0.05 * value


def thin_disc(f, losses):
    """Impedance (n,) [Ohm] of a free thin disc at its radial modes (IEEE Std 176-1987).

    ``losses`` are the Q factor of complex s11 and s12 (``constant_q``) with real d31 and eps33 at
    constant stress, so that the clamped permittivity has a loss; the Q factor at 100 kHz of viscous
    stiffness with real e31 (``viscous_q``); the loss tangent of eps33 at constant stress
    (``tangent``).
    """
    radius, thickness, density = 10e-3, 0.5e-3, 7800.0
    s11 = 16.1e-12 * (1 - 1j / losses.get("constant_q", np.inf))
    s12, d31, eps = -5.1 / 16.1 * s11, -180e-12, 1750 * 8.8541878e-12
    nu = -s12 / s11
    viscous = 1 + 1j * f / 100e3 / losses.get("viscous_q", np.inf)
    c11, e31 = viscous / (s11 * (1 - nu**2)), d31 / (s11 + s12)
    z = 2 * np.pi * f * np.sqrt(density / c11) * radius
    J = z * jv(0, z) / jv(1, z)
    clamped = eps * (1 - 1j * losses.get("tangent", 0.0)) - 2 * d31 * e31
    area = np.pi * radius**2
    return thickness / area / (2j * np.pi * f * (clamped + 2 * e31**2 / c11 / (J - (1 - nu))))


DISC = {
    "disc": {
        "part": "disc",
        "damping": {"quality": 60},
        "layers": [
            {
                "diameter": "20 mm",
                "thickness": "0.5 mm",
                "material": {
                    "density": 7800,
                    "symmetry": "6mm",
                    "compliance": {"s11": 16.1e-12, "s12": -5.1e-12, "s13": -8e-12,
                                   "s33": 20e-12, "s44": 45e-12},
                    "strain_coupling": {"d31": -180e-12, "d33": 400e-12, "d15": 550e-12},
                    "permittivity": {"eps11": 1650, "eps33": 1750},
                    "permittivity_at": "stress",
                },
            }
        ],
    }
}  # fmt: skip


def disc_data(noise=0.005, **losses):
    f, rng = np.linspace(60e3, 160e3, 400), np.random.default_rng(5)
    draw = rng.normal(size=(2, f.size))
    Z = thin_disc(f, losses) * (1 + noise * (draw[0] + 1j * draw[1]))
    return MeasuredAdmittance("part", "part.csv", f, (1 / Z)[:, None, None])


CAUSES = {
    "ieee176": r'complex material constants \(IEEE 176\): set damping.model = "ieee176"',
    "tangent": r"dielectric loss: vary damping.loss_tangent",
    "rayleigh": r'viscous damping: set damping.model = "rayleigh"',
}


def test_a_loss_model_that_does_not_describe_the_data_is_a_warning():
    """Rayleigh damping alone has no loss of the clamped dielectric, which the data have."""
    with pytest.warns(UserWarning, match=f"misfit of .* {CAUSES['ieee176']}"):
        found = kc.fit(DISC, "disc", disc_data(constant_q=80.0), ["damping.quality=30:300"])
    row = found["parameters"]["damping.quality"]
    assert row["value"] < 70  # which made a standard error of 0.4 a false statement
    assert abs(row["value"] - 80) < 2 * row["sigma"] < 40
    assert found["misfit"] > 3


@pytest.mark.parametrize(
    ("model", "cause", "losses"),
    [
        ("rayleigh", "tangent", {"viscous_q": 80.0, "tangent": 0.02}),
        ("ieee176", "tangent", {"constant_q": 80.0, "tangent": 0.02}),
        ("ieee176", "rayleigh", {"viscous_q": 80.0}),
    ],
)
def test_the_cause_of_a_misfit_is_the_loss_of_the_data(model, cause, losses):
    """Data of the closed form with each loss; the scene lacks the one that is named."""
    disc = {"disc": {**DISC["disc"], "damping": {"quality": 60, "model": model}}}
    with pytest.warns(UserWarning, match=f"likely cause: .*{CAUSES[cause]}"):
        kc.fit(disc, "disc", disc_data(**losses), ["damping.quality=30:300"])


def test_complex_constants_find_the_q_of_complex_constants():
    """The closed form of a thin disc, whose frequencies are 0.03 % from those of a solid one."""
    disc = {"disc": {**DISC["disc"], "damping": {"quality": 60, "model": "ieee176"}}}
    with pytest.warns(UserWarning, match="misfit of 3"):  # of these frequencies
        found = kc.fit(disc, "disc", disc_data(constant_q=80.0), ["damping.quality=30:300"])
    row = found["parameters"]["damping.quality"]
    assert row["value"] == pytest.approx(80, rel=0.01)
    assert abs(row["value"] - 80) < 2 * row["sigma"]


def deviations(case):
    """Standard errors that values are off the truth, and how many finite element models it took."""
    found, off = found_and_off(*case)
    return off, found["models"]


@pytest.mark.slow
@pytest.mark.campaign
def test_campaign_of_parts():
    """All true values within two standard errors in nine parts of ten, as errors are drawn; a dozen
    finite element models are enough for each."""
    cases = [(name, noise) for name in PARTS for noise in (0.001, 0.005, 0.01, 0.03)]
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        found = dict(zip(cases, pool.map(deviations, cases), strict=True))
    assert sum(off < 2 for off, _ in found.values()) >= 0.9 * len(cases), found
    assert max(models for _, models in found.values()) <= 14, found


@pytest.mark.slow  # seconds
def test_keys_that_the_data_do_not_distinguish_are_listed():
    """Far below any resonance there is a capacitance alone: area over thickness."""
    data = measured(BUZZER, "disc", {}, (300.0, 600.0), 0.03, 4)
    keys = ("layers[1].thickness", "layers[1].electrodes=11e-3:13.5e-3")
    found = kc.fit(BUZZER, "disc", data, keys)
    assert not found["identifiable"]
    assert found["undetermined"]


@pytest.mark.slow
def test_the_command_writes_values_for_set_and_a_page(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    data = measured(BUZZER, "disc", {"layers[0].thickness": 0.105e-3}, (3e3, 8e3), 0.005, 6)
    rows = [f"{f},{z.real},{z.imag}" for f, z in zip(data.f, 1 / data.Y[:, 0, 0], strict=True)]
    (tmp_path / "part.csv").write_text("\n".join(["f_hz,r_ohm,x_ohm", *rows]))
    words = [f"{BUZZER}:disc", "part.csv", "--vary", "layers[0].thickness=5e-5:2e-4"]
    words += ["-o", "out", "--json", "--quiet"]
    with pytest.raises(SystemExit) as ended:
        app(["fit", *words])
    assert not ended.value.code
    found = json.loads(capsys.readouterr().out)
    assert found["overrides"] == "out/fit.toml"
    assert "measured" in (tmp_path / found["page"]).read_text()
    fitted = kc.load_scene(BUZZER, ["out/fit.toml"]).get_part("disc").keys.layers[0].thickness
    value, sigma = (found["parameters"]["layers[0].thickness"][key] for key in ("value", "sigma"))
    assert fitted == value == pytest.approx(0.105e-3, rel=3e-3)
    boxed = kc.load_scene(BUZZER, ["out/fit.toml", "out/box.toml"]).get_part("disc").keys.rom
    ((key, ends),) = boxed.parameters.items()  # what ranges become in a netlist: test_parameters
    half = max(2 * sigma, 1.1e-3 * value)
    assert key == "layers[0].thickness"
    assert ends == pytest.approx((value - half, value + half), rel=1e-9)


def test_ranges_of_a_fit_of_many_keys_are_a_valid_file_for_set(tmp_path):
    """A netlist has at most four parameters: the least certain of six keys are chosen."""
    keys = ["damping.quality", "layers[0].thickness", "layers[1].thickness",
            "layers[0].diameter", "layers[1].diameter", "layers[1].electrodes"]  # fmt: skip
    values = [50.0, 0.1e-3, 0.12e-3, 20e-3, 14e-3, 12.8e-3]
    errors = [1e-2, 1e-4, 3e-2, 2e-3, 3e-3, 2e-4]  # relative
    parameters = {
        key: {"value": value, "sigma": error * value, "low": 0.5 * value, "high": 2 * value}
        for key, value, error in zip(keys, values, errors, strict=True)
    }
    path = tmp_path / "box.toml"
    path.write_text(format_calibrated_ranges("disc", parameters))
    loaded = kc.load_scene("buzzer_7bb_20_3", [str(path)])
    ranges = loaded.get_part("disc").keys.rom.parameters
    assert list(ranges) == [keys[0], keys[2], keys[3], keys[4]]
    assert ranges["damping.quality"] == pytest.approx((49.0, 51.0))


@pytest.mark.parametrize(
    "vary",
    [["rated_voltage"], ["layers[0].material"], ["layers[7].thickness"], ["centre"], [],
     ["layers[0].thickness=1e-3:2e-3"], ["layers[0].thickness=1"],
     ["layers[0].thickness", "layers[0].thickness=5e-5:3e-4"]],
)  # fmt: skip
def test_keys_that_cannot_be_varied(vary):
    f = np.linspace(3e3, 8e3, 50)
    data = MeasuredAdmittance("part", "part.csv", f, (2e-9j * np.pi * f)[:, None, None])
    with pytest.raises(
        kc.errors.UsageError,
        match=r"is not a number|can be varied|has no keys|not a valid range|not a range|"
        r"vary is missing|twice|the list layers of disc has 2 entries",
    ):
        kc.fit(BUZZER, "disc", data, vary)


def test_a_directory_that_cannot_be_written_is_noticed_before_the_fit(tmp_path, monkeypatch):
    monkeypatch.setattr(
        "kc2spice.workflow.fit.run_descents", lambda _: pytest.fail("it was fitted")
    )
    (tmp_path / "out").write_text("a file")
    data = measured(BUZZER, "disc", {}, (3e3, 8e3), 0.005, 6)
    with pytest.raises(kc.errors.UsageError, match="a file, not a directory"):
        kc.fit(BUZZER, "disc", data, ["layers[0].thickness"], tmp_path / "out")


@pytest.mark.slow
def test_other_parts_and_several_ports_are_refused():
    """A resonance that no value in the ranges reaches; two ports."""
    data = measured(BUZZER, "disc", {"layers[0].thickness": 0.3e-3}, (5e3, 30e3), 0.01, 8)
    with pytest.raises(kc.errors.UsageError, match=r"no values in the ranges|does not converge"):
        kc.fit(BUZZER, "disc", data, ["layers[0].thickness"])
    with pytest.raises(kc.errors.UsageError, match="cannot have"):  # less than its electrodes
        kc.fit(BUZZER, "disc", data, ["layers[1].diameter"])
    two = MeasuredAdmittance("two", "two.s2p", data.f, np.tile(np.eye(2), (len(data.f), 1, 1)))
    with pytest.raises(kc.errors.UsageError, match="impedance of a part with one port"):
        kc.fit(BUZZER, "disc", two, ["layers[0].thickness"])


@pytest.mark.parametrize(
    ("limit", "most", "message"),
    [
        ("MAX_MODELS", 7, "did not converge within its limit"),
        ("MAX_MODELS", 3, "varies too many keys"),
        ("MAX_REDUCED_ADMITTANCES", 100, "did not converge within its limit"),
    ],
)
def test_a_fit_that_reaches_a_limit_ends(monkeypatch, limit, most, message):
    """Seven models are enough for the reduced model of one key, but not for its correction; 64 of
    the 100 admittances are those of random samples."""
    monkeypatch.setattr(body_fit, limit, most)
    true = {"layers[0].thickness": 0.115e-3}
    data = measured(BUZZER, "disc", true, (2e3, 9e3), 0.001, 3)
    with pytest.raises(kc.errors.UsageError, match=message) as caught:
        kc.fit(BUZZER, "disc", data, ["layers[0].thickness"])
    assert str(most) in caught.value.expected
    if message == "did not converge within its limit":
        best = float(caught.value.got.rpartition(" = ")[2])
        assert best == pytest.approx(true["layers[0].thickness"], rel=0.05)


@pytest.mark.slow
def test_a_wrong_stiffness_of_a_material_is_a_likely_cause():
    layers = kc.load_scene(BUZZER).tables["disc"]["layers"]
    layers = [{**layer, "material": {"like": layer["material"]}} for layer in layers]
    scene = kc.load_scene(BUZZER, {"disc.layers": layers})
    key = "layers[0].material.youngs_modulus"
    data = measured(scene, "disc", {key: 115e9}, (2e3, 30e3), 0.002, 5)
    with pytest.warns(UserWarning, match="likely cause: stiffer materials or different dimensions"):
        kc.fit(scene, "disc", data, ["damping.quality"])
    found = kc.fit(scene, "disc", data, ["damping.quality", key])
    assert found["caution"] is None
    assert found["values"][f"disc.{key}"] == pytest.approx(115e9, rel=0.01)
