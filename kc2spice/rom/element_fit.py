"""Elements in parallel, and the least squares that fit their sum to measured admittances.

:class:`Samples` contains frequencies and admittances. Its methods give the deviation of a sum of
:class:`Element` from them, the best amplitudes, and the nearest minimum over all parameters. The
search for elements is in :mod:`kc2spice.rom.branch_fit`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import least_squares, nnls

from kc2spice.rom.network import Branch

TRIAL = 40  # evaluations of a sum of elements to choose one
CONVERGED = 1e-12  # relative change of the least squares and of the parameters
LARGEST_LOG = 150.0  # logarithm of a parameter: beyond every part, within the float range
DC_WEIGHT = 1e4  # samples that one stated resistance at zero frequency counts as
CAPACITIVE = np.tan(np.deg2rad(45))  # B/G at the lowest frequencies of a part that blocks dc
LOWEST = 5  # samples whose mean decides that
Logs = tuple[float, ...]
Response = tuple[np.ndarray, list[np.ndarray]]  # Y (n,), dY / dlog p (n,) of every parameter


def _conductance(p: np.ndarray, s: np.ndarray) -> Response:
    """``Y = g``."""
    Y = np.full(len(s), np.exp(p[0]), complex)
    return Y, [Y]


def _capacitance(p: np.ndarray, s: np.ndarray) -> Response:
    """``Y = s c``."""
    Y = s * np.exp(p[0])
    return Y, [Y]


def _inductive(p: np.ndarray, s: np.ndarray) -> Response:
    """``Y = g / (1 + s t)``: R and L in series."""
    g, t = np.exp(p)
    Y = g / (1 + s * t)
    return Y, [Y, -Y * s * t / (1 + s * t)]


def _relaxing(p: np.ndarray, s: np.ndarray) -> Response:
    """``Y = s a / (1 + s t)``: R and C in series."""
    a, t = np.exp(p)
    Y = s * a / (1 + s * t)
    return Y, [Y, -Y * s * t / (1 + s * t)]


def _resonant(p: np.ndarray, s: np.ndarray) -> Response:
    """``Y = s c w^2 / (s^2 + d s + w^2)``: R, L and C in series."""
    c, w, d = np.exp(p)
    P = s**2 + d * s + w**2
    Y = s * c * w**2 / P
    return Y, [Y, Y * (2 - 2 * w**2 / P), -Y * d * s / P]


FORMS: dict[str, Callable[[np.ndarray, np.ndarray], Response]] = {
    "conductance": _conductance,
    "capacitance": _capacitance,
    "inductive": _inductive,
    "relaxing": _relaxing,
    "resonant": _resonant,
}
CONDUCTING = ("conductance", "inductive")
# Forms that an element has where its time constants lie outside of the band.
SIMPLER = {
    "conductance": (),
    "capacitance": (),
    "inductive": ("conductance",),
    "relaxing": ("capacitance", "conductance"),
    "resonant": ("capacitance", "conductance", "relaxing", "inductive"),
}


@dataclass(frozen=True)
class Element:
    """One summand of Y: its form and the logarithms of its parameters, the amplitude first."""

    form: str
    logs: Logs

    def response(self, s: np.ndarray) -> Response:
        """Its admittance and derivatives at ``s`` (n,)."""
        logs = np.clip(self.logs, -LARGEST_LOG, LARGEST_LOG)
        return FORMS[self.form](logs, s)

    def scaled(self, factor: float) -> Element:
        """The element with its amplitude times ``factor``."""
        return Element(self.form, (self.logs[0] + float(np.log(factor)), *self.logs[1:]))

    @property
    def conductance(self) -> float:
        """At zero frequency [S]."""
        if self.form not in CONDUCTING:
            return 0.0
        return float(np.exp(min(self.logs[0], LARGEST_LOG)))

    def branch(self) -> Branch:
        """Its resistor, inductor and capacitor in series; not of a capacitance."""
        p = np.exp(self.logs).tolist()
        if self.form == "conductance":
            return Branch(1 / p[0])
        if self.form == "inductive":
            return Branch(1 / p[0], inductance=p[1] / p[0])
        if self.form == "relaxing":
            return Branch(p[1] / p[0], elastance=1 / p[0])
        inductance = 1 / (p[0] * p[1] ** 2)
        return Branch(p[2] * inductance, inductance, 1 / p[0])


Elements = tuple[Element, ...]


@dataclass(frozen=True, eq=False)
class Samples:
    """Admittances ``Y`` (n,) [S] at ``f`` (n,) [Hz], and the ``conductance`` [S] at zero frequency
    where the user states it."""

    f: np.ndarray
    Y: np.ndarray
    conductance: float | None = None

    @cached_property
    def s(self) -> np.ndarray:
        """j w."""
        return 2j * np.pi * self.f

    @property
    def conducting(self) -> bool:
        """Whether direct current flows: it is stated, or else the mean phase at the lowest
        frequencies is not that of a capacitor."""
        if self.conductance is not None:
            return self.conductance > 0
        low = np.mean(self.Y[:LOWEST] / np.abs(self.Y[:LOWEST]))
        return bool(low.imag < CAPACITIVE * low.real)

    @cached_property
    def _dc_weight(self) -> float:
        return DC_WEIGHT * np.sqrt(len(self.f)) if self.conductance else 0.0

    def response(self, elements: Elements) -> np.ndarray:
        """Admittance (n,) complex of a sum of elements."""
        Y = np.zeros(len(self.f), complex)
        for element in elements:
            Y += element.response(self.s)[0]
        return Y

    def deviation(self, elements: Elements) -> np.ndarray:
        """Relative deviation (n,) complex of a sum of elements from the samples."""
        return np.asarray(self.response(elements) / self.Y - 1)

    def rms(self, elements: Elements) -> float:
        """Root of the mean square of the logarithmic deviation."""
        misfit = np.log(self.response(elements) / self.Y)
        return float(np.sqrt(np.mean(np.abs(misfit) ** 2)))

    def criterion(self, elements: Elements) -> float:
        """Bayesian information criterion of a fit."""
        count = 2 * len(self.f)
        parameters = sum(len(e.logs) for e in elements)
        least = np.finfo(float).eps
        return float(
            count * np.log(self.rms(elements) ** 2 + least**2) + parameters * np.log(count)
        )

    def _rows(self, x: np.ndarray, dc: float) -> np.ndarray:
        """Numbers (n,) as real rows; below them the share of ``dc`` in the stated conductance."""
        if not self._dc_weight or self.conductance is None:
            return np.concatenate([x.real, x.imag])
        return np.concatenate([x.real, x.imag, [self._dc_weight * dc / self.conductance]])

    def amplitudes(self, elements: Elements) -> tuple[Elements, float]:
        """The elements with the best non-negative amplitudes, those of zero left out, and the norm
        of the rows that they leave."""
        shares = [element.response(self.s)[0] / self.Y for element in elements]
        rows = [self._rows(x, e.conductance) for x, e in zip(shares, elements, strict=True)]
        A, target = np.column_stack(rows), self._rows(np.ones(len(self.f)), self.conductance or 0.0)
        size = np.linalg.norm(A, axis=0)
        x, left = nnls(A / size, target, maxiter=100 * len(size))
        kept = [(e, x_e / size_e) for e, x_e, size_e in zip(elements, x, size, strict=True)]
        return tuple(e.scaled(factor) for e, factor in kept if factor > 0), float(left)

    def polished(self, elements: Elements, evaluations: int = TRIAL) -> Elements:
        """The nearest least squares of all parameters, or what ``evaluations`` reach of it."""
        if not elements:
            return elements
        ends = np.cumsum([len(e.logs) for e in elements])[:-1]

        def unpacked(logs: np.ndarray) -> Elements:
            parts = np.split(logs, ends)
            return tuple(
                Element(e.form, tuple(map(float, part)))
                for e, part in zip(elements, parts, strict=True)
            )

        def residual(logs: np.ndarray) -> np.ndarray:
            tried = unpacked(logs)
            lost = sum(e.conductance for e in tried) - (self.conductance or 0.0)
            return self._rows(np.log(self.response(tried) / self.Y), lost)

        def slopes(logs: np.ndarray) -> np.ndarray:
            tried = unpacked(logs)
            Y, result = self.response(tried), []
            for e in tried:
                first, *others = e.response(self.s)[1]
                result.append(self._rows(first / Y, e.conductance))
                result += [self._rows(other / Y, 0.0) for other in others]
            return np.column_stack(result)

        start = np.concatenate([e.logs for e in elements])
        if len(start) > 2 * len(self.f):
            return elements
        result = least_squares(
            residual,
            start,
            slopes,
            method="lm",
            xtol=CONVERGED,
            ftol=CONVERGED,
            gtol=CONVERGED,
            max_nfev=evaluations,
        )
        return unpacked(result.x) if np.isfinite(result.x).all() else elements
