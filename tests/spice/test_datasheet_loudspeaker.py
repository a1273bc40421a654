"""Loudspeakers from Thiele-Small parameters: their netlists in ngspice against closed forms."""

import math

import numpy as np
import pytest
from support import list_dialect_names

import kc2spice as kc

# Kicker 49ST9MR8, page kicker.com/app/tsparam/49ST9MR8.html; cms from its Kms of 18.65 N/mm.
SHEET = {
    "fs": 110.3, "re": 6.18, "qms": 4.537, "qes": 1.297, "mms": 38.839e-3, "bl": 11.325,
    "cms": 0.0536e-3, "rms": 5.932, "qts": 1.009,
}  # fmt: skip
BASIS = ("fs", "re", "qms", "qes", "mms")
SETS = (
    BASIS, ("fs", "re", "qms", "qes", "bl"), ("fs", "re", "qms", "qts", "mms"),
    ("re", "bl", "mms", "cms", "rms"), ("fs", "re", "zmax", "qms", "cms"),
    ("fs", "re", "qms", "qes", "vas", "sd"), ("fs", "re", "qts", "zmax", "vas", "sd"),
)  # fmt: skip
LE, SD = 0.6e-3, 34e-3


def scene(keys, **analysis):
    part = {"part": "loudspeaker", "pins": {"plus": "drive.out"}, **keys}
    drive = {"part": "source", "ac": 1.0}
    band = {"type": "ac", "start": 10.0, "stop": 2e3, "points": 60}
    return {"name": "sheet", "speaker": part, "drive": drive, "analysis": analysis or band}


def exact():
    """A consistent set: five values of the sheet, and the others by Small's equations."""
    v = {name: SHEET[name] for name in BASIS}
    w = 2 * np.pi * v["fs"]
    v["bl"] = np.sqrt(w * v["mms"] * v["re"] / v["qes"])
    v["cms"], v["rms"] = 1 / (w**2 * v["mms"]), w * v["mms"] / v["qms"]
    v["qts"] = v["qms"] * v["qes"] / (v["qms"] + v["qes"])
    v["zmax"], v["sd"] = v["re"] * (1 + v["qms"] / v["qes"]), SD
    v["vas"] = 1.204 * 343.2**2 * SD**2 * v["cms"]
    return v


def impedance(frequency, v, inductance):
    w = 2 * np.pi * frequency
    mechanical = v["rms"] + 1j * w * v["mms"] + 1 / (1j * w * v["cms"])
    return v["re"] + 1j * w * inductance + v["bl"] ** 2 / mechanical


@pytest.mark.parametrize("names", SETS)
def test_any_sufficient_set_of_parameters_gives_the_same_impedance(names):
    v = exact()
    waves = kc.run(scene({name: v[name] for name in names} | {"le": LE})).waves
    found = waves["speaker.v"] / waves["speaker.i"]
    expected = impedance(waves["frequency"].real, v, LE)
    np.testing.assert_allclose(found, expected, rtol=1e-7)


def test_the_impedance_at_resonance_is_that_of_the_sheet():
    v, f = exact(), SHEET["fs"]
    span = {"type": "ac", "start": f, "stop": 1.01 * f, "points": 2, "scale": "linear"}
    waves = kc.run(scene({name: v[name] for name in BASIS} | {"le": 1e-9}, **span)).waves
    found = abs(waves["speaker.v"][0] / waves["speaker.i"][0])
    assert found == pytest.approx(6.18 * (1 + 4.537 / 1.297), rel=1e-6)


def test_the_redundant_values_of_a_sheet_follow_from_five_of_them():
    """Bl, Rms and Qts of the maker's page, none of which is an input here."""
    detail = (
        kc.load_scene(scene({name: SHEET[name] for name in BASIS})).records["speaker"].shared_data
    )
    w = 2 * np.pi * detail.fs
    assert np.sqrt(w * detail.mms * detail.re / detail.qes) == pytest.approx(SHEET["bl"], rel=1e-3)
    assert w * detail.mms / detail.qms == pytest.approx(SHEET["rms"], rel=1e-3)
    qts = detail.qms * detail.qes / (detail.qms + detail.qes)
    assert qts == pytest.approx(SHEET["qts"], rel=1e-3)


def test_all_values_of_a_sheet_at_once_agree_within_rounding():
    detail = kc.load_scene(scene(SHEET)).records["speaker"].shared_data
    for name in BASIS:
        assert getattr(detail, name) == pytest.approx(SHEET[name], rel=5e-3), name


def test_a_force_on_the_cone_bends_the_suspension():
    v = exact()
    tables = scene({name: v[name] for name in BASIS}, type="op")
    tables["push"] = {"part": "source", "kind": "force", "dc": 2.0, "pins": {"out": "speaker.cone"}}
    x = kc.run(tables).waves["speaker.x"][0]
    assert x == pytest.approx(2.0 * v["cms"], rel=1e-9)


def test_a_mass_on_the_cone_lowers_the_resonance():
    """The added mass of a Thiele-Small measurement: ``fs' = fs / sqrt(1 + m/mms)``."""
    v, m = exact(), 20e-3
    f = v["fs"] / np.sqrt(1 + m / v["mms"])
    span = {"type": "ac", "start": f, "stop": 1.01 * f, "points": 2, "scale": "linear"}
    tables = scene({name: v[name] for name in BASIS} | {"le": 1e-9}, **span)
    tables["clay"] = {"part": "mass", "mass": m, "pins": {"a": "speaker.cone"}}
    waves = kc.run(tables).waves
    z = waves["speaker.v"][0] / waves["speaker.i"][0]
    assert z == pytest.approx(v["re"] + v["bl"] ** 2 / v["rms"], rel=1e-5)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"fs": 50.0, "re": 6.0}, "the stated values do not fully determine the circuit"),
        ({"fs": 50.0, "re": 6.0, "qms": 3.0, "qes": 0.5, "vas": 0.03}, "do not fully determine"),
        (SHEET | {"bl": 20.0}, "contradicts"),
        (SHEET | {"tolerance": {"sd": 0.1}}, "but no value of"),
        ({"fs": 50.0, "re": 6.0, "qms": 3.0, "qts": 3.5, "mms": 0.01}, "no circuit has"),
    ],
)
def test_sheets_that_no_driver_has_are_errors(keys, message):
    with pytest.raises(kc.errors.UsageError, match=message):
        kc.load_scene(scene(keys))


def test_verify_passes_in_time_and_warns_of_the_excursion():
    tables = scene({name: SHEET[name] for name in BASIS} | {"xmax": "0.1 mm"})
    tables["drive"] = {"part": "source", "sine": {"amplitude": 20.0, "frequency": 100.0}}
    tables["analysis"] = {"type": "transient", "stop": 0.03}
    assert kc.verify(tables)["passed"]
    (check,) = (c for c in kc.run(tables).checks if c.name == "excursion of speaker")
    assert check.action == "warn"
    assert check.value > check.limit == 1e-4


@pytest.mark.parametrize("dialect", list_dialect_names())
def test_every_dialect_has_it(dialect, tmp_path):
    assert kc.export(scene({name: SHEET[name] for name in BASIS}), tmp_path, dialect=dialect)


def test_the_gallery_scene_has_the_extreme_impedances_of_its_data_sheets(tmp_path):
    """The woofer has ``re (1 + qms / qes)`` at ``fs``, the buzzer ``zs`` beside its capacitance."""
    result = kc.run("buzzer_and_speaker", out=tmp_path / "out")
    largest = 6.23 * (1 + 6.657 / 0.538)
    assert result.metrics["woofer_a"] == pytest.approx(1 / largest, rel=1e-4)
    parallel = 2 * math.pi * 6300 * 10e-9 * (1 - 0.358**2)
    smallest = math.hypot(1 / 350, parallel)
    assert result.metrics["buzzer_a"] == pytest.approx(smallest, rel=2e-3)
