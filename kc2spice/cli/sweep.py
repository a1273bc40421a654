"""The command ``sweep``: its options, its progress, its exit codes."""

import json
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from kc2spice.cli.console import (
    INTERRUPTED,
    ProgressCallback,
    print_table,
    reported_errors,
    shown_progress,
)
from kc2spice.core.errors import SimulationError, UsageError

if TYPE_CHECKING:
    from kc2spice.workflow.sweep.pool import Engine
    from kc2spice.workflow.sweep.study import Request, Study

_EVERY = 10.0  # s between two lines of progress where stderr is no terminal


def sweep(
    scene: Annotated[
        str | None,
        typer.Argument(
            metavar="SCENE",
            show_default=False,
            help="Gallery name, study name, or path of a TOML file of either.",
        ),
    ] = None,
    set_: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="KEY=RANGE",
            help="a:b:n, log:a:b:n, x,y,z, normal(mu,sigma,n), uniform(a,b,n) with or without "
            "units, or one value. KEY is a scene key, or param.PART.NAME for a parameter of a "
            "subcircuit. Repeatable.",
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
        typer.Option("--out", "-o", metavar="DIR", help="Where to write; default: ./NAME_sweep."),
    ] = None,
    table_format: Annotated[
        str, typer.Option("--format", metavar="csv|parquet", help="Of the table.")
    ] = "csv",
    tune: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KEY=a:b",
            help="Search KEY between two positive values for the least --minimise, as a ratio to "
            "the scene as it is, at the worst of all points. Repeatable.",
        ),
    ] = None,
    minimise: Annotated[
        str | None, typer.Option(metavar="METRIC", help="What --tune makes small.")
    ] = None,
    require: Annotated[
        list[str] | None,
        typer.Option(
            metavar="METRIC<=X", help="What --tune must keep, also METRIC>=X, in SI. Repeatable."
        ),
    ] = None,
    generations: Annotated[int, typer.Option(min=1, help="Of the search of --tune.")] = 12,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Points at a time; default: all cores.")
    ] = None,
    timeout: Annotated[
        float, typer.Option(metavar="S", min=0.1, help="Longest time for one ngspice run.")
    ] = 600.0,
    dask: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Run on a Dask scheduler, or on 'local' workers."),
    ] = None,
    slurm: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Write plan and Slurm array script to DIR, run nothing."),
    ] = None,
    shards: Annotated[int, typer.Option(min=1, help="Array tasks of --slurm.")] = 16,
    shard: Annotated[
        str | None,
        typer.Option(metavar="K/N", help="Run part K (0 … N-1) of the plan that --out holds."),
    ] = None,
    collect: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Put the rows of all parts in DIR into one table."),
    ] = None,
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
    """Run SCENE over ranges of its keys; a table with a row for each.

    A sweep that was interrupted goes on where it was when the same command is given again. Points
    that share finite elements or a reduced model share them. Points that fail are rows that say
    why.
    """
    with reported_errors():
        from kc2spice.workflow.sweep import run
        from kc2spice.workflow.sweep.study import make_study

        engine = _engine(dask, workers)
        with shown_progress(quiet) as progress:
            shown = progress if quiet or sys.stderr.isatty() else _Lines(progress)
            if collect is not None:
                result = run.collect(collect, shown)
            elif shard is not None:
                result = run.sweep_shard(
                    _needed(out, "--out"), _shard(shard), engine, shown, retry_failed=retry_failed
                )
            else:
                if tune:
                    metric = _goals(metric, minimise, require)
                study = make_study(
                    _request(scene, set_, zipped, latin, seed, metric, timeout, table_format)
                )
                if not quiet:
                    print(study.describe(), file=sys.stderr)
                out = out or Path(f"{study.base.name}_sweep")
                if dry_run:
                    result = run.dry_run_summary(study, out)
                elif slurm is not None:
                    result = run.write_array(study, slurm, shards)
                elif tune:
                    search = (tune, _needed(minimise, "--minimise"), generations, require or [])
                    result = _interruptible(study, out, engine, shown, search)
                else:
                    result = _interruptible(study, out, engine, shown, retry_failed=retry_failed)
        if as_json:
            print(json.dumps(result))
        elif not quiet:
            _show(result)
        if result["points"] and result["failed"] == result["points"]:
            raise SimulationError("every point failed", where=result["table"],
                                  hint="the column status says why")  # fmt: skip


def _goals(metrics: list[str] | None, minimise: str | None, require: list[str] | None) -> list[str]:
    """Columns that a tuning needs."""
    from kc2spice.workflow.sweep.tune import limit

    limits = [limit(text).metric for text in require or []]
    return [*(metrics or []), _needed(minimise, "--minimise"), *limits]


def _request(
    scene: str | None, sets: list[str] | None, zipped: bool, latin: bool, seed: int,
    metrics: list[str] | None, timeout: float, table_format: str,
) -> "Request":  # fmt: skip
    from kc2spice.workflow.sweep.study import request_of

    return request_of(
        _needed(scene, "SCENE"), sets=tuple(sets or ()), zipped=zipped, latin=latin, seed=seed,
        metrics=tuple(metrics or ()), timeout=timeout, format=table_format,
    )  # fmt: skip


def _needed(value: Any, name: str) -> Any:
    if value is None:
        raise UsageError("is missing", where=name, hint="'kc2spice sweep --help' explains all")
    return value


def _shard(text: str) -> Any:
    from kc2spice.workflow.sweep.run import Shard

    number, _, count = text.partition("/")
    if not number.isdecimal() or not count.isdecimal():
        raise UsageError("not a part", where="--shard", got=text, expected="K/N, such as 0/16")
    return Shard(int(number), int(count))


def _engine(dask: str | None, workers: int | None) -> "Engine":
    from kc2spice.workflow.sweep.pool import DaskEngine, LocalEngine, cores

    count = workers or cores()
    return LocalEngine(count) if dask is None else DaskEngine(dask, count)


def _interruptible(
    study: "Study", out: Path, engine: "Engine", progress: ProgressCallback,
    search: tuple[list[str], str, int, list[str]] | None = None, *, retry_failed: bool = False,
) -> Any:  # fmt: skip
    from kc2spice.workflow.sweep import run, tune

    try:
        if search is not None:
            texts, metric, generations, required = search
            bounds = [tune.bound(text, study.keys) for text in texts]
            return tune.run_tuning(
                study, bounds, metric, generations, out, engine, progress,
                limits=[tune.limit(text) for text in required],
            )  # fmt: skip
        return run.sweep(study, out, engine, progress, retry_failed=retry_failed)
    except KeyboardInterrupt:
        print(f"kc2spice: interrupted; the points run so far are kept in {out}, the same command "
              "runs the rest", file=sys.stderr)  # fmt: skip
        raise typer.Exit(INTERRUPTED) from None


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
    if result.get("overhead") is not None:
        busy, over = (f"{100 * result[name]:.1f} %" for name in ("busy_share", "overhead"))
        rows.append(("workers busy", busy))
        rows.append(("CPU over that of ngspice", over))
    for name, share in result.get("yield", {}).items():
        low, high = share["low"], share["high"]
        rows.append((f"{name}: yield", f"{share['share']:.4g} (95 %: {low:.4g} … {high:.4g})"))
    for name in ("best", "mean_ratio", "worst_ratio"):
        if name in result:
            rows.append((name.replace("_", " "), str(result[name])))
    if result.get("files"):
        rows.append(("files", ", ".join(result["files"])))
    print_table("sweep", rows)
