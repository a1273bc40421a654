"""Two models at a time: through the cache, and without a process that stays."""

import os
import time
from types import SimpleNamespace

import pytest

from kc2spice.core.cache import cached
from kc2spice.core.progress import Clock
from kc2spice.workflow import ahead
from kc2spice.workflow.ahead import built_ahead

HERE = os.getpid()


class Kind:
    """Builds what process it was built by, within a tenth of a second."""

    def __init__(self, stage, fails_in_fork=False):
        self.stage, self.fails_in_fork = stage, fails_in_fork

    def build(self, part, scene, clock):
        def make():
            with clock.stage(self.stage, part.name):
                if self.fails_in_fork and os.getpid() != HERE:
                    raise ValueError(part.name)
                time.sleep(0.1)
                return os.getpid()

        return cached("ahead", {"name": part.name}, make)[0]


def build(clock, **kinds):
    scene = SimpleNamespace(
        parts={name: SimpleNamespace(name=name, type=kind) for name, kind in kinds.items()}
    )
    waiting, found = dict(scene.parts), []
    with built_ahead(scene, waiting, clock):
        for name, part in scene.parts.items():
            found.append(part.type.build(part, scene, clock))
            del waiting[name]
    return found


@pytest.fixture
def fresh(tmp_path, monkeypatch):
    monkeypatch.setenv("KC2SPICE_CACHE", str(tmp_path))
    monkeypatch.setattr(ahead, "_possible", lambda: True)


def gone(pid):
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


def test_the_second_model_comes_from_another_process_that_ends(fresh):
    clock = Clock()
    ours, theirs = build(clock, kick=Kind("reduce"), catch=Kind("magnetics"))
    assert ours == HERE != theirs
    gone(theirs)
    assert clock.wall_s["reduce"] >= 0.1
    assert clock.wall_s["magnetics"] >= 0.1  # measured over there


def test_a_failure_over_there_is_computed_here(fresh):
    found = build(Clock(), kick=Kind("reduce"), catch=Kind("magnetics", fails_in_fork=True))
    assert found == [HERE, HERE]


def test_nothing_is_forked_for_the_last_model_or_for_none(fresh, monkeypatch):
    build(Clock(), kick=Kind("reduce"))
    monkeypatch.setattr(os, "fork", lambda: pytest.fail("forked"))
    found = build(Clock(), kick=Kind("reduce"), catch=Kind("magnetics"))  # one is in the cache
    assert found == [HERE, HERE]
    build(Clock(), kick=Kind("reduce"), catch=Kind("magnetics"))  # both are


def test_an_error_here_leaves_no_process(fresh, monkeypatch):
    pids = []
    fork = os.fork
    monkeypatch.setattr(os, "fork", lambda: pids.append(fork()) or pids[-1])

    class Broken(Kind):
        def build(self, part, scene, clock):
            with clock.stage(self.stage, part.name):
                raise KeyError(part.name)

    with pytest.raises(KeyError):
        build(Clock(), kick=Broken("reduce"), catch=Kind("magnetics"))
    assert len(pids) == 1
    gone(pids[0])
