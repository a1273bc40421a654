"""Resonators and crystals from data sheets: their netlists in ngspice against closed forms."""

import re
import subprocess

import numpy as np
import pytest
from support import list_dialect_names, read_catalogue

import kc2spice as kc

C0, FS, CM, RM = 8e-9, 6300.0, 0.45e-9, 210.0  # of a buzzer disc
DRIVE = {"part": "source", "ac": 1.0}


def scene(start=500.0, stop=1e4, points=400, scale="log", kind="bvd", **keys):
    pin = "anode" if kind == "bvd" else "a"
    analysis = {"type": "ac", "start": start, "stop": stop, "points": points, "scale": scale}
    part = {"part": kind, "pins": {pin: "drive.out"}, **keys}
    return {"name": "sheet", "part": part, "drive": DRIVE, "analysis": analysis}


def impedance(tables, *frequencies):
    """V / I of the part in ngspice, at these frequencies alone."""
    result = []
    for frequency in frequencies:
        span = {"start": frequency, "stop": 1.01 * frequency, "points": 2, "scale": "linear"}
        waves = kc.run({**tables, "analysis": {"type": "ac", **span}}).waves
        result.append(waves["part.voltage"][0] / waves["part.current"][0])
    return np.array(result)


def closed_form(frequency, c0, branches):
    """Impedance of c0 beside series branches (fs, cm, rm)."""
    w = 2 * np.pi * np.asarray(frequency)
    admittance = 1j * w * c0
    for fs, cm, rm in branches:
        inductance = 1 / ((2 * np.pi * fs) ** 2 * cm)
        admittance = admittance + 1 / (rm + 1j * w * inductance + 1 / (1j * w * cm))
    return 1 / admittance


def sheet(c0=C0, fs=FS, cm=CM, rm=RM):
    """All values that a sheet of one mode may state, by closed forms."""
    w, fp = 2 * np.pi * fs, fs * np.sqrt(1 + cm / c0)
    return {
        "fs": fs, "fp": fp, "keff": np.sqrt(cm / (c0 + cm)), "cm": cm, "lm": 1 / (w**2 * cm),
        "rm": rm, "qm": 1 / (w * cm * rm), "zs": abs(closed_form(fs, c0, [(fs, cm, rm)])),
        "c0": c0, "c_low": c0 + cm / (1 - (1e3 / fs) ** 2),
    }  # fmt: skip


SETS = (
    ("fs", "fp", "c0", "qm"), ("fs", "fp", "c_low", "rm"), ("fs", "keff", "c_low", "zs"),
    ("fp", "keff", "c0", "zs"), ("fs", "cm", "c_low", "rm"), ("lm", "cm", "rm", "c0"),
    ("fs", "lm", "qm", "c_low"), ("fp", "lm", "zs", "c0"), ("lm", "keff", "c_low", "qm"),
    ("fs", "qm", "rm", "c0"),
)  # fmt: skip


@pytest.mark.parametrize("names", SETS)
def test_any_sufficient_set_of_values_gives_the_same_impedance(names):
    values = sheet()
    tables = scene(**{name: values[name] for name in names})
    places = np.array([1e3, FS, values["fp"], 9e3])
    expected = closed_form(places, C0, [(FS, CM, RM)])
    np.testing.assert_allclose(impedance(tables, *places), expected, rtol=2e-8)


def test_two_modes_have_the_antiresonances_of_the_sheet():
    """Roots of the susceptance, found by bisection, are the parallel resonances of the sheet."""
    from scipy.optimize import brentq

    branches = [(6300.0, 4e-10, 0.0), (27e3, 9e-10, 0.0)]

    def susceptance(f):
        return C0 + sum(c / (1 - (f / fs) ** 2) for fs, c, _ in branches)

    fp = [brentq(susceptance, 6301, 26999), brentq(susceptance, 27001, 1e5)]
    tables = scene(fs=[6300.0, 27e3], fp=fp, c0=C0, rm=[300.0, 80.0])
    places = np.array([1e3, 6300.0, 2e4, 27e3, fp[1]])
    expected = closed_form(places, C0, [(6300.0, 4e-10, 300.0), (27e3, 9e-10, 80.0)])
    np.testing.assert_allclose(impedance(tables, *places), expected, rtol=2e-7)


def test_a_run_reads_off_the_values_of_the_sheet():
    values = sheet()
    metrics = kc.run(scene(**{name: values[name] for name in SETS[0]})).metrics
    assert metrics["resonance_hz"] == pytest.approx(FS, rel=1e-7)
    assert metrics["antiresonance_hz"] == pytest.approx(values["fp"], rel=1e-7)
    assert metrics["coupling"] == pytest.approx(np.sqrt(1 - (FS / values["fp"]) ** 2), rel=1e-6)
    assert metrics["quality"] == pytest.approx(values["qm"], rel=1e-5)


def test_redundant_values_are_averaged_by_their_tolerances():
    """Two values of one quantity, ``c0`` and ``c_low - cm``, whose weighted mean is known."""
    tables = scene(fs=FS, cm=1e-15, rm=1e6, c0=1e-9, c_low=1.02e-9)
    tables["part"]["tolerance"] = {"c0": 0.01, "c_low": 0.02}
    found = kc.load_scene(tables).records["part"].shared_data.c0
    weights = np.log1p([0.01, 0.02]) ** -2.0
    assert found == pytest.approx(np.exp(weights @ np.log([1e-9, 1.02e-9]) / weights.sum()), 1e-6)


def test_a_contradiction_lists_both_values_and_their_implications():
    """A coupling of 0.4 where the resonances give another one; with it fs or fp would differ."""
    values = sheet() | {"keff": 0.4}
    stated = {name: values[name] for name in ("fs", "fp", "keff", "c0", "rm")}
    with pytest.raises(kc.errors.UsageError) as caught:
        kc.load_scene(scene(**stated))
    error = caught.value
    first, second = error.message.split(" contradicts ")
    assert first == "keff"
    assert second in ("fs", "fp")
    fp = FS / np.sqrt(1 - 0.4**2)
    moved = fp if second == "fp" else values["fp"] * np.sqrt(1 - 0.4**2)
    assert error.got == f"keff = 0.4 and {second} = {values[second]:.5g} Hz"
    assert f"keff = {sheet()['keff']:.5g}, as computed from {second}" in error.expected
    assert f"{second} = {moved:.5g} Hz, as computed from keff" in error.expected


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"fs": FS, "keff": 0.2, "c0": C0}, "the stated values do not fully determine the circuit"),
        ({}, "the stated values do not fully determine the circuit"),
        ({"fs": 7e3, "fp": 6e3, "c0": C0, "rm": 1.0}, "parallel resonance is not above"),
        ({"fs": FS, "keff": 0.2, "c0": C0, "zs": 1e6}, "exceeds the reactance of the clamped"),
        (
            {"fs": FS, "rm": 1.0, "c0": 2e-9, "c_low": 1e-9},
            "is not greater than the clamped capacitance",
        ),
        ({"fs": [1e3, 2e3], "keff": 0.2, "c0": C0, "rm": 1.0}, "lists of modes differ in length"),
        ({"fs": 500.0, "keff": 0.2, "c_low": C0, "rm": 1.0}, "above the lowest resonance"),
        ({"fs": FS, "keff": 0.2, "c0": C0, "rm": 1.0, "tolerance": {"qm": 0.1}}, "but no value of"),
        ({"fs": FS, "keff": 0.2, "c0": C0, "rm": 1e300}, "too small or too large"),
        ({"fs": [], "keff": 0.2, "c0": C0, "rm": 1.0}, "the list is empty"),
    ],
)
def test_sheets_that_no_circuit_has_are_errors(keys, message):
    with pytest.raises(kc.errors.UsageError, match=message) as caught:
        kc.load_scene(scene(**keys))
    assert "key part" in caught.value.where


def test_values_that_fit_two_circuits_are_refused():
    """``zs`` and ``fp`` of 1 nF, and of 12.38 nF, by the closed forms, at 1 MHz and Qm = 100."""
    w, cm, c0 = 2e6 * np.pi, 0.3e-9, 1e-9
    lm = 1 / (w**2 * cm)
    rm = w * lm / 100
    values = {"fp": 1e6 * np.sqrt(1 + cm / c0), "lm": lm, "qm": 100.0}
    with pytest.raises(kc.errors.UsageError, match="fit more than one circuit") as caught:
        kc.load_scene(scene(**values, zs=1 / abs(1j * w * c0 + 1 / rm)))
    assert "c0 = 1e-09 F" in caught.value.expected
    assert "c0 = 1.238e-08 F" in caught.value.expected
    assert caught.value.hint == "add c0"


def test_a_missing_value_is_named():
    with pytest.raises(kc.errors.UsageError) as caught:
        kc.load_scene(scene(fs=FS, keff=0.2, c0=C0))
    assert caught.value.expected == "1 more value of rm, qm, zs"


def test_a_usual_coupling_factor_completes_a_sheet_without_one():
    """The advised value is within the coupling factors of the listed buzzer discs."""
    keys = {"fs": FS, "zs": 200.0, "c_low": 10e-9}
    with pytest.raises(kc.errors.UsageError, match="do not fully determine") as caught:
        kc.load_scene(scene(**keys))
    advised = float(re.search(r"keff = ([\d.]+)", caught.value.hint)[1])
    assert kc.run(scene(**keys, keff=advised)).metrics["coupling"] == pytest.approx(advised, 1e-3)
    discs = [part.keys for part in read_catalogue().values() if part.device == "buzzer disc"]
    listed = [float(found[1]) for keys in discs if (found := re.search(r"keff = (.*)", keys))]
    assert len(listed) == 5
    assert min(listed) <= advised <= max(listed)
    low, high = map(float, re.search(r"have ([\d.]+) to ([\d.]+)", caught.value.hint).groups())
    assert (low, high) == pytest.approx((min(listed), max(listed)), abs=5e-3)


CRYSTAL = {"kind": "crystal", "f": 1e6, "cl": 12e-12, "c0": 3e-12}
LIBRARIES = {
    "keff": {name: sheet()[name] for name in ("fs", "keff", "c_low", "zs")},
    "fp": {name: sheet()[name] for name in ("fs", "fp", "c0", "qm")},
    "cm": {name: sheet()[name] for name in ("fs", "cm", "c_low", "rm")},
    "l1": {**CRYSTAL, "l1": 2.6, "q": 5e4},
    "c1": {**CRYSTAL, "c1": 10e-15, "r1": 50.0},
}


@pytest.mark.parametrize(
    ("library", "setting", "words"),
    [
        ("keff", "", ""),
        ("keff", "keff=0.5", ""),
        ("keff", "keff=1.2", "keff_must_be_between_0_and_1"),
        ("keff", "keff=1", "keff_must_be_between_0_and_1"),
        ("keff", "zs=4000", "zs_must_be_below_the_reactance_of_c0"),
        ("keff", "zs=-1", "zs_must_be_above_0"),
        ("keff", "fs=900", "fs_must_be_at_least_1000"),
        ("fp", "", ""),
        ("fp", "fp=6k", "fp_must_be_above_fs"),
        ("fp", "qm=0", "qm_must_be_above_0"),
        ("cm", "", ""),
        ("cm", "cm=20n", "c_low_must_be_above_the_sum_of_cm"),
        ("l1", "", ""),
        ("l1", "l1=1m", "l1_is_too_small_for_f_c0_and_cl"),
        ("c1", "", ""),
        ("c1", "r1=-5", "r1_must_be_above_0"),
    ],
)
def test_a_library_stops_the_simulator_outside_of_its_ranges(library, setting, words, tmp_path):
    keys = LIBRARIES[library]
    kc.export(scene(**keys), tmp_path)
    part = keys.get("kind", "bvd")
    deck = (
        f"test\n.include {part}.lib\nV1 a 0 DC 0 AC 1\nX1 a 0 {part} {setting}\n"
        ".ac lin 2 5k 6k\n.print ac v(a)\n.end\n"
    )
    (tmp_path / "own.cir").write_text(deck)
    command = ["ngspice", "-b", "own.cir"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    log = done.stdout + done.stderr
    assert (f"rx1.r{words}" in log.replace("r.x1", "rx1")) is bool(words)
    assert ("No. of Data Rows : 2" in log) is not words


def test_the_header_of_a_library_states_the_ranges(tmp_path):
    kc.export(scene(**LIBRARIES["keff"]), tmp_path)
    (library,) = kc.read_lib(tmp_path / "bvd.lib")
    params = {p.name: (p.low, p.high) for p in library.params}
    assert params["keff"] == (pytest.approx(0, abs=1e-29), 1)
    assert params["fs"] == (1000, np.inf)


def test_a_sweep_varies_the_capacitance_within_its_tolerance():
    """The parameter of the subcircuit, 30 % up: every capacitance follows, resonances stay."""
    values = sheet()
    tables = scene(fs=FS, fp=values["fp"], c_low=10e-9, qm=50.0, tolerance={"c_low": "30 %"})
    done = kc.sweep(kc.load_scene(tables), {"param.bvd.c_low": [10e-9, 13e-9]})
    np.testing.assert_allclose(done["resonance_hz"], FS, rtol=1e-6)
    np.testing.assert_allclose(done["antiresonance_hz"], values["fp"], rtol=1e-6)
    low, high = done["capacitance_f"]
    assert high / low == pytest.approx(1.3, rel=1e-6)


def test_verify_compares_netlist_and_equations():
    result = kc.verify(scene(**{name: sheet()[name] for name in SETS[2]}))
    assert result["passed"]


@pytest.mark.parametrize("dialect", list_dialect_names())
def test_every_dialect_has_them(dialect, tmp_path):
    for kind, keys in (("bvd", {n: sheet()[n] for n in SETS[2]}), ("crystal", WATCH)):
        files = kc.export(scene(kind=kind, **keys), tmp_path / kind, dialect=dialect)
        assert files


WATCH = {"f": 32768.0, "cl": 12.5e-12, "c0": 1.2e-12, "c1": 3e-15, "r1": 35e3}


def test_a_crystal_and_its_load_are_in_resonance_at_the_frequency_of_the_sheet():
    """At f the reactance of the crystal and that of the load capacitance sum to zero, and the
    series resonance is ``f / sqrt(1 + c1 / (c0 + cl))``; losses shift both by (r1 / X)^2."""
    watch = WATCH | {"r1": 1.0}
    fs = 32768.0 / np.sqrt(1 + 3e-15 / (1.2e-12 + 12.5e-12))
    at_load, at_series = impedance(scene(kind="crystal", **watch), 32768.0, fs)
    assert at_load.imag == pytest.approx(1 / (2 * np.pi * 32768.0 * 12.5e-12), rel=1e-6)
    assert at_series.real == pytest.approx(1.0, rel=1e-6)


@pytest.mark.parametrize("names", [("c1", "r1"), ("l1", "r1"), ("c1", "q"), ("l1", "q")])
@pytest.mark.parametrize("load", [None, 12.5e-12])
def test_a_crystal_by_inductance_or_quality_is_the_same(names, load):
    fs = 32768.0 / np.sqrt(1 + (0.0 if load is None else 3e-15 / (1.2e-12 + load)))
    w = 2 * np.pi * fs
    values = {"c1": 3e-15, "l1": 1 / (w**2 * 3e-15), "r1": 35e3, "q": 1 / (w * 3e-15 * 35e3)}
    keys = {"f": 32768.0, "c0": 1.2e-12} | {name: values[name] for name in names}
    keys |= {} if load is None else {"cl": load}
    places = np.array([3e4, fs, 1.0001 * fs])
    expected = closed_form(places, 1.2e-12, [(fs, 3e-15, 35e3)])
    np.testing.assert_allclose(impedance(scene(kind="crystal", **keys), *places), expected, 1e-6)


def test_a_crystal_whose_values_contradict_is_an_error():
    with pytest.raises(kc.errors.UsageError, match="contradicts"):
        kc.load_scene(scene(kind="crystal", **(WATCH | {"q": 1e3})))
