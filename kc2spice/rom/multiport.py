"""Passive state-space models fitted to measured multiports by vector fitting.

The module fits scattering parameters S for a reference resistance R. All entries of S have the same
poles. First, scikit-rf makes a few iterations of vector fitting (B. Gustavsen, A. Semlyen, IEEE
Trans. Power Delivery 14 (1999) 1052). Then, nonlinear least squares refine the poles, because the
minimum of a least-squares problem hardly depends on rounding errors. Poles are added until the
deviation of the fit is about the noise of the data. The nearest passive model with the same poles
follows from the bounded real lemma. The eigenvalues of a Hamiltonian matrix show whether a model is
passive at all frequencies (S. Boyd, V. Balakrishnan, P. Kabamba, Math. Control Signals Systems 2
(1989) 207). The incident waves are ``a = (v / r + r i) / 2`` and the reflected waves are ``b = (v /
r - r i) / 2 = S a``, with ``r = sqrt(R)``. The state-space equations are::

    x' = A x + B a            v / r = C x + (1 + D) a
    b  = C x + D a            i = (2 a - v / r) / r

The output of an electrical port is the charge, which is the integral of the current i.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import scipy
from scipy.optimize import least_squares

from kc2spice.core.domains import ELECTRICAL
from kc2spice.core.errors import UsageError
from kc2spice.core.optional_libraries import import_optional
from kc2spice.linalg.openblas_kernels import use_fast_kernels
from kc2spice.rom.linear_model import Certificate, LinearModel, Port
from kc2spice.rom.pencil import make_explicit_pencil
from kc2spice.rom.state_space import ABCD

# number of vector fitting iterations; further iterations would amplify rounding errors
FITTING_ITERATIONS = 6
MAX_EVALUATIONS = 60  # largest number of function evaluations in the refinement of poles
# smallest decay rate at which samples determine a pole, divided by the spacing of the samples
MIN_DECAY_RATIO = 0.25
# largest decay rate at which samples determine a pole, divided by the angular frequency at the end
# of the band
MAX_DECAY_RATIO = 10.0
# Upper limits for the frequency of a pole, relative to the upper end of the band. The fit tries the
# largest upper limit first.
# Transmission lines need poles above the band.
# However, a model of measured data with poles above the band is seldom passive.
MAX_FREQUENCY_RATIOS = (3.0, 1.25, 1.001)
# largest number of parameters per measured value; more parameters would describe noise
MAX_PARAMETER_SHARE = 0.25
# Logarithms of start values differ from the logarithms of bounds by at least BOUND_DISTANCE / 4.
BOUND_DISTANCE = 1e-3
MAX_POLES = 60  # largest number of poles; a complex pair counts once
# largest number n of states; the time for passivity enforcement is proportional to n^6
MAX_STATES = 48
NOISE_FACTOR = 1.2  # largest deviation of a good fit, as a multiple of the noise of the data
GOOD_DEVIATION = 1e-5  # largest deviation of a good fit, as a fraction of the largest value
# smallest useful relative reduction of the deviation by three additional poles
MIN_IMPROVEMENT = 0.1
# The search ends if this number of successive fits, each with more poles than the fit before,
# reduces the deviation by less than MIN_IMPROVEMENT.
MAX_FAILURES = 2
# The search ends if the deviation of a passive fit is below PASSIVITY_RATIO times the deviation of
# the best fit without enforced passivity.
PASSIVITY_RATIO = 1.2
# largest deviation of an acceptable passive model, relative to the largest value of the data
POOR_DEVIATION = 0.2
# If rounding errors make a model slightly active, C and D are divided by a factor above one.
# OPTIMUM_ROUNDING is the first trial value of (factor - 1).
OPTIMUM_ROUNDING = 1e-6
MAX_PASSIVITY_EXCESS = 0.1  # largest violation of passivity that scaling corrects
# tolerance of the passivity check, relative to the limit 1 of the largest singular value
PASSIVITY_MARGIN = 1e-7


def fit_multiport(f: np.ndarray, Y: np.ndarray, noise: float, where: str) -> LinearModel:
    """Fit a passive state-space model to admittances ``Y`` (n, ports, ports) [S].

    The frequencies are ``f`` (n,) [Hz]. The ports are ``port1``, ``port2``, …, with the common
    reference pin ``ref``. The error in the certificate is the largest deviation of an entry of Y
    from the samples, relative to the peak of the entry. ``noise`` is the relative standard
    deviation of the noise in the real or the imaginary part of an entry of Y.

    Raises
    ------
    MissingToolError : scikit-rf is not installed.
    UsageError : no passive state-space model fits the data.
    """
    ports = Y.shape[1]
    diagonal = np.abs(Y[:, range(ports), range(ports)])
    R = float(1 / np.median(diagonal[diagonal > 0]))
    one = np.eye(ports)
    S = np.linalg.solve(one + R * Y, one - R * Y)
    model = _convert_to_charges(*_select_fit(f, S, noise, where), R)
    response = 2j * np.pi * f[:, None, None] * model.transfer(f)
    peak = np.abs(Y).max(axis=0)
    # If two ports are not coupled, their entry of Y is zero and has no peak.
    # The deviation of a zero entry is relative to the largest peak of all entries of Y.
    deviation = np.abs(response - Y) / np.where(peak > 0, peak, peak.max())
    worst = np.unravel_index(int(deviation.argmax()), deviation.shape)
    error, at = float(deviation[worst]), float(f[worst[0]])
    rms = float(np.sqrt(np.mean(deviation**2)))
    method = (
        f"{model.order - 2 * Y.shape[1]} states fitted to {len(f)} samples: largest deviation "
        f"{error:.2g} of an entry's peak (Y{worst[1] + 1}{worst[2] + 1} at {at:.6g} Hz), rms "
        f"{rms:.2g}, noise of the samples {np.sqrt(2) * noise:.2g}; passive at all frequencies, "
        "measured in the band alone"
    )
    band = float(f[0]), float(f[-1])
    certificate = Certificate(band, error, method, True, True, norm="peak")
    return replace(model, certificate=certificate)


def _select_fit(f: np.ndarray, S: np.ndarray, noise: float, where: str) -> ABCD:
    """Return the best passive model among fits with different numbers of poles.

    The search begins with the most accurate fits. The search ends at the first passive model that
    is about as accurate as the best fit without enforced passivity. Otherwise, the most accurate
    passive model is returned.
    """
    fits = _fit_increasing_orders(f, S, noise, where)
    result, least = None, np.inf
    for deviation, fit in fits:
        if deviation > least:
            break
        model = _fit_passive(fit, f, S)
        if model is None:
            continue
        error = _compute_rms_deviation(_compute_transfer(model, f), S)
        if error < least:
            result, least = model, error
        if error < PASSIVITY_RATIO * fits[0][0]:
            break
    if result is None or least > POOR_DEVIATION:
        raise UsageError(
            "no passive model matches the measurement",
            where=where,
            got=f"{100 * least:.2g} % deviation for the most accurate of {len(fits)} models"
            if result
            else f"none of the {len(fits)} fitted models is passive",
            expected=f"a passive model with a deviation of less than {100 * POOR_DEVIATION:g} %",
            hint="check the units of frequency and impedance, and the sign of the phase",
        )
    return result


def _fit_increasing_orders(
    f: np.ndarray, S: np.ndarray, noise: float, where: str
) -> list[tuple[float, ABCD]]:
    """Fit models with increasing numbers of poles to scattering parameters.

    Each model is returned as a pair: its deviation from the data, and its state-space matrices. The
    models are sorted by their deviations.
    """
    skrf = import_optional("skrf", where)
    network = skrf.Network(frequency=skrf.Frequency.from_f(f, unit="hz"), s=S, z0=1.0)
    result: list[tuple[float, ABCD]] = []
    failures = 0
    for poles in range(2, MAX_POLES + 1, 3):
        fit = skrf.vectorFitting.VectorFitting(network)
        fit.max_iterations = FITTING_ITERATIONS
        with warnings.catch_warnings():
            # without convergence, the deviation of the fit shows whether the poles are usable
            warnings.simplefilter("ignore")
            try:
                fit.vector_fit(n_poles_real=2, n_poles_cmplx=poles, enforce_dc=False)
            except (np.linalg.LinAlgError, ValueError):
                continue
        parameters = (2 + poles) + poles + (3 + 2 * poles) * S[0].size
        if result and parameters > MAX_PARAMETER_SHARE * 2 * S.size:
            break
        previous_deviation = min((item for item, _ in result), default=np.inf)
        for frequency_ratio in MAX_FREQUENCY_RATIOS:
            model = _realise_state_space(
                *refine_poles(f, S, np.asarray(fit.poles), frequency_ratio)
            )
            if len(model[0]) > MAX_STATES:
                break
            result.append((_compute_rms_deviation(_compute_transfer(model, f), S), model))
            if is_passive(*model):
                break
        if len(model[0]) > MAX_STATES:
            break
        smallest_deviation = min(item for item, _ in result)
        failures = (
            failures + 1 if smallest_deviation > (1 - MIN_IMPROVEMENT) * previous_deviation else 0
        )
        if (
            smallest_deviation < max(NOISE_FACTOR * noise, GOOD_DEVIATION)
            or failures == MAX_FAILURES
        ):
            break
    return sorted(result, key=lambda item: item[0])


def _enforce_passivity(model: ABCD, f: np.ndarray, S: np.ndarray) -> ABCD | None:
    """Compute the nearest passive state space with the same poles.

    The result is None if the optimisation fails.

    The matrices C and D minimise the deviation, subject to the bounded real lemma. The lemma is a
    linear matrix inequality in C, D and the matrix P of a storage function ``x'Px`` (S.
    Grivet-Talocia, B. Gustavsen, Passive Macromodeling, 2016, section 9.4)::

        [ A'P + PA   PB   C' ]
        [ B'P        -1   D' ]  <= 0
        [ C           D   -1 ]
    """
    with use_fast_kernels():
        from cvxopt import matrix, solvers

    A, B, _, _ = model
    n, m = B.shape
    top = 2 * np.pi * float(f[-1])
    states = np.linalg.solve(2j * np.pi * f[:, None, None] * np.eye(n) - A, B.astype(complex)[None])
    size = np.sqrt((np.abs(states) ** 2).mean(axis=(0, 2)))  # rms value of each state
    A, B, states = A / top * size / size[:, None], B / size[:, None] / top, states / size[:, None]
    X = np.concatenate([states, np.broadcast_to(np.eye(m), (len(f), m, m))], axis=1)
    # Each row is one input at one sample; the columns are the states, then the inputs.
    X = np.moveaxis(X, 1, 2).reshape(-1, n + m)
    target = np.moveaxis(S, 1, 2).reshape(-1, m)
    Q, R = np.linalg.qr(np.concatenate([X.real, X.imag]))
    q = Q.T @ np.concatenate([target.real, target.imag])
    scale = np.linalg.norm(q) or 1.0

    pairs = np.tril_indices(n)
    triangle = len(pairs[0])
    count, order = triangle + m * (n + m), n + 2 * m

    def make_inequality_matrix(x: np.ndarray) -> np.ndarray:
        """Return the part of the passivity inequality matrix that is linear in ``x``.

        The result contains zero in place of the constant entries -1 of the matrix. ``x`` contains
        the lower triangle of P, and then the rows of the block matrix ``[C D]``.
        """
        P, CD = np.zeros((n, n)), x[triangle:count].reshape(m, n + m)
        P[pairs] = P.T[pairs] = x[:triangle]
        C, D, zero = CD[:, :n], CD[:, n:], np.zeros((m, m))
        rows = [[A.T @ P + P @ A, P @ B, C.T], [B.T @ P, zero, D.T], [C, D, zero]]
        return np.block(rows).ravel()

    least = np.diag(np.r_[np.zeros(n), np.ones(2 * m)])
    cone = np.zeros((1 + m * (n + m), count + 1))
    cone[0, -1] = -1.0
    cone[1:, triangle:count] = np.kron(np.eye(m), R / scale)
    G = np.vstack([cone, np.transpose(list(map(make_inequality_matrix, np.eye(count + 1))))])
    h = np.concatenate([[0.0], (q.T / scale).ravel(), least.ravel()])
    cost = np.zeros(count + 1)
    cost[-1] = 1.0
    dims = {"l": 0, "q": [len(cone)], "s": [order]}
    try:
        result = solvers.conelp(
            matrix(cost), matrix(G), matrix(h), dims, options={"show_progress": False}
        )
    except (ValueError, ArithmeticError):
        return None
    if result["x"] is None:
        return None
    CD = np.array(result["x"]).ravel()[triangle:-1].reshape(m, n + m)
    C, D = CD[:, :n] / size, CD[:, n:]
    B = B * top * size[:, None]
    return model[0], B, C, D


def _fit_passive(fit: ABCD, f: np.ndarray, S: np.ndarray) -> ABCD | None:
    """Return the most accurate passive state space with the poles of ``fit``.

    The result is None if no passive state space is found.
    """
    if (np.linalg.eigvals(fit[0]).real >= 0).any():
        return None
    if is_passive(*fit):
        return fit
    candidates = [
        _scale_to_passive(model)
        for model in (fit, _enforce_passivity(fit, f, S))
        if model is not None
    ]
    models = [model for model in candidates if model is not None]
    return min(
        models,
        key=lambda model: _compute_rms_deviation(_compute_transfer(model, f), S),
        default=None,
    )


def _scale_to_passive(model: ABCD) -> ABCD | None:
    """Divide C and D by a factor that makes the model passive.

    The factors 1 and ``1 + OPTIMUM_ROUNDING 2^k`` are tried for k = 0, 1, 2, …. The result is None
    if the factor would exceed 1 + :data:`MAX_PASSIVITY_EXCESS`.
    """
    A, B, C, D = model
    excess = 0.0
    while not is_passive(A, B, C / (1 + excess), D / (1 + excess)):
        excess = 2 * excess or OPTIMUM_ROUNDING
        if excess > MAX_PASSIVITY_EXCESS:
            return None
    return A, B, C / (1 + excess), D / (1 + excess)


def _compute_transfer(model: ABCD, f: np.ndarray) -> np.ndarray:
    """Return the transfer matrices of a state-space model at frequencies ``f`` [Hz]."""
    return make_explicit_pencil(*model).transfer(2j * np.pi * f)


def _compute_rms_deviation(one: np.ndarray, other: np.ndarray) -> float:
    """Return the rms difference of two responses, relative to the peak of ``other``."""
    return float(np.sqrt(np.mean(np.abs(one - other) ** 2)) / np.abs(other).max())


def refine_poles(
    f: np.ndarray, S: np.ndarray, poles: np.ndarray, highest: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Refine stable poles near ``poles`` [rad/s] by nonlinear least squares.

    ``poles`` contains the real poles and the poles in the upper half-plane. The fitted function is
    ``D + sum_k R_k / (s - p_k) + R_k* / (s - p_k*)``. Return the poles p, the residues R (poles,
    ports, ports) and the matrix D. The imaginary part of a pole is at most ``highest`` times the
    end of the band.

    The residues and D are linear parameters, which are eliminated from the least-squares problem
    (variable projection with Kaufman's Jacobian: Golub and Pereyra, Inverse Problems 19 (2003) R1).
    Unlike the result of vector fitting, the minimum of the least-squares problem hardly depends on
    rounding errors.
    """
    top = 2 * np.pi * float(f[-1])
    s, real = 2j * np.pi * f / top, np.abs(poles.imag) == 0
    step = float(np.median(np.diff(f))) / float(f[-1])
    # mask of the imaginary parts
    is_imaginary_part = np.arange(len(poles) + int(np.sum(~real))) >= len(poles)
    lower_bounds = np.log(
        np.where(is_imaginary_part, max(f[0] / f[-1], step), MIN_DECAY_RATIO * step)
    )
    upper_bounds = np.log(np.where(is_imaginary_part, highest, MAX_DECAY_RATIO))
    parts = np.r_[np.abs(poles.real), poles.imag[~real]] / top
    start = np.clip(
        np.log(np.maximum(parts, np.exp(lower_bounds))),
        lower_bounds + BOUND_DISTANCE / 4,
        upper_bounds - BOUND_DISTANCE / 4,
    )
    target = S.reshape(len(f), -1)
    target = np.concatenate([target.real, target.imag])

    def unpack_poles(x: np.ndarray) -> np.ndarray:
        """Return the complex poles [rad/s] for the pole parameters ``x``."""
        p = -np.exp(x[: len(poles)]).astype(complex)
        p[~real] += 1j * np.exp(x[len(poles) :])
        return np.asarray(p)

    def fit_residues(x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Fit residues for given pole parameters ``x`` by linear least squares.

        Each column of the least-squares matrix contains the samples of one term of the model.
        Return an orthonormal basis of the columns of this matrix, the fitted coefficients of the
        terms, and the residual of the fit.
        """
        columns, size = _scale_columns(s, unpack_poles(x), real)
        Q, upper = np.linalg.qr(columns)
        coefficients = scipy.linalg.lstsq(upper, Q.T @ target)[0]
        return Q, coefficients / size[:, None], target - columns @ coefficients

    def compute_residual(x: np.ndarray) -> np.ndarray:
        """Return the residuals of the fit as a vector."""
        return fit_residues(x)[2].ravel()

    def compute_residual_slopes(x: np.ndarray) -> np.ndarray:
        """Return the derivatives of the residuals with respect to pole parameters ``x``."""
        Q, coefficients, _ = fit_residues(x)
        result = []
        for change in _yield_pole_derivatives(s, unpack_poles(x), real, coefficients):
            rows = np.concatenate([change.real, change.imag])
            result.append((Q @ (Q.T @ rows) - rows).ravel())
        return np.column_stack(result)

    solution = least_squares(
        compute_residual,
        start,
        compute_residual_slopes,
        bounds=(lower_bounds, upper_bounds),
        x_scale="jac",
        xtol=1e-10,
        ftol=1e-10,
        gtol=1e-12,
        max_nfev=MAX_EVALUATIONS,
    )
    x = solution.x
    p, coefficients = unpack_poles(x), fit_residues(x)[1]
    residues = _recover_residues(coefficients, real)
    shape = S.shape[1:]
    return p * top, (residues * top).reshape(-1, *shape), coefficients[0].reshape(shape)


def _scale_columns(s: np.ndarray, p: np.ndarray, real: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the least-squares columns scaled to norm 1, and the original norms.

    The columns are divided by the norms. Columns contain the real and imaginary parts of the
    following terms: ``1``, ``1 / (s - p)`` for real poles, and ``1 / (s - p) + 1 / (s - p*)`` and
    ``j / (s - p) - j / (s - p*)`` for complex poles.
    """
    one, other = 1 / (s[:, None] - p), 1 / (s[:, None] - p.conj())
    sums = np.where(real, one, one + other)
    columns = np.hstack([np.ones((len(s), 1)), sums, 1j * (one - other)[:, ~real]])
    rows = np.concatenate([columns.real, columns.imag])
    size = np.linalg.norm(rows, axis=0)
    return rows / size, size


def _recover_residues(coefficients: np.ndarray, real: np.ndarray) -> np.ndarray:
    """Convert fitted real coefficients to complex residues (poles, entries).

    ``coefficients`` contains D, the real parts of all residues, and then the imaginary parts of
    complex residues.
    """
    result = coefficients[1 : 1 + len(real)].astype(complex)
    result[~real] += 1j * coefficients[1 + len(real) :]
    return result


def _yield_pole_derivatives(
    s: np.ndarray, p: np.ndarray, real: np.ndarray, coefficients: np.ndarray
) -> Iterator[np.ndarray]:
    """Yield the derivatives of the fit with respect to all log pole parameters.

    The pole parameters are ``-Re(p)`` of all poles p, and ``Im(p)`` of complex poles. Each
    derivative has the shape (frequencies, entries).
    """
    residues = _recover_residues(coefficients, real)
    one, other = 1 / (s[:, None] - p) ** 2, 1 / (s[:, None] - p.conj()) ** 2

    def compute_pole_derivative(k: int, rate: complex) -> np.ndarray:
        """Return the derivative of the fit with respect to a parameter of pole ``k``.

        ``rate`` is the derivative of the pole with respect to the parameter.
        """
        result = np.outer(rate * one[:, k], residues[k])
        if not real[k]:
            result = result + np.outer(np.conj(rate) * other[:, k], residues[k].conj())
        return result

    for k in range(len(p)):
        yield compute_pole_derivative(k, p[k].real)
    for k in np.flatnonzero(~real).tolist():
        yield compute_pole_derivative(k, 1j * p[k].imag)


def _realise_state_space(poles: np.ndarray, residues: np.ndarray, D: np.ndarray) -> ABCD:
    """Compute real state-space matrices from poles and residues.

    The response of the state space is ``D + sum_k R_k / (s - p_k)``.

    A real pole has as many states as the rank of the pole's residue matrix. A complex pair of poles
    has twice as many states as the rank of the residue matrix.
    """
    ports = len(D)
    blocks, inputs, outputs = [], [], []
    for pole, residue in zip(poles, residues, strict=True):
        U, size, Vh = np.linalg.svd(residue)
        rank = int(np.sum(size > 1e-9 * size[0])) if size[0] > 0 else 0
        into, out = Vh, U * size
        # with separate states for each input, the matrices have few entries
        if rank == ports:
            into, out = np.eye(ports), residue
        for column in range(rank):
            c, b = out[:, column], into[column]
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
    return scipy.linalg.block_diag(*blocks), np.vstack(inputs), np.hstack(outputs), D


def is_passive(A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray) -> bool:
    """Return whether a state-space model of scattering parameters is passive.

    A passive model is stable, the norm of D is at most one, and the gain is at most one at all
    frequencies. The gain can cross a limit just above one only at the imaginary eigenvalues of a
    Hamiltonian matrix. Therefore, the function computes the gain only at the imaginary eigenvalues
    of the Hamiltonian matrix.
    """
    if (np.linalg.eigvals(A).real >= 0).any() or np.linalg.norm(D, 2) >= 1 + PASSIVITY_MARGIN:
        return False
    g = 1 + 10 * PASSIVITY_MARGIN
    Q = np.linalg.inv(g * g * np.eye(len(D)) - D.T @ D)
    H = np.block(
        [
            [A + B @ Q @ D.T @ C, B @ Q @ B.T],
            [-C.T @ (np.eye(len(D)) + D @ Q @ D.T) @ C, -(A + B @ Q @ D.T @ C).T],
        ]
    )
    values = np.linalg.eigvals(H)
    size = np.abs(values).max()
    crossing = np.abs(values[np.abs(values.real) < 1e-9 * size].imag) / (2 * np.pi)
    gain = np.linalg.norm(_compute_transfer((A, B, C, D), crossing), 2, axis=(1, 2))
    return bool((gain <= g * (1 - PASSIVITY_MARGIN)).all())


def _convert_to_charges(
    A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray, R: float
) -> LinearModel:
    """Convert a scattering-parameter model to a model of charges versus voltages.

    The input ``v`` [V] contains the voltages of the ports, and the output ``q`` [C] the charges of
    the ports. ``r`` is the square root of the reference resistance R [Ohm].

    The incident waves ``a`` remain algebraic unknowns, so that the poles of the fit remain in
    separate blocks of the matrix A::

        x' = A x + B a,    q' = (2 a - v / r) / r,    0 = v / r - C x - (1 + D) a
    """
    n, m = B.shape
    one, r = np.eye(m), np.sqrt(R)
    zero = np.zeros((m, m))
    wide = np.block(
        [
            [A, np.zeros((n, m)), B],
            [np.zeros((m, n)), zero, 2 * one / r],
            [-C, zero, -one - D],
        ]
    )
    ports = tuple(
        Port(f"port{k + 1}", ELECTRICAL.port, pins=(f"port{k + 1}", "ref")) for k in range(m)
    )
    return LinearModel(
        A=wide,
        E=np.diag(np.r_[np.ones(n + m), np.zeros(m)]),
        B=np.vstack([np.zeros((n, m)), -one / R, one / r]),
        C=np.hstack([np.zeros((m, n)), one, zero]),
        ports=ports,
    )
