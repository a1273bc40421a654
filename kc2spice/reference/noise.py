"""Thermal noise of a linear circuit about its operating point, by fluctuation and dissipation.

A linear law with the admittance ``Y`` (through by rate of across) has through quantities of the
spectral density ``4 k T (Y + Y^H) / 2`` (H. B. Callen, T. A. Welton, Phys. Rev. 83 (1951) 34; one
sided, per Hz). A body is taken by the answers at its ports, whatever its states are: not by the
force noise of each mode, as its netlist is.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import partial
from types import SimpleNamespace

import numpy as np

from kc2spice.core import laws as L
from kc2spice.core.units import BOLTZMANN, TEMPERATURE
from kc2spice.reference.assemble import System, assemble
from kc2spice.reference.linear import Linear


def _answers(law: L.LinearBody, s: np.ndarray) -> np.ndarray:
    """``H(s)`` (frequencies, outputs, inputs) of a body's matrices."""
    M, E, K = (np.diag(P) if P.ndim == 1 else P for P in (law.M, law.E, law.K))
    return np.array([law.C @ np.linalg.solve(w * w * M + w * E + K, law.B) + law.D for w in s])


def _answering(law: L.Law) -> L.Law:
    if not isinstance(law, L.LinearBody):
        return law
    pencil = SimpleNamespace(transfer=partial(_answers, law))
    return L.PortBody(law.name, SimpleNamespace(pencil=pencil), law.ports)


def noise(
    laws: Iterable[L.Law], joins: Mapping[str, Iterable[str]], of: L.Reading, f: np.ndarray
) -> np.ndarray:
    """Spectral density (nf,) of a reading, in its unit per root Hz, at the frequencies ``f`` [Hz].

    ``joins`` are those of :func:`kc2spice.reference.assemble.assemble`.
    """
    system = assemble(map(_answering, laws), joins)
    rest = Linear(system)
    point = rest.z0, rest.held
    power = [_power(system, Linear(system, s, point), of, s) for s in 2j * np.pi * f]
    return np.sqrt(4 * BOLTZMANN * TEMPERATURE * np.array(power))


def _power(system: System, at: Linear, of: L.Reading, s: complex) -> float:
    """Sum of what all sources of a unit density add, by the adjoint of the circuit."""
    n, k = system.size, len(system.sources)
    names = list(at.names)
    C0 = sum(factor * at.C0[names.index(wave)] for factor, wave in of.terms)
    C1 = sum(factor * at.C1[names.index(wave)] for factor, wave in of.terms)
    P = (s * at.G - at.F)[:, :n]
    level = np.abs(P).max(axis=1)
    adjoint = np.linalg.solve((P / level[:, None]).T, (C0 + s * C1)[:n]) / level
    power = 0.0
    held = (*at.held, *(() for _ in system.linear))
    for device, mode in zip((*system.devices, *system.linear), held, strict=True):
        e = device.inputs @ np.concatenate([at.z0, np.zeros(2 * k)])
        found = device.law.noise(s, e, mode)
        if found is None:
            continue
        out, kept = found
        drive = device.into @ out
        if device.stores is not None:
            drive = drive - s * device.stores @ kept
        power += float((np.abs(adjoint @ drive) ** 2).sum())
    return power
