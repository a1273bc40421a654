"""Tolerance in, order out: errors against the full model, estimates against errors."""

from functools import cache

import numpy as np
import pytest

from kc2spice.bodies.piezo_stack import from_sector
from kc2spice.core.errors import UsageError
from kc2spice.fem.piezo.assembly import assemble_kick
from kc2spice.fem.piezo.keys import Chip as Kick
from kc2spice.parts.contact import ContactKeys
from kc2spice.parts.piezo_stack import Drive
from kc2spice.parts.sphere import SphereKeys
from kc2spice.rom.modal import resonators
from kc2spice.rom.reduce import reduce
from kc2spice.rom.response import relative_error
from laboratory.usual.contact import as_system, contact_surface, on_reduced
from laboratory.usual.transient import Ball, transient

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


def velocity(system, surface):
    """Of a kicked sphere, after the contact."""
    return transient(
        system, surface, Ball(MASS, 0.0, 0.0, 9.81), step=20e-9, stop=6.2e-6,
        voltage=lambda t: float(PULSE(t)), resting=True,
    ).velocity[-1]  # fmt: skip


@pytest.fixture(scope="module")
def launched():
    """The assembled chip, its contact surface, and the launch with it."""
    full = assemble_kick(Kick())
    surface = contact_surface(Kick(), ContactKeys().penalty, SphereKeys().radius)
    return full, surface, velocity(full, surface)


@cache
def small(layers: int, ratio: float, **change):
    kick = Kick(layers=layers, mesh={**SMALL, **change}, damping={"ratio": ratio})
    return from_sector(assemble_kick(kick))


@pytest.mark.slow  # the chip of the paper
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


CASES = [
    (layers, ratio, change, band, tolerance)
    for layers, ratio, change in (
        (3, 0.01, ()), (5, 0.05, ()), (3, 0.002, (("refine", 2),)), (2, 0.01, (("order", 2),)),
    )
    for band in ((0.0, 500e3), (100e3, 900e3))
    for tolerance in (1e-3, 1e-6, 1e-9)
]  # fmt: skip
QUICK = (1, 5, 7)  # two bands, two dampings, two tolerances
JUDGED = [
    pytest.param(*case, marks=() if k in QUICK else pytest.mark.slow)
    for k, case in enumerate(CASES)
]


@cache
def exactly(layers: int, ratio: float, change: tuple, frequency: float):
    """Response of the full model at one frequency [Hz], which several tolerances are judged by."""
    return small(layers, ratio, **dict(change)).transfer(np.array([frequency]))[0]


def notches(rom, band):
    """Where any entry's magnitude has a local minimum: relative errors are largest there."""
    frequency = np.linspace(*band, 801)
    size = np.abs(rom.transfer(frequency))
    lowest = (size[1:-1] < size[:-2]) & (size[1:-1] < size[2:])
    return frequency[1:-1][lowest.any(axis=(1, 2))]


@pytest.mark.parametrize(("layers", "ratio", "change", "band", "tolerance"), JUDGED)
def test_estimate_follows_the_true_error(layers, ratio, change, band, tolerance):
    """Never below the error, never above by more than 10; direct solves judge."""
    model = small(layers, ratio, **dict(change))
    rom = reduce(model, tolerance=tolerance, band=band)
    frequency = np.union1d(np.linspace(*band, 19), notches(rom, band))
    exact = np.stack([exactly(layers, ratio, change, f) for f in frequency])
    error = relative_error(rom.transfer(frequency), exact)
    assert error <= rom.certificate.error_estimate * (1 + 1e-6) + 1e-11
    assert rom.certificate.error_estimate <= tolerance
    assert rom.certificate.error_estimate <= 10 * error + 1e-10
    assert rom.certificate.passive


def test_unreachable_tolerance_is_refused():
    with pytest.raises(UsageError, match="certified"):
        reduce(small(3, 0.01), tolerance=1e-18, band=BAND)
