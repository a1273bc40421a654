"""A constant loss tangent of a body's dielectric, as relaxations beside its clamped capacitances.

What loses the same share of its energy at every frequency has, by causality, the permittivity of a
constant-phase element (A. K. Jonscher, Nature 267 (1977) 673)::

    eps(s) = eps (s / w0)^-m,      m = (2 / pi) arctan(tan delta),      w0 / (2 pi) = 1 kHz

the frequency at which sheets state permittivities. In a netlist it is Foster's sum

    a_0 + sum_k a_k / (1 + s t_k),      a_k >= 0,

of a capacitor and series R C, passive by its form, whose amplitudes are non-negative least squares
over the band. Of a body with the same tangent everywhere it multiplies the clamped capacitances;
what it changes of the stiffness by fields inside of the body is neglected, tan delta times the
share of the electric energy at constant charge in a mode.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.optimize import nnls

from kc2spice.core.errors import UsageError
from kc2spice.rom.modal import Resonators

STATED_AT = 1e3  # Hz
DECADES = 4.0  # of a band from zero
POINTS = 30  # a decade
MOST = 6  # relaxations a decade
SHARE = 0.1  # of the tangent, or of a certified error: what the sum may be off


def permittivity(frequency: np.ndarray, tangent: float) -> np.ndarray:
    """``eps(s) / eps`` (n,) at ``frequency`` (n,) [Hz]."""
    m = 2 / np.pi * np.arctan(tangent)
    return np.asarray((1j * np.asarray(frequency) / STATED_AT) ** -m)


def foster(
    tangent: float, band: tuple[float, float], error: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """Amplitudes ``a`` (k + 1,) and rates ``1/t`` (k,) [1/s] of the sum, and its largest relative
    difference to :func:`permittivity` in the band: the fewest relaxations within ``error``, or the
    best there is."""
    low, high = max(band[0], band[1] / 10**DECADES), band[1]
    decades = np.log10(high / low) + 1e-9
    f = np.geomspace(low, high, int(POINTS * decades) + POINTS)
    wanted, s = permittivity(f, tangent), 2j * np.pi * f[:, None]
    best = np.inf
    found = np.ones(1), np.empty(0)
    for each in range(1, MOST + 1):
        count = int(np.ceil(each * decades)) + 2
        rates = 2 * np.pi * np.geomspace(low / 3, 3 * high, count)
        A = np.column_stack([np.ones(len(f)), 1 / (1 + s / rates)]) / wanted[:, None]
        one = np.r_[np.ones(len(f)), np.zeros(len(f))]
        a = nnls(np.concatenate([A.real, A.imag]), one)[0]
        off = float(np.abs(A @ a - 1).max())
        if off < best:
            best, found = off, (a, rates)
        if best <= error:
            break
    return *found, best


def lossy(model: Resonators, tangent: float) -> Resonators:
    """``model`` with a dielectric of that loss tangent in the band of its certificate, which the
    error of the sum widens.

    Raises
    ------
    UsageError : it has no electrodes.
    """
    known = model.certificate
    electrical = [k for k, port in enumerate(model.ports) if port.kind == "electrical"]
    if known is None or not electrical:
        raise UsageError("no dielectric to lose energy in", where="damping.loss_tangent")
    amplitude, rates, off = foster(tangent, known.band_hz, SHARE * min(tangent, 0.01))
    D = model.D[np.ix_(electrical, electrical)]
    w, V = np.linalg.eigh(D)
    root = (V * np.sqrt(np.maximum(w, 0.0)))[:, w > 0]
    used = amplitude[1:] > 0
    omega = np.repeat(rates[used], root.shape[1])
    gain = np.zeros((len(omega), len(model.ports)))
    gain[:, electrical] = omega[:, None] * np.vstack(
        [np.sqrt(a) * root.T for a in amplitude[1:][used]]
    )
    clamped = model.D.copy()
    clamped[np.ix_(electrical, electrical)] = amplitude[0] * D
    told = f"{known.method}; a loss tangent of {tangent:g} by {used.sum()} relaxations within "
    told += f"{off:.1e} of a constant one"
    return replace(
        model,
        omega=np.r_[model.omega, omega],
        damp=np.r_[model.damp, omega],
        gain=np.vstack([model.gain, gain]),
        D=clamped,
        massless=model.massless + len(omega),
        certificate=replace(known, error_estimate=known.error_estimate + off, method=told),
    )
