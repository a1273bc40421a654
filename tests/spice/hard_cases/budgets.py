"""Random devices under error budgets: ``python tests/spice/hard_cases/budgets.py FIRST LAST``.

Six families in turn. Each is run as ``kc2spice run`` runs it and judged by what shares no code with
it: a chip's kick by an own integrator on all modes of the full matrices, a buzzer's current by a
sparse solution on a finer mesh, a bimorph's step by 60 modes of that, and oscillators, rectifiers
and voice coils by the plain equations of ``test_random_parts.py``. The budget holds, or the run
says that it does not. One line of JSON for every draw, so that ranges can be resumed.
"""

import contextlib
import random
import sys
import tempfile
import tomllib
import warnings
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy import signal, sparse
from scipy.linalg import eigh
from scipy.sparse.linalg import LinearOperator, eigsh, splu

import kc2spice as kc

sys.path.extend(map(str, Path(__file__).parents[1:3]))  # tests/spice and tests
from drawn_devices import voice
from hard_cases.modal_kick import Kick
from support import SimulationError, StageTimer, UsageError, complete_run, load_scene
from test_random_parts import Drawn, campaign, motion, patience, rectifier

COUNT = 50
PATIENCE = 120  # s of this process' time, for a draw
FINER = {"disc": 3, "beam": 2}  # cells of the oracle along the edge of one of the scene
STEP_END = 2e-3  # s
MODES = 20  # of a bimorph; what others add at rest is added
START, FLIGHT = 5e-6, 35e-6  # s: the kick, and what follows it
LATEST = 20e-6  # s after its start a kick has thrown
POINTS = 20_001  # of plain equations
OWN = 1e-5  # of the oracles' errors
STEP = 0.5e-9  # s of the oracle's steps


@dataclass(frozen=True)
class Budgeted:
    """One draw: the true ``error`` of the metric, what the run ``stated`` of it, and what of the
    worst of all metrics."""

    family: str
    outcome: str
    budget: float
    error: float
    stated: float
    worst: str
    runs: int
    scene: Mapping[str, Any]


def between(rng, low, high):
    """Log-uniform, four digits."""
    return float(f"{np.exp(rng.uniform(np.log(low), np.log(high))):.4g}")


# --- a kick --------------------------------------------------------------------------------------


def kick(rng):
    """A small chip, damped by 1 % or 0.3 %, under a sphere and a pulse."""
    width, damping = between(rng, 2e-6, 2e-5), float(rng.choice([1e-2, 3e-3]))
    edge = min(between(rng, 1e-8, 2e-6), width)
    drive = {"voltage": between(rng, 40, 120), "width": width, "edge": edge, "start": START}
    return {
        "gravity": 9.81, "error_budget": between(rng, 2e-4, 1e-2),
        "kick": {
            "layers": 3, "height": 1e-3, "side": between(rng, 1.5e-3, 3e-3), "drive": drive,
            "damping": {"ratio": damping}, "mesh": {"sectors": 6, "outer_rings": 6, "rings": 3},
        },
        "contact": {"penalty": between(rng, 1e7, 3e8), "rings": "all"},
        "sphere": {"radius": between(rng, 0.5e-3, 1.5e-3), "density": between(rng, 3e3, 15e3)},
        "solver": {"stop": START + min(width, LATEST) + FLIGHT},
    }  # fmt: skip


def kick_error(done):
    """Relative error of the launch velocity."""
    waves, scene = done.run.waves, done.run.build.scene
    time, ball, chip = waves["time"], scene.parts["sphere"].keys, scene.parts["kick"].keys
    tables = {k: v for k, v in scene.tables.items() if k not in ("error_budget", "rom")}
    model = kc.build(load_scene(tables))["kick"]
    whole = np.eye(model.order)
    squares, modes = eigh(model.K @ whole, model.M @ whole)
    pulse = chip.drive
    corners = np.array([0.0, pulse.edge, pulse.width, pulse.width + pulse.edge]) + pulse.start
    volts = pulse.voltage * np.array([0.0, 1.0, 1.0, 0.0])
    weight = np.array([[0.0, -ball.mass * 9.81], [time[-1], -ball.mass * 9.81]])
    oracle = Kick(
        np.sqrt(squares), chip.damping.beta * squares, modes.T @ model.B, chip.mesh.ring_spacing,
        ball.radius, ball.mass, 4 * scene.parts["contact"].keys.penalty,
        np.stack([corners, volts], axis=1), weight,
    )  # fmt: skip
    times, _, speeds, touched = oracle.flight(STEP, float(time[-1]))
    at = max(touched, float(done.run.metrics["launch_time_s"]))
    exact = float(np.interp(at, times, speeds))
    return float(abs(np.interp(at, time, waves["sphere.v"]) / exact - 1))


# --- full models of bodies -----------------------------------------------------------------------


def _full(done, part):
    """The full model of a body of the drawn scene on a finer mesh."""
    tables = {k: v for k, v in done.run.build.scene.tables.items() if k != "error_budget"}
    drawn = load_scene({**tables, part: {**tables[part], "mesh": {"refine": FINER[part]}}})
    return kc.build(drawn)[part]


def _whole(K):
    """The stiffness with its electric potentials, and how many of its unknowns move."""
    if sparse.issparse(K):
        return sparse.csc_array(K), K.shape[0]
    return sparse.csc_array(sparse.bmat([[K.uu, K.up], [K.pu, K.pp]])), K.shape[0]


def _padded(matrix, size):
    found = sparse.coo_array(matrix)
    return sparse.csc_array((found.data, found.coords), shape=(size, size))


# --- a buzzer ------------------------------------------------------------------------------------


def buzzer(rng):
    """A ceramic on a plate of brass, its current at one frequency and at its peak."""
    wide, thick = between(rng, 10e-3, 30e-3), between(rng, 0.1e-3, 0.3e-3)
    ceramic = float(f"{wide * rng.uniform(0.5, 0.85):.4g}")
    layers = [
        {"material": "brass", "diameter": wide, "thickness": thick},
        {"material": "PZT-5A", "diameter": ceramic, "thickness": between(rng, 0.1e-3, 0.3e-3),
         "electrodes": float(f"{0.9 * ceramic:.4g}")},
    ]  # fmt: skip
    at = between(rng, 1e3, 1e4)
    return {
        "error_budget": between(rng, 1e-3, 5e-2),
        "disc": {
            "part": "disc", "layers": layers, "damping": {"quality": between(rng, 10, 100)},
            "support": str(rng.choice(["free", "clamped", "simply_supported"])),
        },
        "analysis": {
            "type": "ac", "start": 500, "stop": 15e3, "points": int(rng.integers(60, 400)),
        },
        "probes": {"current_a": {"of": "disc.current", "at": f"{at!r} Hz"}},
    }  # fmt: skip


def buzzer_error(done):
    """Relative error of the current at the probe's frequency."""
    model = _full(done, "disc")
    s = 2j * np.pi * done.run.build.scene.probes["current_a"].at
    alpha, beta = model.rayleigh
    K, moving = _whole(model.K)
    P = (1 + s * beta) * K + (s**2 + s * alpha) * _padded(model.M, K.shape[0])
    port = model.inputs.index("anode")
    load = np.zeros(K.shape[0], complex)
    load[:moving] = model.B[:, port]
    x = splu(sparse.csc_array(P)).solve(load)[:moving]
    exact = abs(s * (model.C[port] @ x + model.D[port, port]))
    return float(abs(done.run.metrics["current_a"] / exact - 1))


# --- a bimorph -----------------------------------------------------------------------------------


def bimorph(rng):
    """A cantilever of two layers under a pulse."""
    thick = between(rng, 0.2e-3, 0.5e-3)
    layers = [{"material": "PZT-5A", "thickness": thick}] * 2
    pulse = {"high": between(rng, 10, 100), "start": 1e-4, "width": between(rng, 0.5e-3, 1.5e-3),
             "edge": between(rng, 1e-4, 5e-4)}  # fmt: skip
    return {
        "error_budget": between(rng, 1e-3, 5e-2),
        "beam": {
            "part": "bimorph", "length": between(rng, 20e-3, 40e-3), "width": 5e-3,
            "layers": layers, "wiring": str(rng.choice(["series", "parallel"])),
            "damping": {"quality": between(rng, 10, 100)}, "pins": {"anode": "drive.out"},
        },
        "drive": {"part": "source", "pulse": pulse},
        "analysis": {"type": "transient", "stop": STEP_END},
        "probes": {"stroke_m": {"of": "beam.u.tip", "take": "max"}},
    }  # fmt: skip


def bimorph_error(done):
    """Relative error of the largest displacement of the tip."""
    model = _full(done, "beam")
    alpha, beta = model.rayleigh
    K, moving = _whole(model.K)
    rest = splu(K)

    def inverse(b):
        load = np.zeros(K.shape[0])
        load[:moving] = b.ravel()
        return np.asarray(rest.solve(load)[:moving])

    size = (moving, moving)
    squares, modes = eigsh(
        LinearOperator(size, model.K.__matmul__), k=MODES, M=sparse.csc_matrix(model.M), sigma=0.0,
        OPinv=LinearOperator(size, inverse),
    )  # fmt: skip
    push, show = model.B[:, model.inputs.index("anode")], model.C[model.outputs.index("tip")]
    gain = (modes.T @ push) * (show @ modes)  # modes' M modes = 1
    wave = done.run.build.scene.parts["drive"].keys.pulse
    corners = wave.start + np.array([0.0, wave.edge, wave.width, wave.width + wave.edge])
    time = np.linspace(0, STEP_END, 30_001)
    volts = np.interp(time, corners, wave.high * np.array([0.0, 1.0, 1.0, 0.0]))
    tip = (show @ inverse(push) - (gain / squares).sum()) * volts
    for square, g in zip(squares, gain, strict=True):
        tip += signal.lsim(([g], [1.0, alpha + beta * square, square]), volts, time)[1]
    exact = float(tip.max())
    return float(abs(done.run.metrics["stroke_m"] / exact - 1))


# --- plain equations -----------------------------------------------------------------------------


def drawn(family):
    """A family of ``test_random_parts.py`` with a budget for the peak to peak of a wave, which its
    own equations have too."""

    def under_way(seed):
        found = Drawn(random.Random(seed), Path("."))
        family(found)
        return found

    def draw(rng):
        seed, budget = int(rng.integers(2**31)), between(rng, 1e-4, 2e-2)
        d = under_way(seed)
        return tomllib.loads("\n".join(d.text)) | {
            "error_budget": budget, "title": str(seed),
            "analysis": {"type": "transient", "stop": float(d.stop)},
            "probes": {"range": {"of": next(iter(d.compared)), "take": "peak_to_peak"}},
        }  # fmt: skip

    def judge(done):
        d = under_way(int(done.run.build.scene.tables["title"]))
        points = np.linspace(0.0, d.stop, POINTS)
        _, wave = d.solve(points) if hasattr(d, "solve") else d.own.solve(d.stop, points)
        exact = np.ptp(wave(next(iter(d.compared.values()))))
        return float(abs(done.run.metrics["range"] / exact - 1))

    return draw, judge


# --- all of them ---------------------------------------------------------------------------------

FAMILIES = {
    "kick": (kick, kick_error),
    "buzzer": (buzzer, buzzer_error),
    "bimorph": (bimorph, bimorph_error),
    "oscillator": drawn(motion),
    "rectifier": drawn(rectifier),
    "voice_coil": drawn(voice),
}
METRICS = {"kick": "launch_velocity_m_s", "buzzer": "current_a", "bimorph": "stroke_m"}


def judged(number):
    """Run one draw and compare it with its oracle."""
    family = list(FAMILIES)[number % len(FAMILIES)]
    draw, judge = FAMILIES[family]
    with tempfile.TemporaryDirectory() as work, contextlib.chdir(work):  # of files that are drawn
        tables = {"name": f"drawn_{number}", **draw(np.random.default_rng((7, number)))}
        return _compared(family, tables, judge)


def _compared(family, tables, judge):
    budget, why = tables["error_budget"], "timed out"
    try:
        with patience(PATIENCE), tempfile.TemporaryDirectory() as work, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            done = complete_run(load_scene(tables), Path(work), StageTimer())
            found, error = done.converged, judge(done)
    except (UsageError, SimulationError) as failed:
        why = f"refused: {failed.message} {failed.got or ''}"
    except TimeoutError:
        pass
    else:
        assert found is not None
        stated = found.final.errors.get(METRICS.get(family, "range"), np.nan)
        right = error <= budget and error <= 3 * stated + OWN
        outcome = "said" if not found.check.passed else "holds" if right else "SILENT"
        worst = f"{found.check.name.removeprefix('error of ')} {found.check.value:.1e}"
        return Budgeted(family, outcome, budget, error, stated, worst, len(found.tried), tables)
    return Budgeted(family, why, budget, np.nan, np.nan, "", 0, tables)


def describe_outcome(number):
    """The outcome of a draw, and its line, with its scene where that is neither held nor said."""
    line = asdict(judged(number))
    if line["outcome"] in ("holds", "said"):
        del line["scene"]
    return line["outcome"], line


if __name__ == "__main__":
    campaign(describe_outcome)
