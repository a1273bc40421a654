"""Plane ``macromodel``: a 4-port of order 105, as scikit-rf writes a vector fit and as we do.

The size is that of scikit-rf's own comparison (its pull request 1247: 789, 0.39 and 0.105 s in
ngspice for its admittance, impedance and state-space form). The data of that case are no part of
the package, so poles and residues are made up. scikit-rf 2 writes the fastest form alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from kc2spice.core.waveforms import Waveforms
from kc2spice.netlist.circuit import Subcircuit
from kc2spice.netlist.deck import Deck
from kc2spice.rom.linear import LinearModel, Port
from kc2spice.sim.ngspice import run_deck
from kc2spice.spice.header import Header
from kc2spice.spice.realize import subcircuit
from laboratory.points import Outcome, Plane, Point, Ratio, timed
from laboratory.setup import Setup

PORTS, REAL, PAIRS = 4, 5, 50  # 105 poles, all in every response: 420 states
IMPEDANCE = 50.0  # Ohm
BAND, FREQUENCIES = (0.1e9, 20e9), 1000
THEIRS, OURS = "scikit-rf, state space", "kc2spice, blocks"


def macromodel(setup: Setup) -> Outcome:
    """Time of an .ac sweep, error against the poles and residues themselves."""
    poles, residues = rational(setup)
    frequency = np.linspace(*BAND, 20 if setup.quick else FREQUENCIES)
    exact = scattering(poles, residues, frequency)[:, :, 0]
    points = []
    for label, part in forms(poles, residues, setup.work):
        setup.clock.progress("macromodel", None, label)
        deck = matched(part, frequency)
        waves, time = timed(
            partial(run_deck, deck, setup.work / "macro"), setup.repeats, "children"
        )
        error = float(np.abs(_found(waves) - exact).max() / np.abs(exact).max())
        lines = float(len(part.text.splitlines()))
        points.append(Point(label, label, error, time, {"response": error}, {"lines": lines}))
    found = {point.label: point for point in points}
    ours, theirs = found[OURS], found.get(THEIRS)
    notes = ("made-up poles and residues: the data of scikit-rf's own case are not published",)
    if theirs is None:
        notes += ("scikit-rf is not installed",)
    title = f"4-port of {REAL + 2 * PAIRS} poles in .ac, {len(frequency)} frequencies"
    plane = Plane(
        "macromodel", title, "largest error of S over the largest S", "CPU time [s]",
        tuple(points), notes,
    )  # fmt: skip
    ratio = Ratio(
        "macromodel_vs_scikit_rf",
        None if theirs is None else theirs.time.median / ours.time.median,
        ours.error if theirs is None else max(ours.error, theirs.error), 1.0,
        f"scikit-rf's state-space netlist over ours, {title}, whole process",
    )  # fmt: skip
    return Outcome((plane,), (ratio,))


def rational(setup: Setup) -> tuple[np.ndarray, np.ndarray]:
    """Poles [1/s] with positive imaginary part or none, and reciprocal residues (poles, 4, 4)."""
    rng = np.random.default_rng(1247)
    pairs = 4 if setup.quick else PAIRS
    omega = 2 * np.pi * np.geomspace(*BAND, pairs)
    poles = np.concatenate([-2 * np.pi * np.geomspace(*BAND, REAL), omega * (1j - 0.02)])
    size = np.abs(poles.real)[:, None, None] / 4
    residues = rng.standard_normal((poles.size, PORTS, PORTS)) * size * np.ones(1, complex)
    residues += 1j * rng.standard_normal(residues.shape) * size * (poles.imag > 0)[:, None, None]
    return poles, (residues + residues.transpose(0, 2, 1)) / 2


def scattering(poles: np.ndarray, residues: np.ndarray, frequency: np.ndarray) -> np.ndarray:
    """(frequencies, 4, 4): the sum over poles and their conjugates."""
    s = 2j * np.pi * frequency[:, None]
    paired = poles.imag > 0
    found = np.einsum("fp,pij->fij", 1 / (s - poles), residues)
    mirrored = np.einsum("fp,pij->fij", 1 / (s - poles[paired].conj()), residues[paired].conj())
    return np.asarray(found + mirrored)


def forms(poles: np.ndarray, residues: np.ndarray, work: Path) -> Iterator[tuple[str, Subcircuit]]:
    """Subcircuits ``s_equivalent p1 p2 p3 p4`` by label."""
    yield OURS, ours(poles, residues)
    if find_spec("skrf"):
        import skrf
        from skrf.vectorFitting import VectorFitting

        flat = residues.reshape(len(poles), -1).T
        grid = np.linspace(*BAND, 2)
        band = skrf.Frequency.from_f(grid, unit="Hz")
        network = skrf.Network(frequency=band, s=np.zeros((2, PORTS, PORTS)), z0=IMPEDANCE)
        fit = VectorFitting(network)
        fit.poles, fit.residues = poles, flat
        fit.constant_coeff = fit.proportional_coeff = np.zeros(len(flat))
        file = work / "scikit_rf.sp"
        fit.write_spice_subcircuit_s(str(file))
        yield THEIRS, Subcircuit("s_equivalent", (), (), file.read_text(encoding="utf-8"))


def ours(poles: np.ndarray, residues: np.ndarray) -> Subcircuit:
    """The waves' state space through the product's own writer, behind four reference resistors."""
    A, B, C = _state_space(poles, residues)
    names = [(f"a{k + 1}", "input") for k in range(PORTS)]
    names += [(f"b{k + 1}", "output") for k in range(PORTS)]
    ports = tuple(Port(name, kind) for name, kind in names)  # type: ignore[arg-type]
    D = np.zeros((PORTS, PORTS))
    model = LinearModel(A=A, B=B, C=C, D=D, ports=ports, name="waves", band=(0.0, BAND[1]))
    part = subcircuit(model, "waves", Header("macromodel", "0"))
    root = IMPEDANCE**0.5
    lines = [part.text, f".subckt s_equivalent {' '.join(f'p{k + 1}' for k in range(PORTS))}"]
    pins = [pin.name for pin in part.pins]
    nodes = ["0" if pin == pins[-1] else pin for pin in pins]
    lines.append(f"Xwaves {' '.join(nodes)} {part.name}")
    for k in range(1, PORTS + 1):  # a = v / sqrt Z - b, i = v / Z - 2 b / sqrt Z
        lines += [f"R{k} p{k} 0 {IMPEDANCE}", f"Gb{k} 0 p{k} b{k} 0 {2 / root!r}",
                  f"Rw{k} a{k} 0 1", f"Gv{k} 0 a{k} p{k} 0 {1 / root!r}",
                  f"Gm{k} a{k} 0 b{k} 0 1"]  # fmt: skip
    lines.append(".ends s_equivalent\n")
    return Subcircuit("s_equivalent", (), (), "\n".join(lines))


def _state_space(
    poles: np.ndarray, residues: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Real A, B, C: each port's wave drives one or two states of every pole."""
    size = sum(1 + (pole.imag > 0) for pole in poles) * PORTS
    A, B, C = np.zeros((size, size)), np.zeros((size, PORTS)), np.zeros((PORTS, size))
    row = 0
    for pole, residue in zip(poles, residues, strict=True):
        for port in range(PORTS):
            A[row, row], B[row, port] = pole.real, 1.0 + (pole.imag > 0)
            C[:, row] = residue[:, port].real
            if pole.imag > 0:
                A[row + 1, row + 1] = pole.real
                A[row, row + 1], A[row + 1, row] = pole.imag, -pole.imag
                C[:, row + 1] = residue[:, port].imag
            row += 1 + (pole.imag > 0)
    return A, B, C


def matched(part: Subcircuit, frequency: np.ndarray) -> Deck:
    """Port 1 driven by 1 V behind its impedance, the others matched."""
    pins = [f"p{k + 1}" for k in range(PORTS)]
    lines = [
        "* scattering from port 1", f".include {part.filename}", "V1 source 0 DC 0 AC 1",
        f"R1 source p1 {IMPEDANCE}", *(f"R{pin} {pin} 0 {IMPEDANCE}" for pin in pins[1:]),
        f"X1 {' '.join(pins)} s_equivalent",
        f".ac lin {len(frequency)} {float(frequency[0])!r} {float(frequency[-1])!r}",
        *(f".save v({pin})" for pin in pins), ".end", "",
    ]  # fmt: skip
    vectors = {pin: (f"v({pin})", 1.0) for pin in pins}
    return Deck(name="macromodel", text="\n".join(lines), vectors=vectors, parts=(part,))


def _found(waves: Waveforms) -> np.ndarray:
    """(frequencies, 4): S of every port from port 1."""
    values = 2 * np.column_stack([waves[f"p{k + 1}"] for k in range(PORTS)])
    values[:, 0] -= 1.0
    return values
