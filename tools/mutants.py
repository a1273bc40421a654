"""Mutation testing by cosmic-ray: does a test fail when one operator or number is changed?

    python tools/mutants.py [--sample N] [--seed S] [--out docs/mutants.md]

A sample of all mutants of each package below runs in a copy of the repository against the tests
that know the package; what survives is written with file, line and change.
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from cosmic_ray.work_db import WorkDB, use_db
from cosmic_ray.work_item import WorkerOutcome, WorkItem, WorkResult

ROOT = Path(__file__).parents[1]
TESTS = {  # fast ones first: the first failure ends a mutant
    "kc2spice/rom": "tests/unit/test_rom_io.py tests/physics/test_certificates.py "
    "tests/unit/test_reduce_scene.py",
    "kc2spice/spice": "tests/unit/test_lint.py tests/unit/test_scan.py tests/unit/test_naming.py "
    "tests/unit/test_read_lib.py tests/unit/test_keys_reach.py tests/spice/test_dialect.py "
    "tests/spice/test_symbols.py tests/spice/test_veriloga.py tests/spice/test_kick_subcircuit.py",
    "kc2spice/parts": "tests/unit/test_grammar.py tests/unit/test_keys_reach.py "
    "tests/unit/test_metrics.py tests/unit/test_run_checks.py tests/spice/test_parts.py",
    "kc2spice/sim": "tests/unit/test_run_checks.py tests/spice/test_engine.py "
    "tests/spice/test_retries.py",
    "kc2spice/workflow/verify": "tests/unit/test_verify_report.py tests/spice/test_verify.py",
}
TIMEOUT = 900.0  # s; a mutant that hangs is killed


def main() -> int:
    """Run the sample of each package and write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sample", type=int, default=40, help="mutants of each package")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", nargs="*", default=list(TESTS), help="packages")
    parser.add_argument("--out", type=Path, help="page to write instead of printing it")
    asked = parser.parse_args()
    rows, survivors = [], []
    with tempfile.TemporaryDirectory() as directory:
        copy = Path(directory) / "copy"
        shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns(".git", ".venv", "build", "out"))
        for package in asked.only:
            database = Path(directory) / f"{package.replace('/', '_')}.sqlite"
            total, done = tested(copy, package, database, asked.sample, asked.seed)
            alive = [item for item, result in done if not result.is_killed]
            rows.append((package, total, len(done), len(done) - len(alive)))
            survivors += [described(item, result) for item, result in done if not result.is_killed]
    page = "\n".join(written(rows, survivors, asked.seed))
    if asked.out:
        asked.out.write_text(page, encoding="utf-8")
    sys.stdout.write(page)
    return 0


def tested(
    copy: Path, package: str, database: Path, sample: int, seed: int
) -> tuple[int, list[tuple[WorkItem, WorkResult]]]:
    """The number of all mutants of a package, and those of the sample with their results."""
    config = database.with_suffix(".toml")
    command = f"{sys.executable} -m pytest -q -x -m 'not slow' -p no:cacheprovider {TESTS[package]}"
    config.write_text(
        f'[cosmic-ray]\nmodule-path = "{package}"\ntimeout = {TIMEOUT}\nexcluded-modules = []\n'
        f'test-command = "{command}"\n[cosmic-ray.distributor]\nname = "local"\n'
    )
    environment = dict(os.environ, PYTHONPATH=str(copy))
    tool = [sys.executable, "-m", "cosmic_ray.cli"]
    run = {"cwd": copy, "env": environment, "check": True}
    subprocess.run([*tool, "init", str(config), str(database)], **run)
    with use_db(database, WorkDB.Mode.open) as db:
        jobs = sorted(item.job_id for item in db.work_items)
        keep = {item.job_id for item in chosen(list(db.work_items), sample, seed)}
        for job in jobs:
            if job not in keep:
                db.set_result(job, WorkResult(worker_outcome=WorkerOutcome.SKIPPED))
    subprocess.run([*tool, "exec", str(config), str(database)], **run)
    with use_db(database, WorkDB.Mode.open) as db:
        results = dict(db.results)
        return len(jobs), [(i, results[i.job_id]) for i in db.work_items if i.job_id in keep]


def chosen(items: list[WorkItem], sample: int, seed: int) -> list[WorkItem]:
    """A sample that is the same for the same source; annotations' operators are no code."""

    def place(item: WorkItem) -> tuple[object, ...]:
        one = item.mutations[0]
        return str(one.module_path), one.start_pos, one.operator_name, one.occurrence

    real = [i for i in items if "BitOr" not in i.mutations[0].operator_name]
    return random.Random(seed).sample(sorted(real, key=place), min(sample, len(real)))


def described(item: WorkItem, result: WorkResult) -> str:
    """Where a survivor is and what it changed."""
    one = item.mutations[0]
    lines = [
        x for x in (result.diff or "").splitlines() if x[:1] in "+-" and x[:3] not in ("+++", "---")
    ]
    change = " → ".join(f"`{line[1:].strip()}`" for line in lines)
    return f"| {one.module_path}:{one.start_pos[0]} | {change} | |"


def written(
    rows: list[tuple[str, int, int, int]], survivors: list[str], seed: int
) -> Iterator[str]:
    """The page, line by line."""
    yield from ("# Mutants", "", f"`make mutants`, cosmic-ray, seed {seed}.", "")
    yield from ("| package | mutants in all | sampled | killed |", "|---|---|---|---|")
    for package, total, count, killed in rows:
        yield f"| `{package}` | {total} | {count} | {killed} ({killed / max(count, 1):.0%}) |"
    yield from ("", "| survivor | change | reason |", "|---|---|---|", *survivors, "")


if __name__ == "__main__":
    sys.exit(main())
