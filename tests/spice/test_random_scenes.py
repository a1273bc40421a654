"""Scenes drawn at random over all keys: each ends in a checked result or in a true diagnosis."""

import random
import signal
import tempfile
import warnings
from collections import Counter
from pathlib import Path
from typing import get_args

import annotated_types as at
import pytest

from kc2spice.core.errors import SimulationError, UsageError
from kc2spice.core.progress import Clock, silent
from kc2spice.netlist.lint import lint
from kc2spice.report.run_page import write_run
from kc2spice.scene.gates import Gate
from kc2spice.scene.keys import scene_keys, submodel
from kc2spice.scene.load import load_scene
from kc2spice.scene.model import Frame
from kc2spice.scene.parttype import part_types
from kc2spice.scene.short import SHORT
from kc2spice.sim.retries import RetriesFailedError
from kc2spice.workflow.decks import make_deck
from kc2spice.workflow.judge import metrics
from kc2spice.workflow.models import build_models
from kc2spice.workflow.run import run_figures
from kc2spice.workflow.simulate import simulate
from kc2spice.workflow.verify.circuit import solve, without_law
from kc2spice.workflow.verify.compare import measured, solution

# What the paper's scenes are made of: each list is a study, the loop's are drawn from.
LOOP = ("kick", "contact", "sphere", "catch", "control")
STUDIES = {
    "impact": ("impact", "kick", "contact", "sphere"),
    "imprint": ("imprint", "kick", "contact", "sphere"),
    "harmonic": ("harmonic", "kick"),
    "em_force": ("em_force", "sphere", "catch"),
    "loop": LOOP,
}  # fmt: skip
DRIVERS = {
    "kick": {"half_bridge": "half_bridge", "amplifier": "amplifier", "charge": "charge_drive"},
    "catch": {"linear": "linear_drive", "pwm": "pwm_drive"},
}
TIME = 20.0  # s for one ngspice run; a legal scene may ask for hours
# Counts and times that make a run longer and nothing else harder come from their low end.
LOW_END = {
    "kick.layers": (1, 6), "kick.mesh.refine": (1, 2), "kick.mesh.sectors": (2, 6),
    "kick.mesh.rings": (1, 6), "kick.mesh.outer_rings": (1, 5), "catch.positions": (4, 9),
    "catch.refine": (1, 1), "rom.order": (1, 60), "imprint.steps": (1, 40),
    "harmonic.steps": (2, 40), "catch.turns": (1, 10_000),
}  # fmt: skip
# A scene small enough for its FE to take a second; everything else is at its default.
BASE = {
    "kick": "layers = 3\nmesh = { sectors = 4, outer_rings = 3 }\n"
    'drive = { start = "5 us" }\n',
    "catch": "positions = 5\n"
    "ring = { height = 1e-3, outer = 5e-3, inner = 4e-3, y = 2.5e-3 }\n"
    "lower = { height = 2e-3, outer = 2.3e-3, inner = 1.3e-3, y = 1e-3 }\n"
    "upper = { height = 2e-3, outer = 2.3e-3, inner = 1.3e-3, y = 4e-3 }\n",
    "control": 'enable_at = "5 us"\n',
    "imprint": "steps = 20\n",
    "harmonic": "steps = 20\n",
    "em_force": "", "impact": "", "sphere": "", "contact": "",
    "solver": 'stop = "60 us"\n',
}  # fmt: skip


def schema_fields(model, prefix=""):
    """Dotted name and field of every key."""
    for name, field in model.model_fields.items():
        section = submodel(field.annotation)
        if section is None:
            yield f"{prefix}{field.alias or name}", field
        else:
            yield from schema_fields(section, f"{prefix}{field.alias or name}.")


def all_fields():
    """Fields of the frame, of parts under their short names, and of drivers within them."""
    yield from schema_fields(Frame)
    types = part_types()
    for short, kind in SHORT.items():
        yield from schema_fields(types[kind].schema, f"{short}.")
    for part, drivers in DRIVERS.items():
        for short, name in drivers.items():
            yield from schema_fields(types[name].schema, f"{part}.driver.{short}.")


def plain_types(annotation):
    """The types that a key may have, without what they are wrapped in."""
    inner = get_args(annotation)
    return {t for each in inner for t in plain_types(each)} if inner else {annotation}


CHOICES = {key.name: key.choices for key in scene_keys()}
FIELDS = {
    key: field
    for key, field in all_fields()
    if (CHOICES.get(key) or str not in plain_types(field.annotation))  # names of other things
    and key.split(".")[-1] not in ("of", "coils", "a", "b", "driver", "include", "title", "name")
    and key.split(".")[0] not in ("analysis", "probes", "bench")
}


def bounds(field):
    """Lowest and highest legal value, None where there is none."""
    low = high = None
    for meta in field.metadata:
        low = meta.gt if isinstance(meta, at.Gt) else meta.ge if isinstance(meta, at.Ge) else low
        high = meta.lt if isinstance(meta, at.Lt) else meta.le if isinstance(meta, at.Le) else high
    return low, high


def number(rng, default, low, high):
    """A legal number: mostly near the default, sometimes decades away, now and then at a bound."""
    scale, kind = abs(default) or 1.0, rng.random()
    if kind < 0.6:
        drawn = default * 10 ** rng.uniform(-0.5, 0.5) if default else rng.uniform(-0.5, 0.5)
    elif kind < 0.9:
        drawn = scale * 10 ** rng.uniform(-4, 4) * (rng.choice([1, -1]) if low is None else 1)
    else:
        drawn = rng.choice([x for x in (low, high, 0.0) if x is not None])
    legal = (low is None or drawn > low) and (high is None or drawn < high)
    return drawn if legal else default


def value(rng, key):
    """A value for one key, as TOML text."""
    field = FIELDS[key]
    default, (low, high) = field.default, bounds(field)
    literals = [each for each in get_args(field.annotation) if isinstance(each, int)]
    if key == "contact.rings":
        return rng.choice(['"needed"', '"all"', "1", "2", "4"])
    if CHOICES.get(key):
        return f'"{rng.choice(CHOICES[key])}"'
    if literals:
        return str(rng.choice(literals))
    if key in LOW_END:
        return str(rng.randint(*LOW_END[key]))
    if isinstance(default, tuple):
        return str([each * 10 ** rng.uniform(-0.1, 0.1) for each in default])
    whole = default is None and {int, float} & plain_types(field.annotation) == {int}
    if isinstance(default, int) or whole:
        return str(rng.randint(low or 0, high or 10))
    return repr(number(rng, default if isinstance(default, float) else 1e-3, low, high))


def drawn_scene(rng):
    """A study with its parts, and one to five keys of theirs changed."""
    study = rng.choice(sorted(STUDIES))
    parts = list(STUDIES[study])
    if study == "loop":
        some = ("sphere",), ("kick",), ("kick", "contact", "sphere"), ("sphere", "catch")
        parts = list(rng.choice([*some, LOOP, LOOP]))
    present = (*parts, "rom", "solver", "checks", "gravity", "error_budget")
    keys = [k for k in FIELDS if k.split(".")[0] in present and ".driver." not in k]
    lines = [f"[{part}]\n{BASE[part]}" for part in (*parts, "solver")]
    overrides = [f"{key}={value(rng, key)}" for key in rng.sample(keys, rng.randint(1, 5))]
    for part in ("kick", "catch"):
        drivers = [k for k in FIELDS if k.startswith(f"{part}.driver.")]
        if "control" in parts and rng.random() < 0.3:
            kind = rng.choice(sorted({k.split(".")[2] for k in drivers}))
            one = rng.choice([k for k in drivers if k.split(".")[2] == kind])
            overrides.append(f"{one}={value(rng, one)}")
    return "".join(lines), tuple(overrides)


def simulated(text, overrides, folder):
    """The models of a scene and what became of its deck in ``folder``."""
    path = folder / "drawn.toml"
    path.write_text(text)
    build = build_models(load_scene(path, overrides), Clock(silent))
    deck = make_deck(build)
    lint(deck)
    return build, simulate(build, deck, folder, timeout=TIME)


def outcome(text, overrides):
    """What became of a scene, in one word; anything but our own errors is raised."""
    with tempfile.TemporaryDirectory() as folder:
        try:
            build, done = simulated(text, overrides, Path(folder))
        except UsageError as error:
            assert error.where or error.hint or error.expected, error
            return "refused"
        except RetriesFailedError as error:
            failure = error.failure
            assert failure is None or failure.time is not None or failure.kind, error
            assert failure or "physics" in error.message, error
            return "diagnosed after retries" if len(error.attempts) > 1 else "diagnosed"
        except SimulationError as error:
            if "did not finish" in error.message:
                return "out of time"
            assert error.hint or error.expected or error.got, error
            return "diagnosed"
        assert not any(check.fatal for check in done.verdict.checks)
        figures = run_figures(build, done.waves)
        record = {"metrics": metrics(done.waves, build)}
        write_run(Path(folder) / "report.html", record, build.scene, figures)
    return "result" if len(done.attempts) == 1 else "result after retries"


def campaign(count):
    found = Counter()
    for number in range(count):
        drawn = drawn_scene(random.Random(f"scene {number}"))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found[outcome(*drawn)] += 1
    return found


def judged(found, count):
    assert sum(found.values()) >= count
    assert found["result"] >= 0.4 * count, found
    retried = found["result after retries"] + found["diagnosed after retries"]
    assert retried <= max(1, 0.02 * count), found
    assert found["out of time"] <= max(1, 0.03 * count), found


def test_six_scenes_end_in_a_result_or_a_diagnosis():
    judged(campaign(6), 6)


@pytest.mark.slow
@pytest.mark.campaign
def test_two_hundred_scenes_end_in_a_result_or_a_diagnosis():
    judged(campaign(200), 200)


# --- against the independent integrator -----------------------------------------------------------

LAUNCH, HEIGHT = 1e-3, 5e-6  # relative, m
PATIENCE = 60  # s of the integrator; a train of pulses over seconds takes it hours


class OutOfTimeError(Exception):
    pass


def deviations(build, waves):
    """Largest difference of launch or rebound, of heights, of responses, over its limit.

    None where a part has no law, nothing is compared, or the integrator is out of time or patience.
    """
    if without_law(build):
        return None

    def late(*_):
        raise OutOfTimeError

    signal.signal(signal.SIGALRM, late)
    signal.alarm(PATIENCE)
    try:
        exact = solution(solve(build, waves).results, build)
    except (OutOfTimeError, SimulationError):
        return None
    finally:
        signal.alarm(0)
    ours = solution(waves, build)
    found = {}
    for part in build.scene.parts.values():
        for gate in part.type.gates(part, build):
            if gate.of.endswith("velocity_m_s") or gate.measure in ("largest", "spectral"):
                found[gate.words] = measured(gate, ours, exact), LAUNCH
        name = f"{part.name}.y"
        if "time" in waves and name in waves and name in exact.waves:
            found[name] = measured(Gate(name, name, {}, "absolute"), ours, exact), HEIGHT
    return {k: None if v is None else v / limit
            for k, (v, limit) in found.items() if v is None or isinstance(v, float)}  # fmt: skip


def compared(number):
    """Outcome of a scene, its deviations, and what was said of it."""
    text, overrides = drawn_scene(random.Random(f"scene {number}"))
    with tempfile.TemporaryDirectory() as folder:
        try:
            build, done = simulated(text, overrides, Path(folder))
        except (UsageError, SimulationError) as error:
            return f"refused: {error.message}", {}, []
        said = [check.name for check in done.verdict.checks if not check.passed]
        return "result", deviations(build, done.waves), said


def word_for(outcome, found, said):
    """*refused*, *not compared*, *right*, *off, said* or *OFF, SILENT*."""
    if outcome != "result":
        return "refused"
    if not found:
        return "not compared"
    if all(value is not None and value <= 1 for value in found.values()):
        return "right"
    return "off, said" if said else "OFF, SILENT"


@pytest.mark.slow
@pytest.mark.campaign
@pytest.mark.parametrize("number", range(1000, 1008))
def test_a_result_is_right_or_says_that_it_is_not(number):
    assert word_for(*compared(number)) != "OFF, SILENT"
