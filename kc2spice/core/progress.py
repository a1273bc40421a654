"""Progress and wall time of the stages of a study.

``logging.getLogger("kc2spice")`` logs the start of every stage at the level INFO, and its wall time
at DEBUG. Nothing is printed unless the caller adds a handler.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

Progress = Callable[[str, float | None, str], None]

ERROR_BUDGET = "error budget"  # stage that announces the limits of refined meshes
LOGGER = logging.getLogger("kc2spice")
LOGGER.addHandler(logging.NullHandler())
STAGES = ("mesh", "assemble", "reduce", "magnetics", "export", "simulate", "report")


def silent(stage: str, done: float | None, text: str) -> None:
    """Report nothing."""


@dataclass
class Clock:
    """Wall time by stage; 0 for a stage that was skipped or came from the cache."""

    progress: Progress = silent
    wall_s: dict[str, float] = field(default_factory=lambda: dict.fromkeys(STAGES, 0.0))

    @contextmanager
    def stage(self, name: str, text: str) -> Iterator[Callable[[float], None]]:
        """Announce and time a stage, and yield a function that takes the share done."""
        self.progress(name, None, text)
        LOGGER.info("%s: %s", name, text)
        start = time.perf_counter()
        yield lambda done: self.progress(name, done, text)
        elapsed = time.perf_counter() - start
        LOGGER.debug("%s took %.3f s", name, elapsed)
        self.wall_s[name] = self.wall_s.get(name, 0.0) + elapsed
