"""Structural damping of one oscillator in closed form, and ladders with real poles only."""

import warnings

import numpy as np
import pytest
import scipy
from support import (
    LinearModel,
    Port,
    UsageError,
    assemble_oscillators,
    fit_relaxing_oscillator,
    make_viscous_oscillator,
    reduce_model,
    subcircuit,
)


def test_one_oscillator_has_its_loss_at_resonance():
    """``1 / (k (1 + j eta) - m w^2)`` is ``1 / (j eta k)`` there."""
    k, m, eta = 4e4, 1e-2, 0.03
    model = LinearModel(M=np.eye(1) * m, K=np.eye(1) * k * (1 + 1j * eta), B=np.eye(1))
    resonance = np.sqrt(k / m) / (2 * np.pi)
    assert model.transfer([resonance])[0, 0, 0] == pytest.approx(1 / (1j * eta * k))
    with pytest.warns(
        UserWarning, match="no causal model has structural damping of 0.03 at all frequencies"
    ):
        rom = reduce_model(model, tolerance=1e-4, band=(0.0, 2 * resonance), norm="pointwise")
    assert rom.transfer([resonance])[0, 0, 0] == pytest.approx(1 / (1j * eta * k), rel=1e-6)
    frequency = np.linspace(0.01, 1.99, 199) * resonance
    w = 2 * np.pi * frequency
    exact = 1 / (k * (1 + 1j * eta) - m * w**2)
    error = np.abs(rom.transfer(frequency)[:, 0, 0] / exact - 1).max()
    assert 0.5 * eta < error <= rom.certificate.error_estimate <= 1.3 * eta
    assert rom.certificate.passive


def test_an_imaginary_part_that_is_no_loss_is_refused():
    K = np.diag([1.0, 2.0])
    one_sided = np.array([[0.1, 0.05], [0.0, 0.1]])
    for bad in (K * (1 - 0.1j), K + 1j * np.diag([0.1, -0.1]), K + 1j * one_sided):
        with pytest.raises(UsageError, match="matrix K is not a valid structural damping"):
            LinearModel(M=np.eye(2), K=bad, B=np.eye(2))
    for bad in (-0.1, np.nan, "much"):
        with pytest.raises(UsageError, match="the loss factor is not a valid structural damping"):
            LinearModel(M=np.eye(2), K=K, B=np.eye(2), loss_factor=bad)
    with pytest.raises(UsageError, match="defined twice"):
        LinearModel(M=np.eye(2), K=K * (1 + 0.1j), B=np.eye(2), loss_factor=0.1)
    with pytest.raises(UsageError, match="second-order models"):
        LinearModel(E=np.eye(2), K=K * (1 + 0.1j), B=np.eye(2))
    for loss in (0.1 * K, np.diag([0.1, 0.1])):
        model = LinearModel(M=np.eye(2), K=K + 1j * loss, B=np.eye(2))
        with pytest.raises(UsageError, match="no state-space form"):
            model.state_space()
        with pytest.raises(UsageError, match="cannot be reduced to a prescribed order"):
            reduce_model(model, order=1, band=(0.0, 1.0))
    model = LinearModel(M=np.eye(2), E=np.diag([0.1, 0.3]), K=K + 0.1j * np.eye(2), B=np.eye(2))
    with pytest.raises(
        UsageError, match="several materials cannot be combined with a damping matrix"
    ):
        reduce_model(model, tolerance=1e-3, band=(0.0, 1.0))


def bar(n, loss):
    """M, K and its loss of n masses in a row, and their lower natural frequencies [Hz]; the loss
    factor of each spring is ``loss``."""
    K, H = np.zeros((n, n)), np.zeros((n, n))
    for k, eta in enumerate(np.broadcast_to(loss, n)):
        stretch = np.zeros((1, n))
        stretch[0, k] = 1.0
        if k:
            stretch[0, k - 1] = -1.0
        spring = 1e6 * stretch.T @ stretch
        K, H = K + spring, H + eta * spring
    M = 1e-2 * np.eye(n)
    return M, K, H, np.sqrt(np.linalg.eigvalsh(K) / 1e-2) / (2 * np.pi)


def largest_error(rom, parts, band, modes):
    """Of a reduced model, relative to peaks, against the solutions with the complex stiffness."""
    M, K, H, B = parts
    near = modes[(modes > band[0]) & (modes < band[1])]
    f = np.unique(np.r_[np.linspace(max(band[0], 0.01), band[1], 300), near, 1.01 * near])
    f = f[f <= band[1]]
    exact = np.array([B.T @ np.linalg.solve(K + 1j * H - (2 * np.pi * x) ** 2 * M, B) for x in f])
    return (np.abs(rom.transfer(f) - exact) / np.abs(exact).max(axis=0)).max()


@pytest.mark.parametrize(
    ("eta", "band", "most"),
    [(0.02, (0.0, 900.0), 2e-3), (1e-3, (0.0, 900.0), 1e-4), (0.02, (200.0, 300.0), 3e-4)],
)
def test_relaxations_bring_a_model_nearer_than_its_loss_factor(eta, band, most):
    """Dashpots alone differ by a quarter of eta beside each resonance."""
    n = 40
    M, K, H, modes = bar(n, eta)
    B = np.eye(n)[:, [5, 30]]
    model = LinearModel(M=M, K=K + 1j * H, B=B)
    assert model.loss_factor == pytest.approx(eta, rel=1e-12)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore" if most > 1e-4 else "error")
        rom = reduce_model(model, tolerance=1e-4, band=band, norm="peak")
    error = largest_error(rom, (M, K, H, B), band, modes)
    assert error <= rom.certificate.error_estimate <= most
    assert rom.certificate.passive
    assert rom.certificate.stable
    assert rom.poles().real.max() < 0
    f = np.geomspace(1, 1e5, 80)
    velocity = 2j * np.pi * f[:, None, None] * rom.transfer(f)  # no port delivers net energy
    assert np.linalg.eigvalsh(velocity + velocity.conj().swapaxes(1, 2)).min() >= 0
    subcircuit(rom, "bar")


@pytest.mark.filterwarnings("ignore:no causal model")
def test_a_band_far_above_the_resonances_includes_the_loss_at_rest():
    n, band = 20, (0.0, 500e3)
    M, K, H, modes = bar(n, 0.01)
    B = np.eye(n)[:, [n - 1]]
    rom = reduce_model(LinearModel(M=M, K=K + 1j * H, B=B), tolerance=1e-4, band=band, norm="peak")
    slow = np.array([1e-3, 1.0, 20.0])
    exact = np.array(
        [B.T @ np.linalg.solve(K + 1j * H - (2 * np.pi * f) ** 2 * M, B) for f in slow]
    )
    peak = np.abs(B.T @ np.linalg.solve(K + 1j * H - (2 * np.pi * modes[0]) ** 2 * M, B))
    error = (np.abs(rom.transfer(slow) - exact) / peak).max()
    assert error <= rom.certificate.error_estimate < 2e-4


@pytest.mark.filterwarnings("ignore:no causal model")
@pytest.mark.parametrize("form", [np.asarray, scipy.sparse.csc_matrix])
def test_losses_of_several_materials_make_a_passive_model_of_known_error(form):
    n, band = 40, (0.0, 900.0)
    M, K, H, modes = bar(n, np.where(np.arange(n) < 15, 0.02, 0.002))
    B = np.eye(n)[:, [5, 30]]
    model = LinearModel(M=form(M), K=form(K + 1j * H), B=B)
    assert model.loss_factor == 0
    rom = reduce_model(model, tolerance=1e-4, band=band, norm="peak")
    error = largest_error(rom, (M, K, H, B), band, modes)
    assert error <= rom.certificate.error_estimate <= 7e-3
    assert rom.certificate.passive
    low = modes[:2]  # the peaks of the lowest modes are those of their own loss
    peaks = [B.T @ np.linalg.solve(K + 1j * H - (2 * np.pi * x) ** 2 * M, B) for x in low]
    assert np.abs(np.abs(rom.transfer(low)) / np.abs(peaks) - 1).max() < 2e-3


def test_an_oscillator_with_one_relaxation_is_exact_in_value_and_slope():
    k, eta = 4e4, 0.01
    s = 1j * np.sqrt(k) * np.unique(np.r_[np.linspace(0.01, 2, 200), np.linspace(0.9, 1.1, 201)])
    wanted = k * (1 + 1j * eta) + s**2
    mode = fit_relaxing_oscillator(s, wanted, 1 / np.abs(wanted) ** 2, np.sqrt([k]))
    assert mode.spring == pytest.approx(k * (1 - eta / 2), rel=1e-3)
    assert mode.mass == pytest.approx(1 + eta / 2, rel=1e-3)
    assert mode.amplitudes == pytest.approx([2 * eta * k], rel=0.05)
    K, E, M = assemble_oscillators([mode], np.zeros((1, 1)))
    at = s[::40]
    condensed = [1 / np.linalg.inv(K + x * E + x**2 * M)[0, 0] for x in at]
    assert mode(at) == pytest.approx(np.array(condensed), rel=1e-9)
    assert np.abs(1 / mode(s) - 1 / wanted).max() * eta * k < 1.5 * eta**2
    viscous = make_viscous_oscillator(k, eta * k)
    assert np.abs(1 / viscous(s) - 1 / wanted).max() * eta * k > 0.2 * eta


@pytest.mark.parametrize("kind", ["signal", "mechanical"])
def test_a_ladder_of_real_poles_becomes_a_passive_model_of_first_order(kind):
    """An RC ladder written in second order, or overdamped masses: inertia 1e-9 does nothing."""
    n = 60
    K = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    K[-1, -1] = 1.0
    ports = (Port("tip", "mechanical"),) if kind == "mechanical" else ()
    full = LinearModel(M=1e-9 * np.eye(n), E=np.eye(n), K=K, B=np.eye(n)[:, [0]], ports=ports)
    rom = reduce_model(full, tolerance=1e-4, band=(0.0, 0.1), norm="peak")
    assert rom.first_order
    # In second order 16 states. Conservative ports keep their static answer exactly.
    assert rom.order == (7 if kind == "signal" else 8)
    assert rom.certificate.passive
    values, X = np.linalg.eigh(K)
    frequency = np.r_[0.0, np.geomspace(1e-5, 0.1, 100)]
    s = 2j * np.pi * frequency[:, None]
    exact = (X[0] ** 2 / (s + values)).sum(axis=1)
    error = np.abs(rom.transfer(frequency)[:, 0, 0] - exact).max() / np.abs(exact).max()
    assert error <= rom.certificate.error_estimate <= 1e-4
    subcircuit(rom, "ladder")
    parts = rom.pencil.make_dense().coefficients
    assert all(np.array_equal(P, P.T) for P in parts)
    assert all(np.linalg.eigvalsh(P)[0] > 0 for P in parts)
    heavy = LinearModel(M=np.eye(n), E=0.1 * np.eye(n), K=K, B=np.eye(n)[:, [0]], ports=ports)
    ringing = reduce_model(heavy, tolerance=1e-2, band=(0.0, 0.1), norm="peak")
    assert "without inertia" not in ringing.certificate.method
    assert np.abs(ringing.poles().imag).max() > 0


@pytest.mark.parametrize("tolerance", [1e-2, 2e-3, 1e-3, 1e-4, 1e-5])
def test_a_ladder_needs_one_state_more_than_the_bound_of_all_methods(tolerance):
    """No model of q states is closer over all frequencies than the next Hankel singular value.

    The band ends at 47 times the highest rate of the ladder, so it contains all frequencies at
    which the response is not negligible.
    """
    n = 60
    K = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    K[-1, -1] = 1.0
    B = np.eye(n)[:, :1]
    full = LinearModel(M=1e-9 * np.eye(n), E=np.eye(n), K=K, B=B)
    rom = reduce_model(full, tolerance=tolerance, band=(0.0, 30.0), norm="peak")
    peak = np.linalg.solve(K, B)[0, 0]
    hankel = np.linalg.eigvalsh(scipy.linalg.solve_continuous_lyapunov(-K, -B @ B.T))[::-1] / peak
    least = int((hankel > tolerance).sum())
    assert rom.first_order
    assert rom.certificate.passive
    assert least <= rom.order <= least + 1
    values, X = np.linalg.eigh(K)
    frequency = np.r_[0.0, np.geomspace(1e-5, 30.0, 300)]
    exact = (X[0] ** 2 / (2j * np.pi * frequency[:, None] + values)).sum(axis=1)
    error = np.abs(rom.transfer(frequency)[:, 0, 0] - exact).max() / peak
    assert error <= rom.certificate.error_estimate <= tolerance


def test_a_mass_without_effect_on_a_ladder_refuses_nothing():
    """An RC ladder with masses of 1e-30, whose poles of 1e21 1/s no Gramian can represent."""
    n = 50
    K = 1e-3 * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    full = LinearModel(M=1e-30 * np.eye(n), E=1e-9 * np.eye(n), K=K, B=np.eye(n)[:, [0]])
    rom = reduce_model(full, tolerance=1e-3, band=(0.0, 1e4), norm="peak")
    values, X = np.linalg.eigh(K)
    frequency = np.linspace(0.0, 1e4, 100)
    s = 2j * np.pi * frequency[:, None]
    exact = (X[0] ** 2 / (1e-9 * s + values)).sum(axis=1)
    error = np.abs(rom.transfer(frequency)[:, 0, 0] - exact).max() / np.abs(exact).max()
    assert error <= rom.certificate.error_estimate <= 1e-3


@pytest.mark.parametrize(("tolerance", "states"), [(1e-2, 6), (1e-3, 8), (1e-4, 11)])
def test_two_ports_of_a_network_of_resistors_and_capacitors_stay_passive(tolerance, states):
    """In first order. Balanced truncation has 8, 11 and 13 states, and is not passive by its form.
    Real parts of the impedances at all frequencies show that the fit of rates and gains is."""
    n, rng = 40, np.random.default_rng(3)
    K = np.diag(rng.uniform(0.01, 0.1, n))
    for k in range(n - 1):
        K[k : k + 2, k : k + 2] += rng.uniform(0.5, 2) * np.array([[1, -1], [-1, 1]])
    E, B = np.diag(rng.uniform(0.5, 2, n)), np.eye(n)[:, [0, n // 2]]
    rom = reduce_model(
        LinearModel(E=E, K=K, B=B), tolerance=tolerance, band=(0.0, 0.3), norm="peak"
    )
    assert rom.first_order
    assert rom.certificate.passive
    frequency = np.r_[0.0, np.geomspace(1e-5, 0.3, 150)]
    exact = np.array([B.T @ np.linalg.solve(K + 2j * np.pi * f * E, B) for f in frequency])
    error = (np.abs(rom.transfer(frequency) - exact) / np.abs(exact).max(axis=0)).max()
    assert error <= rom.certificate.error_estimate <= tolerance
    wide = rom.transfer(np.geomspace(1e-6, 1e3, 60))
    assert np.linalg.eigvalsh(wide.real).min() > 0
    assert rom.poles().real.max() < 0
    assert np.abs(rom.poles().imag).max() == 0
    assert rom.order == states


def supported_chain(n, support, where):
    """Masses of 10 g between springs of 1e6 N/m, held softly at the first one or at all."""
    K = 1e6 * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    K[0, 0] = K[-1, -1] = 1e6
    elastic, X = np.linalg.eigh(K)
    ground = np.zeros(n)
    ground[: 1 if where == "end" else n] = support
    held = scipy.sparse.csc_array(K + np.diag(ground))
    mass = 1e-2 * scipy.sparse.eye_array(n, format="csc")
    model = LinearModel(M=mass, rayleigh=(0.0, 1e-6), K=held, B=np.eye(n)[:, [5]])

    def exact(f):
        """Rigid body on its support and elastic modes of the free chain."""
        w = 2 * np.pi * np.asarray(f)[:, None]
        rest = (X[5, 1:] ** 2 / (elastic[1:] * (1 + 1e-6j * w) - 1e-2 * w**2)).sum(axis=1)
        return 1 / (ground.sum() * (1 + 1e-6j * w[:, 0]) - n * 1e-2 * w[:, 0] ** 2) + rest

    return model, exact, np.sqrt(ground.sum() / (n * 1e-2)) / (2 * np.pi)


@pytest.mark.filterwarnings("ignore:its own response is uncertain")
@pytest.mark.parametrize(
    ("n", "support", "where"), [(40, 1e-6, "end"), (40, 3e-8, "all"), (1400, 3e-8, "end")]
)
def test_a_support_above_rounding_is_kept(n, support, where):
    """3e-14 of the stiffness, dense and sparse: far below the resonance the support alone holds."""
    model, exact, resonance = supported_chain(n, support, where)
    rom = reduce_model(model, tolerance=1e-4, band=(0.0, 20.0), norm="peak")
    f = resonance * np.array([0.0, 0.1, 0.5, 2.0, 10.0])
    assert np.abs(rom.transfer(f)[:, 0, 0] / exact(f) - 1).max() < 0.01
    assert "free to move" not in rom.certificate.method


@pytest.mark.filterwarnings("ignore:the full model itself is only good")
@pytest.mark.parametrize(("support", "where"), [(3e-8, "end"), (1e-9, "all")])
def test_a_support_that_rounding_hides_is_left_out_with_a_warning(support, where):
    """Rounding of all entries at random is a tenth of its stiffness: the response far below its
    resonance is not known. The warning has the resonance, and above it the response is right."""
    model, exact, resonance = supported_chain(40, support, where)
    with pytest.warns(UserWarning, match="the stiffness of a support is below") as caught:
        rom = reduce_model(model, tolerance=1e-4, band=(0.0, 20.0), norm="peak")
    text = next(str(w.message) for w in caught if "stiffness of a support" in str(w.message))
    stated = float(text.split("at about ")[1].split(" Hz")[0])
    assert stated == pytest.approx(resonance, rel=0.1)
    f = np.array([100 * resonance, 1.0, 10.0])
    assert np.abs(rom.transfer(f)[:, 0, 0] / exact(f) - 1).max() < 1e-3
    assert "is not detectable because of rounding errors" in rom.certificate.method
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        reduce_model(model, tolerance=1e-4, band=(1.0, 20.0), norm="peak")


def test_a_free_body_states_which_supports_rounding_hides():
    model, exact, _ = supported_chain(40, 0.0, "all")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        rom = reduce_model(model, tolerance=1e-4, band=(0.0, 20.0), norm="peak")
    assert "a support with a resonance below 8.0e-05 Hz" in rom.certificate.method
    f = np.array([1e-4, 1e-2, 1.0, 10.0])
    assert np.abs(rom.transfer(f)[:, 0, 0] / exact(f) - 1).max() < 1e-3
