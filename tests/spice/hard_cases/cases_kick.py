"""The kick: damping, edges, electrical ports, orders, tolerances; oracles: scipy, closed forms."""

from dataclasses import replace

import numpy as np
from device import chip
from hard_cases.kit import HEADER, bench_deck, case, exact, kick, launch_error, leaves, relative
from scipy.linalg import expm
from support import Port, Waveforms, subcircuit

LAUNCH = "launch velocity, relative"


@case("undamped modes", "amplitude after 300 periods, relative", 1e-3)
def undamped_mode_after_a_voltage_step(bench):
    """One mode struck by a voltage step: ``u = static (1 - cos w t)``, which trap must not damp."""
    one = chip(1, damping=0.0)
    u, t, static = _struck(bench, one, 300)
    late = t > t[-1] - 2 * 2 * np.pi / one.omega[0]
    return relative(np.ptp(u[late]), 2 * static)


@case("0.01 % damping", "amplitude after 300 periods, relative", 1e-3)
def damped_mode_after_a_voltage_step(bench):
    """``exp(-zeta w t)`` to a thousandth: no numerical damping hides behind the physical one."""
    one = chip(1, damping=1e-4)
    u, t, static = _struck(bench, one, 300)
    late = t > t[-1] - 2 * 2 * np.pi / one.omega[0]
    decay = np.exp(-one.damp[0] / 2 * t[late].mean())
    return relative(np.ptp(u[late]), 2 * static * decay)


def _struck(bench, one, periods):
    """Displacement of ring 0 of a one-mode chip after 10 V, its times, its static part."""
    part = subcircuit(one.to_linear_model(), "kick", HEADER, ports=("ring0", "anode"))
    stop = periods * 2 * np.pi / one.omega[0]
    cards = f"""Vstep a 0 PULSE(0 10 0 1e-09 1e-09 1)
Xkick a 0 r 0 kick
.options reltol=1e-4 trtol=1 chgtol=1e-10
.tran 1e-7 {stop} 0 {stop / periods / 80}"""
    waves = bench.run(bench_deck([part], cards, {"u": ("v(r)", 1e-6)}, stop))
    static = 10 * one.gain[0, 0] * one.gain[0, -1] / one.omega[0] ** 2
    return waves["u"], waves["time"], static


@case("50 ms of flight", "height after 50 ms [m]", 1e-6, slow=True)
def flight_of_50_ms(bench):
    """The launch from scipy, then the parabola of free fall."""
    study, model = kick("solver.stop=50 ms", "solver.reltol=1e-6"), chip()
    waves = bench.scene(study, model)
    times = Waveforms({"time": np.linspace(0.0, 40e-6, 4001)}, {})
    left, velocity = leaves(exact(kick(), times, model))
    start = np.interp(left, waves["time"], waves["sphere.y"])
    span = 50e-3 - left
    return abs(waves["sphere.y"][-1] - start - velocity * span + 9.81 / 2 * span**2)


@case("source without resistance at a capacitance", "charge, relative", 1e-6)
def ideal_source_charges_the_chip(bench):
    """1 ns edge of 100 V: the charge is ``C0 V`` and what the modes add (matrix exponential)."""
    model = chip(6)
    part = subcircuit(model.to_linear_model(), "kick", HEADER, ports=("anode",))
    cards = """Vstep a 0 PULSE(0 100 0 1e-09 1e-09 1)
Xkick a 0 0 kick
Fcharge 0 charge Vstep -1
Ccharge charge 0 1e-06
Rcharge charge 0 1e12
.options reltol=1e-5 trtol=1 chgtol=1e-12
.tran 1e-9 2e-6 0 2e-9"""
    waves = bench.run(bench_deck([part], cards, {"q": ("v(charge)", 1e-6)}, 2e-6))
    n = 6
    a = np.block([[np.zeros((n, n)), np.eye(n)], [-np.diag(model.omega**2), -np.diag(model.damp)]])
    push = np.concatenate((np.zeros(n), model.gain[:, -1] * 100.0))
    state = np.linalg.solve(a, (expm(a * (2e-6 - 0.5e-9)) - np.eye(2 * n)) @ push)
    charge = model.D[-1, -1] * 100.0 + model.gain[:, -1] @ state[:n]
    return relative(waves["q"][-1], charge)


PENALTIES, ORDERS = "penalty 1e6 to 1e12 N/m", "orders 1 to 120"
TOLERANCES = "relative tolerances 3e-2 to 1e-7"
LAUNCHES = [  # entry, name, key, modes, limit, slow
    (PENALTIES, "penalty 1e6", "contact.penalty=1e6 N/m", 30, 2e-4, False),
    (PENALTIES, "penalty 1e11", "contact.penalty=1e11 N/m", 30, 2e-4, True),
    ("kick with 1 ns edges", "edges of 1 ns", "kick.drive.edge=1 ns", 30, 2e-4, True),
    (ORDERS, "order 120", "solver.reltol=1e-4", 120, 2e-4, True),
    # all rings on one hard mode: "energy of kick" refuses every looser run
    (ORDERS, "order 1", "solver.reltol=3e-7", 1, 2e-4, False),
    # Measured errors fall with the square root of reltol; limits leave a factor of two and more.
    (TOLERANCES, "reltol 1e-3", "solver.reltol=1e-3", 30, 1e-3, False),
    (TOLERANCES, "reltol 1e-7", "solver.reltol=1e-7", 30, 1e-5, True),
]
for entry, name, key, modes, limit, slow in LAUNCHES:
    case(entry, LAUNCH, limit, slow=slow, name=name)(
        lambda bench, key=key, modes=modes: launch_error(bench, kick(key), chip(modes))
    )


@case(TOLERANCES, "launch velocity", refused="energy balance of", name="reltol 3e-2")
def reltol_3e_2(bench):
    bench.scene(kick("solver.reltol=3e-2"))
    return 0.0


@case(
    "node names that occur twice",
    "names of nodes",
    refused="already contains this name",
)
def ports_named_like_inner_nodes(bench):
    """q1 and charge are nodes of the subcircuit itself: two nodes would become one in silence."""
    model, names = chip(6), ("q1", "charge")
    ports = [Port(name, "mechanical", "um", "N") for name in names]
    model = replace(model, ports=(*ports, *model.ports[2:]))
    subcircuit(model.to_linear_model(), "kick", HEADER, ports=(*names, "anode"))
    return 0.0
