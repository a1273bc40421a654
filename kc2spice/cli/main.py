"""The command line: options, progress and exit codes; the work is done by :mod:`kc2spice.workflow`.

Imports that take time stand inside the commands, so that ``--help`` answers at once. For the same
reason no annotation here is postponed: typer evaluates each such text three times.
"""

import gc
import inspect
import os
import shlex
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from kc2spice.cli.console import INTERRUPTED, Caller, print_table, reported_errors
from kc2spice.cli.options import PARAMETERS
from kc2spice.core.errors import GateMissedError, MissingToolError, SimulationError, UsageError
from kc2spice.core.version import __version__

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


def _command(function: Callable[..., None]) -> Callable[..., None]:
    """Makes a command of ``function(caller, …)``: its options are those of ``PARAMETERS`` and the
    caller's ``--json`` and ``--quiet``, its exceptions one message and an exit code."""

    def call(as_json: bool, quiet: bool, **words: Any) -> None:
        with reported_errors():
            function(Caller(as_json, quiet), **words)

    name = call.__name__ = function.__name__
    call.__doc__ = function.__doc__
    _, *own = inspect.signature(function).parameters.values()
    flags = inspect.signature(call).parameters
    common = [flags[each].replace(default=False) for each in ("as_json", "quiet")]
    call.__annotations__ = {}
    parameters = []
    for each in (*own, *common):
        info = PARAMETERS.get(f"{name}.{each.name}") or PARAMETERS[each.name]
        call.__annotations__[each.name] = Annotated[each.annotation, info]
        parameters.append(each.replace(annotation=Annotated[each.annotation, info]))
    call.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    app.command()(call)
    return function


@_command
def run(
    caller: Caller,
    scene: str,
    out: Path | None = None,
    set_: list[str] | None = None,
    deck: Path | None = None,
    png: bool = False,
    keep: bool = False,
    trust: bool = False,
) -> None:
    """Build, reduce, export and simulate SCENE.

    All files appear in DIR at the end; report.html has the plots.
    """
    from kc2spice.cli.tables import show_result
    from kc2spice.scene.load import load_scene
    from kc2spice.workflow import run as study

    loaded = load_scene(scene, set_ or [])
    out = out or Path(loaded.name)
    with caller.progress() as progress:
        found = study.run(loaded, out, progress, trust=trust, deck=deck, keep=keep, png=png)
    caller.answer(found, lambda: show_result(found, out), out)


@_command
def export(
    caller: Caller,
    scene: str | None = None,
    out: Path | None = None,
    set_: list[str] | None = None,
    dialect: str = "ngspice",
    trust: bool = False,
    tolerance: float | None = None,
    count: int | None = None,
    rom: Path | None = None,
    dense: bool = False,
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
        with caller.progress() as progress:
            files = write(loaded, out, dialect, progress, trust=trust, count=count)
    record = {**head, "files": [path.name for path in files]}
    rows = [(str(path),) for path in files]
    caller.answer(record, lambda: print_table("files", rows), files[0].parent)


@_command
def verify(
    caller: Caller,
    scene: str | None = None,
    all_: bool = False,
    full: bool = False,
    deck: Path | None = None,
    out: Path | None = None,
    set_: list[str] | None = None,
    trust: bool = False,
) -> None:
    """Check SCENE three ways: full model, reduced model, emitted netlist.

    Writes verify.json and verify.html into DIR. Exit code 4 when a gate of the scene is missed.
    """
    from kc2spice.cli.tables import show_verdicts
    from kc2spice.scene.load import gallery, load_scene
    from kc2spice.workflow.verify.verify import verify as verify_scenes

    if (scene is None) is not all_:
        raise UsageError("give either a SCENE or --all", where="verify")
    loaded = [load_scene(name, set_ or []) for name in ([scene] if scene else gallery())]
    out = out or Path("verify" if all_ else f"{loaded[0].name}_verify")
    with caller.progress() as progress:
        found = verify_scenes(loaded, out, full=full, deck=deck, trust=trust, progress=progress)
    passed = all(record["passed"] for record in found.values())
    record = {"passed": passed, "scenes": found} if all_ else next(iter(found.values()))
    caller.answer(record, lambda: show_verdicts(found, out), out)
    if not passed:
        raise typer.Exit(GateMissedError.exit_code)


@_command
def explain(caller: Caller, scene: str, set_: list[str] | None = None) -> None:
    """Say what is modelled, its numerical settings, what was left out and why."""
    from dataclasses import asdict

    from kc2spice.cli.tables import show_plan
    from kc2spice.core.progress import Clock
    from kc2spice.scene.load import load_scene
    from kc2spice.scene.model import scene_hash
    from kc2spice.scene.parttype import Build
    from kc2spice.workflow.models import build_models

    loaded = load_scene(scene, set_ or [])
    timed = loaded.analysis.type == "transient"
    build = build_models(loaded, Clock()) if timed else Build(loaded, {})
    step = None if build.largest is None else {"s": build.largest.step, "why": build.largest.why}
    head = {"scene": loaded.name, "hash": scene_hash(loaded), "largest_step": step}
    record = {**head, **asdict(build.plan)}
    caller.answer(record, lambda: show_plan(record, loaded.title))


@_command
def scenes(caller: Caller, keys: bool = False, parts: bool = False) -> None:
    """List the built-in scenes, all scene keys, or all part types."""
    from dataclasses import asdict

    from kc2spice.cli.tables import show_keys, show_parts
    from kc2spice.scene.keys import part_docs, scene_keys
    from kc2spice.scene.load import gallery, load_scene

    if keys and parts:
        raise UsageError("give either --keys or --parts", where="scenes")
    if keys or parts:
        found: list[Any] = list(scene_keys() if keys else part_docs())
        show = show_keys if keys else show_parts
        caller.answer([asdict(each) for each in found], lambda: show(found))
        return
    titles = {name: load_scene(name).title for name in gallery()}
    caller.answer(titles, lambda: print_table("scenes", list(titles.items())))


@_command
def doctor(caller: Caller) -> None:
    """Check ngspice and libraries; print the fix for what is missing."""
    from dataclasses import asdict

    from kc2spice.cli.doctor import examine
    from kc2spice.cli.tables import show_findings

    findings = list(examine())
    record = {"findings": [asdict(finding) for finding in findings]}
    caller.answer(record, lambda: show_findings(findings))
    if any(finding.needed and not finding.ok for finding in findings):
        raise typer.Exit(MissingToolError.exit_code)


@_command
def reduce(
    caller: Caller,
    model: str,
    out: Path | None = None,
    band: tuple[float, float] | None = None,
    tolerance: float | None = None,
    order: int | None = None,
    norm: str | None = None,
) -> None:
    """Reduce matrices of another tool, or a measured impedance, to a model of stated error.

    An unstable model ends with exit code 4.
    """
    from kc2spice.cli.tables import show_reduced
    from kc2spice.workflow.reduce import reduce as reduce_study
    from kc2spice.workflow.reduce import require_stable

    wanted: dict[str, Any] = {"band": band, "tolerance": tolerance, "order": order, "norm": norm}
    with caller.progress() as progress:
        found = reduce_study(model, out, **wanted, progress=progress)
    caller.answer(found, lambda: show_reduced(found))
    require_stable(found)


@_command
def fit(
    caller: Caller,
    target: str,
    data: Path,
    vary: list[str] | None = None,
    out: Path | None = None,
    set_: list[str] | None = None,
) -> None:
    """Vary keys of a body until its impedance is the measured one.

    Writes fit.toml with the values, for --set, and report.html into DIR. Tens of finite element
    models make a reduced one of the whole range, in which several starts descend: seconds of a
    disc, minutes of a solid.
    """
    from kc2spice.cli.tables import show_fit
    from kc2spice.scene.load import load_scene
    from kc2spice.workflow.fit import fit as fit_study

    name, colon, part = target.rpartition(":")
    if not colon:
        raise UsageError("names no part", where=target, expected="SCENE:PART")
    scene = load_scene(name, set_ or [])
    with caller.progress() as progress:
        found = fit_study(scene, part, data, vary or (), out or Path(f"{part}_fit"), progress)
    caller.answer(found, lambda: show_fit(found))


@_command
def bench(
    caller: Caller,
    scene: str,
    error: float = 1e-4,
    metric: list[str] | None = None,
    out: Path | None = None,
    set_: list[str] | None = None,
    repeats: int = 5,
    trust: bool = False,
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
    with caller.progress() as progress:
        record = measure(loaded, out, **wanted, progress=progress)
    given = shlex.join([scene, *(word for each in set_ or () for word in ("--set", each))])
    caller.answer(record, lambda: show_bench(record, given, out), out)
    if record["recommended"] is None:
        raise typer.Exit(GateMissedError.exit_code)


@_command
def sweep(
    caller: Caller,
    scene: str,
    set_: list[str] | None = None,
    zipped: bool = False,
    latin: bool = False,
    seed: int = 0,
    metric: list[str] | None = None,
    out: Path | None = None,
    table_format: str = "csv",
    workers: int | None = None,
    dask: str | None = None,
    timeout: float = 600.0,
    retry_failed: bool = False,
    dry_run: bool = False,
) -> None:
    """Run SCENE over ranges of its keys; a table with a row for each point.

    A sweep that was interrupted goes on where it was when the same command is given again. Points
    that share finite elements or a reduced model share them. Points that fail are rows that say
    why.
    """
    from kc2spice.cli.tables import show_sweep
    from kc2spice.scene.load import override_texts
    from kc2spice.workflow.sweep import run as study
    from kc2spice.workflow.sweep import workers as pools

    table = study.table_name(table_format)
    wanted: dict[str, Any] = {"zipped": zipped, "latin": latin, "seed": seed, "timeout": timeout}
    found = study.named_sweep(scene, override_texts(set_ or ()), metrics=metric or (), **wanted)
    out = out or Path(f"{found.scene.name}_sweep")
    count = workers or pools.cores()
    pool = pools.processes(count) if dask is None else pools.dask(dask, count)
    caller.note(found.describe())
    result = {"scene": found.scene.name, "points": found.plan.size, "failed": 0, "resumed": 0}
    result |= {"table": str((out / table).absolute()), "runs": found.runs}
    if not dry_run:
        again: dict[str, Any] = {"table_format": table_format, "retry_failed": retry_failed}
        try:
            with caller.progress() as progress:
                result = study.sweep(found, out, pool, progress, **again)
        except KeyboardInterrupt:
            told = f"the points run so far are kept in {out}, the same command runs the rest"
            print(f"kc2spice: interrupted; {told}", file=sys.stderr)
            raise typer.Exit(INTERRUPTED) from None
    caller.answer(result, lambda: show_sweep(result))
    if result["points"] == result["failed"]:
        hint = "the column status says why"
        raise SimulationError("every point failed", where=result["table"], hint=hint)
