"""Parts whose loss grows with the square of a velocity or flow, against closed forms."""

import warnings

import numpy as np
import pytest
from support import Declaration, DeclaredPart, branch, displacement, parttype

import kc2spice as kc

MASS, DRAG, SPEED, STOP = 20e-3, 0.5, 2.0, 0.1


class DragKeys(kc.Section):
    drag: float


@pytest.fixture(autouse=True)
def parts(monkeypatch):
    """A damper with the force ``drag v |v|``, and an orifice with the pressure ``drag q |q|``."""
    for name, coordinate in (("drag_plate", displacement("x", "a", "b")),
                             ("orifice", branch("volume_velocity"))):  # fmt: skip
        rate = "x_rate" if name == "drag_plate" else "flow"
        content = f"drag*(max(0, {rate})^3 + max(0, -{rate})^3)/3"
        declaration = Declaration(name, name, DragKeys, (coordinate,), content=content)
        monkeypatch.setitem(parttype._types, name, DeclaredPart(declaration))


@pytest.mark.parametrize("speed", [SPEED, -SPEED])
def test_a_mass_coasts_by_the_logarithm_of_time(speed):
    """``x = m/c ln(1 + c v t/m)``: the corner of the law is at the velocity zero."""
    scene = {
        "name": "coast",
        "body": {"part": "mass", "mass": MASS, "velocity": speed},
        "damper": {"part": "drag_plate", "drag": DRAG, "pins": {"a": "body.a"}},
        "solver": {"stop": STOP},
        "probes": {"end_m": {"of": "damper.x", "take": "final"}},
    }
    result = kc.verify(scene)
    way = MASS / DRAG * np.log(1 + DRAG * SPEED * STOP / MASS)
    assert result["answers"]["ngspice"]["end_m"] == pytest.approx(np.copysign(way, speed), rel=1e-6)
    assert result["answers"]["rom"]["end_m"] == pytest.approx(np.copysign(way, speed), rel=1e-9)
    assert result["passed"]


def test_a_sine_of_the_displacement_begins_with_a_velocity():
    """Force ``drag (w X)^2 cos(w t) |cos(w t)|`` from the first instant on."""
    amplitude, cycles = 1e-3, 20.0
    scene = {
        "name": "shaken",
        "damper": {"part": "drag_plate", "drag": DRAG, "pins": {"a": "drive.out"}},
        "drive": {"part": "source", "kind": "displacement",
                  "sine": {"amplitude": amplitude, "frequency": cycles}},
        "solver": {"stop": 0.02},
        "probes": {"mean_n": {"of": "damper.force", "take": "mean"}},
    }  # fmt: skip
    result = kc.verify(scene)
    w = 2 * np.pi * cycles
    t = np.linspace(0, 0.02, 100_001)
    force = DRAG * (w * amplitude) ** 2 * np.cos(w * t) * np.abs(np.cos(w * t))
    mean = np.trapezoid(force, t) / 0.02
    assert result["answers"]["rom"]["mean_n"] == pytest.approx(mean, rel=1e-4)
    assert result["passed"]


def test_reversals_of_a_flow_are_no_impacts():
    scene = {
        "name": "blown",
        "orifice": {"part": "orifice", "drag": 1e12, "pins": {"a": "drive.out"}},
        "drive": {"part": "source", "kind": "volume_velocity",
                  "sine": {"amplitude": "5 cm3/s", "frequency": "1 kHz"}},
        "solver": {"stop": "5 ms"},
        "probes": {"peak_pa": {"of": "orifice.pressure", "take": "max"}},
    }  # fmt: skip
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        result = kc.run(scene)
    assert result.metrics["peak_pa"] == pytest.approx(1e12 * 5e-6**2, rel=1e-4)
