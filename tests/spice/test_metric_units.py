"""Units of metrics come from their records: their names, which users choose, decide nothing."""

from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import numpy as np
import pytest
from films import FILM
from scipy.integrate import solve_ivp
from support import bench, find_value_units, format_summary, settings_refinement

import kc2spice as kc

MASS, STIFFNESS, CUBIC, DAMPING, FORCE, TONE, STOP = 25e-6, 100.0, 5e9, 5e-3, 0.05, 400.0, 20e-3
# A Duffing oscillator at a coarse step beside a source of 1 kV, and probes whose names end in words
# that are units of other dimensions.
SCENE = f"""
name = "budget"
error_budget = 1e-3
gravity = 0.0
[spring]
part = "cubic_spring"
stiffness = {STIFFNESS}
cubic = {CUBIC}
pins = {{ a = "mass.a" }}
[mass]
part = "mass"
mass = {MASS}
[damp]
part = "damper"
damping = {DAMPING}
pins = {{ a = "mass.a" }}
[push]
part = "source"
kind = "force"
sine = {{ amplitude = {FORCE}, frequency = {TONE} }}
pins = {{ out = "mass.a" }}
[drive]
part = "source"
dc = "1 kV"
[load]
part = "resistor"
resistance = "1 MOhm"
pins = {{ a = "drive.out" }}
[solver]
stop = {STOP}
max_step = "200 us"
[probes]
x_final = {{ of = "mass.x", take = "final" }}
drive_final = {{ of = "drive.v", take = "final" }}
t_m = {{ of = "drive.v", take = "max" }}
t_s = {{ of = "drive.v", take = "argmax" }}
"""


def rates(t: float, state: np.ndarray) -> list[float]:
    x, v = state
    force = FORCE * np.sin(2 * np.pi * TONE * t)
    return [v, (force - DAMPING * v - STIFFNESS * x - CUBIC * x**3) / MASS]


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    path = tmp_path_factory.mktemp("budget") / "budget.toml"
    path.write_text(SCENE)
    with pytest.warns(UserWarning, match="error_budget|error of x_final"):
        return kc.run(path)


def test_an_error_budget_covers_a_small_length_beside_a_large_voltage(result):
    limits = {"method": "DOP853", "rtol": 1e-10, "atol": 1e-14}
    exact = solve_ivp(rates, (0.0, STOP), [0.0, 0.0], **limits)
    apart = abs(result.metrics["x_final"] - exact.y[0, -1])
    scale = max(abs(exact.y[0, -1]), 0.1 * np.abs(exact.y[0]).max())
    stated = result.record["convergence"]
    assert apart / scale <= stated["errors"]["x_final"]
    assert apart / scale <= 1e-3 or not stated["held"]


@pytest.mark.parametrize("chgtol", [1e-8, 1e-14])
def test_settings_at_their_finest_have_an_error_too(tmp_path, chgtol):
    path = tmp_path / "budget.toml"
    path.write_text(SCENE)
    finest = {"error_budget": 0.5, "solver.reltol": 1e-7, "solver.chgtol": chgtol}
    result = kc.run(kc.load_scene(path, finest))
    limits = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-15}
    exact = solve_ivp(rates, (0.0, STOP), [0.0, 0.0], **limits).y[0, -1]
    error = result.record["convergence"]["errors"]["x_final"]
    assert abs(result.metrics["x_final"] / exact - 1) < error < 1e-2


@pytest.mark.slow
@pytest.mark.parametrize("chgtol", [1e-8, 1e-14])
def test_bench_states_the_error_of_settings_at_their_finest(tmp_path, chgtol):
    """The estimate of the scene as it is equals that of an error budget, run by run."""
    path = tmp_path / "budget.toml"
    path.write_text(SCENE)
    finest = {"error_budget": 0.5, "solver.reltol": 1e-7, "solver.chgtol": chgtol}
    scene = kc.load_scene(path, finest)
    stated = kc.run(scene).record["convergence"]["errors"]["x_final"]
    options = {"metric": ["x_final"], "repeats": 1, "error": 0.5}
    record = bench.bench(scene, tmp_path / "bench", **options)
    own = next(point for point in record["points"] if point["own"])
    limits = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-15}
    exact = solve_ivp(rates, (0.0, STOP), [0.0, 0.0], **limits).y[0, -1]
    value = kc.run(scene).metrics["x_final"]
    assert record["estimate"]["errors"] == {"x_final": pytest.approx(stated, rel=1e-9)}
    assert abs(value / exact - 1) < own["error"]
    assert own["error"] <= own["bound"] < 1e-2
    assert record["reference"]["error"] > 0.0


def test_records_state_the_units_of_all_metrics(result):
    assert result.record["metric_units"] == {
        "mass_peak_m": "m",
        "mass_speed_m_s": "m/s",
        "x_final": "m",
        "drive_final": "V",
        "t_m": "V",
        "t_s": "s",
    }


def test_reports_print_the_unit_of_the_record(result):
    rows = dict(format_summary(result.record).rows)
    assert rows["t m"].startswith("1 kV, ")
    assert rows["drive final"].startswith("1 kV, ")
    assert "mm/s" in rows["mass speed"]


def test_a_damping_is_no_length(tmp_path):
    path = tmp_path / "film.toml"
    path.write_text(FILM)
    result = kc.run(path)
    rows = dict(format_summary(result.record).rows)
    assert rows["gap stiffness"].endswith(" kN/m")
    assert rows["gap damping"] == f"{result.metrics['gap_damping_n_s_m']:.4g} N·s/m"


@pytest.mark.parametrize("part", ["bvd", "disc"])
def test_resonances_behind_a_coil_are_those_of_the_part_without_its_circuit(part):
    """``resonance_hz`` of the part does not depend on the coil, and the summary says so."""
    keys = {"bvd": {"c0": "1 nF", "rm": "50 Ohm", "lm": "10 mH", "cm": "0.3 nF"},
            "disc": {"layers": [{"material": "PZT-8", "diameter": "25 mm", "thickness": "3 mm"}],
                     "damping": {"quality": 500}}}[part]  # fmt: skip
    analysis = {"type": "ac", "start": "60 kHz", "stop": "150 kHz", "points": 200}
    scene = {"name": "s", "drive": {"part": "source", "ac": "1 V"}, "analysis": analysis}
    coil = {"part": "inductor", "inductance": "2.3 mH",
            "pins": {"a": "drive.out", "b": "x.anode"}}  # fmt: skip
    bare = kc.run(scene | {"x": {"part": part, **keys, "pins": {"anode": "drive.out"}}})
    tuned = kc.run(scene | {"x": {"part": part, **keys}, "coil": coil})
    assert tuned.metrics["resonance_hz"] == pytest.approx(bare.metrics["resonance_hz"], rel=1e-3)
    texts = [dict(format_summary(run.record).rows)["series resonance"] for run in (bare, tuned)]
    assert "circuit" not in texts[0]
    assert texts[1].endswith(" kHz, of x without its circuit")


@dataclass
class Metrics:
    """The attributes of a run that an error estimate reads."""

    values: dict[str, np.ndarray]
    units: dict[str, str]
    waves: SimpleNamespace = field(default_factory=lambda: SimpleNamespace(scale=np.arange(2.0)))
    is_small_signal: bool = False


def runs(coarse: dict[str, float], fine: dict[str, float], units: dict[str, str]):
    return [Metrics({k: np.asarray(v) for k, v in m.items()}, units) for m in (coarse, fine)]


def test_errors_of_metrics_are_relative_to_metrics_of_the_same_unit():
    # by name the length would be judged by 100 V, the quality by the coupling
    units = {"x_peak": "m", "u_peak": "V", "far_m": "m"}
    coarse, fine = runs(
        {"x_peak": 1.1e-6, "u_peak": 1e3, "far_m": 2e-6, "quality": 90.0, "coupling_quality": 0.3},
        {"x_peak": 1.0e-6, "u_peak": 1e3, "far_m": 2e-6, "quality": 100.0, "coupling_quality": 0.3},
        units,
    )
    found = settings_refinement.compute_metric_changes(coarse, fine)
    assert found["x_peak"] == pytest.approx(0.1)
    assert found["quality"] == pytest.approx(0.1)


def test_near_zero_values_are_judged_by_a_tenth_of_the_largest_in_their_unit():
    units = {"rest": "m", "stroke": "m"}
    coarse, fine = runs({"rest": 2e-9, "stroke": 1e-6}, {"rest": 1e-9, "stroke": 1e-6}, units)
    assert settings_refinement.compute_metric_changes(coarse, fine)["rest"] == pytest.approx(
        1e-9 / 1e-7
    )


def test_errors_of_a_response_are_relative_to_each_value():
    """An amplitude below a resonance is no small difference of large ones."""
    units = {"low": "m", "peak": "m", "still": "m"}
    coarse, fine = runs(
        {"low": 2e-9, "peak": 1e-6, "still": 3e-19}, {"low": 1e-9, "peak": 1e-6, "still": 0}, units
    )
    found = settings_refinement.compute_metric_changes(replace(coarse, is_small_signal=True), fine)
    assert found["low"] == pytest.approx(1.0)
    assert found["still"] < 1e-6


def test_a_short_list_is_not_a_curve_over_frequency():
    """A list of three resonances has no values between its entries."""
    waves = SimpleNamespace(scale=np.linspace(1.0, 2.0, 100))
    coarse, fine = (
        replace(run, is_small_signal=True, waves=waves)
        for run in runs({"modes": [100.0, 180.0, 300.0]}, {"modes": [100.0, 200.0, 300.0]}, {})
    )
    found = settings_refinement.compute_metric_changes(coarse, fine)
    assert found["modes"] == pytest.approx(20.0 / 300.0)


def test_bench_and_error_budget_state_the_same_error():
    units = {"rest": "m", "stroke": "m"}
    coarse, fine = runs({"rest": 2e-9, "stroke": 1e-6}, {"rest": 1e-9, "stroke": 1.1e-6}, units)
    assert bench.compute_metric_errors(
        coarse, fine, ("rest", "stroke")
    ) == settings_refinement.compute_metric_changes(coarse, fine)


def test_facts_of_models_have_units():
    facts = {
        "unknowns": 10,
        "mass_kg": 1e-3,
        "capacitance_free_f": 1e-9,
        "anode_capacitance_f": 1e-9,
        "free_stroke_tip_m_m_per_v": 1e-9,
        "resonance_short_hz": 1e3,
        "extent_x_mm": 3.0,
    }
    assert find_value_units(facts) == {
        "mass_kg": "kg",
        "capacitance_free_f": "F",
        "anode_capacitance_f": "F",
        "free_stroke_tip_m_m_per_v": "m/V",
        "resonance_short_hz": "Hz",
        "extent_x_mm": "mm",
    }


@pytest.mark.parametrize(
    ("height", "width", "takes", "spiky"),
    [
        (3.0, 1e-13, "max", True),
        (-3.0, 1e-13, "min", True),
        (3.0, 1e-5, "max", False),
        (1e-3, 1e-13, "max", False),
        (3.0, 1e-13, "rms", False),
    ],
)
def test_a_spike_of_an_ideal_switch_is_named(height, width, takes, spiky):
    """A sine with one sample that differs, at 5 ms of 10 ms."""
    time = np.sort(np.r_[np.linspace(0, 1e-2, 1000), 5e-3 - width, 5e-3, 5e-3 + width])
    wave = np.sin(2 * np.pi * 1e3 * time)
    wave[np.searchsorted(time, 5e-3)] += height
    scene = kc.load_scene(
        {
            "drive": {"part": "source", "sine": {"frequency": "1 kHz"}},
            "r": {"part": "resistor", "resistance": "1 Ohm", "pins": {"a": "drive.out"}},
            "analysis": {"type": "transient", "stop": "10 ms"},
            "probes": {"peak": {"of": "r.voltage", "take": takes}},
        }
    )
    waves = {"time": time, "r.voltage": wave}
    run = SimpleNamespace(build=SimpleNamespace(scene=scene), waves=waves)
    text = settings_refinement._describe_spike("peak", [run])
    assert ("r.voltage has a spike at 5 ms" in text) is spiky
    assert bool(text) is spiky
