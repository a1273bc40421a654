"""Comparisons of a verification: waves and pairs of a gate, points, metrics without a unit."""

import importlib
import math
from types import SimpleNamespace

import numpy as np
import pytest
from support import (
    Check,
    Gate,
    Solution,
    VerificationResult,
    Waveforms,
    compute_gate_difference,
    compute_output_errors,
    format_verification,
    list_gate_checks,
    list_metric_errors,
)

verification = importlib.import_module("kc2spice.workflow.verify.scene_verification")


def response(low: float, high: float) -> Waveforms:
    """Two entries over 10 frequencies; the second is off by ``low`` at the first two, then by
    ``high``."""
    f = np.arange(1.0, 11.0)
    error = np.where(f <= 2.0, low, high)
    return Waveforms({"frequency": f, "a>a": 1.0 / f, "a>b": (1.0 + error) / f}, {})


@pytest.mark.parametrize("wrong", ["catch.force.0", "catch.force.1", "catch.force.2"])
def test_a_gate_of_several_waves_looks_at_each(wrong: str) -> None:
    waves = {f"catch.force.{k}": np.linspace(0.0, k + 1.0, 5) for k in range(3)}
    exact = Waveforms({"y": np.arange(5.0)} | waves, {})
    ours = Waveforms(exact.data | {wrong: exact[wrong] + 0.03}, {})
    gate = Gate("force", "catch.force.*", {}, "largest")
    assert compute_gate_difference(gate, Solution(ours, {}), Solution(exact, {})) == pytest.approx(
        0.01
    )


@pytest.mark.parametrize("wrong", ["a>a", "a>b"])
def test_a_gate_of_a_response_looks_at_every_pair(wrong: str) -> None:
    exact = response(0.0, 0.0)
    ours = Waveforms(exact.data | {wrong: exact[wrong] * 1.01}, {})
    gate = Gate("response", "*>*", {}, "spectral")
    assert compute_gate_difference(gate, Solution(ours, {}), Solution(exact, {})) == pytest.approx(
        0.01
    )


def test_waves_of_unequal_points_are_compared_where_both_are() -> None:
    """Points that repeat count once; a height follows its velocity, others straight lines."""
    t = np.array([0.0, 1.0, 1.0, 2.0, 4.0])
    ours = {"time": t, "b.y": t**3, "b.v": 3 * t**2, "u": t**2, "c.y": t**2}
    s = np.array([0.5, 1.5, 3.0, 3.5, 3.75, 5.0])
    exact = {"time": s, "b.y": s**3, "b.v": 3 * s**2, "u": s**2, "c.y": s**2}
    found = {
        e.output: e for e in compute_output_errors("p", Waveforms(ours, {}), Waveforms(exact, {}))
    }
    assert found["b.y"].largest < 1e-12  # a cubic is its own spline
    # at 1, 2 and 4 of ours: chords of s^2 from a to b lie above it by (s - a)(b - s)
    assert found["u"].largest == found["c.y"].largest == pytest.approx(0.5 / 16.25)
    power = (0.25**2 + 0.5**2) / 2 + (0.5**2 + 0.25**2), (1.25**2 + 4.5**2) / 2 + 4.5**2 + 16.25**2
    assert found["u"].rms == pytest.approx(np.sqrt(power[0] / power[1]))
    swapped = compute_output_errors("p", Waveforms(exact, {}), Waveforms(ours, {}))
    (one,) = (e for e in swapped if e.output == "u")  # at the points of the coarser one
    assert one.largest == pytest.approx(0.5 / 16)
    assert one.rms == pytest.approx(np.sqrt(power[0] / ((1 + 4**2) / 2 + 4**2 + 16**2)))
    more = {k: v[:-1] for k, v in exact.items()}
    back = {
        e.output: e for e in compute_output_errors("p", Waveforms(exact, {}), Waveforms(more, {}))
    }
    assert all(e.largest < 1e-12 for e in back.values())


def test_a_rounding_error_beside_an_exact_zero_is_no_difference() -> None:
    """A displacement that a source prescribes as zero, and the rounding error of the equations."""
    points = np.arange(3.0)
    for wrong, listed in ((1e-21, False), (1e-9, True)):
        exact = Waveforms({"sweep": points, "beam.u.tip": np.full(3, wrong)}, {})
        ours = Waveforms({"sweep": points, "beam.u.tip": np.zeros(3)}, {})
        found = compute_output_errors("p", ours, exact)
        assert [e.rms for e in found] == ([1.0] if listed else [])


def test_the_error_of_a_metric_without_unit_is_relative_to_itself() -> None:
    waves = Waveforms({"frequency": np.array([1.0, 1e5]), "z": np.array([2.0, 3.0])}, {})
    units = {"z": "Ohm"}
    ours = Solution(waves, {"coupling": 0.33, "least_ohm": 1e-4, "zero": 0.25})
    ohm = {"least_ohm": "Ohm"}
    exact = Solution(waves, {"coupling": 0.30, "least_ohm": 2e-4, "zero": 0.0}, ohm)
    found = dict(list_metric_errors(ours, exact, units))
    assert found["coupling"] == pytest.approx(0.1)
    assert found["least_ohm"] == pytest.approx(1e-4 / 3e-3)  # a thousandth of the largest
    assert found["zero"] == 0.25


def test_relative_errors_are_printed_in_percent() -> None:
    """A value that the run did not reach is a dash beside its limit."""
    checks = [
        Check("a", 0.5, 0.1, "relative", label="error"),
        Check("b", math.nan, 0.1, "relative"),
    ]
    record = VerificationResult(checks).make_record()
    table, _ = format_verification("disc", record)
    assert table.title == "disc: checks, 0 of 2 passed"
    assert table.rows == [("MISSED", "error", "50 %", "10 %"), ("MISSED", "b", "—", "10 %")]


def test_equal_metric_names_of_parts_are_checked_separately() -> None:
    """Of two throws one is right; alone, a part's metric has no name in front."""
    none = Waveforms({"time": np.arange(2.0)}, {})
    gate = Gate("speed", "speed_m_s", {"ngspice_vs_rom": 0.1})
    gates = [("left", gate), ("right", gate)]
    ours, exact = ({"left.speed_m_s": v, "right.speed_m_s": 2.0} for v in (1.5, 1.0))
    rows, _ = list_gate_checks(gates, "ngspice_vs_rom", Solution(none, ours), Solution(none, exact))
    assert [row.value for row in rows] == [pytest.approx(0.5), 0.0]
    assert rows[0].label == "relative error of speed, ngspice versus reduced model"
    alone = (Solution(none, {"speed_m_s": v}) for v in (1.5, 1.0))
    ((row,), _) = list_gate_checks(gates[:1], "ngspice_vs_rom", *alone)
    assert row.value == pytest.approx(0.5)


def test_checks_with_halved_time_steps_are_named_as_such(monkeypatch) -> None:
    """The result with coarse time steps is 5 % off; both solutions use the full model."""
    none = Waveforms({"time": np.arange(2.0)}, {})
    coarse, fine = (Solution(none, {"speed_m_s": value}) for value in (1.05, 1.0))
    solutions = iter((coarse, fine))
    monkeypatch.setattr(verification, "complete_solution", lambda waves, build: next(solutions))
    gate = Gate("speed", "speed_m_s", {"rom_vs_fom": 0.1})
    outcome = VerificationResult()
    work = SimpleNamespace(build=None, outcome=outcome, _list_model_gates=lambda: [("catch", gate)])
    verification._Verification._check_time_steps(work, none, none)
    (check,) = outcome.checks
    assert (check.value, check.passed) == (pytest.approx(0.05), True)
    assert check.name == "speed, full model, time steps halved"
    assert check.label == "relative error of speed, full model, time steps halved"
