"""Both norms of a certificate, and the fewest states in them, against direct solutions."""

import json

import numpy as np
import oracle
import pytest
from support import LinearModel, app, reduce_model
from typer.testing import CliRunner

from bench.beam import heat, structure
from bench.reduction_methods import Truncated, largest, schur


@pytest.mark.parametrize(
    ("case", "most", "tolerance"),
    [
        (heat(80), 0.5, 1e-4),
        pytest.param(heat(), 0.5, 1e-6, marks=pytest.mark.slow),
        pytest.param(structure(60, 2), 0.96, 1e-2, marks=pytest.mark.slow),
    ],
)
def test_the_peak_norm_needs_fewer_states_and_holds(case, most, tolerance):
    """At 1 kHz nothing is left of the heat that goes into the rod, 1e-290 and less."""
    full, _, band = case
    found = {norm: reduce_model(full, tolerance=tolerance, band=band, norm=norm)
             for norm in ("pointwise", "peak")}  # fmt: skip
    assert found["peak"].order <= most * found["pointwise"].order
    model = oracle.system({"A": full.A, "B": full.B, "C": full.C})
    frequency = np.r_[0.0, oracle.fine(model, band, oracle.poles(model[0]))]
    exact = oracle.direct(model, frequency)
    size = np.abs(exact)
    for norm, rom in found.items():
        assert rom.certificate.norm == norm
        assert rom.certificate.stable is True
        peak = size.max(axis=0)
        base = peak if norm == "peak" else np.maximum(size, oracle.FLOOR * peak)
        difference = np.abs(oracle.direct(oracle.system_of(rom), frequency) - exact)
        error = (difference / base).max()
        stated = rom.certificate.error_estimate
        assert error <= stated <= tolerance, (norm, error, stated)
        assert norm == "pointwise" or stated <= 3 * error + 1e-11


def test_the_command_uses_the_requested_norm_or_the_norm_of_the_ports(tmp_path):
    rod, _, (_, top) = heat(80)
    np.savez(tmp_path / "rod.npz", A=rod.A, B=rod.B, C=rod.C)
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


def test_fitted_outputs_need_fewer_states_than_any_balanced_truncation():
    """Fifteen damped modes, two by two: truncations by scipy, and errors by its Schur form."""
    rng, n = np.random.default_rng(3), 15
    w, ratio = np.linspace(1, 5, n), rng.uniform(0.05, 0.2, n)
    A, B, C = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, 2)), np.zeros((2, 2 * n))
    A[::2, 1::2], A[1::2, ::2], A[1::2, 1::2] = np.diag(w), -np.diag(w), -2 * np.diag(ratio * w)
    B[1::2] = rng.standard_normal((n, 2)) / w[:, None] ** 2
    C[:, ::2] = rng.standard_normal((2, n)) / w**2
    rom = reduce_model(
        LinearModel(A=A, B=B, C=C), tolerance=0.0144, band=(0, 2.5 / np.pi), norm="peak"
    )
    plain, at = (A, B, C, np.zeros((2, 2))), np.linspace(0, 5, 1500)
    exact = schur(plain)(at)
    error = largest(rom.transfer(at / (2 * np.pi)), exact, "peak")
    assert error <= rom.certificate.error_estimate <= 0.0144
    assert rom.order <= Truncated(plain, at, exact).least(0.0144, "peak") - 4  # 13 without the fit
