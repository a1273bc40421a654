"""Operating points of small signals: where there is one, and that no plate is on its stop there."""

import numpy as np
import pytest
from scipy.optimize import brentq

import kc2spice as kc

EPS, AREA, GAP, TRAVEL, K = 8.8541878188e-12, 1e-6, 2e-6, 1.5e-6, 20.0
PULL_IN = np.sqrt(8 * K * GAP**3 / (27 * EPS * AREA))  # 2.31 V


def biased(kind, volts, analysis):
    """A plate on a spring that a bias pulls, whose force or current noise is asked for."""
    plate = {"part": kind, "area": AREA, "gap": GAP, "travel": TRAVEL,
             "pins": {"plus": "bias.out"}}  # fmt: skip
    plate |= {"a": "proof.a", "side": "above"} if kind == "gap" else {}
    plate["pins"] |= {} if kind == "gap" else {"a": "proof.a"}
    small = {"start": 10.0, "stop": 1e3, "points": 5}
    return {
        "name": "biased",
        "gravity": 0.0,
        "plate": plate,
        "proof": {"part": "mass", "mass": 50e-9},
        "spring": {"part": "spring", "stiffness": K, "pins": {"a": "proof.a"}},
        "air": {"part": "damper", "damping": 1e-4, "pins": {"a": "proof.a"}},
        "bias": {"part": "source", "dc": volts, "ac": 1.0},
        "analysis": {
            "ac": {"type": "ac", **small},
            "noise": {"type": "noise", "output": "proof.x", **small},
            "op": {"type": "op"},
        }[analysis],
    }


@pytest.mark.parametrize("kind", ["parallel_plate", "gap"])
@pytest.mark.parametrize("analysis", ["ac", "noise"])
def test_small_signal_runs_print_their_operating_point(kind, analysis):
    """``K x = eps A v^2 / (2 (g - x)^2)``."""
    record = kc.run(biased(kind, 2.0, analysis)).record
    x = brentq(lambda x: K * x * 2 * (GAP - x) ** 2 - EPS * AREA * 4.0, 0.0, GAP / 3)
    point = record["operating_point"]
    assert point["proof.x"]["value"] == pytest.approx(x, rel=1e-5)
    assert point["proof.x"]["unit"] == "m"
    assert all(check["passed"] for check in record["checks"])


@pytest.mark.filterwarnings("error:the operating point")
def test_a_film_of_many_branches_has_an_operating_point():
    """A film at rest exerts no force: ``K x = eps A v^2 / (2 (g - x)^2)``."""
    scene = biased("gap", 2.0, "ac")
    scene["plate"]["film"] = {"length": 4e-4, "width": 2e-4}
    scene["analysis"] |= {"start": 100e3, "stop": 5e5}
    record = kc.run(scene).record
    (branches,) = [c["name"] for c in record["checks"] if "branches" in c["name"]]
    assert int(branches.split()[0]) > 3  # as many as an analysis without frequencies has
    x = brentq(lambda x: K * x * 2 * (GAP - x) ** 2 - EPS * AREA * 4.0, 0.0, GAP / 3)
    assert record["operating_point"]["proof.x"]["value"] == pytest.approx(x, rel=1e-5)


@pytest.mark.parametrize("kind", ["parallel_plate", "gap"])
@pytest.mark.parametrize("analysis", ["ac", "noise"])
def test_small_signals_about_a_stop_fail(kind, analysis):
    for volts, stands in ((0.99 * PULL_IN, False), (1.01 * PULL_IN, True)):
        scene = biased(kind, volts, analysis)
        if not stands:
            kc.run(scene)
            continue
        with pytest.raises(kc.errors.SimulationError, match="at its operating point"):
            kc.run(scene)


def test_a_bias_beyond_the_stop_prints_a_warning():
    with pytest.warns(UserWarning, match="beyond the stop at its operating point"):
        result = kc.run(biased("parallel_plate", 5.0, "op"))
    force = EPS * AREA * 25.0 / (2 * (GAP - TRAVEL) ** 2) - K * TRAVEL
    (check,) = [c for c in result.checks if not c.passed]
    assert check.value == pytest.approx(force / 1e5, rel=0.02)  # of the stop's 1e5 N/m


BENDER = {
    "part": "bimorph",
    "length": 20e-3,
    "width": 2e-3,
    "layers": [{"material": "PZT-5A", "thickness": 0.25e-3}] * 2,
    "wiring": "parallel",
    "pins": {"anode": "bias.out"},
}


def bent(bias=1.0, **parts):
    """A clamped bimorph whose tip nothing but a probe names."""
    return {
        "name": "bent",
        "bender": BENDER,
        "bias": {"part": "source", "dc": bias, "ac": 1.0},
        "analysis": {"type": "ac", "start": 10.0, "stop": 100.0, "points": 5},
        "probes": {"u": {"of": "bender.u.tip", "take": "value", "at": "10 Hz"}},
        **parts,
    }


@pytest.mark.slow
@pytest.mark.filterwarnings("error:the operating point")
def test_a_free_tip_of_a_clamped_body_has_an_operating_point():
    """``|u| = 3 d31 V L^2 / h^2`` with both layers of thickness h/2 at V: J. G. Smits et al., Sens.
    Actuators A 28 (1991) 41. The field within a layer makes it stiffer by the quarter of
    ``k31^2 / (1 - k31^2)``, the clamp across the width by a few percent."""
    coupling = 171e-12**2 / (16.4e-12 * 1700 * EPS)
    bend = 3 * 171e-12 * (20e-3 / 0.5e-3) ** 2 / (1 + coupling / (1 - coupling) / 4)
    result = kc.run(bent(diode={"part": "diode", "pins": {"anode": "gnd", "cathode": "bias.out"}}))
    point = result.record["operating_point"]["bender.u.tip"]
    assert abs(point["value"]) == pytest.approx(bend, rel=0.1)
    assert result.metrics["u"] == pytest.approx(abs(point["value"]), rel=1e-3)  # at 10 Hz


def test_a_linear_scene_needs_no_operating_point(monkeypatch):
    def refused(*_):
        raise AssertionError("a second run of the simulator")

    monkeypatch.setattr("kc2spice.workflow.operating_point.run_deck", refused)
    probes = {"i": {"of": "bender.current", "take": "max"}}
    assert kc.run(bent(probes=probes)).record["operating_point"] == {}
