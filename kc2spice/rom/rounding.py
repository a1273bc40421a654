"""Effects of rounding errors of a model's entries on its response."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np

from kc2spice.rom.entries import Entries
from kc2spice.rom.error_estimate import relative_size
from kc2spice.rom.intermediate import IntermediateModel
from kc2spice.rom.pencil import Pencil, absolute_entries
from kc2spice.rom.response import (
    FLANK_DISTANCE,
    MIN_DAMPING_RATIO,
    Response,
    drop_points_near_poles,
    grid,
    sample_resonances,
)

# smallest relative change of a response by rounding errors that the certificate mentions
STATED_UNCERTAINTY = 1e-9
ENERGY_ROUNDING = 100.0  # largest elastic energy of a mode that counts as zero, in rounding errors
# numbers found by trials
ZERO_FREQUENCIES = 50  # number of frequencies of the band at which entries are tested for zero
ZERO_SHARE = 0.5  # share of these frequencies at which a zero entry must be negligible
# number of the lowest, and of the sharpest, resonances at which rounding effects are evaluated
CHECKED_RESONANCES = 8
RANDOM_TRIALS = 4  # number of trials with random units of the unknowns
# Share of the target error below which rounding errors are negligible. Trials differ by a factor of
# less than 10.
NEGLIGIBLE_SHARE = 0.01
TRIAL_FACTOR = 3.0  # safety factor on the largest change in a few trials


def estimate_rounding_uncertainty(
    pencil: Pencil,
    frequency: np.ndarray,
    states: np.ndarray | None = None,
    dual: np.ndarray | None = None,
    zero: np.ndarray | bool = False,
) -> np.ndarray:
    """Estimate the relative change of a dense model's response by rounding of the entries.

    The result is the change at each ``frequency`` [Hz]. By default, this function solves the model
    and its dual. More accurate solutions ``states`` (frequencies, n, inputs) and ``dual`` replace
    them. Errors of entries that are ``zero`` by symmetry are relative to their row and column.
    """
    x = pencil.states(2j * np.pi * frequency) if states is None else states
    H = pencil.C @ x + pencil.D
    size = relative_size(
        estimate_rounding_change(pencil, frequency, x, dual), H, Entries.of(H, zero=zero)
    )
    return np.asarray(size.max(axis=(1, 2)))


def estimate_rounding_change(
    pencil: Pencil, frequency: np.ndarray, x: np.ndarray, dual: np.ndarray | None = None
) -> np.ndarray:
    """Estimate the change (frequencies, outputs, inputs) of a response by rounding of entries.

    The change is the root of the sum of squares of ``eps |y_i P_ij x_j|``, where ``x``
    (frequencies, n, inputs) are the states, and ``y`` the states of the dual model.
    """
    s = 2j * np.pi * frequency
    y = x if pencil.symmetric and pencil.collocated else dual
    y = pencil.transposed().states(s) if y is None else y
    squares = [absolute_entries(P) ** 2 for P in pencil.coefficients]
    result = []
    for item, right, left in zip(s, np.abs(x) ** 2, np.abs(y) ** 2, strict=True):
        terms = (abs(item) ** (2 * k) * (left.T @ (P @ right)) for k, P in enumerate(squares))
        result.append(np.sqrt(sum(terms)))
    return np.asarray(np.finfo(float).eps * np.reshape(result, (len(s), *pencil.D.shape)))


def find_zero_entries(
    pencil: Pencil, V: np.ndarray, response: Response, band: tuple[float, float]
) -> np.ndarray | bool:
    """Find the entries (outputs, inputs) of a model that are zero by symmetry.

    In the ``response`` of the projection on V, an entry that is zero by symmetry is negligible at
    nearly all frequencies of the band. At sharp resonances of equal modes, it may be as large as
    the effect of rounding of the model's entries.
    """
    at, ratio = response.select_visible(band)
    chosen = np.union1d(np.argsort(at)[:CHECKED_RESONANCES], np.argsort(ratio)[:CHECKED_RESONANCES])
    peaks = at[chosen] * (1 + FLANK_DISTANCE * (ratio[chosen] < MIN_DAMPING_RATIO))
    f = np.r_[
        drop_points_near_poles(grid(band, ZERO_FREQUENCIES, False), *response.within(band)), peaks
    ]
    if pencil.D.size == 1 or not f.size:
        return False
    x = response.states(2j * np.pi * f)
    H = response.pencil.C @ x + response.pencil.D
    faint = response.entries(f, H).negligible(H)
    suspect = (faint[: len(f) - len(peaks)].mean(axis=0) > ZERO_SHARE) & ~faint.all(axis=0)
    if suspect.any():
        rows = np.flatnonzero((~faint & suspect).any(axis=(1, 2)))
        both = pencil.symmetric and pencil.collocated
        dual = (
            None
            if both or not pencil.is_dense
            else pencil.transposed().states(2j * np.pi * f[rows])
        )
        if both or dual is not None:
            limit = ENERGY_ROUNDING * estimate_rounding_change(pencil, f[rows], V @ x[rows], dual)
            faint[rows] |= (np.abs(H[rows]) <= limit) & suspect
    return np.asarray(faint.all(axis=0))


def describe_uncertainty(at: np.ndarray, size: np.ndarray, tolerance: float) -> str:
    """Describe the effect of rounding of the matrices on the response, for the certificate.

    ``size`` is the relative change of the response at the frequencies ``at`` [Hz]. The text is
    empty if the change is negligible. If the change exceeds ``tolerance``, the function also warns.
    """
    worst = int(size.argmax())
    text = f"changes the response by {size[worst]:.1e} at {at[worst]:.5g} Hz"
    if size[worst] > tolerance:
        warnings.warn(
            f"rounding of the matrix entries {text}; the reduction uses the matrices without "
            f"change",
            stacklevel=2,
        )
    return f", and rounding of its matrices {text}" if size[worst] > STATED_UNCERTAINTY else ""


def estimate_removed_stiffness(projected: Pencil, free: Pencil, band: tuple[float, float]) -> float:
    """Return the change of the response if the stiffness of rigid-body motions is removed.

    This stiffness is a rounding error. The change is evaluated at the lowest relevant frequency,
    where it is largest.
    """
    s = 2j * np.pi * grid(band, 2, False)[:1]
    H = free.transfer(s)
    return float(relative_size(projected.transfer(s) - H, H).max())


def add_rounding_floor(
    pencil: Pencil,
    V: np.ndarray,
    band: tuple[float, float],
    model: IntermediateModel,
    target: float,
) -> IntermediateModel:
    """Return ``model`` with its ``floor``: the effect of rounding errors on the resonances.

    In other units of the unknowns, the exact response is the same, but the entries of the full
    model have other rounding errors. The model in random units is projected on the same basis, and
    the floor is computed from the change of the response. Thin bodies are sensitive to rounding
    errors, because their elastic forces are small differences of large forces. If the first change
    is negligible relative to ``target``, the error of the model, no other trials are made.
    """
    exact = model.response
    at, ratio = exact.select_visible(band)
    points = drop_points_near_poles(
        sample_resonances(at, ratio, np.array([0.0, 1.0])), *exact.within(band)
    )
    if not points.size:
        return model
    H = exact.transfer(2j * np.pi * points)
    entries = exact.entries(np.union1d(points, grid(band, 50, False)))
    rng = np.random.default_rng(0)
    apart = 0.0
    for t in rng.uniform(1.0, 2.0, (RANDOM_TRIALS, pencil.size)):
        again = Response(pencil.in_units(t).project(V / t[:, None]))
        size = relative_size(again.transfer(2j * np.pi * points) - H, H, entries)
        size[:, exact.cancelled_entries(2j * np.pi * points) & ~entries.zero] = 0.0
        apart = max(apart, TRIAL_FACTOR * float(size.max()))
        if apart < NEGLIGIBLE_SHARE * target:
            break
    proof = f"{model.proof}, and rounding changes it by {apart:.0e}"
    return replace(model, floor=max(model.floor, apart), proof=proof)
