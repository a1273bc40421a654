"""Tolerance in, order out: errors against the full model, estimates against errors."""

from functools import cache

import numpy as np
import pytest

from kc2spice.bodies.piezo_stack import from_sector
from kc2spice.core.errors import UsageError
from kc2spice.fem.piezo.assembly import assemble_kick
from kc2spice.fem.piezo.contact import contact_surface
from kc2spice.fem.piezo.keys import Chip as Kick
from kc2spice.fem.piezo.transient import Ball, transient
from kc2spice.parts._mesh_study import as_system, on_reduced
from kc2spice.parts.contact import ContactKeys
from kc2spice.parts.piezo_stack import Drive
from kc2spice.parts.sphere import SphereKeys
from kc2spice.rom.modal import resonators
from kc2spice.rom.reduce import reduce
from kc2spice.rom.response import relative_error

BAND = (0.0, 500e3)
SMALL = {"sectors": 4, "rings": 2, "ring_spacing": 300e-6, "outer_rings": 2}
MASS = SphereKeys().mass / 4
PULSE = Drive(start=0.0).waveform


@pytest.fixture(scope="module")
def default():
    return from_sector(assemble_kick(Kick()))


@pytest.fixture(scope="module")
def truth(default):
    """Ten Krylov blocks equal the full model to 1e-12 up to 500 kHz (surrogate)."""
    frequency = np.linspace(0, 500e3, 463)
    return frequency, reduce(default, order=70, band=BAND).transfer(frequency)


@cache
def small(layers: int, ratio: float, **change):
    kick = Kick(layers=layers, mesh={**SMALL, **change}, damping={"ratio": ratio})
    return from_sector(assemble_kick(kick))


@pytest.mark.parametrize(("tolerance", "states"), [(1e-3, 13), (1e-5, 16), (2e-7, 21), (1e-10, 39)])
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


def test_twenty_states_launch_the_sphere_as_the_full_model_does(default):
    """Same steps on both, so the reduction alone differs."""
    rom = reduce(default, tolerance=2e-7, band=BAND)
    surface = contact_surface(Kick(), ContactKeys().penalty, SphereKeys().radius)
    full = assemble_kick(Kick())
    reduced, reduced_surface = as_system(rom, full), on_reduced(surface, rom)
    launch = [
        transient(
            system, contact, Ball(MASS, 0.0, 0.0, 9.81), step=20e-9, stop=6.2e-6,
            voltage=lambda t: float(PULSE(t)), resting=True,
        ).velocity[-1]
        for system, contact in ((full, surface), (reduced, reduced_surface))
    ]  # fmt: skip
    assert rom.order <= 22
    assert launch[1] == pytest.approx(
        launch[0], rel=1e-3
    )  # measured 8.2e-4, from modes above the band


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
    size = np.abs(rom.transfer(frequency))
    lowest = (size[1:-1] < size[:-2]) & (size[1:-1] < size[2:])
    return frequency[1:-1][lowest.any(axis=(1, 2))]


@pytest.mark.parametrize(("layers", "ratio", "change", "band", "tolerance"), CASES)
def test_estimate_follows_the_true_error(layers, ratio, change, band, tolerance):
    """Never below the error, never above by more than 10; direct solves judge."""
    model = small(layers, ratio, **dict(change))
    rom = reduce(model, tolerance=tolerance, band=band)
    frequency = np.union1d(np.linspace(*band, 19), notches(rom, band))
    error = relative_error(rom.transfer(frequency), model.transfer(frequency))
    assert error <= rom.certificate.error_estimate * (1 + 1e-6) + 1e-11
    assert rom.certificate.error_estimate <= tolerance
    assert rom.certificate.error_estimate <= 10 * error + 1e-10
    assert rom.certificate.passive


def test_unreachable_tolerance_is_refused():
    with pytest.raises(UsageError, match="certified"):
        reduce(small(3, 0.01), tolerance=1e-18, band=BAND)
