"""Terminal output: progress on stderr, tables on stdout, errors in one block."""

from __future__ import annotations

import contextlib
import json
import os
import sys
import traceback
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import typer

from kc2spice.core.errors import Kc2spiceError, SimulationError, UsageError
from kc2spice.core.files import FULL
from kc2spice.core.progress import ERROR_BUDGET, Progress, silent

if TYPE_CHECKING:
    from kc2spice.report.html import PageSection
COLUMNS = 80  # width of piped output
MOST_METRICS, MOST_ROWS = 9, 13  # metrics and rows of the summary of a run
INTERRUPTED = 130  # exit code of shells after Ctrl-C


@dataclass(frozen=True)
class Caller:
    """The reader of the output: a program (JSON), or a person, with progress or quiet."""

    as_json: bool
    quiet: bool

    def progress(self) -> AbstractContextManager[Progress]:
        """One line for each stage with its elapsed time in a terminal; elsewhere the limits of an
        error budget alone."""
        if not self.quiet and sys.stderr.isatty():
            return _progress_bars()
        return nullcontext(silent if self.quiet or self.as_json else _print_limits)

    def expects_text(self, record: Any, out: Path | None = None) -> bool:
        """Whether it is a person who reads the answer; a program gets ``record`` and its directory
        ``out`` as JSON."""
        if self.as_json:
            more = {} if out is None else {"directory": str(out.absolute())}
            print(json.dumps({**record, **more} if more else record))
        return not (self.as_json or self.quiet)


def _print_limits(stage: str, done: float | None, text: str) -> None:
    """Print the limits of an error budget before the first refinement."""
    if stage == ERROR_BUDGET:
        print(f"{stage}: {text}", file=sys.stderr)


@contextmanager
def _progress_bars() -> Iterator[Progress]:
    """Show one progress bar for each stage; the bars of earlier stages are full."""
    from rich import progress as rich
    from rich.console import Console

    stage, text = "{task.fields[stage]:<10}", rich.TextColumn("{task.fields[text]}", markup=False)
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
                tasks[stage] = bars.add_task("", total=None, stage=stage, text=text)
            total = None if done is None else 1.0
            bars.update(tasks[stage], total=total, completed=done or 0.0, text=text)

        yield show
        fill()


@contextmanager
def reported_errors() -> Iterator[None]:
    """Turn exceptions into one message and the exit code of the contract."""
    warnings.showwarning = lambda message, *_, **__: print(
        f"kc2spice: warning: {message}", file=sys.stderr, flush=True
    )
    try:
        yield
        # so that a full disk is reported as an error before the interpreter ends
        sys.stdout.flush()
    except Kc2spiceError as error:
        _fail(str(error), error.exit_code)
    except KeyboardInterrupt:
        _fail("interrupted; nothing was written", INTERRUPTED)
    except BrokenPipeError:  # the reader of the pipe has ended, as in `kc2spice scenes | head`
        _drop_stdout()
        raise typer.Exit(0) from None
    except typer.Exit:
        raise
    except MemoryError:
        text = "the memory is exhausted\n  next:     a coarser mesh, fewer points or more memory"
        _fail(text, SimulationError.exit_code)
    except Exception as error:
        if isinstance(error, OSError) and error.errno in FULL:
            _drop_stdout()
            text = f"cannot be written: {error.strerror}\n  next:     free some space"
            _fail(text, UsageError.exit_code)
        if os.environ.get("KC2SPICE_DEBUG"):
            traceback.print_exc()
        detail = f"{type(error).__name__}: {error}".splitlines()[0]
        text = f"internal error: {detail}\n  next:     set KC2SPICE_DEBUG=1 for the details"
        _fail(text, SimulationError.exit_code)


def _drop_stdout() -> None:
    """Discard further output."""
    with contextlib.suppress(OSError, ValueError):  # a stream without a file
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _fail(text: str, code: int) -> NoReturn:
    print(f"kc2spice: error: {text}", file=sys.stderr, flush=True)
    raise typer.Exit(code) from None


def print_table(
    title: str, rows: Sequence[Sequence[str]], header: Sequence[str] = (), names: int | None = None
) -> None:
    """Print a small table on stdout, as plain text if stdout is no terminal.

    The column ``names`` is never broken, so that readers can search for its entries and copy them.
    """
    from rich.console import Console
    from rich.table import Table

    table = Table(title=title, title_justify="left", title_style="bold", box=None, pad_edge=False)
    table.show_header = bool(header)
    for k, name in enumerate(header or [""] * max(map(len, rows), default=0)):
        table.add_column(name, overflow="fold", no_wrap=k == names)
    for row in rows:
        table.add_row(*(cell.replace("[", r"\[") for cell in row))
    width = None if sys.stdout.isatty() else COLUMNS
    Console(width=width).print(table)


def print_tables(sections: Iterable[PageSection]) -> None:
    """The tables of a page."""
    for section in sections:
        if section.rows:
            rows = [[cell.replace("\u2212", "-") for cell in row] for row in section.rows]
            print_table(section.title, rows, section.head)


def show_result(result: Mapping[str, Any], directory: Path, *, verbose: bool = False) -> None:
    """Print the answer of a run in at most 15 lines; ``verbose`` adds all tables of its report."""
    from kc2spice.report.run_page import format_results, format_summary

    answer = format_summary(result, MOST_METRICS)
    count = len(result["files"])
    rows = [*answer.rows[:MOST_ROWS], ("report", f"{directory / 'report.html'} ({count} files)")]
    print_tables([replace(answer, title=str(result.get("scene", "")), rows=rows)])
    if not verbose:
        return
    print_tables(format_results(result))
    print_table(f"files in {directory}", [(", ".join(map(str, result["files"])),)])
    for raw in (name for name in result["files"] if name.endswith(".raw")):
        rows = [
            ("ngspice", f"load {raw}, then plot VECTOR"),
            ("Python", f"spicelib.RawRead({raw!r}, dialect='ngspice')"),
        ]
        print_table("viewers of the raw file", rows)
