"""A small model that stands for the full one over a band: the first stage of a reduction.

* Small models: all of it, in dense form.
* Symmetric positive definite models with proportional or no damping: K-orthonormal block Krylov
  vectors at zero while that pays (paper 2.3, eq. 6 and 7), then at the real shift where the last
  block changed most. The pencil ``K - w^2 M`` serves the pair of points +-j w.
* All others: multi-point rational Krylov. Points are chosen where the sketched residual, in turn
  with the last change, is largest. Each is solved on the full model first as a *check* of the
  projection, and only then joins the basis with its derivative by s, real and imaginary part apart
  so that everything stays real.
* Ill-conditioned dense models: where rounding of the large entries of a matrix exceeds its slow
  motions, neither its eigenvectors nor its projections keep digits. Solutions do, refined with
  residuals in extended precision. The states ``X = P(s)^-1 B`` and ``Y = P(s)^-T C'`` at a few
  frequencies span two bases, and ``A X = s E X - B`` projects the model on them without a product
  with the large matrix.

Sources: rational interpolation, greedy or by oblique projection (Grimme 1997; Feng, Antoulas,
Benner 2017); balancing by samples, Gosea, Gugercin and Beattie, SIAM J. Sci. Comput. 44 (2022)
A408.
"""

from __future__ import annotations

import numpy as np
import scipy

from kc2spice.core.errors import SimulationError
from kc2spice.rom.error_estimate import inexact, relative_size
from kc2spice.rom.intermediate import Subspace
from kc2spice.rom.pencil import Matrix, Pencil, Schur, magnitudes, symmetric
from kc2spice.rom.reductors.exact_samples import _sampled
from kc2spice.rom.reductors.rational_krylov import MANY, MAX_POINTS, _block_krylov, _rational
from kc2spice.rom.response import FLANK, SHARPEST, Response, clear_of_poles, grid
from kc2spice.rom.rigid_body import RANDOM, apart, congruent, energy_rounding, hidden_support
from kc2spice.rom.rounding import (
    FREE,
    SHARP,
    SPREAD,
    _taken_out,
    _uncertainty_note,
    uncertainty,
    zero_entries,
)
from kc2spice.rom.stability import dissipative

EXTENDED = 500  # unknowns up to which a model is turned into its modes with 19 digits
# Largest models that are used without samples.
WHOLE_DECOUPLED = 1300  # unknowns of decoupled models
WHOLE = 600  # first-order states of others
DENSE = 2000  # states of models with so many resonances that samples do not converge
DIRECT = 150  # unknowns up to which one linear system per frequency may be solved


def subspace(pencil: Pencil, band: tuple[float, float], target: float, limit: float) -> Subspace:
    """A model within ``target`` of the full one over ``band`` [Hz], or within ``limit`` where
    rounding of the full model's solutions keeps it from that.

    Raises
    ------
    SimulationError : not even ``limit`` is met.
    """
    if pencil.size <= WHOLE_DECOUPLED:
        full = pencil.scaled(2 * np.pi * band[1]).dense()
        whole, inaccurate = None, None
        try:
            whole = _whole(full, band, limit)
        except SimulationError as error:
            inaccurate = error
        sound = whole is not None and whole.response.diagonal
        # Without an energy a congruence needs well-conditioned modes to converge.
        if pencil.degree == 1 and not sound and not dissipative(full):
            try:
                return _sampled(full, band, target, limit)
            except SimulationError:
                pass  # free to move at zero frequency, or with too many resonances
        if inaccurate is not None:
            raise inaccurate
        if whole is not None:
            return whole
    if is_definite(pencil, undamped_too=True):
        return _block_krylov(pencil, band, target, limit)
    scaled = pencil.scaled(2 * np.pi * band[1])
    states = pencil.degree * pencil.size
    moderate = WHOLE < states <= DENSE
    if not (moderate and pencil.is_dense and pencil.degree == 1):
        try:
            return _rational(scaled, band, target, limit, MANY if moderate else MAX_POINTS)
        except SimulationError:
            if not moderate:
                raise
    result = _whole(scaled.dense(), band, limit, DENSE)
    return result or _rational(scaled, band, target, limit, MAX_POINTS)


def is_definite(pencil: Pencil, *, undamped_too: bool = False) -> bool:
    """Symmetric, collocated, proportionally damped (or not at all), K positive definite."""
    proportional = pencil.rayleigh is not None or (undamped_too and pencil.undamped)
    if pencil.degree != 2 or not (proportional and pencil.symmetric and pencil.collocated):
        return False
    load = np.random.default_rng(0).standard_normal((pencil.size, 1))
    try:
        solve = pencil.pencil_solver(0.0).solve
        x, y = solve(pencil.B), solve(load)
    except SimulationError:
        return False
    held = bool((np.einsum("ki,ki->i", x, pencil.B) >= 0).all())
    return held and not _is_free(pencil.coefficients[0], y, load)


def _is_free(K: Matrix, y: np.ndarray, load: np.ndarray) -> bool:
    """Whether the softest motion, ``y = K^-1 load`` of a random load, has no more energy than the
    rounding of K itself, which may give a body that is free to move a factor."""
    size = magnitudes(K)
    rounding = FREE * np.finfo(float).eps * np.sum(abs(y) * (size @ abs(y)))
    soft = bool(np.sum(y * load) < rounding)
    if not soft or isinstance(K, Schur):
        return soft
    # the factor's own error may exceed that of the entries, by which a soft support is known
    y = y / np.linalg.norm(y)
    energy, noise = float(np.sum(y * (K @ y))), float(energy_rounding(K, y)[0, 0])
    return energy <= RANDOM * noise


def _whole(
    full: Pencil, band: tuple[float, float], limit: float, most: int = WHOLE
) -> Subspace | None:
    """All of a small model; None where its response would take too long to evaluate.

    Raises
    ------
    SimulationError : two solutions are further apart than ``limit``.
    """
    given = full
    full, V, static, projected = apart(given, 2 * np.pi * band[1])
    hidden = hidden_support(given, V[:, : full.free], band[0]) if static else 0.0
    T = _undamped_modes(full.held) if static else None
    if T is not None:
        V = V @ scipy.linalg.block_diag(np.eye(full.free), T)
        full, projected = congruent(given, V, full.free)
    response = Response(full)
    response.zero = zero_entries(given, V, response, band)
    if not response.decoupled and (
        full.degree * full.size > most or (full.size > DIRECT and not response.diagonal)
    ):
        return None
    error, floor, rounded = _solution_error(response, band), 0.0, 0.0
    at, ratio = response.visible(band)
    note = ""
    if at.size:
        looked = np.union1d(np.argsort(at)[:SHARP], np.argsort(ratio)[:SHARP])
        at = at[looked] * (1 + FLANK * (ratio[looked] < SHARPEST))
        s, states, dual = 2j * np.pi * at, None, None
        if T is not None:
            states = V @ response.states(s)
        elif response.modes is not None and given is full:
            states, dual = response.states(s), response.dual.states(s)
        size = uncertainty(given, at, states, dual, response.zero)
        rounded = SPREAD * float(size.max())
        if T is not None:
            note = _uncertainty_note(at, size, 2 * limit)
        # products and solutions round its entries
        if T is None or full.free or full.size < given.size:
            floor = rounded
    if error > max(limit, rounded):
        raise inexact(
            "the full model itself is not that accurate",
            f"two direct solutions differ by {error:.1e}",
            limit,
            "ask for a looser tolerance; other units or fewer elements may help",
        )
    proof = f"being all of the full model, solved to {error:.0e}{note}"
    error = min(error, limit)  # a larger error is a rounding error of the given matrices
    if projected is not None:
        floor = max(floor, _taken_out(projected, full, band))
    return Subspace(response, error, static, proof, floor, whole=True, hidden=hidden)


def _undamped_modes(full: Pencil) -> np.ndarray | None:
    """Modes (n, n) of symmetric, definite K and M of a model of moderate size, else None."""
    if full.degree == 1 or full.size > EXTENDED:
        return None
    K, _, M = full.coefficients
    if not (symmetric(K) and symmetric(M)):
        return None
    try:
        values, T = scipy.linalg.eigh(M, K)
    except np.linalg.LinAlgError:
        return None
    return np.asarray(T) if values.min() > 0 else None


def _solution_error(response: Response, band: tuple[float, float]) -> float:
    """How far direct solutions in two orders of elimination, and the modes', are apart."""
    full = response.pencil
    at, ratio = response.visible(band)
    sharpest = at[np.argsort(ratio)[:1]] * (1 + FLANK * (ratio.min(initial=1.0) < FLANK))
    points = np.r_[band[1], 0.31 * band[0] + 0.69 * band[1], sharpest]
    s = 2j * np.pi * points
    coarse = clear_of_poles(grid(band, 50, False), *response.within(band))
    everywhere = 2j * np.pi * coarse
    entries = response.entries(coarse)
    flipped = Pencil(
        tuple(P[::-1, ::-1] for P in full.coefficients), full.B[::-1], full.C[:, ::-1], full.D
    )
    result = [full.transfer(s), flipped.transfer(s), response.transfer(s)]
    apart = [relative_size(one - result[0], result[0], entries) for one in result[1:]]
    counted = ~response.cancelled(everywhere) | entries.zero
    return float(np.array(apart)[..., counted].max(initial=0.0))
