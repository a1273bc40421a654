"""The kick: damping, edges, electrical ports, orders, tolerances; oracles: scipy, closed forms."""

from dataclasses import replace

import numpy as np
from device import chip
from hard_cases.cases_contact import launch_error
from hard_cases.kit import (
    HEADER,
    bench_deck,
    case,
    exact,
    kick,
    leaves,
    relative,
)
from scipy.linalg import expm

from kc2spice.core.waveforms import Waveforms
from kc2spice.rom.linear import Port
from kc2spice.spice.realize import subcircuit

LAUNCH = "launch, relative"


@case("undamped modes", "amplitude after 300 periods, relative", 1e-3)
def undamped_mode_rings_on(bench):
    """One mode struck by a voltage step: ``u = static (1 - cos w t)``, which trap must not damp."""
    one = chip(1, damping=0.0)
    u, t, static = _struck(bench, one, 300)
    late = t > t[-1] - 2 * 2 * np.pi / one.omega[0]
    return relative(np.ptp(u[late]), 2 * static)


@case("0.01 % damping", "amplitude after 300 periods, relative", 1e-3)
def lightly_damped_mode_decays(bench):
    """``exp(-zeta w t)`` to a thousandth: no numerical damping hides behind the physical one."""
    one = chip(1, damping=1e-4)
    u, t, static = _struck(bench, one, 300)
    late = t > t[-1] - 2 * 2 * np.pi / one.omega[0]
    decay = np.exp(-one.damp[0] / 2 * t[late].mean())
    return relative(np.ptp(u[late]), 2 * static * decay)


def _struck(bench, one, periods):
    """Displacement of ring 0 of a one-mode chip after 10 V, its times, its static part."""
    part = subcircuit(one.linear(), "kick", HEADER, ports=("ring0", "anode"))
    stop = periods * 2 * np.pi / one.omega[0]
    cards = f"""Vstep a 0 PULSE(0 10 0 1e-09 1e-09 1)
Xkick a 0 r 0 kick
.options reltol=1e-4 trtol=1 chgtol=1e-10
.tran 1e-7 {stop} 0 {stop / periods / 80}"""
    waves = bench.run(bench_deck([part], cards, {"u": ("v(r)", 1e-6)}, stop))
    static = 10 * one.gain[0, 0] * one.gain[0, -1] / one.omega[0] ** 2
    return waves["u"], waves["time"], static


@case("kick with 1 ns edges", LAUNCH, 2e-4, slow=True)
def edges_of_1_ns(bench):
    return launch_error(bench, kick("kick.drive.edge=1 ns"))


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


@case("stiff source into the capacitance", "charge, relative", 1e-6)
def ideal_source_charges_the_chip(bench):
    """1 ns edge of 100 V: the charge is ``C0 V`` and what the modes add (matrix exponential)."""
    model = chip(6)
    part = subcircuit(model.linear(), "kick", HEADER, ports=("anode",))
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


def _order(order, reltol="1e-4", slow=False):
    def measure(bench):
        return launch_error(bench, kick(f"solver.reltol={reltol}"), chip(order))

    measure.__name__ = f"order_{order}"
    case("orders 1 to 120", LAUNCH, 2e-4, slow=slow)(measure)


_order(120, slow=True)
_order(1, "3e-7")  # all rings on one hard mode: "energy of kick" refuses every looser run


def _tolerance(reltol, limit):
    def measure(bench):
        return launch_error(bench, kick(f"solver.reltol={reltol}"))

    measure.__name__ = f"reltol_{reltol}"
    slow = float(reltol) < 1e-5
    case("tolerances 1e-2 to 1e-7", LAUNCH, limit, slow=slow)(measure)


# Measured errors fall with the square root of reltol; the limits leave a factor of two and more.
for reltol, limit in (("1e-3", 1e-3), ("1e-7", 1e-5)):
    _tolerance(reltol, limit)


@case("tolerances 1e-2 to 1e-7", "a launch that is wrong by a percent", refused="energy of")
def reltol_1e_2_is_noticed(bench):
    bench.scene(kick("solver.reltol=3e-2"))
    return 0.0


@case("node names that collide", "ports called as inner nodes are", refused="name is taken")
def ports_named_like_inner_nodes(bench):
    """q1 and charge are nodes of the subcircuit itself: two nodes would become one in silence."""
    model = _renamed(chip(6), ("q1", "charge"))
    subcircuit(model.linear(), "kick", HEADER, ports=("q1", "charge", "anode"))
    return 0.0


def _renamed(model, names):
    ports = [Port(name, "mechanical", "um", "N") for name in names]
    return replace(model, ports=(*ports, *model.ports[len(names) :]))
