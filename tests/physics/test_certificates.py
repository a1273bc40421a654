"""Certificates of random models against direct solutions at fine sets of frequencies."""

import time
from dataclasses import replace

import numpy as np
import oracle
import pytest
from mor_families import damped_chain
from scipy import sparse
from support import (
    LinearModel,
    ReductionTask,
    ResponsePod,
    build_intermediate_model,
    certify,
    disc,
    reduce_model,
)

from bench.beam import hermite_beam


def random_case(seed):
    """A model of 10 to 80 unknowns, a band and a tolerance; damping ratios from 1e-6 to 0.1."""
    rng = np.random.default_rng(seed)
    n, ports = int(rng.integers(10, 80)), int(rng.integers(1, 4))
    Q, _ = np.linalg.qr(rng.standard_normal((n, n)))
    omega = np.sort(np.exp(rng.uniform(0, 4, n)))
    ratio = 10 ** rng.uniform(-6, -1)
    damping = 2 * ratio * omega
    if rng.integers(0, 2):
        damping = damping * omega / omega[0]
    root = np.exp(rng.uniform(-1, 1, n))[:, None] * Q
    K, E, M = (root @ np.diag(d) @ root.T for d in (omega**2, damping, np.ones(n)))
    K, E, M = (0.5 * (P + P.T) for P in (K, E, M))
    if rng.integers(0, 3) == 0:  # a dashpot that couples the modes
        E[0, 0] += ratio * np.sqrt(K[0, 0] * M[0, 0])
    B = rng.standard_normal((n, ports))
    C = B.T if rng.integers(0, 2) else rng.standard_normal((2, n))
    band = 0.0, float(omega[int(n * rng.uniform(0.1, 0.6))]) * 1.03 / (2 * np.pi)
    return (M, E, K, B, C), band, 10 ** rng.uniform(-6, -2)


DRAWS = [
    pytest.param(seed, norm, marks=[pytest.mark.slow, pytest.mark.campaign])
    for seed in range(500) for norm in oracle.SHARES
]  # fmt: skip


@pytest.mark.parametrize(
    ("seed", "norm"),
    [(1, "pointwise"), (6, "pointwise"),
     pytest.param(374, "pointwise", marks=pytest.mark.slow), *DRAWS],
)  # fmt: skip
def test_estimate_is_between_the_error_and_three_times_it(seed, norm):
    """And never above the tolerance; 6 has sharp notches, 374 points that rounding sets apart."""
    matrices, band, tolerance = random_case(seed)
    M, E, K, B, C = matrices
    with oracle.bounded():
        model = LinearModel(M=M, E=E, K=K, B=B, C=C)
        rom = reduce_model(model, tolerance=tolerance, band=band, norm=norm)
    full = oracle.system(dict(zip("MEKBC", matrices, strict=True)))
    error = oracle.largest_error(full, oracle.system_of(rom), band, share=oracle.SHARES[norm])
    estimate = rom.certificate.error_estimate
    assert error <= estimate + oracle.ROUNDING, (seed, error, estimate)
    assert estimate <= tolerance, (seed, estimate, tolerance)
    assert estimate <= 3 * error + oracle.ROUNDING, (seed, error, estimate)


@pytest.mark.parametrize(
    ("unknowns", "dashpot", "way"), [(90, 0.0, "compared with all states"),
                                     (310, 0.3, "compared with the full model"),
                                     pytest.param(1310, 0.0, "more", marks=pytest.mark.slow)],
)  # fmt: skip
def test_an_intermediate_model_states_how_far_it_is_from_the_full_model(unknowns, dashpot, way):
    """It stops as early as it may, so that its error is large where it is not all of the model."""
    matrices = damped_chain(unknowns, dashpot, 3.0)
    damping = {} if dashpot else {"E": None, "rayleigh": (0.0, 1e-2)}
    full = LinearModel(**matrices | damping)
    band = 0.0, 10.0 / unknowns / (2 * np.pi)
    intermediate = build_intermediate_model(full.pencil, band, np.inf, np.inf)
    assert intermediate.proof.startswith(way)
    frequency = np.linspace(0.31, 0.97, 4) * band[1]
    exact = oracle.direct(oracle.system(matrices), frequency)
    error = (np.abs(intermediate.pencil.transfer(2j * np.pi * frequency) / exact - 1)).max()
    rounding = (
        1e-11 if way == "compared with all states" else 0.0
    )  # numpy's solution is 4e-12 off, ours 6e-14
    assert 0 < error <= intermediate.error + rounding


def test_error_and_rounding_of_the_intermediate_model_are_in_the_certificate():
    matrices, band, _ = random_case(1)
    M, E, K, B, C = matrices
    full = LinearModel(M=M, E=E, K=K, B=B, C=C)
    intermediate = build_intermediate_model(full.pencil, band, 1e-8, np.inf)
    worse = replace(intermediate, error=2e-3, floor=1e-3)
    basis = ResponsePod(two_sided=True).basis(
        ReductionTask.from_models(full, full.pencil, worse, band, "pointwise")
    )
    estimate = certify(basis, basis.size).certificate.error_estimate
    assert 3e-3 <= estimate < 3.1e-3


def test_the_estimate_covers_rounding_errors_of_a_thin_free_plate():
    """Bending is the small difference of large forces in the plate: 16 digits leave seven."""
    layers = [
        {"material": "brass", "diameter": "20 mm", "thickness": "0.1 mm"},
        {"material": "PZT-5A", "diameter": "14 mm", "thickness": "0.12 mm",
         "electrodes": "12.8 mm"},
    ]  # fmt: skip
    found = disc.make_disc_blocks({"layers": layers, "damping": {"quality": 50}}).build_fe_model()
    full = found.model.select(["anode"])
    rom = reduce_model(full, tolerance=1e-6, band=(288.0, 9600.0))
    pole = full.facts["resonance_short_hz"]
    frequency = pole * np.linspace(0.99, 1.01, 21)
    exact, found = (oracle.direct(oracle.system_of(each), frequency) for each in (full, rom))
    error = (np.abs(found - exact) / np.abs(exact)).max()
    assert 1e-10 < error <= rom.certificate.error_estimate <= 1e-6
    assert np.linalg.eigvalsh(rom.K)[0] > 0  # its electrode does not move the whole plate


@pytest.mark.slow
def test_a_cantilever_of_300_hermite_elements_has_a_valid_error_estimate():
    """Condition 1e10: less than rounding is not certified; the closed form is within the rest."""
    beta = 2 * 0.01 / 3.516
    M, K = (sparse.csc_array(P[2:, 2:]) for P in hermite_beam(300))
    full = LinearModel(M=M, K=K, B=np.eye(600)[:, [-2]], rayleigh=(0.0, beta))
    with pytest.warns(UserWarning, match="response of the full model has an error"):
        near = reduce_model(full, tolerance=1e-6, band=(0.0, 5.0))
    assert near.certificate.error_estimate > 1e-6
    rom = reduce_model(full, tolerance=1e-4, band=(0.0, 5.0))
    frequency = np.linspace(0.05, 5.0, 200)
    w = 2 * np.pi * frequency
    stiff = 1 + 1j * w * beta
    x = (w**2 / stiff) ** 0.25
    shape = np.sin(x) * np.cosh(x) - np.cos(x) * np.sinh(x)
    exact = shape / (stiff * x**3 * (1 + np.cos(x) * np.cosh(x)))
    error = np.abs(rom.transfer(frequency)[:, 0, 0] / exact - 1).max()
    assert 1e-8 < error < rom.certificate.error_estimate < 1e-4


@pytest.mark.slow
def test_chain_of_600_lightly_damped_masses_takes_seconds():
    """Poles of a uniform chain are 2 sqrt(k/m) sin(j pi / (2 (n + 1))): 600 of them in the band."""
    n, k, m, ratio = 600, 4e6, 1e-6, 1e-5
    K = k * sparse.diags_array(
        [-np.ones(n - 1), 2 * np.ones(n), -np.ones(n - 1)], offsets=(-1, 0, 1)
    )
    full = LinearModel(
        M=m * sparse.eye_array(n, format="csc"), K=K.tocsc(), B=np.eye(n)[:, [0, n - 1]],
        rayleigh=(0.0, ratio * np.sqrt(m / k)),
    )  # fmt: skip
    started = time.process_time()
    rom = reduce_model(full, tolerance=1e-4, band=(0.0, 3e5))
    assert time.process_time() - started < 60
    poles = np.sort(np.abs(rom.poles()[rom.poles().imag > 0]))
    exact = 2 * np.sqrt(k / m) * np.sin(np.arange(1, n + 1) * np.pi / (2 * (n + 1)))
    low = exact[exact < 2 * np.pi * 1e5]
    np.testing.assert_allclose(poles[: low.size], low, rtol=1e-6)


@pytest.mark.slow
def test_a_free_chain_stays_free_when_it_is_reduced():
    """Far below the band a chain of masses under a force is their sum: ``x = -F / (n m w^2)``."""
    n, k, m = 310, 4e6, 1e-6
    links = sparse.diags_array([-np.ones(n - 1), np.ones(n)], offsets=(1, 0), shape=(n - 1, n))
    one = sparse.csc_array(([1.0], ([n // 3], [n // 3])), shape=(n - 1, n - 1))
    full = LinearModel(
        M=m * sparse.eye_array(n, format="csc"), K=(k * links.T @ links).tocsc(),
        E=(0.02 * links.T @ one @ links).tocsc(), B=np.eye(n)[:, [0]],
    )  # fmt: skip
    rom = reduce_model(full, tolerance=1e-2, band=(0.0, 4e3))
    frequency = np.array([1e-5, 1e-3, 1e-1])
    found = rom.transfer(frequency)[:, 0, 0] * n * m * (2 * np.pi * frequency) ** 2
    np.testing.assert_allclose(found, -1.0, rtol=1e-3)
