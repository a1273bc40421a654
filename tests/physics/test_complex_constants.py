"""Losses by complex constants of IEEE 176, against a bar assembled with complex constants."""

import numpy as np
import pytest
from scipy.linalg import eigh
from support import (
    Certificate,
    ComplexConstants,
    Port,
    Resonators,
    StageTimer,
    UsageError,
    build_models,
    ignore_progress,
    make_complex_constants_model,
)

import kc2spice as kc

# A bar along x, poled and driven across its thickness, clamped at x = 0, with a force at its tip.
LENGTH, WIDTH, THICKNESS, COUNT = 20e-3, 3e-3, 1e-3, 8
DENSITY, C, D31, EPS_T = 7700.0, 1 / 16e-12, -180e-12, 1700 * 8.8541878e-12
PORTS = (Port("anode", "electrical"), Port("tip", "mechanical"))


def bar(chi=1.0):
    """Stiffness, mass, loads of a volt and of a newton, and clamped capacitance of T = c (S - d E),
    D = d T + eps E, with a factor of the stiffness."""
    h, area = LENGTH / COUNT, WIDTH * THICKNESS
    K = np.zeros((COUNT + 1, COUNT + 1), dtype=complex)
    M = np.zeros((COUNT + 1, COUNT + 1))
    for k in range(COUNT):
        K[k : k + 2, k : k + 2] += C * chi * area / h * np.array([[1, -1], [-1, 1]])
        M[k : k + 2, k : k + 2] += DENSITY * area * h / 6 * np.array([[2, 1], [1, 2]])
    B = np.zeros((COUNT, 2), dtype=complex)
    B[-1] = C * chi * D31 * WIDTH, 1.0  # the stress of a field pulls at the free end alone
    return K[1:, 1:], M[1:, 1:], B, -(D31**2) * C * chi * WIDTH * LENGTH / THICKNESS


def power_law(f, at, factor):
    """1 + j factor at a frequency, with the same angle at all others."""
    angle = np.arctan(factor)
    return (1j * f / at) ** (2 * angle / np.pi) / np.cos(angle)


def direct(f, quality, tangent, at):
    """Charge and displacement per volt and newton (n, 2, 2), by complex constants."""
    result = []
    for frequency in f:
        K, M, B, rest = bar(power_law(frequency, at, 1 / quality))
        H = B.T @ np.linalg.solve(K - (2 * np.pi * frequency) ** 2 * M, B)
        eps = EPS_T * (1j * frequency / 1e3) ** (-2 / np.pi * np.arctan(tangent))
        H[0, 0] += eps * WIDTH * LENGTH / THICKNESS + rest
        result.append(H)
    return np.array(result)


def modes(band):
    K, M, B, rest = bar()
    squares, shapes = eigh(K.real, M)
    D = np.diag([EPS_T * WIDTH * LENGTH / THICKNESS + rest.real, 0.0])
    certificate = Certificate(band, 0.0, "all modes", True, True)
    return Resonators(np.sqrt(squares), np.zeros(COUNT), shapes.T @ B.real, D, PORTS, certificate)


@pytest.mark.parametrize(("quality", "tangent"), [(80.0, 0.0), (80.0, 0.02), (1000.0, 0.004)])
@pytest.mark.parametrize("band", [(0.0, 250e3), (20e3, 120e3)])
def test_a_bar_is_that_of_complex_constants(quality, tangent, band):
    model = modes(band)
    at = float(model.omega[0] / (2 * np.pi))
    result = make_complex_constants_model(model, ComplexConstants(1 / quality, tangent, at))
    resonances = model.omega[model.omega < 2 * np.pi * band[1]] / (2 * np.pi)
    f = np.sort(np.r_[np.geomspace(max(band[0], 100.0), band[1], 60), resonances])
    exact, H = direct(f, quality, tangent, at), result.transfer(f)
    size = np.maximum(np.abs(exact), 1e-6 * np.abs(exact).max(axis=0))
    off = np.abs(H - exact) / size
    assert off.max() < 2 * result.certificate.error_estimate < 5e-3
    assert result.symmetric


def test_a_body_of_complex_constants_gives_no_power():
    result = make_complex_constants_model(modes((0.0, 250e3)), ComplexConstants(1 / 30, 0.02, 40e3))
    H = result.transfer(np.geomspace(1e-2, 1e9, 100))
    loss = (np.conj(np.swapaxes(H, 1, 2)) - H) / 2j
    size = np.sqrt(np.abs(np.einsum("nii->ni", H)))
    assert np.linalg.eigvalsh(loss / (size[:, :, None] * size[:, None, :])).min() > -1e-12
    assert (result.poles().real < 0).all()
    assert np.linalg.eigvalsh(result.D).min() >= 0


def test_losses_that_leave_no_capacitance_are_refused():
    with pytest.raises(UsageError, match="losses are too large"):
        make_complex_constants_model(modes((0.0, 250e3)), ComplexConstants(0.9, 0.9, 40e3))


DISC = {
    "title": "free disc with one Q for all modes",
    "disc": {
        "part": "disc",
        "damping": {"quality": 80, "model": "ieee176"},
        "pins": {"anode": "drive.out"},
        "layers": [{"diameter": "20 mm", "thickness": "0.5 mm", "material": "PZT-5H"}],
    },
    "drive": {"part": "source", "ac": "1 V"},
    "analysis": {"type": "ac", "start": "60 kHz", "stop": "300 kHz", "points": 1500},
}


def half_width(f, G):
    """Q of the highest peak of a conductance, above the line between the ends of the samples."""
    G = G - np.interp(f, f[[0, -1]], G[[0, -1]])
    top = int(G.argmax())
    rise = np.interp(G[top] / 2, G[: top + 1], f[: top + 1])
    fall = np.interp(-G[top] / 2, -G[top:], f[top:])
    return f[top] / (fall - rise)


def test_a_run_has_one_q_for_all_modes_and_the_tangent_at_rest():
    """First and second radial mode in ngspice; viscous damping has 80 and 31."""
    waves = kc.run(DISC).waves
    f, Y = waves["frequency"].real, waves["disc.current"] / waves["disc.voltage"]
    first, second = f < 140e3, (f > 230e3) & (f < 290e3)
    for part in (first, second):
        assert half_width(f[part], Y.real[part]) == pytest.approx(80, rel=0.1)
    damping = {"quality": 80, "loss_tangent": 0.02, "model": "ieee176"}
    low = {"type": "ac", "start": "500 Hz", "stop": "2 kHz", "points": 20}
    waves = kc.run({**DISC, "disc": {**DISC["disc"], "damping": damping}, "analysis": low}).waves
    Y = waves["disc.current"] / waves["disc.voltage"]
    at = int(np.argmin(np.abs(waves["frequency"] - 1e3)))
    assert Y[at].real / Y[at].imag == pytest.approx(0.02, rel=0.02)


@pytest.mark.parametrize(
    "other", [{"per_material": True}, {"alpha": 10.0}, {"ratio": [0.01, 0.02], "at": [1e3, 2e3]}]
)
def test_keys_of_viscous_damping_are_refused(other):
    with pytest.raises(UsageError, match="rayleigh"):
        kc.load_scene({**DISC, "disc": {**DISC["disc"], "damping": {"model": "ieee176", **other}}})


def test_a_body_without_complex_constants_is_an_error():
    scene = kc.load_scene(DISC)
    with pytest.warns(UserWarning, match="ieee176: the matrices of disc contain viscous"):
        kc.build(scene)
    box = {"disc.rom.parameters": {"damping.quality": [50.0, 90.0]}}
    with pytest.raises(UsageError, match="viscous damping"):
        build_models(kc.load_scene(DISC, box), StageTimer(ignore_progress))
