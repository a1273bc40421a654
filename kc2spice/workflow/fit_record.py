"""Rows of a fit's record: values with standard errors, and resonances."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import compress, zip_longest
from operator import attrgetter
from typing import Any

import numpy as np

from kc2spice.bodies.readers.measured_admittance import MeasuredAdmittance
from kc2spice.core.errors import UsageError
from kc2spice.parts.bodies._varied_keys import VariedKey
from kc2spice.workflow.fit_keys import compute_log_widths, find_resonances, is_at_bound
from kc2spice.workflow.misfit import compute_error_scale, compute_rms_misfit, estimate_covariance

# A combination of keys is undetermined if its standard error exceeds a limit.
# The limit of a standard error is the width of the widest parameter range / ERRORS_PER_RANGE.
# Standard errors and widths of parameter ranges are differences of logarithms.
ERRORS_PER_RANGE = 4


def describe_values(
    keys: Sequence[VariedKey], values: Mapping[str, float], J: np.ndarray, residuals: np.ndarray
) -> dict[str, Any]:
    """Return the fitted values, their standard errors, correlations and misfit.

    Parameters
    ----------
    keys : sequence of VariedKey
        Varied keys with their ranges.
    values : mapping of str to float
        Fitted value of each key.
    J : (2 * n, keys) array
        Derivatives of the residuals with respect to logarithms of the values.
    residuals : (2 * n,) array
        Residuals at the end of the fit in units of the noise.

    Raises
    ------
    UsageError : over its whole range, a key changes the residuals by less than the noise.
    """
    names, widths = list(map(attrgetter("key"), keys)), np.array(compute_log_widths(keys))
    unimportant = np.linalg.norm(J, axis=0) * widths < 1.0
    if unimportant.any():
        raise UsageError(
            "this key does not change the impedance",
            where=", ".join(compress(names, unimportant)),
            got="a change below the noise of the data",
            expected="a key that changes the impedance",
            hint="vary another key",
        )
    _, s, Vt = np.linalg.svd(J, full_matrices=False)
    scatter = estimate_covariance(J, residuals, widths)
    sigma = np.sqrt(np.diag(scatter))
    weak = ERRORS_PER_RANGE * compute_error_scale(residuals, len(keys)) > s * widths.max()
    parameters = {}
    for item, deviation in zip(keys, sigma.tolist(), strict=True):
        value = values[item.key]
        parameters[item.key] = {
            "value": value,
            "sigma": abs(value) * deviation,
            "low": item.low,
            "high": item.high,
            "at_bound": is_at_bound(item, value),
        }
    return {
        "parameters": parameters,
        "identifiable": not weak.any(),
        "undetermined": [dict(zip(names, row, strict=True)) for row in Vt[weak].tolist()],
        "correlation": (scatter / np.outer(sigma, sigma)).tolist(),
        "misfit": compute_rms_misfit(residuals, len(keys)),
    }


def compute_error_statistics(size: np.ndarray) -> dict[str, float]:
    """Compute the rms value and the largest value of relative impedance errors.

    ``size`` contains the relative errors of the impedance magnitude ``|Z|``.
    """
    return {"rms": float(np.sqrt(np.mean(size**2))), "largest": float(size.max())}


def match_resonances(
    data: MeasuredAdmittance, start: np.ndarray, end: np.ndarray
) -> list[dict[str, float | None]]:
    """Return measured resonances, and model resonances before and after the fit.

    Rows are in ascending order of frequency. A resonance is a peak of the conductance. ``start``
    and ``end`` are the admittances [S] of the model at the values of the scene and at the fitted
    values.
    """
    curves = (data.Y[:, 0, 0], start, end)
    rows = [find_resonances(data.f, Y, data.noise) for Y in curves]
    names = ("measured_hz", "start_hz", "fitted_hz")
    return [dict(zip(names, row, strict=True)) for row in zip_longest(*rows)]
