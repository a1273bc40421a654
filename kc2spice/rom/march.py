"""Exact answers of modes to recorded loads, and the energy that they hold."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from kc2spice.rom.modal import Resonators

_BLOCK = 4096  # steps whose propagators are in memory at a time


@dataclass(frozen=True)
class ChipResponse:
    """Over the points of time: ``output`` (n, ports) in m and C, ``stored`` (n,) energy [J]."""

    output: np.ndarray
    stored: np.ndarray


def chip_response(model: Resonators, t: np.ndarray, load: np.ndarray) -> ChipResponse:
    """Response to ``load`` (n, ports; N into the chip and V), linear between the times ``t`` (n,).

    Each mode ``z'' + d z' + w^2 z = r`` is split by its roots a, b into two states

        x' = a x + r,    x(t + h) = e^(ah) x + h p1(ah) r + h p2(ah) (r(t + h) - r)

    with ``p1 = (e^s - 1)/s`` and ``p2 = (e^s - 1 - s)/s^2``; then ``z = (x_a - x_b)/(a - b)``.
    Exact for such loads whatever the step. A state without inertia is one such state by itself.
    The chip starts in equilibrium with ``load[0]``.
    """
    drive, heavy = load @ model.gain.T, model.order - model.massless
    z = np.empty_like(drive)
    z[:, :heavy], rate = resonant(model.omega[:heavy], model.damp[:heavy], t, drive[:, :heavy])
    z[:, heavy:] = _relaxing(model.omega[heavy:], model.damp[heavy:], t, drive[:, heavy:])
    stored = (rate**2).sum(axis=1) / 2 + ((model.omega * z) ** 2).sum(axis=1) / 2
    stored += np.einsum("nk,kl,nl->n", load, model.D, load) / 2
    return ChipResponse(z @ model.gain + load @ model.D, stored)


def resonant(
    omega: np.ndarray, damp: np.ndarray, t: np.ndarray, drive: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Displacements and rates (n, modes) of ``z'' + damp z' + omega^2 z = drive``, which starts in
    equilibrium and is linear between the times."""
    a, b = _roots(omega, damp)
    if (b == a.conj()).all():  # then x_b is the conjugate of x_a
        x_a = _march(a, t, drive)
        x_b = x_a.conj()
    else:
        both = _march(np.concatenate([a, b]), t, np.tile(drive, 2))
        x_a, x_b = both[:, : a.size], both[:, a.size :]
    return ((x_a - x_b) / (a - b)).real, ((a * x_a - b * x_b) / (a - b)).real


def _relaxing(omega: np.ndarray, damp: np.ndarray, t: np.ndarray, drive: np.ndarray) -> np.ndarray:
    """Displacements (n, modes) of ``d z' + w^2 z = r``; undamped ones follow at once."""
    z = drive / omega**2
    slow = damp > 0
    z[:, slow] = _march(-(omega[slow] ** 2) / damp[slow], t, drive[:, slow] / damp[slow]).real
    return z


def _march(roots: np.ndarray, t: np.ndarray, drive: np.ndarray) -> np.ndarray:
    """(n, roots) of ``x' = a x + r`` from equilibrium.

    Rows of steps are followed side by side from zero, then each from where the one before ends.
    """
    states = np.empty((t.size, roots.size), dtype=np.result_type(roots, drive))
    states[0] = state = drive[0] / -roots
    for begin in range(0, t.size - 1, _BLOCK):
        part = slice(begin, min(begin + _BLOCK, t.size - 1) + 1)
        count = part.stop - part.start - 1
        side = math.isqrt(count - 1) + 1
        shape = (side, side, roots.size)
        grow, push = (np.resize(each, shape) for each in _steps(roots, t[part], drive[part]))
        for k in range(1, side):
            push[:, k] += grow[:, k] * push[:, k - 1]
            grow[:, k] *= grow[:, k - 1]
        for row in range(side):
            push[row] += grow[row] * state
            state = push[row, -1]
        states[part][1:] = push.reshape(side**2, roots.size)[:count]
        state = states[part.stop - 1]
    return states


def _roots(omega: np.ndarray, damp: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Roots of ``s^2 + damp s + omega^2``; equal ones are moved apart by 1e-4 of omega."""
    half = np.sqrt(damp.astype(complex) ** 2 / 4 - omega**2)
    half = np.where(np.abs(half) < 1e-4 * omega, 1e-4 * omega, half)
    fast = -damp / 2 - half
    # their sum would lose the slow one of a mode damped hard
    return np.where(fast.imag == 0, omega**2 / fast, fast.conj()), fast


def _steps(roots: np.ndarray, t: np.ndarray, drive: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """``e^(ah)`` and what the load adds in each step, both (steps, roots)."""
    h = np.diff(t)[:, None]
    s = h * roots
    small = np.abs(s) < 1e-2
    safe = np.where(small, 1.0, s)
    grow = np.exp(s)
    p1 = np.where(small, 1 + s / 2 * (1 + s / 3 * (1 + s / 4)), (grow - 1) / safe)
    p2 = np.where(small, (1 + s / 3 * (1 + s / 4 * (1 + s / 5))) / 2, (p1 - 1) / safe)
    return grow, h * (p1 * drive[:-1] + p2 * np.diff(drive, axis=0))
