"""Contact: stiffness, grazing, rest, chatter, bounces; oracles: scipy, closed forms, energy."""

from dataclasses import replace

import numpy as np
from device import RADII, chip, deck_of
from hard_cases.kit import HEADER, bench_deck, case, exact, kick, relative, scene
from hard_cases.modal_kick import Kick
from scipy.integrate import solve_ivp
from support import ContactForce, SphereKeys, declare_contact, declare_sphere, subcircuit
from support import make_declared_subcircuit as declared

from bench.distance import compare

MASS = SphereKeys().mass
STEP = 0.5e-9  # s, of the oracle
RINGS = tuple(f"ring{k}" for k in range(6))


@case("all six contact rings close at the same time", "rebound velocity, relative", 1e-4)
def flat_chip_below_the_sphere(bench):
    """A chip flat under the sphere, all gaps zero: six springs close in one instant.

    The range check would rightly refuse this contact patch, so the deck is run without it.
    """
    model, gap, velocity, stop = chip(6), 1e-6, -1.0, 10e-6
    parts = [
        subcircuit(model.to_linear_model(), "kick", HEADER),
        declared(HEADER, "contact", declare_contact(RINGS, (0.0,) * 6, ContactForce(4e8)), {}),
        declared(HEADER, "sphere", declare_sphere(MASS, 1e-3, 0.0, velocity, gap), {}),
    ]
    rings = " ".join(RINGS)
    cards = f"""Xkick 0 0 {rings} 0 kick
Xcontact {rings} v bottom 0 contact
Xsphere v bottom y 0 sphere
.options reltol=1e-4 trtol=1 chgtol=1e-08
.tran 1e-08 {stop} 0 5e-08 uic"""
    waves = bench.run(bench_deck(parts, cards, {"sphere.v": ("v(v)", 1.0)}, stop))
    w, damp, rings = model.omega, model.damp, model.gain[:, :6]

    def rate(_, x):
        """Plain equations of modes z, z' and of height and velocity of the sphere."""
        force = 4e8 * np.maximum(x[:6] @ rings - x[12], 0.0)
        bend = -damp * x[6:12] - w**2 * x[:6] - rings @ force
        return np.r_[x[6:12], bend, x[13], force.sum() / MASS]

    size = 1e-6 / np.abs(rings).max(axis=1)
    done = solve_ivp(rate, (0, stop), np.r_[np.zeros(12), gap, velocity], "DOP853", rtol=1e-10,
                     atol=1e-10 * np.r_[size, size * w, 1e-6, 1.0])  # fmt: skip
    return relative(waves["sphere.v"][-1], done.y[-1, -1])


@case("grazing contact", "trajectory, relative to the travel", 1e-4)
def impact_at_1_mm_per_s(bench):
    study = scene("impact", "impact.velocity=-1 mm/s", "impact.gap=1 nm", "solver.stop=15 us",
                  "kick.electrical=short")  # fmt: skip
    waves = bench.scene(study)
    return compare(waves, exact(study, waves))["of_travel"]


@case("resting contact", "contact force, relative to the weight", 1e-4)
def sphere_rests_on_the_chip(bench):
    """Nothing moves: the energy balances must not take rounding for work."""
    waves = bench.scene(kick("kick.drive.voltage=0", "solver.stop=50 ms"))
    return np.abs(waves["contact.force"] / (MASS * 9.81) - 1.0).max()


@case("resting contact", "height, relative to the travel", 1e-3, slow=True)
def small_bounces_after_a_kick_of_1_V(bench):
    """The sphere hops by nanometres: steps must resolve them, or the run must notice."""
    study = kick("kick.drive.voltage=1 V", "solver.stop=0.2 ms")
    waves = bench.scene(study)
    return compare(waves, exact(study, waves))["of_travel"]


@case("100 elastic bounces", "energy, relative", 1e-3)
def sphere_on_a_rigid_plane(bench):
    """A sphere falls 5 um a hundred times."""
    speed, height, landings = 0.01, 1e-7, 100
    ground = declared(HEADER, "contact", declare_contact(("ring0",), (0.0,), ContactForce(4e8)), {})
    sphere = declared(HEADER, "sphere", declare_sphere(MASS, 1e-3, 9.81, -speed, height), {})
    stop = (landings + 0.5) * (2 * speed / 9.81 + np.pi * np.sqrt(MASS / 4e8))
    cards = f"""Xsphere v bottom y 0 sphere
Vground ring0 0 0
Xcontact ring0 v bottom 0 contact
.options reltol=1e-4 trtol=1 chgtol=1e-08
.tran 1e-4 {stop} 0 1e-5 uic"""
    vectors = {"v": ("v(v)", 1.0), "bottom": ("v(bottom)", 1e-6)}
    waves = bench.run(bench_deck([sphere, ground], cards, vectors, stop))
    bottom, v = waves["bottom"], waves["v"]
    # Counted where the sphere is clear of the plane, thus without the spring's law.
    energy = (v**2 / 2 + 9.81 * bottom)[bottom > height / 10]
    missed = landings - np.count_nonzero((bottom[:-1] > 0) & (bottom[1:] <= 0))
    return abs(energy[-1] / (speed**2 / 2 + 9.81 * height) - 1) + abs(missed)


@case("two kicks 50 us apart", "launch velocity, relative", 2e-4, slow=True)
def second_kick_during_the_flight(bench):
    """The sphere is gone when the second pulse comes; oracle: modes in closed form."""
    voltage = 20.0
    few, study = chip(6), kick(f"kick.drive.voltage={voltage}", "solver.stop=0.11 ms")
    deck = deck_of(study, few)
    once = " 10k)"  # the pulse's period
    assert deck.files[deck.main_file_name].count(once) == 1
    text = deck.files[deck.main_file_name].replace(once, " 50u)")
    waves = bench.run(replace(deck, text=text, options=()))
    edges = np.array([0.0, 0.1, 25.0, 25.1]) * 1e-6
    corners = np.r_[0.0, 10e-6 + edges, 60e-6 + edges, study.stop_time]
    volts = np.r_[0.0, np.tile([0.0, voltage, voltage, 0.0], 2), 0.0]
    weight = np.array([[0.0, -MASS * 9.81], [study.stop_time, -MASS * 9.81]])
    oracle = Kick(few.omega, few.damp, few.gain, RADII[1], 1e-3, MASS, 4e8,
                  np.stack([corners, volts], axis=1), weight)  # fmt: skip
    _, _, speeds, _ = oracle.flight(STEP, study.stop_time)
    return relative(waves["sphere.v"][-1], speeds[-1])
