"""Modes of a reduced model as an engineer reads them: frequency, Q, and how each port sees them."""

from __future__ import annotations

from typing import Any

import numpy as np

from kc2spice.core.errors import UsageError
from kc2spice.rom.linear import LinearModel
from kc2spice.rom.modal import resonators

MOST = 20  # modes in a table, the lowest
UNITS = {"mechanical": "m/N", "rotational": "rad/(N m)", "acceleration": "kg s2"}


def mode_table(model: LinearModel) -> dict[str, Any] | None:
    """Modes with all electrodes shorted and no load, up to the end of the certificate's band.

    ``modes``, each with ``frequency_hz``, ``quality`` (None without damping) and ``couplings`` by
    port, in ``units``. That of an electrical port is the effective factor ``k = sqrt(C_j / (C_j +
    C_above))``, where ``C_j = gain_j^2 / omega_j^2`` [F] is what the mode adds to the static
    capacitance and ``C_above`` what all higher ones and the clamped body have (``k^2 = 1 - (f_r /
    f_a)^2`` of a mode far from others); of any other port it is the same static share ``gain_j^2 /
    omega_j^2``.

    None for a model without such modes: one free to move, or with damping that couples them.
    """
    try:
        found = resonators(model)
    except UsageError:
        return None
    end = np.inf if found.certificate is None else found.certificate.band_hz[1]
    count = found.order - found.massless
    order = np.argsort(found.omega[:count])
    share = found.gain**2 / found.omega[:, None] ** 2
    electrical = np.array([port.kind == "electrical" for port in found.ports])
    rest = np.diag(found.D) + share[count:].sum(axis=0)
    above = rest + share[order].sum(axis=0) - np.cumsum(share[order], axis=0)
    modes = []
    for j, higher in zip(order[:MOST], above, strict=False):
        if found.omega[j] > 2 * np.pi * end:
            break
        whole = share[j] + np.maximum(higher, 0.0)
        factor = np.sqrt(np.divide(share[j], whole, out=np.zeros_like(whole), where=whole > 0))
        size = np.where(electrical, factor, share[j])
        modes.append(
            {
                "frequency_hz": float(found.omega[j] / (2 * np.pi)),
                "quality": float(found.omega[j] / found.damp[j]) if found.damp[j] > 0 else None,
                "couplings": {p.name: float(v) for p, v in zip(found.ports, size, strict=True)},
            }
        )
    units = {port.name: UNITS.get(port.kind, "") for port in found.ports}
    return {"units": units, "modes": modes} if modes else None
