"""Reduction of the kick actuator against the unreduced model and exact properties."""

from functools import cache

import numpy as np
import pytest
from scipy.sparse import block_array, csc_array
from scipy.sparse.linalg import splu

from kc2spice.bodies.device import Device
from kc2spice.bodies.piezo_stack import stack_device
from kc2spice.core.errors import UsageError
from kc2spice.fem.piezo.keys import Chip
from kc2spice.parts.contact import ContactKeys
from kc2spice.parts.piezo_stack import Drive
from kc2spice.parts.sphere import SphereKeys
from kc2spice.rom.modal import resonators
from kc2spice.rom.reduce import reduce
from kc2spice.rom.response import relative_error
from laboratory.usual.contact import as_system, contact_surface, on_reduced
from laboratory.usual.system import PiezoSystem, quarter_of
from laboratory.usual.transient import Ball, transient

SMALL = {"sectors": 4, "rings": 2, "ring_spacing": 300e-6, "outer_rings": 2}
MASS = SphereKeys().mass / 4
PULSE = Drive(start=0.0).waveform
SMALL_VARIANTS = [{}, {"refine": 2}, {"order": 2}]


@cache
def small(**change) -> Device:
    return stack_device(Chip(layers=3, mesh={**SMALL, **change}))


BAND = (0.0, 500e3)


@pytest.fixture(scope="module")
def device():
    return stack_device(Chip())


@pytest.fixture(scope="module")
def default(device):
    return device.model


@pytest.fixture(scope="module")
def sector(device):
    return quarter_of(device)


def whole(response):
    """From the response of one of four sectors to that of the device."""
    root = np.r_[np.full(response.shape[-1] - 1, 0.5), 2.0]
    return response * np.outer(root, root)


def full_response(system: PiezoSystem, frequency: float) -> np.ndarray:
    """Ring and anode response by one direct complex solve with all potentials kept (oracle).

    The damping force is beta K u' with K the condensed stiffness: a potential q of its own, driven
    by u', carries the part of K that comes from the potentials.
    """
    s, volt = 2j * np.pi * frequency, 1e9
    n, m = system.M.shape[0], system.K_pp.shape[0]
    damped = 1 + s * system.beta
    K_up, K_pp = system.K_up * volt, system.K_pp * volt**2
    dynamic = s**2 * system.M + s * system.alpha * system.M + damped * system.K_uu
    rhs = np.zeros((n + 2 * m, len(system.ports)), dtype=complex)
    rhs[:n, :-1] = system.B
    rhs[:n, -1] = -system.k_uV
    if m:
        # p = p(V) + p(u): the first is instantaneous, the second damped like every strain.
        rhs[n : n + m, -1] = system.k_pV * volt
        blocks = [
            [dynamic, K_up, damped * K_up],
            [None, -K_pp, None],
            [K_up.T, None, -K_pp],
        ]
        matrix = block_array(blocks, format="csc")
    else:
        matrix, rhs = csc_array(dynamic), rhs[:n]
    if m:
        x = splu(matrix).solve(rhs)
    else:
        x = splu(
            matrix,
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        ).solve(rhs)
    u, p = x[:n], volt * (x[n : n + m] + x[n + m :])
    charge = system.k_pV @ p - system.k_uV @ u
    charge[-1] += system.c_VV
    return np.vstack([system.B.T @ u, charge])


@pytest.fixture(scope="module")
def direct(sector):
    """One sector of the default chip at 480 kHz."""
    return full_response(sector, 480e3)


@pytest.mark.slow
def test_default_model_follows_the_direct_solution_within_its_certificate(direct, default):
    full = whole(direct[None])
    rom = reduce(default, order=30, band=BAND)
    assert rom.order == 30
    error = relative_error(rom.transfer([480e3]), full)
    assert error < 1.5 * rom.certificate.error_estimate < 2e-3
    assert relative_error(full, full.transpose(0, 2, 1)) < 1e-9  # reciprocity of the full model


@pytest.mark.slow
def test_estimate_agrees_with_the_true_error(default):
    frequency = np.linspace(0, 500e3, 301)[1:]
    truth = reduce(default, order=63, band=BAND).transfer(frequency)
    for order in (21, 28, 30, 35, 42):
        rom = reduce(default, order=order, band=BAND)
        error = relative_error(rom.transfer(frequency), truth)
        assert 0.5 < rom.certificate.error_estimate / error < 2


@pytest.fixture(scope="module")
def model():
    return small(refine=2).model


@pytest.mark.parametrize("order", [1, 5, 9, 20, 40])
def test_every_order_is_symmetric_stable_passive_and_exact_at_rest(model, order):
    """The static answers of all ports are in the basis from the order of their number on."""
    rom = reduce(model, order=order, band=BAND)
    assert rom.order == order
    assert rom.certificate.stable
    assert rom.certificate.passive
    for matrix in (rom.M, rom.E, rom.K):
        np.testing.assert_array_equal(matrix, matrix.T)
        assert np.linalg.eigvalsh(matrix)[0] > 0
    response = rom.transfer(np.linspace(1e3, 2e6, 50))
    np.testing.assert_allclose(
        response, response.transpose(0, 2, 1), atol=1e-12 * np.abs(response).max()
    )
    if order >= len(model.ports):
        static = model.B.T @ model.pencil.pencil_solver(0.0).solve(model.B) + model.D
        np.testing.assert_allclose(rom.transfer([0.0])[0].real, static, rtol=1e-10)


@pytest.mark.slow
def test_facts_of_the_default_chip(default):
    facts = default.facts
    assert facts["unknowns"] == 16722
    assert facts["mass_kg"] == pytest.approx(7700 * 3e-3 * 3e-3 * 2e-3, rel=1e-12)
    # Closed forms 33 V d33 and eps A 33^2 / h; the resonances are those of this mesh family.
    assert facts["free_stroke_ring0_m_per_100v"] == pytest.approx(2.3508e-6, rel=1e-4)
    assert facts["capacitance_free_f"] == pytest.approx(143.19e-9, rel=1e-4)
    assert facts["capacitance_clamped_f"] == pytest.approx(34.87e-9, rel=5e-4)
    assert facts["resonance_short_hz"] == pytest.approx(270.4e3, rel=5e-3)
    assert facts["resonance_open_hz"] == pytest.approx(365.7e3, rel=5e-3)


@pytest.fixture(scope="module")
def truth(default):
    """Ten Krylov blocks equal the full model to 1e-12 up to 500 kHz (surrogate)."""
    frequency = np.linspace(0, 500e3, 463)
    return frequency, reduce(default, order=70, band=BAND).transfer(frequency)


def velocity(system, surface):
    """Of a kicked sphere, after the contact."""
    return transient(
        system, surface, Ball(MASS, 0.0, 0.0, 9.81), step=20e-9, stop=6.2e-6,
        voltage=lambda t: float(PULSE(t)), resting=True,
    ).velocity[-1]  # fmt: skip


@pytest.fixture(scope="module")
def launched(sector):
    """The assembled chip, its contact surface, and the launch with it."""
    surface = contact_surface(Chip(), ContactKeys().penalty, SphereKeys().radius)
    return sector, surface, velocity(sector, surface)


@pytest.mark.slow
@pytest.mark.parametrize(("tolerance", "states"), [(1e-3, 13), (1e-5, 20), (2e-7, 30), (1e-10, 39)])
def test_few_states_reach_the_tolerance(default, truth, tolerance, states):
    frequency, exact = truth
    rom = reduce(default, tolerance=tolerance, band=BAND)
    error = relative_error(rom.transfer(frequency), exact)
    assert rom.order <= states
    assert error <= rom.certificate.error_estimate <= tolerance
    assert rom.certificate.error_estimate / error < 10
    assert rom.certificate.stable
    assert rom.certificate.passive
    static = default.B.T @ default.pencil.pencil_solver(0.0).solve(default.B) + default.D
    np.testing.assert_allclose(rom.transfer([0.0])[0].real, static, rtol=1e-10)
    assert resonators(rom).order == rom.order


@pytest.mark.slow
@pytest.mark.parametrize(("tolerance", "states"), [(1e-5, 20), (2e-7, 30)])
def test_few_states_launch_the_sphere_as_the_full_model_does(default, launched, tolerance, states):
    """Same steps on both, so the reduction alone differs."""
    full, surface, launch = launched
    rom = reduce(default, tolerance=tolerance, band=BAND)
    assert rom.order <= states
    found = velocity(as_system(rom, full), on_reduced(surface, rom))
    assert found == pytest.approx(launch, rel=3e-4)  # measured 1.5e-4


def test_unreachable_tolerance_is_refused():
    with pytest.raises(UsageError, match="certified"):
        reduce(small().model, tolerance=1e-18, band=BAND)
