"""A measured multiport as a passive state space, by vector fitting.

Scattering parameters S of a reference resistance R are fitted by common poles (B. Gustavsen,
A. Semlyen, IEEE Trans. Power Delivery 14 (1999) 1052; scikit-rf does it), more of them until what
is left is the noise of the data; residues are then changed as little as makes the model passive
everywhere (scikit-rf, by singular values). Whether it is passive is judged by the Hamiltonian of
the state space, which knows all frequencies (S. Boyd, V. Balakrishnan, P. Kabamba, Math. Control
Signals Systems 2 (1989) 207). With ``b = S a``, ``a, b = (v / r +- r i) / 2``, ``r = sqrt(R)``::

    x' = A x + B a            x' = (A - B T C) x + B T v / r,      T = (1 + D)^-1
    b  = C x + D a            i  = (-2 T C x + (1 - D) T v / r) / r

whose charge is the output of an electrical port: a resistance at zero frequency integrates.
"""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any

import numpy as np

from kc2spice.core.errors import MissingToolError, UsageError
from kc2spice.rom.linear import Certificate, LinearModel, Port
from kc2spice.rom.statespace import ABCD

MOST = 60  # poles, pairs counted once
NOISE = 1.2  # times the noise of the data: what a good fit leaves
GAIN, PATIENCE = 0.1, 2  # three poles more take that share of the deviation, or two times not
CLOSE = 1.5  # times the deviation without passivity: a passive fit as good as any
POOR = 0.2  # of the largest: what no rational function comes near
INSIDE = 1e-7  # below one, of the largest singular value that counts as passive
Fit = Any  # skrf.vectorFitting.VectorFitting: scikit-rf has no types


def multi_port(f: np.ndarray, Y: np.ndarray, noise: float, where: str) -> LinearModel:
    """The state space of admittances ``Y`` (n, ports, ports) [S] at ``f`` (n,) [Hz], with the
    electrical ports ``port1`` … against ``ref``. Its certificate is the largest deviation of any entry
    from the samples, relative to the entry's peak.

    ``noise`` is the relative standard deviation of one component of Y.

    Raises
    ------
    MissingToolError : scikit-rf is not installed.
    UsageError : no such state space comes near the data, or none that is passive.
    """
    ports = Y.shape[1]
    R = float(1 / np.median(np.abs(Y[:, range(ports), range(ports)])))
    one = np.eye(ports)
    S = np.linalg.solve(one + R * Y, one - R * Y)
    model = _best(f, S, noise, where)
    return _certified(_admittance(*model, R), f, Y, noise, where)


def _best(f: np.ndarray, S: np.ndarray, noise: float, where: str) -> ABCD:
    """Of the fits with few to many poles the passive one with the least deviation, or the first
    that is as near as they are without."""
    fits = _fits(f, S, noise, where)
    found, least = None, np.inf
    for left, fit in fits:
        if left > least:
            break
        model = _passive(fit, f, len(S[0]))
        if model is None:
            continue
        error = _deviation(_transfer(model, f), S)
        if error < least:
            found, least = model, error
        if error < CLOSE * fits[0][0]:
            break
    if found is None or least > POOR:
        raise UsageError(
            "no passive model comes near the measurement",
            where=where,
            got=f"{least:.2g} of its largest left over by the best of {len(fits)}"
            if found
            else f"none of {len(fits)} is passive",
            expected=f"less than {POOR:g}",
            hint="is the unit of the frequency right, is the reference plane, are there enough "
            "points on every resonance? A part that amplifies has no such model",
        )
    return found


def _fits(f: np.ndarray, S: np.ndarray, noise: float, where: str) -> list[tuple[float, Fit]]:
    """Fits with more and more poles, with their deviations, the least first."""
    try:
        import skrf
        from skrf.vectorFitting import VectorFitting
    except ImportError:
        raise MissingToolError(
            "scikit-rf is not installed",
            where=where,
            expected="it to fit several ports",
            hint="pip install 'kc2spice[measured]'",
        ) from None
    network = skrf.Network(frequency=skrf.Frequency.from_f(f, unit="hz"), s=S, z0=1.0)
    found: list[tuple[float, Fit]] = []
    useless = 0
    for poles in range(2, MOST + 1, 3):
        fit = VectorFitting(network)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of iterations that end early; the deviation decides
            try:
                fit.vector_fit(n_poles_real=2, n_poles_cmplx=poles, enforce_dc=False)
            except (np.linalg.LinAlgError, ValueError):
                continue
        left = _deviation(_response(fit, f, len(S[0])), S)
        least = min((each for each, _ in found), default=np.inf)
        useless = useless + 1 if left > (1 - GAIN) * least else 0
        found.append((left, fit))
        if left < NOISE * noise or useless == PATIENCE:
            break
    return sorted(found, key=lambda each: each[0])


def _passive(fit: Fit, f: np.ndarray, ports: int) -> ABCD | None:
    """The state space of a fit with residues that make it passive; None where they cannot."""
    model = _state_space(fit, ports)
    if passive(*model):
        return model
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # judged here
        try:
            fit.passivity_enforce(n_samples=4 * len(f), f_max=10 * float(f[-1]))
        except (np.linalg.LinAlgError, ValueError):
            return None
    model = _state_space(fit, ports)
    return model if passive(*model) else None


def _transfer(model: ABCD, f: np.ndarray) -> np.ndarray:
    A, B, C, D = model
    s = 2j * np.pi * f[:, None, None]
    return np.asarray(C @ np.linalg.solve(s * np.eye(len(A)) - A, B.astype(complex)[None]) + D)


def _deviation(one: np.ndarray, other: np.ndarray) -> float:
    """Root of the mean square by the largest entry."""
    return float(np.sqrt(np.mean(np.abs(one - other) ** 2)) / np.abs(other).max())


def _response(fit: Fit, f: np.ndarray, ports: int) -> np.ndarray:
    rows = [[fit.get_model_response(i, j, f) for j in range(ports)] for i in range(ports)]
    return np.moveaxis(np.array(rows), 2, 0)


def _state_space(fit: Fit, ports: int) -> ABCD:
    """Real matrices of ``S = D + sum_k R_k / (s - p_k)``, every pole as often as the rank of its
    residue asks."""
    residues = np.asarray(fit.residues).reshape(ports, ports, -1)
    blocks, inputs, outputs = [], [], []
    for k, pole in enumerate(np.asarray(fit.poles)):
        U, size, Vh = np.linalg.svd(residues[:, :, k])
        for column in range(int(np.sum(size > 1e-9 * size[0])) if size[0] > 0 else 0):
            c, b = U[:, column] * size[column], Vh[column]
            if pole.imag == 0:
                blocks.append(np.array([[pole.real]]))
                scale = c[np.argmax(np.abs(c))] / abs(c[np.argmax(np.abs(c))])
                inputs.append((b * scale).real[None])
                outputs.append((c / scale).real[:, None])
            else:
                w = pole.imag
                blocks.append(np.array([[pole.real, w], [-w, pole.real]]))
                inputs.append(2 * np.array([b.real, -b.imag]))
                outputs.append(np.column_stack([c.real, c.imag]))
    n = sum(map(len, blocks))
    A, at = np.zeros((n, n)), 0
    for block in blocks:
        A[at : at + len(block), at : at + len(block)] = block
        at += len(block)
    D = np.asarray(fit.constant_coeff).reshape(ports, ports)
    return A, np.vstack(inputs), np.hstack(outputs), D.real


def passive(A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray) -> bool:
    """Whether the scattering state space takes power at every frequency: it is stable, D is below
    one, and the Hamiltonian of a bound just above one has no eigenvalue on the imaginary axis."""
    if (np.linalg.eigvals(A).real >= 0).any() or np.linalg.norm(D, 2) >= 1 + INSIDE:
        return False
    g = 1 + 10 * INSIDE
    Q = np.linalg.inv(g * g * np.eye(len(D)) - D.T @ D)
    H = np.block(
        [
            [A + B @ Q @ D.T @ C, B @ Q @ B.T],
            [-C.T @ (np.eye(len(D)) + D @ Q @ D.T) @ C, -(A + B @ Q @ D.T @ C).T],
        ]
    )
    values = np.linalg.eigvals(H)
    size = np.abs(values).max()
    crossing = np.abs(values[np.abs(values.real) < 1e-9 * size].imag)
    s = 1j * crossing
    return not any(_gain(A, B, C, D, each) > g * (1 - INSIDE) for each in s)


def _gain(A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray, s: complex) -> float:
    return float(np.linalg.norm(C @ np.linalg.solve(s * np.eye(len(A)) - A, B) + D, 2))


def _admittance(
    A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray, R: float
) -> LinearModel:
    """The state space of charges [C] by voltages [V]."""
    one, r = np.eye(len(D)), np.sqrt(R)
    T = np.linalg.inv(one + D)
    inner, drive = A - B @ T @ C, B @ T / r
    current, direct = -2 * T @ C / r, (one - D) @ T / R
    charge = np.linalg.solve(inner.T, current.T).T  # its rate is the current but for rest
    rest = direct - charge @ drive  # conductance at zero frequency
    n, m = len(A), len(D)
    wide = np.zeros((n + m, n + m))
    wide[:n, :n] = inner
    ports = tuple(Port(f"port{k + 1}", "electrical", pins=(f"port{k + 1}", "ref")) for k in range(m))
    return LinearModel(
        A=wide, B=np.vstack([drive, one]), C=np.hstack([charge, rest]), ports=ports
    )


def _certified(
    model: LinearModel, f: np.ndarray, Y: np.ndarray, noise: float, where: str
) -> LinearModel:
    answer = 2j * np.pi * f[:, None, None] * model.transfer(f)
    deviation = np.abs(answer - Y) / np.abs(Y).max(axis=0)
    worst = np.unravel_index(int(deviation.argmax()), deviation.shape)
    error, at = float(deviation[worst]), float(f[worst[0]])
    rms = float(np.sqrt(np.mean(deviation**2)))
    told = (
        f"{model.order - Y.shape[1]} states fitted to {len(f)} samples: largest deviation "
        f"{error:.2g} of an entry's peak (Y{worst[1] + 1}{worst[2] + 1} at {at:.6g} Hz), rms "
        f"{rms:.2g}, noise of the samples {np.sqrt(2) * noise:.2g}; passive at all frequencies, "
        "measured in the band alone"
    )
    band = float(f[0]), float(f[-1])
    certificate = Certificate(band, error, told, True, True, norm="peak")
    return replace(model, certificate=certificate)
