"""What ``verify`` looks at in a scene and in each body, on solutions made by hand."""

import importlib
from types import SimpleNamespace

import numpy as np
import pytest

from kc2spice.core.errors import UsageError
from kc2spice.core.laws import (
    Contact,
    Equations,
    LinearBody,
    Reading,
    Sensor,
    SignalBlock,
    Source,
)
from kc2spice.core.progress import Clock, silent
from kc2spice.core.waveforms import Waveforms
from kc2spice.netlist.circuit import Pin, Subcircuit
from kc2spice.netlist.deck import Deck
from kc2spice.rom.linear import Certificate, LinearModel, Port
from kc2spice.scene.load import load_scene
from kc2spice.spice.realize import LEAK
from kc2spice.workflow.models import build_models
from kc2spice.workflow.verify import bodies, circuit
from kc2spice.workflow.verify.compare import Solution, solution

module = importlib.import_module("kc2spice.workflow.verify.verify")
TIME = np.array([0.0, 1.0])


def test_a_solution_has_the_metrics_that_its_waves_tell():
    def lost(*_):
        raise KeyError("ball.y")

    kinds = {"a": lambda *_: {"x": 1}, "b": lost, "c": lambda *_: {"y": 2}}
    parts = {k: SimpleNamespace(type=SimpleNamespace(metrics=each)) for k, each in kinds.items()}
    waves = Waveforms({"time": TIME}, {})
    found = solution(waves, SimpleNamespace(scene=SimpleNamespace(parts=parts)))
    assert found == Solution(waves, {"x": 1, "y": 2})


def test_one_deck_is_of_one_scene(tmp_path):
    with pytest.raises(UsageError, match="one deck") as caught:
        module.verify([None, None], tmp_path / "out", deck=Deck(name="d"))
    assert caught.value.got == "2 scenes"


def test_subcircuits_are_those_emitted_or_on_disk():
    own = Subcircuit("a", (), (), ".subckt a\n.ends\n")
    assert module._libraries(Deck(name="d", parts=(own,))) == (own,)
    text = "* b\n.subckt b in out\nR1 in out 1\n.ends\n"
    (found,) = module._libraries(Deck(name="d", text="* d\n", more={"b.lib": text}))
    assert (found.name, [pin.name for pin in found.pins]) == ("b", ["in", "out"])


# -------------------------------------------------------------------------------------- bodies

KINDS = {"tip": "mechanical", "turn": "rotational", "anode": "electrical", "base": "acceleration",
         "u1": "input", "y1": "output"}  # fmt: skip
# kinds as files spell them: equal words, not the same objects
PORTS = {name: Port(name, "".join(list(kind))) for name, kind in KINDS.items()}
CERTIFICATE = Certificate((0.0, 200.0), 1e-5, "told", True, True)


def body(names, hertz=(10.0, 100.0), **more):
    """Resonators with these ports, damped by 1 %; electrodes have 2 nF of their own."""
    omega = 2 * np.pi * np.array(hertz)
    rng = np.random.default_rng(4)
    inputs = [n for n in names if KINDS[n] != "output"]
    outputs = [n for n in names if KINDS[n] != "input"]
    B = rng.uniform(1, 2, (omega.size, len(inputs)))
    C = rng.uniform(1, 2, (len(outputs), omega.size)) if "y1" in names else B.T
    D = np.zeros((len(C), B.shape[1]))
    if "anode" in names:
        D[outputs.index("anode"), inputs.index("anode")] = 2e-9
    return LinearModel(
        M=np.eye(omega.size), E=np.diag(0.02 * omega), K=np.diag(omega**2), B=B, C=C, D=D,
        ports=tuple(PORTS[n] for n in names), certificate=CERTIFICATE, name="b", **more,
    )  # fmt: skip


def test_the_leak_is_a_share_of_the_clamped_capacitances_charge():
    rom = body(["tip", "anode"])
    found = bodies.leakage(rom, np.array([50.0, 5.0]))
    np.testing.assert_allclose(found, [LEAK / (2 * np.pi * 5.0 * 2e-9)])
    assert bodies.leakage(body(["tip"]), np.array([5.0])).size == 0
    bare = LinearModel(M=rom.M, K=rom.K, B=rom.B, ports=rom.ports)
    assert bodies.leakage(bare, np.array([5.0])).tolist() == [0.0]


def test_each_electrode_is_judged_by_its_own_leak():
    rom = body(["base", "anode", "tip"])
    exact = rom.transfer(np.array([50.0, 60.0]))
    wrong = exact * (1 + 1e-4)
    for leak, passed in ((1e-6, False), (0.6e-4, True)):
        checks = bodies.electrical_checks("b", rom, wrong, exact, 1e-8, np.array([leak]))
        assert [c.name for c in checks] == [
            "b: capacitance of anode", "b: charge by loads of anode",
        ]  # fmt: skip
        assert [c.passed for c in checks] == [passed] * 2
        assert checks[0].limit == pytest.approx(2 * leak)
    alone = body(["anode"])
    H = alone.transfer(np.array([50.0]))
    (only,) = bodies.electrical_checks("b", alone, H, H, 1e-8, np.zeros(1))
    assert (only.name, only.limit) == ("b: capacitance of anode", 1e-8)


def test_the_band_is_the_certificates_or_the_scenes():
    def scene(kind):
        analysis = SimpleNamespace(type="".join(list(kind)), stop=70.0)
        return SimpleNamespace(
            scene=SimpleNamespace(analysis=analysis, rom=SimpleNamespace(band=(1.0, 9.0)))
        )

    rom = body(["tip"])
    bare = LinearModel(M=rom.M, K=rom.K, B=rom.B)
    assert bodies._band(rom, scene("ac")) == (0.0, 200.0)
    assert bodies._band(bare, scene("ac")) == (0.0, 70.0)
    assert bodies._band(bare, scene("transient")) == (1.0, 9.0)


def test_poles_of_a_reduced_model_are_told_by_their_damping():
    with np.errstate(all="raise"):  # nothing is asked at rest, where no power flows
        (pole, power, pairs) = bodies.own_structure("b", body(["tip", "turn"]), (0.0, 200.0))
    assert (pole.name, pole.limit) == ("b: ROM, growth of its poles", 0.0)
    assert pole.value == pytest.approx(-0.01)
    assert power.passed
    assert pairs.passed
    growing = LinearModel(A=np.diag([-4.0, 2.0]), B=np.ones((2, 1)))
    (pole,) = bodies.own_structure("b", growing, (0.0, 1.0))
    # 2 1/s is slower than the band's end of 1 Hz, which it is then measured by
    assert (pole.value, pole.passed) == (pytest.approx(1 / np.pi), False)
    (pole,) = bodies.own_structure("b", growing, (0.0, 0.1))  # and faster than 0.1 Hz
    assert (pole.value, pole.passed) == (1.0, False)
    definite = LinearModel(A=np.array([[-1.0, 100.0], [-100.0, -1.0]]), B=np.ones((2, 1)))
    (pole,) = bodies.own_structure("b", definite, (0.0, 1.0))
    assert (pole.value, pole.passed) == (0.0, True)  # A + A^T < 0 shows it without poles
    slow = LinearModel(A=np.array([[-1.0, 400.0], [-25.0, -1.0]]), B=np.ones((2, 1)))
    (pole,) = bodies.own_structure("b", slow, (0.0, 1.0))
    assert pole.value == pytest.approx(-0.01, rel=1e-3)
    assert pole.limit == 1e-9
    signals = bodies.own_structure("b", body(["u1", "y1"]), (0.0, 200.0))
    assert len(signals) == 1


@pytest.mark.parametrize("hertz", [1e-9, 1.0, 1e9])
@pytest.mark.parametrize(("turn", "power"), [(-0.1j, 0.0), (0.1j, 0.1 / abs(1 + 0.1j))])
def test_power_that_is_given_is_a_share_at_any_frequency(hertz, turn, power):
    """``Re (s H)`` of ``H = 1 + j a`` is ``-a`` of ``|s H|``; the scale of H does not matter."""
    H = np.full((2, 1, 1), 1e-12 * (1 + turn))
    (found,) = bodies.structure("x", np.array([0.5, 1.0]) * hertz, H, 1e-9)
    assert found.name == "x, active power over all frequencies"
    assert found.value == pytest.approx(power, abs=1e-12)


def test_frequencies_of_a_sample_begin_with_the_resonances():
    at = bodies._sampled(body(["tip"], (10.0, 70.0, 300.0)), (0.0, 200.0))
    np.testing.assert_allclose(sorted(at[:2]), [10.0, 70.0], rtol=1e-3)
    assert at.size == np.unique(at).size > 200
    assert at.min() > 0
    assert all(float(f"{f:.4g}") == f for f in at)


@pytest.mark.parametrize("count", [1, 2, 3, 5, 29, 30, 31])
def test_a_sample_is_as_large_as_asked(count):
    at = np.random.default_rng(0).permutation(np.linspace(1.0, 150.0, 30))
    found = bodies._first(body(["tip", "turn"]), at, count)
    assert found.size <= min(count, 30)
    assert (np.diff(found) > 0).all()
    peak = at[np.abs(at - 100.0).argmin()], at[np.abs(at - 10.0).argmin()]
    assert set(found) & set(peak)
    if count >= 30:
        np.testing.assert_array_equal(found, np.sort(at))
    if count == 5:  # three of the tallest, two spread over all
        assert np.abs(found - 50.0).min() < 20 or np.abs(found - 75.0).min() < 30


def test_mass_that_a_pin_moves_is_the_bodys_or_its_states():
    """``y'' = C B a`` far above all resonances, with unit masses."""
    rom = body(["base", "tip"])
    gain = rom.B[:, 0]
    assert bodies.reaction_mass(rom, PORTS["base"]) == pytest.approx(gain @ gain, rel=1e-9)
    known = body(["base", "tip"], facts={"mass_kg": 7.0})
    assert bodies.reaction_mass(known, PORTS["base"]) == 7.0


NAMES = ["tip", "turn", "anode", "base", "u1", "y1"]
LIBRARY = Subcircuit(
    "B_1a",
    tuple(Pin(n, "1", "-") for n in
          ("tip", "turn", "ANODE", "anode_ret", "base", "u1", "y1", "extra")),
    (), ".subckt b\n.ends\n",
)  # fmt: skip


PART = SimpleNamespace(name="b")


# ----------------------------------------------------------------------------- circuits of laws

LADDER = {
    "name": "ladder",
    "amp": {"part": "source", "dc": 6.0, "ac": 2.0, "pins": {"out": "top.a"}},
    "top": {"part": "resistor", "resistance": 100.0},
    "low": {"part": "resistor", "resistance": 200.0, "pins": {"a": "top.b"}},
    "store": {"part": "capacitor", "capacitance": 1e-6, "pins": {"a": "top.b"}},
    "own": {"part": "source", "dc": 3.0, "pins": {"out": "load.a"}},
    "load": {"part": "resistor", "resistance": 10.0},
}


def built(**more):
    return build_models(load_scene(LADDER | more), Clock(silent))


def test_an_operating_point_is_kirchhoffs():
    build = built(analysis={"type": "op"})
    found = circuit.solve(build, Waveforms({"sweep": np.zeros(1)}, {}))
    assert found.imbalance is None
    results = found.results
    np.testing.assert_allclose(results["store.v"], 4.0)
    np.testing.assert_allclose(results["load.v"], 3.0)
    assert next(iter(results.data)) == "sweep"


def test_small_signals_are_those_of_the_divider():
    build = built(analysis={"type": "ac", "start": 10.0, "stop": 1e5, "points": 3})
    frequency = np.array([10.0, 1e3, 1e5])
    found = circuit.solve(build, Waveforms({"frequency": frequency + 0j}, {})).results
    parallel = 1 / (1 / 200 + 2j * np.pi * frequency * 1e-6)
    np.testing.assert_allclose(found["store.v"], 2 * parallel / (100 + parallel), rtol=1e-9)
    np.testing.assert_allclose(found["load.v"], 0.0, atol=1e-15)  # no constant part


def test_a_sweep_moves_its_own_circuit_alone():
    build = built(analysis={"type": "dc", "sweep": "amp.dc", "from": 0.0, "to": 9.0, "points": 4})
    found = circuit.solve(build, Waveforms({"sweep": np.arange(4.0)}, {})).results
    np.testing.assert_allclose(found["store.v"], [0.0, 2.0, 4.0, 6.0], atol=1e-12)
    np.testing.assert_allclose(found["load.v"], 3.0)


def test_a_transient_is_read_at_its_own_points_up_to_the_end():
    """A divider that charges: ``v = 4 (1 - exp(-t / T))``, T = 1 uF x 66.7 Ohm."""
    amp = {"part": "source", "pwl": [[0, 0], [1e-12, 6], [1, 6]], "pins": {"out": "top.a"}}
    build = built(amp=amp, solver={"stop": "0.2 ms"})
    times = np.array([0.0, 1e-4, 5e-5, 1e-4, 2e-4 + 1e-12])
    found = circuit.solve(build, Waveforms({"time": times}, {}))
    t = found.results["time"]
    assert (np.diff(t) > 0).all()
    assert t[-1] == 2e-4
    assert {5e-5, 1e-4} <= set(t)
    exact = 4 * (1 - np.exp(-t / (1e-6 * 200 / 3)))
    np.testing.assert_allclose(found.results["store.v"], exact, atol=1e-6)
    assert 0 <= found.imbalance < 1e-6


def test_circuits_share_ground_alone():
    found = circuit.circuits(built())
    names = sorted(sorted(law.name for law in each.laws) for each in found)
    assert [len(each) for each in names] == [4, 2]
    for each in found:
        own = {law.name for law in each.laws}
        assert {pin.partition(".")[0] for pins in each.joins.values() for pin in pins} <= own
        assert {circuit._owner(reading) for reading in each.readings.values()} <= own
        assert all(law in own for law, _ in each.sweeps)


def test_an_imbalance_is_a_share_of_all_that_was_turned_over():
    def runs(*books):
        kept = [SimpleNamespace(turnover=t, residual=r) for t, r in books]
        return [SimpleNamespace(energy=book) for book in kept]

    assert circuit._imbalance(runs((2.0, -1e-3), (3.0, 2e-3))) == pytest.approx(6e-4)
    assert circuit._imbalance(runs((0.0, 0.0))) is None
    assert circuit._imbalance([]) is None


def test_nets_that_share_a_pin_of_a_law_are_one():
    """Two nets of the scene on one pin of a law; another that a law ties to ground."""
    nets = {("a", "p"): "1", ("a", "q"): "2", ("b", "p"): "2", ("b", "g"): "0", ("c", "g"): "0",
            ("d", "p"): "3", ("e", "p"): "3", ("f", "p"): "4"}  # fmt: skip
    found = {
        "a": Equations(pins=(("p", "x.a"), ("q", "x.a"))),
        "b": Equations(pins=(("p", "y.a"), ("g", "y.b"))),
        "c": Equations(pins=(("g", "z.b"),), nets=(("z.a", "w.a"),)),
        "d": Equations(pins=(("p", "y.b"),)), "e": Equations(pins=(("p", "v.a"),)),
        "f": Equations(pins=(("p", "u.a"),)),
    }  # fmt: skip
    build = SimpleNamespace(scene=SimpleNamespace(nets=nets))
    assert circuit._joins(build, found) == {
        "n0": ("w.a", "z.a"), "n1": ("x.a", "y.a"), "gnd": ("v.a", "y.b", "z.b"),
    }  # fmt: skip
    held = circuit._joins(build, found, {"4": Source("net_4", "voltage", None)})
    assert held["n0"] == ("net_4.out", "u.a")


def test_what_was_recorded_is_replayed_in_steps_that_are_more_than_rounding():
    times = np.array([0.0, 0.5e-6, 1e-6, 1e-6 + 1e-13, 0.5, 1.0])
    waves = Waveforms({"time": times, "net a": np.array([1.0, 9.0, 2.0, 9.0, 3.0, 4.0])}, {})
    source = circuit._replayed("a", "displacement", waves)
    assert (source.name, source.kind) == ("net a", "displacement")
    assert source.wave.times.tolist() == [0.0, 1e-6, 0.5, 1.0]
    assert source.wave.values.tolist() == [1.0, 2.0, 3.0, 4.0]
    nets = circuit.taken_vectors({"a": "displacement", "b": "electrical", "c": "signal"})
    assert nets == {"net a": ("v(a)", 1e-6), "net b": ("v(b)", 1.0), "net c": ("v(c)", 1.0)}


def test_a_circuit_is_given_where_sources_hold_all_its_nets():
    def of(*laws, **joins):
        return circuit.Circuit(laws, joins, {}, {})

    one = Source("net_a", "voltage", None)
    both = {"n0": ("net_a.out", "r.a"), "gnd": ("r.b",)}
    assert of(one, **both).given({"net_a.out"})
    assert not of(one, **both).given(set())
    assert not of(one, **both, n1=("c.a", "r.c")).given({"net_a.out"})
    body_ = object.__new__(LinearBody)
    assert not of(one, body_, **both).given({"net_a.out"})


@pytest.mark.parametrize(
    ("kind", "holds"),
    [("voltage", True), ("displacement", True), ("signal", True), ("current", False),
     ("force", False)],
)  # fmt: skip
def test_a_source_holds_its_net_unless_it_drives_a_flow(kind, holds):
    laws = {"s": Source("s", "".join(list(kind)), None)}
    assert circuit._holds(laws, "s.out") is holds
    assert not circuit._holds(laws, "s.ret")


SHUT = (("a",), np.ones(1), np.zeros(1))


class Driving(Contact):
    """A device that puts out a signal."""

    drives = ("out",)


@pytest.mark.parametrize(
    ("law", "holds"),
    [(SignalBlock("s", *[None] * 5, ("a",), ("out",)), True), (Sensor("s"), True),
     (Driving("s", *SHUT), True), (Contact("s", *SHUT), False)],
)  # fmt: skip
def test_what_puts_out_a_signal_holds_its_net(law, holds):
    assert circuit._holds({"s": law}, "s.out") is holds
    assert not circuit._holds({"s": law}, "s.a")


def test_a_reading_is_a_sum_with_a_constant_or_a_charge():
    readings = {
        "u": Reading(((2.0, "a"), (-1.0, "b")), 0.5), "q": Reading(((1.0, "a"),), 0.5, charge=True),
        "none": Reading(((1.0, "a"), (1.0, "absent"))),
    }  # fmt: skip
    own = circuit.Circuit((), {}, readings, {})
    waves = {"a": np.array([1.0, 3.0]), "b": np.array([1.0, 1.0])}
    scale = np.array([1.0, 2.0])
    found = circuit.read(own, waves, scale)
    assert {k: v.tolist() for k, v in found.items()} == {"u": [1.5, 5.5], "q": [1.5, 3.5]}
    small = circuit.read(own, {k: v + 0j for k, v in waves.items()}, scale)
    np.testing.assert_allclose(small["u"], [1.0, 5.0])
    np.testing.assert_allclose(small["q"], np.array([1.0, 3.0]) / (2j * np.pi * scale))


# ------------------------------------------------------------------- parts that have no law

FILTER = "* a filter of somebody's\n.subckt rc in out\nR1 in out 1k\nC1 out 0 1n\n.ends\n"
FILTERED = {
    "name": "filtered",
    "amp": {"part": "source", "pwl": [[0, 0], [1e-4, 6]], "pins": {"out": "rc.in"}},
    "rc": {"part": "netlist", "file": "rc.lib", "subckt": "rc"},
    "r": {"part": "resistor", "resistance": 100.0, "pins": {"a": "rc.out"}},
    "c": {"part": "capacitor", "capacitance": 1e-7, "pins": {"a": "r.b"}},
    "solver": {"stop": 1e-4},
}


@pytest.fixture
def filtered(tmp_path, monkeypatch):
    """A scene with a subcircuit of the user's own between a source and a load."""
    (tmp_path / "rc.lib").write_text(FILTER)
    monkeypatch.chdir(tmp_path)

    def make(**more):
        tables = {k: v for k, v in (FILTERED | more).items() if v is not None}
        return build_models(load_scene(tables), Clock(silent))

    return make


def test_nets_where_a_part_without_law_meets_others_are_taken(filtered):
    build = filtered()
    assert circuit.without_law(build) == ("rc",)
    net = build.net(build.scene.parts["r"], "a")
    assert circuit.taken_nets(build) == {net: "electrical"}  # the amplifier holds its own
    weak = FILTERED["amp"] | {"kind": "current"}
    both = circuit.taken_nets(filtered(amp=weak))
    assert sorted(both.values()) == ["electrical", "electrical"]
    assert net in both


def test_the_others_are_given_what_ngspice_has_there(filtered):
    """A ramp into R and C: ``v = k (t - T (1 - exp(-t / T)))``."""
    build = filtered()
    ((net, kind),) = circuit.taken_nets(build).items()
    t = np.linspace(0.0, 1e-4, 41)
    waves = Waveforms({"time": t, f"net {net}": 4e4 * t}, {})
    found = circuit.solve(build, waves, {net: kind})
    T, s = 1e-5, found.results["time"]
    exact = 4e4 * (s - T * (1 - np.exp(-s / T)))
    np.testing.assert_allclose(found.results["c.v"], exact, atol=1e-5)
    assert found.imbalance < 1e-5
    bare = filtered(c=None, r=FILTERED["r"] | {"pins": {"a": "rc.out", "b": "gnd"}})
    given = circuit.solve(bare, waves, {net: kind})  # nothing is left to integrate
    assert given.imbalance is None
    assert list(given.results.data) == ["time"]
