"""Tolerance in, order out: errors against the full model, estimates against errors."""

from functools import cache

import numpy as np
import pytest

from kc2spice.core.errors import SimulationError
from kc2spice.fem.piezo.assembly import assemble_kick
from kc2spice.fem.piezo.contact import contact_surface
from kc2spice.fem.piezo.harmonic import harmonic
from kc2spice.fem.piezo.transient import Ball, kick_pulse, transient
from kc2spice.rom.compress import directions, krylov_model
from kc2spice.rom.krylov import block_arnoldi
from kc2spice.rom.meshstudy import as_system, on_reduced
from kc2spice.rom.modal import resonators
from kc2spice.rom.project import project, project_again
from kc2spice.rom.reduce import reduce_condensed
from kc2spice.rom.residual import ResidualEstimator
from kc2spice.rom.response import frequency_response, relative_error
from kc2spice.rom.schur import condense
from kc2spice.scene.schema import Contact, Drive, Kick, Rom, Sphere

SMALL = {"sectors": 4, "rings": 2, "ring_spacing": 300e-6, "outer_rings": 2}
MASS = Sphere().mass / 4


@pytest.fixture(scope="module")
def default():
    return condense(assemble_kick(Kick()))


@pytest.fixture(scope="module")
def truth(default):
    """Ten Krylov blocks equal the full model to 1e-12 up to 500 kHz (checked with the stand-in)."""
    V = block_arnoldi(default.stiffness, default.solve, default.mass, default.B, 70)
    frequency = np.linspace(0, 500e3, 463)
    return frequency, frequency_response(project(default, V), frequency)


@cache
def small(layers: int, ratio: float, **change):
    kick = Kick(layers=layers, mesh={**SMALL, **change}, damping={"ratio": ratio})
    return condense(assemble_kick(kick))


@pytest.mark.parametrize(("tolerance", "states"), [(1e-3, 13), (1e-5, 16), (2e-7, 20), (1e-10, 33)])
def test_few_states_reach_the_tolerance(default, truth, tolerance, states):
    frequency, exact = truth
    rom = reduce_condensed(default, Rom(tolerance=tolerance))
    error = relative_error(frequency_response(rom, frequency), exact)
    assert rom.order <= states
    assert error <= 1.05 * tolerance  # between the frequencies where the estimate looked
    assert 0.5 < rom.certificate.error_estimate / error < 10
    assert rom.certificate.stable
    assert rom.certificate.passive
    static = default.B.T @ default.solve(default.B) + default.D
    np.testing.assert_allclose(frequency_response(rom, [0.0])[0].real, static, rtol=1e-10)
    assert resonators(rom).order == rom.order


def test_static_gains_are_exact_at_every_order(default):
    """Those of the exact potentials and ring loads, with every road's basis."""
    static = default.B.T @ default.solve(default.B) + default.D
    frequency = np.linspace(0.0, 500e3, 101)
    large, _ = krylov_model(default, frequency, 1e-9)
    ordered = directions(large, (0.0, 500e3), 2e-7)
    V = block_arnoldi(default.stiffness, default.solve, default.mass, default.B, 42)
    paper = project(default, V)
    for order in range(7, 43):
        for rom in (
            project_again(large, ordered[:, :order]),
            project_again(paper, np.eye(paper.order)[:, :order]),
        ):
            gain = frequency_response(rom, [0.0])[0].real
            assert np.abs(gain / static - 1).max() < 1e-10


def test_twenty_states_launch_the_sphere_as_the_full_model_does(default):
    """Same steps on both, so the reduction alone differs."""
    rom = reduce_condensed(default, Rom(tolerance=2e-7))
    surface = contact_surface(Kick(), Contact(), Sphere())
    full = default.system
    reduced, reduced_surface = as_system(rom, full), on_reduced(surface, rom)
    launch = [
        transient(
            system, contact, Ball(MASS, 0.0, 0.0, 9.81), step=20e-9, stop=6.2e-6,
            voltage=kick_pulse(Drive()), resting=True,
        ).velocity[-1]
        for system, contact in ((full, surface), (reduced, reduced_surface))
    ]  # fmt: skip
    assert rom.order <= 22
    assert launch[1] == pytest.approx(launch[0], rel=5e-4)


CASES = [
    (layers, ratio, change, band, tolerance)
    for layers, ratio, change in (
        (3, 0.01, ()), (5, 0.05, ()), (3, 0.002, (("refine", 2),)), (2, 0.01, (("order", 2),)),
    )
    for band in ((0.0, 500e3), (100e3, 900e3))
    for tolerance in (1e-3, 1e-6, 1e-9)
]  # fmt: skip


def notches(rom, band):
    """Where any entry's magnitude has a local minimum: relative errors are largest there."""
    frequency = np.linspace(*band, 801)
    size = np.abs(frequency_response(rom, frequency))
    lowest = (size[1:-1] < size[:-2]) & (size[1:-1] < size[2:])
    return frequency[1:-1][lowest.any(axis=(1, 2))]


@pytest.mark.parametrize(("layers", "ratio", "change", "band", "tolerance"), CASES)
def test_estimate_follows_the_true_error(layers, ratio, change, band, tolerance):
    """Never below the error by more than 2, never above by more than 10; direct solves judge."""
    model = small(layers, ratio, **dict(change))
    rom = reduce_condensed(model, Rom(tolerance=tolerance, band=band))
    frequency = np.union1d(np.linspace(*band, 19), notches(rom, band))
    error = relative_error(frequency_response(rom, frequency), harmonic(model.system, frequency))
    assert error <= 1.2 * tolerance
    assert rom.certificate.error_estimate <= tolerance
    assert 0.5 < rom.certificate.error_estimate / error < 10
    assert rom.certificate.passive


def test_residual_estimate_is_close_to_the_error(default, truth):
    frequency, exact = truth
    V = block_arnoldi(default.stiffness, default.solve, default.mass, default.B, 42)
    for order in (21, 28, 35):
        rom = project(default, V[:, :order])
        error = exact - frequency_response(rom, frequency)
        estimate = ResidualEstimator(default, V[:, :order]).error(rom, frequency)
        assert 0.5 < np.abs(estimate / exact).max() / np.abs(error / exact).max() < 2


def test_wide_bands_get_other_expansion_points():
    model = small(3, 0.01)
    frequency = np.linspace(2e6, 4e6, 41)
    large, residual = krylov_model(model, frequency, 1e-6)
    error = relative_error(frequency_response(large, frequency), harmonic(model.system, frequency))
    assert error < 1e-4
    assert residual <= 1e-6


def test_unreachable_tolerance_is_refused():
    with pytest.raises(SimulationError, match="out of reach"):
        reduce_condensed(small(3, 0.01), Rom(tolerance=1e-18))
