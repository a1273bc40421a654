"""Random legal settings of the paper's scene: ``python kick_settings.py 0 200``.

Voltage, width, edge, penalty, density, set point, gains and damping (0.01 to 10 %) are drawn. Each
run is solved, or reports that the sphere left the table of the catch. :func:`confirmed` holds a run
against a reference that shares no code with it: the full chip projected on many times the states by
plain block Krylov vectors, its modes in closed form, the sphere between its contacts by scipy, the
published table of forces. One line of JSON per draw, so that ranges can be resumed.
"""

import sys
import tempfile
from functools import cache
from pathlib import Path

import numpy as np
from scipy import sparse
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.linalg import eigh
from scipy.sparse.linalg import splu

import kc2spice as kc

sys.path.extend(map(str, Path(__file__).parents[1:3]))  # tests/spice and tests
from hard_cases.modal_kick import Kick
from support import SimulationError, StageTimer, UsageError, complete_run, load_scene
from test_random_parts import campaign, patience

COUNT, SEED = 200, 43
PATIENCE = 600  # s of this process' time, for a draw
SOLVED, LEFT = "solved", "the sphere left the table"
# Blocks of Krylov vectors, one vector for each of seven ports: 315 states. The launch of setting 87
# differs from that with 420 states by 3e-6, with 119 states by 6e-4.
BLOCKS = 45
# Time step [s] of the reference while the sphere touches the chip. The launches of settings 23, 30
# and 58 differ by at most 1e-5 from those of DOP853; steps of 1 ns changed them by 0.3, 3.4 and
# 2.3 %, as the contact opens and closes within nanoseconds.
STEP = 0.25e-9
LEAD, AFTER = 1e-6, 60e-6  # s before the kick, and after the pulse, that modes are followed
GRAVITY = 9.81  # m/s2


def between(rng, low, high):
    """Log-uniform, four digits."""
    return float(f"{np.exp(rng.uniform(np.log(low), np.log(high))):.4g}")


def settings(number):
    """Overrides of ``kick_and_catch``."""
    rng = np.random.default_rng((SEED, number))
    width = between(rng, 3e-6, 60e-6)
    return {
        "kick.drive.voltage": between(rng, 50, 150),
        "kick.drive.width": width,
        "kick.drive.edge": min(between(rng, 1e-8, 5e-6), width),
        "contact.penalty": between(rng, 1e7, 1e9),
        "sphere.density": between(rng, 3e3, 15e3),
        "control.setpoint": between(rng, 1.8e-3, 4e-3),
        "control.kp": between(rng, 2e4, 1e5),
        "control.ki": between(rng, 3, 30),
        "control.kd": between(rng, 10, 40),
        "kick.damping.ratio": between(rng, 1e-4, 0.1),
    }


def outcome(number, folder):
    """The word for a draw, its settings, and the run where it is solved."""
    chosen = settings(number)
    try:
        with patience(PATIENCE):
            done = complete_run(load_scene("kick_and_catch", chosen), folder, StageTimer())
    except (UsageError, SimulationError) as failed:
        left = "outside the force table" in failed.message
        return LEFT if left else f"refused: {failed.message} {failed.got or ''}", chosen, None
    except TimeoutError:
        return "timed out", chosen, None
    return SOLVED, chosen, done.run


# --- the reference -------------------------------------------------------------------------------


@cache
def modes():
    """Frequencies [rad/s] and gains (states, rings and anode) of the full chip without damping."""
    tables = {"name": "chip", "kick": {}, "contact": {"rings": "all"}, "sphere": {}}
    model = kc.build(kc.load_scene({**tables, "solver": {"stop": 1e-3}}))["kick"]
    K, n = model.K, model.K.shape[0]
    potentials = not sparse.issparse(K)
    whole = splu(sparse.csc_array(sparse.bmat([[K.uu, K.up], [K.pu, K.pp]]) if potentials else K))

    def solved(load):
        padded = np.zeros((whole.shape[0], load.shape[1]))
        padded[:n] = load
        return whole.solve(padded)[:n]

    block, V = solved(model.B), np.empty((n, 0))
    for _ in range(BLOCKS):
        for _ in range(2):
            block = block - V @ (V.T @ block)
        V = np.hstack([V, np.linalg.qr(block)[0]])
        block = solved(model.M @ V[:, -model.B.shape[1] :])
    squares, shapes = eigh(V.T @ (K @ V), V.T @ (model.M @ V))
    return np.sqrt(squares), (V @ shapes).T @ model.B


def force_law(scene):
    """Force [N] on the sphere at its centre's height [m] by the controller's current [A]."""
    catch = scene.parts["catch"]
    table = catch.type.build(catch, scene, StageTimer())
    parts = CubicSpline(table.y, table.coefficients)

    def force(y, i):
        c0, c1, c2, c11, c12, c22 = np.moveaxis(parts(y), -1, 0)
        return c0 + (c2 - c1) * i + (c11 - c12 + c22) * i**2

    return force, (float(table.y[0]), float(table.y[-1]))


def reference(scene):
    """Times [s], heights of the centre [m] and velocities [m/s] from the kick to the sphere's
    return, its leaving of the table or the end; when it last touched, and whether it left."""
    ball, pulse = scene.parts["sphere"].keys, scene.parts["kick"].keys.drive
    law, chip = scene.parts["control"].keys, scene.parts["kick"].keys
    (omega, gain), (force, ends) = modes(), force_law(scene)
    rest, begin = ball.radius, pulse.start - LEAD
    stop = LEAD + pulse.width + AFTER
    corners = LEAD + np.array([0.0, pulse.edge, pulse.width, pulse.width + pulse.edge])
    volts = np.stack([np.r_[0.0, corners, stop], pulse.voltage * np.array([0, 0, 1, 1, 0, 0])], 1)

    def current(y, v, integral):
        raw = law.kp * (law.setpoint - y) + integral - law.kd * v
        return np.clip(raw, -law.current_limit, law.current_limit), raw

    times = np.array([0.0, LEAD, LEAD * (1 + 1e-9), stop])
    heights, speeds = np.full(4, rest), np.zeros(4)
    for step in (4 * STEP, STEP):  # the current depends on the motion a little
        on = times > LEAD
        pushed = force(heights, np.where(on, current(heights, speeds, 0.0)[0], 0.0))
        other = np.stack([times, pushed - ball.mass * GRAVITY], axis=1)
        penalty = 4 * scene.parts["contact"].keys.penalty
        damp = chip.damping.beta * omega**2
        kick = Kick(
            omega, damp, gain, chip.mesh.ring_spacing, rest, ball.mass, penalty, volts, other
        )
        times, heights, speeds, touched = kick.flight(step, stop)
        heights = heights + rest

    def rate(_, x):
        i, raw = current(*x)
        inside = abs(raw) < law.current_limit
        return [x[1], force(x[0], i) / ball.mass - GRAVITY, law.ki * (law.setpoint - x[0]) * inside]

    events = [lambda _, x: x[0] - ends[1], lambda _, x: x[0] - rest]
    for event, way in zip(events, (1, -1), strict=True):
        event.terminal, event.direction = True, way
    last = int(np.searchsorted(times, touched)) + 1
    start = [heights[last], speeds[last], 0.0]
    span = begin + times[last], scene.stop_time
    done = solve_ivp(
        rate, span, start, "LSODA", max_step=5e-6, rtol=1e-9, atol=1e-12, events=events
    )
    t = np.r_[begin + times[: last + 1], done.t[1:]]
    y, v = np.r_[heights[: last + 1], done.y[0, 1:]], np.r_[speeds[: last + 1], done.y[1, 1:]]
    return t, y, v, begin + touched, bool(done.t_events[0].size)


def confirmed(word, chosen, run):
    """Errors of the launch (relative) and of the height (of its travel up to the return), or
    whether the reference leaves the table too where the run says so."""
    scene = load_scene("kick_and_catch", chosen)
    t, y, v, touched, left = reference(scene)
    if word == LEFT:
        return {"left": left}
    waves = run.waves
    at = max(touched, run.metrics["launch_time_s"]) + 1e-7
    launch = float(np.interp(at, waves["time"], waves["sphere.v"]) / np.interp(at, t, v) - 1)
    height = np.abs(np.interp(t, waves["time"], waves["sphere.y"]) - y).max() / np.ptp(y)
    return {"launch": launch, "height": float(height), "until_s": float(t[-1]), "left": left}


def describe_outcome(number):
    """The word for a draw, and its line."""
    with tempfile.TemporaryDirectory() as folder:
        word, chosen, run = outcome(number, Path(folder))
    line = {"word": word, "settings": chosen}
    if word in (SOLVED, LEFT):
        line["reference"] = confirmed(word, chosen, run)
    if run is not None:
        metrics = run.metrics
        line |= {"launch_m_s": metrics["launch_velocity_m_s"], "caught": metrics["caught"]}
        checks = {c.name: float(f"{c.value:.2g}") for c in run.verdict.checks if not c.passed}
        line["warned"] = checks
    return word, line


if __name__ == "__main__":
    campaign(describe_outcome)
