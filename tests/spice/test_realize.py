"""Subcircuits of small models with every kind of port, against their equations solved by numpy."""

import re

import numpy as np
import pytest
from device import bench

from kc2spice.core.errors import UsageError
from kc2spice.rom.blocks import BlockModel
from kc2spice.rom.linear import Certificate, LinearModel, Port
from kc2spice.rom.modal import Resonators
from kc2spice.sim.ngspice import run_deck
from kc2spice.spice.header import Header
from kc2spice.spice.realize import COARSE, FOLLOWED, STRIKING, _balanced, subcircuit

HEADER = Header("made up", "0")
FREQUENCY = "lin 6 150 1400"
DRIVE, SENSE, FLOATING, TIP, TWIST, SHAKE = range(6)
PORTS = (
    Port("drive", "".join(["electri", "cal"]), pins=("drive", "common")),
    Port("sense", "electrical", pins=("sense", "common")),
    Port("bare", "electrical", pins=("bare", "bare_ret")),  # no capacitance of its own
    Port("tip", "mechanical"),
    Port("twist", "rotational"),
    Port("shake", "acceleration"),
)
KNOWN_MASS = 2.0  # kg, of the whole body


def springs():
    """Three masses in a row, piezoelectric forces, a lever, a base that shakes: M, K, B, D."""
    M = np.diag([0.5, 0.3, 0.2])
    K = 4e6 * np.array([[2.0, -1, 0], [-1, 2, -1], [0, -1, 1]])
    B = np.zeros((3, 6))
    B[:, DRIVE] = [3.0, -3.0, 0.0]
    B[:, SENSE] = [0.0, 1.0, -1.0]
    B[:, FLOATING] = [0.5, 0.0, 0.7]
    B[:, TIP] = [0.0, 0.0, 1.0]
    B[:, TWIST] = [-20.0, 0.0, 20.0]
    B[:, SHAKE] = -np.diag(M)
    D = np.zeros((6, 6))
    D[DRIVE, DRIVE], D[SENSE, SENSE], D[DRIVE, SENSE] = 4e-8, 3e-8, -1e-8
    D[TIP, TIP], D[TWIST, TWIST], D[TIP, TWIST] = 2e-8, 8e-6, 1e-7
    D[DRIVE, TIP], D[SENSE, TWIST] = 3e-9, 5e-8
    return M, K, B, np.triu(D) + np.triu(D, 1).T


def answers(part, ports, tmp_path):
    """Ports' outputs per input in SI by ``.ac``: each port is driven in an instance of its own."""
    cards, vectors = [], {}
    for k, driven in enumerate(ports):
        nodes = {"base": "0", "common": "0", "bare_ret": "0"}
        for port in ports:
            node, on = f"{port.name}{k}", int(port is driven)
            nodes[port.terminals[0]] = node
            if port.kind in ("electrical", "acceleration"):
                cards.append(f"V{node} {node} 0 DC 0 AC {on}")
            elif on:
                cards.append(f"I{node} 0 {node} DC 0 AC 1")
            flow = (f"i(v{node})", -1.0)
            across = (f"v({node})", 1.0 if port.kind == "rotational" else 1e-6)
            voltage = port.kind in ("mechanical", "rotational")
            vectors[f"{driven.name}>{port.name}"] = across if voltage else flow
        cards.append(f"X{k} {' '.join(nodes[pin.name] for pin in part.pins)} {part.name}")
    return run_deck(bench([part], "\n".join([*cards, f".ac {FREQUENCY}"]), vectors), tmp_path)


@pytest.mark.parametrize("form", ["resonators", "blocks", "dense"])
@pytest.mark.parametrize("mass", [None, KNOWN_MASS])
def test_every_port_answers_every_other(form, mass, tmp_path):
    """``y = B' (s^2 M + s E + K)^-1 B u + D u``; a charge is seen as the current ``s y``, a
    frame's reaction is ``m a - y''``."""
    M, K, B, D = springs()
    E = 0.05 * K / 1e3 if form == "resonators" else 0.05 * K / 1e3 + np.diag([90.0, 0.0, 5.0])
    facts = {} if mass is None else {"mass_kg": mass}
    model = LinearModel(M=M, E=E, K=K, B=B, D=D, ports=PORTS, facts=facts)
    part = subcircuit(model, "zoo", HEADER, dense=form == "dense")
    assert ("\nCq1 " in part.text) == (form == "resonators")
    assert not re.search(r"(?m)^G.* -?0\.0$", part.text)
    waves = answers(part, PORTS, tmp_path)
    s = 2j * np.pi * waves["frequency"].real
    H = np.array([B.T @ np.linalg.solve(z * z * M + z * E + K, B) + D for z in s])
    rigid = B[:, SHAKE] @ np.linalg.solve(M, B[:, SHAKE]) if mass is None else mass
    for i, driven in enumerate(PORTS):
        for o, port in enumerate(PORTS):
            exact = H[:, o, i]
            if port.kind == "electrical":
                exact = s * exact
            if port.kind == "acceleration":
                exact = (rigid if driven is port else 0.0) - s**2 * exact
            error = np.abs(waves[f"{driven.name}>{port.name}"] - exact).max()
            assert error < 1e-6 * np.abs(exact).max() + 1e-11, (driven.name, port.name)


def test_the_zoo_is_drawn_as_written():
    """Pins in their order, labels by column, no cards for what is rounding."""
    M, K, B, D = springs()
    D[TIP, SENSE] = D[SENSE, TIP] = 1e-15 * D[SENSE, SENSE]
    model = LinearModel(M=M, E=1e-4 * K, K=K, B=B, D=D, ports=PORTS)
    part = subcircuit(model, "zoo")
    names = "drive common sense bare bare_ret tip twist shake base"
    assert [pin.name for pin in part.pins] == names.split()
    assert re.search(r"\* scene: model hash=[0-9a-f]{16}\n", part.text)
    direct = dict(re.findall(r"(?m)^G(?:t|c_)(\w+?_u\d+) \S+ \S+ \S+ \S+ (\S+)$", part.text))
    found = {label: float(value) for label, value in direct.items()}
    assert found == pytest.approx({
        "drive_u2": -1e-2, "drive_u4": 3e-3, "sense_u1": -1e-2, "sense_u5": 5e-2,
        "tip_u1": 3e-3, "tip_u4": 2e-2, "tip_u5": 0.1,
        "twist_u2": 5e-8, "twist_u4": 1e-7, "twist_u5": 8e-6,
    })  # fmt: skip


def test_a_port_called_base_gets_another_reference():
    M, K, B, _ = springs()
    ports = (Port("base", "acceleration"), Port("tip", "mechanical"))
    columns = [SHAKE, TIP]
    model = LinearModel(M=M, E=1e-4 * K, K=K, B=B[:, columns], ports=ports)
    assert [pin.name for pin in subcircuit(model, "shaken").pins] == ["base", "tip", "ground"]


def pair(*pins):
    return Port("drive", "electrical", pins=pins)


@pytest.mark.parametrize(
    "port", [pair("a"), pair("a", "b", "c"), Port("t", "mechanical", pins=("a", "b"))]
)
def test_a_port_has_its_number_of_pins(port):
    model = LinearModel(M=np.eye(1), K=np.eye(1), B=np.ones((1, 1)), ports=(port,))
    with pytest.raises(UsageError, match="wrong number of pins") as caught:
        subcircuit(model, "part")
    assert (caught.value.where, caught.value.got) == ("part", port.name)


def test_no_capacitance_is_negative():
    with pytest.raises(UsageError, match="negative capacitance"):
        subcircuit(modes([1e4], [[1.0]], ("electrical",), D=[[-1e-9]]).linear(), "kick", HEADER)


# ---------------------------------------------------------------------- scaling of resonators


def modes(omega, gain, kinds, *, damp=0.0, D=None, massless=0):
    ports = tuple(Port(f"a{k}", kind) for k, kind in enumerate(kinds))
    omega = np.array(omega)
    D = np.zeros((len(kinds),) * 2) if D is None else np.array(D)
    damp = np.broadcast_to(damp, omega.shape)
    return Resonators(omega, damp, np.array(gain), D, ports, None, massless)


def values(part, label):
    """``{digits of the label: value}`` of cards."""
    found = re.findall(rf"(?m)^{label} \S.* (\S+)$", part.text)
    return {key: float(value.strip("{}").removeprefix("damping*")) for key, value in found}


def test_a_state_is_the_largest_displacement_of_its_mode():
    gain = [[0.5, 0.2, 3.0], [0.1, 4.0, 0.1], [0.0, 0.0, 0.02], [3.0, 9.0, 0.0]]
    kinds = ("mechanical", "mechanical", "electrical")
    model = modes([1e4, 2e4, 4e4, 8e4], gain, kinds, D=np.diag([0, 0, 1e-9]), massless=1, damp=1e3)
    part = subcircuit(model.linear(), "kick", HEADER)
    assert values(part, r"Gua0_(\d)") == {"1": 1.0, "2": 0.025, "4": pytest.approx(1 / 3)}
    assert values(part, r"Gua1_(\d)") == {"1": 0.4, "2": 1.0, "4": 1.0}
    # charge in uC per um, of a mode that moves no port per its own share
    charges = {"1": 6.0, "2": 0.025, "3": 1.0, "4": 0.0}
    assert values(part, r"Gc(\d)") == pytest.approx(charges)


def test_a_state_that_moves_nothing_is_no_division_by_zero():
    part = subcircuit(modes([1e4], [[0.0]], ("mechanical",), damp=1.0).linear(), "kick", HEADER)
    assert values(part, r"Gfa0_(\d)") == {"1": 0.0}
    assert "Left out" not in part.text


@pytest.mark.parametrize(
    ("watch", "power", "start", "share"),
    [(FOLLOWED, 2, 3.0, 0.01), (STRIKING, 6, 3.0, 0.01), (COARSE, 6, 8.0, 1e-6)],
)
def test_what_step_control_sees_of_slow_modes(watch, power, start, share):
    gain = [[1.0, 1.0]] * 3
    model = modes([1e4, 2e4, 9e4], gain, ("mechanical", "electrical"), D=np.diag([0.0, 2e-9]))
    part = subcircuit(model.linear(), "kick", HEADER, watch=watch)
    farad = {"1": 1e-6 / start**power, "2": 1e-6 * (2 / start) ** power, "3": 1e-6}
    for node in "qp":
        assert values(part, rf"C{node}(\d)") == pytest.approx(farad)
    conductance = {key: value * {"1": 1e4, "2": 2e4, "3": 9e4}[key] for key, value in farad.items()}
    assert values(part, r"Gq(\d)") == pytest.approx(conductance)
    (clamped,) = values(part, "C(clamped)").values()
    assert clamped == pytest.approx(share * 2e-9)


def test_slight_damping_is_damping():
    part = subcircuit(modes([1e4], [[1.0]], ("mechanical",), damp=0.5).linear(), "kick", HEADER)
    assert [p.name for p in part.params] == ["damping"]
    assert values(part, r"Gd(\d)") == {"1": pytest.approx(0.5e-6 / 9)}
    assert "Mode 1: 1591.55 Hz, damping ratio 2.5e-05\n" in part.text


def test_silent_modes_are_counted():
    gain = [[1.0], [1e-12], [1e-12], [1.0], [1.0]]
    part = subcircuit(
        modes([1e4, 2e4, 3e4, 4e4, 5e4], gain, ("mechanical",)).linear(), "kick", HEADER
    )
    assert "Left out: 2 of the reduced" in part.text
    assert part.params == ()  # nothing damps
    assert list(values(part, r"Cp(\d)")) == ["1", "2", "3"]


def test_what_is_silent_is_judged_at_each_port():
    """The second mode is a ten-thousand-millionth of the first, but all that charges the body."""
    model = modes([1e4, 1e5], [[1.0, 0.0], [0.0, 1e-5]], ("mechanical", "electrical"))
    part = subcircuit(model.linear(), "kick", HEADER)
    assert list(values(part, r"Cp(\d)")) == ["1", "2"]
    assert "Left out" not in part.text


def test_states_without_inertia_come_last_whatever_their_frequency(tmp_path):
    """``1 / (s^2 + d s + w^2)`` and ``1 / (d s + w^2)``; the second without damping is a spring."""
    omega, damp = [9e3, 4e3, 5e3], [50.0, 2e3, 0.0]
    model = modes(omega, [[1.0], [2.0], [0.5]], ("mechanical",), damp=damp, massless=2)
    part = subcircuit(model.linear(), "kick", HEADER)
    assert "from 636.62 Hz on: relaxes within 0.000125 s\n" in part.text
    farads = values(part, r"Cq(\d)")
    assert farads["2"] == pytest.approx(2e3 / 16e6)  # at 1 S it is the time in seconds
    cards = "Ip a0 0 AC -1\nXkick a0 0 kick\n.ac lin 5 100 3000"
    waves = run_deck(bench([part], cards, {"y": ("v(a0)", 1e-6)}), tmp_path)
    s = 2j * np.pi * waves["frequency"].real
    exact = 1 / (s**2 + 50 * s + 81e6) + 4 / (2e3 * s + 16e6) + 0.25 / 25e6
    np.testing.assert_allclose(waves["y"], exact, rtol=1e-7)


# -------------------------------------------------------------------------- blocks of signals


def signals(A, B, C, D=None, **more):
    A, B, C = (np.array(each, dtype=float) for each in (A, B, C))
    inputs = [Port(f"u{k}", "input") for k in range(B.shape[1])]
    outputs = [Port(f"y{k}", "output") for k in range(C.shape[0])]
    D = np.zeros((len(C), B.shape[1])) if D is None else np.array(D)
    return LinearModel(A=A, E=np.eye(len(A)), B=B, C=C, D=D, ports=(*inputs, *outputs), **more)


@pytest.mark.parametrize("dense", [False, True])
def test_signals_of_coupled_states(dense, tmp_path):
    """``y = C (s - A)^-1 B u + D u``; the states stand at about 1 V for a constant 1 V."""
    A = [[-40.0, 3e3, 0, 0], [-2e3, -40.0, 0, 0], [0, 0, -5e3, 0], [0, 0, 0, -100.0]]
    B = [[1e3, 0.0], [0.0, 20.0], [5.0, 1.0], [2.0, 0.0]]
    C, D = [[1.0, 0, 2.0, 0], [0, 3.0, 0, 1.0]], [[0.5, 0.0], [0.0, 2.0]]
    part = subcircuit(signals(A, B, C, D, band=(0.0, 1e3)), "plant", HEADER, dense=dense)
    assert "plant: reduced linear model, 2 inputs, 2 outputs\n" in part.text
    assert [p.name for p in part.pins] == ["u0", "u1", "y0", "y1", "ref"]
    assert "free integrator" not in part.text
    farads = re.findall(r"(?m)^Cz\d \S+ \S+ (\S+)$", part.text)
    assert list(map(float, farads)) == pytest.approx(4 * [1 / (2 * np.pi * 1e3)])
    cards = ["V0 one 0 DC 1 AC 1", "X0 one 0 a0 a1 0 plant", "X1 0 one b0 b1 0 plant"]
    vectors = {f"{n}{k}": (f"v({n}{k})", 1.0) for n in "ab" for k in range(2)}
    waves = run_deck(bench([part], "\n".join([*cards, ".ac lin 4 50 800"]), vectors), tmp_path)
    s = 2j * np.pi * waves["frequency"].real
    H = np.array([np.array(C) @ np.linalg.solve(z * np.eye(4) - A, B) + D for z in s])
    for k, n in enumerate("ab"):
        for o in range(2):
            np.testing.assert_allclose(waves[f"{n}{o}"], H[:, o, k], rtol=1e-9, atol=1e-12)
    states = {f"{x}{j}": (f"v(x{x}.z{j})", 1.0) for x in range(2) for j in range(1, 5)}
    at_rest = run_deck(bench([part], "\n".join([*cards, ".op"]), states), tmp_path / "op")
    size = np.array([[at_rest[f"{x}{j}"][0] for j in range(1, 5)] for x in range(2)])
    blocks = re.findall(r"\* States (\d) to (\d): ", part.text)
    assert len(blocks) == (1 if dense else 2)
    for first, last in blocks:
        assert np.abs(size[:, int(first) - 1 : int(last)]).max() == pytest.approx(1.0, rel=1e-6)


def test_a_block_line_by_line():
    """``z' = -2 z + 4 u``, ``y = 3 z + u / 2``: 1 V at the input brings z to 2, so half of it is
    the state."""
    part = subcircuit(signals([[-2.0]], [[4.0]], [[3.0]], [[0.5]], band=(0.0, 2.0)), "plant")
    cards = [line.split() for line in part.text.partition(".subckt ")[2].splitlines()]
    farad = 1 / (2 * np.pi * 2.0)
    expected = {
        "Gleak1": ("u0 ref u0 ref", 1e-12), "E1": ("y0 ref sum1 ref", 1.0),
        "Rsum1": ("sum1 ref", 1.0), "Gc1_1": ("ref sum1 z1 ref", 6.0),
        "Gt1_u1": ("ref sum1 u0 ref", 0.5), "Cz1": ("z1 ref", farad),
        "Ga1_1": ("ref z1 z1 ref", -2.0 * farad), "Gb1_1": ("ref z1 u0 ref", 2.0 * farad),
    }  # fmt: skip
    found = {c[0]: (" ".join(c[1:-1]), float(c[-1])) for c in cards if c and c[0] in expected}
    assert found == {k: (nodes, pytest.approx(x)) for k, (nodes, x) in expected.items()}
    assert part.text.count("\nG") == 5


@pytest.mark.parametrize(("more", "top"), [
    ({}, 1.0), ({"band": (5.0, 3e3)}, 3e3),
    ({"band": (0.0, 2.0), "certificate": Certificate((5.0, 4e3), 1e-4, "", True, True)}, 4e3),
])  # fmt: skip
def test_a_state_of_a_block_is_slow_by_the_band(more, top):
    part = subcircuit(signals([[-2.0]], [[4.0]], [[3.0]], **more), "plant")
    (farad,) = values(part, r"Cz(\d)").values()
    assert farad == pytest.approx(1 / (2 * np.pi * top))
    assert ("small signals up to 4000 Hz at" in part.text) == ("certificate" in more)


def test_a_direct_effect_may_be_tiny():
    part = subcircuit(signals([[-2.0]], [[4.0]], [[3.0]], [[1e-15]]), "plant")
    assert values(part, r"Gt1_u(\d)") == {"1": 1e-15}


def test_a_charge_that_relaxes_is_a_resistor_and_a_capacitor(tmp_path):
    """``q' = (C v - q) / (R C)``: the terminals have no capacitance of their own."""
    ohm, farad = 1e3, 2e-9
    rate = np.array([[1 / (ohm * farad)]])
    port = Port("drive", "electrical", pins=("a", "b"))
    model = LinearModel(A=-rate, E=np.eye(1), B=rate * farad, C=np.eye(1), D=np.zeros((1, 1)),
                        ports=(port,), band=(0.0, 1e5))  # fmt: skip
    part = subcircuit(model, "rc", HEADER)
    cards = f"Va a 0 AC 1\nXrc {' '.join('a' if p.name == 'a' else '0' for p in part.pins)} rc"
    deck = bench([part], f"{cards}\n.ac lin 5 2e4 1e5", {"i": ("i(va)", -1.0)})
    waves = run_deck(deck, tmp_path)
    s = 2j * np.pi * waves["frequency"].real
    np.testing.assert_allclose(waves["i"], 1 / (ohm + 1 / (s * farad)), rtol=1e-6)


def test_poles_are_told_to_the_reader():
    A = np.diag([-1.0, -20.0, -3e3, -4e4, -5e5])
    text = subcircuit(signals(A, np.ones((5, 1)), np.ones((1, 5))), "plant", dense=True).text
    (line,) = re.findall(r"\* States 1 to 5: (.*)", text)
    poles = line.removesuffix("; and 2 more").split("; ")
    assert len(poles) == 3 < len(line)
    assert line.endswith("; and 2 more")
    assert set(poles) < {f"pole {p:.6g} 1/s" for p in np.diag(A)}
    text = subcircuit(
        signals(A[:3, :3], np.ones((3, 1)), np.ones((1, 3))), "plant", dense=True
    ).text
    assert "more" not in re.findall(r"\* States 1 to 3: (.*)", text)[0]
    pair = signals([[-30.0, 400.0], [-400.0, -30.0]], [[1.0], [0.0]], [[1.0, 0.0]])
    text = subcircuit(pair, "plant").text
    told = f"{np.hypot(30, 400) / (2 * np.pi):.6g} Hz, damping ratio {30 / np.hypot(30, 400):.6g}"
    assert f"* States 1 to 2: {told}\n" in text


def test_a_symmetric_model_with_signals_is_no_network(tmp_path):
    ports = (Port("u", "input"), Port("y", "output"))
    model = LinearModel(M=np.eye(1), K=np.array([[4.0]]), B=np.ones((1, 1)), ports=ports)
    part = subcircuit(model, "one", HEADER)
    assert [pin.name for pin in part.pins] == ["u", "y", "ref"]
    waves = run_deck(bench([part], "Vu u 0 3\nXone u y 0 one\n.op", {"y": ("v(y)", 1.0)}), tmp_path)
    assert waves["y"][0] == pytest.approx(0.75)


def test_an_integrator_has_an_operating_point(tmp_path):
    """``y' = 5 u``, in a band up to 2 Hz."""
    model = signals([[0.0]], [[5.0]], [[1.0]], band=(0.0, 2.0))
    part = subcircuit(model, "sum", HEADER)
    assert part.text.count("* The leak gives a free integrator its operating point.") == 1
    cards = "Vu u 0 PWL(0 0 1e-6 2)\nXsum u y 0 sum\n.tran 1e-3 0.1"
    waves = run_deck(bench([part], cards, {"y": ("v(y)", 1.0)}, 0.1), tmp_path)
    assert waves["y"][-1] == pytest.approx(1.0, rel=1e-4)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_complex_pair_is_balanced_and_answers_as_before(sign):
    one, other = np.ones((2, 1)), np.array([[1.0, 3.0]])
    model = BlockModel((np.array([[-1.0, 8 * sign], [-2 * sign, -1.0]]),), one, other, np.eye(1))
    found = _balanced(model, 1.0)
    np.testing.assert_allclose(found.blocks[0], [[-1.0, 4 * sign], [-4 * sign, -1.0]], rtol=1e-14)
    at = np.array([0.0, 0.3, 2.0])
    np.testing.assert_allclose(found.response(at), model.response(at), rtol=1e-13)
