"""Plane ``writers``: one multiport of 105 poles and 4 ports as scikit-rf writes it and as the
product does, and states of first order beside resonators, in .ac and .tran.
"""

from types import SimpleNamespace

import numpy as np

from bench.dense import ran, rotation, sources, synthetic
from bench.points import Outcome, Plane, Point, speed_up
from kc2spice.netlist.card_parser import read_cards
from kc2spice.netlist.subcircuit_library import Subcircuit
from kc2spice.rom.linear_model import Certificate, LinearModel, Port
from kc2spice.rom.multiport import _convert_to_charges, _realise_state_space
from kc2spice.synthesis.model_to_subcircuit import subcircuit

OHM, TOP = 50.0, 1e9  # of the scattering parameters, Hz
STEP, STOP = 5e-11, 1e-7  # s of the transient
SOURCE = "DC 0 AC 1 SIN(0 1 3e8)"


def writers(setup):
    """CPU time of ngspice by form; error of the response in closed form, in .tran to the other."""
    pairs, ports = (4, 2) if setup.quick else (50, 4)
    fit, answer = multiport(5, pairs, ports)
    theirs = _scikit(setup, fit, ports)
    residues = np.moveaxis(fit.residues.reshape(ports, ports, -1), 2, 0)
    ours = _convert_to_charges(
        *_realise_state_space(fit.poles, residues, fit.constant_coeff.reshape(ports, ports)), OHM
    )
    certificate = Certificate((0.0, TOP), 0.0, "its poles", True, True)
    given = {"ports": ours.ports, "certificate": certificate}
    closed = LinearModel(**dict(zip("ABCD", ours.state_space(), strict=True)), **given)
    waves = LinearModel(A=ours.A, E=ours.E, B=ours.B, C=ours.C, **given)
    parts = {"scikit-rf, state space of S": theirs, "ours": subcircuit(waves, "dut"),
             "ours, loops closed": subcircuit(closed, "dut")}  # fmt: skip
    frequency = np.linspace(TOP / 1000, TOP, 20 if setup.quick else 1000)
    points, ratios = [], []
    known = {".ac": answer(frequency)}
    for analysis in (".ac", ".tran"):
        for form, part in parts.items():
            cards = _cards(part, ports, analysis, len(frequency))
            found, time = ran(setup, part, cards, ["port2"], setup.repeats)
            wave = found["port2"]
            if analysis == ".tran":
                wave = np.interp(np.linspace(0, STOP, 500), found.data["time"], wave)
            label = f"{2 * pairs + 5} poles, {ports} ports, {analysis}, {form}"
            points.append(_point(form, label, part, wave, known.setdefault(analysis, wave), time))
        peer, own = points[-3:-1]
        what = (
            f"time of the netlist of scikit-rf divided by time of kc2spice, {analysis}, equal poles"
        )
        ratios.append(speed_up(f"scikit_rf_vs_ours_{analysis[1:]}", peer.time, own, 1.0, what))
    points += _first_order(setup, ratios)
    plane = Plane(
        "writers", "Netlists of several programs with equal poles",
        "largest error divided by the largest response", "CPU time [s]", tuple(points),
        ("In .tran, the error is the difference from the netlist of scikit-rf",),
    )  # fmt: skip
    return Outcome((plane,), tuple(ratios))


def multiport(real, pairs, ports):  # type: ignore[no-untyped-def]
    """A passive reciprocal scattering matrix as a fit has it; what port 2 of it answers to a source
    of 1 V at port 1 while all others see 50 ohm."""
    rng = np.random.default_rng(0)
    w = 2 * np.pi * TOP * np.geomspace(0.01, 1, pairs)
    poles = np.r_[
        -2 * np.pi * TOP * np.geomspace(0.01, 1, real), (1j - rng.uniform(0.01, 0.1, pairs)) * w
    ]
    R = rng.standard_normal((real + pairs, ports, ports)).astype(complex)
    R[real:] += 1j * rng.standard_normal((pairs, ports, ports))
    R = (R + R.swapaxes(1, 2)) * 0.08 / ports * np.abs(poles.real)[:, None, None]
    D = np.diag(rng.uniform(-0.3, 0.3, ports))

    def answer(frequency):
        s, one = 2j * np.pi * frequency[:, None, None], np.eye(ports)
        S = D + sum(
            r / (s - p) + (p.imag > 0) * r.conj() / (s - p.conj())
            for r, p in zip(R, poles, strict=True)
        )
        Y = np.linalg.solve(one + S, one - S) / OHM
        return -np.linalg.solve(Y[:, 1:, 1:] + one[1:, 1:] / OHM, Y[:, 1:, :1])[:, 0, 0]

    residues = np.moveaxis(R, 0, 2).reshape(ports**2, -1)
    return SimpleNamespace(poles=poles, residues=residues, constant_coeff=D.ravel()), answer


def _scikit(setup, fit, ports):
    import skrf
    from skrf.vectorFitting import VectorFitting

    f = np.linspace(TOP / 10, TOP, 3)
    S = np.zeros((3, ports, ports), dtype=complex)
    found = VectorFitting(skrf.Network(frequency=skrf.Frequency.from_f(f, unit="hz"), s=S, z0=OHM))
    for name, value in vars(fit).items():
        setattr(found, name, value)
    found.proportional_coeff = np.zeros(ports**2)
    file = setup.work / "skrf.sp"
    found.write_spice_subcircuit_s(str(file), "dut")
    text = file.read_text()
    return Subcircuit("dut", (), (), read_cards(text, file.name), source=text)


def _cards(part, ports, analysis, count):
    names = [f"port{k + 1}" for k in range(ports)]
    pins = [pin.name for pin in part.pins] or names
    commands = {".ac": f".ac lin {count} {TOP / 1000!r} {TOP!r}", ".tran": f".tran {STEP} {STOP}"}
    return [
        f"V1 port1 0 {SOURCE}", *(f"R{name} {name} 0 {OHM}" for name in names[1:]),
        f"Xdut {' '.join('0' if p in ('ref', 'base') else p for p in pins)} dut",
        commands[analysis],
    ]  # fmt: skip


def _point(family, label, part, found, exact, time, same_model=True):
    size = np.abs(exact).max() or 1.0  # at rest, where time alone is looked at
    error = max(float(np.abs(found - exact).max() / size), 1e-16)
    errors = {"response": error}
    return Point(family, label, error, time, errors, sources(part), same_model=same_model)


def _first_order(setup, ratios):
    """100 states of first order, coordinates mixed, and 100 resonators, 8 ports each, in .ac and
    in .tran of fixed steps."""
    size, ports = (10, 3) if setup.quick else (100, 8)
    rng = np.random.default_rng(1)
    w = 2 * np.pi * np.geomspace(270e3, 30e6, size // 2)
    A = np.kron(np.diag(w), np.array([[-0.01, 1.0], [-1.0, -0.01]]))
    B, C = rng.standard_normal((size, ports)), rng.standard_normal((ports, size))
    Q = rotation(size)
    named = tuple(Port(f"u{k}", "input") for k in range(ports))
    named += tuple(Port(f"y{k}", "output") for k in range(ports))
    states = LinearModel(A=Q @ A @ Q.T, B=Q @ B, C=C @ Q.T, ports=named, band=(0.0, 1e6))
    model = synthetic(size, ports)
    f = np.linspace(1e3, 1e6, 20 if setup.quick else 1000)
    rows = []
    inside = 2j * np.pi * f[:, None, None] * np.eye(size) - A
    mixed = np.linalg.solve(inside, B[:, :1].astype(complex)[None])
    exact = {
        "states": (C[:1] @ mixed)[:, 0, 0],
        "resonators": 1e6 * model.to_linear_model().transfer(f)[:, 0, -1],
    }
    for name, part in (
        ("resonators", subcircuit(model.to_linear_model(), "dut")),
        ("states", subcircuit(states, "dut")),
    ):  # fmt: skip
        for analysis in (".ac", ".tran"):
            driven = "u0" if name == "states" else "anode"
            seen = "y0" if name == "states" else "ring0"
            pins = [pin.name for pin in part.pins]
            command = f".ac lin {len(f)} 1e3 1e6" if analysis == ".ac" else ".tran 1e-9 5e-6 0 1e-9"
            cards = [
                f"V1 {driven} 0 DC 0 AC 1",
                f"Xdut {' '.join('0' if p in ('ref', 'base', 'cathode') else p for p in pins)} dut",
                *(f"G{p} {p} 0 {p} 0 1e-12" for p in pins if p.startswith("ring")),
                *(f"V{p} {p} 0 0" for p in pins if p.startswith("u") and p != driven),
                ".options reltol=1", command,
            ]  # fmt: skip
            found, time = ran(setup, part, cards, [seen], setup.repeats)
            wave = found[seen][: len(f)]
            known = exact[name] if analysis == ".ac" else wave  # timed alone
            label = f"{size} {name}, {ports} ports, {analysis}"
            rows.append(_point(name, label, part, wave, known, time, same_model=False))
    for k, analysis in enumerate(("ac", "tran")):
        what = (
            f"time of {size} resonators divided by time of {size} first-order states, .{analysis}"
        )
        name, error = f"resonators_vs_states_{analysis}", rows[2].error
        ratios.append(speed_up(name, rows[k].time, rows[2 + k], 1.0, what, error=error))
    return rows
