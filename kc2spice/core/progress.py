"""Progress, remaining time and wall time of the stages of a run.

``logging.getLogger("kc2spice")`` logs the start of each stage at the level INFO, and its remaining
time and wall time at the level DEBUG. Nothing is printed unless the caller installs a log handler.

:class:`StepTimer` and :class:`ConvergenceTimer` estimate the remaining time of a computation. The
estimate is reported for the stage that contains the computation.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field

Progress = Callable[[str, float | None, str], None]

# Name of the stage that refines numerical settings until the error budget is met.
ERROR_BUDGET = "error budget"
LOGGER = logging.getLogger("kc2spice")
LOGGER.addHandler(logging.NullHandler())
STAGES = ("mesh", "assemble", "reduce", "magnetics", "export", "simulate", "report")
_report: ContextVar[Callable[[float, str], None] | None] = ContextVar("report", default=None)


def ignore_progress(stage: str, done: float | None, text: str) -> None:
    """Ignore a progress report."""


@contextmanager
def follow_stage(progress: Progress, name: str, text: str) -> Iterator[Callable[[float], None]]:
    """Report the start of a stage; yield a function that reports the stage's progress.

    Within the ``with`` block, :func:`report_remaining_time` also reports the completed fraction,
    which is the elapsed time divided by the estimated total time.

    Examples
    --------
    >>> seen = []
    >>> with follow_stage(lambda *item: seen.append(item), "reduce", "900 equations"):
    ...     report_remaining_time(0.0, "last step")
    >>> seen
    [('reduce', None, '900 equations'), ('reduce', 1.0, '900 equations, last step')]
    """
    progress(name, None, text)
    start = time.perf_counter()

    def report(remaining: float, step: str) -> None:
        """Report the completed fraction of a stage, computed from its remaining time [s]."""
        elapsed = time.perf_counter() - start
        LOGGER.debug("%s: %s, about %.3g s remain", name, step, remaining)
        progress(name, elapsed / (elapsed + remaining), f"{text}, {step}")

    token = _report.set(report)
    try:
        yield lambda done: progress(name, done, text)
    finally:
        _report.reset(token)


def report_remaining_time(seconds: float, step: str) -> None:
    """Report the remaining time [s] of the current stage, and the name of the step."""
    report = _report.get()
    if report is not None:
        report(seconds, step)


class StepTimer:
    """Timer that reports the remaining time of steps with known relative durations."""

    def __init__(self) -> None:
        self._start = time.perf_counter()

    def begin_step(self, number: int, steps: Sequence[tuple[str, float]]) -> None:
        """Report the remaining time at the start of a step.

        ``steps`` contains the name and the relative duration of each step.
        """
        finished, remaining = (
            sum(size for _, size in part) for part in (steps[:number], steps[number:])
        )
        elapsed = time.perf_counter() - self._start
        report_remaining_time(elapsed * remaining / finished, steps[number][0])


class ConvergenceTimer:
    """Timer that reports the remaining time of a geometrically converging iteration.

    Parameters
    ----------
    target : float
        Error below which the iteration ends.
    confirmations : int
        Number of consecutive steps whose errors must not exceed the target.
    usual : int
        Assumed number of steps while the rate of convergence is unknown.
    step : str
        Name of each step in the progress report.
    """

    def __init__(self, target: float, confirmations: int, usual: int, step: str) -> None:
        self._target, self._confirmations, self._usual = target, confirmations, usual
        self._name, self._errors = step, list[float]()
        self._start = time.perf_counter()

    def end_step(self, error: float) -> None:
        """Record the numerical error of a completed step, and report the remaining time."""
        self._errors.append(error)
        count, remaining = len(self._errors), self.remaining_steps()
        per_step = (time.perf_counter() - self._start) / count
        report_remaining_time(
            remaining * per_step, f"{self._name} {count} of about {count + remaining}"
        )

    def remaining_steps(self) -> int:
        """Extrapolate the number of remaining steps from the latest errors.

        Only the later half of the errors is used, because many iterations converge faster towards
        the end.
        """
        errors = [error for error in self._errors if math.isfinite(error) and error > 0]
        errors = errors[(len(errors) - 1) // 2 :]
        met = next((k for k, error in enumerate(reversed(self._errors)) if error > self._target), 0)
        if len(errors) > 1 and errors[-1] < errors[0]:
            rate = math.log(errors[0] / errors[-1]) / (len(errors) - 1)
            steps = math.ceil(max(math.log(errors[-1] / self._target) / rate, 0.0))
            # The first step that meets the target is counted in ``steps`` and again in
            # ``_confirmations``, so 1 is subtracted.
            return max(steps + self._confirmations - (1 if steps else met), 0)
        return max(self._usual - len(self._errors), 1)


@dataclass
class StageTimer:
    """Timer that records the wall time [s] of each stage of a run."""

    progress: Progress = ignore_progress
    wall_s: dict[str, float] = field(default_factory=lambda: dict.fromkeys(STAGES, 0.0))

    @contextmanager
    def time_stage(self, name: str, text: str) -> Iterator[Callable[[float], None]]:
        """Log and time a stage; yield a function that reports the completed fraction."""
        LOGGER.info("%s: %s", name, text)
        start = time.perf_counter()
        with follow_stage(self.progress, name, text) as report:
            yield report
        elapsed = time.perf_counter() - start
        LOGGER.debug("%s took %.3f s", name, elapsed)
        self.wall_s[name] = self.wall_s.get(name, 0.0) + elapsed
