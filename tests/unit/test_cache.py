"""The cache: equal back, rebuilt when anything it depends on changes or the entry is damaged."""

import json
import os
import resource
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from support import (
    StackKeys,
    StageTimer,
    _body_model,
    build_models,
    cache,
    ignore_progress,
    load_or_build,
    load_scene,
    ring_magnet_coils,
)

import kc2spice


@dataclass(frozen=True)
class Inner:
    name: str
    limits: tuple[float, float]


@dataclass(frozen=True)
class Outer:
    dense: np.ndarray
    ports: tuple[Inner, ...]
    count: int
    nothing: None
    table: dict[str, float]


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("KC2SPICE_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def outer():
    rng = np.random.default_rng(1)
    return Outer(
        dense=rng.standard_normal((4, 5)),
        ports=(Inner("a", (0.0, 1 / 3)), Inner("b", (-1.0, 1e-300))),
        count=7,
        nothing=None,
        table={"x": 0.1},
    )


class Builder:
    """Counts how often it had to build."""

    def __init__(self, value):
        self.value, self.calls = value, 0

    def __call__(self):
        self.calls += 1
        return self.value


def test_round_trip_is_bit_exact(outer):
    build = Builder(outer)
    assert load_or_build("kind", {"a": 1}, build, classes=(Outer, Inner)) is outer
    second = load_or_build("kind", {"a": 1}, build, classes=(Outer, Inner))
    assert build.calls == 1
    assert second.dense.tobytes() == outer.dense.tobytes()
    assert second.ports == outer.ports
    assert (second.count, second.nothing, second.table) == (7, None, {"x": 0.1})


@pytest.mark.parametrize(
    "change",
    [
        {"key": {"kick": StackKeys(layers=34)}},
        {"key": {"kick": StackKeys(), "more": np.float64(1)}},
        {"sources": ("kc2spice.core.quantities",)},
        {"kind": "other"},
    ],
)
def test_a_changed_dependency_builds_the_entry_again(change):
    base = {"kind": "kind", "key": {"kick": StackKeys()}}
    build = Builder(1)
    load_or_build(build=build, **base)
    load_or_build(build=build, **base)
    assert build.calls == 1
    load_or_build(build=build, **{**base, **change})
    assert build.calls == 2


def test_changed_source_or_library_builds_again(tmp_path, monkeypatch):
    (tmp_path / "some_model.py").write_text("x = 1\n")
    monkeypatch.syspath_prepend(tmp_path)
    build = Builder(1)
    for _ in range(2):
        load_or_build("kind", {}, build, sources=("some_model",))
    assert build.calls == 1
    (tmp_path / "some_model.py").write_text("x = 2\n")
    load_or_build("kind", {}, build, sources=("some_model",))
    assert build.calls == 2
    monkeypatch.setattr(cache, "_find_installed_version", lambda library: "0.0")
    load_or_build("kind", {}, build, sources=("some_model",))
    assert build.calls == 3


@pytest.mark.parametrize("damage", ["flip", "cut", "empty"])
def test_damaged_entries_are_noticed(folder, outer, damage):
    load_or_build("kind", {}, Builder(outer), classes=(Outer, Inner))
    (entry,) = folder.rglob("*.entry")
    content = bytearray(entry.read_bytes())
    if damage == "flip":
        content[len(content) // 2] ^= 1
    entry.write_bytes({"flip": content, "cut": content[:-9], "empty": b""}[damage])
    build = Builder(outer)
    with pytest.warns(UserWarning, match="damaged"):
        load_or_build("kind", {}, build, classes=(Outer, Inner))
    assert build.calls == 1
    load_or_build("kind", {}, build, classes=(Outer, Inner))
    assert build.calls == 1


def test_an_unwritable_cache_warns_and_works(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("KC2SPICE_CACHE", str(tmp_path / "file"))
    with pytest.warns(UserWarning, match="the cache .* cannot be written"):
        assert load_or_build("kind", {}, Builder(3)) == 3


def test_a_full_disk_costs_time_only(folder):
    child = os.fork()
    if child == 0:
        resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, 10_000))
        with pytest.warns(UserWarning, match="the cache .* cannot be written"):
            found = load_or_build("kind", {}, Builder(np.zeros(10_000)))
        os._exit(7 if found.size == 10_000 else 1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 7
    assert not [path for path in folder.rglob("*") if path.is_file()]


def test_two_processes_build_a_common_entry_once(folder):
    """One builds, the other waits for it, be they threads or processes."""
    code = (
        "import sys, time\n"
        "from kc2spice.core.cache import load_or_build\n"
        "def build():\n"
        "    open(sys.argv[1], 'a').write('x')\n"
        "    time.sleep(0.5)\n"
        "    return 7\n"
        "assert load_or_build('sums', {'a': 1}, build) == 7\n"
    )
    log = folder / "built"
    command = [sys.executable, "-c", code, str(log)]
    both = [subprocess.Popen(command) for _ in range(3)]
    assert [process.wait(60) for process in both] == [0, 0, 0]
    assert log.read_text() == "x"
    assert not list(folder.rglob("*.part"))


# Of what a build runs, these cannot change its result: they count time, return keys, word errors,
# and refuse what does not fit into the memory.
NEUTRAL = {
    "kc2spice.core.cache", "kc2spice.core.errors", "kc2spice.core.memory", "kc2spice.core.progress",
    "kc2spice.core.memory_store",
    "kc2spice.scene.scene_classes", "kc2spice.scene.parttype", "kc2spice.scene.part_records",
    "kc2spice.scene.settings",
}  # fmt: skip
SMALL = ("kick.layers=2", "kick.mesh.sectors=4", "kick.mesh.rings=1", "kick.mesh.outer_rings=1",
         "rom.order=6", "contact.rings=all", "catch.positions=4")  # fmt: skip
BODIES = {"kick_and_catch": SMALL, "harvester": ()}


@pytest.mark.parametrize(
    "scene", ["kick_and_catch", pytest.param("harvester", marks=pytest.mark.slow)]
)
def test_every_module_that_a_build_runs_is_part_of_its_key(scene, monkeypatch):
    """Watched while it runs, so that a module that joins the build later cannot be forgotten."""
    missed, root = {}, Path(kc2spice.__file__).parents[1]

    def watched(kind, key, build, *, classes=(), sources=()):
        files = set()

        def note(frame, event, _):
            files.add(frame.f_code.co_filename)

        sys.setprofile(note)
        try:
            result = build()
        finally:
            sys.setprofile(None)
        own = (Path(f).relative_to(root) for f in files if f.startswith(str(root / "kc2spice")))
        ran = {".".join(f.with_suffix("").parts) for f in own}
        known = {*sources, *(cls.__module__ for cls in classes)}
        assert ran
        missed[kind] = sorted(
            name for name in ran - NEUTRAL
            if not any(name == one or name.startswith(f"{one}.") for one in known)
        )  # fmt: skip
        return result

    for module in (_body_model, ring_magnet_coils):
        monkeypatch.setattr(module, "load_or_build", watched)
    build_models(load_scene(scene, list(BODIES[scene])), StageTimer(ignore_progress))
    assert missed
    assert not any(missed.values()), missed


MATTERS = ("kick.damping.ratio=0.02", "kick.mesh.refine=2", "kick.material.density=7800",
           "kick.side=2e-3", "kick.layers=3", "rom.order=7", "rom.band=[0, 4e5]",
           "contact.inertia=lumped", "contact.rings=1", "catch.mu_r=1.2", "catch.refine=2",
           "catch.polarity=antiparallel", "catch.positions=5", "catch.ring.height=0.7e-3",
           "sphere.radius=0.9e-3")  # fmt: skip


def keys(*overrides):
    scene = load_scene("kick_and_catch", [*SMALL, *overrides])
    parts = scene.parts
    found = {name: parts[name].type.model_key(parts[name], scene) for name in ("kick", "catch")}
    return json.dumps(found, sort_keys=True, default=cache._convert_to_json)


@pytest.mark.parametrize("override", MATTERS)
def test_a_key_of_the_model_demands_a_new_one(override):
    assert keys(override) != keys()
