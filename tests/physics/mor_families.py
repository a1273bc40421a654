"""Benchmark models rebuilt from their published formulas, and their response by plain numpy."""

import numpy as np
import oracle
from scipy import sparse
from support import Deck, run_deck

from bench.beam import hermite_beam


def beam(elements=40):
    """Clamped Euler-Bernoulli beam of Hermite elements (E I = rho A = length = 1), tip force to
    tip; slopes are scaled to be well conditioned."""
    M, K = (P[2:, 2:] for P in hermite_beam(elements, scaled=True))
    B = np.zeros((len(K), 1))
    B[-2] = 1.0
    return {"M": M, "E": 0.2 * M + 1e-5 * K, "K": K, "B": B}, 60.0


def triple_chain(length=100):
    """Three chains of oscillators that meet in one mass, each held by a dashpot at its end.

    Truhar and Veselic, SIAM J. Matrix Anal. Appl. 31 (2009) 18; damping is not proportional.
    """
    n = 3 * length + 1
    K = np.zeros((n, n))
    stiffness = (10.0, 20.0, 1.0)
    for chain, k in enumerate(stiffness):
        rows = np.arange(length) + chain * length
        K[rows, rows] = 2 * k
        K[rows[:-1], rows[1:]] = K[rows[1:], rows[:-1]] = -k
        K[rows[-1], -1] = K[-1, rows[-1]] = -k
    K[-1, -1] = 50.0 + sum(stiffness)
    M = np.diag(np.r_[np.repeat([1.0, 2.0, 3.0], length), 10.0])
    E = 2e-3 * M + 2e-3 * K
    for chain in range(3):
        E[chain * length, chain * length] += 5.0
    B = np.zeros((n, 2))
    B[length // 2, 0] = B[-1, 1] = 1.0
    return {"M": M, "E": E, "K": K, "B": B}, 0.08


def chain(n=40, k=1.0):
    """Masses between springs, pushed at one end and in the middle."""
    K = k * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    return {"M": np.eye(n), "E": 0.02 * K, "K": K, "B": np.eye(n)[:, [0, n // 2]]}


def damped_chain(n, dashpot=0.0, heaviest=1.0):
    """Masses of 1 to ``heaviest``, driven inside and at an end; a ``dashpot`` couples the modes."""
    K = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    E = 1e-2 * K
    E[0, 0] += dashpot
    M, B = np.diag(np.linspace(1, heaviest, n)), np.eye(n)[:, [n // 5, n - 1]]
    return {"M": M, "E": E, "K": K, "B": B}


def building(storeys=60):
    """Shear building: ground acceleration in, drift of the roof and of the sixth floor out.

    Chopra, Dynamics of Structures, ch. 9; storeys soften upwards, a damper sits in every fourth.
    """
    k = np.linspace(3e8, 1e8, storeys)
    K = np.diag(k + np.r_[k[1:], 0.0]) - np.diag(k[1:], 1) - np.diag(k[1:], -1)
    M = np.diag(np.full(storeys, 2e5))
    D = np.zeros((storeys, storeys))
    for i in range(3, storeys, 4):
        D[i - 1 : i + 1, i - 1 : i + 1] += 2e6 * np.array([[1, -1], [-1, 1]])
    B = -M @ np.ones((storeys, 1))
    return {"M": M, "E": 1e-3 * K + D, "K": K, "B": B, "C": np.eye(storeys)[[-1, 5]]}, 2.0


def heat_rod(n=250):
    """Heat conduction along a rod of unit length, ends held at zero: heat in at a third,
    temperature out at two thirds and at the middle. First order; Chahlaoui and Van Dooren,
    SLICOT 2002-2.
    """
    h = 1 / (n + 1)
    A = (np.diag(np.full(n - 1, 1.0), 1) + np.diag(np.full(n - 1, 1.0), -1) - 2 * np.eye(n)) / h**2
    B = np.zeros((n, 1))
    B[n // 3] = 1 / h
    return {"A": A, "B": B, "C": np.eye(n)[[2 * n // 3, n // 2]]}, 30.0


def rotor(n=40):
    """Shaft in two planes coupled by gyroscopic moments of its spin: E is skew but for bearings."""
    parts, _ = beam(n // 2)
    K, M = parts["K"], parts["M"]
    zero = np.zeros_like(K)
    G = 0.3 * np.diag(np.tile([0.0, 1.0], len(K) // 2)) / n
    E = np.block([[1e-3 * K, G], [-G, 1e-3 * K]])
    twice = np.block([[M, zero], [zero, M]]), np.block([[K, zero], [zero, K]])
    B = np.zeros((2 * len(K), 2))
    B[len(K) - 2, 0] = B[-2, 1] = 1.0
    return {"M": twice[0], "E": E, "K": twice[1], "B": B}, 20.0


def as_files(matrices):
    """Square matrices sparse, as they come from files."""
    return {k: sparse.csc_array(v) if k in "MEKA" else v for k, v in matrices.items()}


def full_response(matrices, frequency):
    """``H(j 2 pi f)`` straight from the definition, (frequencies, outputs, inputs)."""
    return oracle.direct(oracle.system(matrices), frequency, refined=False)


def spice_response(part, inputs, outputs, frequency, directory):
    """The same from ngspice: one ``.ac`` run per input on the library file as it is written."""
    first, last, count = frequency[0], frequency[-1], len(frequency)
    pins = [pin.name for pin in part.pins]
    columns = []
    for j in range(inputs):
        cards = [f"Vin{i} {pins[i]} 0 dc 0 ac {int(i == j)}" for i in range(inputs)]
        probes = " ".join(f"v({pin})" for pin in pins[inputs : inputs + outputs])
        text = "\n".join([
            "response", f".include {part.filename}", *cards,
            f"X1 {' '.join(pins[:-1])} 0 {part.name}",
            f".ac lin {count} {float(first)!r} {float(last)!r}", f".save {probes}", ".end", "",
        ])  # fmt: skip
        vectors = {pin: (f"v({pin.lower()})", 1.0) for pin in pins[inputs : inputs + outputs]}
        deck = Deck(name="ac", text=text, more={part.filename: part.text}, vectors=vectors)
        waves = run_deck(deck, directory)
        columns.append(np.stack([waves.data[pin] for pin in vectors], axis=1))
    return np.stack(columns, axis=2)
