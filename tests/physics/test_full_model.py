"""Full-model references: harmonic, imprint, impact and kick, each against an independent oracle."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.sparse import block_array
from scipy.sparse.linalg import splu

from kc2spice.bodies.piezo_stack import from_sector
from kc2spice.core.errors import SimulationError
from kc2spice.core.progress import Clock
from kc2spice.core.waveforms import Waveforms
from kc2spice.fem.piezo import statics
from kc2spice.fem.piezo import transient as steps_
from kc2spice.fem.piezo.assembly import assemble_kick
from kc2spice.fem.piezo.contact import contact_forces, contact_surface, sphere_gap
from kc2spice.fem.piezo.keys import Chip
from kc2spice.fem.piezo.statics import imprint, imprint_refactorised
from kc2spice.fem.piezo.transient import Ball, transient
from kc2spice.parts import _chip_full
from kc2spice.parts._chip_full import converged, players
from kc2spice.parts.piezo_stack import Drive
from kc2spice.parts.sphere import SphereKeys
from kc2spice.rom.modal import resonators
from kc2spice.rom.reduce import reduce
from kc2spice.rom.surrogate import surrogate
from kc2spice.scene.load import load_scene
from kc2spice.scene.parttype import Build

SMALL = {"sectors": 4, "rings": 2, "ring_spacing": 300e-6, "outer_rings": 2}
MASS = SphereKeys().mass / 4
PULSE = Drive(start=0.0).waveform


@cache
def small(per_node: bool = False, **change):
    kick = Chip(layers=3, mesh={**SMALL, **change})
    return assemble_kick(kick), contact_surface(kick, 1e8, 1e-3, per_node=per_node)


@pytest.fixture(scope="module")
def default():
    kick = Chip()
    return assemble_kick(kick), contact_surface(kick, 1e8, 1e-3)


def energy_error(result) -> float:
    """Largest imbalance of the energy budget relative to what came in."""
    e = result.energy
    total = e["sphere"] + e["chip"] + e["contact"] + e["damped"] - e["supplied"]
    came_in = np.abs(e["supplied"]).max() + np.ptp(e["sphere"])
    return np.abs(total - total[0]).max() / came_in


def test_gap_of_a_sphere_is_exact():
    r = np.array([0.0, 1e-9, 50e-6, 250e-6, 1e-3])
    np.testing.assert_allclose(
        sphere_gap(1e-3, r)[2:], 1e-3 - np.sqrt(1e-6 - r[2:] ** 2), rtol=1e-9
    )
    assert sphere_gap(1e-3, r)[1] == pytest.approx(5e-16, rel=1e-12)  # no cancellation


def test_contact_forces_satisfy_the_law_for_random_compliances():
    rng = np.random.default_rng(3)
    for _ in range(100):
        root = rng.normal(size=(6, 4))
        G, p, k = root @ root.T * 1e-8, rng.normal(size=6) * 1e-6, 10 ** rng.uniform(6, 11, 6)
        force, _ = contact_forces(G, p, k)
        np.testing.assert_allclose(force, k * np.maximum(p - G @ force, 0), atol=1e-9 * force.max())


@pytest.mark.parametrize("change", [{}, {"order": 2}])
def test_harmonic_is_the_response_of_the_coupled_equations(change):
    """Oracle: damping written as a second potential, driven by velocities (see the reduction)."""
    system, _ = small(**change)
    s, volt = 2j * np.pi * 2.3e5, 1e9
    n, m, damped = system.M.shape[0], system.K_pp.shape[0], 1 + 2j * np.pi * 2.3e5 * system.beta
    K_up, K_pp = system.K_up * volt, system.K_pp * volt**2
    dynamic = s**2 * system.M + damped * system.K_uu
    rhs = np.zeros((n + 2 * m, len(system.ports)), dtype=complex)
    rhs[:n] = np.column_stack([system.B, -system.k_uV])
    rhs[n : n + m, -1] = system.k_pV * volt
    matrix = dynamic
    if m:
        matrix = block_array(
            [[dynamic, K_up, damped * K_up], [None, -K_pp, None], [K_up.T, None, -K_pp]]
        )
    x = splu(matrix.tocsc()).solve(rhs)
    p = volt * (x[n : n + m] + x[n + m :])
    charge = system.k_pV @ p - system.k_uV @ x[:n]
    charge[-1] += system.c_VV
    expected = np.vstack([system.B.T @ x[:n], charge])
    root = np.r_[np.full(len(system.ports) - 1, 0.5), 2.0]  # four sectors make the device
    found = from_sector(system).transfer([2.3e5])[0]
    np.testing.assert_allclose(found, expected * np.outer(root, root), rtol=1e-9)


def test_surrogate_is_checked_against_direct_solutions():
    system, _ = small(order=2)
    full = from_sector(system)
    small_one = surrogate(full, (0.0, 500e3))
    model = small_one.model
    assert small_one.error < 1e-10
    frequency = np.array([1.23e5, 4.56e5])
    np.testing.assert_allclose(model.transfer(frequency), full.transfer(frequency), rtol=1e-9)
    with pytest.raises(SimulationError, match="cannot replace"):
        surrogate(from_sector(system), (0.0, 500e3), blocks=6)  # 4e-8


@pytest.mark.parametrize(
    ("change", "has"),
    [((), True), (("contact.gap=1 um",), False), (("contact.damping=1 s/m",), False),
     (("contact.shape=pressure", "sphere.elastic.damping.ratio=0.001"), False)],
)  # fmt: skip
def test_the_full_solution_is_of_a_plain_contact(change, has):
    """Its springs have no gap of their own, no damping and no elastic sphere."""
    scene = load_scene("impact", list(change))
    assert (players(scene.parts["kick"], scene) is not None) is has


def test_a_launch_may_miss_the_full_model_by_what_is_certified():
    """By two fifths of the certified error beyond the steps' share; by 1e-3 without one."""
    scene = load_scene({"name": "launch", "kick": {}, "contact": {}, "sphere": {}})
    contact = scene.parts["contact"]
    certified = SimpleNamespace(certificate=SimpleNamespace(error_estimate=2e-2))
    for models, more in (({}, 1e-3), ({"kick": certified}, 8e-3)):
        (gate,) = contact.type.gates(contact, Build(scene, models))
        assert gate.limits["rom_vs_fom"] - gate.limits["ngspice_vs_rom"] == pytest.approx(more)


@pytest.mark.parametrize("electrical", ["open", "short"])
@pytest.mark.parametrize("change", [{}, {"order": 2}])
def test_both_roads_of_the_imprint_agree(electrical, change):
    system, surface = small(**change)
    depth = np.array([0.0, 1e-6, 5e-6, 100e-6])
    fast = imprint(system, surface, depth, electrical)
    slow = imprint_refactorised(system, surface, depth, electrical)
    np.testing.assert_allclose(fast.ring_force, slow.ring_force, rtol=1e-10, atol=1e-12)


def test_open_anode_stiffens_the_chip(default):
    system, surface = default
    depth = np.linspace(0, 50e-6, 251)
    force = {e: imprint(system, surface, depth, e).force for e in ("open", "short")}
    assert np.all(force["open"][1:] > force["short"][1:])


def test_imprint_force_and_rings_rise_monotonically(default):
    system, surface = default
    result = imprint(system, surface, np.linspace(0, 50e-6, 251))
    assert result.force[0] == 0
    assert np.all(np.diff(result.force) > 0)
    assert np.all(np.diff((result.ring_force > 0).sum(axis=1)) >= 0)


def test_grouping_the_nodes_of_a_ring_changes_little(default):
    system, surface = default
    single = contact_surface(Chip(), 1e8, 1e-3, per_node=True)
    depth = np.linspace(2e-7, 50e-6, 50)
    grouped, nodal = (imprint(system, s, depth).force for s in (surface, single))
    assert np.abs(nodal / grouped - 1).max() < 1e-4  # measured 2e-7


def test_reduced_imprint_equals_the_full_one(default):
    """Static port answers are in the basis; force laws see nothing else."""
    system, surface = default
    depth = np.linspace(0, 50e-6, 51)
    rom = resonators(reduce(from_sector(system), order=30, band=(0.0, 500e3)))
    root = np.r_[np.full(6, 2.0), 0.5]  # back to one of four sectors
    G = rom.transfer(np.zeros(1))[0].real * np.outer(root, root)
    open_anode = G[:6, :6] - np.outer(G[:6, 6], G[6, :6]) / G[6, 6]
    reduced = np.array(
        [contact_forces(open_anode, d - surface.gap, surface.penalty)[0].sum() for d in depth]
    )
    np.testing.assert_allclose(reduced, imprint(system, surface, depth).force, rtol=1e-9)


def test_imprint_of_an_isotropic_chip_follows_hertz():
    """F = 4/3 E/(1-nu^2) sqrt(R) d^1.5 on a half space; finite chip, rings 1/8 of the contact."""
    young, nu = 70e9, 0.3
    lame, shear = young * nu / (1 + nu) / (1 - 2 * nu), young / 2 / (1 + nu)
    stiffness = (lame + 2 * shear, lame, lame, lame + 2 * shear, shear, shear)
    kick = Chip(
        side=3e-3, layers=40,
        material={"stiffness": stiffness, "coupling": (0, 0, 0)},
        mesh={"rings": 10, "ring_spacing": 25e-6, "outer_rings": 11},
    )  # fmt: skip
    surface = contact_surface(kick, 1e13, 1e-3)
    depth = np.array([40e-6])
    force = 4 * imprint(assemble_kick(kick), surface, depth, "short").force
    hertz = 4 / 3 * young / (1 - nu**2) * np.sqrt(1e-3) * depth**1.5
    np.testing.assert_allclose(force, hertz, rtol=0.08)  # measured 6 %


@pytest.mark.parametrize("voltage", [None, lambda t: 0.0])
@pytest.mark.parametrize(("per_node", "alpha"), [(False, 0.0), (True, 0.0), (False, 5e6)])
def test_both_roads_of_the_impact_agree(voltage, per_node, alpha):
    system, surface = small(per_node)
    system = replace(system, alpha=alpha)
    ball = Ball(MASS, 1e-7, -1.0, 9.81)
    fast, slow = (
        transient(system, surface, ball, step=50e-9, stop=4e-6, voltage=voltage, road=road)
        for road in ("low_rank", "refactorise")
    )
    assert fast.force.max() > 0.1
    assert slow.factorisations > 80 > fast.factorisations == 1
    np.testing.assert_allclose(fast.ring_force, slow.ring_force, atol=1e-9 * fast.force.max())
    # Springs that just open magnify rounding; measured 3e-10.
    np.testing.assert_allclose(fast.height, slow.height, rtol=1e-8, atol=1e-16)


def test_free_flight_is_a_parabola():
    system, surface = small()
    result = transient(
        system, surface, Ball(MASS, 1e-3, -0.5, 9.81), step=1e-6, stop=1e-4, voltage=None
    )
    t = result.time
    np.testing.assert_allclose(result.height, 1e-3 - 0.5 * t - 9.81 / 2 * t**2, rtol=1e-12)
    assert not result.force.any()


def test_step_error_of_the_impact_falls_quadratically():
    system, surface = small()
    ball = Ball(MASS, 1e-7, -1.0)

    def history(step: float) -> np.ndarray:
        result = transient(system, surface, ball, step=step, stop=3e-6, voltage=None)
        return np.interp(np.linspace(0, 3e-6, 151), result.time, result.height)

    exact = history(1e-9)
    error = [np.linalg.norm(history(h) - exact) for h in (20e-9, 10e-9, 5e-9)]
    assert error[1] < 0.3 * error[0]
    assert error[2] < 0.3 * error[1]


def test_the_limit_of_two_steps_has_no_error_of_second_order():
    """Waves that are off by h^2, but for loads, which are those of the finer steps."""
    t = np.linspace(0.0, 1.0, 9)
    fine = {"time": t, "sphere.y": t**3 + 1e-3, "contact.force": t + 1e-3}
    coarse = {"time": t[::2], "sphere.y": t[::2] ** 3 + 4e-3, "contact.force": t[::2] + 4e-3}
    found = converged(Waveforms(coarse, {}), Waveforms(fine, {}), "contact.force")
    np.testing.assert_array_equal(found["time"], t[::2])
    np.testing.assert_allclose(found["sphere.y"], t[::2] ** 3, atol=1e-15)
    np.testing.assert_array_equal(found["contact.force"], fine["contact.force"][::2])


def test_impact_energy_balances_and_the_sphere_keeps_98_percent(default):
    system, surface = default
    result = transient(
        system, surface, Ball(MASS, 1e-6, -1.0), step=50e-9, stop=12e-6, voltage=None
    )
    assert energy_error(result) < 2e-4  # the steps in which springs open or close
    assert result.height.min() == pytest.approx(-3.112e-6, rel=1e-3)
    assert result.velocity[-1] == pytest.approx(0.990, abs=1e-3)
    impulse = np.sum((result.force[1:] + result.force[:-1]) / 2) * 50e-9
    assert MASS * (result.velocity[-1] + 1) == pytest.approx(impulse, rel=1e-9)


def test_kick_starts_at_rest_and_launches_at_one_metre_per_second(default):
    system, surface = default
    result = transient(
        system, surface, Ball(MASS, 0.0, 0.0, 9.81), step=50e-9, stop=8e-6,
        voltage=lambda t: float(PULSE(t)), resting=True,
    )  # fmt: skip
    assert result.force[0] == pytest.approx(MASS * 9.81, rel=1e-9)
    assert -1e-9 < result.height[0] < 0
    assert result.velocity[-1] == pytest.approx(1.0202, rel=1e-3)
    assert energy_error(result) < 2e-4


def test_a_resting_sphere_stays():
    system, surface = small(order=2)
    result = transient(
        system, surface, Ball(MASS, 0.0, 0.0, 9.81), step=1e-7, stop=2e-6, voltage=None,
        resting=True,
    )  # fmt: skip
    np.testing.assert_allclose(result.force, MASS * 9.81, rtol=1e-6)


@pytest.fixture(scope="module")
def mass_damped():
    """A small chip whose damping is mostly alpha M, and its matrices."""
    kick = Chip(layers=3, mesh=SMALL, damping={"alpha": 3e5, "ratio": 1e-3})
    system = assemble_kick(kick)
    assert system.K_pp.shape[0] == 0  # one element a layer: nothing to eliminate
    M, K = system.M.toarray(), system.K_uu.toarray()
    return kick, system, (M, 3e5 * M + 1e-3 / (np.pi * 250e3) * K, K, -system.k_uV)


def test_mass_damping_reaches_the_response_and_its_reduction(mass_damped):
    _, system, (M, E, K, b) = mass_damped
    model = from_sector(system)
    frequency = np.array([50e3, 230e3, 270e3, 400e3])
    s = 2j * np.pi * frequency
    R0 = system.B[:, 0]
    direct = np.array([R0 @ np.linalg.solve(x * x * M + x * E + K, b) for x in s])
    rom = reduce(model, tolerance=1e-6, band=(0.0, 500e3))
    for found in (model, rom):
        row, column = found.outputs.index("ring0"), found.inputs.index("anode")
        H = found.transfer(frequency)[:, row, column]
        np.testing.assert_allclose(H, direct, rtol=2e-6)


def test_mass_damping_reaches_a_projection(mass_damped):
    _, system, (_, E, _, _) = mass_damped
    V = np.linalg.qr(np.random.default_rng(1).standard_normal((len(E), 5)))[0]
    found = from_sector(system).pencil.project(V).coefficients[1]
    exact = 4 * V.T @ E @ V
    np.testing.assert_allclose(found, exact, rtol=1e-12, atol=1e-12 * np.abs(exact).max())


def test_energy_of_steps_with_mass_damping_balances_to_rounding(mass_damped):
    """Average acceleration keeps the discrete balance exactly, if its matrix has all of E."""
    kick, system, _ = mass_damped
    result = transient(
        system, contact_surface(kick, 1e8, 1e-3), Ball(MASS, 1e-3, 0.0), step=50e-9, stop=4e-6,
        voltage=lambda t: 100.0 * (t > 0),
    )  # fmt: skip
    assert result.energy["damped"][-1] > 0.1 * np.ptp(result.energy["supplied"])
    assert energy_error(result) < 1e-10


def test_mass_damping_reaches_the_steps(mass_damped):
    """A voltage step against the matrix exponential of the same matrices."""
    kick, system, (M, E, K, b) = mass_damped
    surface = contact_surface(kick, 1e8, 1e-3)
    stop, n = 6e-6, len(M)
    rest = np.linalg.solve(K, b)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(M, np.hstack([K, E]))]])
    x = expm(stop * A) @ np.r_[-rest, np.zeros(n)]
    exact = surface.shapes.T @ (100.0 * (rest + x[:n]))
    result = transient(
        system, surface, Ball(MASS, 1e-3, 0.0), step=5e-9, stop=stop,
        voltage=lambda t: 100.0 * (t > 0),
    )  # fmt: skip
    # Half a step of the jump, and the mean acceleration rule, cost 2e-3 at this step.
    np.testing.assert_allclose(result.spring_displacement[-1], exact, rtol=5e-3)


# --- a scene's own full solution, on a chip of three layers ---------------------------------------

COARSE = ["kick.layers=3"] + [
    f"kick.mesh.{key}" for key in ("sectors=4", "rings=2", "ring_spacing=50 um", "outer_rings=3")
]
LAUNCH = {"name": "launch", "kick": {}, "contact": {}, "sphere": {}}


def full(scene, *keys, whole=False, said=None):
    """Its full solution; ``said`` receives what the stages are called."""
    loaded = load_scene(scene, [*COARSE, *keys])
    clock = Clock(lambda stage, done, text: None if said is None else said.add((done, text)))
    kick = loaded.parts["kick"]
    return kick.type.full_solution(kick, Build(loaded, {}), clock, whole)


def obeys(waves, rings, radius=1e-3, penalty=4e8):
    """Loads are the penalty's: four sectors of 1e8 N/m on ``u - (y - R) - gap``, if positive; on
    the mean, for the limit of two steps is no state where a spring has just closed."""
    low = waves["sphere.y"] - radius
    for k in range(rings):
        gap = radius - np.sqrt(radius**2 - (50e-6 * k) ** 2)
        law = penalty * np.maximum(waves[f"kick.u.ring{k}"] - low - gap, 0.0)
        force = waves[f"contact.force.ring{k}"]
        assert np.abs(force - law).mean() < 0.02 * max(force.max(), 0.1)
    total = sum(waves[f"contact.force.ring{k}"] for k in range(rings))
    np.testing.assert_allclose(waves["contact.force"], total, rtol=1e-12)


def gained(waves, gravity):
    """Impulse less weight over the sphere's gain of momentum [N s], at every time."""
    t, force = waves["time"], waves["contact.force"]
    impulse = np.r_[0.0, np.cumsum((force[1:] + force[:-1]) / 2 * np.diff(t))]
    mass = 4 / 3 * np.pi * 1e-9 * 7850
    return impulse - mass * gravity * t, mass * (waves["sphere.v"] - waves["sphere.v"][0])


def test_the_full_impact_keeps_momentum_and_the_springs_law():
    found, waves = {}, {}
    for electrical in ("open", "short"):
        said = set()
        found[electrical] = full(
            "impact", f"kick.electrical={electrical}", "impact.gap=0.2 um", "gravity=2e4",
            "solver.stop=3 us", said=said,
        )  # fmt: skip
        waves[electrical] = w = found[electrical].waves
        assert np.diff(w["time"]) == pytest.approx(20e-9)
        assert (w["time"][-1], w["sphere.v"][0]) == pytest.approx((3e-6, -1.0))
        assert w["sphere.y"][0] == pytest.approx(1e-3 + 0.2e-6, rel=1e-12)
        first = np.flatnonzero(w["contact.force"])[0]  # it falls from its gap, faster and faster
        assert w["time"][first] == pytest.approx(0.2e-6, abs=21e-9)
        impulse, momentum = gained(w, 2e4)
        np.testing.assert_allclose(momentum, impulse, atol=0.015 * np.ptp(impulse))
        assert w["contact.force.ring1"].max() > 1.0
        obeys(w, 3)
        texts = {text for _, text in said}
        assert {"6 refactorising steps", "steps of 50 ns", "steps of 20 ns"} < texts
        assert (1.0, "steps of 10 ns") in said
    # An open anode is stiffer: its charge stays where it is.
    assert waves["open"]["sphere.y"].min() > waves["short"]["sphere.y"].min() + 5e-9
    assert found["open"].notes == ("refactorising code timed over 6 of 60 steps in contact",)
    assert found["open"].baselines["refactor"] == found["open"].metrics["full_wall_s"]


def test_refactorising_steps_are_timed_in_contact_and_for_the_whole_impact(monkeypatch):
    asked = []

    def timed(system, surface, ball, **how):
        if how.get("road") == "refactorise":
            asked.append((ball.height, ball.velocity, how["step"], how["stop"]))
        lasted = {"refactorise": 3.0}.get(how.get("road"), how["step"] / 1e-8)
        return replace(transient(system, surface, ball, **how), wall_s=lasted)

    monkeypatch.setattr(steps_, "transient", timed)
    short = ["impact.gap=0.2 um", "solver.stop=0.54 us"]  # 10.8 steps
    some = full("impact", *short)
    assert asked[0] == pytest.approx((0.0, -1.0, 50e-9, 300e-9))
    assert some.baselines == {"refactor": pytest.approx(3.0 * 11 / 6), "low_rank": 5.0}
    assert some.wall_s == 1.0  # of the finer steps
    every = full("impact", *short, whole=True)
    assert asked[1] == pytest.approx((0.0, -1.0, 50e-9, 550e-9))
    assert every.baselines["refactor"] == pytest.approx(3.0)
    assert "11 of 11 steps" in every.notes[0]


def test_the_full_model_follows_a_lone_sphere_for_a_while_only(monkeypatch):
    short = ["impact.gap=0", "solver.stop=0.2 us"]
    monkeypatch.setattr(_chip_full, "LONGEST", 0.2e-6)
    assert full("impact", *short) is not None
    monkeypatch.undo()
    assert full("impact", "solver.stop=50.1 us") is None
    # something else on the sphere, or on the anode
    held = {"name": "held", "kick": {"electrical": "open"}, "contact": {},
            "sphere": {"velocity": -1.0}, "solver": {"stop": 2e-7, "max_step": 1e-8}}  # fmt: skip
    assert full(held) is not None
    aside = {"part": "resistor", "resistance": 1e3, "pins": {"a": "cell.out"}}
    assert full(held | {"aside": aside, "cell": {"part": "source", "dc": 1.0}}) is not None
    spring = {"part": "spring", "stiffness": 1e3, "pins": {"a": "kick.ring0"}}
    assert full(held | {"hold": spring}) is None
    load = {"part": "resistor", "resistance": 1e3, "pins": {"a": "kick.anode"}}
    assert full(held | {"load": load}) is None
    charge = {"part": "source", "kind": "current", "dc": 0.0, "pins": {"out": "kick.anode"}}
    assert full(held | {"charge": charge}) is None
    # a sphere at rest on a chip that nothing drives, and what is no motion in time
    assert full(LAUNCH | {"kick": {"electrical": "open"}}) is None
    assert full(LAUNCH | {"kick": {"drive": {}}, "analysis": {"type": "op"}}) is None


def test_the_full_kick_is_the_launch_of_its_scene_alone():
    """The pulse comes at once; the free stack overshoots its static stroke by as much again."""
    said = set()
    found = full("kick_and_catch", "kick.drive.voltage=60", said=said)
    scene, w = found.build.scene, found.waves
    assert set(scene.parts) == {"kick", "contact", "sphere", "kick_drive"}
    assert (scene.name, scene.stop, scene.gates.trajectory) == ("kick_and_catch_kick", 12e-6, None)
    wave = scene.parts["kick_drive"].keys.waveform(scene.home)
    np.testing.assert_allclose(wave(np.array([0.0, 0.1e-6, 5e-6])), [0.0, 60.0, 60.0], atol=1e-9)
    assert w["time"][-1] == pytest.approx(12e-6)
    weight = 4 / 3 * np.pi * 1e-9 * 7850 * 9.81
    assert w["contact.force"][0] == pytest.approx(weight, rel=1e-9)  # at rest, then thrown
    impulse, momentum = gained(w, 9.81)
    np.testing.assert_allclose(momentum, impulse, atol=3e-3 * np.ptp(impulse))
    obeys(w, 3)
    assert w["sphere.v"][-1] > 0.03
    C, e, _ = Chip().material.tensors()
    stroke = 3 * 60.0 * abs(np.linalg.solve(C, e[2])[2])
    assert 1.7 < np.ptp(w["kick.u.ring1"]) / stroke < 2.1
    assert {text for _, text in said} >= {"steps of 20 ns", "steps of 10 ns"}
    assert found.piece == " of the kick alone"


def test_the_kick_alone_keeps_its_own_keys(monkeypatch):
    """Its probes, length and trajectory's gate belong to the whole flight."""
    monkeypatch.setattr(_chip_full, "KICK", 1e-7)
    given = LAUNCH | {
        "contact": {"rings": "all"}, "probes": {"height": {"of": "sphere.y"}},
        "gates": {"trajectory": "1 um"}, "solver": {"stop": 2e-3, "reltol": 3e-4},
    }  # fmt: skip
    scene = full(given).build.scene
    assert (scene.solver.reltol, scene.gates.trajectory, scene.probes) == (3e-4, None, {})
    assert scene.parts["contact"].keys.rings == 3  # those of the whole flight


def test_the_full_imprint_begins_with_the_compliance_under_the_centre():
    """While ring0 alone carries, force is depth over spring's and chip's compliance in series."""
    keys = ["imprint.depth=1 um", "imprint.steps=4"]
    chip = Chip(layers=3, mesh={"sectors": 4, "rings": 2, "ring_spacing": 50e-6, "outer_rings": 3})
    H = from_sector(assemble_kick(chip)).transfer(np.zeros(1))[0].real
    short = H[0, 0]
    give = {"short": short, "open": short - H[0, -1] * H[-1, 0] / H[-1, -1]}
    for electrical, compliance in give.items():
        found = full("imprint", f"kick.electrical={electrical}", *keys)
        w = found.waves
        np.testing.assert_allclose(w["imprint.depth"], [0.0, 0.25e-6, 0.5e-6, 0.75e-6, 1e-6])
        exact = w["imprint.depth"] / (compliance + 1 / 4e8)
        np.testing.assert_allclose(w["contact.force"], exact, rtol=1e-8)
        np.testing.assert_allclose(w["contact.force.ring0"], exact, rtol=1e-8)
        (falls,) = found.checks
        assert (falls.value, falls.limit) == (0.0, 0.0)
        assert found.metrics["grouping_error"] == 0.0  # the centre is one node
        assert found.notes[0] == "time of the refactorising code from 2 of 5 depths"
    deep = full("imprint", "imprint.depth=20 um", "imprint.steps=2", whole=True)
    assert 1e-6 < deep.metrics["grouping_error"] < 1e-3
    assert deep.notes[0].endswith("3 of 3 depths")


def test_a_warm_start_saves_the_refactorising_imprint_its_iterations(monkeypatch):
    """Each depth costs one factorisation more, the first as many as it iterates."""
    told = SimpleNamespace(wall_s=3.0, iterations=np.array([4, 2]))
    monkeypatch.setattr(statics, "imprint_refactorised", lambda *_: told)
    some = full("imprint", "imprint.steps=10")
    assert some.baselines["refactor"] == pytest.approx((11 + 4) * 0.5)
    assert some.metrics["full_step_wall_s"] == pytest.approx((11 + 4) * 0.5 / 11)
    assert full("imprint", "imprint.steps=10", whole=True).baselines["refactor"] == 3.0


def test_under_a_pressure_every_hat_is_a_spring_of_the_full_model():
    """No rings in the waves; Hertz's force within the few hats and the thin chip."""
    pressed = ["contact.shape=pressure", "contact.spacing=20 um"]
    found = full("imprint", "imprint.depth=8 um", "imprint.steps=4", *pressed)
    assert set(found.waves.data) == {"imprint.depth", "contact.force"}
    assert "grouping_error" not in found.metrics
    modulus = load_scene("imprint", COARSE).parts["kick"]
    E = modulus.type.indentation_modulus(modulus)
    hertz = 4 / 3 * E * np.sqrt(1e-3) * found.waves["imprint.depth"] ** 1.5
    assert 0.9 < found.waves["contact.force"][-1] / hertz[-1] < 1.3
    thrown = full("impact", "impact.gap=0", "solver.stop=0.5 us", *pressed)
    assert not [name for name in thrown.waves.data if "ring" in name]
    impulse, momentum = gained(thrown.waves, 0.0)
    np.testing.assert_allclose(momentum, impulse, atol=0.02 * np.ptp(impulse))
