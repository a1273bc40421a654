"""Scales of errors of a transfer function's entries, and entries that are zero.

A structure with a mirror plane has entries that are zero by symmetry: a force along y causes no
motion along z. Both solutions contain only rounding errors in this entry, so their quotient has no
meaning. Errors of such an entry are relative to the geometric mean of the largest entries of its
row and its column, ``sqrt(|H_ii| |H_jj|)`` for two ports of a passive model. Rows and columns are
balanced first, so that units of inputs and outputs do not matter: D. Ruiz, RAL-TR-2001-034 (2001).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# Below this share of the peak of an entry, errors are relative to this share of the peak.
PEAK_SHARE = 1e-6
# An entry counts as zero below this share of the geometric mean of its row and column. Rounding
# causes about eps times the Q factor of the resonance, 2e-13 for a Q factor of 1000.
ZERO_ENTRY = 1e-11
BALANCING_STEPS = 40  # each iteration halves the logarithm of the remaining scale factor


def reference_share(norm: str) -> float:
    """Return the smallest reference of errors of an entry, as a fraction of its peak."""
    return PEAK_SHARE if norm == "pointwise" else 1.0


@dataclass(frozen=True, eq=False)
class Entries:
    """Entries (outputs, inputs) of a response over a band.

    ``peak`` is the largest size of each entry. For entries that are ``zero`` it is the geometric
    mean ``rows columns`` of their row and column.
    """

    peak: np.ndarray
    zero: np.ndarray
    rows: np.ndarray
    columns: np.ndarray

    @classmethod
    def of(
        cls, H: np.ndarray, peak: np.ndarray | None = None, zero: np.ndarray | bool = False
    ) -> Entries:
        """Make the entries of the response H (frequencies, outputs, inputs).

        The caller may state the ``peak`` of each entry, and entries that are ``zero``.
        """
        size = np.abs(H)
        peak = size.max(axis=0, initial=0.0) if peak is None else np.asarray(peak, dtype=float)
        rows, columns = balance(peak)
        scale = rows[:, None] * columns
        empty = (peak.max(axis=1, initial=0.0) == 0)[:, None] | (peak.max(axis=0, initial=0.0) == 0)
        mean = np.maximum(_geometric_mean(size, rows, columns), scale)
        zero = (zero | (size <= ZERO_ENTRY * mean).all(axis=0)) & ~empty
        return cls(np.where(zero, scale, peak), np.asarray(zero), rows, columns)

    def base(self, H: np.ndarray, share: float = PEAK_SHARE) -> np.ndarray:
        """Return the sizes to which errors of the response H (..., outputs, inputs) are relative.

        Each reference is the size of the entry, but at least this ``share`` of its peak.
        """
        size = np.abs(H)
        if self.zero.any():
            size = np.where(self.zero, _geometric_mean(size, self.rows, self.columns), size)
        return np.asarray(np.maximum(size, share * self.peak))

    def negligible(self, H: np.ndarray) -> np.ndarray:
        """Mask of values of the response H that are below ``ZERO_ENTRY`` of row and column.

        H is (..., outputs, inputs).
        """
        scale = self.rows[:, None] * self.columns
        mean = _geometric_mean(np.abs(H), self.rows, self.columns)
        return np.asarray(np.abs(H) <= ZERO_ENTRY * np.maximum(mean, scale))

    def relative_sizes(
        self, difference: np.ndarray, H: np.ndarray, share: float = PEAK_SHARE
    ) -> np.ndarray:
        """Sizes of a ``difference`` to the response H, relative to :meth:`base`.

        Both arrays are (..., outputs, inputs). The result is zero if the base is zero.
        """
        base = self.base(H, share)
        return np.asarray(
            np.divide(np.abs(difference), base, out=np.zeros_like(base), where=base > 0)
        )


def balance(size: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute factors that scale the largest entry of each row and column to one.

    The factors balance ``size / (rows columns)``. Rows and columns of zeros are ignored.
    """
    rows, columns = np.ones(size.shape[0]), np.ones(size.shape[1])
    for _ in range(BALANCING_STEPS if size.size > 1 else 1):
        left = size / (rows[:, None] * columns)
        across, down = left.max(axis=1, initial=0.0), left.max(axis=0, initial=0.0)
        rows = rows * np.sqrt(np.where(across > 0, across, 1.0))
        columns = columns * np.sqrt(np.where(down > 0, down, 1.0))
    return rows, columns


def _geometric_mean(size: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Geometric mean of the largest entries of row and column.

    The result is (..., outputs, inputs).
    """
    left = size / (rows[:, None] * columns)
    across = left.max(axis=-1, keepdims=True, initial=0.0)
    down = left.max(axis=-2, keepdims=True, initial=0.0)
    return np.asarray(np.sqrt(across * down) * rows[:, None] * columns)
