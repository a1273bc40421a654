"""A plugin of pytest: notes which test executes which line, and how long each takes.

Run under coverage, it names the context after the test and its stage; ``TIMES`` in the environment
is the JSON file for the durations [s]. A test that fails without a mutant tells nothing and is left
out. Each test file begins with an empty cache, so that what an earlier one has built does not hide
who executes the building.
"""

from __future__ import annotations

import json
import os
import tempfile
from collections import Counter
from collections.abc import Generator
from pathlib import Path

import coverage
import pytest

_spent: Counter[str] = Counter()
_failed: set[str] = set()
_folder = tempfile.TemporaryDirectory()


def _switch(context: str) -> None:
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
    file = Path(os.environ["TIMES"])
    known = json.loads(file.read_text()) if file.exists() else {}
    file.write_text(json.dumps({k: v for k, v in (known | _spent).items() if k not in _failed}))
