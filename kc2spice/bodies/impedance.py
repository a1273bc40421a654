"""Characteristic values that an impedance analyser displays for a resonance.

The characteristic values are f_s, f_p, Q, coupling, capacitance and the elements of a
Butterworth-Van Dyke (BVD) circuit. A BVD circuit is a capacitor C0 in parallel with a branch of R,
L and C in series. With s = j w, the admittance of the circuit is

    Y(s) = s C0 + s C / (1 + s R C + s^2 L C).

The characteristic values are f_s = 1/(2 pi sqrt(L C)), f_p = f_s sqrt(1 + C/C0), Q = sqrt(L/C)/R
and the effective coupling ``k^2 = 1 - (f_s/f_p)^2 = C/(C + C0)`` (IEEE Std 177-1966, IEEE Std
176-1987). Multiplication by the denominator makes the equation for Y linear in the coefficients.
The coefficients of Y are fitted to the samples around the resonance. A few iterations update the
weights of the samples (Sanathanan and Koerner, IEEE Trans. Autom. Control 8 (1963) 56). The fitted
f_s can lie between the frequencies of the samples.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from kc2spice.core.errors import wrong

MIN_SAMPLES = 7  # smallest number of samples around the resonance; the fit has six coefficients
_FIT_ITERATIONS = 8
OVERDAMPED_Q = 0.5  # Q factor of a critically damped circuit, whose charge has no overshoot
# smallest peak conductance of a resonance, relative to the rms residual of the fitted circuit
MIN_PROMINENCE = 3.0


@dataclass(frozen=True)
class BVD:
    """Elements of the Butterworth-Van Dyke circuit of one resonance, in SI units."""

    c0_f: float
    rm_ohm: float
    lm_h: float
    cm_f: float

    def admittance(self, frequency: np.ndarray) -> np.ndarray:
        """Compute the complex admittance [S] at an array of frequencies [Hz]."""
        s = 2j * np.pi * np.asarray(frequency)
        branch = self.rm_ohm + s * self.lm_h + 1 / (s * self.cm_f)
        return s * self.c0_f + 1 / branch


@dataclass(frozen=True)
class AnalyserValues:
    """Values that an impedance analyser displays for a resonance, such as Q factor.

    Each field has the name of the metric that an ``ac`` scene prints for this value.
    """

    resonance_hz: float
    antiresonance_hz: float
    quality: float
    coupling: float
    capacitance_f: float
    capacitance_frequency_hz: float
    bvd: BVD


# SI unit of each metric, and of each element in ``bvd``; dimensionless metrics are omitted
METRIC_UNITS = {
    "resonance_hz": "Hz", "antiresonance_hz": "Hz", "capacitance_f": "F",
    "capacitance_frequency_hz": "Hz", "c0_f": "F", "rm_ohm": "Ohm", "lm_h": "H", "cm_f": "F",
}  # fmt: skip


def analyse_impedance(frequency: np.ndarray, impedance_ohm: np.ndarray) -> AnalyserValues:
    """Return frequencies, Q factor, coupling and BVD circuit of the first resonance.

    The samples are at increasing frequencies [Hz]. The field ``capacitance_f`` is Im(Y)/w at
    ``capacitance_frequency_hz``, which is 1 kHz or a tenth of the resonance frequency, whichever is
    lower. If this frequency is below the lowest sample, Y of the fitted circuit is used.

    Raises
    ------
    UsageError : the samples are not an impedance, contain no resonance, or are too few around the
        resonance.
    """
    f, Z = np.asarray(frequency, float), np.asarray(impedance_ohm, complex)
    if f.ndim != 1 or f.shape != Z.shape or len(f) < MIN_SAMPLES:
        raise wrong(
            None,
            "these arrays are not samples of an impedance",
            got=f"shapes {f.shape} and {Z.shape}",
            expected=f"two arrays of the same length, with at least {MIN_SAMPLES} samples",
        )
    good = np.isfinite(f).all() and np.isfinite(Z).all() and (Z != 0).all()
    if not good or f[0] <= 0 or not (np.diff(f) > 0).all():
        raise wrong(
            None,
            "these arrays are not samples of an impedance",
            expected="finite values, at positive frequencies in increasing order",
        )
    Y = 1 / Z
    window = _select_window(f, Y)
    bvd = _fit_circuit(f[window], Y[window])
    ratio = bvd.cm_f / bvd.c0_f
    resonance = 1 / (2 * math.pi * math.sqrt(bvd.lm_h * bvd.cm_f))
    quality = math.sqrt(bvd.lm_h / bvd.cm_f) / bvd.rm_ohm
    _require_resonance(f[window], Y[window], bvd, resonance, quality)
    low = np.array([min(1e3, resonance / 10)])
    sampled_at, admittance = (low, bvd.admittance(low)) if f[0] > low[0] else (f, Y)
    return AnalyserValues(
        resonance_hz=resonance,
        antiresonance_hz=resonance * math.sqrt(1 + ratio),
        quality=quality,
        coupling=math.sqrt(ratio / (1 + ratio)),
        capacitance_f=float(
            np.interp(low, sampled_at, admittance.imag / (2 * np.pi * sampled_at))[0]
        ),
        capacitance_frequency_hz=float(low[0]),
        bvd=bvd,
    )


def _require_resonance(
    f: np.ndarray, Y: np.ndarray, bvd: BVD, resonance: float, quality: float
) -> None:
    """Reject a fitted circuit if the maximum of the conductance is not a resonance.

    Dielectric losses, and rounding errors in a body without losses, also cause maxima of the
    conductance.
    """
    branch = bvd.admittance(f) - 2j * np.pi * f * bvd.c0_f
    # the conductance without the R-L-C branch is due to dielectric loss and other modes
    conductance = Y.real - branch.real
    ripple = conductance - np.polyval(np.polyfit(f, conductance, 2), f)
    band = f"{f[0]:g} to {f[-1]:g} Hz"
    got = f"samples from {band}"
    if not f[0] <= resonance <= f[-1]:
        got = f"a fitted resonance at {resonance:.4g} Hz, outside the frequency range {band}"
    elif quality <= OVERDAMPED_Q:
        got = f"a fitted circuit with Q = {quality:.2g} at {resonance:.4g} Hz, which is overdamped"
    elif np.abs(branch.real).max() > MIN_PROMINENCE * float(np.sqrt(np.mean(ripple**2))):
        return
    raise wrong(
        None, "the samples contain no resonance", got=got, hint="use a wider frequency band"
    )


def _select_window(f: np.ndarray, Y: np.ndarray) -> slice:
    """Select the samples around the first resonance and its antiresonance.

    A resonance is a local maximum of G/w that is at least a twentieth of the largest maximum. The
    antiresonance is the next local maximum of Re(Z). The number of selected samples below the
    resonance equals the number of samples between resonance and antiresonance.
    """
    G = Y.real / f
    inner = np.flatnonzero((G[1:-1] >= G[:-2]) & (G[1:-1] > G[2:])) + 1
    inner = inner[G[inner] > 0]
    if len(inner) == 0:
        raise wrong(
            None,
            "the samples contain no resonance",
            got=f"{f[0]:g} to {f[-1]:g} Hz",
            hint=(
                "use a wider frequency band, or add damping so that the peak spans several samples"
            ),
        )
    peak = int(inner[G[inner] >= G[inner].max() / 20][0])
    R = (1 / Y).real
    later = np.flatnonzero((R[1:-1] >= R[:-2]) & (R[1:-1] > R[2:])) + 1
    later = later[later > peak]
    top = int(later[0]) if len(later) else min(peak + MIN_SAMPLES, len(f) - 1)
    reach = max(top - peak, 4)
    low, high = max(0, peak - reach), min(len(f), top + reach // 4 + 2)
    if high - low < MIN_SAMPLES:
        raise wrong(
            None,
            "the data have too few samples around the resonance",
            got=f"{high - low} samples around {f[peak]:g} Hz",
            expected=f"at least {MIN_SAMPLES} samples",
            hint="use a smaller frequency step",
        )
    return slice(low, high)


def _fit_circuit(f: np.ndarray, Y: np.ndarray) -> BVD:
    """Fit a Butterworth-Van Dyke circuit to samples of Y by linear least squares.

    The samples are weighted. The frequencies f are scaled by their mean, and the admittances Y by
    their largest magnitude. The least-squares problem determines the coefficients of the equation

        Y (1 + a s + b s^2) = s C + (s C0 + s^2 g)(1 + a s + b s^2).

    The term with g represents the loss of the dielectric and of higher modes. The returned circuit
    omits g, because a Butterworth-Van Dyke circuit contains no loss of the dielectric or of higher
    modes.
    """
    unit, size = float(np.mean(f)), float(np.max(np.abs(Y)))
    s, y = 1j * f / unit, Y / size
    weight = 1 / np.abs(y)
    for _ in range(_FIT_ITERATIONS):
        columns = np.column_stack([-y * s, -y * s**2, s, s**2, s**3, s**4]) * weight[:, None]
        system = np.concatenate([columns.real, columns.imag])
        right = np.concatenate([(y * weight).real, (y * weight).imag])
        a, b, c1, _, c3, c4 = map(float, np.linalg.lstsq(system, right, rcond=None)[0])
        weight = 1 / (np.abs(y) * np.abs(1 + a * s + b * s**2))
    c0 = (c3 - a * c4 / b) / b
    cm = c1 - c0
    if not min(a, b, c0, cm) > 0:
        raise wrong(
            None,
            "the samples do not match a resonance in parallel with a capacitor",
            got=f"a fitted circuit with C0 = {c0:g}, C = {cm:g}, R*C = {a:g} and L*C = {b:g} in "
            "normalised units",
            expected="a fitted circuit in which these four values are positive",
            hint="take more samples between resonance and antiresonance",
        )
    scale = 1 / (2 * math.pi * unit)
    farad = size * scale
    return BVD(c0 * farad, a * scale / (cm * farad), b * scale**2 / (cm * farad), cm * farad)
