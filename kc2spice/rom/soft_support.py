"""Soft support for the rigid-body modes of models that need positive stiffness.

The rigid-body modes of a body without a support have no stiffness. With a soft support, each
rigid-body mode has a resonance frequency ``f_s`` far below the band. The soft support causes a
relative error of ``(f_s / f)^2`` in the response at the frequency f.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy

from kc2spice.rom.linear_model import LinearModel

# Resonance frequency on the soft support, relative to the lower end of the band.
# The soft support causes a relative error in the band of at most SOFT_SUPPORT_RATIO squared.
SOFT_SUPPORT_RATIO = 1e-4
# key of the mapping ``facts`` of a model: resonance frequency on the soft support
SOFT_SUPPORT = "soft_support_hz"
# largest squared frequency of a rigid-body mode, divided by the squared frequency of the next mode
ZERO_FREQUENCY_RATIO = 1e-6
MAX_COUPLING = 1e-8  # largest relative coupling of modes by damping that counts as a rounding error
# A rigid-body mode's gain at a port counts as zero up to this fraction of the port's largest gain.
RIGID_ROUNDING = 1e-6


def count_rigid_body_modes(squares: np.ndarray) -> int:
    """Count the rigid-body modes in ascending squared frequencies [rad^2/s^2]."""
    free = 0
    while free + 1 < squares.size and squares[free] < ZERO_FREQUENCY_RATIO * squares[free + 1]:
        free += 1
    return free


def support_softly(rom: LinearModel, band: tuple[float, float]) -> LinearModel:
    """Return a model in modal coordinates with a soft support of its rigid-body modes.

    The model is returned unchanged if it is unsymmetric, of first order, or has no rigid-body
    modes. The model is also returned unchanged if damping couples elastic modes, or if the band
    begins at 0 Hz.

    Parameters
    ----------
    rom : LinearModel
        Reduced model.
    band : (float, float)
        Band [Hz] of the model.

    Returns
    -------
    LinearModel
        Model in modal coordinates, with diagonal matrices M, E and K. All entries on the diagonal
        of K are positive.

    Examples
    --------
    Two masses are joined by a spring, and have no support.

    >>> import kc2spice as kc
    >>> from kc2spice.rom.soft_support import support_softly
    >>> spring = [[1.0, -1.0], [-1.0, 1.0]]
    >>> pair = kc.LinearModel(M=np.eye(2), K=spring, B=np.eye(2), rayleigh=(0.0, 0.01))
    >>> held = support_softly(pair, (0.1, 1.0))
    >>> print(np.sqrt(np.diag(held.K)) / (2 * np.pi))
    [1.00000000e-05 2.25079079e-01]
    """
    if rom.first_order or not rom.symmetric or band[0] <= 0:
        return rom
    K, E, M = rom.pencil.make_dense().coefficients
    try:
        w2, V = scipy.linalg.eigh(K, M)
    except np.linalg.LinAlgError:  # the mass matrix is singular
        return rom
    free = count_rigid_body_modes(w2)
    damping = V.T @ E @ V
    damp = np.maximum(np.diag(damping), 0.0)
    scale = np.sqrt(np.outer(damp, damp))[free:, free:] + np.finfo(float).tiny
    coupling = np.abs(damping - np.diag(damp))[free:, free:] / scale
    if not free or coupling.max(initial=0.0) > MAX_COUPLING:
        return rom
    soft, gain = SOFT_SUPPORT_RATIO * band[0], V.T @ rom.B
    w2[:free] = (2 * np.pi * soft) ** 2
    limit = RIGID_ROUNDING * np.abs(gain).max(axis=0)
    gain[:free] = np.where(np.abs(gain[:free]) > limit, gain[:free], 0.0)
    gain *= np.sign(gain[np.arange(len(gain)), np.abs(gain).argmax(axis=1)])[:, None]
    known = rom.certificate
    if known is not None:
        error = known.error_estimate + SOFT_SUPPORT_RATIO**2
        method = f"{known.method}; a soft support with a resonance of {soft:.4g} Hz"
        known = replace(known, error_estimate=error, method=method)
    return LinearModel(
        M=np.eye(w2.size),
        E=np.diag(damp),
        K=np.diag(w2),
        B=gain,
        D=rom.D,
        ports=rom.ports,
        certificate=known,
        facts={**rom.facts, SOFT_SUPPORT: soft},
        name=rom.name,
        band=rom.band,
    )
