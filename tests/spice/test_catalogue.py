"""The catalogue of parts: every scene loads, and sheets agree with their own redundant values."""

import json

import numpy as np
import pytest
from support import find_part, read_catalogue, search_parts

import kc2spice as kc

PARTS = read_catalogue()
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
