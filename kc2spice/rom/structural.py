"""Damping that polynomials in s do not have, and inertia that does nothing.

Structural damping ``K (1 + j eta)`` loses the same share of its energy at every frequency. No
causal model does that in a band without a change of stiffness, so a circuit has a passive one near
it: each mode gets the viscous damping ``eta w_j``, which is exact at its resonance and differs by
less than ``eta`` of the mode's response elsewhere. That difference is part of the error estimate.

An RC ladder or an overdamped chain has real poles only. Where its inertia changes nothing in the
band, ``E x' + K x = B u`` has half of the states per unknown, and is passive as well.

Sources: S. H. Crandall, J. Sound Vib. 11 (1970) 3; D. J. Ewins, Modal Testing (2000), 2.4.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import scipy

from kc2spice.core.errors import SimulationError, UsageError
from kc2spice.rom.constraints import reduced_form
from kc2spice.rom.entries import Entries, share_of
from kc2spice.rom.linear import LinearModel, Norm
from kc2spice.rom.pencil import Pencil, Schur, largest
from kc2spice.rom.response import Response, adaptive_frequencies, grid
from kc2spice.rom.structure import semidefinite

Reductor = Callable[[LinearModel, float, tuple[float, float]], LinearModel]

SAFETY = 1.15  # on differences at samples, for what lies between them
BASE_SHARE = 0.5  # of the tolerance: for the model with viscous damping
LOWEST = 1e-10  # tolerances of a reduction
DIRECT = 6  # direct solutions of the full model that check a causal model
REAL = 1e-6  # imaginary part of a pole that is real, relative
MASSLESS = 1e-12  # of the largest eigenvalue: a damping matrix that is singular
MASS_SHARE = 0.5  # of the tolerance: what inertia that is left out may change


def causal(
    model: LinearModel,
    reduced: Reductor,
    tolerance: float,
    band: tuple[float, float],
    norm: Norm,
) -> LinearModel:
    """The passive model nearest to one with structural damping.

    Parameters
    ----------
    reduced : reduces a model with viscous damping within a tolerance over a band by a congruence.

    Raises
    ------
    UsageError : a model of first order, or without a definite mass matrix.
    """
    # nowhere in the band more damping than eta: errors beside sharper resonances are larger
    eta, beta = model.loss_factor, model.loss_factor / (2 * np.pi * band[1])
    share, within = share_of(norm), BASE_SHARE * tolerance
    small = reduced(_viscous(model, beta), within, band)
    result, lossy = _modal_damping(model, small, eta, beta)
    frequency, exact, more = _compared(small, result, lossy, band, norm)
    if more > 1:  # peaks of the damping that the base was reduced with are higher
        small = reduced(_viscous(model, beta), max(within / more, LOWEST), band)
        result, lossy = _modal_damping(model, small, eta, beta)
        frequency, exact, more = _compared(small, result, lossy, band, norm)
    entries = Entries.of(exact)
    ours = result.transfer(frequency)
    apart = float(entries.relative(ours - exact, exact, share).max())
    known = small.certificate
    assert known is not None
    sharp = np.sort(Response(result.pencil.dense()).within(band)[0])[:DIRECT]
    few = np.r_[band[0] + (band[1] - band[0]) * (np.arange(DIRECT) + 0.4) / DIRECT, sharp]
    full = model.transfer(few)
    checked = float(entries.relative(result.transfer(few) - full, full, share).max())
    estimate = max(max(more, 1.0) * known.error_estimate + SAFETY * apart, SAFETY * checked)
    method = (
        f"{known.method}; structural damping of {eta:g} by viscous damping of each mode, which "
    )
    method += f"differs by {apart:.1e}"
    if estimate > tolerance:
        warnings.warn(
            f"no causal model has a structural damping of {eta:g} at all frequencies: the passive "
            f"one differs by {apart:.2g}, more than the tolerance of {tolerance:g}",
            stacklevel=4,
        )
    return replace(
        result, certificate=replace(known, error_estimate=estimate, method=method), loss_factor=0.0
    )


def _modal_damping(
    model: LinearModel, small: LinearModel, eta: float, beta: float
) -> tuple[LinearModel, Pencil]:
    """The ``small`` model with viscous damping of each mode, and with structural damping."""
    K, E, M = small.pencil.dense().coefficients
    try:
        squares, T = scipy.linalg.eigh(0.5 * (K + K.T), 0.5 * (M + M.T))
    except np.linalg.LinAlgError:
        raise UsageError(
            "structural damping needs symmetric matrices and a definite mass",
            where=model.name,
            hint="fix unknowns without mass, or state viscous damping E",
        ) from None
    # E = M T diag(eta w_j) T'M, beside the viscous damping of the model itself
    given, modal = E - beta * K, M @ T
    E = given + (modal * (eta * np.sqrt(np.maximum(squares, 0.0)))) @ modal.T
    lossy = Pencil((K * (1 + 1j * eta), given, M), small.B, small.C, small.D)
    return replace(small, E=0.5 * (E + E.T)), lossy


def _compared(
    base: LinearModel, result: LinearModel, lossy: Pencil, band: tuple[float, float], norm: Norm
) -> tuple[np.ndarray, np.ndarray, float]:
    """Frequencies [Hz] at which errors show, there the response with structural damping, and how
    many times larger the peaks of the ``base`` are where errors count against peaks."""
    response = Response(result.pencil.dense())
    frequency = adaptive_frequencies(response, band, False, norm)
    frequency = frequency[frequency > 0]
    exact = lossy.transfer(2j * np.pi * frequency)
    if norm == "pointwise":
        return frequency, exact, 1.0
    entries = Entries.of(exact)
    sharper = np.r_[frequency, Response(base.pencil.dense()).within(band)[0]]
    own = np.abs(base.transfer(sharper)).max(axis=0)
    return frequency, exact, float((own / (entries.peak + np.finfo(float).tiny)).max())


def _viscous(model: LinearModel, beta: float) -> LinearModel:
    """With damping ``beta K`` beside its own instead of structural damping."""
    if model.first_order:
        raise UsageError("structural damping is of second-order models", where=model.name)
    if model.rayleigh is not None:
        alpha, own = model.rayleigh
        return replace(model, rayleigh=(alpha, own + beta), E=None, loss_factor=0.0)
    if not largest(model.E):
        return replace(model, rayleigh=(0.0, beta), E=None, loss_factor=0.0)
    if isinstance(model.K, Schur):
        problem = (
            "structural damping beside a damping matrix needs potentials that are not eliminated"
        )
        raise UsageError(problem, where=model.name, hint="rayleigh instead of E")
    return replace(model, E=model.E + beta * model.K, loss_factor=0.0)


def without_inertia(
    model: LinearModel,
    found: LinearModel,
    reduced: Reductor,
    tolerance: float,
    norm: Norm,
) -> LinearModel:
    """A passive model of first order, if ``found`` has real poles only and more states."""
    known = found.certificate
    if known is None or any(port.kind == "acceleration" for port in model.ports):
        return found
    poles = found.poles()
    if not poles.size or (np.abs(poles.imag) > REAL * np.abs(poles)).any():
        return found
    states = found.order * (1 if found.first_order else 2)
    pencil = reduced_form(model.pencil)
    if pencil.degree != 2 or not (pencil.symmetric and pencil.collocated):
        return found
    K, E, _ = pencil.coefficients
    if isinstance(K, Schur) or not semidefinite(E) or _singular(E):
        return found
    light = LinearModel(
        A=-K, E=E, B=pencil.B, C=pencil.C, D=pencil.D, ports=model.ports, name=model.name
    )
    frequency = grid(known.band_hz, DIRECT, False)
    try:
        exact, ours = model.transfer(frequency), light.transfer(frequency)
    except SimulationError:
        return found
    share = share_of(norm)
    mass = SAFETY * float(Entries.of(exact).relative(ours - exact, exact, share).max())
    if mass > MASS_SHARE * tolerance:
        return found
    small = reduced(light, tolerance - mass, known.band_hz)
    certificate = small.certificate
    if certificate is None or small.order >= states or not certificate.passive:
        return found
    method = f"{certificate.method}; without inertia, which changes the response by {mass:.1e}"
    error = certificate.error_estimate + mass
    return replace(
        small,
        certificate=replace(certificate, error_estimate=error, method=method),
        facts=model.facts,
    )


def _singular(E: np.ndarray) -> bool:
    """Whether a semidefinite matrix is not definite: an unknown without damping."""
    diagonal = E.diagonal()
    if diagonal.min(initial=np.inf) <= MASSLESS * diagonal.max(initial=0.0):
        return True
    matrix = E - MASSLESS * largest(E) * scipy.sparse.eye_array(E.shape[0], format="csc")
    return not semidefinite(np.asarray(matrix) if isinstance(E, np.ndarray) else matrix)
