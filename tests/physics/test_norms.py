"""Both norms of a certificate, and the fewest states in them, against direct solutions."""

import json

import numpy as np
import pytest
from scipy.linalg import eigvals
from typer.testing import CliRunner

from kc2spice.cli.main import app
from kc2spice.rom.linear import LinearModel
from kc2spice.rom.reduce import reduce


def heat():
    """A rod of 200 cells: at 1 kHz nothing is left of what goes in, 1e-290 and less."""
    n = 200
    A = 1e-2 * (n + 1) ** 2 * (np.eye(n, k=1) + np.eye(n, k=-1) - 2 * np.eye(n))
    return A, (n + 1) * np.eye(n)[:, [n // 3]], np.eye(n)[[2 * n // 3]], 1e3 / (2 * np.pi)


def structure(states=120, ports=2):
    """Lightly damped modes over two decades, in first order, none symmetric."""
    rng = np.random.default_rng(5)
    n = states // 2
    w, ratio = np.exp(np.linspace(0, 5, n)), rng.uniform(1e-3, 5e-3, n)
    A = np.zeros((states, states))
    for i in range(n):
        A[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = [[0, w[i]], [-w[i], -2 * ratio[i] * w[i]]]
    B, C = np.zeros((states, ports)), np.zeros((ports, states))
    B[1::2] = rng.standard_normal((n, ports)) / w[:, None]
    C[:, ::2] = rng.standard_normal((ports, n)) / w
    return A, B, C, w[-1] / (2 * np.pi)


def direct(A, B, C, frequency, E=None):
    s = 2j * np.pi * frequency[:, None, None]
    E = np.eye(len(A)) if E is None else E
    return C @ np.linalg.solve(s * E - A, B.astype(complex)[None])


def dense_points(A, top):
    poles = eigvals(A)
    poles = poles[poles.imag > 0] / (2 * np.pi)
    near = poles.imag[:, None] + np.abs(poles.real[:, None]) * np.linspace(-3, 3, 13)
    f = np.r_[0.0, np.linspace(0, top, 800), np.geomspace(1e-4 * top, top, 800), near.ravel()]
    return np.unique(f[(f >= 0) & (f <= top)])


@pytest.mark.parametrize("tolerance", [1e-2, 1e-4, 1e-6])
@pytest.mark.parametrize(("model", "most"), [(heat, 0.5), (structure, 0.96)])
def test_the_peak_norm_needs_fewer_states_and_holds(model, most, tolerance):
    A, B, C, top = model()
    full = LinearModel(A=A, B=B, C=C)
    found = {norm: reduce(full, tolerance=tolerance, band=(0.0, top), norm=norm)
             for norm in ("pointwise", "peak")}  # fmt: skip
    assert found["peak"].order <= most * found["pointwise"].order
    f = dense_points(A, top)
    H = direct(A, B, C, f)
    for norm, rom in found.items():
        assert rom.certificate.norm == norm
        assert rom.certificate.stable is True
        size = np.abs(H)
        base = size.max(axis=0) if norm == "peak" else np.maximum(size, 1e-6 * size.max(axis=0))
        difference = np.abs(direct(rom.A, rom.B, rom.C, f, rom.E) + rom.D - H)
        error = (difference / base).max()
        stated = rom.certificate.error_estimate
        assert error <= stated <= tolerance, (norm, error, stated)
        assert norm == "pointwise" or stated <= 3 * error + 1e-11


def test_the_command_takes_the_norm_of_the_ports_or_the_one_asked_for(tmp_path):
    A, B, C, top = heat()
    np.savez(tmp_path / "rod.npz", A=A, B=B, C=C)
    words = ["reduce", str(tmp_path / "rod.npz"), "--band", "0", str(top), "--json"]
    found = {}
    for norm in ("", "peak", "pointwise"):
        asked = ["--norm", norm] if norm else []
        done = CliRunner().invoke(app, [*words, *asked, "-o", str(tmp_path / f"out{norm}")])
        assert done.exit_code == 0, done.output
        found[norm] = json.loads(done.stdout)
    assert [found[n]["norm"] for n in ("", "peak", "pointwise")] == ["peak", "peak", "pointwise"]
    assert found[""]["order"] == found["peak"]["order"] < found["pointwise"]["order"]
    again = CliRunner().invoke(
        app, ["export", "--rom", found["peak"]["rom"], "-o", str(tmp_path / "lib")]
    )
    assert again.exit_code == 0, again.output
    texts = [path.read_text() for path in (tmp_path / "lib").glob("*.lib")]
    assert any("norm=peak" in text for text in texts)
    wrong = CliRunner().invoke(app, [*words, "--norm", "largest", "-o", str(tmp_path / "no")])
    assert wrong.exit_code == 2
    assert "pointwise, peak" in wrong.stderr
