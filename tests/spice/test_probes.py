"""Probes: windows, names that are checked before models are built, nodes of a user's netlist."""

import math

import numpy as np
import pytest
from support import StageTimer, UsageError, decks, load_scene

import kc2spice as kc

R, C, V, F = 1e3, 1e-6, 4.0, 200.0


def rc(probes, stop=60e-3, **parts):
    """A source of 4 V at 200 Hz on 1 kOhm and 1 uF in series: at first off its steady state."""
    return {
        "name": "rc",
        "g": {"part": "source", "sine": {"amplitude": V, "frequency": F}},
        "r": {"part": "resistor", "resistance": R, "pins": {"a": "g.out", "b": "c.a"}},
        "c": {"part": "capacitor", "capacitance": C},
        "analysis": {"type": "transient", "stop": stop},
        "solver": {"reltol": 1e-5, "max_step": 1e-5},
        "probes": probes,
        **parts,
    }


def test_windows_read_a_steady_state():
    """rms of the current, its mean, and the power of the source, against phasors."""
    window = {"from": "30 ms", "to": "50 ms"}
    probes = {
        "rms": {"of": "r.i", "take": "rms", "periods": 4},
        "rms_between": {"of": "r.i", "take": "rms", **window},
        "mean": {"of": "c.v", "take": "mean", "periods": 4},
        "power": {"of": "g.power", "take": "mean", "periods": 4},
        "first": {"of": "c.v", "take": "mean", "to": "5 ms"},
    }
    result = kc.run(load_scene(rc(probes)))
    omega = 2 * math.pi * F
    current = V / (R - 1j / (omega * C))
    assert result.metrics["rms"] == pytest.approx(abs(current) / math.sqrt(2), rel=1e-4)
    assert result.metrics["rms_between"] == pytest.approx(abs(current) / math.sqrt(2), rel=1e-4)
    assert abs(result.metrics["mean"]) < 1e-4 * V
    assert result.metrics["power"] == pytest.approx((V * current.conjugate()).real / 2, rel=1e-4)
    # over the first period, v = A e^(-t/RC) + Im(U e^(j w t)) from 0 V: A = -Im(U)
    U = V / (1 + 1j * omega * R * C)
    T = 1 / F
    mean = -U.imag * R * C * (1 - math.exp(-T / (R * C))) / T
    assert result.metrics["first"] == pytest.approx(mean, rel=1e-3)
    assert result.record["metric_units"]["power"] == "W"


def test_ends_of_a_window_lie_between_points():
    """A ramp over coarse points: its mean within the window is the value in its middle."""
    probes = {"mean": {"of": "g.v", "take": "mean", "from": "0.3 ms", "to": "0.55 ms"},
              "last": {"of": "g.v", "take": "final", "to": "0.55 ms"}}  # fmt: skip
    ramp = {"part": "source", "pwl": [[0, 0], ["1 ms", 10]]}
    result = kc.run(load_scene(rc(probes, stop=1e-3, g=ramp)))
    assert result.metrics["mean"] == pytest.approx(4.25, rel=1e-6)
    assert result.metrics["last"] == pytest.approx(5.5, rel=1e-6)


SECOND = {"part": "source", "sine": {"amplitude": 1.0, "frequency": 333.0}}
LOAD = {"part": "resistor", "resistance": 1.0, "pins": {"a": "h.out"}}
BAD_WINDOWS = (
    ({"periods": 20}, {}, "longer than the run", None),
    ({"periods": 2, "from": "1 ms"}, {}, "`periods` cannot be combined with `from` or `to`", None),
    ({"from": "5 ms", "to": "1 ms"}, {}, "the window is empty", None),
    (
        {"from": "5 ms", "at": "6 ms", "take": "value"},
        {},
        "`at` cannot be combined with `from`, `to` or `periods`",
        None,
    ),
    ({"to": "70 ms"}, {}, "outside of the range of the analysis", None),
    ({"periods": 2}, {"h": SECOND, "load": LOAD}, "no common period", "`from` and `to`"),
    ({"periods": 2}, {"g": {"part": "source", "dc": 1.0}}, "no common period", "`from` and `to`"),
)


@pytest.mark.parametrize(("keys", "parts", "problem", "cure"), BAD_WINDOWS)
def test_bad_windows_are_refused(keys, parts, problem, cure):
    with pytest.raises(UsageError, match=problem) as caught:
        load_scene(rc({"x": {"of": "r.i", "take": "rms", **keys}}, **parts))
    assert cure is None or cure in str(caught.value.hint)


def test_pulse_trains_have_a_period():
    train = {"high": 1.0, "width": "2 ms", "edge": "1 us", "period": "5 ms"}
    probes = {"mean": {"of": "g.v", "take": "mean", "periods": 2}}
    scene = load_scene(rc(probes, stop=20e-3, g={"part": "source", "pulse": train}))
    assert kc.run(scene).metrics["mean"] == pytest.approx(0.4, rel=1e-3)


BEAM = {
    "name": "beam",
    "b": {
        "part": "bimorph",
        "length": "20 mm",
        "width": "5 mm",
        "layers": [{"material": "PZT-5A", "thickness": "0.3 mm"}] * 2,
        "points": {"middle": "10 mm"},
        "pins": {"anode": "g.out"},
    },
    "g": {"part": "source", "ac": "1 V"},
    "analysis": {"type": "ac", "start": "10 Hz", "stop": "100 Hz", "points": 3},
}


@pytest.mark.parametrize(
    ("of", "near"),
    [("b.x", "b.u.tip"), ("b.u.tip_", "tip"), ("b.curent", "b.current"), ("g.powr", "g.power")],
)
def test_names_are_checked_before_any_model_is_built(of, near, monkeypatch):
    def build(*_, **__):
        raise AssertionError("a model was built")

    monkeypatch.setattr(type(load_scene(BEAM).parts["b"].type), "build", build)
    with pytest.raises(UsageError) as caught:
        decks.prepare_deck(load_scene({**BEAM, "probes": {"u": {"of": of}}}), StageTimer())
    assert near in f"{caught.value.expected} {caught.value.hint}"


def test_motions_at_ports_that_nothing_is_joined_to_are_offered():
    """``PART.u.PIN`` of every port: a probe alone keeps it."""
    with pytest.raises(UsageError) as caught:
        decks.prepare_deck(load_scene({**BEAM, "probes": {"u": {"of": "b.u"}}}), StageTimer())
    assert "b.u.tip" in caught.value.expected
    assert "b.u.middle" in caught.value.expected


METER = """.subckt meter a b
R1 a b 1k
Bp p b V=V(a,b)*V(a,b)/1000
.ends
"""
READ = """
[m]
part = "netlist"
file = "probe.lib"
subckt = "meter"
pins = { a = "g.out", b = "gnd" }
[g]
part = "source"
sine = { amplitude = "4 V", frequency = "50 Hz" }
[analysis]
type = "transient"
stop = "40 ms"
[probes]
"""


def test_a_node_that_a_probe_reads_is_not_floating(tmp_path):
    """Mean of ``v^2 / R`` over two periods: ``4^2 / 2 / 1 kOhm``."""
    (tmp_path / "probe.lib").write_text(METER)
    path = tmp_path / "pr.toml"
    path.write_text(READ + 'p = { of = "m.p", take = "mean", periods = 2 }\n')
    assert kc.run(path).metrics["p"] == pytest.approx(8e-3, rel=2e-3)
    path.write_text(READ + 'a = { of = "m.a" }\n')
    with pytest.raises(UsageError, match="floating"):
        kc.run(path)


def test_a_window_of_a_response_reads_its_own_peak():
    """Within a band above its resonance the current of a resonator is largest at the lower end."""
    scene = {
        "name": "rlc",
        "g": {"part": "source", "ac": "1 V"},
        "r": {"part": "resistor", "resistance": 10.0, "pins": {"a": "g.out", "b": "l.a"}},
        "l": {"part": "inductor", "inductance": 1e-3, "pins": {"b": "c.a"}},
        "c": {"part": "capacitor", "capacitance": 1e-6},
        "analysis": {"type": "ac", "start": "1 kHz", "stop": "20 kHz", "points": 400},
        "probes": {"i": {"of": "l.i", "take": "max", "from": "10 kHz"}},
    }
    omega = 2 * np.pi * 10e3
    exact = 1 / abs(10.0 + 1j * (omega * 1e-3 - 1 / (omega * 1e-6)))
    assert kc.run(load_scene(scene)).metrics["i"] == pytest.approx(exact, rel=1e-3)


SWEPT = {
    "voltage": ("V", "ohm", "resistance", 100.0, "i"),
    "current": ("A", "ohm", "resistance", 100.0, "v"),
    "force": ("N", "k", "stiffness", 100.0, "x"),
    "displacement": ("m", "k", "stiffness", 100.0, "force"),
}


@pytest.mark.parametrize("kind", SWEPT)
@pytest.mark.parametrize("back", [False, True])
def test_places_on_swept_scales_are_in_si(kind, back):
    """A linear part over a sweep of each kind of source from 0 to 4e-6 in SI: every place that a
    probe states or reads is in the SI unit of the source, a displacement in metres."""
    unit, name, key, value, wave = SWEPT[kind]
    part = "resistor" if name == "ohm" else "spring"
    of, last = "g.x" if kind == "force" else f"{name}.{wave}", 4e-6
    factor = {"i": 1 / value, "v": value, "x": 1 / value, "force": value}[wave]
    probes = {
        "at": {"of": of, "at": f"1e-6 {unit}"},
        "within": {"of": of, "take": "mean", "from": f"1e-6 {unit}", "to": f"3e-6 {unit}"},
        "largest": {"of": "g." + {"m": "x", "V": "v"}.get(unit, unit), "take": "argmax"},
        "passed": {"of": of, "take": "crossing", "level": 2.5e-6 * factor},
    }
    if unit not in ("m", "V"):  # what a source of current or force sets is no result of a sweep
        del probes["largest"]
    scene = {
        "name": "swept",
        "g": {"part": "source", "kind": kind},
        name: {"part": part, key: value, "pins": {"a": "g.out"}},
        "analysis": {
            "type": "dc", "sweep": "g.dc", "from": 0, "to": last, "points": 9, "back": back,
        },
        "probes": probes,
    }  # fmt: skip
    result = kc.run(load_scene(scene))
    found = result.metrics
    top = 2 * last if back else last
    np.testing.assert_allclose(result.waves["sweep"], np.linspace(0, top, 17 if back else 9))
    assert abs(found["at"]) == pytest.approx(1e-6 * factor, rel=1e-6)
    assert abs(found["within"]) == pytest.approx(2e-6 * factor, rel=1e-6)
    sign = np.sign(found["at"])
    if sign > 0:
        assert found["passed"] == pytest.approx(2.5e-6, rel=1e-6)
        assert result.record["metric_units"]["passed"] == unit
    if "largest" in found:
        assert found["largest"] == pytest.approx(last, rel=1e-6)
        assert result.record["metric_units"]["largest"] == unit


@pytest.mark.parametrize(
    "window", [{"from": "2 V"}, {"to": "-1 V"}, {"from": "0.2 V", "to": "5 V"}]
)
def test_windows_off_a_sweep_are_refused(window):
    scene = {
        "name": "swept",
        "g": {"part": "source"},
        "r": {"part": "resistor", "resistance": 10.0, "pins": {"a": "g.out"}},
        "analysis": {"type": "dc", "sweep": "g.dc", "from": 1, "to": 0, "points": 5},
        "probes": {"x": {"of": "r.i", "take": "mean", **window}},
    }
    with pytest.raises(UsageError, match="outside of the range of the analysis") as caught:
        kc.run(load_scene(scene))
    assert "0 … 1" in str(caught.value.expected)


@pytest.mark.parametrize("points", [3, 20])
def test_probes_read_responses_at_their_frequency(points):
    """Current of a series resonator at a frequency and at the ends of a window, in closed form."""
    R, L, C = 10.0, 1e-3, 1e-6
    scene = {
        "name": "rlc",
        "g": {"part": "source", "ac": "1 V"},
        "r": {"part": "resistor", "resistance": R, "pins": {"a": "g.out", "b": "l.a"}},
        "l": {"part": "inductor", "inductance": L, "pins": {"b": "c.a"}},
        "c": {"part": "capacitor", "capacitance": C},
        "analysis": {"type": "ac", "start": "1 kHz", "stop": "20 kHz", "points": points},
        "probes": {
            "at": {"of": "l.i", "at": "3.3 kHz"},
            "below": {"of": "l.i", "take": "max", "to": "2.2 kHz"},
            "above": {"of": "l.i", "take": "max", "from": "8 kHz"},
        },
    }
    found = kc.run(load_scene(scene)).metrics
    for name, f in (("at", 3.3e3), ("below", 2.2e3), ("above", 8e3)):
        s = 2j * np.pi * f
        assert found[name] == pytest.approx(abs(1 / (R + s * L + 1 / (s * C))), rel=1e-6), name


def test_probes_read_densities_at_their_frequency():
    """Johnson's noise of a resistor behind a capacitor, between two frequencies of the analysis."""
    scene = {
        "name": "rc",
        "r": {"part": "resistor", "resistance": R, "pins": {"a": "c.a"}},
        "c": {"part": "capacitor", "capacitance": C},
        "analysis": {"type": "noise", "output": "c.v", "start": 1, "stop": 1e4, "points": 4},
        "probes": {"at": {"of": "noise", "at": "170 Hz"}},
    }
    density = np.sqrt(4 * 1.380649e-23 * 300.15 * R) / abs(1 + 2j * np.pi * 170 * R * C)
    with pytest.warns(UserWarning, match="change of the rms noise without every second frequency"):
        found = kc.run(load_scene(scene)).metrics
    assert found["at"] == pytest.approx(density, rel=1e-4)
