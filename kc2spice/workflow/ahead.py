"""Models of several parts at once: while the first is computed, a fork computes the others."""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

from kc2spice.core.progress import Clock
from kc2spice.scene.model import Part, Scene


@contextmanager
def built_ahead(scene: Scene, waiting: Mapping[str, Part], clock: Clock) -> Iterator[None]:
    """Within it, the first stage that has to be computed forks a process for all parts of
    ``waiting`` but the first, which is in work. Both processes share results through the cache,
    where one waits for what the other computes.

    Nothing is forked where the cache has all models, or without a second processor. What fails in
    the fork is computed, and fails, once more in this process.
    """
    others = _Fork()
    if len(waiting) > 1 and _possible():
        clock.before_work = lambda: others.start(scene, list(waiting.values())[1:])
    try:
        yield
        for stage, seconds in others.wall_s().items():
            clock.wall_s[stage] = clock.wall_s.get(stage, 0.0) + seconds
    finally:
        clock.before_work = None
        others.end()


def _possible() -> bool:
    count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 1
    return count > 1 and threading.current_thread() is threading.main_thread()


class _Fork:
    """The second process, if there is one."""

    def __init__(self) -> None:
        self._pid = self._answer = 0

    def start(self, scene: Scene, parts: list[Part]) -> None:
        if not parts:
            return
        answer, own = os.pipe()
        sys.stdout.flush(), sys.stderr.flush()
        self._pid, self._answer = os.fork(), answer
        if self._pid:
            os.close(own)
            return
        try:
            warnings.simplefilter("ignore")  # whoever takes the model warns
            clock = Clock()
            for part in parts:
                part.type.build(part, scene, clock)
            os.write(own, json.dumps(clock.wall_s).encode())
        finally:  # nothing of the caller's stack is this process' to clean up
            os._exit(0)

    def wall_s(self) -> Mapping[str, float]:
        """What its stages took; empty where it failed, or was not needed."""
        if not self._pid:
            return {}
        text = os.read(self._answer, 10_000)  # all or nothing; the end where it has none
        found: Mapping[str, float] = json.loads(text or b"{}")
        return found

    def end(self) -> None:
        if self._pid:
            os.kill(self._pid, signal.SIGKILL)  # a cache entry is written whole or not at all
            os.waitpid(self._pid, 0)
            os.close(self._answer)
            self._pid = 0
