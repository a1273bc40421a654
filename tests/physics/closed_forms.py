"""Closed forms that several tests hold models against; they share nothing with the product."""

import numpy as np
from scipy.optimize import brentq
from scipy.special import ellipe, ellipk, j0

MU_0 = 4e-7 * np.pi


def circles(a, b, apart):
    """Maxwell's mutual inductance [H] of two coaxial circles."""
    m = 4 * a * b / ((a + b) ** 2 + apart**2)
    return MU_0 * np.sqrt(a * b) * ((2 - m) * ellipk(m) - 2 * ellipe(m)) / np.sqrt(m)


def rod_resonance(sections, top, *, held=False):
    """First longitudinal resonance [Hz] below ``top`` of sections (area, modulus, density, length)
    in a line, free at both ends or ``held`` at the first one."""

    def end_force(frequency):
        w, state = 2 * np.pi * frequency, np.array([0.0, 1.0] if held else [1.0, 0.0])
        for area, modulus, density, length in sections:  # of displacement and force
            k = w * np.sqrt(density / modulus)
            c, s, z = np.cos(k * length), np.sin(k * length), area * modulus * k
            state = np.array([[c, s / z], [-z * s, c]]) @ state
        return state[1]

    f = np.linspace(1e3, top, 500)
    at = np.flatnonzero(np.diff(np.sign([end_force(x) for x in f])))[0]
    return brentq(end_force, f[at], f[at + 1])


def half_space(modulus, nodes):
    """(n, n) mean motion [m/N] of each P1 pressure per force on each: ``4 pi / E* int P P' dk``
    of their radial transforms ``P(k) = int p J0(k r) r dr`` (Johnson, Contact Mechanics, 1985)."""
    x, w = np.polynomial.legendre.leggauss(24)
    k = np.linspace(0, 25 / nodes[1], 12001)
    k = (k[:-1] + k[1:]) / 2
    P = []
    for j in range(len(nodes) - 1):
        total, force = np.zeros(k.size), 0.0
        for a, b in zip(nodes[max(0, j - 1) : j + 1], nodes[max(1, j) : j + 2], strict=True):
            r = (a + b) / 2 + (b - a) / 2 * x
            p = np.interp(r, nodes, np.eye(len(nodes))[j]) * r * w * (b - a) / 2
            total += j0(k[:, None] * r) @ p
            force += 2 * np.pi * p.sum()
        P.append(total / force)
    return 4 * np.pi / modulus * (k[1] - k[0]) * np.array(P) @ np.array(P).T


def hertz(modulus, radius, depth):
    """Force [N] of a sphere that is pressed ``depth`` deep into a half-space."""
    return 4 / 3 * modulus * np.sqrt(radius) * depth**1.5
