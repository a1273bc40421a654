"""Effects of rounding errors of the matrix entries on the response of a model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kc2spice.core.user_warnings import warn_user
from kc2spice.rom.error_estimate import compute_relative_errors
from kc2spice.rom.intermediate_model import IntermediateModel
from kc2spice.rom.pencil import Pencil, compute_absolute_entries
from kc2spice.rom.response import (
    FLANK_DISTANCE,
    MIN_DAMPING_RATIO,
    Response,
    drop_points_near_poles,
    make_frequency_grid,
    sample_resonances,
)
from kc2spice.rom.transfer_function_error_scales import EntryScales

# The certificate mentions rounding errors if they change the response by more than this fraction.
STATED_UNCERTAINTY = 1e-9
# largest ratio of a response entry to its rounding error at which the entry counts as zero
ZERO_ENTRY_FACTOR = 100.0
# the following numbers were found by trials
ZERO_FREQUENCIES = 50  # number of frequencies at which entries are tested for zero
ZERO_SHARE = 0.5  # share of the tested frequencies at which a zero entry must be negligible
# number of lowest resonances, and of sharpest resonances, at which effects of rounding are
# evaluated
CHECKED_RESONANCES = 8
RANDOM_TRIALS = 4  # largest number of trials, each with random scale factors of the unknowns
# An effect of rounding is negligible if it is below NEGLIGIBLE_SHARE times the target error.
# The effects of rounding in different trials differ by a factor of less than 10.
NEGLIGIBLE_SHARE = 0.01
TRIAL_FACTOR = 3.0  # safety factor for the largest change in RANDOM_TRIALS trials


def estimate_rounding_uncertainty(
    pencil: Pencil,
    frequency: np.ndarray,
    states: np.ndarray | None = None,
    dual: np.ndarray | None = None,
    zero: np.ndarray | bool = False,
) -> np.ndarray:
    """Estimate the relative change of a response due to rounded matrix entries.

    The result (frequencies,) is the largest relative change of any entry of the response at each
    ``frequency`` [Hz]. By default, this function solves the model and its dual. If more accurate
    solutions ``states`` (frequencies, n, inputs) and ``dual`` are given, the function uses them
    instead. The change of an entry that is ``zero`` by symmetry is relative to the other entries in
    the same row and column.
    """
    x = pencil.states(2j * np.pi * frequency) if states is None else states
    H = pencil.C @ x + pencil.D
    size = compute_relative_errors(
        estimate_rounding_change(pencil, frequency, x, dual),
        H,
        EntryScales.from_response(H, zero=zero),
    )
    return np.asarray(size.max(axis=(1, 2)))


def estimate_rounding_change(
    pencil: Pencil, frequency: np.ndarray, x: np.ndarray, dual: np.ndarray | None = None
) -> np.ndarray:
    """Estimate the change of a response due to rounded matrix entries.

    The result has the shape (frequencies, outputs, inputs). Each estimate is the square root of the
    sum of ``(eps |y_i P_ij x_j|)^2`` over all matrix entries ``P_ij``. ``x`` (frequencies, n,
    inputs) contains the states, and ``y`` the states of the dual model.
    """
    s = 2j * np.pi * frequency
    y = x if pencil.is_symmetric and pencil.is_collocated else dual
    y = pencil.make_dual().states(s) if y is None else y
    squares = [compute_absolute_entries(P) ** 2 for P in pencil.coefficients]
    result = []
    for item, right, left in zip(s, np.abs(x) ** 2, np.abs(y) ** 2, strict=True):
        terms = (abs(item) ** (2 * k) * (left.T @ (P @ right)) for k, P in enumerate(squares))
        result.append(np.sqrt(sum(terms)))
    return np.asarray(np.finfo(float).eps * np.reshape(result, (len(s), *pencil.D.shape)))


def find_zero_entries(
    pencil: Pencil, V: np.ndarray, response: Response, band: tuple[float, float]
) -> np.ndarray | bool:
    """Return a mask (outputs, inputs) of response entries that are zero by symmetry.

    ``response`` is the response of the projection on V. The mask includes every entry of the
    response that is negligible at all tested frequencies of the band. At sharp resonances of modes
    with equal frequencies, an entry that is zero by symmetry may contain a large rounding error;
    the mask still includes the entry.
    """
    at, ratio = response.select_visible_resonances(band)
    chosen = np.union1d(np.argsort(at)[:CHECKED_RESONANCES], np.argsort(ratio)[:CHECKED_RESONANCES])
    peaks = at[chosen] * (1 + FLANK_DISTANCE * (ratio[chosen] < MIN_DAMPING_RATIO))
    f = np.r_[
        drop_points_near_poles(
            make_frequency_grid(band, ZERO_FREQUENCIES, False),
            *response.select_band_resonances(band),
        ),
        peaks,
    ]
    if pencil.D.size == 1 or not f.size:
        return False
    x = response.states(2j * np.pi * f)
    H = response.pencil.C @ x + response.pencil.D
    negligible = response.compute_error_scales(f, H).mask_negligible_values(H)
    suspect = (negligible[: len(f) - len(peaks)].mean(axis=0) > ZERO_SHARE) & ~negligible.all(
        axis=0
    )
    if suspect.any():
        rows = np.flatnonzero((~negligible & suspect).any(axis=(1, 2)))
        self_dual = pencil.is_symmetric and pencil.is_collocated
        dual = (
            None
            if self_dual or not pencil.is_dense
            else pencil.make_dual().states(2j * np.pi * f[rows])
        )
        if self_dual or dual is not None:
            limit = ZERO_ENTRY_FACTOR * estimate_rounding_change(pencil, f[rows], V @ x[rows], dual)
            negligible[rows] |= (np.abs(H[rows]) <= limit) & suspect
    return np.asarray(negligible.all(axis=0))


def describe_uncertainty(at: np.ndarray, size: np.ndarray, tolerance: float) -> str:
    """Describe the uncertainty of the response due to rounding of matrix entries.

    The certificate of the reduced model contains the description.
    ``size`` is the relative change of the response at the frequencies ``at`` [Hz]. The description
    is empty if the change is negligible. If the change exceeds ``tolerance``, the function also
    warns.
    """
    worst = int(size.argmax())
    effect = f"changes the response by {size[worst]:.1e} at {at[worst]:.5g} Hz"
    if size[worst] > tolerance:
        warn_user(
            f"rounding of the matrix entries {effect}; the reduction cannot correct this "
            "change, and a direct solution of the full model can be even less accurate"
        )
    return f"; rounding of the matrix entries {effect}" if size[worst] > STATED_UNCERTAINTY else ""


def estimate_removed_stiffness(projected: Pencil, free: Pencil, band: tuple[float, float]) -> float:
    """Estimate how the removal of rigid-body stiffness changes the response.

    The removed stiffness of rigid-body modes is a rounding error. The pencil ``projected`` contains
    this stiffness, and ``free`` does not. The change is evaluated at the lowest frequency of the
    band, where the change is largest.
    """
    s = 2j * np.pi * make_frequency_grid(band, 2, False)[:1]
    H = free.transfer(s)
    return float(compute_relative_errors(projected.transfer(s) - H, H).max())


def add_rounding_floor(
    pencil: Pencil,
    V: np.ndarray,
    band: tuple[float, float],
    model: IntermediateModel,
    target: float,
) -> IntermediateModel:
    """Add the rounding floor, an estimate of the error due to rounding, to a model.

    The attribute ``floor`` of the returned model estimates the relative error of the response due
    to rounding errors. A change of the units of the unknowns changes the rounding errors of the
    full model's matrix entries, but not the exact response. Therefore, the function multiplies the
    unknowns of the full model by random factors, and projects the rescaled model on the same basis
    V. The attribute ``floor`` is computed from the largest change of the response due to the random
    factors. Thin bodies are sensitive to rounding errors, because their elastic forces are small
    differences of large forces. The trials end early if the change is negligible relative to
    ``target``, the required error of the model.
    """
    exact = model.response
    at, ratio = exact.select_visible_resonances(band)
    points = drop_points_near_poles(
        sample_resonances(at, ratio, np.array([0.0, 1.0])), *exact.select_band_resonances(band)
    )
    if not points.size:
        return model
    H = exact.transfer(2j * np.pi * points)
    entries = exact.compute_error_scales(np.union1d(points, make_frequency_grid(band, 50, False)))
    rng = np.random.default_rng(0)
    largest_change = 0.0
    for t in rng.uniform(1.0, 2.0, (RANDOM_TRIALS, pencil.size)):
        scaled_response = Response(pencil.rescale_unknowns(t).project(V / t[:, None]))
        size = compute_relative_errors(
            scaled_response.transfer(2j * np.pi * points) - H, H, entries
        )
        size[:, exact.mask_cancelled_entries(2j * np.pi * points) & ~entries.zero] = 0.0
        largest_change = max(largest_change, TRIAL_FACTOR * float(size.max()))
        if largest_change < NEGLIGIBLE_SHARE * target:
            break
    proof = f"{model.proof}, and rounding changes the response by {largest_change:.0e}"
    return replace(model, floor=max(model.floor, largest_change), proof=proof)
