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
from dataclasses import replace
from typing import get_args

import numpy as np

from kc2spice.core.errors import UsageError, unknown
from kc2spice.linalg.factor import require_factors
from kc2spice.rom.band import natural_band
from kc2spice.rom.constraints import reduced_form
from kc2spice.rom.linear import LinearModel, Norm
from kc2spice.rom.reduced_basis import subspace_model
from kc2spice.rom.reductors.block_krylov import _krylov
from kc2spice.rom.reductors.response_pod import ordered
from kc2spice.rom.search import _of_order, _within
from kc2spice.rom.stability import FORM, structure
from kc2spice.rom.structural import causal, without_inertia
from kc2spice.rom.subspace import is_definite, subspace

HIGHEST = 1e30  # Hz; powers of a frequency stay numbers
LOWEST = 1e-10  # tolerances that can be certified
MARGIN = 0.02  # the subspace model's part of a tolerance
FIXED_ORDER_TARGET = 1e-8  # tolerance of the subspace if the order is given


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
