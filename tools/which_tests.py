"""A plugin of pytest: notes which test executes which line, and how long each takes.

Under coverage it names the context after the test and its stage; processes that the test starts
find the name in the environment. A test that fails without a mutant, or takes too long for one,
tells nothing and is left out. Each test file begins with an empty cache, so that what an earlier
one has built does not hide who executes the building.
"""

from __future__ import annotations

import os
import signal
import tempfile
from collections import defaultdict
from collections.abc import Generator
from pathlib import Path

import coverage
import pytest

_spent: defaultdict[str, float] = defaultdict(float)
_failed: set[str] = set()
LIMIT = 90.0  # s of a stage of a test
_folder = tempfile.TemporaryDirectory()


def _too_long(*_: object) -> None:
    pytest.fail(f"takes more than {LIMIT} s")


def _switch(context: str) -> None:
    os.environ["WHICH_TEST"] = context
    signal.signal(signal.SIGALRM, _too_long)
    signal.setitimer(signal.ITIMER_REAL, LIMIT)
    measuring = coverage.Coverage.current()
    if measuring is not None:
        measuring.switch_context(context)


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> Generator[None]:
    os.environ["KC2SPICE_CACHE"] = str(Path(_folder.name) / item.path.stem)
    _switch(f"{item.nodeid}|setup")
    return (yield)


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None]:
    _switch(f"{item.nodeid}|call")
    return (yield)


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    if report.failed:
        _failed.add(report.nodeid)
    if report.passed:
        _spent[report.nodeid] += report.duration
    if report.when == "setup":  # mostly that of the file's first test
        file = f"{report.nodeid.partition('::')[0]}|setup"
        _spent[file] = max(_spent[file], report.duration)


def pytest_sessionfinish() -> None:
    signal.setitimer(signal.ITIMER_REAL, 0.0)


def seconds() -> dict[str, float]:
    """Duration of each test that passed, and of ``FILE|setup``."""
    return {test: spent for test, spent in _spent.items() if test not in _failed}
