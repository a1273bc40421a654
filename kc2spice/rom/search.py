"""The least order whose error estimate is within a tolerance, for bases of any method."""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from kc2spice.core.errors import UsageError
from kc2spice.rom.error_estimate import default_norm, inexact
from kc2spice.rom.linear import LinearModel
from kc2spice.rom.reduced_basis import Reduction
from kc2spice.rom.reductors.balanced_truncation import balanced
from kc2spice.rom.reductors.response_pod import tightened
from kc2spice.rom.refinement import refitted, relaxing_fit
from kc2spice.rom.stability import FORM, structure

CHEAP = 200  # states up to which balancing only measures the cost of keeping the form
# Definite matrices become resonators, which prove stability. A model without this form is used only
# if it has at most this share of their states.
FORM_SHARE = 0.91


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
