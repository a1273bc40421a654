"""Plane ``dense``: one device as decoupled resonators and as generic exporters write it, in .ac."""

from functools import partial

import numpy as np

from bench.points import Outcome, Plane, Point, fastest, speed_up, timed
from kc2spice.netlist.deck import Deck
from kc2spice.rom.linear_model import Certificate, LinearModel, Port
from kc2spice.rom.modal_models import Resonators
from kc2spice.sim.ngspice import run_deck
from kc2spice.synthesis.model_to_subcircuit import subcircuit

PORTS = 7
# Name of the ratio, modes, frequencies, target. 30 is the order of the scenes' reduced chip, 348
# are first-order states. The small device needs many points to outlast start-up.
SIZES = (("30", 30, 5000, 5.0), ("348", 174, 20, 50.0))
QUICK_SIZES = (("30", 15, 50, 5.0), ("348", 30, 5, 50.0))
EQUAL = 1e-6
FORMS = ("resonators", "second order", "first order")


def dense(setup):
    """Time of an .ac sweep of each form, error against the closed form of the response.

    Unit voltage on the anode, frequencies to 1 MHz, displacements in um.
    """
    points, ratios = [], []
    for size, modes, frequencies, target in QUICK_SIZES if setup.quick else SIZES:
        model, found = synthetic(modes, PORTS), {}
        step, rings = 1e6 / frequencies, [port.name for port in model.ports[:-1]]
        frequency = np.linspace(step, 1e6, frequencies)
        exact = 1e6 * model.to_linear_model().transfer(frequency)[:, :-1, -1]
        cards = ["V1 anode 0 DC 0 AC 1", f"Xkick anode 0 {' '.join(rings)} 0 kick",
                 *(f"G{ring} {ring} 0 {ring} 0 1e-12" for ring in rings),
                 f".ac lin {frequencies} {step!r} 1e6"]  # fmt: skip
        for form in FORMS:
            setup.clock.progress("dense", None, f"{modes} modes, {form}")
            part = subcircuit(written(model, form), "kick", dense=form != FORMS[0])
            repeats = 1 if modes > 100 and form != FORMS[0] else setup.repeats
            waves, time = ran(setup, part, cards, rings, repeats)
            answers = np.column_stack([waves[ring] for ring in rings])
            error = float((np.abs(answers - exact) / np.abs(exact).max(axis=0)).max())
            label = f"{modes} modes, {frequencies} frequencies, {form}"
            found[form] = Point(form, label, error, time, {"response": error}, sources(part))
        points += found.values()
        slow = fastest((found[form] for form in FORMS[1:]), {"response": EQUAL})
        ours = found[FORMS[0]]
        what = (
            f"time of the faster dense form divided by time of resonators, {modes} modes "
            f"({2 * modes} states), {PORTS} ports, .ac at {frequencies} frequencies, whole process"
        )
        error = max(each.error for each in (ours, slow) if each is not None)
        name = f"dense_vs_resonator_{size}"
        ratios.append(speed_up(name, slow and slow.time, ours, target, what, error=error))
    notes = (
        "The devices are synthetic, with resonances from 270 kHz to 30 MHz, as in the chip of "
        "`kick_and_catch`",
    )
    plane = Plane(
        "dense", "Three netlist forms of a device in .ac", "largest relative error of any response",
        "CPU time [s]", tuple(points), notes,
    )  # fmt: skip
    return Outcome((plane,), tuple(ratios))


def ran(setup, part, cards, nodes, repeats):
    """The voltages of ``nodes`` in a deck of these cards, and the CPU time of ngspice."""
    saved = " ".join(f"v({node})" for node in nodes)
    lines = ["* one model", f".include {part.filename}", *cards, f".save {saved}", ".end", ""]
    vectors = {node: (f"v({node})", 1.0) for node in nodes}
    deck = Deck(name="dense", text="\n".join(lines), vectors=vectors, parts=(part,))
    return timed(partial(run_deck, deck, setup.work / "dense"), repeats, "children")


def sources(part):
    """How many of them are in a netlist."""
    count = sum(line[:1] in "GEF" for line in part.text.splitlines() if line)
    return {"controlled sources": float(count)}


def written(model, form):
    """``model`` as decoupled resonators, or turned into other coordinates by a fixed rotation.

    *second order* keeps displacements and velocities apart, with dense stiffness and damping;
    *first order* mixes all states, which is what a rational fit or a general reduction gives.
    """
    if form == "resonators":
        return model.to_linear_model()
    omega, q = model.omega, model.omega.size
    stiff, damp, drive, zero = np.diag(omega**2), np.diag(model.damp), model.gain, np.zeros((q, q))
    if form == "second order":
        T, omega = rotation(q), np.full(q, np.exp(np.log(omega).mean()))
        stiff, damp, drive = T @ stiff @ T.T, T @ damp @ T.T, T @ drive
    A = np.block([[zero, np.diag(omega)], [-stiff / omega[:, None], -damp]])
    B, C = np.vstack([0 * drive, drive / omega[:, None]]), np.hstack([drive.T, 0 * drive.T])
    if form == "first order":
        T = rotation(2 * q)
        A, B, C = T @ A @ T.T, T @ B, C @ T.T
    return LinearModel(A=A, B=B, C=C, D=model.D, ports=model.ports, certificate=model.certificate)


def rotation(size):
    """An orthogonal matrix without zeros, always the same."""
    return np.linalg.qr(np.random.default_rng(7).standard_normal((size, size)))[0]


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
