"""A measured one-port as a passive circuit: resonators and relaxations beside a capacitance.

The charge per voltage of a passive part without inductance of its own is, with s = j w,

    Y(s)/s = C0 + sum_k a_k / (1 + s t_k) + sum_j c_j w_j^2 / (s^2 + d_j s + w_j^2),   a, c >= 0,

a Butterworth-Van Dyke branch (C = c_j, L = 1/(c_j w_j^2), R = d_j L) for every resonance j, and a
series R C for every relaxation k: those are the loss of the dielectric. No choice of non-negative
a and c gives power. Frequencies and dampings are least squares of the relative deviation, the
amplitudes inside it non-negative least squares (variable projection: Golub and Pereyra, Inverse
Problems 19 (2003) R1). Resonances are added where most is left, until noise is.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares, nnls

from kc2spice.rom.linear import Certificate, LinearModel, Port
from kc2spice.rom.modal import Resonators

MOST = 30  # resonances
GAIN = 0.1  # a resonance takes that share of the deviation, or the one before was the last
NOISE = 1.1  # times the noise of the data: all that a circuit can reach
POOR = 0.2  # relative deviation of something that is no such part
QUALITIES = (5.0, 30.0, 200.0, 1500.0)
SMALL = 1e-12  # of the largest amplitude
LEAST = 1e-6  # of the least |Y/s|: a clamped capacitance below loses the digits of a netlist


class _Basis:
    """Y/s of unit amplitudes over samples, weighted by the measured size."""

    def __init__(self, f: np.ndarray, Y: np.ndarray) -> None:
        self.s = 2j * np.pi * f
        self.H = Y / self.s
        self.weight = 1 / np.abs(self.H)
        decades = max(2, round(2 * np.log10(f[-1] / f[0])) + 4)
        self.rates = 2 * np.pi * np.geomspace(f[0] / 10, 10 * f[-1], decades)
        relaxing = 1 / (1 + self.s[:, None] / self.rates)
        self.fixed = np.column_stack([np.ones(len(f)), relaxing])

    def amplitudes(self, modes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Non-negative amplitudes for modes (j, 2), log of w and of d, and the relative deviation
        (n,) complex that they leave."""
        w2, d = np.exp(2 * modes[:, 0]), np.exp(modes[:, 1])
        s = self.s[:, None]
        columns = np.column_stack([self.fixed, w2 / (s**2 + s * d + w2)])
        A = columns * self.weight[:, None]
        b = self.H * self.weight
        scale = np.linalg.norm(A, axis=0)
        stacked = np.concatenate([A.real, A.imag]) / scale
        x = nnls(stacked, np.concatenate([b.real, b.imag]), maxiter=50 * len(scale))[0] / scale
        return x, A @ x - b

    def polished(self, modes: np.ndarray) -> np.ndarray:
        """The modes with least deviation near ``modes``."""

        def deviation(flat: np.ndarray) -> np.ndarray:
            left = self.amplitudes(flat.reshape(-1, 2))[1]
            return np.concatenate([left.real, left.imag])

        reach = np.tile([0.5, 6.0], len(modes))
        start = modes.ravel()
        result = least_squares(
            deviation, start, bounds=(start - reach, start + reach), x_scale="jac", max_nfev=40
        )
        return np.asarray(result.x.reshape(-1, 2))

    def more(self, modes: np.ndarray) -> np.ndarray:
        """One mode more: a new one where most is left, or the nearest one there split in two."""
        left = self.amplitudes(modes)[1]
        worst = np.abs(self.s[int(np.argmax(np.abs(left)))])
        missing = np.abs(self.s[int(np.argmax(-(left * self.H).imag / np.abs(self.H)))])
        tried = [
            np.vstack([modes, [np.log(w), np.log(w / Q)]])
            for w in (worst, missing)
            for Q in QUALITIES
        ]
        starts = [min(tried, key=lambda item: _rms(self.amplitudes(item)[1]))]
        if len(modes):
            nearest = int(np.argmin(np.abs(modes[:, 0] - np.log(worst))))
            log_w, log_d = modes[nearest]
            apart = 0.25 * np.exp(log_d - log_w)
            halves = [[log_w - apart, log_d - 0.5], [log_w + apart, log_d - 0.5]]
            starts.append(np.vstack([np.delete(modes, nearest, axis=0), halves]))
        ends = [self.polished(start) for start in starts]
        return min(ends, key=lambda item: _rms(self.amplitudes(item)[1]))


def one_port(f: np.ndarray, Y: np.ndarray, noise: float) -> tuple[LinearModel | None, float]:
    """The circuit of admittances ``Y`` (n,) [S] at ``f`` (n,) [Hz] as a model with one electrical
    port, ``anode``. Its certificate is the largest relative deviation from the samples.

    ``noise`` is the relative standard deviation of one component of Y. Gives also what is left,
    root of the mean square of the relative deviation; no model where that is :data:`POOR`.
    """
    basis = _Basis(f, Y)
    modes = np.empty((0, 2))
    rms = _rms(basis.amplitudes(modes)[1])
    while len(modes) < MOST and rms > NOISE * np.sqrt(2) * noise:
        more = basis.more(modes)
        left = _rms(basis.amplitudes(more)[1])
        if left > (1 - GAIN) * rms:
            break
        modes, rms = more, left
    x, deviation = basis.amplitudes(modes)
    largest = int(np.argmax(np.abs(deviation)))
    error = float(np.abs(deviation[largest]))
    if rms > POOR or not x.any():
        return None, rms
    told = (
        f"{len(modes)} resonances fitted to {len(f)} samples: largest deviation {error:.2g} at "
        f"{f[largest]:.6g} Hz, rms {rms:.2g}, noise of the samples {np.sqrt(2) * noise:.2g}; above "
        "and below the band the circuit is a capacitor, at rest an open one"
    )
    certificate = Certificate((float(f[0]), float(f[-1])), error, told, True, True)
    count, kept = len(basis.rates), x > SMALL * x.max()
    moving, relaxing = np.flatnonzero(kept[1 + count :]), np.flatnonzero(kept[1 : 1 + count])
    order = moving[np.argsort(modes[moving, 0])]
    omega = np.r_[np.exp(modes[order, 0]), basis.rates[relaxing]]
    size = np.r_[x[1 + count :][order], x[1 : 1 + count][relaxing]]
    result = Resonators(
        omega=omega,
        damp=np.r_[np.exp(modes[order, 1]), basis.rates[relaxing]],
        gain=(np.sqrt(size) * omega)[:, None],
        D=np.array([[max(float(x[0]), LEAST * float(np.abs(basis.H).min()))]]),
        ports=(Port("anode", "electrical", pins=("anode", "cathode")),),
        certificate=certificate,
        massless=len(relaxing),
    )
    return result.linear(), rms


def _rms(deviation: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.abs(deviation) ** 2)))
