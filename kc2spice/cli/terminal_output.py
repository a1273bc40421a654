"""Terminal output: progress on stderr, tables on stdout, errors in one block."""

from __future__ import annotations

import contextlib
import json
import math
import os
import sys
import time
import traceback
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import typer

from kc2spice.core.errors import Kc2spiceError, SimulationError, UsageError
from kc2spice.core.files import DISK_FULL_ERRORS
from kc2spice.core.progress import ERROR_BUDGET, Progress, ignore_progress

if TYPE_CHECKING:
    from kc2spice.report.html import PageSection
PIPED_COLUMNS = 80  # characters, line width of output that is not printed on a terminal
# largest numbers of metrics and rows in the summary of a run
MAX_METRICS = 9
MAX_ROWS = 13
# purposes of the files of a run, keyed by the end of their names
FILE_PURPOSES = {
    "result.json": "all results",
    "report.html": "figures and tables",
    "waveforms.npz": "waveforms",
    "waveforms.csv": "waveforms",
    ".raw": "waveforms",
    "_plot.sp": "ngspice script for plots",
    ".ltspice.lib": "subcircuits for LTspice",
    ".asy": "symbols for LTspice",
    ".lib": "subcircuits",
    ".va": "Verilog-A modules",
    ".cir": "netlist of the scene",
    ".kicad_pro": "KiCad project",
    ".kicad_sch": "KiCad project",
    ".kicad_sym": "KiCad project",
    ".wbk": "KiCad project",
    "sym-lib-table": "KiCad project",
    ".png": "figures",
    "em_table.npz": "force table",
}
# Output that is not printed on a terminal contains one line about a stage if the remaining time of
# the stage exceeds LONG_TIME [s]. This time is extrapolated after MIN_ELAPSED_TIME [s].
LONG_TIME = 30.0
MIN_ELAPSED_TIME = 2.0
INTERRUPTED_EXIT_CODE = 130  # exit code of shells after Ctrl-C
_printed_warnings: list[str] = []  # warnings that the current command has printed


@dataclass(frozen=True)
class OutputRecipient:
    """Recipient of a command's output: a program (with ``as_json``) or a person.

    With ``quiet``, the command prints neither progress nor tables.
    """

    as_json: bool
    quiet: bool

    def open_progress_display(self) -> AbstractContextManager[Progress]:
        """Return a context manager that shows stages and elapsed times on a terminal."""
        if not self.quiet and sys.stderr.isatty():
            return _show_progress_bars()
        silent = self.quiet or self.as_json
        return nullcontext(ignore_progress if silent else _make_printer_of_long_stages())

    def print_json_if_requested(self, record: Any, out: Path | None = None) -> bool:
        """Print ``record`` as JSON if requested; return True if tables must be printed.

        The entry ``warnings`` of the JSON object lists the warnings of the record, and the warnings
        that the command has printed on stderr.
        """
        if self.as_json:
            location = {} if out is None else {"directory": str(out.absolute())}
            texts = dict.fromkeys((*record.get("warnings", ()), *_printed_warnings))
            record = {**record, **location, "warnings": list(texts)}
        return self.print_data(record)

    def print_data(self, data: Any) -> bool:
        """Print ``data`` as JSON if requested; return True if tables must be printed.

        ``data`` is a list or a mapping, such as the titles of all scenes, keyed by name.
        """
        if self.as_json:
            print(json.dumps(data))
        return not (self.as_json or self.quiet)


def _make_printer_of_long_stages() -> Progress:
    """Return a function that prints one line for each stage that takes long.

    The line contains the remaining time, which is extrapolated from the completed fraction of the
    stage. Messages of the stage :data:`ERROR_BUDGET` contain limits, and are always printed.
    """
    starts, printed = dict[str, float](), set[str]()

    def print_remaining_time(stage: str, done: float | None, text: str) -> None:
        """Print the remaining time of a long stage, only once for each stage."""
        now = time.monotonic()
        if stage == ERROR_BUDGET:
            print(f"{stage}: {text}", file=sys.stderr, flush=True)
        if not done:
            starts[stage] = now
            return
        elapsed = now - starts.setdefault(stage, now)
        remaining = _extrapolate_remaining_time(elapsed, done)
        if stage not in printed and elapsed > MIN_ELAPSED_TIME and remaining > LONG_TIME:
            printed.add(stage)
            left = _describe_remaining_time(remaining)
            print(f"{stage}: {text}, about {left}", file=sys.stderr, flush=True)

    return print_remaining_time


@contextmanager
def _show_progress_bars() -> Iterator[Progress]:
    """Show one progress bar for each stage; the bars of completed stages are full."""
    from rich import progress as rich
    from rich.console import Console
    from rich.text import Text

    class RemainingColumn(rich.ProgressColumn):
        """Progress-bar column that shows the remaining time if this time is known."""

        def render(self, task: rich.Task) -> Text:
            """Return the remaining time of a task as text, empty if the time is unknown."""
            return Text(_describe_remaining_time(task.fields["end"] - time.monotonic()))

    stage, text = "{task.fields[stage]:<10}", rich.TextColumn("{task.fields[text]}", markup=False)
    left = (rich.SpinnerColumn(), rich.TextColumn(stage), rich.BarColumn(24))
    right = (rich.TimeElapsedColumn(), RemainingColumn(), text)
    starts = dict[str, float]()  # start time of each stage
    with rich.Progress(*left, *right, console=Console(stderr=True)) as bars:

        def fill_bars() -> None:
            """Fill the progress bars of all stages that have begun, up to 100 %."""
            for task in bars.tasks:
                bars.update(task.id, total=1, completed=1, end=math.inf)

        def update_bar(stage: str, done: float | None, text: str) -> None:
            """Update the completed fraction and the text of a stage's progress bar."""
            tasks = {task.fields["stage"]: task.id for task in bars.tasks}
            if stage not in tasks:
                fill_bars()
                starts[stage] = time.monotonic()
                tasks[stage] = bars.add_task("", total=None, stage=stage, text=text, end=math.inf)
            total, end = None if done is None else 1.0, math.inf
            if done:
                now = time.monotonic()
                end = now + _extrapolate_remaining_time(now - starts[stage], done)
            bars.update(tasks[stage], total=total, completed=done or 0.0, text=text, end=end)

        yield update_bar
        fill_bars()


def _extrapolate_remaining_time(elapsed: float, done: float) -> float:
    """Return the remaining time [s] of a stage of which the fraction ``done`` is complete.

    >>> _extrapolate_remaining_time(elapsed=30.0, done=0.25)
    90.0
    """
    return elapsed * (1 - done) / done


def _describe_remaining_time(seconds: float) -> str:
    """Describe a remaining time [s] in minutes and seconds; "" for an infinite time.

    >>> [_describe_remaining_time(time) for time in (75.2, -1.0, math.inf)]
    ['1:15 left', '0:00 left', '']
    """
    if math.isinf(seconds):
        return ""
    minutes, seconds = divmod(max(round(seconds), 0), 60)
    return f"{minutes}:{seconds:02.0f} left"


@contextmanager
def report_errors() -> Iterator[None]:
    """Print an exception of the ``with`` block as one message; exit with its code."""
    _printed_warnings.clear()

    def print_once(message: Warning | str, *_: object, **__: object) -> None:
        """Print a warning, unless the command has already printed the same warning."""
        if str(message) not in _printed_warnings:
            _printed_warnings.append(str(message))
            print(f"kc2spice: warning: {message}", file=sys.stderr, flush=True)

    warnings.showwarning = print_once
    try:
        yield
        # This flush reports a full disk before the interpreter ends.
        sys.stdout.flush()
    except Kc2spiceError as error:
        _exit_with_error(str(error), error.exit_code)
    except KeyboardInterrupt:
        _exit_with_error("interrupted; nothing was written", INTERRUPTED_EXIT_CODE)
    # The program that reads the pipe has ended, as in `kc2spice scenes | head`.
    except BrokenPipeError:
        _discard_stdout()
        raise typer.Exit(0) from None
    except typer.Exit:
        raise
    except MemoryError:
        text = (
            "the memory is exhausted\n  next:     use a coarser mesh, fewer points or more memory"
        )
        _exit_with_error(text, SimulationError.exit_code)
    except Exception as error:
        if isinstance(error, OSError) and error.errno in DISK_FULL_ERRORS:
            _discard_stdout()
            text = f"the file cannot be written: {error.strerror}\n  next:     free some space"
            _exit_with_error(text, UsageError.exit_code)
        if os.environ.get("KC2SPICE_DEBUG"):
            traceback.print_exc()
        detail = f"{type(error).__name__}: {error}".splitlines()[0]
        text = f"internal error: {detail}\n  next:     set KC2SPICE_DEBUG=1 for the details"
        _exit_with_error(text, SimulationError.exit_code)


def _discard_stdout() -> None:
    """Discard further output on stdout."""
    with contextlib.suppress(OSError, ValueError):  # ``sys.stdout`` may lack a file descriptor
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _exit_with_error(text: str, code: int) -> NoReturn:
    """Exit from the program with an error message and an exit code."""
    print(f"kc2spice: error: {text}", file=sys.stderr, flush=True)
    raise typer.Exit(code) from None


def print_table(
    title: str, rows: Sequence[Sequence[str]], header: Sequence[str] = (), names: int | None = None
) -> None:
    """Print a small table on stdout, as plain text if stdout is not a terminal.

    Entries of the column ``names`` are never wrapped, so that readers can search for and copy each
    entry.
    """
    from rich.console import Console
    from rich.table import Table

    table = Table(title=title, title_justify="left", title_style="bold", box=None, pad_edge=False)
    table.show_header = bool(header)
    for k, name in enumerate(header or [""] * max(map(len, rows), default=0)):
        table.add_column(name, overflow="fold", no_wrap=k == names)
    for row in rows:
        table.add_row(*(cell.replace("[", r"\[") for cell in row))
    width = None if sys.stdout.isatty() else PIPED_COLUMNS
    Console(width=width).print(table)


def print_tables(sections: Iterable[PageSection]) -> None:
    """Print the sections of a report page as tables."""
    for section in sections:
        if section.rows:
            rows = [[cell.replace("\u2212", "-") for cell in row] for row in section.rows]
            print_table(section.title, rows, section.head)


def print_notes(result: Mapping[str, Any]) -> None:
    """Print each note and each warning of a result on a line of its own."""
    for kind in ("notes", "warnings"):
        for text in result.get(kind, ()):
            print(f"{kind[:-1]}: {text}")


def print_files(directory: Path, names: Iterable[str], netlist: str | None = None) -> None:
    """Print the names of the files in ``directory``, grouped by purpose.

    ``netlist`` is the name of the file with the netlist of the scene, if its ending is not
    ``.cir``.
    """
    groups = dict[str, list[str]]()
    for name in names:
        matches = (purpose for end, purpose in FILE_PURPOSES.items() if name.endswith(end))
        purpose = "netlist of the scene" if name == netlist else next(matches, "other files")
        groups.setdefault(purpose, []).append(name)
    rows = [(purpose, ", ".join(group)) for purpose, group in groups.items()]
    print_table(f"Files in {directory}", rows)


def print_result(result: Mapping[str, Any], directory: Path, *, verbose: bool = False) -> None:
    """Print the result of a run in at most 15 lines.

    With ``verbose``, all metrics and all tables of the report are printed.
    """
    from kc2spice.report.run_page import format_results, format_summary

    summary = format_summary(result, None if verbose else MAX_METRICS)
    rows = [*summary.rows[: None if verbose else MAX_ROWS]]
    rows.append(("report", str(directory / "report.html")))
    print_tables([replace(summary, title=str(result.get("scene", "")), rows=rows)])
    if not verbose:
        return
    for section in format_results(result):
        if section.rows:
            print()
            print_tables([section])
    print()
    print_files(directory, result["files"], result.get("netlist"))
    for raw in (name for name in result["files"] if name.endswith(".raw")):
        rows = [
            ("ngspice", f"load {raw}, then plot VECTOR"),
            ("Python", f"spicelib.RawRead({raw!r}, dialect='ngspice')"),
        ]
        print_table("viewers of the raw file", rows)
