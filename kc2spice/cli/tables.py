"""What a person sees in the terminal: progress on stderr, results, verdicts, plans, keys and
findings as tables on stdout, errors in one block.
"""

from __future__ import annotations

import contextlib
import json
import os
import shlex
import sys
import textwrap
import time
import traceback
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from kc2spice.core.errors import Kc2spiceError, SimulationError, UsageError
from kc2spice.core.files import FULL
from kc2spice.core.progress import Progress, silent

if TYPE_CHECKING:
    from kc2spice.cli.doctor import Finding
    from kc2spice.report.html import Section
    from kc2spice.scene.keys import Key, PartDoc
COLUMNS = 80  # of what is piped
_EVERY = 10.0  # s between two lines of progress of one stage
INTERRUPTED = 130  # what a shell reports after Ctrl-C


@dataclass(frozen=True)
class Caller:
    """Who gave a command: a program that asked for JSON, a person, or one who wants it quiet."""

    as_json: bool
    quiet: bool

    def progress(self) -> AbstractContextManager[Progress]:
        """Shows the progress of a block."""
        return shown_progress(self.quiet)

    def note(self, text: str) -> None:
        """A line beside the answer."""
        if not self.quiet:
            print(text, file=sys.stderr)

    def answer(self, record: Any, show: Callable[[], None], out: Path | None = None) -> None:
        """``record`` and its directory ``out`` as JSON, or what ``show`` prints of it."""
        if self.as_json and out is not None:
            record = {**record, "directory": str(out.absolute())}
        if self.as_json:
            print(json.dumps(record))
        elif not self.quiet:
            show()


def shown_progress(quiet: bool) -> AbstractContextManager[Progress]:
    """Progress bars in a terminal, one line for each stage elsewhere, nothing when quiet."""
    if not quiet and sys.stderr.isatty():
        return _bars()
    return nullcontext(silent if quiet else _Lines())


@contextmanager
def _bars() -> Iterator[Progress]:
    """One bar for each stage; that of an earlier one is full."""
    from rich import progress as rich
    from rich.console import Console

    stage, text = "{task.fields[stage]:<10}", rich.TextColumn("{task.description}", markup=False)
    left = (rich.SpinnerColumn(), rich.TextColumn(stage), rich.BarColumn(24))
    right = (rich.TimeElapsedColumn(), text)
    with rich.Progress(*left, *right, console=Console(stderr=True)) as bars:

        def fill() -> None:
            for task in bars.tasks:
                bars.update(task.id, total=1, completed=1)

        def show(stage: str, done: float | None, text: str) -> None:
            tasks = {task.fields["stage"]: task.id for task in bars.tasks}
            if stage not in tasks:
                fill()
                tasks[stage] = bars.add_task(text, total=None, stage=stage)
            total = None if done is None else 1.0
            bars.update(tasks[stage], description=text, total=total, completed=done or 0.0)

        yield show
        fill()


class _Lines:
    """For logs and pipes: a line when a stage begins, then what has changed now and then."""

    def __init__(self) -> None:
        self._stage, self._text, self._last = "", "", 0.0

    def __call__(self, stage: str, done: float | None, text: str) -> None:
        late = time.monotonic() - self._last > _EVERY or done == 1.0
        if stage != self._stage or (late and text != self._text):
            self._stage, self._text, self._last = stage, text, time.monotonic()
            print(f"{stage}: {text}", file=sys.stderr, flush=True)


@contextmanager
def reported_errors() -> Iterator[None]:
    """Turn exceptions into one message and the exit code of the contract."""
    warnings.showwarning = _show_warning
    try:
        yield
        sys.stdout.flush()  # what cannot be written is told here, not by the interpreter's end
    except Kc2spiceError as error:
        _fail(str(error))
        raise typer.Exit(error.exit_code) from None
    except KeyboardInterrupt:
        _fail("interrupted; nothing was written")
        raise typer.Exit(INTERRUPTED) from None
    except BrokenPipeError:  # the reader of a pipe left, as in `kc2spice scenes | head`
        _drop_stdout()
        raise typer.Exit(0) from None
    except typer.Exit:
        raise
    except MemoryError:
        _fail("the memory is exhausted\n  next:     a coarser mesh, fewer points or more memory")
        raise typer.Exit(SimulationError.exit_code) from None
    except Exception as error:
        if isinstance(error, OSError) and error.errno in FULL:
            _drop_stdout()
            _fail(f"cannot be written: {error.strerror}\n  next:     free some space")
            raise typer.Exit(UsageError.exit_code) from None
        if os.environ.get("KC2SPICE_DEBUG"):
            traceback.print_exc()
        detail = f"{type(error).__name__}: {error}".splitlines()[0]
        _fail(f"internal error: {detail}\n  next:     set KC2SPICE_DEBUG=1 for the details")
        raise typer.Exit(SimulationError.exit_code) from None


def _drop_stdout() -> None:
    """What is still to be written goes nowhere."""
    with contextlib.suppress(OSError, ValueError):  # a stream without a file
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _fail(text: str) -> None:
    print(f"kc2spice: error: {text}", file=sys.stderr, flush=True)


def _show_warning(message: Any, *_: Any, **__: Any) -> None:
    print(f"kc2spice: warning: {message}", file=sys.stderr, flush=True)


def print_table(
    title: str,
    rows: Sequence[Sequence[str]],
    header: Sequence[str] = (),
    *,
    names: int | None = None,
) -> None:
    """A small table on stdout; plain text where stdout is no terminal.

    The column ``names`` is never broken: what stands there is meant to be searched and copied.
    """
    from rich.console import Console
    from rich.table import Table

    table = Table(title=title, title_justify="left", title_style="bold", box=None, pad_edge=False)
    table.show_header = bool(header)
    for k, name in enumerate(header or [""] * max((len(row) for row in rows), default=0)):
        table.add_column(name, overflow="fold", no_wrap=k == names)
    for row in rows:
        table.add_row(*(cell.replace("[", r"\[") for cell in row))
    width = None if sys.stdout.isatty() else COLUMNS
    Console(width=width).print(table)


def show_sections(sections: Iterable[Section]) -> None:
    """The tables of a page."""
    for section in sections:
        if section.rows:
            rows = [[cell.replace("\u2212", "-") for cell in row] for row in section.rows]
            print_table(section.title, rows, section.head)


def show_result(result: Mapping[str, Any], directory: Path) -> None:
    """What ``run`` found."""
    from kc2spice.report.run_page import result_sections

    show_sections(result_sections(result))
    print_table(f"files in {directory}", [(", ".join(map(str, result["files"])),)])
    for raw in (name for name in result["files"] if name.endswith(".raw")):
        rows = [
            ("ngspice", f"load {raw}, then plot VECTOR"),
            ("Python", f"spicelib.RawRead({raw!r}, dialect='ngspice')"),
        ]
        print_table("viewers of the raw file", rows)


def show_verdicts(found: Mapping[str, Mapping[str, Any]], directory: Path) -> None:
    """What ``verify`` found."""
    from kc2spice.report.pages import verdict_sections

    for name, record in found.items():
        show_sections(verdict_sections(name, record))
        for note in record["notes"]:
            print(f"  {note}")
    print(f"all of it, with errors and plots: {directory / 'verify.html'}")


def show_plan(record: Mapping[str, Any], title: str) -> None:
    """What ``explain`` says."""
    from kc2spice.report.run_page import plan_sections

    print(textwrap.fill(f"{record['scene']}: {title}", COLUMNS))
    print(f"scene hash {record['hash']}\n")
    print_table("joined", [(line,) for line in record["joins"]])
    show_sections(plan_sections(record))
    budget = "X" if record["error_budget"] is None else f"{record['error_budget']:g}"
    told = "refines the settings until every metric's error is below"
    print(f"error_budget = {budget} {told} {budget}\n")
    if step := record["largest_step"]:
        print(textwrap.fill(f"largest step {step['s']:.3g} s: {step['why']}", COLUMNS))


def show_reduced(found: Mapping[str, Any]) -> None:
    """What ``reduce`` made."""
    from kc2spice.report.run_page import above_band

    low, high = found["band_hz"]
    rows = [
        ("equations", f"{found['unknowns']}, {found['form']}"),
        ("states", str(found["order"])),
        ("band", f"{low:g} … {high:g} Hz"),
        ("error estimate", f"{found['error_estimate']:.3g}, {found['norm']}"),
        *above_band(found),
        ("stable", {True: "yes", False: "NO", None: "not known"}[found["stable"]]),
        ("passive", "yes" if found["passive"] else "not shown"),
        ("method", found["method"]),
        ("reduced model", found["rom"]),
    ]
    print_table("reduced model", rows)


def show_bench(record: Mapping[str, Any], given: str, out: Path) -> None:
    """What ``bench`` measured of a scene with overrides, ``given`` as words of the command line."""
    from kc2spice.report.pages import bench_sections

    front = [point for point in record["points"] if point["front"] or point["own"]]
    show_sections(bench_sections({**record, "points": front}))
    if record["recommended"] is not None:
        print(f"kc2spice run {given} {shlex.join(record['recommended']['set'])}".rstrip())
    print(f"all of it: {out / 'bench.html'}")


def show_sweep(result: Mapping[str, Any]) -> None:
    """What ``sweep`` has run."""
    rows = [(name, str(result[name])) for name in ("points", "failed", "resumed", "table")]
    for name, share in result.get("yield", {}).items():
        low, high = share["low"], share["high"]
        rows.append((f"{name}: yield", f"{share['share']:.4g} (95 %: {low:.4g} … {high:.4g})"))
    if result.get("files"):
        rows.append(("files", ", ".join(result["files"])))
    print_table("sweep", rows)


def show_keys(keys: Iterable[Key]) -> None:
    """What ``scenes --keys`` lists."""
    rows = [
        (
            key.name,
            key.unit or "",
            "" if key.default is None else str(key.default),
            " | ".join(key.choices) or key.doc,
        )
        for key in keys
    ]
    print_table("keys of a scene", rows, header=("key", "unit", "default", ""), names=0)


def show_parts(docs: Iterable[PartDoc]) -> None:
    """What ``scenes --parts`` lists."""
    for doc in docs:
        rows = [
            ("pin", pin.name, pin.kind, f"default {pin.default}" if pin.default else "")
            for pin in doc.pins
        ]
        rows += [
            (
                "key",
                key.name,
                key.unit or " | ".join(key.choices),
                "" if key.default is None else f"default {key.default}",
            )
            for key in doc.keys
        ]
        print_table(f"{doc.name}: {doc.title}", rows, names=1)


def show_findings(findings: Iterable[Finding]) -> None:
    """What ``doctor`` found."""
    marks = {(True, True): "ok", (True, False): "ok", (False, True): "MISSING"}
    rows = [
        (marks.get((f.ok, f.needed), "absent"), f.name, f.found, "" if f.ok else f.fix)
        for f in findings
    ]
    print_table("doctor", rows, header=("", "what", "found", "fix"))


def show_fit(found: Mapping[str, Any]) -> None:
    """What ``fit`` found."""
    from kc2spice.report.pages import fit_sections

    show_sections(fit_sections(found))
    print(f"values, for --set: {found['overrides']}\nwith plots: {found['page']}")
