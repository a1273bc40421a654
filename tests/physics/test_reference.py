"""The scipy oracle against closed forms, its own energy book and its own convergence."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from kc2spice import reference
from kc2spice.core.errors import SimulationError
from kc2spice.fem.magnetics.table import EMTable
from kc2spice.reference.flight import FreeModes
from kc2spice.reference.law import EXTRA, Mode, law
from kc2spice.report.metrics import separation
from kc2spice.rom.linear import Certificate, Port
from kc2spice.rom.modal import Resonators
from kc2spice.scene.load import load_scene
from kc2spice.scene.schema import Scene

CERTIFICATE = Certificate((0.0, 5e5), 0.0, "exact", True, True)
ANODE = Port("anode", "electrical", pins=("anode", "cathode"))


def chip(damping: float = 0.01, rings: int = 2, modes: int = 4) -> Resonators:
    """A bar of the chip's mass and stroke whose rings move a little differently."""
    n = np.arange(1, modes + 1)
    omega = 2 * np.pi * 270e3 * (2 * n - 1)
    spread = 1.0 + 0.05 * np.outer((-1.0) ** n, np.arange(rings))
    gain = np.column_stack((130.0 * spread, -1.2e-2 * omega[0] * 130 / (2 * n - 1) / 1e4))
    capacitance = np.zeros((rings + 1, rings + 1))
    capacitance[-1, -1] = 35e-9
    ports = tuple(Port(f"R{i}", "mechanical", "um", "N") for i in range(rings))
    damp = 2 * damping * omega**2 / omega[0]
    gain[:, -1] *= -1.0
    return Resonators(omega, damp, gain, capacitance, (*ports, ANODE), CERTIFICATE)


def stiff_chip() -> Resonators:
    """One ring whose modes are so stiff that the contact spring alone yields."""
    gain = np.array([[1.0, 0.0]])
    d = np.diag([0.0, 35e-9])
    omega, damp = np.array([2 * np.pi * 50e6]), np.array([1e5])
    ports = (Port("R0", "mechanical", "um", "N"), ANODE)
    return Resonators(omega, damp, gain, d, ports, CERTIFICATE)


def magnets() -> EMTable:
    """Linear magnets: a weak pull to 2.5 mm and 0.33 N/A per coil."""
    y = np.linspace(-2.5e-3, 7.5e-3, 11)
    one = np.ones_like(y)
    return EMTable(
        y=y, c0=0.3 * (2.5e-3 - y) * -0.2, c1=-0.33 * one, c2=0.33 * one, c11=0.02 * one,
        c12=0.01 * one, c22=0.02 * one, flux0=np.zeros((11, 2)), inductance=np.zeros((11, 2, 2)),
        resistance=np.array([1600.0, 1600.0]), unknowns=0,
    )  # fmt: skip


def loop_scene(*overrides: str) -> Scene:
    return load_scene("kick_and_catch", ["kick.drive.start=10 us", "control.enable_at=10 us",
                                         "solver.stop=1.2 ms", *overrides])  # fmt: skip


@pytest.fixture(scope="module")
def run() -> reference.Reference:
    return reference.kick_and_catch(chip(), loop_scene(), magnets(), rtol=1e-9)


def test_energy_book_of_the_loop_closes(run: reference.Reference) -> None:
    book = run.energy
    # 1.6e-5 J leave with the sphere; the book resolves a 1e-6 th of that.
    assert abs(book.residual) < 2e-11
    assert book.electrical_in > 1e-5
    assert book.damped > 1e-6
    assert book.em_work != 0.0


def test_loop_converges_in_itself(run: reference.Reference) -> None:
    finer = reference.kick_and_catch(chip(), loop_scene(), magnets(), rtol=1e-11)
    a, b = separation(run.waves), separation(finer.waves)
    assert a.velocity == pytest.approx(b.velocity, rel=1e-7)
    times = np.linspace(0.0, 1.2e-3, 400)
    y = [np.interp(times, r.waves["time"], r.waves["sphere.y"]) for r in (run, finer)]
    assert np.abs(y[0] - y[1]).max() < 1e-10
    assert [e.what for e in run.events] == [e.what for e in finer.events]


def test_start_is_an_equilibrium(run: reference.Reference) -> None:
    t, waves = run.waves["time"], run.waves
    still = t < 9.9e-6
    assert np.ptp(waves["sphere.y"][still]) < 1e-15
    weight = loop_scene().sphere.mass * 9.81
    pull = magnets().c0[0] + 0.06 * (waves["sphere.y"][0] + 2.5e-3)
    assert waves["contact.force"][0] == pytest.approx(weight - pull, rel=1e-6)


def test_pulse_and_current_follow_the_scene(run: reference.Reference) -> None:
    t, waves = run.waves["time"], run.waves
    volts = np.interp(t, [0, 10e-6, 10.1e-6, 35e-6, 35.1e-6, 1], [0, 0, 100, 100, 0, 0])
    assert np.abs(waves["kick.voltage"] - volts).max() < 1e-9
    assert np.all(waves["coil.upper.current"][t < 10e-6] == 0.0)
    assert np.abs(waves["coil.upper.current"]).max() == pytest.approx(0.1, rel=1e-12)
    ramp = np.interp(10.01e-6, t, waves["kick.current"])
    assert ramp == pytest.approx(35e-9 * 100 / 0.1e-6, rel=0.05)  # C0 dV/dt before the chip moves


def test_flight_without_coils_is_free_fall() -> None:
    scene = loop_scene("solver.stop=300 us")
    waves = reference.kick_and_catch(chip(), scene, None).waves
    leave = separation(waves)
    s = waves["time"] - leave.time
    free = s > 0.0
    at_leave = np.interp(leave.time, waves["time"], waves["sphere.y"])
    fall = at_leave + leave.velocity * s - 0.5 * 9.81 * s**2
    # The edge is extrapolated within a 10 ns sample: 1 m/s times its 1e-12 s accuracy.
    assert np.abs(waves["sphere.y"] - fall)[free].max() < 2e-11


@pytest.mark.parametrize("penalty", [1e6, 1e8])
def test_bounce_on_a_spring_is_elastic(penalty: float) -> None:
    scene = load_scene("impact", [f"contact.penalty={penalty}", "kick.electrical=short",
                                  "solver.stop=40 us"])  # fmt: skip
    result = reference.impact(stiff_chip(), scene, rtol=1e-10)
    w = np.sqrt(4 * penalty / scene.sphere.mass)
    leave = separation(result.waves)
    # The chip's own compliance is 1e-17 m/N: 4e-9 of the stiffest spring here.
    assert leave.velocity == pytest.approx(1.0, rel=1e-6)
    assert leave.time == pytest.approx(1e-6 + np.pi / w, rel=1e-6)
    assert result.waves["sphere.y"].min() - 1e-3 == pytest.approx(-1.0 / w, rel=1e-4)
    assert [e.what for e in result.events] == ["R0 closes", "R0 opens"]


@pytest.mark.parametrize("electrical", ["open", "short"])
def test_energy_book_of_the_impact_closes(electrical: str) -> None:
    scene = load_scene("impact", [f"kick.electrical={electrical}"])
    result = reference.impact(chip(), scene)
    book = result.energy
    assert abs(book.residual) < 1e-8 * 0.5 * scene.sphere.mass  # of the kinetic energy at 1 m/s
    assert book.electrical_in == 0.0
    if electrical == "open":
        rings = np.array([result.waves[f"kick.u.R{i}"] for i in range(2)])
        assert np.abs(result.waves["kick.voltage"]).max() > 1.0
        assert np.abs(rings).max() > 1e-7
    else:
        assert np.all(result.waves["kick.voltage"] == 0.0)


def test_free_modes_against_the_matrix_exponential() -> None:
    """Under-, critically and over-damped modes under a voltage ramp, with both energy integrals."""
    model = chip(damping=0.2)
    model = Resonators(
        model.omega, np.array([1e5, 2.0, 3.0, 0.0]) * model.omega * [1e-7, 1, 1, 0],
        model.gain, model.D, model.ports, CERTIFICATE,
    )  # fmt: skip
    equations = law(model, loop_scene(), None)
    rng = np.random.default_rng(1)
    x = np.concatenate((rng.normal(size=8) * 1e-6, np.zeros(EXTRA)))
    mode, span = Mode(start=1e-5, volt=3.0, slope=2e7), 2e-6
    free = FreeModes.of(equations, mode, mode.start, x)
    for k in range(4):
        w, d = model.omega[k], model.damp[k]
        push = equations.scale[k] ** 2 * equations.charge[k]
        a = np.array([[0, w, 0, 0], [-w, -d, push / w, 0], [0, 0, 0, 2e7], [0, 0, 0, 0]])
        exact = expm(a * span) @ [x[k], x[4 + k], 3.0, 1.0]
        got = free.at(np.array([mode.start + span]))[[k, 4 + k], 0]
        assert got == pytest.approx(exact[:2], rel=1e-7, abs=1e-15)
    s = np.linspace(0, span, 40_001)
    states = free.at(mode.start + s)
    rate = equations.omega[:, None] * states[4:]
    loss = (equations.damp / equations.scale**2) @ rate**2
    volt = 3.0 + 2e7 * s
    power = volt * (equations.c0 * 2e7 + equations.charge @ rate)
    end = mode.start + span
    # Trapezoidal rule with 50 ps steps, fastest rate 4e7 1/s: (2 r h)^2 / 12 = 1e-6.
    assert free.dissipated(end) == pytest.approx(np.trapezoid(loss, s), rel=3e-6)
    assert free.electrical_input(end) == pytest.approx(np.trapezoid(power, s), rel=3e-6)
    assert np.abs(equations.rings @ states[:4]).max() <= free.reach(end)


def test_imprint_on_a_stiff_chip_is_the_springs_alone() -> None:
    scene = load_scene("imprint", ["kick.electrical=short"])
    waves = reference.imprint(stiff_chip(), scene)
    assert waves["contact.force"] == pytest.approx(4e8 * waves["imprint.depth"], rel=1e-6)


def test_imprint_solves_the_complementarity_of_every_step() -> None:
    model = chip(rings=3)
    scene = load_scene("imprint", ["kick.electrical=open"])
    waves = reference.imprint(model, scene)
    force = np.array([waves[f"contact.force.R{i}"] for i in range(3)])
    flexible = reference.transfer(model, np.zeros(1), "open")[0, :3, :3].real
    gaps = 1e-3 - np.sqrt(1e-6 - (np.arange(3) * 50e-6) ** 2)
    overlap = waves["imprint.depth"] - gaps[:, None] - flexible @ force
    assert np.allclose(force, 4e8 * np.maximum(0.0, overlap), rtol=1e-6, atol=1e-9)
    assert np.all(np.diff(waves["contact.force"]) > 0.0)


def test_open_transfer_inverts_the_electrical_port() -> None:
    model = chip()
    f = np.array([0.0, 1e5, 2.7e5, 4.9e5])
    shorted, floating = (reference.transfer(model, f, e) for e in ("short", "open"))
    load = np.array([0.3, -0.2, 1e-9])  # forces and charge
    for h, g in zip(shorted, floating, strict=True):
        u0, u1, volt = g @ load
        assert h @ [0.3, -0.2, volt] == pytest.approx([u0, u1, 1e-9], rel=1e-9)
    assert floating[:, 0, 1] == pytest.approx(floating[:, 1, 0], rel=1e-12)


def test_sphere_that_leaves_the_table_is_an_error() -> None:
    scene = loop_scene("control.setpoint=6.5 mm", "control.kd=0 A s/m", "solver.stop=6 ms")
    with pytest.raises(SimulationError, match="force table"):
        reference.kick_and_catch(chip(), scene, magnets(), rtol=1e-6)


def test_sphere_that_nothing_presses_down_is_an_error() -> None:
    scene = loop_scene()
    lift = magnets()
    lift = EMTable(**{**lift.__dict__, "c0": np.full(11, 1.0)})
    with pytest.raises(SimulationError, match="rest"):
        reference.kick_and_catch(chip(), scene, lift)
