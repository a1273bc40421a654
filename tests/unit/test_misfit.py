"""Standard errors of fits against the scatter of repeated fits, and named causes of misfits."""

import numpy as np
import pytest
from scipy.optimize import least_squares
from support import compute_rms_misfit, estimate_covariance, find_likely_cause

F = np.linspace(0.8, 1.3, 200)
TRUE = np.log([1.0, 0.2, 50.0])  # resonance, motional capacitance, Q
WIDE = np.full(3, 3.0)
STATED = 0.01  # noise that the fit assumes


def log_admittance(x):
    """Of a resonator beside a capacitor of 1 F."""
    resonance, motional, quality = np.exp(x)
    s = 2j * np.pi * F / (2 * np.pi * resonance)
    return np.log(2j * np.pi * F * (1 + motional / (1 + s / quality + s**2)))


def solve(data):
    def residuals(x):
        left = (log_admittance(x) - data) / STATED
        return np.concatenate([left.real, left.imag])

    return least_squares(residuals, TRUE)


def repeated(noise, count=150):
    """Scatter (3,) of the values of repeated fits, and the mean of their standard errors (3,)."""
    rng, values, errors = np.random.default_rng(3), [], []
    for _ in range(count):
        solved = solve(log_admittance(TRUE) + noise(rng))
        values.append(solved.x)
        errors.append(np.sqrt(np.diag(estimate_covariance(solved.jac, solved.fun, WIDE))))
    return np.std(values, axis=0), np.mean(errors, axis=0)


def white(rng, size):
    return size * (rng.normal(size=F.size) + 1j * rng.normal(size=F.size))


@pytest.mark.parametrize("excess", [1.0, 1.35])
def test_standard_errors_are_the_scatter_of_repeated_fits(excess):
    """Also where the noise of the data is larger than the fit assumes."""
    scatter, stated = repeated(lambda rng: white(rng, excess * STATED))
    assert stated == pytest.approx(scatter, rel=0.15)


def test_standard_errors_cover_errors_that_are_correlated_over_frequency():
    """Errors that keep over some ten frequencies, as those of a model do, three times the noise:
    independent residuals would make the standard errors three times too small."""

    def smooth(rng):
        kernel = np.exp(-0.5 * (np.arange(-20, 21) / 6.0) ** 2)
        padded = rng.normal(size=(2, F.size + 40))
        rows = np.array([np.convolve(row, kernel, "valid") for row in padded])
        return 3 * STATED * (rows[0] + 1j * rows[1]) / np.sqrt(np.sum(kernel**2))

    scatter, stated = repeated(smooth)
    assert (stated > 0.7 * scatter).all()
    assert (stated < 2.5 * scatter).all()


def test_no_standard_error_of_a_bad_model_exceeds_the_range_by_far():
    rng = np.random.default_rng(1)
    J, left = np.zeros((60, 1)), 20 * rng.normal(size=60)
    J[3], J[33] = 50.0, 1e-6  # one frequency determines the value
    assert np.sqrt(estimate_covariance(J, left, np.array([0.5]))[0, 0]) < 1.1 * (
        0.5 + compute_rms_misfit(left, 1) / 50
    )


def test_the_likely_cause_is_the_one_that_was_added():
    """A series resistance, a parallel conductance in proportion to frequency, or none of them."""
    Y = np.exp(log_admittance(TRUE))
    causes = {"dielectric": F / Y, "series": -Y, "stray": 1j * F / Y}
    rng = np.random.default_rng(5)
    for name, changed in (("series", Y / (1 + 0.02 * Y)), ("dielectric", Y + 0.5 * F)):
        solved = solve(np.log(changed) + white(rng, STATED))
        assert compute_rms_misfit(solved.fun, 3) > 3
        assert find_likely_cause(solved.jac, solved.fun, causes) == name
    wavy = log_admittance(TRUE) + 0.1 * np.sin(60 * F) + white(rng, STATED)
    solved = solve(wavy)
    assert find_likely_cause(solved.jac, solved.fun, causes) is None
    assert find_likely_cause(solved.jac, solved.fun, {}) is None
