"""Residual modes without inertia: what a contact presses on answers at once, but damped.

A reduced model keeps the compliance of its ports exact by some stiff modes far above its band. They
are none of the body's, yet behind the spring of a contact their inertia is a lump of mass that
rattles. Component mode synthesis with a massless boundary leaves it out and keeps their compliance
and damping (Monjaraz Tec, Gross and Krack 2021, arXiv 2111.07693)::

    damp z' + omega^2 z = g u        instead of        z'' + damp z' + omega^2 z = g u
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kc2spice.core.errors import UsageError
from kc2spice.rom.modal import Resonators
from kc2spice.rom.response import Judge, Response, above_band, telling

SHARE = 1e-3  # of a port's static compliance: what its answer at the band's end may change by
# The same where the lowest mode that is left out would ring: its damping ratio is below RINGS. Such
# modes are the mesh's, ring on for hundreds of periods, and are what the steps of a lightly damped
# kick follow. Launches of a chip damped by 0.01 % move by 1.2e-3, a quarter of their distance to
# the full model on finer rings and towards it; the time points become a third.
RINGING_SHARE, RINGS = 1e-2, 0.02
FAR = 2.0  # times the band's end: no lower mode answers at once
EQUAL = 1e-9  # relative difference of relaxation times that is none
RANK = 1e-12  # of singular values: no port moves such a combination of modes


def without_inertia(model: Resonators, tolerance: float | None = None) -> Resonators:
    """``model`` with its highest modes as states without inertia and its certificate widened.

    The cut: from the highest mode down, as long as the inertia left out changes the answer of every
    mechanical port at the end f of the certificate's band by less than ``SHARE`` of its static
    compliance, ``sum_j (g_j / w_j)^2 (f / f_j)^2`` (``RINGING_SHARE`` where the lowest of these
    modes would ring), and the certified error stays within ``tolerance``. Statics stay exact, the
    form stays passive. Modes that relax at one pace, as all do under damping proportional to
    stiffness, become as many states as ports move independently. An acceleration port does not see
    these states.
    """
    certificate = model.certificate
    if certificate is None:
        return model
    band = certificate.band_hz
    exact = Response(model.linear().pencil)
    judge = Judge(exact, telling(exact, band, True), band)
    for count in range(_beyond(model, band[1]), 0, -1):
        found = _relaxing(model, count)
        error = certificate.error_estimate
        light = Response(found.linear().pencil)
        error += judge.error(light)
        if tolerance is None or error <= tolerance:
            cut = found.omega[found.order - found.massless] / (2 * np.pi)
            method = f"{certificate.method}; no inertia from {cut:.3g} Hz on, measured"
            more = dict(above_band(model.ports, exact, light, band))
            above = tuple((f, before + more.get(f, 0.0)) for f, before in certificate.above)
            return replace(
                found,
                certificate=replace(certificate, error_estimate=error, method=method, above=above),
            )
    return model


def _beyond(model: Resonators, top: float) -> int:
    """Number of the highest modes whose inertia decides nothing up to ``top`` [Hz]."""
    moved = [port.kind in ("mechanical", "rotational") for port in model.ports]
    down = np.argsort(model.omega)[::-1]
    omega, ratio = model.omega[down], 2 * np.pi * top / model.omega[down]
    share = (model.gain[down][:, moved] / omega[:, None]) ** 2
    share /= share.sum(axis=0) + np.finfo(float).tiny
    missing = np.cumsum(share * ratio[:, None] ** 2, axis=0).max(axis=1)
    limit = np.where(model.damp[down] < 2 * RINGS * omega, RINGING_SHARE, SHARE)
    beyond = np.flatnonzero((missing <= limit) & (FAR * ratio <= 1))
    return int(beyond[-1]) + 1 if beyond.size else 0


def _relaxing(model: Resonators, count: int) -> Resonators:
    """``model`` without the inertia of its ``count`` highest modes."""
    for port, own in zip(model.ports, np.diag(model.D), strict=True):
        if port.kind == "electrical" and own <= 0:
            raise UsageError(
                "an electrode without capacitance of its own on a body with a massless contact",
                where=port.name,
                hint='set contact.inertia = "lumped"',
            )
    order = np.argsort(model.omega)
    low, high = order[:-count], order[-count:]
    omega, damp, gain = model.omega[high], model.damp[high], model.gain[high].copy()
    gain[:, [port.kind == "acceleration" for port in model.ports]] = 0.0
    pace = damp / omega**2
    if np.ptp(pace) <= EQUAL * pace.max():
        _, size, shapes = np.linalg.svd(gain / omega[:, None], full_matrices=False)
        kept = size > RANK * size[0]
        omega = np.full(int(kept.sum()), omega[0])
        damp, gain = pace[0] * omega**2, omega[:, None] * size[kept, None] * shapes[kept]
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
