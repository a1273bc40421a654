"""Reduction of the kick actuator against the unreduced model and exact properties."""

import numpy as np
import pytest
from support import StackKeys, compute_relative_error, make_stack, reduce_model

SMALL = {"sectors": 4, "rings": 2, "ring_spacing": 300e-6, "outer_rings": 2}


BAND = (0.0, 500e3)


@pytest.fixture(scope="module")
def default():
    return make_stack(StackKeys()).model


@pytest.fixture(scope="module")
def model():
    return make_stack(StackKeys(layers=3, mesh={**SMALL, "refine": 2})).model


@pytest.mark.parametrize("order", [1, 5, 9, 20, 40])
def test_every_order_is_symmetric_stable_passive_and_exact_at_rest(model, order):
    """The static answers of all ports are in the basis from the order of their number on."""
    rom = reduce_model(model, order=order, band=BAND)
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
        static = model.B.T @ model.pencil.factorise_shifted_stiffness(0.0).solve(model.B) + model.D
        np.testing.assert_allclose(rom.transfer([0.0])[0].real, static, rtol=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize(("tolerance", "states"), [(1e-5, 16), (2e-7, 20), (1e-10, 25)])
def test_few_states_reach_the_tolerance(default, tolerance, states):
    """Ten Krylov blocks equal the full model to 1e-12 up to 500 kHz."""
    frequency = np.linspace(0, 500e3, 463)
    exact = reduce_model(default, order=70, band=BAND).transfer(frequency)
    rom = reduce_model(default, tolerance=tolerance, band=BAND)
    error = compute_relative_error(rom.transfer(frequency), exact)
    assert rom.order <= states
    assert error <= rom.certificate.error_estimate <= tolerance
    assert rom.certificate.passive
