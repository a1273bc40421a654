"""Each part of a scene is asked once, and later stages read the answers from its record."""

import collections
import functools
import inspect
import pickle
import re
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields

import pytest
from support import (
    ContactPair,
    DeclaredScene,
    GovernedScene,
    JoinedScene,
    PartType,
    StageTimer,
    WiredScene,
    Workspace,
    load_part_types,
    prepare_deck,
    resolve,
)

import kc2spice as kc

MOST = 2
# Cards that depend on the order of parts: comments list them, and a batch run prints two vectors.
ORDERED = ("*", ".print")


def count_calls(monkeypatch):
    """Outermost calls of the methods of all part types, by method and part."""
    calls, depth = collections.Counter(), collections.Counter()

    def counted(function, name):
        @functools.wraps(function)
        def wrapper(*args, **keywords):
            if not depth[name]:
                asked = next(a for a in args[1:] if hasattr(a, "name"))
                calls[name, asked.name] += 1
            depth[name] += 1
            try:
                return function(*args, **keywords)
            finally:
                depth[name] -= 1

        return wrapper

    classes = {PartType}.union(*(type(kind).__mro__ for kind in load_part_types().values()))
    methods = [n for n, f in vars(PartType).items() if inspect.isfunction(f) and n[0] != "_"]
    for cls in classes - {object}:
        for name in methods:
            if inspect.isfunction(function := cls.__dict__.get(name)):
                monkeypatch.setattr(cls, name, counted(function, name))
    return calls


@pytest.mark.parametrize("name", ["kick_and_catch", "duffing", "imprint"])
def test_a_run_calls_each_method_at_most_twice_for_each_part(name, monkeypatch, tmp_path):
    calls = count_calls(monkeypatch)
    scene = kc.load_scene(name)
    calls.clear()
    kc.run(scene, tmp_path / "run")
    assert calls["metrics", next(iter(scene.parts))] == 1  # the run was counted
    above = {key: count for key, count in calls.items() if count > MOST}
    assert not above


def test_loading_a_scene_calls_each_method_of_a_part_once(monkeypatch):
    calls = count_calls(monkeypatch)
    scene = kc.load_scene("kick_and_catch")
    once = (
        "governed_parts",
        "make_frequency_estimator",
        "shared_data",
        "default_joins",
        "equilibrium_conditions",
        "numerics",
        "choose_reduction",
        "pins",
    )
    assert {calls[method, part] for method in once for part in scene.parts} == {1}


STAGES = {kind.__name__: kind for kind in (DeclaredScene, GovernedScene, JoinedScene, WiredScene)}


def narrowed(function, stage):
    """The method with a scene that has the fields of its stage alone."""
    place = [*inspect.signature(function).parameters].index("scene")

    @functools.wraps(function)
    def wrapper(*args, **keywords):
        known = {item.name: getattr(args[place], item.name) for item in fields(stage)}
        return function(*args[:place], stage(**known), *args[place + 1 :], **keywords)

    return wrapper


@pytest.mark.parametrize("name", ["kick_and_catch", "imprint", "harmonic", "harvester_bridge"])
def test_part_types_read_nothing_beyond_their_stage(name, monkeypatch):
    expected = kc.load_scene(name)
    narrow = 0
    for cls in {PartType}.union(*(type(kind).__mro__ for kind in load_part_types().values())) - {
        object
    }:
        for method, function in list(vars(cls).items()):
            stage = STAGES.get(getattr(function, "__annotations__", {}).get("scene"))
            if inspect.isfunction(function) and stage is not None:
                monkeypatch.setattr(cls, method, narrowed(function, stage))
                narrow += 1
    scene = kc.load_scene(name)
    assert narrow > 100
    assert scene.nets == expected.nets
    assert scene.numerics == expected.numerics
    assert scene.equilibrium_conditions == expected.equilibrium_conditions


def test_a_contact_has_one_pair_of_surfaces(monkeypatch, tmp_path):
    pairs = []
    built = ContactPair.__init__
    monkeypatch.setattr(
        ContactPair, "__init__", lambda pair, *of: (pairs.append(of[0].name), built(pair, *of))[1]
    )
    kc.run(kc.load_scene("impact"), tmp_path / "run")
    assert pairs == ["contact"]


def cards_of(scene):
    """Cards of all files of a scene, with nets named after the first of their pins by name."""
    build, deck = prepare_deck(scene, StageTimer())
    pins = collections.defaultdict(list)
    for pin, net in build.scene.nets.items():
        pins[net.lower()].append("_".join(pin).lower())
    names = {net: f"net_{min(joined)}" for net, joined in pins.items() if net != "0"}

    def renamed(line):
        return re.sub(r"[A-Za-z_][\w.]*", lambda word: names.get(word[0].lower(), word[0]), line)

    return {
        name: collections.Counter(
            renamed(line)
            for line in text.replace("\n+", "").splitlines()  # lines are wrapped by their length
            if not line.startswith(ORDERED)
        )
        for name, text in deck.files.items()
    }


@pytest.mark.parametrize(
    "name",
    ["kick_and_catch", "coil_rails", "impact", "imprint", "harvester_bridge", "buzzer_noise"],
)
def test_the_order_of_parts_changes_only_the_order_of_cards(name):
    scene = kc.load_scene(name)
    other = kc.load_scene({key: scene.tables[key] for key in reversed(scene.tables)})
    assert [*other.parts] != [*scene.parts]
    assert cards_of(other) == cards_of(scene)


DISC = {
    "part": "disc",
    "layers": [
        {"material": "brass", "diameter": "12 mm", "thickness": "0.2 mm"},
        {"material": "PZT-5A", "diameter": "9 mm", "thickness": "0.2 mm"},
    ],
    "support": "clamped",
    "fields": True,
}
BUZZER = {
    "name": "buzzer",
    "disc": DISC,
    "drive": {
        "part": "source",
        "sine": {"amplitude": "5 V", "frequency": "2 kHz"},
        "pins": {"out": "disc.anode"},
    },
    "analysis": {"type": "transient", "stop": "1 ms"},
}


@pytest.mark.slow
def test_threads_over_a_meshed_body_equal_the_serial_run():
    """Points with meshes and fields of their own, and points that share one build."""
    values = {
        "disc.layers[1].thickness": [0.2e-3, 0.3e-3],
        "drive.sine.frequency": [2e3, 3e3],
    }
    serial, threads = (kc.sweep(BUZZER, values, workers=workers) for workers in (1, 3))
    assert serial["status"] == ["ok"] * 4
    assert len({row["worst_stress_time_s"] for row in serial}) == 4  # points differ
    assert threads == serial


def test_threads_with_a_workspace_get_the_results_of_their_own_keys(monkeypatch):
    """Both have stored their results before either thread goes on."""
    workspace, both = Workspace(), threading.Barrier(2)

    class EntryScales(dict):
        def __setitem__(self, kind, entry):
            super().__setitem__(kind, entry)
            both.wait(10)

    monkeypatch.setattr(workspace, "_entries", EntryScales())
    with ThreadPoolExecutor(2) as pool:
        results = pool.map(lambda key: workspace.get_or_compute("kind", key, lambda: -key), (1, 2))
        assert [*results] == [-1, -2]


def test_a_copied_workspace_is_empty():
    workspace = Workspace()
    workspace.get_or_compute("kind", 1, lambda: 2)
    assert pickle.loads(pickle.dumps(workspace)).get_or_compute("kind", 1, lambda: 3) == 3


def test_a_run_collects_the_results_of_its_scene_once(monkeypatch):
    """Netlist, metrics and checks read them from the build."""
    builds = []

    def collect(build, original=resolve.collect_results):
        builds.append(build)
        return original(build)

    monkeypatch.setattr(resolve, "collect_results", collect)
    run = kc.run("duffing")
    assert len(builds) == 1
    assert run.metrics.keys() >= builds[0].scene.probes.keys()
