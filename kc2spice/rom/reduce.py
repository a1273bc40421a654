"""Reduction of any linear model: a tolerance (or an order) and a band in, a certified model out.

By default the band ends a little above the fifth lowest natural frequency.

Two stages. A *subspace model* that is far more accurate than asked comes first: all of a model of
up to a thousand unknowns or so, else block Krylov vectors (symmetric definite models: at zero,
then at real shifts) or multi-point rational Krylov vectors with their derivatives (all others).
Inside it the proper orthogonal decomposition of its own response orders the directions, and the
first q of them make the model of order q. What is free to move is set apart first and stays exact.
Static answers come next, so static gains are exact as soon as q covers them. Everything is a
congruence with one real basis, so symmetry, definiteness and skewness survive, and with them
stability and passivity, at every order.

Errors are differences to the subspace model at every resonance, its flanks and every notch, plus
the subspace model's own error in the full model.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import get_args

import numpy as np
from scipy.linalg import LinAlgError, block_diag, cholesky, eigh, solve_triangular

from kc2spice.core.errors import SimulationError, UsageError, unknown
from kc2spice.linalg.factor import require_factors
from kc2spice.rom import blocks
from kc2spice.rom.band import natural_band
from kc2spice.rom.constraints import reduced_form
from kc2spice.rom.entries import Entries
from kc2spice.rom.error_estimate import Judge, above_band, inexact, relative_error, relative_size
from kc2spice.rom.intermediate import Subspace
from kc2spice.rom.linear import Certificate, LinearModel, Norm
from kc2spice.rom.pencil import Pencil
from kc2spice.rom.reductors.block_krylov import block_arnoldi
from kc2spice.rom.relaxing_fit import minimax
from kc2spice.rom.response import FLANK, SHARPEST, Response, around, grid
from kc2spice.rom.rounding import ROUNDED, SPREAD
from kc2spice.rom.stability import FORM, Structure, structure
from kc2spice.rom.structural import causal, without_inertia
from kc2spice.rom.subspace import is_definite, subspace

ROUNDING = 1e-11  # no estimate says less: direct solutions are hardly better in the response
HIGHEST = 1e30  # Hz; powers of a frequency stay numbers
LOWEST = 1e-10  # tolerances that can be certified
MARGIN = 0.02  # the subspace model's part of a tolerance
DIGITS = 4.0  # times rounding over a damping ratio: how well any solution knows that resonance
FIXED_ORDER_TARGET = 1e-8  # tolerance of the subspace if the order is given
SAFETY = 1.15  # on differences at samples, for what lies between them
SOFT = 1e12  # condition of an energy that holds a motion which costs none but for rounding
BALANCED = 2000  # first-order states at most
UNSCALED = 500  # states up to which balancing without scaled outputs is tried too
SAMPLED = 900  # states up to which samples take no more time than Gramians
ALL = "balanced truncation"
THINNED = 4  # every so many samples are enough where no notches count
CHEAP = 200  # states up to which balancing only measures the cost of keeping the form
# Definite matrices become resonators, which prove stability. A model without this form is used only
# if it has at most this share of their states.
FORM_SHARE = 0.91
RANK = 1e-13  # singular values of the response below this are rounding
FIT = 101
TAIL = 8.0  # snapshots of mechanical ports reach so many times the band's upper edge
TAIL_SAMPLES = 150
TAIL_DECAY = 4  # power of the fall of the tail's weight: contact forces are smooth on the whole
# Eight kicks of the paper's chip, 45 to 105 V, tolerances 1e-5 to 5e-8: models of 20 to 31 states
# have launch errors within 2.7e-4. With weights of at most 1e-2, 21 states at 2e-7 have up to 9e-4.
TAIL_WEIGHTS = 4e-3, 5e-2
TAIL_PER_ROOT = 120.0  # per root of the tolerance, as errors go with its square
TIGHTENED = 150  # states up to which directions are turned to save some
TRIALS = 12  # how often directions are turned
SPARE = 20  # directions beyond the order, at least, that are turned
SPARED = 0.5  # share of the tolerance that all of these directions must be good to
LEAST = 0.05  # least change of a weight
FADING = 0.5  # factor of the weight of the tail in each trial
FITTED = 60  # rates and gains of a relaxing model that are fitted
MISSES = 4  # orders that may fail in a row
HOPELESS = 1.5  # error of a fit, per tolerance, that stays
CLOSER = 0.97  # error of a fit, per tolerance, that is enough
EXACT = 1e-10  # error of a surrogate
CHECKS = 10  # direct solutions that measure a surrogate


def reduce(
    model: LinearModel,
    *,
    tolerance: float | None = None,
    order: int | None = None,
    band: tuple[float, float] | None = None,
    norm: Norm = "pointwise",
    contact: bool = False,
) -> LinearModel:
    """Return the smallest model found within ``tolerance``, or the one of ``order``.

    The result has the ports of ``model``. Its certificate states the error over ``band`` [Hz], in
    the ``norm`` of :class:`Certificate`.

    * An ``order`` of a symmetric positive definite model selects the paper's reduction (2.3): block
      Arnoldi at s0 = 0.
    * Models whose ports are signals are also reduced by balanced truncation, to first order. That
      result is used if it has fewer states and no passive resonators are lost.
    * Structural damping becomes viscous damping of each mode, or relaxations if these are much more
      accurate. The error estimate includes the difference. The function warns if the difference
      exceeds the tolerance.
    * A symmetric model with only real poles loses its inertia if that saves states and changes
      nothing.
    * Rounding of the full model's entries may change its response by more than ``tolerance``. The
      error estimate then includes this change, and the function warns.

    Parameters
    ----------
    model : LinearModel
        Full model of n unknowns, in SI units.
    tolerance : float, optional
        Largest relative error over the band, less than 1.
    order : int, optional
        Number of unknowns of the result. Exactly one of ``tolerance`` and ``order`` is required.
    band : tuple of two floats, optional
        Lowest and highest frequency in Hz. By default it is the band of the model, otherwise it
        ends a little above the fifth natural frequency.
    norm : "pointwise" or "peak", default "pointwise"
        Reference of the relative error: the value at the same frequency, or the entry's largest
        value in the band.
    contact : bool, default False
        Whether to represent a part of the response above the band, which a contact excites, by a
        third more states.

    Returns
    -------
    LinearModel
        Reduced model with the ports of ``model`` and with a certificate.

    Raises
    ------
    UsageError : not one of tolerance and order, an empty band, an unknown norm, a tolerance below
        rounding, an order beyond what the response has, a model too large for this machine, one
        that answers to derivatives of its input.
    SimulationError : the tolerance cannot be met, or a point of the band is a pole.

    Examples
    --------
    Block Arnoldi at s0 = 0 keeps the static compliance of four springs of 2000 N/m in series.

    >>> from kc2spice.rom.linear import Port
    >>> stiffness = 2e3 * (np.diag([2.0, 2, 2, 1]) - np.eye(4, k=1) - np.eye(4, k=-1))
    >>> tip = Port("tip", "mechanical")
    >>> chain = LinearModel(M=1e-3 * np.eye(4), K=stiffness, B=np.eye(4)[:, 3:], ports=(tip,))
    >>> small = reduce(chain, order=2, band=(0.0, 100.0))
    >>> small.order
    2
    >>> print(f"{small.transfer([0.0])[0, 0, 0].real:.9f} m/N")
    0.002000000 m/N
    """
    if (tolerance is None) == (order is None):
        raise UsageError("give either a tolerance or an order", where="reduction")
    if tolerance is not None and not LOWEST <= tolerance < 1:
        raise UsageError(
            "not a tolerance that can be certified",
            where="tolerance",
            got=tolerance,
            expected=f"between {LOWEST:g} and 1; less is out of reach of double precision",
        )
    if order is not None and order < 1:
        raise UsageError("not an order", where="order", got=order, expected="1 or more")
    if norm not in get_args(Norm):
        raise unknown("unknown norm", norm, get_args(Norm), "norm")

    def congruence(item: LinearModel, within: float, over: tuple[float, float]) -> LinearModel:
        return _reduce(item, within, None, over, norm, contact, keep_form=True)

    if model.structural:
        if tolerance is None:
            problem = "structural damping is reduced within a tolerance"
            raise UsageError(problem, where="order", got=order, expected="a tolerance, no order")
        undamped = replace(model, loss_factor=0.0, loss=None)
        band = band or model.band or natural_band(reduced_form(undamped.pencil))
        return causal(model, congruence, tolerance, band, norm)
    result = _reduce(model, tolerance, order, band, norm, contact)
    if tolerance is None or contact or model.first_order:
        return result
    return without_inertia(model, result, congruence, tolerance, norm)


def _reduce(
    model: LinearModel,
    tolerance: float | None,
    order: int | None,
    band: tuple[float, float] | None,
    norm: Norm,
    contact: bool,
    keep_form: bool = False,
) -> LinearModel:
    """:func:`reduce` of a model with viscous damping; ``keep_form`` by a congruence."""
    pencil = reduced_form(model.pencil)
    if not pencil.B.any() or not pencil.C.any():
        raise UsageError("has no effective input or output", where=model.name)
    band = band or model.band or natural_band(pencil)
    if not 0 <= band[0] < band[1] <= HIGHEST:
        expected = f"0 <= f0 < f1 <= {HIGHEST:g} in Hz"
        raise UsageError("not a frequency band", where="band", got=band, expected=expected)
    band = float(band[0]), float(band[1])
    require_factors(pencil.bordered(1.0, 1.0, 1.0))
    target = FIXED_ORDER_TARGET if tolerance is None else max(MARGIN * tolerance, 0.1 * LOWEST)
    limit = np.inf if tolerance is None else 0.5 * tolerance
    space = None
    try:
        if order is None or not is_definite(pencil):
            space = subspace(pencil, band, target, limit)
    finally:
        full = structure(pencil, band, space.poles if space else None)
        if full.stable is False:
            warnings.warn(
                "the full model is unstable: some of its motions grow without any drive, and a "
                "frequency response says nothing of them; check signs and halves of the matrices",
                stacklevel=2,
            )
    if space is None:
        assert order is not None
        result = _of_order([subspace_model(model, _krylov(pencil, order), band, norm)], order)
    else:
        plain = subspace_model(model, space, band, norm)
        sides = [False] if pencil.symmetric and pencil.collocated else [False, True]
        congruences = (ordered(plain, two_sided, tolerance) for two_sided in sides)
        if order is not None:
            result = _of_order(list(congruences), order)
        else:
            assert tolerance is not None
            result = _within(plain, congruences, tolerance, contact, keep_form)
    certificate = result.certificate
    assert certificate is not None
    both = (full.stable, certificate.stable)
    stable = False if False in both else None if None in both else True
    method = certificate.method
    if not full.stable or full.proof != FORM:
        method += f"; stability of the full model from {full.proof}"
    known = replace(
        certificate, method=method, stable=stable, passive=certificate.passive and full.passive
    )
    return replace(result, certificate=known)


def _of_order(found: list[Reduction], order: int) -> LinearModel:
    """The best model of an order."""
    most = max(item.size for item in found)
    if order > most:
        expected = f"1 to {most}"
        raise UsageError("no model of this order", where="--order", got=order, expected=expected)
    fitting = (item for item in found if order <= item.size)
    return min(fitting, key=lambda item: item.error(order)).model(order)


def _within(
    plain: Reduction,
    congruences: Iterable[Reduction],
    tolerance: float,
    contact: bool,
    keep_form: bool,
) -> LinearModel:
    """The smallest model within a tolerance."""
    floor = plain.space.floor
    within = tolerance - floor  # the tolerance without rounding errors
    within = within if within > 0.5 * tolerance else tolerance
    selected, least = _fewest(plain, congruences, within, contact, keep_form)
    if not contact:
        fitted = relaxing_fit if selected.relaxing else refitted
        selected, least = fitted(selected, least, within)
    if floor > tolerance:
        warnings.warn(
            f"the full model itself is only good to {floor:.1e}: so far rounding of its "
            "entries moves its response; other units or fewer elements may condition it better",
            stacklevel=3,
        )
    result = selected.model(least)
    estimate = result.certificate.error_estimate  # type: ignore[union-attr]
    if floor <= tolerance < estimate:
        warnings.warn(
            f"the reduced model is certified to {estimate:.2g} only, {tolerance:g} was asked "
            f"for: rounding of the full model's entries alone moves its response by {floor:.1e}",
            stacklevel=3,
        )
    return result


def _fewest(
    plain: Reduction,
    congruences: Iterable[Reduction],
    tolerance: float,
    contact: bool,
    keep_form: bool,
) -> tuple[Reduction, int]:
    """A congruence, or the balanced model of the ``plain`` one that needs fewer states where all
    ports are signals and no passive resonators would be lost.

    Directions of a congruence are turned to save more, unless it is for ``contact``.
    """
    free, share, signals = None, 1.0, default_norm(plain.full) == "peak" and not keep_form
    congruent = plain.pencil.degree == 2 or plain.relaxing
    form = congruent and structure(plain.pencil, plain.judge.band)
    if form and form.proof == FORM:
        share = FORM_SHARE
    if signals and not (form and form.passive):
        free = balanced(plain, plain.states(plain.size) + 1, tolerance)
    if free is not None and not form:  # nothing that a congruence would keep
        return replace(free[0], origin=f"{free[0].origin}; "), free[1]
    result = list(congruences)
    most = np.inf if free is None else int(free[1] / share)
    within = [item.fewest(tolerance, most + 1) for item in result]
    few = [(order, k) for k, order in enumerate(within) if order is not None]
    if not few and free is not None:
        text = f"{free[0].origin}, where a congruence needs more than {most} states; "
        return replace(free[0], origin=text), free[1]
    if not few:
        error = min(item.error(item.size) for item in result)
        raise inexact(
            "the tolerance is out of reach",
            f"estimate {error:.1e} with {result[0].size} states",
            tolerance,
            "ask for a larger tolerance or a narrower band",
        )
    order, k = min(few)
    kept = result[k]
    if not contact:
        kept, order = tightened(kept, order, tolerance)
        order = kept.fewest(tolerance, kept.states(order)) or order
    states = kept.states(order)
    if not keep_form and free is None and (signals or kept.states(kept.pencil.size) <= CHEAP):
        free = balanced(kept, int(np.ceil(share * states)), tolerance)
    if free is not None and free[1] < states:
        text = f"{states} first-order states, {free[1]} without keeping the form; "
        kept = replace(kept, origin=text)
    return kept, order


def tightened(found: Reduction, order: int, tolerance: float) -> tuple[Reduction, int]:
    """Other directions of which fewer than ``order`` meet the tolerance, as long as there are any.

    Snapshots weigh more where the error of one state fewer is largest (Lawson's minimax fit), and
    those of the ``tail`` above the band, which no certificate sees, less and less.
    """
    size, kept = min(found.size, max(3 * order, order + SPARE)), max(found.first, 1)
    if order <= kept or order > TIGHTENED or found.error(size) > SPARED * tolerance:
        return found, order
    held = found.pencil.leading(size)
    response = Response(held)
    judge = found.judge
    inside, far = _snapshots(judge, response, _tail(found.full, tolerance))
    s = 2j * np.pi * np.r_[inside, far[0]]
    H, count = judge.exact.transfer(s), inside.size
    base = judge.reference[1].base(H[:count], judge.share) + np.finfo(float).tiny
    sides = [_weighted(response, s, np.ones(len(s)), H, judge.norm)]
    if not (held.symmetric and held.collocated):
        sides.append(_weighted(response.dual, s, np.ones(len(s)), H.swapaxes(1, 2), judge.norm))
    weight, share, best = np.ones(count), 1.0, found
    for _ in range(TRIALS):
        both = np.r_[weight, share * far[1]]
        columns = np.hstack(
            [side * np.tile(np.repeat(both, side.shape[1] // (2 * len(s))), 2) for side in sides]
        )
        V = block_diag(np.eye(found.first), _principal(columns[found.first :])[0])
        trial = replace(found, pencil=replace(held.project(V), free=held.free))
        while order > kept:
            fewer = trial.pencil.leading(order - 1)
            off = np.abs(Response(fewer).transfer(s[:count]) - H[:count]) / base
            if off.max() > tolerance or not trial.good(order - 1, tolerance):
                break
            best, order = trial, order - 1
        largest = off.max(axis=(1, 2))
        weight = weight * np.sqrt(largest / largest.max() + LEAST)
        weight, share = weight / weight.max(), FADING * share
    return best, order


def refitted(found: Reduction, order: int, tolerance: float) -> tuple[Reduction, int]:
    """A balanced model of fewer than ``order`` states, as long as there is one that meets the
    tolerance in the peak norm with other outputs: those of least largest error (Lawson)."""
    judge = found.judge
    if judge.norm != "peak" or not found.balanced or order > TIGHTENED:
        return found, order
    inside, _ = _snapshots(judge, judge.exact, None)
    s = 2j * np.pi * inside
    H, peak = judge.exact.transfer(s), judge.reference[1].peak
    rows, columns = blocks.scales(peak)
    wanted = (H - found.pencil.D) / (rows[:, None] * columns)
    best, fewer, enough = (found, order), order, CLOSER * tolerance / SAFETY
    while fewer > max(1, found.pencil.free, best[1] - MISSES):
        fewer -= 1
        response = found.leading(fewer)
        part, x = response.pencil, response.states(s) / columns
        weight = np.ones((len(s), 1, x.shape[2]))
        for _ in range(TRIALS):
            C = _least_squares(x * weight, wanted * weight) * rows[:, None]
            off = np.abs(C @ (x * columns) + part.D - H) / (peak + np.finfo(float).tiny)
            if not enough < off.max() < HOPELESS * tolerance:
                break
            weight = weight * np.sqrt(off.max(axis=1, keepdims=True) / off.max() + LEAST)
        if off.max() <= enough:
            trial = replace(found, pencil=replace(part, C=C))
            trial._models[fewer] = Response(trial.pencil, response.modes)
            if trial.good(fewer, tolerance):
                best = trial, fewer
    return best


def relaxing_fit(found: Reduction, order: int, tolerance: float) -> tuple[Reduction, int]:
    """A relaxing model of fewer than ``order`` states that meets the tolerance in the peak norm, as
    long as there is one: its rates and gains are fitted, and it is passive for all of these.

    Conservative ports keep their static answers, and no model of theirs is fitted.
    """
    judge, ports = found.judge, found.pencil.B.shape[1]
    if judge.norm != "peak" or found.first or found.pencil.free:
        return found, order
    inside, _ = _snapshots(judge, judge.exact, None)
    s = 2j * np.pi * inside
    H, base = judge.exact.transfer(s), judge.reference[1].peak + np.finfo(float).tiny
    best = found, order
    for fewer in range(order - 1, 0, -1):
        if fewer * (1 + ports) > FITTED:
            break
        rest, inertia = found.pencil.leading(fewer).coefficients
        rates, T = eigh(rest, inertia)
        if rates[0] <= 0:
            break
        start = rates, T.T @ found.pencil.B[:fewer]
        enough = CLOSER * tolerance / SAFETY
        rates, gains, error = minimax(*start, s, H - found.pencil.D, base, enough)
        pencil = Pencil((np.diag(rates), np.eye(fewer)), gains, gains.T.copy(), found.pencil.D)
        trial = replace(found, pencil=pencil, origin=f"{found.origin}fitted rates and gains; ")
        if error > enough or not trial.good(fewer, tolerance):
            break
        best = trial, fewer
    return best


def _least_squares(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Real C with ``C x`` next to ``y``, over all frequencies and inputs."""
    left, right = (np.moveaxis(P, 1, 2).reshape(-1, P.shape[1]) for P in (x, y))
    both = [np.vstack([P.real, P.imag]) for P in (left, right)]
    size = np.linalg.norm(both[0], axis=0) + np.finfo(float).tiny
    return np.asarray(np.linalg.lstsq(both[0] / size, both[1], rcond=None)[0].T / size)


def default_norm(model: LinearModel) -> Norm:
    """*peak* for models whose ports are all signals, *pointwise* where notches matter."""
    return "pointwise" if any(port.conservative for port in model.ports) else "peak"


def _krylov(pencil: Pencil, order: int) -> Subspace:
    """The paper's model of ``order`` states and two blocks more, by which it is certified."""
    K, _, M = pencil.coefficients
    solve = pencil.pencil_solver(0.0).solve
    larger = order + 2 * pencil.B.shape[1]
    V = block_arnoldi(lambda v: K @ v, solve, lambda v: M @ v, pencil.B, larger)
    return Subspace(Response(pencil.project(V)), 0.0, True, "")


@dataclass(frozen=True)
class Reduction:
    """The subspace model in ordered directions, so that the model of order q is its leading part,
    and the ``judge`` of their errors, who knows the subspace model in coordinates that may
    decouple. ``first`` directions are free motions and the static answers that conservative ports
    keep.
    """

    full: LinearModel
    pencil: Pencil
    space: Subspace
    judge: Judge
    first: int = 0
    origin: str = ""
    balanced: bool = False

    def states(self, order: int) -> int:
        """First-order states of the model of this order."""
        return order * self.pencil.degree

    @property
    def relaxing(self) -> bool:
        """Whether the model is of first order and symmetric, as a network of resistors and
        capacitors is: a congruence keeps its real poles and its passivity."""
        pencil = self.pencil
        return pencil.degree == 1 and pencil.symmetric and pencil.collocated

    @property
    def size(self) -> int:
        """Largest order."""
        return self.pencil.size

    def error(self, order: int, limit: float = np.inf) -> float:
        """Estimated largest relative error of any transfer function over the band; above ``limit``
        something that shows it."""
        error = self.judge.error(self.leading(order), (limit - self.space.error) / SAFETY)
        return max(self.space.error + SAFETY * error, ROUNDING)

    def structure(self, order: int) -> Structure:
        """Stability and passivity of the model of this order."""
        result = self.leading(order)
        return structure(result.pencil, self.judge.band, None if result.decoupled else result.poles)

    def leading(self, order: int) -> Response:
        """Response of the model of this order."""
        if order not in self._models:
            self._models[order] = Response(self.pencil.leading(order))
        return self._models[order]

    @cached_property
    def _models(self) -> dict[int, Response]:
        return {}

    @cached_property
    def _keeps(self) -> bool:
        """Whether smaller models must be stable: a stable subspace model must not lose that."""
        return self.balanced or self.structure(self.size).stable is not False

    def good(self, order: int, tolerance: float) -> bool:
        """Whether the model of this order is within the tolerance, and as stable as it must be."""
        if not self.error(order, tolerance) <= tolerance:
            return False
        stable = self.structure(order).stable
        return bool(stable) if self.balanced else stable is not False or not self._keeps

    def fewest(self, tolerance: float, states: float = np.inf) -> int | None:
        """The least :meth:`good` order of those with fewer first-order ``states``; None where there
        is none."""
        most = int(min(self.size, (states - 1) // self.pencil.degree))
        orders = range(max(self.first, 1), most + 1)
        return next((order for order in orders if self.good(order, tolerance)), None)

    def model(self, order: int) -> LinearModel:
        """The reduced model with its certificate."""
        answer, judge, model = self.structure(order), self.judge, self.full
        response, error = self.leading(order), self.error(order) + self.space.floor
        count, parts = self.space.pencil.size, response.pencil.coefficients
        method = f"{self.origin}difference to {count} states at resonances, flanks and notches"
        if self.space.proof:
            method += f"; those {self.space.proof}; stability from {answer.proof}"
        method += _zeros(judge.reference[1], model)
        if not self.space.static or self.space.pencil.free:
            method += "; free to move at zero frequency"
            if hidden := self.space.hidden:
                method += f", supports that resonate below {hidden:.1e} Hz being hidden by rounding"
        ratio = judge.exact.visible(judge.band)[1].min(initial=1.0)
        if ratio < SHARPEST:
            method += f"; beside resonances, by {FLANK:g}, of a damping ratio below {SHARPEST:g}"
        if not np.isfinite(error):
            raise SimulationError(
                "the reduced model has a state that nothing holds, slows or carries",
                where=model.name,
                got="sizes that double precision cannot tell from zero",
                hint="another order or a tolerance; units in which its entries are closer in size",
            )
        rounding = max(ROUNDING, DIGITS * float(np.finfo(float).eps) / max(ratio, SHARPEST))
        above = above_band(model.ports, judge.exact, response, judge.band)
        certificate = Certificate(
            judge.band,
            max(error, rounding),
            method,
            answer.stable,
            answer.passive,
            above,
            judge.norm,
        )
        first = {"A": -parts[0], "E": parts[1]}
        result = LinearModel(
            **(first if parts[2:] == () else dict(zip("KEM", parts, strict=True))),
            **{letter: getattr(response.pencil, letter) for letter in "BCD"},
            **{key: getattr(model, key) for key in ("ports", "facts", "name")},
            certificate=certificate,
            band=judge.band,
        )
        result.state_space()  # refuses what no netlist can hold before it is certified
        return result


LISTED_ZEROS = 6  # entries that a certificate lists


def _zeros(entries: Entries, model: LinearModel) -> str:
    """Entries that count as zero, for the certificate."""
    places = zip(*np.nonzero(entries.zero), strict=True)
    names = [f"{model.outputs[i]}/{model.inputs[j]}" for i, j in places]
    if not names:
        return ""
    more = f" and {len(names) - LISTED_ZEROS} more" if len(names) > LISTED_ZEROS else ""
    return f"; zero by symmetry: {', '.join(names[:LISTED_ZEROS])}{more}"


def balanced(like: Reduction, states: int, tolerance: float) -> tuple[Reduction, int] | None:
    """The same subspace model in first order and balanced coordinates, over all frequencies or over
    the band, if that has fewer than so many ``states``; None where it has not, or the model is free
    to move or too large."""
    judge, free = like.judge, like.judge.exact.pencil.free
    core, top = judge.exact.core, judge.band[1]
    if not like.space.static or core.free or like.states(judge.exact.pencil.size) > BALANCED:
        return None
    model = Response(blocks.standard(core, top))
    H, entries = judge.reference
    peak = entries.peak
    scales = blocks.scales(peak)
    ways = {ALL: lambda: blocks.by_gramians(model.pencil, *scales)}
    if model.pencil.size <= UNSCALED and peak.size > 1:
        one = [np.ones(len(item)) for item in scales]
        ways[f"{ALL} of outputs as they are"] = lambda: blocks.by_gramians(model.pencil, *one)
    if model.pencil.size <= SAMPLED and model.diagonal:
        step = 1 if judge.norm == "pointwise" else THINNED
        f = judge.frequency[::step]
        weights = blocks.weights(f, entries.base(H[::step], judge.share))
        over = {f"{ALL} over the band": lambda: blocks.by_samples(model, 1j * f / top, *weights)}
        ways = over | ways if judge.norm == "pointwise" else ways | over
    best = None
    for name, way in ways.items():
        small = way()
        if small is None:
            continue
        if free:
            small = small.joined(blocks.standard(judge.exact.pencil.leading(free), top))
        pencil = blocks.in_hertz(small, top)
        other = replace(like, pencil=pencil, first=pencil.free, origin=name, balanced=True)
        fewer = other.fewest(tolerance, states)
        if fewer is not None:
            best, states = (other, fewer), fewer
            if judge.norm == "pointwise":
                break  # Gramians know nothing of notches
    return best


def subspace_model(
    model: LinearModel, space: Subspace, band: tuple[float, float], norm: Norm
) -> Reduction:
    """The subspace model as it is, before its directions are ordered."""
    return Reduction(model, space.pencil, space, space.judge(band, norm))


def ordered(plain: Reduction, two_sided: bool, tolerance: float | None) -> Reduction:
    """Order the directions of the ``plain`` subspace by what they contribute to the response."""
    model, space, judge = plain.full, plain.space, plain.judge
    whole = space.response
    core, omega = whole.core, 2 * np.pi * judge.band[1]
    free = core.free  # motions that damping couples to the others are kept as they are
    energy = _energy_basis(core.held, omega, static=space.static)
    basis = block_diag(np.eye(free), energy)
    response = Response(core.project(basis))
    pencil = response.pencil
    conservative = any(p.kind in ("mechanical", "rotational") for p in model.ports)
    first = np.empty((pencil.size - free, 0))
    if free:
        K, E, _ = pencil.coefficients
        loads = [pencil.B[free:], E[free:, :free], E[:free, free:].T]
        first = _range(np.linalg.solve(K[free:, free:], np.hstack(loads)))
    elif space.static and ((judge.static and judge.band[0] == 0) or conservative):
        first = _range(response.states(np.zeros(1))[0].real)
    inside, far = _snapshots(judge, response, _tail(model, tolerance))
    weight = np.r_[np.ones(inside.size), far[1]]
    s = 2j * np.pi * np.r_[inside, far[0]]
    H = whole.transfer(s)
    sets = [_weighted(response, s, weight, H, judge.norm)]
    if two_sided:
        sets.append(_weighted(response.dual, s, weight, H.swapaxes(1, 2), judge.norm))
    directions = _directions(np.hstack(sets)[free:], first)
    pencil = pencil.project(block_diag(np.eye(free), directions))
    pencil = replace(pencil, free=free)
    if core is not whole.pencil:
        pencil = pencil.joined(whole.pencil.leading(whole.pencil.free))
    kept = pencil.free + (first.shape[1] if conservative else 0)
    return replace(plain, pencil=pencil, first=kept)


def _energy_basis(pencil: Pencil, omega: float, *, static: bool) -> np.ndarray:
    """Coordinates in which the elastic energy (else that at ``omega``) is the plain square, where
    there is one. A model that is not ``static`` has none at rest, though rounding of its K may let
    a factor of it pass for one."""
    rest, inertia = pencil.coefficients[0], pencil.coefficients[-1]
    moving = rest + omega**pencil.degree * inertia
    for energy in (rest, moving) if static else (moving,):
        energy = 0.5 * (energy + energy.T)
        if np.linalg.cond(energy) > SOFT:
            continue
        try:
            return np.asarray(solve_triangular(cholesky(energy), np.eye(pencil.size)))
        except LinAlgError:
            continue
    return np.eye(pencil.size)  # no definite energy: the scaled unknowns must do


def _tail(model: LinearModel, tolerance: float | None) -> float | None:
    """Weight of what is above the band, where contact may act; a basis fitted to the band alone is
    erratic there."""
    if not any(p.kind in ("mechanical", "rotational") for p in model.ports):
        return None
    return float(np.clip(TAIL_PER_ROOT * np.sqrt(tolerance or 0.0), *TAIL_WEIGHTS))


def _snapshots(
    judge: Judge, response: Response, tail: float | None
) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """Frequencies [Hz] of the band and its resonances; those of a tail above with their weights."""
    band = judge.band
    frequency = grid(band, FIT, judge.static)
    at, ratio = response.within(band)
    frequency = np.union1d(frequency, around(at, ratio, np.array([0.0, 1.0])))
    if tail is None:
        return frequency, (np.empty(0), np.empty(0))
    far = np.linspace(band[1], TAIL * band[1], TAIL_SAMPLES)
    weight = tail * (band[1] / far) ** TAIL_DECAY * np.sqrt(FIT / TAIL_SAMPLES)
    return frequency, (far, weight)


def _weighted(
    response: Response, s: np.ndarray, weight: np.ndarray, whole: np.ndarray, norm: Norm
) -> np.ndarray:
    """Real and imaginary parts of the states, each relative to the root of its port's response
    (an energy) where ports have one, else to its own length; with that of a free motion, in the
    response of the ``whole``. Relative to the peaks in that norm."""
    x = response.states(s)
    P = response.pencil
    H = P.C @ x + P.D
    if P.symmetric and P.collocated:
        share = 1.0 if norm == "peak" else 1e-6
        least = share * np.abs(np.einsum("fii->fi", H)).max(axis=0)
        own = np.sqrt(np.maximum(np.abs(np.einsum("fii->fi", whole)), least))
    else:
        own = np.linalg.norm(x, axis=1)
        if norm == "peak":
            own = np.maximum(own, own.max(axis=0))
        size = np.linalg.norm(H, axis=1)
        more = np.divide(
            np.linalg.norm(whole, axis=1), size, out=np.ones_like(size), where=size > 0
        )
        own = own * np.maximum(more, 1.0)
    x = x * (weight[:, None] / (own + np.finfo(float).tiny))[:, None, :]
    columns = np.moveaxis(x, 0, 1).reshape(x.shape[1], -1)
    return np.hstack([columns.real, columns.imag])


def _directions(columns: np.ndarray, first: np.ndarray) -> np.ndarray:
    """Orthonormal directions: ``first``, then the principal ones of all others."""
    for _ in range(2):
        columns = columns - first @ (first.T @ columns)
    both = np.hstack([first, _principal(columns)[0]])
    return np.asarray(np.linalg.qr(both)[0])


def _range(columns: np.ndarray) -> np.ndarray:
    """Principal directions of the columns, those beyond rounding of the largest."""
    U, size = _principal(columns)
    return np.asarray(U[:, size > RANK * max(size.max(initial=0.0), np.finfo(float).tiny)])


def _principal(columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Left singular vectors and values."""
    if columns.shape[1] > 2 * columns.shape[0]:  # a thinner matrix of the same directions
        columns = np.asarray(np.linalg.qr(columns.T, mode="r")).T
    U, size, _ = np.linalg.svd(columns, full_matrices=False)
    return U, size


def surrogate(
    model: LinearModel, band: tuple[float, float], *, blocks: int = 10
) -> tuple[LinearModel, float]:
    """A projected model that equals the full one over ``band``, and its largest measured error.

    The basis is built at s = 0 alone; ``CHECKS`` direct solutions of the full model, spread over
    the band so that none repeats a sampling frequency, are compared in all port pairs.

    Raises
    ------
    SimulationError : the largest relative error exceeds ``EXACT`` and the rounding error of the
        direct solutions; solve directly instead.
    """
    small = reduce(model, order=blocks * len(model.inputs), band=band)
    golden = (np.sqrt(5) - 1) / 2  # never a rational fraction of the band
    frequency = band[0] + (band[1] - band[0]) * np.sort(golden * np.arange(1, CHECKS + 1) % 1)
    exact = model.transfer(frequency)
    errors = relative_size(small.transfer(frequency) - exact, exact)
    error, worst = float(errors.max()), int(errors.max(axis=(1, 2)).argmax())
    if error > EXACT and error > _solution_rounding(model.pencil, frequency[worst], exact[worst]):
        raise SimulationError(
            "the reduced model misses the tolerance",
            where="harmonic reference",
            got=f"largest relative error {error:.1e} with {small.order} states",
            expected=f"at most {EXACT:g}",
            hint="narrow the band, or solve the full model at every frequency",
        )
    return small, error


def _solution_rounding(pencil: Pencil, frequency: float, exact: np.ndarray) -> float:
    """Largest relative change of a direct solution ``exact`` (outputs, inputs) in other units of
    the unknowns, which change nothing but rounding: thin bodies answer with the small difference
    of large forces."""
    rng, s = np.random.default_rng(0), np.array([2j * np.pi * frequency])
    trials = (pencil.in_units(t) for t in rng.uniform(1.0, 2.0, (ROUNDED, pencil.size)))
    return SPREAD * max(relative_error(again.transfer(s), exact[None]) for again in trials)
