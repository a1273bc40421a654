"""Fits of loudspeakers and two-terminal parts to curves of closed forms, noise included."""

import numpy as np
import pytest
from support import MeasuredAdmittance, circuit_fit

import kc2spice as kc

TRUE = {"re": 5.7, "bl": 7.0, "mms": 14.9e-3, "fs": 45.0, "rms": 2.1}
LE = 0.3e-3
START = {"re": 6.0, "bl": 6.0, "mms": 13e-3, "fs": 47.0, "rms": 1.8}
RANGES = {"re": (5, 7), "bl": (5, 9), "mms": (0.01, 0.02), "fs": (40, 50), "rms": (0.5, 5)}


def scene(keys=START):
    part = {"part": "loudspeaker", **keys, "le": LE, "pins": {"plus": "drive.out"}}
    return {"name": "driver", "woofer": part, "drive": {"part": "source", "ac": 1.0}}


def measure(added, noise=1e-3, stop=400.0):
    """Impedance of the true driver with an added mass [kg], with noise."""
    f = np.geomspace(10.0, stop, 60)
    s, v = 2j * np.pi * f, TRUE
    stiffness = (2 * np.pi * v["fs"]) ** 2 * v["mms"]
    z = v["re"] + s * LE + v["bl"] ** 2 / (s * (v["mms"] + added) + v["rms"] + stiffness / s)
    draw = np.random.default_rng(int(1e6 * added)).normal(size=(2, 60))
    z = z * (1 + noise * (draw[0] + 1j * draw[1]))
    return MeasuredAdmittance("curve", f"{added:g} kg", f, 1 / z[:, None, None])


def entry(added, **more):
    return {"file": measure(added), "set": {"woofer.added_mass": added}, **more}


@pytest.mark.slow
def test_an_added_mass_determines_motor_and_mass():
    curves = [entry(0.0), entry(8e-3), entry(16e-3, predict=True)]
    result = kc.fit(scene(), "woofer", curves, RANGES)
    assert result["identifiable"]
    for key, item in result["parameters"].items():
        assert abs(item["value"] - TRUE[key]) < 5 * item["sigma"] < 0.02 * TRUE[key], key
    assert [row["predict"] for row in result["curves"]] == [False, False, True]
    assert result["curves"][2]["rms"] < 2e-3


@pytest.mark.slow
def test_one_curve_does_not_determine_motor_and_mass():
    """The impedance has ``bl^2/mms`` and ``rms/mms`` alone."""
    result = kc.fit(scene(), "woofer", measure(0.0), RANGES)
    assert not result["identifiable"]
    ratio = result["values"]["woofer.bl"] ** 2 / result["values"]["woofer.mms"]
    assert ratio == pytest.approx(TRUE["bl"] ** 2 / TRUE["mms"], rel=5e-3)


@pytest.mark.slow
def test_a_file_of_curves_restricts_their_bands(tmp_path):
    for added in (0.0, 8e-3):
        data = measure(added, stop=5e3)
        z = 1 / data.Y[:, 0, 0]
        z[data.f > 400] *= 1.5  # a resonance of the cone that the model lacks
        rows = np.column_stack([data.f, z.real, z.imag])
        name = tmp_path / f"{1e3 * added:g}.csv"
        np.savetxt(name, rows, delimiter=",", header="frequency_hz,real_ohm,imag_ohm")
    text = '[[curve]]\nfile = "0.csv"\nband = ["10 Hz", "400 Hz"]\n'
    text += '[[curve]]\nfile = "8.csv"\nband = ["10 Hz", "400 Hz"]\n'
    text += 'set = { "woofer.added_mass" = "8 g" }\n'
    (tmp_path / "curves.toml").write_text(text)
    result = kc.fit(scene(), "woofer", tmp_path / "curves.toml", RANGES, tmp_path / "out")
    assert result["values"]["woofer.bl"] == pytest.approx(TRUE["bl"], rel=5e-3)
    assert "Error of" in (tmp_path / "out" / "report.html").read_text()
    fitted = kc.load_scene(scene(), [str(tmp_path / "out" / "fit.toml")])
    assert fitted.get_part("woofer").keys.bl == result["values"]["woofer.bl"]


def test_other_parts_are_fitted_with_any_key_of_the_scene():
    """A resistor in parallel with a capacitor, measured with two capacitors."""
    tables = {
        "coil": {"part": "resistor", "resistance": 80.0, "pins": {"a": "drive.out", "b": "cap.a"}},
        "cap": {"part": "capacitor", "capacitance": 1e-6},
        "drive": {"part": "source", "ac": 1.0},
    }
    f = np.geomspace(1e3, 1e5, 30)
    data = MeasuredAdmittance("r", "r.csv", f, np.full((30, 1, 1), 1 / 100.0, complex))
    curves = [{"file": data}, {"file": data, "set": {"cap.capacitance": 2e-6}}]
    result = kc.fit(tables, "coil", curves, {"resistance": (50, 200)})
    assert result["values"]["coil.resistance"] == pytest.approx(100.0, rel=1e-6)


@pytest.mark.parametrize(
    ("curves", "message"),
    [
        ([], "at least"),
        ([{"set": {}}], "file"),
        ([{"file": "missing.csv"}], "missing.csv"),
        ([entry(0.0, band=(1e3, 2e3))], "too few frequencies"),
        ([entry(0.0, predict=True)], "none is fitted"),
        ([entry(0.0) | {"set": {"woofer.ballast": 1.0}}], "ballast"),
        ([entry(0.0) | {"colour": "red"}], "colour"),
    ],
)
def test_wrong_lists_of_curves_are_errors(curves, message):
    with pytest.raises(kc.errors.UsageError) as caught:
        kc.fit(scene(), "woofer", curves, RANGES)
    assert message in str(caught.value)


def test_parts_without_an_impedance_are_errors():
    tables = scene() | {"clay": {"part": "mass", "mass": 1e-3, "pins": {"a": "woofer.cone"}}}
    with pytest.raises(kc.errors.UsageError, match="no impedance"):
        kc.fit(tables, "clay", measure(0.0), {"mass": (1e-4, 1e-2)})
    silent = scene()
    silent["drive"] = {"part": "source", "dc": 1.0}
    with pytest.raises(kc.errors.UsageError, match="no source drives"):
        kc.fit(silent, "woofer", measure(0.0), RANGES)


def test_a_data_sheet_resonator_is_fitted_with_its_voltage_and_current():
    """The admittance of a capacitance in parallel with a series resonant circuit."""
    c0, fs, cm, rm = 8e-9, 6.4e3, 1.2e-9, 300.0
    f = np.linspace(5e3, 8e3, 100)
    s = 2j * np.pi * f
    y = s * c0 + 1 / (rm + s / ((2 * np.pi * fs) ** 2 * cm) + 1 / (s * cm))
    data = MeasuredAdmittance("bvd", "bvd.csv", f, y[:, None, None])
    part = {"part": "bvd", "fs": "6 kHz", "c0": "7 nF", "cm": [1e-9], "rm": 350.0}
    tables = {"disc": part | {"pins": {"anode": "drive.out"}}, "drive": {"part": "source", "ac": 1}}
    result = kc.fit(tables, "disc", data, ["fs[0]", "c0", "cm[0]", "rm[0]"])
    # a key with a list in the scene keeps its index, a key with a single number has none
    names = ["disc.fs", "disc.c0", "disc.cm[0]", "disc.rm"]
    assert list(result["values"]) == names
    assert list(result["values"].values()) == pytest.approx([fs, c0, cm, rm], rel=1e-6)
    fitted = kc.load_scene(tables, result["values"])
    assert fitted.get_part("disc").keys.fs == pytest.approx([fs], rel=1e-6)


@pytest.mark.slow
def test_several_curves_of_a_finite_element_body_are_fitted():
    layers = [
        {"diameter": "20 mm", "thickness": "0.2 mm", "material": "brass"},
        {"diameter": "14 mm", "thickness": "0.2 mm", "material": "PZT-5A"},
    ]
    disc = {"part": "disc", "layers": layers, "damping": {"quality": 50.0}}
    tables = {"disc": disc | {"pins": {"anode": "drive.out"}}, "drive": {"part": "source", "ac": 1}}
    model = kc.build({"disc": disc | {"damping": {"quality": 45.0}}})["disc"].select(["anode"])
    f = np.linspace(4e3, 9e3, 40)
    data = MeasuredAdmittance("d", "d.csv", f, 2j * np.pi * f[:, None, None] * model.transfer(f))
    result = kc.fit(tables, "disc", [{"file": data}], ["damping.quality"])
    assert result["values"]["disc.damping.quality"] == pytest.approx(45.0, rel=1e-3)


def test_a_fit_without_convergence_is_a_warning(monkeypatch):
    monkeypatch.setattr(circuit_fit, "MAX_EVALUATIONS", 2)
    with pytest.warns(UserWarning, match="did not converge within 2 steps"):
        kc.fit(scene(), "woofer", measure(0.0), {"re": (5, 7), "fs": (40, 50)})
