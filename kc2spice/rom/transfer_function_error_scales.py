"""Scales for relative errors of transfer functions with zero entries.

The transfer function of a body with a mirror plane has entries that are zero by symmetry. For
example, a force along y causes no motion along z. The computed values of a zero entry are only
rounding errors, so that a relative error has no meaning. Therefore, errors of a zero entry are
divided by the geometric mean of the largest entries of the row and the column. For two ports of a
passive model, the geometric mean is ``sqrt(|H_ii| |H_jj|)``. Rows and columns are balanced first,
so that the result does not depend on units (D. Ruiz, RAL-TR-2001-034 (2001)).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kc2spice.core.error_norms import PEAK_SHARE

# An entry counts as zero if (entry / geometric mean of row and column) is below this ratio.
# Rounding errors are about eps times the Q factor of the resonance: 2e-13 for a Q factor of 1000.
ZERO_ENTRY = 1e-11
BALANCING_STEPS = 40  # number of iterations; each iteration halves the logarithm of the scale error


def get_min_relative_divisor(norm: str) -> float:
    """Return the minimum divisor of relative errors, as a share of the response peak.

    A relative error is an absolute error divided by the magnitude of the response. In the norm
    ``pointwise``, the divisor is at least a small fraction of the response's peak. In all other
    norms, the divisor is the peak.
    """
    return PEAK_SHARE if norm == "pointwise" else 1.0


@dataclass(frozen=True, eq=False)
class EntryScales:
    """Magnitude scales for relative errors of each response entry (output, input).

    ``peak`` is the largest magnitude of each entry. Entries in the mask ``zero`` contain only
    rounding errors. For entries in the mask ``zero``, ``peak`` is the row's scale in ``rows`` times
    the column's scale in ``columns``. The product ``rows[i] * columns[j]`` is a typical magnitude
    of an entry (i, j) that is not zero.
    """

    peak: np.ndarray
    zero: np.ndarray
    rows: np.ndarray
    columns: np.ndarray

    @classmethod
    def from_response(
        cls, H: np.ndarray, peak: np.ndarray | None = None, zero: np.ndarray | bool = False
    ) -> EntryScales:
        """Compute the error scales for all entries of a response H.

        H has the shape (frequencies, outputs, inputs).

        By default, ``peak`` and ``zero`` are computed from H.
        """
        size = np.abs(H)
        peak = size.max(axis=0, initial=0.0) if peak is None else np.asarray(peak, dtype=float)
        rows, columns = balance_matrix(peak)
        scale = rows[:, None] * columns
        empty = (peak.max(axis=1, initial=0.0) == 0)[:, None] | (peak.max(axis=0, initial=0.0) == 0)
        mean = np.maximum(_compute_geometric_mean(size, rows, columns), scale)
        zero = (zero | (size <= ZERO_ENTRY * mean).all(axis=0)) & ~empty
        return cls(np.where(zero, scale, peak), np.asarray(zero), rows, columns)

    def compute_error_divisors(self, H: np.ndarray, share: float = PEAK_SHARE) -> np.ndarray:
        """Return the divisors that turn errors of the response ``H`` into relative errors.

        Each value is the magnitude of the entry, but at least ``share`` times the entry's peak.
        """
        size = np.abs(H)
        if self.zero.any():
            size = np.where(self.zero, _compute_geometric_mean(size, self.rows, self.columns), size)
        return np.asarray(np.maximum(size, share * self.peak))

    def mask_negligible_values(self, H: np.ndarray) -> np.ndarray:
        """Return a mask of the values of H (..., outputs, inputs) that count as zero.

        A value counts as zero if it is at most ``ZERO_ENTRY`` times the geometric mean of the
        largest values in its row and in its column.
        """
        scale = self.rows[:, None] * self.columns
        mean = _compute_geometric_mean(np.abs(H), self.rows, self.columns)
        return np.asarray(np.abs(H) <= ZERO_ENTRY * np.maximum(mean, scale))

    def compute_relative_errors(
        self, difference: np.ndarray, H: np.ndarray, share: float = PEAK_SHARE
    ) -> np.ndarray:
        """Return the relative errors (magnitudes) of a ``difference`` from the response H.

        Both arrays have the shape (..., outputs, inputs). The divisors are the values of
        :meth:`compute_error_divisors`. Where a divisor is zero, the relative magnitude is zero.
        """
        base = self.compute_error_divisors(H, share)
        return np.asarray(
            np.divide(np.abs(difference), base, out=np.zeros_like(base), where=base > 0)
        )


def balance_matrix(size: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute row and column factors that balance the entries of a matrix.

    If each entry of ``size`` is divided by its row factor and its column factor, the largest
    quotient in every row and every column is one. Rows and columns of zeros are ignored.
    """
    rows, columns = np.ones(size.shape[0]), np.ones(size.shape[1])
    for _ in range(BALANCING_STEPS if size.size > 1 else 1):
        left = size / (rows[:, None] * columns)
        across, down = left.max(axis=1, initial=0.0), left.max(axis=0, initial=0.0)
        rows = rows * np.sqrt(np.where(across > 0, across, 1.0))
        columns = columns * np.sqrt(np.where(down > 0, down, 1.0))
    return rows, columns


def _compute_geometric_mean(size: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Return the geometric mean of the largest values in each entry's row and column.

    ``size`` and the returned array have the shape (..., outputs, inputs).
    """
    left = size / (rows[:, None] * columns)
    across = left.max(axis=-1, keepdims=True, initial=0.0)
    down = left.max(axis=-2, keepdims=True, initial=0.0)
    return np.asarray(np.sqrt(across * down) * rows[:, None] * columns)
