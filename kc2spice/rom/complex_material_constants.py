"""Passive models of piezoelectric bodies with complex material constants.

Source: IEEE Std 176-1987.

Complex compliances ``s^E (1 - j / Q)`` and permittivities ``eps^T (1 - j tan delta)`` state the
losses of a ceramic. The piezoelectric constants d are real. The Q factor of the compliances does
not depend on frequency, so it is also the Q factor of all modes. A mode with the angular frequency
``omega_j`` has the gain g_j for voltages and forces. The clamped capacitance is D. Only elastic
strain causes mechanical losses. The elastic strain w_j of a mode is the displacement z_j minus the
displacement of the free body at the voltage V:

    w_j = z_j - g_j V / omega_j^2,
    z_j'' + chi(s) omega_j^2 w_j = f_j,        q = psi(s) C_T V + sum_j chi(s) g_j w_j,
    C_T = D + sum_j g_j^2 / omega_j^2,         chi = 1 + j / Q,        psi = 1 - j tan delta,

The factor chi approximates ``1 / (1 - j / Q)`` with an error of ``1 / Q^2``. At frequencies far
below its resonances, a body without supports has the loss tangent of the data sheet and no
mechanical loss. The clamped body has the complex capacitance ``D - j (C_T tan delta + (C_T - D) /
Q)``. No causal model has a loss factor that is constant over all frequencies. The complex factors
chi of the stiffness and psi of the capacitance must be powers of the frequency. See
:mod:`kc2spice.rom.structural_damping` for chi, and :mod:`kc2spice.rom.modal_models` for psi.
Therefore, chi is ``1 + j / Q`` only at the frequency of the stated damping, and psi is ``1 - j tan
delta`` only at 1 kHz. Sums of relaxations approximate chi and psi. All amplitudes of the
relaxations are positive, so each relaxation is passive. The model is passive if the instantaneous
capacitance is positive.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from kc2spice.core.error_norms import PEAK_SHARE
from kc2spice.core.errors import UsageError
from kc2spice.rom.linear_model import LinearModel
from kc2spice.rom.modal_models import Resonators, compute_permittivity_ratio, fit_foster_network
from kc2spice.rom.structural_damping import (
    add_structural_damping,
    compute_causal_stiffness_factor,
    fit_relaxing_stiffness,
)

# permitted relative error of the response at resonances due to approximation by relaxations
MAX_RELAXATION_ERROR = 1e-3
# permitted relative error of the permittivity, as a multiple of min(loss tangent, 0.02)
DIELECTRIC_SHARE = 0.01
# errors of the stiffness are amplified if (frequency / lowest resonance) exceeds this ratio
SENSITIVITY_LIMIT = 0.7
GRID_FREQUENCIES = 400  # number of frequencies in the band at which the error is measured
# number of refinements at antiresonances, and number of frequencies around each antiresonance
REFINEMENT_ROUNDS = 2
REFINED_FREQUENCIES = 9
RESONANCE_OFFSETS = (-2.0, -0.5, 0.0, 0.5, 2.0)  # distances from a resonance in half-widths


@dataclass(frozen=True)
class ComplexConstants:
    """Complex material constants of a body, as a loss factor and a loss tangent.

    Attributes
    ----------
    loss_factor : float
        Loss factor ``1 / Q`` of the compliances.
    tangent : float
        Loss tangent, tan delta, of the free body at 1 kHz.
    at : float
        Frequency [Hz] at which the stiffness equals the stated stiffness of the material.
    """

    loss_factor: float
    tangent: float
    at: float

    def transfer(
        self, omega: np.ndarray, gain: np.ndarray, D: np.ndarray, electrical: np.ndarray,
        frequency: np.ndarray,
    ) -> np.ndarray:  # fmt: skip
        """Compute the transfer matrix of a body with losses from its undamped modes.

        The response is an array of shape (n, ports, ports).

        Parameters
        ----------
        omega : (modes,) array
            Angular frequencies [rad/s] of undamped modes; zero for rigid-body modes.
        gain : (modes, ports) array
            Gains of undamped modes at the ports, for mass-normalised mode shapes.
        D : (ports, ports) array
            Clamped capacitances [F], or zero for ports that are not electrical.
        electrical : (ports,) array of bool
            Whether the input of each port is a voltage.
        frequency : (n,) array
            Frequencies [Hz].
        """
        s = 2j * np.pi * np.asarray(frequency)
        chi = compute_causal_stiffness_factor(frequency, self.loss_factor, self.at)
        psi = compute_permittivity_ratio(frequency, self.tangent)
        free = np.where(electrical, gain, 0.0)
        elastic = omega > 0
        shares = free[elastic] / omega[elastic, None]
        motional = shares.T @ shares
        forces = np.where(electrical, chi[:, None], 1.0)  # force per unit input, divided by gain
        answer = 1 / (s[:, None] ** 2 + chi[:, None] * omega**2)
        H = np.einsum("ni,ji,nj,jk,nk->nik", forces, gain, answer, gain, forces, optimize=True)
        return np.asarray(
            H + D
            + (psi[:, None, None] - 1) * (_zero_nonelectrical_entries(D, electrical) + motional)
            - (chi[:, None, None] - 1) * motional
        )  # fmt: skip


def _zero_nonelectrical_entries(D: np.ndarray, electrical: np.ndarray) -> np.ndarray:
    """Set the entries of nonelectrical ports in the capacitance matrix D to zero."""
    return np.where(np.outer(electrical, electrical), D, 0.0)


def make_complex_constants_model(model: Resonators, losses: ComplexConstants) -> LinearModel:
    """Return a passive model of the modes of a body with complex material constants.

    Parameters
    ----------
    model : Resonators
        Modal model without massless modes, with a certificate. The loss factors replace the damping
        of the modes, and are constant in the band of the certificate.
    losses : ComplexConstants
        Loss factor and loss tangent.

    Returns
    -------
    LinearModel
        Symmetric model. Internal displacements of the relaxations are additional unknowns of this
        model. The error estimate in the certificate includes the error of the relaxations at
        resonances and between resonances.

    Raises
    ------
    UsageError : a mode has no inertia, or the loss is so large that the instantaneous capacitance
        is not positive.
    """
    from scipy.linalg import block_diag  # imported here, so that the command line starts faster

    known, n = model.certificate, model.order
    assert known is not None
    if model.massless:
        raise UsageError(
            'damping.model = "ieee176" cannot be combined with contact.inertia = "massless"',
            where="damping.model",
            got='"ieee176"',
            expected='"rayleigh", or contact.inertia = "lumped"',
            hint='write model = "rayleigh" in the damping of this body',
        )
    electrical = np.array([port.electrical for port in model.ports])
    ports = np.flatnonzero(electrical)
    shares = model.gain[:, ports] / model.omega[:, None]
    motional, clamped = shares.T @ shares, model.D[np.ix_(ports, ports)]

    def estimate_stiffness_sensitivity(f: np.ndarray) -> np.ndarray:
        """Return the ratio of response error to stiffness error at each frequency.

        The ratio is 1 below the lowest resonance, and Q above.
        """
        lowest = SENSITIVITY_LIMIT * model.omega.min() / (2 * np.pi)
        return np.where(f > lowest, max(1.0, 1 / max(losses.loss_factor, 1e-12)), 1.0)

    chi = fit_relaxing_stiffness(
        losses.loss_factor,
        losses.at,
        known.band_hz,
        MAX_RELAXATION_ERROR,
        sensitivity=estimate_stiffness_sensitivity,
    )
    amplitude, rates = np.ones(1), np.empty(0)
    if ports.size and losses.tangent:
        share = DIELECTRIC_SHARE * min(losses.tangent, 0.02)
        amplitude, rates, _ = fit_foster_network(losses.tangent, known.band_hz, share)
    D = model.D.copy()
    sudden = amplitude[0] * (clamped + motional) - chi.instantaneous_factor * motional
    if ports.size and np.linalg.eigvalsh(sudden)[0] < 0:
        raise UsageError(
            "the losses are too large for the piezoelectric coupling of the body",
            where="damping",
            got=f"1 / Q of {losses.loss_factor:g}, loss tangent of {losses.tangent:g}",
            expected="losses for which the high-frequency capacitance is positive",
            hint='reduce the losses, or set model = "rayleigh"',
        )
    D[np.ix_(ports, ports)] = sudden
    lossless = replace(model, damp=np.zeros(n), certificate=None).to_linear_model()
    elastic = add_structural_damping(lossless, chi)
    B = elastic.B.copy()
    # A voltage imposes a strain on the instantaneous spring and on the spring of each relaxation.
    factors = np.r_[chi.instantaneous_factor, -np.sqrt(chi.amplitudes)]
    B[:, ports] = np.kron(factors[:, None], model.gain[:, ports])
    used = amplitude[1:] > 0
    w, V = np.linalg.eigh(clamped + motional)
    root = (V * np.sqrt(np.maximum(w, 0.0))).T
    pace = np.repeat(rates[used], len(ports))
    dielectric = np.zeros((pace.size, len(model.ports)))
    if pace.size:
        columns = np.vstack([np.sqrt(a) * root for a in amplitude[1:][used]])
        dielectric[:, ports] = pace[:, None] * columns
    K, E, M = elastic.pencil.make_dense().coefficients
    result = LinearModel(
        M=block_diag(M, np.diag(np.zeros(pace.size))),
        E=block_diag(E, np.diag(pace)),
        K=block_diag(K, np.diag(pace**2)),
        B=np.vstack([B, dielectric]),
        D=D,
        ports=model.ports,
    )
    error = _compute_largest_error(result, model, losses, electrical, known.band_hz)
    method = (
        f"{known.method}; complex constants: loss factor 1/Q = {losses.loss_factor:g} approximated "
        f"by {len(chi.rates)} relaxation terms, loss tangent {losses.tangent:g} by {used.sum()} "
        f"relaxation terms; relative error of the response {error:.1e}"
    )
    certificate = replace(known, error_estimate=known.error_estimate + error, method=method)
    return replace(result, certificate=certificate)


def _compute_largest_error(
    model: LinearModel,
    modes: Resonators,
    losses: ComplexConstants,
    electrical: np.ndarray,
    band: tuple[float, float],
) -> float:
    """Return the largest relative error of the model's response in the band.

    The error of an entry is divided by the magnitude of the entry, but at least by
    :data:`PEAK_SHARE` times the entry's peak.
    """
    low, high = max(band[0], 1e-4 * band[1]), band[1]
    resonances = modes.omega / (2 * np.pi)
    near = resonances[:, None] * (1 + 0.5 * losses.loss_factor * np.array(RESONANCE_OFFSETS))
    f = np.union1d(np.geomspace(low, high, GRID_FREQUENCIES), near[(near >= low) & (near <= high)])

    def compute_exact_response(f: np.ndarray) -> np.ndarray:
        """Return the exact response of the modes at the frequencies ``f`` [Hz]."""
        return losses.transfer(modes.omega, modes.gain, modes.D, electrical, f)

    for _ in range(REFINEMENT_ROUNDS):
        f = np.union1d(f, _sample_minima(f, np.abs(compute_exact_response(f))))
    exact = compute_exact_response(f)
    size = np.maximum(np.abs(exact), PEAK_SHARE * np.abs(exact).max(axis=0))
    off = np.abs(model.transfer(f) - exact)
    return float(np.divide(off, size, out=np.zeros_like(off), where=size > 0).max())


def _sample_minima(f: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Return frequencies around the local minima of every entry of a response.

    ``size`` (n, ports, ports) contains the magnitudes of the response.

    The minima are antiresonances, at which relative errors are largest.
    """
    curves = size.reshape(len(f), -1)
    inner = (curves[1:-1] <= curves[:-2]) & (curves[1:-1] <= curves[2:])
    lowest = np.flatnonzero(inner.any(axis=1)) + 1
    return np.linspace(f[lowest - 1], f[lowest + 1], REFINED_FREQUENCIES).ravel()
