"""Operating points of nets that nothing conducts to: their charge is zero, as before any load."""

import numpy as np
import pytest
from scipy.optimize import brentq

import kc2spice as kc

EPS = 8.8541878188e-12


def bimorph(**more):
    """A bimorph whose tip a force bends."""
    layers = [{"material": m, "thickness": t}
              for m, t in (("PZT-5H", 2e-4), ("steel", 1e-4), ("PZT-5H", 2e-4))]  # fmt: skip
    return {
        "name": "floating",
        "gravity": 0.0,
        "uni": {"part": "bimorph", "length": 40e-3, "width": 10e-3, "layers": layers,
                "wiring": "parallel", "damping": {"ratio": 0.02}, "pins": {"tip": "push.out"}},
        "push": {"part": "source", "kind": "force", "dc": 10e-3},
        "analysis": {"type": "op"},
        "probes": {"volts": {"of": "uni.voltage", "take": "final"}},
        **more,
    }  # fmt: skip


@pytest.mark.slow
def test_a_capacitor_takes_its_share_of_the_charge_of_a_body():
    """``v = q / (C + C_body)`` with the charge q at a short and the free capacitance of a body."""
    scene = bimorph()
    scene["uni"]["pins"]["anode"] = "c.a"
    c = {"part": "capacitor"}
    found = {f: kc.run(scene | {"c": c | {"capacitance": f}}).metrics["volts"]
             for f in (1e-9, 1e-7, 1e-6)}  # fmt: skip
    capacity, volts = np.array(list(found)), np.array(list(found.values()))
    # 1 / v = (C + C_body) / q is a straight line over C
    slope = (1 / volts[2] - 1 / volts[0]) / (capacity[2] - capacity[0])
    assert 1 / volts[1] == pytest.approx(
        1 / volts[0] + slope * (capacity[1] - capacity[0]), rel=1e-6
    )
    drive = {"part": "source", "ac": 1.0}
    shaken = bimorph(drive=drive, analysis={"type": "ac", "start": 0.5, "stop": 1.0, "points": 2})
    shaken["uni"]["pins"] = {"anode": "drive.out"}
    del shaken["push"], shaken["probes"]
    waves = kc.run(shaken).waves
    own = abs(waves["uni.current"][-1]) / (2 * np.pi)
    assert 1 / (slope * volts[0]) - capacity[0] == pytest.approx(own, rel=1e-3)


@pytest.mark.parametrize("kind", ["capacitor", "plate"])
def test_charges_of_a_divider_sum_to_zero(kind):
    """Two capacitors in series at a dc voltage, and one with a plate that the field moves."""
    c, area, gap, k, volts = 1e-13, 1e-8, 2e-6, 10.0, 8.0
    scene = {
        "name": "divider",
        "gravity": 0.0,
        "drive": {"part": "source", "dc": volts, "pins": {"out": "c.a"}},
        "c": {"part": "capacitor", "capacitance": c, "pins": {"b": "low.plus"}},
        "low": {"part": "parallel_plate", "area": area, "gap": gap, "travel": 1.5e-6,
                "pins": {"a": "spring.a"}},
        "spring": {"part": "spring", "stiffness": k},
        "analysis": {"type": "op"},
        "probes": {"volts": {"of": "low.v", "take": "final"}},
    }  # fmt: skip

    def unbalanced(v):
        def force(x):
            return k * x - EPS * area * v**2 / (2 * (gap - x) ** 2)

        x = brentq(force, 0.0, gap / 3)
        return c * (volts - v) - EPS * area / (gap - x) * v

    exact = brentq(unbalanced, 0.0, 7.99)
    if kind == "capacitor":
        scene["low"] = {"part": "capacitor", "capacitance": 3e-13}
        scene["c"]["pins"] = {"b": "low.a"}
        del scene["spring"]
        exact = volts / 4
    assert kc.run(scene).metrics["volts"] == pytest.approx(exact, rel=1e-5)
