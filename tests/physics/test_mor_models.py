"""Models of other tools: matrices to ROM to subcircuit to ngspice, against the full matrices."""

from functools import cache

import mor_families as families
import numpy as np
import oracle
import pytest
from scipy.linalg import eig
from support import (
    LinearModel,
    ReductionTask,
    ResponsePod,
    UsageError,
    build_intermediate_model,
    reduce_model,
    subcircuit,
)

FAMILIES = {
    "beam": families.beam,
    "triple chain": families.triple_chain,
    "building": families.building,
    "heat rod": families.heat_rod,
    "rotor": families.rotor,
}
FLOOR = 1e-6  # of an entry's peak; below it a relative error says nothing


def built(name):
    matrices, band = FAMILIES[name]()
    return matrices, LinearModel(**families.as_files(matrices), name=name), (0.0, band)


@cache
def reduced(name, tolerance):
    """The model of a family, reduced once for all tests."""
    _, model, band = built(name)
    return reduce_model(model, band=band, tolerance=tolerance)


def worst(found, expected, peak=None):
    """Largest relative error where an entry is above its floor, by its own peak unless told."""
    size = np.abs(expected)
    counted = size > FLOOR * (size.max(axis=0) if peak is None else peak)
    return (np.abs(found - expected)[counted] / size[counted]).max()


@pytest.fixture(scope="module")
def truth():
    """Full responses on a dense grid with the peaks, computed once per family."""
    known = {}

    def get(name):
        if name not in known:
            matrices, _, band = built(name)
            frequency = np.r_[0.0, np.geomspace(1e-4, 1, 40), np.linspace(0.003, 1, 160)] * band[1]
            on = oracle.poles(oracle.system(matrices)[0]).imag / (2 * np.pi)  # largest errors
            frequency = np.union1d(frequency, on[(on > 1e-4 * band[1]) & (on < band[1])])
            known[name] = frequency, families.full_response(matrices, frequency)
        return known[name]

    return get


def test_beam_has_the_textbook_frequencies():
    matrices, _ = families.beam()
    omega = np.sqrt(np.sort(eig(matrices["K"], matrices["M"], right=False).real)[:2])
    assert omega == pytest.approx([1.8751040687**2, 4.6940911330**2], rel=1e-6)


@pytest.mark.parametrize(
    "dense",
    [pytest.param(False, id="blocks"), pytest.param(True, id="dense", marks=pytest.mark.slow)],
)
@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=pytest.mark.slow if n not in ("beam", "building") else ())
     for n in FAMILIES],
)  # fmt: skip
def test_ngspice_runs_the_emitted_subcircuit(name, dense, truth, tmp_path):
    tolerance = 1e-5
    matrices, _, band = built(name)
    rom = reduced(name, tolerance)
    part = subcircuit(rom, "part", dense=dense)
    frequency = np.linspace(band[1] / 80, band[1], 80)
    found = families.spice_response(part, rom.B.shape[1], rom.C.shape[0], frequency, tmp_path)
    own = oracle.direct(oracle.system_of(rom), frequency)
    assert (np.abs(found - own) / np.abs(own).max(axis=0)).max() < 1e-9
    peak = np.abs(truth(name)[1]).max(axis=0)  # 80 frequencies miss it
    assert worst(found, families.full_response(matrices, frequency), peak) <= tolerance


def test_improper_models_are_refused_with_the_reason():
    n = 3
    E = np.diag([1.0, 0.0, 0.0])
    E[1, 2] = 1.0  # x2' = x1 - ..., 0 = x3 - u: the output is the derivative of the input
    A = np.diag([-1.0, 1.0, 1.0])
    matrices = {"A": A, "E": E, "B": np.array([[1.0], [0.0], [1.0]]), "C": np.eye(n)[[1]]}
    model = LinearModel(**families.as_files(matrices), name="index 2")
    with pytest.raises(UsageError, match="derivatives"):
        reduce_model(model, band=(0.01, 0.1), order=3)


def random_model(rng):
    """Order 2 to 200, 1 to 12 ports, damping ratios 0 to 0.5 that couple the modes or not."""
    n = int(np.exp(rng.uniform(np.log(2), np.log(200))))
    ports = int(rng.integers(1, min(12, n) + 1))
    Q, _ = np.linalg.qr(rng.standard_normal((n, n)))
    omega = np.exp(rng.uniform(0, 3, n))
    mass = np.exp(rng.uniform(-2, 2, n))
    root = np.sqrt(mass)[:, None] * Q
    K = root @ np.diag(omega**2) @ root.T
    ratio = rng.uniform(0, 0.5) * rng.integers(0, 2)
    R, _ = np.linalg.qr(rng.standard_normal((n, n))) if rng.integers(0, 2) else (np.eye(n), 0)
    E = root @ R @ np.diag(2 * ratio * omega * rng.uniform(0, 1, n)) @ R.T @ root.T
    B = rng.standard_normal((n, ports))
    symmetric = {"M": np.diag(mass), "E": 0.5 * (E + E.T), "K": 0.5 * (K + K.T), "B": B}
    return symmetric, float(np.quantile(omega, rng.uniform(0.1, 0.9))) / (2 * np.pi)


CAMPAIGN = [pytest.param(k, 1, marks=[pytest.mark.slow, pytest.mark.campaign]) for k in range(500)]


@pytest.mark.parametrize(("seed", "step"), [(0, 7), (1, 7), (2, 7), *CAMPAIGN])
def test_random_models_are_stable_and_passive_at_every_order(seed, step):
    """Poles and power of the reduced models, by eigenvalues that share no code with the product."""
    rng = np.random.default_rng(seed)
    matrices, top = random_model(rng)
    model = LinearModel(**families.as_files(matrices), name="random")
    band = (0.0, top)
    intermediate = build_intermediate_model(model.pencil, band, 1e-5, 1e-5)
    found = ResponsePod().basis(
        ReductionTask.from_models(model, model.pencil, intermediate, band, "pointwise")
    )
    omega = 2 * np.pi * top
    for order in {*range(1, found.size + 1, step), found.size}:
        claim = found.prove_order_stability(order)
        assert claim.stable
        assert claim.passive
        rom = found.pencil.truncate_to_order(order)
        K, E, M = (omega**k * P for k, P in enumerate(rom.coefficients))
        poles = oracle.poles((K, E, M))
        assert (poles.real <= 1e-9 * np.abs(poles)).all()  # rounding of poles on the axis
        s = 1j * np.array([0.1, 0.5, 0.9, 3.0, 30.0])[:, None, None]
        H = rom.C @ np.linalg.solve(s * s * M + s * E + K, rom.B[None])
        power = s * H + (s * H).conj().transpose(0, 2, 1)
        lowest = np.linalg.eigvalsh(power)[:, 0] / np.abs(s * H).max(axis=(1, 2))
        assert lowest.min() >= -1e-9


@pytest.mark.parametrize("name", ["building", pytest.param("heat rod", marks=pytest.mark.slow)])
def test_pymor_agrees_and_does_no_better_at_equal_order(name, truth):
    """pyMOR computes the same responses, of the ROM and of the full model; its balanced truncation
    (of the same structure) is not more accurate in the band with as many states.
    """
    pymor = pytest.importorskip("pymor.models.iosys")
    from pymor.core.logger import set_log_levels
    from pymor.reductors.bt import BTReductor
    from pymor.reductors.sobt import SOBTpvReductor

    set_log_levels({"pymor": "ERROR"})
    matrices, model, band = built(name)
    rom = reduce_model(model, band=band, tolerance=1e-3)
    frequency, expected = truth(name)
    peak = np.abs(expected).max(axis=0)
    if "A" in matrices:
        full = pymor.LTIModel.from_matrices(matrices["A"], matrices["B"], matrices["C"])
        theirs = BTReductor(full).reduce(rom.order)
    else:
        full = pymor.SecondOrderModel.from_matrices(
            *(matrices[k] for k in "MEKB"), Cp=matrices["C"]
        )
        theirs = SOBTpvReductor(full).reduce(rom.order)
    own = oracle.direct(oracle.system_of(rom), frequency)

    def pymor_response(system):
        return np.array([system.transfer_function.eval_tf(2j * np.pi * f) for f in frequency])

    assert (np.abs(pymor_response(full) - expected) / peak).max() < 1e-9
    assert (np.abs(pymor_response(rom.to_pymor()) - own) / peak).max() < 1e-9
    # Balanced truncation spends states on all frequencies, this reduction on the band alone.
    assert (np.abs(own - expected) / peak).max() <= (
        np.abs(pymor_response(theirs) - expected) / peak
    ).max()
