"""Fits that save states of a reduced-order model once its order is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.linalg import eigh

from kc2spice.rom.pencil import Pencil
from kc2spice.rom.reduced_basis import SAFETY, Reduction
from kc2spice.rom.reductors.balanced_truncation import scales
from kc2spice.rom.reductors.response_pod import LEAST, TIGHTENED, TRIALS, _snapshots
from kc2spice.rom.relaxing_fit import minimax
from kc2spice.rom.response import Response

FITTED = 60  # rates and gains of a relaxing model that are fitted
MISSES = 4  # orders that may fail in a row
HOPELESS = 1.5  # error of a fit, per tolerance, that stays
CLOSER = 0.97  # error of a fit, per tolerance, that is enough


def refitted(found: Reduction, order: int, tolerance: float) -> tuple[Reduction, int]:
    """A balanced model of fewer than ``order`` states, as long as there is one that meets the
    tolerance in the peak norm with other outputs: those of least largest error (Lawson)."""
    judge = found.judge
    if judge.norm != "peak" or not found.balanced or order > TIGHTENED:
        return found, order
    inside, _ = _snapshots(judge, judge.exact, None)
    s = 2j * np.pi * inside
    H, peak = judge.exact.transfer(s), judge.reference[1].peak
    rows, columns = scales(peak)
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
