"""The command line: options, progress and exit codes; the work is done by :mod:`kc2spice.workflow`.

Imports that take time stand inside the commands, so that ``--help`` answers at once. For the same
reason no annotation here is postponed: typer evaluates each such text three times.
"""

import gc
import json
import os
import shlex
import signal
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from kc2spice.cli.console import INTERRUPTED, print_table, reported_errors, shown_progress
from kc2spice.cli.options import AnyScene, AsJson, Out, Quiet, Scene, Set, Trust
from kc2spice.core.errors import GateMissedError, SimulationError, UsageError
from kc2spice.core.version import __version__


class _Command(TyperCommand):
    """A command whose exceptions become one message and an exit code."""

    def invoke(self, ctx: Any) -> Any:
        with reported_errors():
            return super().invoke(ctx)


app = typer.Typer(
    name="kc2spice",
    help="Finite-element actuator models as SPICE subcircuits, run with their electronics.",
    epilog="Exit codes: 0 ok, 2 bad usage or scene, 3 simulator or library missing, "
    "4 accuracy gate failed, 5 simulation failed.",
    no_args_is_help=True,
    add_completion=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # plain help: loading rich for it takes as long as all the rest
    context_settings={"help_option_names": ["-h", "--help"]},
)


def main() -> None:
    """Entry point of the ``kc2spice`` script."""
    # The matrices are sparse and small: threads of BLAS and of ngspice mostly wait for each other.
    # It must be said before numpy is loaded; whoever set a number of threads keeps it.
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "1")  # a search of all installed packages
    gc.set_threshold(100_000)  # nearly all that is imported and loaded stays until the end
    _leave_on_signals()
    try:
        with reported_errors():  # also of what stands outside the commands, such as --help
            app()
    except typer.Exit as end:
        raise SystemExit(end.exit_code) from None
    finally:
        gc.freeze()  # the interpreter would look for garbage once more, in all that was imported


def _leave_on_signals() -> None:
    """SIGTERM and SIGHUP end as Ctrl-C does: simulators are stopped, unfinished files removed."""

    def leave(number: int, frame: object) -> None:
        signal.signal(number, signal.SIG_IGN)  # once is enough
        raise SystemExit(128 + number)

    for name in ("SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) is signal.SIG_DFL:
            signal.signal(number, leave)


def _version(wanted: bool) -> None:
    if wanted:
        print(f"kc2spice {__version__}")
        raise typer.Exit


@app.callback()
def _common(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print it and stop.")
    ] = False,
) -> None:
    pass


def _answer(
    record: Mapping[str, Any], out: Path, as_json: bool, quiet: bool, show: Callable[[], None]
) -> None:
    """The record of a command as JSON, or what ``show`` prints of it."""
    if as_json:
        print(json.dumps({**record, "directory": str(out.absolute())}))
    elif not quiet:
        show()


@app.command(cls=_Command)
def run(
    scene: Scene,
    out: Out = None,
    set_: Set = None,
    deck: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Run this netlist, edited by hand, instead of SCENE's own; same metrics, checks "
            "and plots.",
        ),
    ] = None,
    png: Annotated[
        bool, typer.Option("--png", help="Write the report's figures as PNG files too.")
    ] = False,
    keep: Annotated[
        bool,
        typer.Option(
            "--keep", help="Keep the simulator's raw file, for waveform viewers, and its log."
        ),
    ] = False,
    trust: Trust = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Build, reduce, export and simulate SCENE.

    All files appear in DIR at the end; report.html has the plots.
    """
    from kc2spice.cli.tables import show_result
    from kc2spice.scene.load import load_scene
    from kc2spice.workflow import run as study

    loaded = load_scene(scene, set_ or [])
    out = out or Path(loaded.name)
    with shown_progress(quiet) as progress:
        found = study.run(loaded, out, progress, trust=trust, deck=deck, keep=keep, png=png)
    _answer(found, out, as_json, quiet, lambda: show_result(found, out))


@app.command(cls=_Command)
def export(
    scene: AnyScene = None,
    out: Out = None,
    set_: Set = None,
    dialect: Annotated[
        str, typer.Option(help="Language to write: ngspice, xyce, ltspice or verilog-a.")
    ] = "ngspice",
    trust: Trust = False,
    tolerance: Annotated[
        float | None, typer.Option(help="Short for --set rom.tolerance=X.", metavar="X")
    ] = None,
    count: Annotated[
        int | None,
        typer.Option(metavar="N", help="An array: N copies of SCENE in one deck, no symbols."),
    ] = None,
    rom: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Reduced model of 'reduce' instead of a scene."),
    ] = None,
    dense: Annotated[
        bool, typer.Option("--dense", help="With --rom: couple all states instead of blocks.")
    ] = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Write netlists of SCENE, or of a reduced model; no simulation."""
    if rom is not None:
        if scene is not None or set_ or tolerance is not None or count is not None:
            expected = "no scene and no scene keys"
            raise UsageError("a reduced model is final", where="--rom", expected=expected)
        from kc2spice.workflow.reduce import export_rom

        files, head = export_rom(rom, out, dialect=dialect, dense=dense), {"rom": str(rom)}
    elif scene is None:
        raise UsageError("nothing to export", expected="SCENE or --rom FILE")
    else:
        from kc2spice.scene.load import load_scene
        from kc2spice.workflow.export import export as write

        short = [] if tolerance is None else [f"rom.tolerance={tolerance}"]
        loaded = load_scene(scene, [*(set_ or []), *short])
        out, head = out or Path(loaded.name), {"scene": loaded.name}
        with shown_progress(quiet) as progress:
            files = write(loaded, out, dialect, progress, trust=trust, count=count)
    record = {**head, "files": [path.name for path in files]}
    rows = [(str(path),) for path in files]
    _answer(record, files[0].parent, as_json, quiet, lambda: print_table("files", rows))


@app.command(cls=_Command)
def verify(
    scene: AnyScene = None,
    all_: Annotated[bool, typer.Option("--all", help="Verify every built-in scene.")] = False,
    full: Annotated[
        bool,
        typer.Option(
            "--full",
            help="Follow full models 100 times as long, if need be to the scene's end, and solve "
            "large ones at all frequencies.",
        ),
    ] = False,
    deck: Annotated[
        Path | None,
        typer.Option("--deck", metavar="FILE", help="Take SCENE's deck from disk, as it stands."),
    ] = None,
    out: Out = None,
    set_: Set = None,
    trust: Trust = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Check SCENE three ways: full model, reduced model, emitted netlist.

    Writes verify.json and verify.html into DIR. Exit code 4 when a gate of the scene is missed.
    """
    from kc2spice.cli.tables import show_verdicts
    from kc2spice.netlist.deck import read_deck
    from kc2spice.scene.load import gallery, load_scene
    from kc2spice.workflow.verify.verify import verify as verify_scenes

    if (scene is None) is not all_:
        raise UsageError("give either a SCENE or --all", where="verify")
    loaded = [load_scene(name, set_ or []) for name in ([scene] if scene else gallery())]
    out = out or Path("verify" if all_ else f"{loaded[0].name}_verify")
    shipped = None if deck is None else read_deck(deck)
    with shown_progress(quiet) as progress:
        found = verify_scenes(loaded, out, full=full, deck=shipped, trust=trust, progress=progress)
    passed = all(record["passed"] for record in found.values())
    record = {"passed": passed, "scenes": found} if all_ else next(iter(found.values()))
    _answer(record, out, as_json, quiet, lambda: show_verdicts(found, out))
    if not passed:
        raise typer.Exit(GateMissedError.exit_code)


@app.command(cls=_Command)
def explain(scene: Scene, set_: Set = None, as_json: AsJson = False) -> None:
    """Say what is modelled, its numerical settings, what was left out and why."""
    from dataclasses import asdict

    from kc2spice.cli.tables import show_plan
    from kc2spice.core.progress import Clock
    from kc2spice.scene.hash import scene_hash
    from kc2spice.scene.load import load_scene
    from kc2spice.scene.plan import plan
    from kc2spice.workflow.models import build_models

    loaded = load_scene(scene, set_ or [])
    timed = loaded.analysis.type == "transient"
    build = build_models(loaded, Clock()) if timed else None
    limit = None if build is None else build.largest
    found, digest = plan(loaded, build), scene_hash(loaded)
    if as_json:
        step = None if limit is None else {"s": limit.step, "why": limit.why}
        head = {"scene": loaded.name, "hash": digest, "largest_step": step}
        print(json.dumps({**head, **asdict(found)}))
    else:
        show_plan(loaded, digest, found, limit)


@app.command(cls=_Command)
def scenes(
    keys: Annotated[
        bool, typer.Option("--keys", help="List every key that a scene may have instead.")
    ] = False,
    parts: Annotated[
        bool, typer.Option("--parts", help="List part types with their pins and keys instead.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """List the built-in scenes, all scene keys, or all part types."""
    from dataclasses import asdict

    from kc2spice.cli.tables import show_keys, show_parts
    from kc2spice.scene.keys import scene_keys
    from kc2spice.scene.load import gallery, load_scene
    from kc2spice.scene.partdocs import part_docs

    if keys and parts:
        raise UsageError("give either --keys or --parts", where="scenes")
    if keys or parts:
        found: list[Any] = list(scene_keys() if keys else part_docs())
        if as_json:
            print(json.dumps([asdict(each) for each in found]))
        else:
            (show_keys if keys else show_parts)(found)
        return
    titles = {name: load_scene(name).title for name in gallery()}
    if as_json:
        print(json.dumps(titles))
    else:
        print_table("scenes", list(titles.items()))


@app.command(cls=_Command)
def doctor(as_json: AsJson = False) -> None:
    """Check ngspice and libraries; print the fix for what is missing."""
    from dataclasses import asdict

    from kc2spice.cli.doctor import examine
    from kc2spice.cli.tables import show_findings

    findings = list(examine())
    if as_json:
        print(json.dumps({"findings": [asdict(finding) for finding in findings]}))
    else:
        show_findings(findings)
    if any(finding.needed and not finding.ok for finding in findings):
        raise typer.Exit(3)


@app.command(cls=_Command)
def reduce(
    model: Annotated[
        str,
        typer.Argument(
            metavar="MODEL",
            help="NAME of Matrix Market or Harwell-Boeing files NAME.M .E .K .B .C (first order .A "
            ".B .C .D .E; heat .E .K), also NAME_K.mtx; a .npz or .mat file with such matrices; "
            "files of Abaqus, CalculiX, Nastran, Ansys; SCENE:PART for a scene's body; a measured "
            "impedance of one port (.s1p, .csv, .txt), which becomes a passive circuit. NAME.toml "
            "beside it names ports, units, supports and band; docs/matrices.md lists its keys.",
        ),
    ],
    out: Out = None,
    band: Annotated[
        tuple[float, float] | None,
        typer.Option(
            metavar="F0 F1",
            help="Hz; default: that of NAME.toml, else up to the fifth natural frequency.",
        ),
    ] = None,
    tolerance: Annotated[
        float | None,
        typer.Option(metavar="X", help="Largest relative error over the band; default: 1e-4."),
    ] = None,
    order: Annotated[
        int | None, typer.Option(metavar="Q", help="Number of states instead of a tolerance.")
    ] = None,
    norm: Annotated[
        str | None,
        typer.Option(
            metavar="NORM",
            help="Of the error: pointwise (relative at every frequency, notches included) or peak "
            "(relative to the largest value in the band; default where all ports are signals).",
        ),
    ] = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Reduce matrices of another tool, or a measured impedance, to a model of stated error.

    An unstable model ends with exit code 4.
    """
    from kc2spice.cli.tables import show_reduced
    from kc2spice.workflow.reduce import reduce as reduce_study
    from kc2spice.workflow.reduce import require_stable

    wanted: dict[str, Any] = {"band": band, "tolerance": tolerance, "order": order, "norm": norm}
    with shown_progress(quiet) as progress:
        found = reduce_study(model, out, **wanted, progress=progress)
    if as_json:
        print(json.dumps(found))
    elif not quiet:
        show_reduced(found)
    require_stable(found)


@app.command(cls=_Command)
def fit(
    target: Annotated[str, typer.Argument(metavar="SCENE:PART", help="A body of a scene.")],
    data: Annotated[
        Path, typer.Argument(metavar="DATA", help="Its measured impedance: .s1p, .csv, .txt.")
    ],
    vary: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KEY[=LOW:HIGH]",
            help="A key below the part, such as layers[0].thickness or damping.quality, and its "
            "range in SI; else 30 % about the scene's value, ten times of losses. Repeatable.",
        ),
    ] = None,
    out: Out = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Vary keys of a body until its impedance is the measured one.

    Every evaluation is a finite element model, so a fit takes minutes. Writes fit.toml with the
    values into DIR (default: ./PART_fit).
    """
    from kc2spice.cli.tables import show_fit
    from kc2spice.workflow.fit import fit as fit_study

    with shown_progress(quiet) as progress:
        found = fit_study(target, data, vary or (), out, progress)
    if as_json:
        print(json.dumps(found))
    elif not quiet:
        show_fit(found)


@app.command(cls=_Command)
def bench(
    scene: Scene,
    error: Annotated[
        float, typer.Option(metavar="X", min=1e-12, max=1.0, help="Largest error that you accept.")
    ] = 1e-4,
    metric: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Whose error counts, as in result.json; repeatable. Default: bench.metric of the "
            "scene, else every number that converges.",
        ),
    ] = None,
    out: Out = None,
    set_: Set = None,
    repeats: Annotated[int, typer.Option(min=1, help="Runs of each; the median counts.")] = 5,
    trust: Trust = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Measure SCENE's error against time over its settings; recommend the cheapest one.

    Settings are the numerical ones that 'explain' lists, but meshes, which take no time of the
    simulator; the reference has all of them at their finest. Exit code 4 when no setting is within
    --error.
    """
    from kc2spice.cli.tables import show_bench
    from kc2spice.scene.load import load_scene
    from kc2spice.workflow.bench import bench as measure

    loaded, names = load_scene(scene, set_ or []), tuple(metric or ())
    out = out or Path(f"{loaded.name}_bench")
    wanted: dict[str, Any] = {"error": error, "metric": names, "repeats": repeats, "trust": trust}
    with shown_progress(quiet) as progress:
        record = measure(loaded, out, **wanted, progress=progress)
    given = shlex.join([scene, *(word for each in set_ or () for word in ("--set", each))])
    _answer(record, out, as_json, quiet, lambda: show_bench(record, given, out))
    if record["recommended"] is None:
        raise typer.Exit(GateMissedError.exit_code)


@app.command(cls=_Command)
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
    out: Out = None,
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
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Run SCENE over ranges of its keys; a table with a row for each point.

    A sweep that was interrupted goes on where it was when the same command is given again. Points
    that share finite elements or a reduced model share them. Points that fail are rows that say
    why.
    """
    from kc2spice.cli.tables import show_sweep
    from kc2spice.workflow.sweep import run as study
    from kc2spice.workflow.sweep import workers as pools

    table = study.table_name(table_format)
    found = study.named_sweep(
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
    result = {"scene": found.scene.name, "points": found.plan.size, "failed": 0, "resumed": 0}
    result |= {"table": str((out / table).absolute()), "runs": found.runs}
    if not dry_run:
        again: dict[str, Any] = {"table_format": table_format, "retry_failed": retry_failed}
        try:
            with shown_progress(quiet) as progress:
                result = study.sweep(found, out, pool, progress, **again)
        except KeyboardInterrupt:
            told = f"the points run so far are kept in {out}, the same command runs the rest"
            print(f"kc2spice: interrupted; {told}", file=sys.stderr)
            raise typer.Exit(INTERRUPTED) from None
    if as_json:
        print(json.dumps(result))
    elif not quiet:
        show_sweep(result)
    if result["points"] == result["failed"]:
        hint = "the column status says why"
        raise SimulationError("every point failed", where=result["table"], hint=hint)
