"""Subcircuits of small models with every kind of port, against their equations solved by numpy."""

import itertools
import re

import numpy as np
import pytest
from device import bench
from support import Header, LinearModel, Port, UsageError, parse_literal, run_deck, subcircuit

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
def test_every_port_responds_to_every_other_port(form, mass, tmp_path):
    """``y = B' (s^2 M + s E + K)^-1 B u + D u``; a charge is seen as the current ``s y``, a
    frame's reaction is ``m a - y''``."""
    M, K, B, D = springs()
    E = 0.05 * K / 1e3 if form == "resonators" else 0.05 * K / 1e3 + np.diag([90.0, 0.0, 5.0])
    facts = {} if mass is None else {"mass_kg": mass}
    model = LinearModel(M=M, E=E, K=K, B=B, D=D, ports=PORTS, facts=facts)
    part = subcircuit(model, "zoo", HEADER, dense=form == "dense")
    assert ("\nCq1 " in part.text) == (form == "resonators")
    assert not re.search(r"(?m)^G.* -?0(\.0)?$", part.text)
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


@pytest.mark.parametrize("loss", [0.0, 1e-8, 1e-5])  # s, times K: no damping, Q above 1000, below
def test_responses_of_modes_are_exact_for_any_damping(loss, tmp_path):
    """As above; without damping the response is real, away from the poles."""
    M, K, B, D = springs()
    model = LinearModel(M=M, E=loss * K, K=K, B=B, D=D, ports=PORTS)
    part = subcircuit(model, "zoo", HEADER)
    assert ("p = q + q'/omega" in part.text) == (loss < 1e-6)
    waves = answers(part, PORTS, tmp_path)
    s = 2j * np.pi * waves["frequency"].real
    H = np.array([B.T @ np.linalg.solve(z * z * M + z * loss * K + K, B) + D for z in s])
    rigid = B[:, SHAKE] @ np.linalg.solve(M, B[:, SHAKE])
    for i, driven in enumerate(PORTS):
        for o, port in enumerate(PORTS):
            exact = H[:, o, i] * (s if port.kind == "electrical" else 1.0)
            if port.kind == "acceleration":
                exact = (rigid if driven is port else 0.0) - s**2 * exact
            error = np.abs(waves[f"{driven.name}>{port.name}"] - exact).max()
            assert error < 1e-6 * np.abs(exact).max() + 1e-11, (driven.name, port.name)


@pytest.mark.parametrize("loss", [0.0, 1e-13, 1e-8])  # s, times K
def test_modes_without_damping_keep_the_matrix_sparse(loss, tmp_path):
    """Each mode adds a handful of elements to the factors, with whatever damping; the pivots beside
    the diagonal of undamped modes added 200 each."""
    count, rng = 120, np.random.default_rng(1)
    omega = 2 * np.pi * np.geomspace(270e3, 30e6, count)
    B = omega[:, None] * 1e-4 * rng.normal(size=(count, 3))
    ports = (PORTS[DRIVE], PORTS[TIP], PORTS[TWIST])
    D = np.diag([4e-8, 0.0, 0.0])
    model = LinearModel(
        M=np.eye(count), E=loss * np.diag(omega**2), K=np.diag(omega**2), B=B, D=D, ports=ports
    )
    part = subcircuit(model, "many", HEADER)
    nodes = {pin.name: "0" for pin in part.pins}
    nodes |= {port.terminals[0]: port.name for port in ports}
    cards = [f"X1 {' '.join(nodes[pin.name] for pin in part.pins)} many"]
    cards += [f"V1 {PORTS[DRIVE].name} 0 PULSE(0 1 10n 10n 10n 1u)"]
    cards += [f"R{port.name} {port.name} 0 1" for port in ports[1:]]
    cards += [".options acct", ".tran 1n 0.1u"]
    deck = bench([part], "\n".join(cards), {"v": ("v(tip)", 1)})
    run_deck(deck, tmp_path)
    log = (tmp_path / "bench.log").read_text(errors="replace")
    filled = int(re.search(r"fill-in non-zeroes = (\d+)", log)[1])
    assert filled < 10 * count


@pytest.mark.parametrize("dense", [False, True])
def test_a_bare_electrode_that_shares_charge_is_no_passive_network(dense):
    M, K, B, D = springs()
    D[FLOATING, TIP] = D[TIP, FLOATING] = 1e-9
    with pytest.raises(UsageError, match="zero on the diagonal of D, but D couples the electrode"):
        subcircuit(LinearModel(M=M, E=1e-5 * K, K=K, B=B, D=D, ports=PORTS), "zoo", dense=dense)


@pytest.mark.parametrize("dense", [False, True])
@pytest.mark.parametrize("loss", [0.0, 2e3])
def test_states_without_inertia_have_no_velocity(loss, dense, tmp_path):
    """A bare electrode takes the rate of their charge; a frame would take the rate of that."""
    w, ports = 2 * np.pi * np.array([1e3, 3e3]), [PORTS[FLOATING], PORTS[TIP]]
    pencil = {"M": np.diag([1.0, 0.0]), "E": np.diag([100.0, loss]), "K": np.diag(w**2)}
    B = np.array([[1.0, 3.0], [2.0, 1.0]])
    model = LinearModel(**pencil, B=B, ports=ports)
    waves = answers(subcircuit(model, "zoo", HEADER, dense=dense), ports, tmp_path)
    f = waves["frequency"].real
    for (o, out), (i, driven) in itertools.product(enumerate(ports), repeat=2):
        exact = model.transfer(f)[:, o, i] * (2j * np.pi * f if o == 0 else 1.0)
        error = np.abs(waves[f"{driven.name}>{out.name}"] - exact).max()
        assert error < 1e-6 * np.abs(exact).max() + 1e-11, (driven.name, out.name)
    with pytest.raises(UsageError, match="states without inertia"):
        shaken = LinearModel(**pencil, B=B, ports=[PORTS[SHAKE], PORTS[TIP]])
        subcircuit(shaken, "zoo", HEADER, dense=dense)


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
    assert list(map(parse_literal, farads)) == pytest.approx(4 * [1 / (2 * np.pi * 1e3)])
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
