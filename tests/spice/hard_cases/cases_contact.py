"""Contact: stiffness, grazing, rest, chatter, bounces; oracles: scipy, closed forms, energy."""

from __future__ import annotations

import numpy as np
from device import RADII, chip, deck_of
from hard_cases.bounces import OPTIONS, bounce
from hard_cases.kit import (
    HEADER,
    bench_deck,
    case,
    exact,
    kick,
    leaves,
    relative,
    rewritten,
    scene,
)
from hard_cases.oracle import Plain
from scipy.interpolate import CubicHermiteSpline

from kc2spice.parts.contact import Normal, contact_subcircuit
from kc2spice.parts.sphere import SphereKeys, sphere_subcircuit
from kc2spice.spice.realize import subcircuit
from laboratory.distance import compare

MASS = SphereKeys().mass
RINGS = tuple(f"ring{k}" for k in range(6))


def launch_error(bench, study, model=None):
    """Launch velocity of a kick against scipy, relative."""
    model = model or chip()
    waves = bench.scene(study, model)
    return relative(leaves(waves)[1], leaves(exact(study, waves, model))[1])


def impact_error(bench, study, model):
    """Largest distance from scipy's trajectory over its travel."""
    waves = bench.scene(study, model)
    return compare(waves, exact(study, waves, model))["trajectory_relative"]


def _penalty(value, slow=False):
    def measure(bench):
        return launch_error(bench, kick(f"contact.penalty={value} N/m"))

    measure.__name__ = f"penalty_{value}"
    case("penalty 1e6 to 1e12 N/m", "launch, relative", 2e-4, slow=slow)(measure)


for value in ("1e6", "1e7", "1e8", "1e9", "1e10", "1e11"):
    _penalty(value, slow=value not in ("1e6", "1e8"))


@case("all six rings at once", "rebound velocity, relative", 1e-4)
def flat_contact(bench):
    """A chip flat under the sphere, all gaps zero: six springs close in one instant.

    The range check would rightly refuse this contact patch, so the deck is run without it.
    """
    model, gap, velocity, stop = chip(6), 1e-6, -1.0, 10e-6
    parts = [
        subcircuit(model.linear(), "kick", HEADER),
        contact_subcircuit(HEADER, RINGS, np.zeros(6), Normal(4e8)),
        sphere_subcircuit(HEADER, MASS, 1e-3, 0.0, velocity=velocity, height=gap),
    ]
    rings = " ".join(RINGS)
    cards = f"""Xkick 0 0 {rings} 0 kick
Xcontact {rings} v bottom 0 contact
Xsphere v bottom y 0 sphere
.options reltol=1e-4 trtol=1 chgtol=1e-08
.tran 1e-08 {stop} 0 5e-08 uic"""
    waves = bench.run(bench_deck(parts, cards, {"sphere.v": ("v(v)", 1.0)}, stop))
    start = np.zeros(2 * 6 + 2)
    start[-2:] = gap, velocity
    plain = Plain.of(model, np.zeros(6), 1e-3, MASS, stiffness=4e8, gravity=0.0)
    still = np.array([0.0, 1.0])
    _, states = plain.run(start, still, 0.0 * still, stop)
    return relative(waves["sphere.v"][-1], states[-1, -1])


@case("all six rings at once", "contact patch beyond the rings", refused="outer_ring")
def patch_outgrows_the_rings(bench):
    study = scene("impact", "impact.velocity=-100 m/s", "impact.gap=1 um")
    bench.scene(study)
    return 0.0


@case("all six rings at once", "static force, relative", 1e-8)
def deep_imprint(bench):
    study, model = scene("imprint", "imprint.depth=200 um", "imprint.steps=50"), chip()
    waves = bench.scene(study, model)
    force = exact(study, waves, model)["contact.force"]
    assert waves["contact.force.ring5"][-1] > 0.0
    return np.abs(waves["contact.force"][1:] / force[1:] - 1.0).max()


def _grazing(speed, gap, stop):
    def measure(bench):
        study = scene("impact", f"impact.velocity=-{speed} mm/s", f"impact.gap={gap} nm",
                      f"solver.stop={stop} us", "kick.electrical=short")  # fmt: skip
        return impact_error(bench, study, chip())

    measure.__name__ = f"grazing_at_{speed}_mm_s"
    case("grazing contact", "trajectory over travel", 1e-4)(measure)


_grazing("1", "1", "15")
_grazing("10", "10", "15")


@case("resting contact", "penetration m g / k, relative", 1e-4)
def rest_for_50_ms(bench):
    """On a rigid plane; the weight presses the spring in by less than a picometre."""
    ground = contact_subcircuit(HEADER, ("ring0",), np.zeros(1), Normal(4e8))
    sphere = sphere_subcircuit(HEADER, MASS, 1e-3, 9.81)
    cards = """Xsphere v bottom y 0 sphere
Vground ring0 0 0
Xcontact ring0 v bottom 0 contact
.options reltol=1e-4 trtol=1 chgtol=1e-08
.tran 1e-05 0.05 0 1e-05"""
    deck = bench_deck([sphere, ground], cards, {"bottom": ("v(bottom)", 1e-6)}, 0.05)
    bottom = bench.run(deck)["bottom"]
    return np.abs(bottom / (-MASS * 9.81 / 4e8) - 1.0).max()


@case("resting contact", "force over weight, relative", 1e-4)
def rest_on_a_chip(bench):
    """Nothing moves: the energy balances must not take rounding for work."""
    waves = bench.scene(kick("kick.drive.voltage=0", "solver.stop=50 ms"))
    return np.abs(waves["contact.force"] / (MASS * 9.81) - 1.0).max()


@case("resting contact", "height over its travel", 1e-3, slow=True)
def chatter_after_a_kick_of_one_volt(bench):
    """The sphere hops by nanometres: steps must resolve them, or the run must notice."""
    study = kick("kick.drive.voltage=1 V", "solver.stop=0.2 ms")
    waves = bench.scene(study)
    return compare(waves, exact(study, waves))["trajectory_relative"]


@case("resting contact", "height after 50 ms [m]", 1e-6, slow=True)
def ten_landings_in_50_ms(bench):
    """No catch: the sphere falls back again and again and settles into chatter."""
    study = kick("kick.drive.voltage=2 V", "solver.stop=50 ms", "solver.reltol=1e-5")
    waves = bench.scene(study)
    return compare(waves, exact(study, waves))["final_m"]


@case("100 elastic bounces", "energy gained or lost, relative", 1e-3)
def hundred_bounces_on_a_rigid_plane(bench):
    found = bounce(bench, "max(0, x), edges watched", OPTIONS["trap, 1e-4"])
    return abs(found.energy) + abs(found.missed)


@case("100 elastic bounces", "energy of sphere and chip, relative", 1e-3, slow=True)
def bounces_on_an_undamped_chip(bench):
    """A strong pull brings the sphere down again and again; what it loses the chip must hold."""
    pull = 1e4
    study = scene("impact", f"gravity={pull} m/s2", "impact.velocity=-10 mm/s",
                  "impact.gap=100 nm", "kick.electrical=short", "solver.stop=20 us",
                  "solver.reltol=1e-5")  # fmt: skip
    waves = bench.scene(study, chip(6, damping=0.0))
    y, v = waves["sphere.y"], waves["sphere.v"]
    energy = MASS * (v**2 / 2 + pull * (y - y[0]))
    given = sum(
        np.trapezoid(waves[f"contact.force.ring{k}"], waves[f"kick.u.ring{k}"]) for k in range(6)
    )
    return abs(energy[-1] - energy[0] - given) / energy.max()


def _kicked_twice(bench, voltage):
    """ngspice's waveforms and, by DOP853 on the plain equations, times and states."""
    few, study = chip(6), kick(f"kick.drive.voltage={voltage}", "solver.stop=0.11 ms")
    deck = deck_of(study, few)
    once = " 10000.0)"  # the pulse's period
    assert deck.files[deck.main].count(once) == 1
    waves = bench.run(rewritten(deck, deck.files[deck.main].replace(once, " 5e-05)")))
    plain = Plain.of(few, RADII, 1e-3, MASS, stiffness=4e8)
    edges = np.array([0.0, 0.1, 25.0, 25.1]) * 1e-6
    corners = np.concatenate((10e-6 + edges, 60e-6 + edges, 110e-6 + edges))
    rest = np.zeros(2 * 6 + 2)
    rest[:6] = -few.gain[:6, 0] / few.omega**2 * plain.mass * 9.81
    rest[-2] = rest[:6] @ few.gain[:6, 0] - plain.mass * 9.81 / 4e8
    volts = np.tile([0.0, voltage, voltage, 0.0], 3)
    return waves, *plain.run(rest, corners, volts, study.stop, rtol=1e-9, largest=50e-9)


@case("two kicks 50 us apart", "launch, relative", 2e-4)
def two_kicks(bench):
    """The sphere is gone when the second pulse comes; oracle: plain equations by DOP853."""
    waves, _, states = _kicked_twice(bench, 20.0)
    return relative(waves["sphere.v"][-1], states[-1, -1])


@case("two kicks 50 us apart", "stroke, relative to the largest", 1e-2, slow=True)
def second_kick(bench):
    """The second pulse meets a chip that still rings, and trapezoids lag in phase."""
    waves, times, states = _kicked_twice(bench, 100.0)
    times, kept = np.unique(times, return_index=True)
    to_centre = chip(6).gain[:6, 0]
    stroke, rate = states[kept, :6] @ to_centre, states[kept, 6:12] @ to_centre
    exact = CubicHermiteSpline(times, stroke, rate)(waves["time"])
    return np.abs(waves["kick.u.ring0"] - exact).max() / np.abs(stroke).max()
