"""Progress and wall time of the stages of a run.

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

ERROR_BUDGET = "error budget"  # stage that logs the error limits of the refined settings
LOGGER = logging.getLogger("kc2spice")
LOGGER.addHandler(logging.NullHandler())
STAGES = ("mesh", "assemble", "reduce", "magnetics", "export", "simulate", "report")


def ignore_progress(stage: str, done: float | None, text: str) -> None:
    """Accept a progress value without any effect."""


@dataclass
class Clock:
    """Wall time [s] of each stage; 0 for a stage that was skipped or cached."""

    progress: Progress = ignore_progress
    wall_s: dict[str, float] = field(default_factory=lambda: dict.fromkeys(STAGES, 0.0))

    @contextmanager
    def time_stage(self, name: str, text: str) -> Iterator[Callable[[float], None]]:
        """Log and time a stage, and yield a function that reports the completed fraction."""
        self.progress(name, None, text)
        LOGGER.info("%s: %s", name, text)
        start = time.perf_counter()
        yield lambda done: self.progress(name, done, text)
        elapsed = time.perf_counter() - start
        LOGGER.debug("%s took %.3f s", name, elapsed)
        self.wall_s[name] = self.wall_s.get(name, 0.0) + elapsed
