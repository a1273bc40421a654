"""Mutation testing by cosmic-ray: does a test fail when one operator or number is changed?

    python tools/mutants.py record [TESTS …]        which test executes which line: 20 minutes
    python tools/mutants.py run [--sample N] [--seed S] [--only PACKAGE …] [--out FILE]

``record`` runs the tests (all that are not slow, or those named, on top of what is known) under
coverage. ``run`` draws N places of the packages below, one mutant each, and runs those tests that
execute its lines, the most specific and the cheapest first, until one fails or about 80 recorded
seconds are spent. What is no behaviour is not drawn: annotations, messages of errors, plots,
sketches and words, and whole constants of a module above two (one sample more is as good a choice).
Both work on a copy in ``build/mutants``, made by the first ``record``.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import random
import re
import resource
import signal
import subprocess
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from shutil import copytree, ignore_patterns
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import coverage

ROOT = Path(__file__).parents[1]
HOME = ROOT / "build" / "mutants"
COPY, DATA, TIMES = HOME / "copy", HOME / "coverage", HOME / "times.json"
ALL = HOME / "all.sqlite"
PACKAGES = ("rom", "spice", "parts", "sim", "workflow/verify")
LEFT_OUT = ("tests/clients", "tests/benchmarks", "tests/gallery/test_readme.py",
            "tests/gallery/test_site.py", "tests/gallery/test_examples.py")  # fmt: skip
SAID = re.compile(r"\w*(Error|Warning)|warn|progress|stage|LeftOut|Note|Figure|Panel|Curve|Line2D")
WORDS = {"figures", "sketch", "left_out", "modelled", "notes", "__str__", "__repr__", "hint"}
DRAWN = {"kicad_sheet", "plotscript"}  # where things lie on a sheet
FORMAL = {"dataclass", "lru_cache", "cache", "Field"}
ROUNDS = (15.0, 80.0)  # recorded seconds of tests: first, then for survivors
MOST = 200  # tests of a round
ALIKE = 3  # cases of one test before those of others
START_UP = 0.5  # s; tests that take less are equally cheap
SLOWER, START = 3.0, 30.0  # times the CPU time, and seconds more, that a mutant may take
WAITED = 8.0  # times that of wall time: other programs may run beside
MEMORY = 6 << 30  # bytes


@dataclass(frozen=True)
class Mutant:
    """A change of one place, what became of it and which test found it."""

    path: str
    line: int
    operator: str
    occurrence: int
    change: str
    killed: bool
    by: str
    seconds: float


def main() -> int:
    """Record, or draw and run."""
    plain = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=plain)
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("record").add_argument("tests", nargs="*")
    run = commands.add_parser("run")
    run.add_argument("--sample", type=int, default=100, help="mutants of all packages together")
    run.add_argument("--seed", type=int, default=1)
    run.add_argument(
        "--only", nargs="*", default=list(PACKAGES), help="packages, or modules like rom/pencil.py"
    )
    run.add_argument("--again", type=Path, help="run the survivors of this earlier --out")
    run.add_argument("--out", type=Path, default=HOME / "mutants.json")
    asked = parser.parse_args()
    if asked.command == "record":
        return record(asked.tests)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # puts the mutated source back
    drawn = draw(asked.only, asked.sample, asked.seed)
    if asked.again:
        alive = {(m["path"], m["operator"], m["occurrence"])
                 for m in json.loads(asked.again.read_text()) if not m["killed"]}  # fmt: skip
        drawn = [item for item in drawn if (item.path, item.operator, item.occurrence) in alive]
    done = []
    for mutant in map(judged(), drawn):
        done.append(mutant)
        asked.out.write_text(json.dumps([asdict(each) for each in done], indent=1))
        print("killed  " if mutant.killed else "SURVIVED", mutant.path, mutant.line, mutant.change,
              mutant.by, f"{mutant.seconds:.0f} s", flush=True)  # fmt: skip
    print(*page(done, asked.seed), sep="\n")
    return 0


def record(tests: list[str]) -> int:
    """Run ``tests`` under coverage; with none named, all, from the beginning."""
    HOME.mkdir(parents=True, exist_ok=True)
    for known in (ALL, *(() if tests else (DATA, TIMES))):
        known.unlink(missing_ok=True)
    skip = ignore_patterns(".git", ".venv", "build", "out", "__pycache__", ".*_cache")
    copytree(ROOT, COPY, ignore=skip, dirs_exist_ok=True)
    hashed = ["-m", "compileall", "-q", "--invalidation-mode", "checked-hash", "kc2spice"]
    subprocess.run([sys.executable, *hashed], cwd=COPY, check=True)
    command = [sys.executable, "-m", "coverage", "run", "--source=kc2spice"]
    command += ["--append"] if tests else []
    command += ["-m", "pytest", "-q", "-m", "not slow", "-p", "which_tests"]
    command += ["-p", "no:cacheprovider", *(f"--ignore={each}" for each in LEFT_OUT), *tests]
    path = os.pathsep.join([str(COPY), str(COPY / "tools")])
    environment = {"PYTHONPATH": path, "COVERAGE_FILE": str(DATA), "TIMES": str(TIMES)}
    return subprocess.run(command, cwd=COPY, env=os.environ | environment, check=False).returncode


# ----------------------------------------------------------------------------------- drawing


@dataclass(frozen=True)
class Item:
    """A mutant to run: its operator is asked for its ``occurrence`` in the module."""

    path: str
    line: int
    last: int
    operator: str
    occurrence: int


def draw(packages: list[str], sample: int, seed: int) -> list[Item]:
    """One mutant of each of ``sample`` places; the same for the same source."""
    from cosmic_ray.commands.init import init
    from cosmic_ray.work_db import WorkDB, use_db

    files = [path for each in packages for path in _modules(each)]
    texts = {path: path.read_text(encoding="utf-8") for path in files}
    places = defaultdict(list)
    whole = sorted(packages) == sorted(PACKAGES)
    found_before = ALL if whole else ALL.with_name("some.sqlite")
    if not (whole and ALL.exists()):  # finding all takes minutes
        part = ALL.with_suffix(".part")
        with use_db(str(part), WorkDB.Mode.create) as database:
            init(sorted(files), database, {})
        part.rename(found_before)
    with use_db(str(found_before), WorkDB.Mode.open) as database:
        for item in database.work_items:
            one = item.mutations[0]
            if Path(one.module_path) in texts:
                places[Path(one.module_path), one.start_pos, one.end_pos].append(one)
    quiet = {path: list(_no_behaviour(text)) for path, text in texts.items()}
    real = sorted(key for key in places if not any(a <= key[1] < b for a, b in quiet[key[0]]))
    rng = random.Random(seed)
    print(f"{len(real)} places of {len(places)}", flush=True)
    found = []
    for place in rng.sample(real, min(sample, len(real))):
        several = sorted(places[place], key=lambda m: (m.operator_name, m.occurrence))
        one = rng.choice(several)
        path, (line, _), (last, _) = place
        name = str(path.relative_to(COPY))
        found.append(Item(name, line, last, one.operator_name, one.occurrence))
    return found


def _modules(package: str) -> list[Path]:
    folder = COPY / "kc2spice" / package
    every = [folder] if folder.suffix else folder.rglob("*.py")
    return sorted(path for path in every if path.stem not in DRAWN)


def _no_behaviour(text: str) -> Iterator[tuple[tuple[int, int], tuple[int, int]]]:
    """From where to where nothing is drawn."""

    def span(node: ast.AST | None) -> Iterator[tuple[tuple[int, int], tuple[int, int]]]:
        if node is not None:
            yield (node.lineno, node.col_offset), (node.end_lineno, node.end_col_offset)

    tree = ast.parse(text)
    for node in ast.walk(tree):
        if isinstance(node, ast.AnnAssign | ast.arg):
            yield from span(node.annotation)
        if isinstance(node, ast.FunctionDef):
            yield from span(node.returns)
            for decorator in node.decorator_list:
                (line, column), end = next(span(decorator))
                yield (line, column - 1), end
            if node.name in WORDS:
                yield from span(node)
        if isinstance(node, ast.ClassDef):
            for decorator in node.decorator_list:
                (line, column), end = next(span(decorator))
                yield (line, column - 1), end
        if isinstance(node, ast.Raise | ast.Assert):
            yield from span(node)
        if isinstance(node, ast.Call):
            name = getattr(node.func, "attr", getattr(node.func, "id", ""))
            if SAID.fullmatch(name) or name in FORMAL:
                yield from span(node)
        if isinstance(node, ast.If) and getattr(node.test, "id", "") == "TYPE_CHECKING":
            yield from span(node)
    for node in tree.body:  # one sample more or less is as good a choice
        if isinstance(node, ast.Assign):
            for each in ast.walk(node.value):
                value = getattr(each, "value", None)
                if isinstance(value, int) and value > 2:
                    yield from span(each)


def _difference(before: str, after: str) -> str:
    old, new = before.splitlines(), after.splitlines()
    if len(old) != len(new):
        return "a line fewer"
    pairs = [(a.strip(), b.strip()) for a, b in zip(old, new, strict=True) if a != b]
    return "; ".join(f"`{a}` → `{b}`" for a, b in pairs)


# ----------------------------------------------------------------------------------- running


def judged():
    """``Item -> Mutant``, by the tests that were recorded."""
    import coverage
    from cosmic_ray.mutating import use_mutation
    from cosmic_ray.plugins import get_operator

    data = coverage.CoverageData(basename=str(DATA))
    data.read()
    measured = {f"kc2spice/{n.rpartition('/kc2spice/')[2]}": n for n in data.measured_files()}
    known = recorded(data)
    _preload()

    def judge(item: Item) -> Mutant:
        started = time.perf_counter()
        lines = data.contexts_by_lineno(measured.get(item.path, item.path))
        tests = chosen(lines, item, known)
        operator = get_operator(item.operator)()
        killed, by = False, "no test executes it"
        with use_mutation(COPY / item.path, operator, item.occurrence) as texts:
            change = _difference(*texts)
            for each in tests:
                killed, by = _fails(each, known.limit(each))
                if killed:
                    break
        spent = time.perf_counter() - started
        return Mutant(
            item.path, item.line, item.operator, item.occurrence, change, killed, by, spent
        )

    return judge


def chosen(lines: dict[int, list[str]], item: Item, known: Recorded) -> Iterator[list[str]]:
    """Tests of each round. What a test's fixtures execute concerns its whole file; what an import
    executes concerns all tests of the module.

    First come those that execute little else and are cheap: a test of few lines looks at them. Of
    the cases of one test a few come first; the rest follows while the time allows.
    """
    own = {c for k in range(item.line, item.last + 1) for c in lines.get(k, []) if c}
    own = own or {context for each in lines.values() for context in each if context}
    files = {c.partition("::")[0] for c in own if c.endswith("|setup")}
    exact = {context.rpartition("|")[0] for context in own}
    tests = {t for t in known.seconds if t in exact or t.partition("::")[0] in files}
    counts: Counter[str] = Counter()
    ranked = []
    for test in sorted(tests, key=lambda each: (known.rank(each), each)):
        counts[name := test.partition("[")[0]] += 1
        ranked.append(((counts[name] > ALIKE, test not in exact), test))
    queue = [test for _, test in sorted(ranked, key=lambda pair: pair[0])]
    ready: set[str] = set()  # files whose fixtures are paid for
    for limit in ROUNDS:
        round_: list[str] = []
        spent = 0.0
        for test in list(queue):
            file = test.partition("::")[0]
            cost = known.seconds[test] + (file not in ready) * known.fixtures(file)
            if spent + cost > limit or len(round_) == MOST:
                continue
            spent += cost
            ready.add(file)
            round_.append(test)
            queue.remove(test)
        if round_:
            yield round_
        ready.clear()


@dataclass(frozen=True)
class Recorded:
    """Seconds of each test, and of ``FILE|setup``; how many lines of the package each executes."""

    seconds: dict[str, float]
    lines: Counter[str]

    def fixtures(self, file: str) -> float:
        """Seconds until the fixtures of a test file are set up."""
        return self.seconds.get(f"{file}|setup", 0.0)

    def rank(self, test: str) -> float:
        """Small for what is specific and cheap; what takes less than START_UP is cheap."""
        file = test.partition("::")[0]
        return self.lines[test] * (START_UP + self.seconds[test] + self.fixtures(file))

    def limit(self, tests: list[str]) -> float:
        """CPU seconds after which ``tests`` hang."""
        files = {test.partition("::")[0] for test in tests}
        spent = sum(self.seconds[test] for test in tests) + sum(map(self.fixtures, files))
        return SLOWER * spent + START


def recorded(data: coverage.CoverageData) -> Recorded:
    """What ``record`` found; what fixtures execute counts for each test of the file."""
    own: Counter[str] = Counter()
    for file in data.measured_files():
        for contexts in data.contexts_by_lineno(file).values():
            own.update({context.rpartition("|")[0] for context in contexts if context})
    return Recorded(json.loads(TIMES.read_text()), own)


def _preload() -> None:
    """What every test imports and no mutant changes: children inherit it."""
    import gmsh  # noqa: F401
    import hypothesis  # noqa: F401
    import matplotlib.figure  # noqa: F401
    import numpy  # noqa: F401
    import pydantic  # noqa: F401
    import pytest  # noqa: F401
    import scipy.integrate
    import scipy.interpolate
    import scipy.io
    import scipy.optimize
    import scipy.sparse.linalg
    import scipy.spatial  # noqa: F401
    import skfem  # noqa: F401
    import typer.testing  # noqa: F401


def _fails(tests: list[str], limit: float) -> tuple[bool, str]:
    """Whether one of ``tests`` fails, and which; a mutant that hangs fails too."""
    log = HOME / "mutant.log"
    child = os.fork()
    if child == 0:
        _child(tests, log, int(limit))
    deadline = time.monotonic() + WAITED * limit
    while time.monotonic() < deadline:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            found = re.search(r"(?m)^(?:FAILED|ERROR) (\S+)", log.read_text(errors="replace"))
            code = os.waitstatus_to_exitcode(status)
            return code != 0, found[1] if found else f"exit code {code}" if code else ""
        time.sleep(0.05)
    os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return True, "time"


def _child(tests: list[str], log: Path, limit: int) -> None:
    import pytest

    os.setsid()
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CPU, (limit, limit))
    with log.open("w") as file:
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)
    os.chdir(COPY)
    sys.dont_write_bytecode = True
    sys.path.insert(0, str(COPY))
    os.environ |= {"PYTHONPATH": str(COPY), "KC2SPICE_CACHE": str(HOME / "cache")}
    code = pytest.main(["-q", "-x", "-p", "no:cacheprovider", *tests])
    sys.stdout.flush()
    os._exit(int(code))


def page(done: list[Mutant], seed: int) -> Iterator[str]:
    """Tables of the scores and of the survivors."""
    yield from (f"Seed {seed}:", "", "| package | mutants | killed |", "|---|---|---|")
    for package in PACKAGES:
        own = [m.killed for m in done if m.path.startswith(f"kc2spice/{package}/")]
        yield f"| `{package}` | {len(own)} | {sum(own)} |"
    killed = sum(m.killed for m in done)
    yield f"| all | {len(done)} | {killed} ({killed / max(len(done), 1):.0%}) |"
    yield from ("", "| survivor | change | reason |", "|---|---|---|")
    yield from (f"| {m.path}:{m.line} | {m.change} | |" for m in done if not m.killed)


if __name__ == "__main__":
    sys.exit(main())
