"""Mutation testing by cosmic-ray: does a test fail when one operator or number is changed?

    python tools/mutants.py record [FILE …]         which test executes which line
    python tools/mutants.py run [--sample N] [--seed S] [--only PACKAGE …] [--again]

``record`` runs the test files that are not slow (or those named, anew) under coverage, in a process
each, on all cores, the program's own processes included; killed, it goes on where it was.
``run`` draws N places of the packages below, one mutant each, and runs those tests that execute
its lines, the most specific and the cheapest first, until one fails or about 80 recorded seconds
are spent; as many mutants at once as there are cores. Killed, it goes on too; ``--again`` gives
the survivors another try. What is no behaviour is not drawn: annotations, messages of errors,
plots, sketches and words, whole constants of a module above two (one sample more is as good a
choice), assertions (``zip(strict=…)`` too), and identity instead of equality. Both work on copies
in ``build/mutants``, made by the first ``record``; remove that folder to begin with another source.
"""

from __future__ import annotations

import argparse
import ast
import json
import multiprocessing
import os
import random
import re
import resource
import signal
import subprocess
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from pathlib import Path
from shutil import copyfile, copytree, ignore_patterns
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import coverage

ROOT = Path(__file__).parents[1]
HOME = (ROOT / "build" / "mutants").resolve()  # coverage notes real paths
COPY, DATA = HOME / "copy", HOME / "recorded"
ALL = HOME / "all.sqlite"
FOLDERS = ("unit", "physics", "spice", "gallery")
# physics, realisation and certificate
PACKAGES = ("fem", "rom", "synthesis", "equations", "reference", "workflow/verify")
NO_PYTHON = "no Python"  # such a mutant is not counted
LEFT_OUT = ("tests/clients", "tests/benchmarks", "tests/gallery/test_readme.py",
            "tests/gallery/test_site.py", "tests/gallery/test_examples.py")  # fmt: skip
SAID = re.compile(
    r"\w*(Error|Warning)|warn|progress|stage|Neglected|Note|Figure|Panel|Curve|Line2D"
)
WORDS = {"figures", "sketch", "left_out", "modelled", "notes", "__str__", "__repr__", "hint"}
DRAWN = {"kicad"}  # where things lie on a sheet
SAME = re.compile(r"_(Eq_Is|Is_Eq|NotEq_IsNot|IsNot_NotEq)$")  # of short texts and numbers
FORMAL = {"dataclass", "lru_cache", "cache", "_line"}  # the last are strokes of symbols
FIRST, MORE = 15.0, 80.0  # recorded seconds of tests: first, then for survivors
MOST = 200  # tests of a round
ALIKE, QUICK = 3, 20  # cases of one test before those of others; of those that are quick
START_UP = 0.5  # s; tests that take less are equally cheap
SLOWER, START = 3.0, 30.0  # times the CPU time, and seconds more, that a mutant may take
WAITED = 8.0  # times that of wall time: other programs may run beside
MEMORY = 6 << 30  # bytes
LONGEST = 1800.0  # s of CPU for a file of tests
Place = tuple[str, str, int]


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

    @property
    def place(self) -> Place:
        """Identification: path, operator, occurrence."""
        return self.path, self.operator, self.occurrence


def main() -> int:
    """Record, or draw and run."""
    plain = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=plain)
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("record").add_argument("files", nargs="*")
    run = commands.add_parser("run")
    run.add_argument("--sample", type=int, default=100, help="mutants of all packages together")
    run.add_argument("--seed", type=int, default=1)
    run.add_argument(
        "--only", nargs="*", default=list(PACKAGES), help="packages, or modules like rom/pencil.py"
    )
    run.add_argument("--more", type=float, default=MORE, help="recorded s of tests for survivors")
    run.add_argument("--again", action="store_true", help="try those anew that survived")
    run.add_argument("--out", type=Path, help="JSON file; it is gone on with")
    asked = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # puts the mutated source back
    if asked.command == "record":
        return record(asked.files)
    out = asked.out or HOME / f"mutants_{asked.seed}.json"
    drawn = draw(asked.only, asked.sample, asked.seed)
    known = [Mutant(**each) for each in json.loads(out.read_text())] if out.exists() else []
    done = {m.place: m for m in known if m.killed or not asked.again}
    ahead = [item for item in drawn if item.place not in done]
    with TemporaryDirectory(dir=HOME) as work, _workers(_become_judge, work, asked.more) as pool:
        for ended in as_completed([pool.submit(_judged, item) for item in ahead]):
            mutant = ended.result()
            done[mutant.place] = mutant
            out.write_text(json.dumps([asdict(each) for each in done.values()], indent=1))
            found = "killed  " if mutant.killed else "SURVIVED"
            print(f"{len(done)} {found} {mutant.path}:{mutant.line} {mutant.change} "
                  f"{mutant.by} {mutant.seconds:.0f} s", flush=True)  # fmt: skip
    print(*page([done[item.place] for item in drawn], asked.seed), sep="\n")
    return 0


# --------------------------------------------------------------------------------- recording


def record(files: list[str]) -> int:
    """Run the test ``files`` under coverage; with none named, all that are not yet recorded."""
    DATA.mkdir(parents=True, exist_ok=True)
    if not COPY.exists():
        skip = ignore_patterns(".git", ".venv", "build", "out", "__pycache__", ".*_cache")
        copytree(ROOT, part := COPY.with_suffix(".part"), ignore=skip, dirs_exist_ok=True)
        hashed = ["-m", "compileall", "-q", "--invalidation-mode", "checked-hash", "kc2spice"]
        subprocess.run([sys.executable, *hashed], cwd=part, check=True)
        part.rename(COPY)
    for name in files:
        copyfile(ROOT / name, COPY / name)
        _recorded_in(name).unlink(missing_ok=True)
    every = [str(path.relative_to(COPY)) for folder in FOLDERS
             for path in sorted((COPY / "tests" / folder).glob("test_*.py"))]  # fmt: skip
    ahead = [name for name in every if name not in LEFT_OUT and not _recorded_in(name).exists()]
    with _workers() as pool:
        for k, ended in enumerate(as_completed([pool.submit(_record_one, n) for n in ahead]), 1):
            print(f"{k}/{len(ahead)} {ended.result()}", flush=True)
    return 0


def _record_one(name: str) -> str:
    started = time.perf_counter()
    log = _recorded_in(name).with_suffix(".log")
    code = _forked(lambda: _under_coverage(name), COPY, LONGEST, log)
    known = json.loads(_recorded_in(name).read_text()) if code is not None else {}
    return f"{name}: {len(known)} tests, {time.perf_counter() - started:.0f} s"


def _recorded_in(file: str) -> Path:
    """Seconds and number of lines of each test of a file; beside it lies the data of coverage."""
    return DATA / (file.removeprefix("tests/").removesuffix(".py").replace("/", ".") + ".json")


def _under_coverage(file: str) -> int:
    import coverage
    import pytest
    import which_tests

    data = _recorded_in(file).with_suffix(".coverage")
    for old in data.parent.glob(data.name + "*"):
        old.unlink()
    start = data.with_suffix(".start")  # every process that the test starts measures itself
    start.mkdir(exist_ok=True)
    (start / "sitecustomize.py").write_text("import coverage\ncoverage.process_startup()\n")
    sources = ",".join(str(COPY / "kc2spice" / each) for each in PACKAGES)
    settings = start / "coverage.ini"
    settings.write_text(f"[run]\nsource = {sources}\ndata_file = {data}\nparallel = true\n"
                        "core = ctrace\ncontext = ${WHICH_TEST-}\n")  # fmt: skip
    os.environ["PYTHONPATH"] = os.pathsep.join([str(start), str(COPY)])
    os.environ |= {"COVERAGE_PROCESS_START": str(settings), "WHICH_TEST": ""}
    measuring = coverage.Coverage(config_file=str(settings))
    measuring.start()
    code = pytest.main(["-q", "-m", "not slow", "-p", "no:cacheprovider", file], [which_tests])
    measuring.stop()
    measuring.save()
    whole = coverage.Coverage(data_file=str(data), config_file=False)
    whole.combine([str(part) for part in data.parent.glob(data.name + ".*")])
    whole.save()
    own: Counter[str] = Counter()
    for path in whole.get_data().measured_files():
        for contexts in whole.get_data().contexts_by_lineno(path).values():
            own.update({context.rpartition("|")[0] for context in contexts if context})
    known = {test: [spent, own[test]] for test, spent in which_tests.seconds().items()}
    _recorded_in(file).write_text(json.dumps(known))
    return int(code)


# ----------------------------------------------------------------------------------- drawing


@dataclass(frozen=True)
class Item:
    """A mutant to run: its operator is asked for its ``occurrence`` in the module."""

    path: str
    line: int
    last: int
    operator: str
    occurrence: int

    @property
    def place(self) -> Place:
        """Identification of a mutant: path, operator, occurrence."""
        return self.path, self.operator, self.occurrence


def draw(packages: list[str], sample: int, seed: int) -> list[Item]:
    """One mutant of each of ``sample`` places; the same for the same source."""
    from cosmic_ray.commands.init import init
    from cosmic_ray.work_db import WorkDB, use_db

    files = [path for each in packages for path in _modules(each)]
    texts = {path: path.read_text(encoding="utf-8") for path in files}
    places = defaultdict(list)
    whole = sorted(packages) == sorted(PACKAGES)
    found_before = ALL if whole else ALL.with_suffix(f".{os.getpid()}")
    if not (whole and ALL.exists()):  # finding all takes minutes
        part = ALL.with_suffix(f".part{os.getpid()}")
        with use_db(str(part), WorkDB.Mode.create) as database:
            init(sorted(files), database, {})
        part.rename(found_before)
    with use_db(str(found_before), WorkDB.Mode.open) as database:
        for item in database.work_items:
            one = item.mutations[0]
            if Path(one.module_path) in texts and not SAME.search(one.operator_name):
                places[Path(one.module_path), one.start_pos, one.end_pos].append(one)
    if not whole:
        found_before.unlink()
    quiet = {path: list(_no_behaviour(text)) for path, text in texts.items()}
    real = sorted(key for key in places if not any(a <= key[1] < b for a, b in quiet[key[0]]))
    print(f"{len(real)} places of {len(places)}", flush=True)
    found = []
    for k, place in enumerate(random.Random(seed).sample(real, min(sample, len(real)))):
        several = sorted(places[place], key=lambda m: (m.operator_name, m.occurrence))
        # a larger sample goes on with a smaller
        one = random.Random(f"{seed} {k}").choice(several)
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

    def span(node: Any) -> Iterator[tuple[tuple[int, int], tuple[int, int]]]:
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
        if isinstance(node, ast.keyword) and node.arg == "strict":
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


def _workers(first: Callable[..., None] | None = None, *words: Any) -> ProcessPoolExecutor:
    """A process for each core, with the libraries that every test imports."""
    _preload()
    fork = multiprocessing.get_context("fork")
    return ProcessPoolExecutor(len(os.sched_getaffinity(0)), fork, first, words)


_judged_by: Callable[[Item], Mutant]


def _become_judge(work: str, more: float) -> None:
    global _judged_by
    _judged_by = judged((FIRST, more), Path(work) / str(os.getpid()))


def _judged(item: Item) -> Mutant:
    return _judged_by(item)


def judged(rounds: tuple[float, ...], folder: Path) -> Callable[[Item], Mutant]:
    """``Item -> Mutant``, by the tests that were recorded, in a ``folder`` of its own."""
    from cosmic_ray.mutating import use_mutation
    from cosmic_ray.plugins import get_operator

    known = recorded()
    copytree(COPY, folder)

    def judge(item: Item) -> Mutant:
        started = time.perf_counter()
        tests = chosen(known.contexts(item.path), item, known, rounds)
        operator = get_operator(item.operator)()
        killed, by = False, "no test executes it"
        try:
            with use_mutation(folder / item.path, operator, item.occurrence) as texts:
                change = _difference(*texts)
                if _is_python(texts[1]):
                    for each in tests:
                        killed, by = _fails(each, known.limit(each), folder)
                        if killed:
                            break
                else:
                    killed, by = True, NO_PYTHON
        except AttributeError:  # of cosmic-ray, for a dotted name in a tuple of exceptions
            change, killed, by = item.operator, True, NO_PYTHON
        spent = time.perf_counter() - started
        return Mutant(
            item.path, item.line, item.operator, item.occurrence, change, killed, by, spent
        )

    return judge


def _is_python(text: str) -> bool:
    try:
        compile(text, "mutant", "exec")
    except SyntaxError:
        return False
    return True


def chosen(
    lines: dict[int, list[str]], item: Item, known: Recorded, rounds: tuple[float, ...]
) -> Iterator[list[str]]:
    """Tests of each round. What a test's fixtures execute concerns its whole file.

    First come those that execute little else and are cheap: a test of few lines looks at them. Of
    the cases of one test a few come first; the rest follows while the time allows.
    """
    text = (COPY / item.path).read_text(encoding="utf-8")
    at, names = _concerned(text, item.line, item.last)
    names |= {Path(item.path).stem} if names else set()
    own = {c for k in at for c in lines.get(k, []) if c}
    own = own or {context for each in lines.values() for context in each}
    files = {c.partition("::")[0] for c in own if c.endswith("|setup")}
    files = {file.removesuffix("|setup") for file in files}
    exact = {context.rpartition("|")[0] for context in own}
    tests = {t for t in known.seconds if t in exact or t.partition("::")[0] in files}
    said = {file: sum(name in (COPY / file).read_text(encoding="utf-8") for name in names)
            for file in {test.partition("::")[0] for test in tests}}  # fmt: skip
    counts: Counter[str] = Counter()
    ranked = []
    for test in sorted(tests, key=lambda each: (known.rank(each), each)):
        counts[name := test.partition("[")[0]] += 1
        first = -said[test.partition("::")[0]]
        most = ALIKE if known.seconds[test] > START_UP else QUICK
        ranked.append(((counts[name] > most, first, test not in exact), test))
    queue = [test for _, test in sorted(ranked, key=lambda pair: pair[0])]
    ready: set[str] = set()  # files whose fixtures are paid for
    for limit in rounds:
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


def _concerned(text: str, first: int, last: int) -> tuple[set[int], set[str]]:
    """Lines whose execution shows a change of the lines ``first`` to ``last``: of a signature the
    function's body, of an assignment that an import executes those that name its target. For
    what an import executes also the words by which a test file speaks of it."""
    at = set(range(first, last + 1))
    names: set[str] = set()
    targets: set[str] = set()
    for node in ast.walk(ast.parse(text)):
        if not isinstance(node, ast.stmt) or not node.lineno <= first <= (node.end_lineno or 0):
            continue
        if isinstance(node, ast.FunctionDef):
            if first >= node.body[0].lineno:
                return at, set()
            at |= set(range(node.body[0].lineno, (node.end_lineno or 0) + 1))
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.add(node.name)
        if isinstance(node, ast.Assign | ast.AnnAssign):
            several = node.targets if isinstance(node, ast.Assign) else [node.target]
            targets |= {n.id for each in several for n in ast.walk(each) if isinstance(n, ast.Name)}
    if targets:
        word = re.compile(rf"\b({'|'.join(targets)})\b")
        at |= {k for k, line in enumerate(text.splitlines(), 1) if word.search(line)}
    return at, names | targets


@dataclass(frozen=True)
class Recorded:
    """Seconds of each test, and of ``FILE|setup``; how many lines of the packages each executes."""

    seconds: dict[str, float]
    lines: dict[str, int]
    data: dict[str, coverage.CoverageData]

    def contexts(self, module: str) -> dict[int, list[str]]:
        """Which tests, with their stage, execute each line of a module."""
        found = defaultdict[int, list[str]](list)
        for file, data in self.data.items():  # without a test it is the file's import
            for line, contexts in data.contexts_by_lineno(str(COPY / module)).items():
                found[line] += [context or f"{file}|setup" for context in contexts]
        return found

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


def recorded() -> Recorded:
    """Results of ``record``; lines that fixtures execute count for each test of the file."""
    import coverage

    files = sorted(DATA.glob("*.json"))
    known: dict[str, tuple[float, int]] = {}
    data = {}
    for file in files:
        known |= json.loads(file.read_text())
        name = "tests/" + file.stem.replace(".", "/") + ".py"
        data[name] = coverage.CoverageData(basename=str(file.with_suffix(".coverage")))
        data[name].read()
    seconds = {test: spent for test, (spent, _) in known.items()}
    return Recorded(seconds, {test: count for test, (_, count) in known.items()}, data)


def _preload() -> None:
    """Import modules that every test uses and no mutant changes; child processes inherit them."""
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


def _fails(tests: list[str], limit: float, folder: Path) -> tuple[bool, str]:
    """Whether one of ``tests`` fails, and which; a mutant that hangs fails too."""
    log = folder / "mutant.log"

    def run() -> int:
        import pytest

        os.environ |= {"PYTHONPATH": str(folder), "KC2SPICE_CACHE": str(HOME / "cache")}
        return int(pytest.main(["-q", "-x", "-p", "no:cacheprovider", *tests]))

    code = _forked(run, folder, limit, log)
    found = re.search(r"(?m)^(?:FAILED|ERROR) (\S+)", log.read_text(errors="replace"))
    if code is None:
        return True, "time"
    return code != 0, found[1] if found else f"exit code {code}" if code else ""


def _forked(job: Callable[[], int], folder: Path, limit: float, log: Path) -> int | None:
    """Exit code of ``job`` in a process of its own, in ``folder``; None if it had to be ended."""
    child = os.fork()
    if child == 0:
        os.setsid()
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
        resource.setrlimit(resource.RLIMIT_CPU, (int(limit), int(limit)))
        with log.open("w") as file:
            os.dup2(file.fileno(), 1)
            os.dup2(file.fileno(), 2)
        os.chdir(folder)
        sys.dont_write_bytecode = True
        sys.path.insert(0, str(folder))
        code = job()
        sys.stdout.flush()
        os._exit(code)
    deadline = time.monotonic() + WAITED * limit
    try:
        while time.monotonic() < deadline:
            done, status = os.waitpid(child, os.WNOHANG)
            if done:
                return os.waitstatus_to_exitcode(status)
            time.sleep(0.05)
    except SystemExit:
        os.killpg(child, signal.SIGKILL)
        raise
    os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return None


def page(done: list[Mutant], seed: int) -> Iterator[str]:
    """Tables of the scores and of the survivors."""
    done = [m for m in done if m.by != NO_PYTHON]
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
