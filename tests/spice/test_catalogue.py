"""The catalogue of parts: every scene loads, and sheets agree with their own redundant values."""

import json
import tomllib

import numpy as np
import pytest
from support import find_part, read_catalogue, search_parts

import kc2spice as kc

PARTS = read_catalogue()
AC = {"type": "ac", "stop": "1 kHz"}
REDUNDANT = sorted(number for number, part in PARTS.items() if part.redundant)


def device(number):
    return kc.load_scene(number).get_part("device")


def relay(keys, detail):
    return {"current": keys.voltage / keys.resistance}


def crystal(keys, circuit):
    c1, c0 = circuit.cm[0], circuit.c0
    w = 2 * np.pi * circuit.fs[0]
    return {
        "ratio": c0 / c1, "l1": 1 / (w**2 * c1), "q": 1 / (w * c1 * circuit.rm[0]),
        "pullability": c1 / (2 * (c0 + keys.cl) ** 2), "largest_r1": circuit.rm[0],
    }  # fmt: skip


def loudspeaker(keys, v):
    w = 2 * np.pi * v.fs
    bl, cms = np.sqrt(w * v.mms * v.re / v.qes), 1 / (w**2 * v.mms)
    return {
        "bl": bl, "cms": cms, "rms": w * v.mms / v.qms, "qts": v.qms * v.qes / (v.qms + v.qes),
        "res": v.re * v.qms / v.qes, "lces": cms * bl**2, "cmes": v.mms / bl**2,
    }  # fmt: skip


def bvd(keys, circuit):
    return {"largest_zs": 1 / abs(circuit.admittance(np.array(circuit.fs[0])))}


FORMULAS = {"bvd": bvd, "relay": relay, "crystal": crystal, "loudspeaker": loudspeaker}
# Relays: the tolerance of the coil's resistance. Others: sheets have two or three digits.
LARGEST = {"relay": 0.10, "crystal": 0.015, "loudspeaker": 0.02}


@pytest.mark.parametrize("number", PARTS)
def test_every_part_has_a_source_and_a_scene(number):
    part = PARTS[number]
    assert len(part.source) > 10
    assert part.date
    assert kc.load_scene(number).parts


@pytest.mark.parametrize("number", REDUNDANT)
def test_a_sheet_agrees_with_its_redundant_values(number):
    part, own = PARTS[number], device(number)
    detail = kc.load_scene(number).records["device"].shared_data
    values = FORMULAS[part.kind](own.keys, detail)
    if "vas" in part.redundant:
        values["vas"] = 1.204 * 343.2**2 * part.redundant["sd"] ** 2 * values["cms"]
        values["sd"] = part.redundant["sd"]
    assert values.keys() >= part.redundant.keys()
    for key, stated in part.redundant.items():
        if key.startswith("largest_"):
            assert values[key] <= stated
        else:
            assert values[key] == pytest.approx(stated, rel=LARGEST[part.kind]), key


def test_a_buzzer_has_the_resonance_and_impedance_of_its_sheet():
    metrics = kc.run("7BB-20-6").metrics
    assert metrics["resonance_hz"] == pytest.approx(6300.0, rel=1e-6)
    f, z = np.array(metrics["frequency_hz"]), np.array(metrics["impedance_ohm"])
    assert np.interp(6300.0, f, z) == pytest.approx(350.0, rel=0.02)
    low = np.argmin(abs(f - 1e3))
    assert 1 / (2 * np.pi * f[low] * z[low]) == pytest.approx(10e-9, rel=2e-3)


def test_a_langevin_transducer_has_the_values_of_its_sheet():
    """The bandwidth of the motional branch is that of the stated Q factor, 800."""
    metrics = kc.run("90-4050", overrides={"analysis.points": 4001}).metrics
    z = np.array(metrics["impedance_ohm"])
    assert metrics["resonance_hz"] == pytest.approx(40e3, rel=1e-4)
    assert 1 / z.min() == pytest.approx(65e-3, rel=0.01)
    assert metrics["quality"] == pytest.approx(800, rel=0.03)
    assert metrics["capacitance_f"] == pytest.approx(3.8e-9, rel=5e-3)
    # cm = 1/(2 pi fs rm qm), c0 = c_low - cm, fp = fs sqrt(1 + cm/c0)
    cm = 65e-3 / (2 * np.pi * 40e3 * 800)
    expected = 40e3 * np.sqrt(1 + cm / (3.8e-9 - cm))
    assert metrics["antiresonance_hz"] == pytest.approx(expected, rel=1e-3)


def test_part_numbers_are_found_in_any_case_and_searched_by_words():
    assert find_part("7bb-20-6").number == "7BB-20-6"
    assert find_part("7BB") is None
    assert [part.number for part in search_parts("songle 12 v sl")] == ["SRD-12VDC-SL-C"]


def test_the_command_lists_them(cli):
    listed = json.loads(cli("parts", "omron", "--json").stdout)
    assert {part["number"] for part in listed} == {"G5LE-1 DC5", "G5LE-1 DC12", "G5LE-1 DC24"}
    assert all(part["source"].startswith("Omron") for part in listed)
    assert cli("parts", "zzz").exit_code == 2


def test_a_library_has_the_name_of_the_part_number(tmp_path):
    files = {path.name for path in kc.export("SRD-05VDC-SL-C", tmp_path)}
    assert "SRD_05VDC_SL_C.lib" in files


def test_a_wrong_part_number_gets_a_suggestion():
    with pytest.raises(kc.errors.UsageError) as caught:
        kc.load_scene("7BB-20-66")
    assert "7BB-20-6" in caught.value.hint


@pytest.mark.parametrize("kind", sorted({part.kind for part in PARTS.values() if not part.scene}))
def test_a_run_of_a_part_number_prints_its_main_figures(kind, cli, tmp_path):
    number = next(n for n, part in PARTS.items() if part.kind == kind and not part.scene)
    result = json.loads(cli("run", number, "--json", "--out", str(tmp_path / "out")).stdout)
    figures = [value for value in result["metrics"].values() if isinstance(value, float)]
    assert len(figures) >= 2


def test_a_loudspeaker_has_the_impedance_of_its_sheet():
    """Free driver: |Z| is largest at fs, ``Re (1 + Qms/Qes)``; the current is at most V / Re."""
    re, qms, qes = 6.23, 6.657, 0.538  # HiFi-Selbstbau, data sheet 633
    metrics = kc.run("Fast-8").metrics
    assert metrics["largest_impedance_hz"] == pytest.approx(46.44, rel=1e-3)
    assert metrics["largest_impedance_ohm"] == pytest.approx(re * (1 + qms / qes), rel=1e-3)
    assert metrics["current_per_volt"] == pytest.approx(1 / re, rel=5e-3)
    # cone at the lowest frequency, 5 Hz: force Bl V / Re on the suspension
    w, mms = 2 * np.pi * 46.44, 10.28e-3
    bl = np.sqrt(w * mms * re / qes)
    assert metrics["stroke_per_volt"] == pytest.approx(bl / re / (w**2 * mms), rel=0.02)


def test_a_relay_has_the_operate_time_and_the_coil_current_of_its_sheet():
    metrics = kc.run("G5LE-1 DC5").metrics
    assert metrics["operate_time_s"] == pytest.approx(10e-3, rel=2e-3)
    assert metrics["coil_current_a"] == pytest.approx(5.0 / 63.0, rel=5e-3)


@pytest.mark.parametrize("number", PARTS)
def test_the_printed_table_of_a_number_describes_the_same_part(number, cli):
    """The table of ``kc2spice parts NUMBER`` has the keys of the part's own scene."""
    printed = cli("parts", number).stdout
    ((name, table),) = tomllib.loads(printed[printed.index("\n[") :]).items()
    scene = kc.load_scene(number)
    own = scene.get_part(name)
    assert table["part"] == PARTS[number].kind
    tables = dict(scene.tables)
    tables[name] = table | {"pins": own.pins}
    assert kc.load_scene(tables).get_part(name).keys == own.keys


@pytest.mark.parametrize("word", ["Fast-8", "fast-8"])
def test_a_part_number_is_no_part_type(word, cli):
    """The advice names the part type, and a command that prints the keys."""
    scene = {"speaker": {"part": word}}
    with pytest.raises(kc.errors.UsageError, match="a part number, not a part type") as caught:
        kc.load_scene(scene)
    assert caught.value.where == "scene, key speaker.part"
    assert 'part = "loudspeaker"' in caught.value.hint
    command = caught.value.hint.partition("kc2spice ")[2].split()[:2]
    printed = cli(*command).stdout
    table = tomllib.loads(printed[printed.index("\n[") :])["device"]
    drive = {"part": "source", "ac": 1.0, "pins": {"out": "speaker.plus"}}
    loaded = kc.load_scene({"speaker": table, "drive": drive, "analysis": AC})
    assert loaded.get_part("speaker").keys.fs == 46.44
    failed = cli("scenes", "--part", word)
    assert "a part number, not a part type" in failed.stderr
