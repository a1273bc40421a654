"""Foster's and Cauer's form of a heat network against each other and against closed forms."""

import re

import numpy as np
import pytest
from commands import run_command
from support import (
    FosterNetwork,
    HeatLadder,
    NodalCircuit,
    find_heat_ladder,
    parse_literal,
    read_rom,
)

import kc2spice as kc

PORT = kc.Port("junction", "thermal")


def ladder_impedance(ladder, s):
    """Continued fraction of a ladder from its end."""
    Z = np.zeros(len(s), complex)
    for R, C in zip(ladder.resistance[::-1], ladder.capacity[::-1], strict=True):
        Z = 1 / (s * C + 1 / (R + Z))
    return ladder.direct + Z


def foster_impedance(network, s):
    terms = network.resistance / (1 + s[:, None] * network.time_constant)
    return network.direct + terms.sum(axis=1)


def random_network(seed, modes):
    rng = np.random.default_rng([7, seed])
    direct = float(rng.choice([0.0, 0.3]))
    return FosterNetwork(10 ** rng.uniform(-3, 1, modes), 10 ** rng.uniform(-6, 2, modes), direct)


@pytest.mark.parametrize("seed", range(30))
def test_the_ladder_of_a_random_network_is_positive_and_equivalent(seed):
    network = random_network(seed, 1 + seed)
    ladder = network.convert_to_ladder()
    assert (ladder.resistance > 0).all()
    assert (ladder.capacity > 0).all()
    s = 2j * np.pi * np.geomspace(1e-5, 1e7, 25)
    exact = foster_impedance(network, s)
    assert np.abs(ladder_impedance(ladder, s) / exact - 1).max() < 1e-12
    found = ladder.to_linear_model(PORT).transfer(s.imag / (2 * np.pi))[:, 0, 0]
    assert np.abs(found / exact - 1).max() < 1e-9


def test_two_cells_follow_the_closed_form():
    """Z = R1 + R2 at rest, and 1 / (s C1) at high frequencies."""
    ladder = HeatLadder(np.array([2.0, 5.0]), np.array([0.1, 3.0]))
    poles = np.linalg.eigvals([[-1 / 0.2, 1 / 0.2], [1 / 6.0, -(1 / 6.0 + 1 / 15.0)]]).real
    times = -1 / poles
    # residues of T1/q at the poles: with the temperatures of the capacities as states
    A = np.array([[-1 / 0.2, 1 / 0.2], [1 / 6.0, -(1 / 6.0 + 1 / 15.0)]])
    values, vectors = map(np.real, np.linalg.eig(A))  # complex in newer versions of numpy
    residues = vectors[0] * np.linalg.solve(vectors, [1 / 0.1, 0.0])
    network = FosterNetwork(residues * -1 / values, times)
    found = network.convert_to_ladder()
    np.testing.assert_allclose(found.resistance, ladder.resistance, rtol=1e-10)
    np.testing.assert_allclose(found.capacity, ladder.capacity, rtol=1e-10)


def test_equal_time_constants_are_one_mode():
    network = FosterNetwork(np.array([1.0, 2.0, 4.0]), np.array([0.5, 0.5, 3.0]))
    assert len(network.convert_to_ladder().capacity) == 2


def test_only_ladder_matrices_are_recognised_as_a_ladder():
    network = random_network(4, 5)
    ladder = network.convert_to_ladder()
    found = find_heat_ladder(ladder.to_linear_model(PORT))
    np.testing.assert_allclose(found.resistance, ladder.resistance, rtol=1e-14)
    np.testing.assert_allclose(found.capacity, ladder.capacity, rtol=1e-9)
    assert find_heat_ladder(network.to_linear_model(PORT)) is None


@pytest.mark.parametrize("direct", [0.0, 0.25])
def test_the_netlist_of_a_ladder_is_the_ladder(direct):
    ladder = HeatLadder(np.array([2.0, 5.0, 1.0]), np.array([0.1, 3.0, 40.0]), direct)
    part = kc.subcircuit(ladder.to_linear_model(PORT), "ladder")
    start = "h1" if direct else "junction"
    cards = re.findall(r"(?m)^([RC]\d+) (\S+) (\S+) (\S+)$", part.text)
    found = {name: (a, b, parse_literal(value)) for name, a, b, value in cards}
    for k, (R, C) in enumerate(zip(ladder.resistance, ladder.capacity, strict=True), 1):
        node = start if k == 1 else f"h{k}"
        assert found[f"C{k}"][:2] == (node, "ambient")
        assert found[f"C{k}"][2] == pytest.approx(C, rel=1e-12)
        assert found[f"R{k}"][:2] == (node, f"h{k + 1}" if k < 3 else "ambient")
        assert found[f"R{k}"][2] == pytest.approx(R, rel=1e-12)
    s = 2j * np.pi * np.geomspace(1e-4, 1e2, 9)
    solved = NodalCircuit(part.circuit.subcircuits[0]).equations({}, ["ambient"], {})
    Z = solved.solve(s, [{"junction": 1.0}], ["junction"])[:, 0, 0]
    assert np.abs(Z / ladder_impedance(ladder, s) - 1).max() < 1e-9
    assert "structure function" in part.text


def heated_bar(path, ports=1):
    """Files of 60 cells of a bar whose end is at the ambient temperature."""
    n = 60
    K = 30.0 * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    K[0, 0] = 30.0
    np.savez(path, E=0.01 * np.eye(n), K=K, B=np.eye(n)[:, [0, 30][:ports]])
    rows = [f'[[ports]]\nname = "spot{k}"\nkind = "thermal"\ncolumn = {k}' for k in (1, 2)[:ports]]
    path.with_suffix(".toml").write_text("band = [0, 10]\n" + "\n".join(rows))


def test_reduce_writes_a_model_of_matrices_as_a_ladder(tmp_path):
    heated_bar(tmp_path / "bar.npz")
    words = ("reduce", tmp_path / "bar.npz", "--json", "--tolerance", "1e-3")
    plain = run_command(*words, "--out", tmp_path / "plain")
    shaped = run_command(*words, "--network", "cauer", "--out", tmp_path / "shaped")
    first, second = read_rom(plain["rom"]), read_rom(shaped["rom"])
    assert find_heat_ladder(second) is not None
    f = np.geomspace(1e-3, 10, 20)
    np.testing.assert_allclose(second.transfer(f), first.transfer(f), rtol=1e-8)
    assert find_heat_ladder(second).resistance.sum() == pytest.approx(60 / 30.0, rel=1e-9)


def test_a_ladder_has_one_port(cli, tmp_path):
    heated_bar(tmp_path / "bar.npz", ports=2)
    result = cli("reduce", str(tmp_path / "bar.npz"), "--network", "cauer")
    assert result.exit_code == 2
    assert "one thermal port" in result.stderr
    result = cli("reduce", str(tmp_path / "bar.npz"), "--network", "pi")
    assert result.exit_code == 2
    assert "foster or cauer" in result.stderr
