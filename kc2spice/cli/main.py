"""Command line: commands, progress and exit codes.

Slow imports are inside the commands, so that ``--help`` prints without delay. This module does not
postpone annotations, because typer would then evaluate each annotation three times, which delays
``--help``.
"""

import gc
import inspect
import os
import shlex
import sys
import textwrap
from collections.abc import Callable, Mapping
from itertools import chain
from pathlib import Path
from typing import Annotated, Any

import typer

from kc2spice.cli.arguments import PARAMETERS
from kc2spice.cli.terminal_output import (
    INTERRUPTED_EXIT_CODE,
    PIPED_COLUMNS,
    OutputRecipient,
    print_files,
    print_notes,
    print_table,
    print_tables,
    report_errors,
)
from kc2spice.cli.usage_errors import CheckedCommand, CheckedCommands
from kc2spice.core import __version__
from kc2spice.core.argument_and_option_names import use_options_in_errors
from kc2spice.core.errors import GateMissedError, MissingToolError, SimulationError, UsageError
from kc2spice.core.signal_handlers import end_on_signals

EXAMPLES = {
    "run": (
        "kc2spice run buzzer_7bb_20_6",
        "kc2spice run kick_and_catch --set 'control.kd=25 A s/m' --out faster",
    ),
    "export": (
        "kc2spice export impact --dialect ltspice --out netlists",
        "kc2spice export --rom NAME_rom/NAME_rom.npz",
    ),
    "verify": ("kc2spice verify impact", "kc2spice verify --all --out verify"),
    "explain": (
        "kc2spice explain buzzer_7bb_20_6",
        "kc2spice explain impact --set contact.shape=pressure",
    ),
    "scenes": ("kc2spice scenes buzzer_square > my.toml", "kc2spice scenes --part disc"),
    "parts": ("kc2spice parts murata", "kc2spice parts relay --json"),
    "doctor": ("kc2spice doctor", "kc2spice doctor --json"),
    "reduce": (
        "kc2spice reduce NAME.K --tolerance 1e-4 --band 0 5e5",
        "kc2spice reduce NAME.npz --method compare",
        "kc2spice reduce GAIN.csv --shunt '100 Ohm'",
        "kc2spice reduce COOLING.csv --power '2 W' --network cauer",
    ),
    "fit": (
        "kc2spice fit buzzer_7bb_20_6:disc DATA.csv --vary damping.quality=10:200",
        "kc2spice fit MY.toml:disc DATA.s1p --vary 'layers[0].thickness'",
        "kc2spice fit MY.toml:disc GAIN.csv --shunt '100 Ohm' --vary damping.quality",
        "kc2spice fit MY.toml:woofer CURVES.toml --vary bl=5:9 --vary mms --vary fs",
    ),
    "bench": ("kc2spice bench impact --error 1e-4", "kc2spice bench kick_and_catch --repeats 3"),
    "sweep": (
        "kc2spice sweep impact --set impact.velocity=-1:-0.2:5",
        "kc2spice sweep kick_and_catch --set control.kp=log:2e4:2e5:10 --dry-run",
    ),
}


app = typer.Typer(
    name="kc2spice",
    cls=CheckedCommands,
    help="Turn finite-element models of transducers into SPICE subcircuits, and simulate them with "
    "their drive electronics.",
    epilog="SCENE is a TOML file, the name of a built-in scene (kc2spice scenes), or a part number "
    "(kc2spice parts). For a first simulation, type: kc2spice run buzzer_7bb_20_6\n\n"
    "Exit codes: 0 success, 2 wrong usage or scene, 3 missing simulator or library, "
    "4 an error exceeds its limit, 5 the simulation or one of its checks failed.",
    no_args_is_help=True,
    add_completion=True,
    pretty_exceptions_enable=False,
    # The help text is plain, because the library ``rich`` takes as long to load as all other
    # modules together.
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def run_command_line() -> None:
    """Run the command line and end the program."""
    # The matrices are sparse and small: threads of BLAS and ngspice mostly wait for each other. The
    # variables must be set before numpy is loaded. Values that the user has set are not changed.
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
    # Pydantic then does not search all installed packages for plugins.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "1")
    # Frequent garbage collections would take time, and free little memory: nearly all imported
    # objects exist until the program ends.
    gc.set_threshold(100_000)
    try:
        # A wrong option before the name of a command raises an error before any command starts.
        # ``report_errors`` therefore also encloses the call of the app.
        with end_on_signals(), report_errors():
            app()
    except typer.Exit as end:
        raise SystemExit(end.exit_code) from None
    finally:
        gc.freeze()  # skips the last garbage collection of all imported objects


def _print_version(requested: bool) -> None:
    """Print the version and end the program."""
    if requested:
        print(f"kc2spice {__version__}")
        raise typer.Exit


@app.callback()
def _common_options(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version and exit."
        ),
    ] = False,
) -> None:
    """Accept the options before the name of the command, such as ``--version``."""
    pass


def _register_command(function: Callable[..., None]) -> Callable[..., None]:
    """Register a function such as ``_run(caller, …)`` as the command ``run``.

    ``PARAMETERS`` describes the options of the command. Every command also has the options
    ``--json`` and ``--quiet``. If the command raises an exception, the program prints one message
    and ends with an exit code.
    """

    def run_command(as_json: bool, quiet: bool, **words: Any) -> None:
        """Run the command with its options."""
        with report_errors():
            function(OutputRecipient(as_json, quiet), **words)

    name = run_command.__name__ = function.__name__.removeprefix("_")
    run_command.__doc__ = function.__doc__
    _, *command_parameters = inspect.signature(function).parameters.values()
    flags = (
        item.replace(default=False) for item in inspect.signature(run_command).parameters.values()
    )
    parameters = []
    for item in (*command_parameters, next(flags), next(flags)):
        info = PARAMETERS.get(f"{name}.{item.name}") or PARAMETERS[item.name]
        parameters.append(item.replace(annotation=Annotated[item.annotation, info]))
    run_command.__annotations__ = {item.name: item.annotation for item in parameters}
    run_command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    # typer does not wrap a paragraph that begins with a backspace character
    epilog = "\b\nExamples:\n" + "\n".join(f"  {line}" for line in EXAMPLES[name])
    app.command(cls=CheckedCommand, epilog=epilog)(run_command)
    return function


def _load_scene(scene: str, set_: list[str] | None) -> Any:
    """Load a scene, and override its keys with the values of the option ``--set``."""
    from kc2spice.scene.load import load_scene

    return load_scene(scene, set_ or [])


@_register_command
def _run(
    caller: OutputRecipient,
    scene: str,
    out: Path | None = None,
    set_: list[str] | None = None,
    deck: Path | None = None,
    png: bool = False,
    keep: bool = False,
    trust: bool = False,
    verbose: bool = False,
) -> None:
    """Simulate SCENE, check the result and print the metrics.

    Builds and reduces the models, writes the netlists, runs ngspice and checks the result. At the
    end, all files are moved to DIR; report.html contains the curves.
    """
    from kc2spice.cli.terminal_output import print_result
    from kc2spice.workflow import run as study

    loaded = _load_scene(scene, set_)
    out = out or Path(loaded.name)
    with caller.open_progress_display() as progress:
        result = study.run_scene(loaded, out, progress, trust=trust, deck=deck, keep=keep, png=png)
    if caller.print_json_if_requested(result, out):
        print_result(result, out, verbose=verbose)


@_register_command
def _export(
    caller: OutputRecipient,
    scene: str | None = None,
    out: Path | None = None,
    set_: list[str] | None = None,
    dialect: str = "ngspice",
    trust: bool = False,
    tolerance: float | None = None,
    count: int | None = None,
    solver: str | None = None,
    rom: Path | None = None,
    dense: bool = False,
) -> None:
    """Write the netlists of SCENE or of a reduced model.

    Writes the deck, one library for each part, and symbols for KiCad and LTspice. Exit code 4 if a
    circuit misses the tolerance of its reduced model. If rounding of the matrix entries explains
    the circuit's error, the command prints a warning and does not fail.
    """
    if rom is not None:
        settings = {"SCENE": scene, "--set": set_, "--tolerance": tolerance, "--count": count}
        settings |= {"--solver": solver, "--trust": trust or None}
        if others := [name for name, value in settings.items() if value not in (None, [])]:
            raise UsageError(
                f"--rom cannot be combined with {' and '.join(others)}",
                where="export",
                got=f"--rom {rom} with {' and '.join(others)}",
                expected="SCENE with its options, or --rom FILE with --dialect, --dense and --out",
                hint=f"kc2spice export --rom {rom}",
            )
        from kc2spice.workflow.reduction_of_models_from_files import export_rom

        files, head = export_rom(rom, out, dialect=dialect, dense=dense), {"rom": str(rom)}
    elif scene is None:
        raise UsageError(
            "a SCENE or --rom FILE is missing",
            where="export",
            got="neither SCENE nor --rom",
            expected="kc2spice export SCENE, or kc2spice export --rom FILE",
            hint="for example  kc2spice export impact",
        )
    elif dense:
        raise UsageError(
            "--dense applies only to a reduced model",
            where="export",
            got=f"{scene} --dense",
            expected="--dense with --rom FILE",
            hint="leave out --dense",
        )
    else:
        from kc2spice.core.user_warnings import collect_warnings, warn_user
        from kc2spice.workflow.export import export_scene

        overrides = [] if tolerance is None else [f"rom.tolerance={tolerance}"]
        try:
            with collect_warnings() as warnings:
                loaded = _load_scene(scene, [*(set_ or []), *overrides])
            for text in warnings:
                warn_user(text.replace(f"'rom.tolerance={tolerance}'", f"--tolerance {tolerance}"))
        except UsageError as error:
            if overrides and error.where == f"--set {overrides[0]!r}":
                error.where, error.got = "--tolerance", f"{tolerance:g}"
                hint = (error.hint or "").replace("--set rom.tolerance=", "--tolerance ")
                error.hint = hint.replace("rom.tolerance", "--tolerance") or None
            raise
        out, head = out or Path(loaded.name), {"scene": loaded.name}
        choices: dict[str, Any] = {"trust": trust, "count": count, "solver": solver}
        with caller.open_progress_display() as progress:
            files = export_scene(loaded, out, dialect, progress, **choices)
    names, folder = [path.name for path in files], files[0].parent
    if caller.print_json_if_requested({**head, "files": names}, folder):
        print_files(folder, names)


@_register_command
def _verify(
    caller: OutputRecipient,
    scene: str | None = None,
    all_: bool = False,
    full: bool = False,
    deck: Path | None = None,
    out: Path | None = None,
    set_: list[str] | None = None,
    trust: bool = False,
) -> None:
    """Compare full model, reduced model and netlist of SCENE.

    Writes verify.json and verify.html into DIR. Exit code 4 if an error exceeds its limit.
    """
    from kc2spice.scene.scene_file import list_gallery
    from kc2spice.workflow.verify.scene_verification import verify_scenes

    if (scene is None) is not all_:
        got = "neither SCENE nor --all" if scene is None else f"{scene} and --all"
        raise UsageError(
            "the command needs either a SCENE or --all",
            where="verify",
            got=got,
            expected="kc2spice verify SCENE, or kc2spice verify --all",
            hint=f"for example  kc2spice verify {scene or 'impact'}",
        )
    loaded = [_load_scene(name, set_) for name in ([scene] if scene else list_gallery())]
    out = out or Path("verify" if all_ else f"{loaded[0].name}_verify")
    with caller.open_progress_display() as progress:
        result = verify_scenes(loaded, out, full=full, deck=deck, trust=trust, progress=progress)
    if caller.print_json_if_requested(
        result if all_ else next(iter(result["scenes"].values())), out
    ):
        from kc2spice.report.verify_page import format_verification

        for name, item in result["scenes"].items():
            print_tables(format_verification(name, item))
            print(*(f"  {note}\n" for note in item["notes"]), sep="", end="")
        print(f"differences of all results, with plots: {out / 'verify.html'}")
    if not result["passed"]:
        raise typer.Exit(GateMissedError.exit_code)


@_register_command
def _explain(caller: OutputRecipient, scene: str, set_: list[str] | None = None) -> None:
    """Explain what the model of SCENE includes and neglects.

    Lists parts, joined pins, numerical settings with their error estimates, and neglected effects
    with their estimated size.
    """
    from kc2spice.core.progress import StageTimer
    from kc2spice.scene.numerical_settings import describe_analysis, describe_plan
    from kc2spice.scene.scene_classes import compute_scene_hash
    from kc2spice.workflow.part_models import build_models

    loaded = _load_scene(scene, set_)
    build = build_models(loaded, StageTimer())
    step = (
        None
        if build.largest_step is None
        else {"s": build.largest_step.step, "why": build.largest_step.why}
    )
    head = {"scene": loaded.name, "hash": compute_scene_hash(loaded), "largest_step": step}
    head["analysis"] = describe_analysis(loaded)
    record = {**head, **describe_plan(build)}
    if caller.print_json_if_requested(record):
        from kc2spice.report.run_page import format_model_summary

        print(textwrap.fill(f"{record['scene']}: {loaded.title}", PIPED_COLUMNS))
        print(f"Analysis: {record['analysis']}\n")
        for section in format_model_summary(record):
            if not section.rows:
                continue
            print_tables([section])
            if section.note:
                print(textwrap.fill(section.note, PIPED_COLUMNS))
            print()
        print_table("Connections", [(line,) for line in record["joins"]])
        print("".join(f"{line}\n" for line in record["frames"]))
        print(f"Scene hash: {record['hash']}")


@_register_command
def _scenes(
    caller: OutputRecipient,
    scene: str | None = None,
    keys: bool = False,
    parts: bool = False,
    part_type: str | None = None,
) -> None:
    """List the scenes or part types, or print a scene as TOML."""
    from dataclasses import asdict

    from kc2spice.cli.part_type_output import print_keys, print_part_type
    from kc2spice.cli.usage_errors import read_scene_toml
    from kc2spice.scene.keys import list_all_keys
    from kc2spice.scene.load import load_scene
    from kc2spice.scene.part_type_descriptions import describe_part_type, describe_part_types
    from kc2spice.scene.scene_file import list_gallery

    options = {"--keys": keys, "--parts": parts, f"--part {part_type}": part_type is not None}
    options = {str(scene): scene is not None} | options
    first, *others = [name for name, chosen in options.items() if chosen] or [""]
    for other in others:
        raise UsageError(
            f"{first} cannot be combined with {other}",
            where="scenes",
            got=f"{first} {other}",
            expected=f"either {first} or {other}",
            hint=f"run kc2spice scenes {first}, then kc2spice scenes {other}",
        )
    if keys:
        scene_keys = list(list_all_keys())
        if caller.print_data(list(map(asdict, scene_keys))):
            print_keys("Keys of a scene", scene_keys)
    elif parts:
        docs = list(describe_part_types())
        if caller.print_data(list(map(asdict, docs))):
            print_table("part types", [(doc.name, doc.title) for doc in docs], names=0)
    elif part_type is not None:
        doc = describe_part_type(part_type)
        if caller.print_data(asdict(doc)):
            print_part_type(doc)
    elif scene is not None:
        text = read_scene_toml(scene)
        if caller.as_json:
            caller.print_data({"scene": scene, "toml": text})
        else:
            print(text, end="")
    else:
        titles = {name: load_scene(name).title for name in list_gallery()}
        if caller.print_data(titles):
            print_table("scenes", list(titles.items()))


@_register_command
def _parts(caller: OutputRecipient, search: str | None = None) -> None:
    """List commercial parts, or print the keys of one part number.

    All commands with an argument SCENE accept a part number in place of SCENE.
    """
    from dataclasses import asdict

    from kc2spice.scene.catalogue import find_part, search_parts
    from kc2spice.scene.part_type_descriptions import write_catalogue_table

    parts = search_parts(search or "")
    if caller.print_data(list(map(asdict, parts))):
        rows = [(part.number, part.maker, part.device, part.kind) for part in parts]
        print_table("parts", rows, ("number", "maker", "device", "part type"), names=0)
        if (sold := find_part(search or "")) is not None:
            print(f"TOML table of this part in a scene:\n{write_catalogue_table(sold)}")


@_register_command
def _doctor(caller: OutputRecipient) -> None:
    """Check the installation, and print how to correct each fault."""
    from dataclasses import asdict

    from kc2spice.cli.doctor import check_installation, describe_program
    from kc2spice.cli.doctor_output import print_findings

    findings, program = list(check_installation()), describe_program()
    record = {"program": program, "findings": list(map(asdict, findings))}
    if caller.print_json_if_requested(record):
        print_findings(program, findings)
    if any(finding.needed and not finding.ok for finding in findings):
        raise typer.Exit(MissingToolError.exit_code)


@_register_command
def _reduce(
    caller: OutputRecipient,
    model: str,
    out: Path | None = None,
    band: tuple[float, float] | None = None,
    tolerance: float | None = None,
    order: int | None = None,
    norm: str | None = None,
    method: str | None = None,
    solver: str | None = None,
    dc: str | None = None,
    shunt: str | None = None,
    power: str | None = None,
    network: str | None = None,
) -> None:
    """Build a small model from matrices or measured data.

    Writes the reduced model with an error estimate into DIR. Exit code 4 for an unstable model, a
    circuit that misses the tolerance, or a measurement that no circuit describes. If rounding of
    the matrix entries explains the circuit's error, the command prints a warning and does not fail.
    """
    from kc2spice.workflow.reduction_of_models_from_files import reduce_file as reduce_study
    from kc2spice.workflow.reduction_of_models_from_files import require_stable

    options: dict[str, Any] = {"band": band, "tolerance": tolerance, "order": order, "norm": norm}
    if method not in (None, "compare"):
        from kc2spice.workflow.method_comparison import require_method_option

        require_method_option(method)
    if method == "compare":
        no_effect = {"--out": out, "--dc": dc, "--shunt": shunt}
        no_effect |= {"--power": power, "--network": network}
        _compare_methods(caller, model, {**options, "solver": solver}, no_effect)
        return
    options |= {"dc": dc, "shunt": shunt, "power": power, "network": network}
    options |= {"method": method, "solver": solver}
    with use_options_in_errors(options), caller.open_progress_display() as progress:
        result = reduce_study(model, out, **options, progress=progress)
    if caller.print_json_if_requested(result):
        from kc2spice.cli.reduction_output import print_reduction

        print_reduction(result)
    require_stable(result)


def _compare_methods(
    caller: OutputRecipient, model: str, options: dict[str, Any], no_effect: Mapping[str, object]
) -> None:
    """Compare all reduction methods by state count, error estimate and CPU time."""
    from kc2spice.workflow.method_comparison import compare_methods
    from kc2spice.workflow.reduction_of_models_from_files import require_stable

    for option, value in no_effect.items():
        if value is not None:
            raise UsageError(
                "this option cannot be combined with --method compare",
                where=option,
                got=value,
                expected="--method compare without this option",
                hint=f"leave out {option}",
            )
    with use_options_in_errors(options), caller.open_progress_display() as progress:
        result = compare_methods(model, **options, progress=progress)
    if caller.print_json_if_requested(result):
        from kc2spice.cli.reduction_output import print_comparison

        print_comparison(result)
    require_stable(result)


@_register_command
def _fit(
    caller: OutputRecipient,
    target: str,
    data: Path,
    vary: list[str] | None = None,
    shunt: str | None = None,
    out: Path | None = None,
    set_: list[str] | None = None,
) -> None:
    """Fit parameters of a part to measured curves.

    Writes the fitted keys to fit.toml, a file for --set, and plots to report.html in DIR. The fit
    of a disc takes seconds, the fit of a solid takes minutes.
    """
    from kc2spice.workflow.fit import fit as fit_study

    name, colon, part = target.rpartition(":")
    if not colon:
        raise UsageError(
            "the name of the part is missing",
            where="fit",
            got=target,
            expected="SCENE:PART, such as buzzer_7bb_20_6:disc",
            hint=f"write {target}:PART with a part that 'kc2spice explain {target}' lists",
        )
    scene = _load_scene(name, set_)
    with (
        use_options_in_errors(("vary", "shunt", "out")),
        caller.open_progress_display() as progress,
    ):
        out = out or Path(f"{part}_fit")
        result = fit_study(scene, part, data, vary or (), out, progress, shunt=shunt)
    if caller.print_json_if_requested(result):
        from kc2spice.report.fit_page import format_fit

        print_tables(format_fit(result))
        print_notes(result)
        print(f"values, for --set: {result['overrides']}\nwith plots: {result['page']}")


@_register_command
def _bench(
    caller: OutputRecipient,
    scene: str,
    error: float = 1e-4,
    metric: list[str] | None = None,
    out: Path | None = None,
    set_: list[str] | None = None,
    repeats: int = 5,
    trust: bool = False,
) -> None:
    """Find the fastest settings that keep the error within a limit.

    Measures error and CPU time of SCENE for several values of the numerical settings that 'explain'
    lists, except meshes. The reference solution has the finest value of every setting. Exit code 4
    if no combination of settings has an error of at most --error.
    """
    from kc2spice.workflow.bench import bench as measure

    loaded, names = _load_scene(scene, set_), tuple(metric or ())
    out = out or Path(f"{loaded.name}_bench")
    options: dict[str, Any] = {"error": error, "metric": names, "repeats": repeats, "trust": trust}
    with caller.open_progress_display() as progress:
        record = measure(loaded, out, **options, progress=progress)
    recommended = record["recommended"]
    if caller.print_json_if_requested(record, out):
        from kc2spice.report.bench_page import format_bench

        front = [point for point in record["points"] if point["front"] or point["own"]]
        print_tables(format_bench({**record, "points": front}))
        if recommended is not None:
            settings = chain.from_iterable(("--set", item) for item in set_ or ())
            print("kc2spice run", shlex.join([scene, *settings, *recommended["set"]]))
        print(f"full results: {out / 'bench.html'}")
    if recommended is None:
        raise typer.Exit(GateMissedError.exit_code)


@_register_command
def _sweep(
    caller: OutputRecipient,
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
    """Run SCENE at many values of its keys.

    Writes a table with one row for each point, and sweep.html with curves. An interrupted sweep
    continues if the same command is repeated. The row of a failed point states the cause.
    """
    from kc2spice.workflow.sweep import sweep_execution
    from kc2spice.workflow.sweep.workers import (
        count_available_cores,
        make_dask_connector,
        make_local_pool_opener,
    )

    table = sweep_execution.get_table_file_name(table_format)
    options: dict[str, Any] = {"zipped": zipped, "latin": latin, "seed": seed, "timeout": timeout}
    definition = sweep_execution.load_named_sweep(
        scene, set_ or (), metrics=metric or (), **options
    )
    out = out or Path(f"{definition.scene.name}_sweep")
    count = workers or count_available_cores()
    pool = make_local_pool_opener(count) if dask is None else make_dask_connector(dask, count)
    if not caller.quiet:
        print(definition.describe(), file=sys.stderr)
    result: dict[str, Any] = {
        "scene": definition.scene.name,
        "points": definition.plan.size,
        "failed": 0,
        "resumed": 0,
    }
    result |= {"table": str((out / table).absolute()), "runs": definition.run_counts}
    if not dry_run:
        table_options: dict[str, Any] = {"table_format": table_format, "retry_failed": retry_failed}
        try:
            with caller.open_progress_display() as progress:
                result = sweep_execution.run_sweep(definition, out, pool, progress, **table_options)
        except KeyboardInterrupt:
            state = f"the points run so far are kept in {out}, the same command runs the rest"
            print(f"kc2spice: interrupted; {state}", file=sys.stderr)
            raise typer.Exit(INTERRUPTED_EXIT_CODE) from None
    if caller.print_json_if_requested(result):
        rows = [
            ("points", str(result["points"])),
            ("failed", str(result["failed"])),
            ("from an earlier run", str(result["resumed"])),
            ("table", str(out / table)),
        ]
        for name, share in result.get("yield", {}).items():
            low, high = share["low"], share["high"]
            rows.append((f"{name}: yield", f"{share['share']:.4g} (95 %: {low:.4g} … {high:.4g})"))
        pages = (name for name in result.get("files", ()) if name.endswith(".html"))
        rows += [("report", str(out / name)) for name in pages]
        print_table(f"Sweep of {result['scene']}", rows)
    if result["points"] == result["failed"]:
        raise SimulationError(
            "every point of the sweep failed",
            where=result["table"],
            hint="read the column status of this table: it states the cause of each failure",
        )
