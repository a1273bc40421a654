"""Conversion of symmetric models to decoupled resonators, and tables of modes.

A table of modes contains the frequency, the Q factor and the coupling to the ports of each mode.
The response of the resonators to piecewise linear loads is computed exactly.

Residual modes without inertia
    Residual modes of a reduced model have frequencies far above the band, and make the compliance
    of the ports exact. The body itself does not have the residual modes. In series with the
    stiffness of a contact, the inertia of the residual modes causes oscillations that the body does
    not have. Component mode synthesis with a massless boundary omits only the inertia of residual
    modes, not the compliance and damping (Monjaraz Tec, Gross and Krack 2021, arXiv 2111.07693)::

        damp z' + omega^2 z = g u        instead of        z'' + damp z' + omega^2 z = g u

A constant loss tangent of the dielectric
    If the loss tangent of a dielectric is the same at every frequency, causality requires the
    permittivity of a constant-phase element (A. K. Jonscher, Nature 267 (1977) 673)::

        eps(s) = eps (s / w0)^-m,    m = (2 / pi) arctan(tan delta),    w0 / (2 pi) = 1 kHz

    Data sheets give permittivities at the frequency w0 / (2 pi). A netlist contains Foster's sum
    ``a_0 + sum_k a_k / (1 + s t_k)`` instead of ``eps(s)``. The sum represents a capacitor in
    parallel with series RC branches. All amplitudes ``a_k`` are at least zero, so the sum is
    passive. The amplitudes are fitted to the permittivity in the band by non-negative least
    squares. The clamped capacitances D are multiplied by Foster's sum ``a_0 + sum_k a_k / (1 + s
    t_k)``.

    Data sheets give the loss tangent of the mechanically free part at 1 kHz. The capacitance of the
    free part is ``D + C_m``. The motional capacitance ``C_m = sum_j gain_j^2 / omega_j^2`` has no
    loss far below the resonances. The loss angle theta of the clamped part follows from
    ``tan delta`` of the free part:

        D sin theta = tan delta (D cos theta + C_m),   theta = delta + arcsin((C_m / D) sin delta).

    The dielectric loss also changes the stiffness, because deformation causes electric fields. The
    model neglects the change of the stiffness due to dielectric loss. The neglected relative loss
    of a mode is tan delta times the share of electric energy in the mode's energy at constant
    charge.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy

from kc2spice.core.domains import ACCELERATION, PORTS
from kc2spice.core.equality import EqualByContent
from kc2spice.core.errors import UsageError
from kc2spice.core.key_actions import DeleteKey
from kc2spice.rom.error_estimate import ErrorEstimator, estimate_errors_above_band
from kc2spice.rom.linear_model import Certificate, LinearModel, Port
from kc2spice.rom.response import Response
from kc2spice.rom.soft_support import count_rigid_body_modes
from kc2spice.rom.state_space import normalise_modes

# A relative coupling of modes up to this limit counts as a rounding error of proportional damping.
# A larger coupling of modes indicates damping that is not proportional.
MAX_MODAL_COUPLING = 1e-8
LISTED_MODES = 20  # largest number of modes in a table
# A mode is a rigid-body mode if (frequency / end of the band) is below this ratio.
ZERO_FREQUENCY_RATIO = 1e-5
COMPLIANCE_UNITS = {kind: domain.compliance for kind, domain in PORTS.items() if domain.reference}


@dataclass(frozen=True, eq=False)
class Resonators(EqualByContent):
    """Decoupled modes ``m_j z_j'' + damp_j z_j' + omega_j^2 z_j = sum_k gain_jk u_k``.

    The inputs of the ports are ``u_k``. The outputs are
    ``y_k = sum_j gain_jk z_j + sum_l D_kl u_l``.

    The arrays are ``omega`` (q,) in rad/s, ``damp`` (q,) in 1/s, ``gain`` (q, p), and ``D`` (p, p).
    ``m_j`` is 0 for the last ``massless`` modes, and 1 for all other modes. A massless mode has the
    time constant ``damp_j / omega_j^2``. The model is reciprocal. The model is stable if ``damp >=
    0``, and passive if, in addition, ``D`` is positive semi-definite. For an electrical port, u is
    the voltage and y the charge.
    """

    omega: np.ndarray
    damp: np.ndarray
    gain: np.ndarray
    D: np.ndarray
    ports: tuple[Port, ...]
    certificate: Certificate | None
    massless: int = 0

    @property
    def order(self) -> int:
        """Number of unknowns: one for each mode, including modes without inertia."""
        return self.omega.size

    @property
    def inertia(self) -> np.ndarray:
        """Factors ``m_j`` (q,) of the inertia: 1, or 0 for modes without inertia."""
        return (np.arange(self.order) < self.order - self.massless).astype(float)

    def to_linear_model(self) -> LinearModel:
        """Convert the resonators to a :class:`LinearModel`.

        :func:`compute_resonators` is the exact inverse of this conversion.
        """
        return LinearModel(
            M=np.diag(self.inertia),
            E=np.diag(self.damp),
            K=np.diag(self.omega**2),
            B=self.gain,
            D=self.D,
            ports=self.ports,
            certificate=self.certificate,
        )


def compute_resonators(rom: LinearModel) -> Resonators | None:
    """Convert a model with symmetric K and M to decoupled, mass-normalised modes.

    The result is None for a first-order model, an indefinite or singular M or K, ``C != B'``, or
    damping that couples modes. The function solves the eigenvalue problem ``M phi = mu K phi``
    instead of ``K phi = lambda M phi``, because K has a smaller condition number than M.
    """
    if rom.first_order or not rom.symmetric:
        return None
    K, E, M = rom.pencil.make_dense().coefficients
    one, massless = np.eye(rom.order), int(np.count_nonzero(np.diag(M) == 0.0))
    form = one * (np.arange(rom.order) < rom.order - massless)
    diagonal = np.array_equal(M, form) and all(np.array_equal(P, P * one) for P in (E, K))
    if diagonal and (np.diag(K) > 0).all():
        return Resonators(
            np.sqrt(np.diag(K)),
            np.diag(E).copy(),
            rom.B,
            rom.D,
            rom.ports,
            rom.certificate,
            massless,
        )
    try:
        mu, phi = scipy.linalg.eigh(M, K)
    except np.linalg.LinAlgError:
        return None
    if mu[0] <= 0:
        return None
    mu, phi = mu[::-1], phi[:, ::-1] / np.sqrt(mu[::-1])
    damping = phi.T @ E @ phi
    damp = np.diag(damping).copy()
    scale = np.sqrt(np.abs(np.outer(damp, damp))) + np.finfo(float).tiny
    if (np.abs(damping - np.diag(damp)) > MAX_MODAL_COUPLING * scale).any():
        return None
    gain = phi.T @ rom.B
    # mode shapes have arbitrary signs; positive largest gains make netlists equal on all computers
    gain *= np.sign(gain[np.arange(len(gain)), np.abs(gain).argmax(axis=1)])[:, None]
    return Resonators(1 / np.sqrt(mu), damp, gain, rom.D, rom.ports, rom.certificate)


def tabulate_modes(model: LinearModel) -> dict[str, Any] | None:
    """List the modes of a model with all electrodes shorted and no mechanical load.

    The list ends at the end of the certificate's band. Each item of ``modes`` has the keys
    ``frequency_hz``, ``quality`` and ``couplings``. ``quality`` is the Q factor, or None for an
    undamped mode. ``couplings`` contains the coupling of the mode to each port, keyed by port.
    ``units`` contains the units of the couplings.

    The coupling of an electrical port is the effective coupling factor
    ``k = sqrt(C_j / (C_j + C_above))``. The mode adds ``C_j = gain_j^2 / omega_j^2`` [F] to the
    static capacitance, and ``C_above`` is the capacitance of all higher modes and of the clamped
    body. If a mode is far from all other modes, ``k^2 = 1 - (f_r / f_a)^2`` with the resonance
    frequency f_r and the antiresonance frequency f_a. At any other port, the coupling is ``gain_j^2
    / omega_j^2``: the contribution of the mode to the static response of the port.

    If damping couples modes, each pair of complex poles counts as a mode, and ``omega_j`` is the
    magnitude of the poles. Rigid-body modes are omitted. The result is None for a first-order
    model, a model with signal ports, or a model without modes in the band.
    """
    result = _compute_modal_data(model)
    if result is None:
        return None
    omega, damp, share, rest = result
    end = np.inf if model.certificate is None else model.certificate.band_hz[1]
    order = np.argsort(omega)
    electrical = np.array([port.electrical for port in model.ports])
    above = rest + share[order].sum(axis=0) - np.cumsum(share[order], axis=0)
    modes = []
    for j, higher in zip(order[:LISTED_MODES], above, strict=False):
        if omega[j] > 2 * np.pi * end:
            break
        # a mode that a port does not excite has a share of zero plus or minus a rounding error
        capacitance = np.maximum(share[j], 0.0)
        total = capacitance + np.maximum(higher, 0.0)
        factor = np.sqrt(np.divide(capacitance, total, out=np.zeros_like(total), where=total > 0))
        size = np.where(electrical, factor, share[j])
        modes.append(
            {
                "frequency_hz": float(omega[j] / (2 * np.pi)),
                "quality": float(omega[j] / damp[j]) if damp[j] > 0 else None,
                "couplings": {p.name: float(v) for p, v in zip(model.ports, size, strict=True)},
            }
        )
    units = {port.name: COMPLIANCE_UNITS.get(port.kind, "") for port in model.ports}
    return {"units": units, "modes": modes} if modes else None


def _compute_modal_data(
    model: LinearModel,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray] | None:
    """Return frequencies, damping and static responses of modes, and the direct term.

    The results are ``omega`` (modes,) [rad/s], ``damp`` (modes,) [1/s], the static responses
    ``gain^2 / omega^2`` (modes, ports), and the instantaneous responses (ports,).
    """
    result = compute_resonators(model)
    if result is None:
        return _compute_modal_data_from_poles(model)
    count = result.order - result.massless
    share = result.gain**2 / result.omega[:, None] ** 2
    rest = np.diag(result.D) + share[count:].sum(axis=0)
    return result.omega[:count], result.damp[:count], share[:count], rest


def _compute_modal_data_from_poles(
    model: LinearModel,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray] | None:
    """Compute modal data from the poles of a second-order model.

    The four results are the same as in :func:`_compute_modal_data`. The result is None for a
    first-order model or a model with signal ports.

    The static response of a pair of poles at a port is ``-2 Re(residue / pole)``, with the residue
    of the port's driving-point response. For decoupled modes, the static response equals ``gain^2 /
    omega^2``.
    """
    if model.first_order or not all(port.conservative for port in model.ports):
        return None
    K, E, M = model.pencil.make_dense().coefficients
    n, one = len(K), np.eye(len(K))
    # typical angular frequency [rad/s]
    scale = np.sqrt(np.abs(np.diag(K)).max() / np.abs(np.diag(M)).max())
    left = np.block([[np.zeros((n, n)), one], [-K, -scale * E]])
    right = np.block([[one, np.zeros((n, n))], [np.zeros((n, n)), scale**2 * M]])
    values, dual, eigenvectors = scipy.linalg.eig(left, right, left=True, right=True)
    end = np.abs(values[np.isfinite(values)]).max()
    if model.certificate is not None:
        end = min(end, 2 * np.pi * model.certificate.band_hz[1] / scale)
    rows = np.isfinite(values) & (values.imag > ZERO_FREQUENCY_RATIO * end)
    weight = np.einsum("ij,ij->j", dual.conj(), right @ eigenvectors)[rows]
    into = dual[n:, rows].conj().T @ model.B
    out = model.C @ eigenvectors[:n, rows]
    share = -2 * np.real(into * out.T / weight[:, None] / values[rows, None])
    size = np.abs(values[rows]) * scale
    return size, -2 * values[rows].real * scale, share, np.diag(model.D)


# largest permitted change of a compliance by omitted inertia, relative to the static compliance
MASSLESS_ERROR = 1e-3
# Replaces MASSLESS_ERROR if (damping ratio of the lowest massless mode) < MAX_RINGING_RATIO.
# Modes with little damping depend on the mesh, ring for hundreds of periods, and limit time steps.
# With massless modes instead, the simulated launch of a chip needs a third of the time points.
# Massless modes change the simulated launch of a chip with 0.01 % damping by 1.2e-3.
# A finer model changes the simulated launch in the same direction as massless modes do, but by four
# times as much.
RINGING_ERROR = 1e-2
MAX_RINGING_RATIO = 0.02
# A mode may become massless if (frequency / end of the band) exceeds this ratio.
# Modes nearer to the band keep their inertia, because they do not follow loads instantaneously.
MIN_FREQUENCY_RATIO = 2.0
EQUAL_TIMES_TOLERANCE = 1e-9  # relaxation times up to this relative difference count as equal
# A combination of modes counts as not driven by any port if (its singular value / largest singular
# value) is below this ratio.
ZERO_SINGULAR_VALUE = 1e-12


def make_highest_modes_massless(model: Resonators, tolerance: float | None = None) -> Resonators:
    """Replace the highest modes of a model by states without inertia.

    The certificate of the result includes the additional error. The function replaces as many modes
    as possible under two conditions:

    * At the end f of the band, the omitted inertia changes the compliance of every mechanical port
      by less than ``MASSLESS_ERROR`` of the static compliance. At the frequency f, massless
      modes with the port gains g_j and frequencies ``f_j = w_j / (2 pi)`` change the compliance by
      ``sum_j (g_j / w_j)^2 (f / f_j)^2``. If the lowest massless mode has little damping, the limit
      is ``RINGING_ERROR`` instead.
    * The error estimate of the resulting model is at most ``tolerance``.

    The static response remains exact, and the model remains passive. If all massless modes have
    equal relaxation times, they are merged into one state for each linearly independent port. For
    example, all modes have equal relaxation times if damping is proportional to stiffness. A mode
    without inertia contributes nothing to the response of an acceleration port.
    """
    certificate = model.certificate
    if certificate is None:
        return model
    band = certificate.band_hz
    exact = Response(model.to_linear_model().pencil)
    estimator = ErrorEstimator(exact, band, static=True)
    for count in range(_count_quasi_static_modes(model, band[1]), 0, -1):
        result = _remove_inertia(model, count)
        error = certificate.error_estimate
        massless_response = Response(result.to_linear_model().pencil)
        error += estimator.estimate_model_error(massless_response)
        if tolerance is None or error <= tolerance:
            cut = result.omega[result.order - result.massless] / (2 * np.pi)
            method = f"{certificate.method}; modes at {cut:.3g} Hz and above without inertia, "
            method += "whose effect is part of the error estimate"
            added_errors = dict(
                estimate_errors_above_band(model.ports, exact, massless_response, band)
            )
            above = tuple((f, before + added_errors.get(f, 0.0)) for f, before in certificate.above)
            return replace(
                result,
                certificate=replace(certificate, error_estimate=error, method=method, above=above),
            )
    return model


def _count_quasi_static_modes(model: Resonators, top: float) -> int:
    """Count the highest modes whose inertia is negligible up to ``top`` [Hz]."""
    moved = [port.has_position for port in model.ports]
    descending = np.argsort(model.omega)[::-1]
    omega, ratio = model.omega[descending], 2 * np.pi * top / model.omega[descending]
    share = (model.gain[descending][:, moved] / omega[:, None]) ** 2
    share /= share.sum(axis=0) + np.finfo(float).tiny
    omitted_inertia = np.cumsum(share * ratio[:, None] ** 2, axis=0).max(axis=1)
    limit = np.where(
        model.damp[descending] < 2 * MAX_RINGING_RATIO * omega, RINGING_ERROR, MASSLESS_ERROR
    )
    acceptable = np.flatnonzero((omitted_inertia <= limit) & (MIN_FREQUENCY_RATIO * ratio <= 1))
    return int(acceptable[-1]) + 1 if acceptable.size else 0


def _remove_inertia(model: Resonators, count: int) -> Resonators:
    """Make the ``count`` highest modes of a model massless."""
    for port, capacitance in zip(model.ports, np.diag(model.D), strict=True):
        if port.has_charge_output and capacitance <= 0:
            raise UsageError(
                "a body with an electrode without capacitance cannot have massless contact ports",
                where=port.name,
                hint='set contact.inertia = "lumped"',
            )
    order = np.argsort(model.omega)
    low, high = order[:-count], order[-count:]
    omega, damp, gain = model.omega[high], model.damp[high], model.gain[high].copy()
    gain[:, [port.domain is ACCELERATION for port in model.ports]] = 0.0
    relaxation_times = damp / omega**2
    if np.ptp(relaxation_times) <= EQUAL_TIMES_TOLERANCE * relaxation_times.max():
        _, size, shapes = np.linalg.svd(gain / omega[:, None], full_matrices=False)
        significant = size > ZERO_SINGULAR_VALUE * size[0]
        omega = np.full(int(significant.sum()), omega[0])
        damp, gain = (
            relaxation_times[0] * omega**2,
            omega[:, None] * size[significant, None] * shapes[significant],
        )
        gain *= np.sign(gain[np.arange(len(gain)), np.abs(gain).argmax(axis=1)])[:, None]
    return Resonators(
        np.r_[model.omega[low], omega],
        np.r_[model.damp[low], damp],
        np.vstack([model.gain[low], gain]),
        model.D,
        model.ports,
        None,
        omega.size,
    )


_BLOCK_STEPS = 4096  # number of time steps per group, which limits the memory


def simulate_resonators(
    model: Resonators, t: np.ndarray, load: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Compute outputs and stored energy of resonators under given loads over time.

    ``load`` (n, ports) contains forces on the body [N] and voltages [V] at the times ``t`` (n,)
    [s]. Between successive times, the loads are linear. The outputs (n, ports) are displacements
    [m] and charges [C]. The stored energy (n,) is in J.

    The displacement z of each mode satisfies ``z'' + d z' + w^2 z = r`` with the load r. The
    characteristic equation ``s^2 + d s + w^2 = 0`` of a mode has the roots a and b. For each root
    a, the equation ``x' = a x + r`` with the load r is integrated over the time steps h:

        x(t + h) = e^(ah) x(t) + h p1(ah) r(t) + h p2(ah) (r(t + h) - r(t))

    The functions p1 and p2 are ``p1(s) = (e^s - 1)/s`` and ``p2(s) = (e^s - 1 - s)/s^2``. The
    states ``x_a`` and ``x_b`` of the roots a and b give the displacement ``z = (x_a - x_b)/(a -
    b)`` of the mode. For piecewise linear loads, the formulas are exact for any time step h. A mode
    without inertia has only one state. The body starts in equilibrium with the loads ``load[0]``.
    """
    drive, inertial = load @ model.gain.T, model.order - model.massless
    z = np.empty_like(drive)
    z[:, :inertial], rate = integrate_modes(
        model.omega[:inertial], model.damp[:inertial], t, drive[:, :inertial]
    )
    z[:, inertial:] = drive[:, inertial:] / model.omega[inertial:] ** 2
    # undamped massless states respond without delay
    delayed = inertial + np.flatnonzero(model.damp[inertial:])
    damp = model.damp[delayed]
    z[:, delayed] = integrate_modal_states(
        -(model.omega[delayed] ** 2) / damp, t, drive[:, delayed] / damp
    ).real
    stored = (rate**2).sum(axis=1) / 2 + ((model.omega * z) ** 2).sum(axis=1) / 2
    stored += np.einsum("nk,kl,nl->n", load, model.D, load) / 2
    return z @ model.gain + load @ model.D, stored


def integrate_modes(
    omega: np.ndarray, damp: np.ndarray, t: np.ndarray, drive: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Integrate modes ``z'' + damp z' + omega^2 z = drive`` from equilibrium.

    ``drive`` (n, modes) is linear between the times ``t`` (n,). Return the displacements z and the
    velocities z', two arrays of shape (n, modes).
    """
    a, b = _compute_oscillator_roots(omega, damp)
    if (b == a.conj()).all():  # for conjugate roots, x_b is the conjugate of x_a
        x_a = integrate_modal_states(a, t, drive)
        x_b = x_a.conj()
    else:
        both = integrate_modal_states(np.concatenate([a, b]), t, np.tile(drive, 2))
        x_a, x_b = both[:, : a.size], both[:, a.size :]
    return ((x_a - x_b) / (a - b)).real, ((a * x_a - b * x_b) / (a - b)).real


def integrate_modal_states(roots: np.ndarray, t: np.ndarray, drive: np.ndarray) -> np.ndarray:
    """Integrate the modal states ``x' = a x + r`` of all poles a over time.

    ``roots`` contains the poles a, and ``drive`` the values of r at the times ``t``.

    Return the states x, an array of shape (n, roots). The time steps are divided into groups. All
    groups are integrated in parallel, each from the state zero. Afterwards, the free response that
    starts from the final state of one group is added to the states of the next group.
    """
    states = np.empty((t.size, roots.size), dtype=np.result_type(roots, drive))
    states[0] = state = drive[0] / -roots
    for begin in range(0, t.size - 1, _BLOCK_STEPS):
        part = slice(begin, min(begin + _BLOCK_STEPS, t.size - 1) + 1)
        count = part.stop - part.start - 1
        side = math.isqrt(count - 1) + 1
        shape = (side, side, roots.size)
        grow, push = (
            np.resize(item, shape)
            for item in _compute_step_propagators(roots, t[part], drive[part])
        )
        for k in range(1, side):
            push[:, k] += grow[:, k] * push[:, k - 1]
            grow[:, k] *= grow[:, k - 1]
        for row in range(side):
            push[row] += grow[row] * state
            state = push[row, -1]
        states[part][1:] = push.reshape(side**2, roots.size)[:count]
        state = states[part.stop - 1]
    return states


def _compute_oscillator_roots(omega: np.ndarray, damp: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the slow and the fast roots of ``s^2 + damp s + omega^2`` for all modes.

    Nearly equal roots of a mode are replaced by roots that differ by 2e-4 omega.
    """
    half = np.sqrt(damp.astype(complex) ** 2 / 4 - omega**2)
    half = np.where(np.abs(half) < 1e-4 * omega, 1e-4 * omega, half)
    fast = -damp / 2 - half
    # The slow root is computed from the product of both roots.
    # From the sum of both roots, the slow root of a strongly damped mode would be inaccurate.
    return np.where(fast.imag == 0, omega**2 / fast, fast.conj()), fast


def _compute_step_propagators(
    roots: np.ndarray, t: np.ndarray, drive: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the propagator ``e^(ah)`` and the load increment of each time step.

    Both results have the shape (steps, roots).
    """
    h = np.diff(t)[:, None]
    s = h * roots
    small = np.abs(s) < 1e-2
    safe = np.where(small, 1.0, s)
    grow = np.exp(s)
    p1 = np.where(small, 1 + s / 2 * (1 + s / 3 * (1 + s / 4)), (grow - 1) / safe)
    p2 = np.where(small, (1 + s / 3 * (1 + s / 4 * (1 + s / 5))) / 2, (p1 - 1) / safe)
    return grow, h * (p1 * drive[:-1] + p2 * np.diff(drive, axis=0))


TANGENT_FREQUENCY = 1e3  # frequency [Hz] at which data sheets give the loss tangent
# largest number of decades below the upper band limit over which Foster's sum is fitted
DEFAULT_DECADES = 4.0
POINTS_PER_DECADE = 30
MAX_RELAXATIONS = 6  # largest number of relaxation terms per decade
# permitted error of Foster's sum, relative to the smaller of the loss tangent and 0.01
LOSS_ERROR_SHARE = 0.02
# A clamped loss tangent counts as zero up to this ratio to the largest loss tangent.
NEGLIGIBLE_TANGENT_RATIO = 1e-9


def compute_permittivity_ratio(frequency: np.ndarray, tangent: float) -> np.ndarray:
    """Return the complex permittivity ratio ``eps(s) / eps`` (n,) at frequencies [Hz]."""
    m = 2 / np.pi * np.arctan(tangent)
    return np.asarray((1j * np.asarray(frequency) / TANGENT_FREQUENCY) ** -m)


def compute_clamped_loss_tangent(tangent: float, ratio: float) -> float:
    """Compute the loss tangent of a clamped body from the loss tangent of a free body.

    The loss tangents of the free body and of the clamped body are values at 1 kHz.

    Parameters
    ----------
    tangent : float
        Loss tangent, tan delta, of the free body, as in data sheets.
    ratio : float
        Ratio of motional to clamped capacitance at zero frequency, ``C_m / D``.

    Raises
    ------
    UsageError : the clamped capacitance is too small for the loss tangent.

    Examples
    --------
    >>> round(compute_clamped_loss_tangent(0.02, 1.0), 4)
    0.04
    """
    if not tangent * ratio < 1:  # otherwise the clamped loss angle would be at least 90 degrees
        raise UsageError(
            "the loss tangent must be less than the ratio of clamped to motional capacitance",
            where="damping.loss_tangent",
            got=f"{tangent:g}",
            expected=f"less than {1 / ratio:.3g}",
            hint=f"write a smaller loss tangent, for example  loss_tangent = {0.5 / ratio:.1g}  in "
            "the table `damping`",
        )
    delta = math.atan(tangent)
    return math.tan(delta + math.asin(ratio * math.sin(delta)))


def fit_foster_network(
    tangent: float, band: tuple[float, float], error: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """Fit a Foster sum with few terms to a permittivity with constant loss tangent.

    The Foster sum is ``a_0 + sum_k a_k / (1 + s t_k)``. Return the amplitudes ``a`` (k + 1,), the
    rates ``1/t`` (k,) [1/s], and the largest relative error of the sum. If no tried Foster sum has
    an error of at most ``error``, the most accurate Foster sum is returned.
    """
    low, high = max(band[0], band[1] / 10**DEFAULT_DECADES), band[1]
    decades = np.log10(high / low) + 1e-9
    f = np.geomspace(low, high, int(POINTS_PER_DECADE * decades) + POINTS_PER_DECADE)
    target, s = compute_permittivity_ratio(f, tangent), 2j * np.pi * f[:, None]
    best = np.inf
    result = np.ones(1), np.empty(0)
    for item in range(1, MAX_RELAXATIONS + 1):
        count = int(np.ceil(item * decades)) + 2
        rates = 2 * np.pi * np.geomspace(low / 3, 3 * high, count)
        A = np.column_stack([np.ones(len(f)), 1 / (1 + s / rates)]) / target[:, None]
        one = np.r_[np.ones(len(f)), np.zeros(len(f))]
        a = scipy.optimize.nnls(np.concatenate([A.real, A.imag]), one)[0]
        trial_error = float(np.abs(A @ a - 1).max())
        if trial_error < best:
            best, result = trial_error, (a, rates)
        if best <= error:
            break
    return *result, best


def add_dielectric_loss(model: LinearModel, tangents: Sequence[float]) -> LinearModel:
    """Add dielectric loss to a model by massless states, which represent relaxations.

    ``tangents`` contains the loss tangent of the mechanically free body at 1 kHz for each
    electrode, while all other electrodes are shorted. The loss tangents are constant in the band of
    the certificate. The error estimate in the certificate of the result includes the deviation of
    the loss tangents from a constant. The relaxations are electrically in parallel with the clamped
    capacitances, so they do not depend on the mechanical damping. The mechanical damping may
    couple modes.

    Raises
    ------
    UsageError : the model has no certificate or no electrodes, or the clamped capacitance is too
    small for a loss tangent.
    """
    known = model.certificate
    electrical = [k for k, port in enumerate(model.ports) if port.electrical]
    if known is None or not electrical or model.first_order:
        raise UsageError(
            "this body has no dielectric, so it cannot have a loss tangent",
            where="damping.loss_tangent",
            expected="a body with electrodes",
            hint=DeleteKey("loss_tangent"),
        )
    K, E, M = model.pencil.make_dense().coefficients
    if any(not np.array_equal(P, np.diag(np.diag(P))) for P in (K, M)):
        model = _use_modal_coordinates(model)
        K, E, M = model.pencil.make_dense().coefficients
    D = model.D[np.ix_(electrical, electrical)]
    elastic = np.diag(K) > 0
    shares = model.B[elastic][:, electrical] / np.sqrt(np.diag(K)[elastic])[:, None]
    motional = np.sum(shares**2, axis=0)
    limit = LOSS_ERROR_SHARE * min(min(filter(None, tangents)), 0.01)
    instantaneous, errors, count = np.zeros_like(D), [0.0], 0
    paces, gains = [np.empty(0)], [np.empty((0, len(electrical)))]
    for loss, columns in _split_clamped_capacitances(D, motional, tangents):
        if loss <= NEGLIGIBLE_TANGENT_RATIO * max(tangents):
            instantaneous += columns @ columns.T
            continue
        amplitude, rates, error = fit_foster_network(loss, known.band_hz, limit)
        used = amplitude[1:] > 0
        pace = np.repeat(rates[used], columns.shape[1])
        gain = np.vstack([np.sqrt(a) * columns.T for a in amplitude[1:][used]])
        paces.append(pace)
        gains.append(pace[:, None] * gain)
        instantaneous += amplitude[0] * (columns @ columns.T)
        errors.append(error)
        count += int(used.sum())
    pace, B = np.concatenate(paces), np.zeros((sum(map(len, gains)), len(model.ports)))
    B[:, electrical] = np.vstack(gains)
    clamped = model.D.copy()
    clamped[np.ix_(electrical, electrical)] = instantaneous
    texts = " and ".join(f"{value:g}" for value in sorted(set(tangents)))
    method = f"{known.method}; loss tangent of {texts} at 1 kHz approximated by {count} "
    method += f"relaxations, with a relative error of the permittivity of {max(errors):.1e}"
    error_estimate = known.error_estimate + max(errors)
    return replace(
        model,
        M=scipy.linalg.block_diag(M, np.zeros((pace.size, pace.size))),
        E=scipy.linalg.block_diag(E, np.diag(pace)),
        K=scipy.linalg.block_diag(K, np.diag(pace**2)),
        rayleigh=None,
        B=np.vstack([model.B, B]),
        C=np.hstack([model.C, B.T]),
        D=clamped,
        basis=None,
        certificate=replace(known, error_estimate=error_estimate, method=method),
    )


def _split_clamped_capacitances(
    D: np.ndarray, motional: np.ndarray, tangents: Sequence[float]
) -> list[tuple[float, np.ndarray]]:
    """Split the matrix D of the clamped capacitances into parts with one loss tangent each.

    Return the clamped loss tangent of each part, and a matrix R. The capacitances of the part are
    ``R R'``, and their sum over all parts is D. ``motional`` contains the motional capacitance of
    each electrode, and ``tangents`` the loss tangents of the free body.

    If all loss tangents are equal, there is one part. Its clamped loss tangent follows from the
    sums of the motional and of the clamped capacitances over all electrodes. Otherwise, each
    electrode k has its own clamped loss tangent ``t_k``. The imaginary part of the clamped
    capacitances is then ``T D T`` with ``T = diag(t_k^(1/2))``.
    """
    w, V = np.linalg.eigh(D)
    root = (V * np.sqrt(np.maximum(w, 0.0)))[:, w > 0]
    if len(set(tangents)) == 1:
        loss = compute_clamped_loss_tangent(tangents[0], float(motional.sum() / np.trace(D)))
        return [(loss, root)]
    ratios = motional / np.diag(D)
    losses = [*map(compute_clamped_loss_tangent, tangents, map(float, ratios))]
    half = np.linalg.pinv(root) @ (np.sqrt(losses)[:, None] * root)
    size, turn = np.linalg.eigh(half @ half.T)
    return [
        (float(one), column[:, None]) for one, column in zip(size, (root @ turn).T, strict=True)
    ]


def _use_modal_coordinates(model: LinearModel) -> LinearModel:
    """Return a symmetric model in mass-normalised modal coordinates; damping may couple modes.

    The rigid-body modes of the result have no stiffness.
    """
    K, E, M = model.pencil.make_dense().coefficients
    T, squares = normalise_modes(M, K)
    assert squares is not None
    ascending = np.argsort(squares)
    T, squares = T[:, ascending], squares[ascending]
    squares[: count_rigid_body_modes(squares)] = 0.0
    return replace(
        model,
        M=np.eye(len(M)),
        E=T.T @ E @ T,
        K=np.diag(squares),
        rayleigh=None,
        B=T.T @ model.B,
        C=model.C @ T,
        basis=None,
    )
