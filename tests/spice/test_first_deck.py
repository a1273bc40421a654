"""The deck that comes with an exported model, run as written, against the matrices themselves."""

import subprocess

import numpy as np
import pytest
from support import export_rom, find_ngspice, read_raw, reduce_file

N = 6
K = np.diag(np.linspace(1e6, 3e6, N)) - 2e5 * (np.eye(N, k=1) + np.eye(N, k=-1))
M, E = 1e-4 * np.eye(N), 1e-7 * K
B = np.zeros((N, 3))
B[[0, 3, 5], [0, 1, 2]] = 1e-3, 2e-3, 1.0
D = np.diag([1e-9, 2e-9, 0.0])
PORT = '[[ports]]\nname = "{}"\nkind = "{}"\ncolumn = {}\n{}\n'


def emitted(folder, table, **arrays):
    """Frequencies and vectors of the first deck, from ngspice itself."""
    np.savez(folder / "m.npz", **arrays)
    (folder / "m.toml").write_text("band = [10, 3e4]\n" + table)
    found = reduce_file(folder / "m.npz", folder / "rom", tolerance=1e-8)
    files = [path.name for path in export_rom(found["rom"], folder / "out")]
    assert {"m_rom.lib", "m_rom.asy", "kc2spice.kicad_sym", "m_rom_response.cir"} <= set(files)
    deck = (folder / "out" / "m_rom_response.cir").read_text(encoding="utf-8")
    assert "covers 30 to 30000 Hz. The error estimate is valid from 10 to 30000 Hz." in deck
    command = [find_ngspice().path, "-b", "-n", "-r", "out.raw", "m_rom_response.cir"]
    done = subprocess.run(command, cwd=folder / "out", capture_output=True, check=False)
    assert done.returncode == 0, done.stdout
    vectors = read_raw(folder / "out" / "out.raw")
    return 2j * np.pi * vectors["frequency"].real, vectors


def test_two_electrodes_and_a_mechanical_port(tmp_path):
    """Any number of named pairs of terminals; the response is that of the first."""
    ports = PORT.format("drive", "electrical", 1, "") + PORT.format("tip", "mechanical", 3, "")
    ports += PORT.format("sense", "electrical", 2, 'pins = ["sp", "sn"]')
    s, found = emitted(tmp_path, ports, K=K, M=M, E=E, B=B, C=B.T, D=D)
    text = (tmp_path / "out" / "m_rom.lib").read_text()
    pins = [line.split()[3] for line in text.splitlines() if line.startswith("* @pin")]
    assert pins == ["drive", "drive_ret", "sp", "sn", "tip", "base"]
    x = np.array([np.linalg.solve(K + p * E + p**2 * M, B[:, 0]) for p in s])
    charge = x @ B + D[0]
    np.testing.assert_allclose(-found["i(vdrive)"], s * charge[:, 0], rtol=1e-6)
    np.testing.assert_allclose(-found["i(vsp)"], s * charge[:, 1], rtol=1e-5)
    np.testing.assert_allclose(1e-6 * found["v(tip)"], charge[:, 2], rtol=1e-5)


def test_a_mechanical_model_is_driven_by_its_first_force(tmp_path):
    ports = PORT.format("a", "mechanical", 3, "") + PORT.format("b", "mechanical", 2, "")
    s, found = emitted(tmp_path, ports, K=K, M=M, E=E, B=B)
    x = np.array([np.linalg.solve(K + p * E + p**2 * M, B[:, 2]) for p in s])
    np.testing.assert_allclose(1e-6 * found["v(a)"], x @ B[:, 2], rtol=1e-6)
    np.testing.assert_allclose(1e-6 * found["v(b)"], x @ B[:, 1], rtol=1e-5)


@pytest.mark.parametrize("inputs", [1, 2])
def test_signals_are_driven_one_by_one(inputs, tmp_path):
    A = np.diag([-1e2, -1e3, -1e4]) + np.diag([30.0, 40.0], 1) - np.diag([20.0, 50.0], -1)
    b, c = np.ones((3, inputs)), np.arange(6.0).reshape(2, 3)
    s, found = emitted(tmp_path, "", A=A, E=np.eye(3), B=b, C=c)
    x = np.array([np.linalg.solve(p * np.eye(3) - A, b[:, 0]) for p in s])
    np.testing.assert_allclose(found["v(y1)"], x @ c[0], rtol=1e-6)
    np.testing.assert_allclose(found["v(y2)"], x @ c[1], rtol=1e-6)
