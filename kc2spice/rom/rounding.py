"""Effects of rounding of the entries of a model on its response."""

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

# relative change of a response due to rounding that the certificate mentions
STATED_UNCERTAINTY = 1e-9
ENERGY_ROUNDING = 100.0  # multiple of the rounding error below which a mode has no elastic energy
# Numbers chosen by trial.
ZERO_FREQUENCIES = 50  # frequencies of the band at which entries are tested for zero
ZERO_SHARE = 0.5  # share of these frequencies at which a zero entry must be negligible
# lowest and sharpest resonances at which the effect of rounding is evaluated
CHECKED_RESONANCES = 8
RANDOM_TRIALS = 4  # random units of the unknowns
# Share of the target error below which rounding is negligible; trials differ by a factor of less
# than 10.
NEGLIGIBLE_SHARE = 0.01
TRIAL_FACTOR = 3.0  # safety factor on the largest change in a few trials


def rounding_uncertainty(
    pencil: Pencil,
    frequency: np.ndarray,
    states: np.ndarray | None = None,
    dual: np.ndarray | None = None,
    zero: np.ndarray | bool = False,
) -> np.ndarray:
    """Estimate the relative change of a response by rounding of the entries.

    The model is dense. The result is the change at each ``frequency`` [Hz].

    ``states`` x (frequencies, n, inputs), and states of the ``dual``, replace the solutions of
    this function if they are more accurate. Errors of entries that are ``zero`` by symmetry are
    relative to their row and column.
    """
    x = pencil.states(2j * np.pi * frequency) if states is None else states
    H = pencil.C @ x + pencil.D
    size = relative_size(rounding_change(pencil, frequency, x, dual), H, Entries.of(H, zero=zero))
    return np.asarray(size.max(axis=(1, 2)))


def rounding_change(
    pencil: Pencil, frequency: np.ndarray, x: np.ndarray, dual: np.ndarray | None = None
) -> np.ndarray:
    """Change (frequencies, outputs, inputs) of a response by rounding of entries.

    The change is the root of the sum of squares of ``eps |y_i P_ij x_j|`` with states ``x``
    (frequencies, n, inputs), and ``y`` of the ``dual``.
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


def zero_entries(
    pencil: Pencil, V: np.ndarray, response: Response, band: tuple[float, float]
) -> np.ndarray | bool:
    """Find the entries (outputs, inputs) of a model that are zero by symmetry.

    A zero entry is negligible nearly everywhere in the band in the ``response`` of the projection
    on V. At sharp resonances of equal modes, the errors may be larger, up to the effect of
    rounding of the model's entries.
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
            limit = ENERGY_ROUNDING * rounding_change(pencil, f[rows], V @ x[rows], dual)
            faint[rows] |= (np.abs(H[rows]) <= limit) & suspect
    return np.asarray(faint.all(axis=0))


def uncertainty_note(at: np.ndarray, size: np.ndarray, tolerance: float) -> str:
    """Return a text about the effect of rounding of the matrices on the response.

    The certificate contains this text. ``size`` is the relative change at the frequencies ``at``
    [Hz]. The text is empty for a negligible change. A change above ``tolerance`` is also printed as
    a warning.
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


def removed_stiffness(projected: Pencil, free: Pencil, band: tuple[float, float]) -> float:
    """Change of the response by rounding stiffness of a rigid-body motion.

    The change is evaluated at the lowest relevant frequency, where it is largest.
    """
    s = 2j * np.pi * grid(band, 2, False)[:1]
    H = free.transfer(s)
    return float(relative_size(projected.transfer(s) - H, H).max())


def with_rounding(
    pencil: Pencil,
    V: np.ndarray,
    band: tuple[float, float],
    model: IntermediateModel,
    target: float,
) -> IntermediateModel:
    """Return ``model`` with the effect of rounding on the resonances as its ``floor``.

    Other units of the unknowns do not change the exact response, but they round the entries of the
    full model differently. The model in other units is projected on the same directions, and the
    floor follows from the change of the response. Thin bodies are sensitive, because their elastic
    forces are small differences of large forces. The trials end if the first change is negligible
    relative to ``target``, the error of the model.
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
