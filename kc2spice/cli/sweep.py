"""The command ``sweep``: its options, its progress, its exit codes."""

import json
import sys
import time
from pathlib import Path
from typing import Annotated, Any

import typer

from kc2spice.cli.console import (
    INTERRUPTED,
    ProgressCallback,
    directory,
    print_table,
    reported_errors,
    shown_progress,
)
from kc2spice.core.errors import SimulationError

_EVERY = 10.0  # s between two lines of progress where stderr is no terminal


def sweep(
    scene: Annotated[
        str,
        typer.Argument(
            metavar="SCENE", help="Gallery name, study name, or path of a TOML file of either."
        ),
    ],
    set_: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="KEY=RANGE",
            help="a:b:n, log:a:b:n, x,y,z, normal(mu,sigma,n), uniform(a,b,n) with or without "
            "units, or one value. KEY is a scene key (beam.layers[0].thickness too), or "
            "param.PART.NAME for a parameter of a subcircuit. Repeatable.",
        ),
    ] = None,
    zipped: Annotated[
        bool, typer.Option("--zip", help="Step through all ranges together; else they are crossed.")
    ] = False,
    latin: Annotated[
        bool, typer.Option("--latin", help="Draw by Latin hypercube instead of independently.")
    ] = False,
    seed: Annotated[int, typer.Option(min=0, help="Of all draws.")] = 0,
    metric: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Column of the table, repeatable; default: all metrics. Any number of result.json "
            "by its path: model.kick.resonance_short_hz, checks.NAME, rom.order.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            metavar="DIR",
            parser=directory,
            help="Where to write; default: ./NAME_sweep.",
        ),
    ] = None,
    table_format: Annotated[
        str, typer.Option("--format", metavar="csv|parquet", help="Of the table.")
    ] = "csv",
    workers: Annotated[
        int | None, typer.Option(min=1, help="Points at a time; default: all cores.")
    ] = None,
    dask: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Run on a Dask scheduler, or on 'local' workers."),
    ] = None,
    timeout: Annotated[
        float, typer.Option(metavar="S", min=0.1, help="Longest time for one ngspice run.")
    ] = 600.0,
    retry_failed: Annotated[
        bool,
        typer.Option(
            "--retry-failed",
            help="Run all points again that failed; without it those whose run was interrupted.",
        ),
    ] = False,
    dry_run: Annotated[bool, typer.Option(help="Say what would be run and stop.")] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="One JSON object on stdout, all else on stderr.")
    ] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress, no tables.")] = False,
) -> None:
    """Run SCENE over ranges of its keys; a table with a row for each point.

    A sweep that was interrupted goes on where it was when the same command is given again. Points
    that share finite elements or a reduced model share them. Points that fail are rows that say
    why.
    """
    with reported_errors():
        from kc2spice.workflow.sweep import run
        from kc2spice.workflow.sweep import workers as pools

        table = run.table_name(table_format)
        found = run.named_sweep(
            scene,
            set_ or (),
            zipped=zipped,
            latin=latin,
            seed=seed,
            metrics=metric or (),
            timeout=timeout,
        )
        out = out or Path(f"{found.scene.name}_sweep")
        count = workers or pools.cores()
        pool = pools.processes(count) if dask is None else pools.dask(dask, count)
        if not quiet:
            print(found.describe(), file=sys.stderr)
        if dry_run:
            result = {
                "scene": found.scene.name,
                "points": found.plan.size,
                "failed": 0,
                "resumed": 0,
                "table": str((out / table).absolute()),
                "runs": found.runs,
            }
        else:
            with shown_progress(quiet) as progress:
                shown = progress if quiet or sys.stderr.isatty() else _Lines(progress)
                try:
                    result = run.sweep(
                        found,
                        out,
                        pool,
                        shown,
                        table_format=table_format,
                        retry_failed=retry_failed,
                    )
                except KeyboardInterrupt:
                    print(
                        f"kc2spice: interrupted; the points run so far are kept in {out}, the "
                        "same command runs the rest",
                        file=sys.stderr,
                    )
                    raise typer.Exit(INTERRUPTED) from None
        if as_json:
            print(json.dumps(result))
        elif not quiet:
            _show(result)
        if result["points"] == result["failed"]:
            hint = "the column status says why"
            raise SimulationError("every point failed", where=result["table"], hint=hint)


class _Lines:
    """A line of progress now and then, for logs and pipes."""

    def __init__(self, stages: ProgressCallback) -> None:
        self._stages, self._last = stages, time.monotonic()

    def __call__(self, stage: str, done: float | None, text: str) -> None:
        if done is None:
            self._stages(stage, done, text)
        elif time.monotonic() - self._last > _EVERY or done >= 1.0:
            self._last = time.monotonic()
            print(text, file=sys.stderr, flush=True)


def _show(result: dict[str, Any]) -> None:
    rows = [(name, str(result[name])) for name in ("points", "failed", "resumed", "table")]
    for name, share in result.get("yield", {}).items():
        low, high = share["low"], share["high"]
        rows.append((f"{name}: yield", f"{share['share']:.4g} (95 %: {low:.4g} … {high:.4g})"))
    if result.get("files"):
        rows.append(("files", ", ".join(result["files"])))
    print_table("sweep", rows)
