"""The same reduced chip as other tools would write it: dense.

One writer for any state-space form, in the manner of generic exporters (a capacitor for every
state, a controlled source for every entry of A, B and C), with the pins of the product's own part.
"""

from dataclasses import dataclass, replace

import numpy as np

from kc2spice.netlist.cards import number
from kc2spice.rom.linear import Certificate, Port
from kc2spice.rom.modal import Resonators

STATE = 1e-6  # farad of every state
FORMS = ("resonators", "second order", "first order")


@dataclass(frozen=True)
class StateSpace:
    """``x' = A x + B u``, ``y = C x``: x in um, u in N and V, y in um and uC; ``clamped`` in F."""

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    clamped: float


def state_space(model, form):
    """``model`` as decoupled resonators, or turned into other coordinates by a fixed rotation.

    *second order* keeps displacements and velocities apart, with dense stiffness and damping;
    *first order* mixes all states, which is what a rational fit or a general reduction gives.
    """
    order = np.argsort(model.omega)
    omega, damp, gain = model.omega[order], model.damp[order], model.gain[order]
    mechanical = [port.kind == "mechanical" for port in model.ports]
    scale = np.abs(gain[:, mechanical]).max(axis=1)
    q, zero = omega.size, np.zeros((omega.size, omega.size))
    drive, shape = 1e6 * scale[:, None] * gain, (gain / scale[:, None]).T
    if form == "second order":
        T, W = rotation(q), np.exp(np.log(omega).mean())
        stiffness, damping = (T * omega**2) @ T.T / W, (T * damp) @ T.T
        A = np.block([[zero, W * np.eye(q)], [-stiffness, -damping]])
        drive, shape = T @ drive / W, shape @ T.T
    else:
        A = np.block([[zero, np.diag(omega)], [-np.diag(omega), -np.diag(damp)]])
        drive = drive / omega[:, None]
    B, C = np.vstack([0 * drive, drive]), np.hstack([shape, 0 * shape])
    if form == "first order":
        T = rotation(2 * q)
        A, B, C = T @ A @ T.T, T @ B, C @ T.T
    anode = mechanical.index(False)
    return StateSpace(A, B, C, float(model.D[anode, anode]))


def rotation(size):
    """An orthogonal matrix without zeros, always the same."""
    return np.linalg.qr(np.random.default_rng(7).standard_normal((size, size)))[0]


def written(model, part, form):
    """``part``, the product's subcircuit of ``model``, with the inside of another form."""
    pins = [pin.name for pin in part.pins]
    rings = [pin.name for pin in part.pins if pin.flow == "N" and pin.name != "base"]
    columns = {port.name: k for k, port in enumerate(model.ports)}
    ss = state_space(model, form)
    lines = [f"* {form}, {len(ss.A)} states", f".subckt {part.name} {' '.join(pins)}"]
    lines += ["Vtick tick base PWL(0 0 1e-12 0 2e-12 0)", "Rtick tick base 1"]
    sums: dict[str, list[tuple[str, float]]] = {}
    for ring in rings:
        lines += [f"Ru{ring} u{ring} base 1", f"Gf{ring} base f{ring} {ring} u{ring} 1",
                  f"Gp{ring} {ring} base f{ring} base 1"]  # fmt: skip
        sums[f"u{ring}"] = [(f"x{j + 1}", c) for j, c in enumerate(ss.C[columns[ring]])]
    inputs = [(f"f{ring}", columns[ring]) for ring in rings]
    if "anode" in pins:
        lines += [f"Cclamped anode inner {number(ss.clamped)}",
                  "Gleak anode inner anode inner 1e-12",
                  "Ginner base current inner cathode 1", "Gcurrent inner cathode current base 1",
                  f"Gcharge base current charge base {number(1e-6 / ss.clamped)}",
                  "Rcharge charge base 1", "Evolt volt base anode cathode 1",
                  "Rvolt volt base 1"]  # fmt: skip
        anode = next(k for k, port in enumerate(model.ports) if port.kind == "electrical")
        sums["charge"] = [(f"x{j + 1}", c) for j, c in enumerate(ss.C[anode])]
        inputs.append(("volt", anode))
    for i, row in enumerate(ss.A):
        lines.append(f"C{i + 1} x{i + 1} base {number(STATE)}")
        sums[f"x{i + 1}"] = [(f"x{j + 1}", STATE * a) for j, a in enumerate(row)]
        sums[f"x{i + 1}"] += [(node, STATE * ss.B[i, column]) for node, column in inputs]
    for node, terms in sums.items():
        lines += [
            f"G{node}_{k} base {node} {term} base {number(value)}"
            for k, (term, value) in enumerate(terms)
            if value
        ]
    lines.append(f".ends {part.name}")
    return replace(part, text="\n".join(lines) + "\n")


def with_form(deck, model, form, *, name="kick"):
    """``deck`` with its part ``name`` written in another form."""
    part = next(part for part in deck.parts if part.filename == f"{name}.lib")
    return with_text(deck, name, written(model, part, form).text)


def with_text(deck, name, text):
    """``deck`` with another text in the library of its part ``name``."""
    file = f"{name}.lib"
    parts = tuple(replace(p, text=text) if p.filename == file else p for p in deck.parts)
    return replace(deck, parts=parts)


def synthetic(modes, ports):
    """A chip-like model of any size: resonances from 270 kHz to 30 MHz, ``ports`` with an anode."""
    rng = np.random.default_rng(modes * 1000 + ports)
    omega = 2 * np.pi * np.geomspace(270e3, 30e6, modes)
    gain = rng.uniform(0.2, 1.0, (modes, ports)) * rng.choice((-1.0, 1.0), (modes, ports))
    gain *= 50.0 / np.sqrt(modes)
    gain[:, -1] *= 1e-2
    rings = tuple(Port(f"ring{k}", "mechanical") for k in range(ports - 1))
    D = np.zeros((ports, ports))
    D[-1, -1] = 35e-9
    certificate = Certificate((0.0, 500e3), 0.0, "synthetic", True, True)
    named = (*rings, Port("anode", "electrical", pins=("anode", "cathode")))
    return Resonators(omega, 0.02 * omega, gain, D, named, certificate)
