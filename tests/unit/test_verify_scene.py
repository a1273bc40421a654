"""What ``verify`` looks at in a scene and in each body, on solutions made by hand."""

import importlib
import json
from types import SimpleNamespace

import numpy as np
import pytest

from kc2spice.core.errors import UsageError
from kc2spice.core.laws import (
    Diode,
    Equations,
    LinearBody,
    Reading,
    Sensor,
    SignalBlock,
    Source,
)
from kc2spice.core.progress import Clock, silent
from kc2spice.core.waveforms import Waveforms
from kc2spice.rom.linear import Certificate, LinearModel, Port
from kc2spice.scene.gates import Cost, Gate, Limit
from kc2spice.scene.judge import Check, Verdict
from kc2spice.scene.load import load_scene
from kc2spice.spice.circuit import Pin, Subcircuit
from kc2spice.spice.deck import Block, Deck, Option
from kc2spice.spice.realize import LEAK
from kc2spice.workflow.models import build_models
from kc2spice.workflow.verify import bodies, circuit
from kc2spice.workflow.verify.compare import OutputError, Solution, solution

module = importlib.import_module("kc2spice.workflow.verify.verify")
TIME = np.array([0.0, 1.0])


def part(reduced=False, gates=()):
    own = {"reduced": reduced, "gates": lambda *_: gates, "metrics": lambda *_: {}}
    return SimpleNamespace(type=SimpleNamespace(**own))


@pytest.fixture
def under_way(monkeypatch):
    """A verification of a scene that is not run, by the keys that it asks for."""
    monkeypatch.setattr(module, "make_deck", lambda build: Deck(name="d"))

    def make(parts=None, *, kind="transient", metrics=None, waves=None, taken=(), **solver):
        solver = SimpleNamespace(**{"reltol": 1e-3, "ringing": None} | solver)
        gates = SimpleNamespace(metrics=metrics, waves=waves)
        scene = SimpleNamespace(
            parts=parts or {}, gates=gates, solver=solver, name="s",
            analysis=SimpleNamespace(type="".join(list(kind)), points=4),
        )  # fmt: skip
        build = SimpleNamespace(scene=scene, model=lambda name: scene.models[name])
        return module._Verification(build, None, None, False, None, taken=dict.fromkeys(taken, "x"))

    return make


def generic(way, ours, exact, outputs=()):
    solutions = (Solution(Waveforms({"time": TIME}, {}), each) for each in (ours, exact))
    return list(way._generic(way.build, *solutions, outputs))


def off(name, rms):
    return OutputError("ngspice_vs_rom", name, 9.0, rms)


@pytest.mark.parametrize(
    ("ringing", "worst"),
    [("followed", "chip.u"), (None, "chip.u"), ("".join(["coa", "rse"]), "chip2.u")],
)  # fmt: skip
def test_waves_of_a_body_that_is_coarse_by_choice_are_left_out(under_way, ringing, worst):
    """Its own and its drive's; not of a part whose name begins alike, nor of what it moves."""
    parts = {"chip": part(reduced=True), "ball": part(), "chip2": part()}
    errors = {"chip.u": 0.9, "chip_drive.v": 0.8, "chip2.u": 0.3, "ball.y": 0.2}
    outputs = [off(name, rms) for name, rms in errors.items()]
    (limit,) = generic(under_way(parts, ringing=ringing), {}, {}, outputs)
    assert limit.name == f"every wave (rms), worst {worst}, ngspice to laws"
    assert limit.value == errors[worst]
    alone = under_way({"chip": part(reduced=True)}, ringing="coarse")
    assert generic(alone, {}, {}, outputs[:2]) == []


@pytest.mark.parametrize(
    ("keys", "metric", "wave"),
    [
        ({}, 1e-2, 0.2), ({"reltol": 1e-5}, 1e-4, 2e-3), ({"kind": "ac"}, 5e-9, 3e-8),
        ({"metrics": 0.5, "waves": 0.25}, 0.5, 0.25), ({"taken": ["net"]}, 5e-2, 0.2),
    ],
)  # fmt: skip
def test_gates_follow_the_tolerance_of_the_steps(under_way, keys, metric, wave):
    found = generic(
        under_way(**keys), {"a": 1.02, "b": 5.0}, {"a": 1.0, "b": 4.0}, [off("a.v", 0.1)]
    )
    assert [(each.value, each.limit) for each in found] == [
        (pytest.approx(0.25), pytest.approx(metric)), (0.1, pytest.approx(wave)),
    ]  # fmt: skip
    assert found[0].name == "every metric, worst b, ngspice to laws"


def test_a_metric_that_one_solution_reaches_is_missed(under_way):
    found = generic(under_way(), {"a": None, "b": 1.0}, {"a": 1.0, "b": 1.0})
    assert [(each.name, each.value) for each in found] == [
        ("metric a, reached by one of both", None), ("every metric, worst b, ngspice to laws", 0.0),
    ]  # fmt: skip
    assert generic(under_way(), {}, {}) == []


def test_a_solution_has_the_metrics_that_its_waves_tell():
    def lost(*_):
        raise KeyError("ball.y")

    kinds = {"a": lambda *_: {"x": 1}, "b": lost, "c": lambda *_: {"y": 2}}
    parts = {k: SimpleNamespace(type=SimpleNamespace(metrics=each)) for k, each in kinds.items()}
    waves = Waveforms({"time": TIME}, {})
    found = solution(waves, SimpleNamespace(scene=SimpleNamespace(parts=parts)))
    assert found == Solution(waves, {"x": 1, "y": 2})


def pair(way, name, everything=True):
    exact = Solution(
        Waveforms({"time": TIME, "u": np.array([1.0, 2.0]), "v": 1 + TIME}, {}), {"m": 2.0}
    )
    ours = Solution(
        Waveforms({"time": TIME, "u": np.array([1.0, 2.2]), "v": 1 + TIME}, {}), {"m": 2.1}
    )
    way._pair(name, way.build, ours, exact, " of a piece", everything)


def test_a_pair_is_judged_by_gates_of_its_own_and_by_every_wave(under_way):
    way = under_way()
    pair(way, "ngspice_vs_rom")
    assert [c.name.split(",")[0] for c in way.checks] == ["every metric", "every wave (rms)"]
    assert {o.output for o in way.outputs} == {"u", "v"}
    assert way.errors == {"ngspice_vs_rom": max(o.rms for o in way.outputs)}
    for name, everything in (("rom_vs_fom", True), ("ngspice_vs_rom", False)):
        way = under_way()
        pair(way, name, everything)
        assert way.checks == []
    gates = [Gate("m", "m", {"rom_vs_fom": 1e-3}, leads=True), Gate("u", "u", {"rom_vs_fom": 1.0})]
    way = under_way({"a": part(gates=gates)})
    pair(way, "rom_vs_fom")
    assert [(c.name, c.passed) for c in way.checks] == [
        ("m of a piece, ROM to full model", False), ("u of a piece, ROM to full model", True),
    ]  # fmt: skip
    assert way.errors == {"rom_vs_fom": pytest.approx(0.05)}


def test_physics_of_the_netlists_run_that_fail_a_run_are_gates(under_way, monkeypatch):
    checks = (Check("energy", 2.0, 1.0, "J", ""), Check("told", 2.0, 1.0, "m", "", "warn"),
              Check("jump of y", 0.5, 1.0, "m", "", "warn"))  # fmt: skip
    monkeypatch.setattr(module, "verdict", lambda *_: Verdict(checks))
    way = under_way()
    way._own_checks(way.build, None)
    assert way.checks == [
        Limit("energy, ngspice", 2.0, 1.0, "J"), Limit("jump of y, ngspice", 0.5, 1.0, "m"),
    ]  # fmt: skip


def test_a_shipped_deck_keeps_its_own_text_and_the_scenes_names(under_way, monkeypatch):
    emitted = Deck(
        name="own", parts=(Subcircuit("a", (), (), ""),), options=(Option("x", "1", ""),),
        blocks=(Block("b", ("R1 a 0 1",)),), vectors={"u": ("v(a)", 1.0)}, stop=2.0,
    )  # fmt: skip
    monkeypatch.setattr(module, "make_deck", lambda build: emitted)
    way = under_way()
    assert way._deck(way.build, None) is emitted
    shipped = Deck(
        name="s", text="* s\n.end\n", more={"a.lib": "* a\n"}, vectors={"w": ("v(w)", 1.0)}
    )
    found = way._deck(way.build, shipped)
    assert found.files == {"s.cir": shipped.text, "a.lib": "* a\n"}
    assert (found.vectors, found.stop) == (emitted.vectors, 2.0)
    assert (found.parts, found.blocks, found.options) == ((), (), ())


def test_each_reduced_body_is_verified_by_itself(under_way, monkeypatch, tmp_path):
    asked = []

    def verified(part, build, libraries, clock, work, whole, gate):
        asked.append((part.name, libraries, work, whole, gate))
        limit, cost = Limit(part.name, 1.0, 2.0), Cost(part.name, 1.0)
        return module.BodyFindings(part.name, (limit,), {}, (cost,), {"x": part.name}, ("note",))

    monkeypatch.setattr(module, "verify_body", verified)
    monkeypatch.setattr(module, "responses", lambda name, curves: [(name, curves)])
    way = under_way({n: part(reduced=n != "ball") for n in ("chip", "ball", "disc")})
    for name, each in way.build.scene.parts.items():
        each.name = name
    way.build.scene.gates.harmonic_ngspice = 3e-9
    way.work, way.whole = tmp_path, True
    found = way._bodies(("libraries",))
    assert [body.name for body in found] == ["chip", "disc"]
    assert asked == [(n, ("libraries",), tmp_path / n, True, 3e-9) for n in ("chip", "disc")]
    assert way.checks == [Limit("chip", 1.0, 2.0), Limit("disc", 1.0, 2.0)]
    assert [cost.name for cost in way.costs] == ["chip", "disc"]
    assert way.notes == ["note", "note"]
    assert way.figures == [("chip", {"x": "chip"}), ("disc", {"x": "disc"})]


def test_the_full_model_is_told_with_what_it_costs(under_way):
    way = under_way()
    found = module.FullSolution(
        None,
        None,
        3.0,
        " of a piece",
        {"low_rank": 6.0},
        (Limit("a", 1.0, 2.0),),
        {"m": 1},
        ("note",),
    )
    way._told(found, 0.5)
    assert way.speedup == {"low_rank": 12.0}
    assert way.costs == [Cost("full model of a piece", 3.0), Cost("full model, low rank", 6.0)]
    assert (way.checks, way.metrics, way.notes) == ([Limit("a", 1.0, 2.0)], {"m": 1}, ["note"])


@pytest.mark.parametrize("kind", ["transient", "dc"])
def test_the_summary_has_the_bodies_errors_where_the_scene_has_none(under_way, kind):
    body = SimpleNamespace(name="chip", errors={"rom_vs_fom": 1e-5, "ngspice_vs_rom": 1e-9})
    other = SimpleNamespace(name="disc", errors={"ngspice_vs_rom": 3e-9})
    for told in ([body], [other, body]):
        way = under_way(kind=kind)
        facts = {"unknowns": 12.0} if len(told) == 1 else {}
        way.build.scene.models = {"chip": SimpleNamespace(order=7, facts=facts)}
        way.errors = {"rom_vs_fom": 0.5} if len(told) == 2 else {}
        way._summary(told, 2.0)
        expected = {"simulate_wall_s": 2.0, "rom_wall_s": 2.0}
        expected |= {"rom_step_wall_s": 0.5} if kind == "dc" else {}
        if len(told) == 1:
            assert way.errors == {"rom_vs_fom": 1e-5, "ngspice_vs_rom": 1e-9}
            expected |= {"rom_error": 1e-5, "rom_order": 7, "unknowns": 12.0}
        else:
            assert way.errors == {"rom_vs_fom": 0.5, "ngspice_vs_rom": 3e-9}
            expected |= {"rom_error": 0.5}
        assert way.metrics == expected
    way = under_way(kind=kind)
    way.build.scene.models = {"disc": SimpleNamespace(order=7, facts={})}
    way._summary([other], 2.0)
    assert "rom_error" not in way.metrics
    assert "unknowns" not in way.metrics
    assert way.metrics["rom_order"] == 7


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
    assert (pole.name, pole.limit) == ("b: ROM, rightmost pole over its frequency", 0.0)
    assert pole.value == pytest.approx(-0.01)
    assert power.passed
    assert pairs.passed
    growing = LinearModel(A=np.diag([-4.0, 2.0]), B=np.ones((2, 1)))
    (pole,) = bodies.own_structure("b", growing, (0.0, 1.0))
    assert (pole.value, pole.passed) == (1.0, False)
    slow = LinearModel(A=np.array([[-1.0, 100.0], [-100.0, -1.0]]), B=np.ones((2, 1)))
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


def asked(rom, **more):
    return SimpleNamespace(libraries={"b": "b"}, model=lambda _: rom, **more)


PART = SimpleNamespace(name="b")


def test_one_copy_of_the_subcircuit_is_loaded_at_each_port():
    rom = body(NAMES)
    deck = bodies._deck(PART, asked(rom), [Subcircuit("ab", (), (), ""), LIBRARY], (0.0, 240.0))
    assert [b.title for b in deck.blocks] == [f"load on {n}" for n in NAMES[:-1]]
    assert deck.command.words[:2] == ("lin", "120")
    assert [float(word) for word in deck.command.words[2:]] == [2.0, 240.0]
    tip, turn, anode, base, u1 = (b.cards for b in deck.blocks)
    nodes = "n0_0 n1_0 n2_0 n3_0 n4_0 n5_0 n6_0 0"
    assert tip[0] == f"Xbody0 {nodes} B_1a"
    held = [
        "Vret_n3_0 n3_0 0 0",
        "V2_0 n2_0 n3_0 DC 0 AC 0",
        "V3_0 n4_0 0 DC 0 AC 0",
        "V4_0 n5_0 0 DC 0 AC 0",
    ]
    assert set(tip[1:]) == {*held, "I0_0 0 n0_0 DC 0 AC 1", "R5_0 n6_0 0 1e9"}
    assert "I1_1 0 n1_1 DC 0 AC 1" in turn
    assert not any(card.startswith("I0") for card in turn)
    assert "V2_2 n2_2 n3_2 DC 0 AC 1" in anode
    assert "V3_3 n4_3 0 DC 0 AC 1" in base
    assert "V4_4 n5_4 0 DC 0 AC 1" in u1
    assert deck.vectors["tip>tip"] == ("v(n0_0)", 1e-6)
    assert deck.vectors["tip>turn"] == ("v(n1_0)", 1.0)
    assert deck.vectors["turn>anode"] == ("i(v2_1)", -1.0)
    assert deck.vectors["anode>base"] == ("i(v3_2)", -1.0)
    assert deck.vectors["u1>y1"] == ("v(n6_4)", 1.0)
    assert len(deck.vectors) == 5 * 5


@pytest.mark.parametrize("name", ["bb", "b_xyz", "ab", "b_"])
def test_a_deck_without_the_parts_subcircuit_is_refused(name):
    with pytest.raises(UsageError, match="no subcircuit of this part"):
        bodies._deck(PART, asked(body(["tip"])), [Subcircuit(name, (), (), "")], (0.0, 1.0))


def answered(rom, frequency):
    """What pins carry where the netlist answers as ``rom``: currents of electrodes, the force that
    a moved pin draws, ``m a - s^2 y``."""
    s = 2j * np.pi * frequency
    H = rom.transfer(frequency)
    data = {"frequency": frequency + 0j}
    for i, load in enumerate(rom.inputs):
        for o, output in enumerate(rom.outputs):
            h = H[:, o, i]
            if KINDS[output] == "electrical":
                h = s * h
            if KINDS[output] == "acceleration":
                mass = rom.C[o] @ rom.B[:, i] if load == output else 0.0
                h = mass - s**2 * h
            data[f"{load}>{output}"] = h
    return Waveforms(data, {"accepted": 3.0})


def test_answers_of_the_netlist_are_those_of_the_model_in_si(monkeypatch, tmp_path):
    rom = body(NAMES)
    frequency = np.array([3.0, 60.0, 200.0])
    monkeypatch.setattr(bodies, "run_deck", lambda deck, work: answered(rom, frequency))
    waves, spent = bodies.netlist_response(
        PART, asked(rom), [LIBRARY], Clock(silent), tmp_path, (0.0, 200.0)
    )
    np.testing.assert_allclose(bodies._matrix(waves, rom), rom.transfer(frequency), rtol=1e-9)
    assert waves.stats == {"accepted": 3.0}
    assert 0 <= spent < 10


@pytest.mark.parametrize("whole", [False, True])
@pytest.mark.parametrize("wrong", ["nothing", "full", "netlist"])
def test_a_body_is_compared_with_its_full_model_and_its_netlist(
    wrong, whole, monkeypatch, tmp_path
):
    rom = body(["tip", "anode"])
    solved = []

    def exact(at):
        solved.append(at)
        return rom.transfer(at) * (1 + 2e-5 * (wrong == "full"))

    large = SimpleNamespace(order=5000, transfer=exact, inputs=rom.inputs, outputs=rom.outputs)
    kind = SimpleNamespace(full_model=lambda *_: large, model_key=lambda *_: {"rom": 1, "k": 2},
                           sources=lambda: ())  # fmt: skip
    own = SimpleNamespace(name="b", type=kind)
    frequency = np.linspace(200.0 / 120, 200.0, 120)

    def run(deck, work):
        waves = answered(rom, frequency)
        if wrong == "netlist":
            waves.data["tip>tip"] *= 1 + 1e-3
        return waves

    monkeypatch.setattr(bodies, "run_deck", run)
    monkeypatch.setattr(bodies, "cached", lambda name, key, solve, sources: (solve(), False))
    found = bodies.verify_body(
        own, asked(rom, scene=None), [LIBRARY], Clock(silent), tmp_path, whole, 5e-9
    )
    assert 35 <= solved[0].size <= 40 if whole else solved[0].size == 3
    checks = {c.name: c for c in found.checks}
    first = checks[f"b: ROM to full model, at {solved[0].size} frequencies with its resonances"]
    assert first.limit == 1e-5
    assert first.passed is (wrong != "full")
    netlist = checks["b: netlist to ROM, all ports"]
    assert netlist.passed is (wrong != "netlist")
    leaked = 2 * LEAK / (2 * np.pi * frequency[0] * 2e-9)
    assert netlist.limit == pytest.approx(max(5e-9, leaked))
    assert checks["b: netlist, reciprocity"].limit == pytest.approx(max(1e-9, leaked))
    assert {c.name for c in found.checks if not c.passed} <= {
        first.name,
        netlist.name,
        "b: netlist, x",
    }
    assert [cost.name for cost in found.costs] == [
        "b: full model, per frequency",
        "b: netlist, 120 frequencies",
    ]
    assert set(found.curves) == {"b: full model", "b: netlist, ngspice"}
    np.testing.assert_array_equal(found.curves["b: full model"]["frequency"], solved[0])
    np.testing.assert_allclose(
        found.curves["b: full model"]["anode>tip"], exact(solved[0])[:, 0, 1]
    )
    assert found.notes == ()
    kind.full_model = lambda *_: None
    alone = bodies.verify_body(
        own, asked(rom, scene=None), [LIBRARY], Clock(silent), tmp_path, whole, 5e-9
    )
    assert set(alone.errors) == {"ngspice_vs_rom"}
    assert alone.notes == ("b: no full model here; its reduced model is taken as it is",)


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
    assert (source.name, source.kind) == ("net_a", "displacement")
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


class Driving(Diode):
    """A device that puts out a signal."""

    drives = ("out",)


@pytest.mark.parametrize(
    ("law", "holds"),
    [(SignalBlock("s", *[None] * 5, ("a",), ("out",)), True), (Sensor("s"), True),
     (Driving("s"), True), (Diode("s"), False)],
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
    found = circuit._read(own, waves, scale)
    assert {k: v.tolist() for k, v in found.items()} == {"u": [1.5, 5.5], "q": [1.5, 3.5]}
    small = circuit._read(own, {k: v + 0j for k, v in waves.items()}, scale)
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


@pytest.mark.parametrize("coils", [False, True])
@pytest.mark.parametrize("elastic", [False, True])
def test_coils_that_follow_an_elastic_body_are_not_given(coils, elastic, filtered, monkeypatch):
    """Their flux makes every step of its ringing one of Newton's method."""
    build, known = filtered(), circuit._equations
    shape = object.__new__(LinearBody)
    shape.__dict__.update(name="shape", ports=())
    more = (shape,) * elastic + (Diode("stands for a coil"),) * coils
    monkeypatch.setattr(circuit, "_equations", lambda b: known(b) | {"more": Equations(more)})
    monkeypatch.setattr(circuit, "has_store", lambda law: True)
    assert (circuit.taken_nets(build) is None) is (coils and elastic)


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


@pytest.mark.parametrize("analysis", ["transient", "op"])
def test_what_is_left_out_is_told(filtered, analysis, monkeypatch, tmp_path):
    build = filtered(**({"analysis": {"type": "op"}} if analysis == "op" else {}))
    net = build.net(build.scene.parts["r"], "a")
    t = np.linspace(0.0, 1e-4, 41)
    ran = []

    def run(deck, folder, progress):
        ran.append(deck)
        zero = dict.fromkeys(deck.vectors, 0 * t)
        given = {name: 4e4 * t for name in zero if name.startswith("net ")}
        return Waveforms({"time": t} | zero | given | {"c.v": -1.0 + 0 * t}, {})

    monkeypatch.setattr(module, "run_deck", run)
    found = module._Verification(build, Clock(silent), tmp_path, False, None).findings()
    (note,) = found.notes
    assert note.startswith("left out, for they have no law: rc; ")
    assert found.left_out == ("rc",)
    assert (f"net {net}" in ran[0].vectors) is (analysis == "transient")
    if analysis == "transient":
        assert note.endswith(f"on the nets where they meet them: {net}")
        assert any(check.name.startswith("every wave (rms), worst c.v") for check in found.checks)
        (energy,) = (c for c in found.checks if c.name == "energy of the reference integration")
        assert energy.limit == 1e-5  # recorded voltages are as good as their samples
        assert found.errors["ngspice_vs_rom"] > 0.9
        assert [cost.name for cost in found.costs] == [
            "laws, reference integrator",
            "netlist, ngspice",
        ]
    else:
        assert note.endswith("the scene as a whole is not compared, its bodies are")
        assert found.errors == {}
        assert found.costs == ()
    assert all(0 <= cost.wall_s < 60 for cost in found.costs)
    assert found.passed is not any(not check.passed for check in found.checks)


def test_a_scene_of_laws_is_compared_as_a_whole(monkeypatch, tmp_path):
    """Of a divider that charges, ngspice in place of which the closed form answers."""
    amp = {"part": "source", "pwl": [[0, 0], [1e-12, 6], [1, 6]], "pins": {"out": "top.a"}}
    build = built(amp=amp, solver={"stop": "0.2 ms"})
    t = np.linspace(0.0, 2e-4, 401)
    exact = 4 * (1 - np.exp(-t / (1e-6 * 200 / 3)))

    def run(deck, folder, progress):
        return Waveforms({"time": t, "store.v": exact, "load.v": 3 + 0 * t}, {})

    monkeypatch.setattr(module, "run_deck", run)
    found = module._Verification(build, Clock(silent), tmp_path, False, None).findings()
    assert (found.notes, found.left_out, found.shipped) == ((), (), False)
    (energy,) = (c for c in found.checks if c.name == "energy of the reference integration")
    assert energy.limit == build.scene.gates.energy
    assert energy.passed
    assert found.errors["ngspice_vs_rom"] < 1e-4
    assert {"store.v", "load.v"} == {o.output for o in found.outputs}


def test_a_full_solution_of_a_piece_is_compared_with_netlist_and_laws_of_the_piece(
    under_way, monkeypatch
):
    """Every pair has the wave's own error; the laws and the netlist of the piece are made anew."""
    way, piece = under_way({"a": part(), "b": part()}), under_way().build
    t = TIME
    solved = {"full": 1.0, "laws": 1.01, "ngspice": 1.03, "whole": 9.0}
    waves = {k: Waveforms({"time": t, "u": v + t}, {}) for k, v in solved.items()}
    told = module.FullSolution(waves["full"], piece, 3.0, " of a piece", {"refactor": 4.0})
    for name, found in (("a", None), ("b", told)):
        kind = way.build.scene.parts[name].type
        kind.full_solution = lambda *_, found=found: found
    asked = []
    monkeypatch.setattr(
        way,
        "_ngspice",
        lambda build, deck, folder: (asked.append((build, folder)) or waves["ngspice"], 2.0),
    )
    monkeypatch.setattr(
        way, "_reference", lambda build, _: (SimpleNamespace(results=waves["laws"]), 0.1)
    )
    monkeypatch.setattr(
        module, "comparison", lambda name, title, curves, units: [(name, title, sorted(curves))]
    )
    way._full(Solution(waves["whole"], {}), 0.5)
    assert asked == [(piece, "piece")]
    assert {o.pair: o.largest for o in way.outputs} == {
        "rom_vs_fom": pytest.approx(0.01 / 2), "ngspice_vs_rom": pytest.approx(0.02 / 2.01),
        "ngspice_vs_fom": pytest.approx(0.03 / 2),
    }  # fmt: skip
    assert set(way.errors) == {"rom_vs_fom", "ngspice_vs_rom", "ngspice_vs_fom"}
    assert way.checks == []
    assert way.speedup == {"refactor": 2.0}
    titles = [("full", "s of a piece", ["full model", "laws", "netlist, ngspice"])]
    assert way.figures == titles
    asked.clear()
    whole = under_way({"b": way.build.scene.parts["b"]})
    own = module.FullSolution(waves["full"], whole.build, 3.0, "", {"refactor": 4.0})
    whole.build.scene.parts["b"].type.full_solution = lambda *_: own
    monkeypatch.setattr(
        whole, "_reference", lambda build, _: (SimpleNamespace(results=waves["laws"]), 0.1)
    )
    whole._full(Solution(waves["whole"], {}), 0.5)
    assert asked == []
    assert {o.pair for o in whole.outputs} == {"rom_vs_fom", "ngspice_vs_fom"}
    assert whole.speedup == {"refactor": 8.0}


def test_the_first_part_with_a_mesh_study_has_its_table():
    table, asked = object(), []

    def study(found):
        return lambda *words: asked.append(words[3]) or found

    kinds = [
        SimpleNamespace(type=SimpleNamespace(mesh_study=study(f))) for f in (None, table, table)
    ]
    scene = SimpleNamespace(parts=dict(enumerate(kinds)), name="s")
    assert module._mesh_study(SimpleNamespace(scene=scene), None, True) == {"s": table}
    assert asked == [True, True]
    none = SimpleNamespace(scene=SimpleNamespace(parts={0: kinds[0]}, name="s"))
    assert module._mesh_study(none, None, False) == {}


@pytest.mark.parametrize(("meshes", "asked"), [(False, []), (True, ["a", "b"])])
def test_the_record_of_all_scenes_is_written_with_one_mesh_study(
    meshes, asked, monkeypatch, tmp_path
):
    """The first scene that has one; of two scenes one fails, and so do both together."""
    studied = []
    table = module.Table("t", ("h",), (("1",),), "note", ({"size": 1.0},))

    def study(build, clock, full):
        studied.append(build.scene.name)
        return {"b": table} if build.scene.name == "b" else {}

    def findings(way):
        limit = 1.0 if way.build.scene.name == "b" else 0.5
        return module.Findings((Limit("x", 0.7, limit),), {}, {}, (), {}, notes=("n",))

    monkeypatch.setattr(module, "find_ngspice", lambda: None)
    monkeypatch.setattr(
        module, "build_models", lambda scene, _, trust: SimpleNamespace(scene=scene)
    )
    monkeypatch.setattr(module, "_mesh_study", study)
    monkeypatch.setattr(module._Verification, "findings", findings)
    scenes = [SimpleNamespace(name=name) for name in "abc"]
    found = module.verify(scenes, tmp_path / "out", meshes=meshes)
    assert studied == asked
    assert [record["passed"] for record in found.values()] == [False, True, False]
    assert ("meshes" in found["b"]) is meshes
    written = json.loads((tmp_path / "out" / "verify.json").read_text())
    assert written["passed"] is False
    assert written["scenes"] == json.loads(json.dumps(found))
    assert found["a"]["checks"] == [
        {"name": "x", "value": 0.7, "limit": 0.5, "unit": "1", "passed": False}
    ]
    assert found["a"]["notes"] == ["n"]
    good = module.verify(scenes[1:2], tmp_path / "good", deck=Deck(name="d"))
    assert good["b"]["passed"]
    assert (studied, "meshes" in good["b"]) == (asked, False)  # not unless asked for
    assert json.loads((tmp_path / "good" / "verify.json").read_text())["passed"] is True
    assert (tmp_path / "good" / "verify.html").is_file()
