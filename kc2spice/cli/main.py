"""The command line: options, progress and exit codes; the work is done by :mod:`kc2spice.workflow`.

Imports that take time stand inside the commands, so that ``--help`` answers at once. For the same
reason no module of a command postpones its annotations: typer evaluates each such text three times.
"""

import json
import os
import signal
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from kc2spice.cli.bench import bench
from kc2spice.cli.console import COLUMNS, directory, print_table, reported_errors, shown_progress
from kc2spice.cli.reduce import export_rom, reduce
from kc2spice.cli.sweep import sweep
from kc2spice.cli.tables import (
    show_findings,
    show_keys,
    show_parts,
    show_plan,
    show_result,
    show_verdicts,
)
from kc2spice.core.errors import GateMissedError, UsageError
from kc2spice.core.version import __version__

if TYPE_CHECKING:
    from kc2spice.scene.model import Scene

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


def _scene_names(incomplete: str) -> list[str]:
    """What the shell offers; file names come from the shell itself."""
    from importlib import resources

    names = (item.name for item in (resources.files("kc2spice") / "scenes").iterdir())
    return sorted(n[:-5] for n in names if n.startswith(incomplete) and n.endswith(".toml"))


SceneName = Annotated[
    str,
    typer.Argument(
        metavar="SCENE",
        help="Gallery name (see 'scenes') or path of a TOML file.",
        autocompletion=_scene_names,
    ),
]
Out = Annotated[
    Path | None,
    typer.Option(
        "--out",
        "-o",
        metavar="DIR",
        parser=directory,
        help="Where to write; default: ./NAME of the scene.",
    ),
]
Set = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Override a key, e.g. --set kick.drive.voltage=80 or --set control.kd='25 A s/m'. "
        "Repeatable; numbers are SI.",
    ),
]
Trust = Annotated[
    bool, typer.Option("--trust", help="Let included netlists act on this machine; see 'include'.")
]
AsJson = Annotated[
    bool, typer.Option("--json", help="One JSON object on stdout, everything else on stderr.")
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress, no tables.")]


def main() -> None:
    """Entry point of the ``kc2spice`` script."""
    # The matrices are sparse and small: threads of BLAS and of ngspice mostly wait for each other.
    # It must be said before numpy is loaded; whoever set a number of threads keeps it.
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "1")  # a search of all installed packages
    _leave_on_signals()
    try:
        with reported_errors():  # also of what stands outside the commands, such as --help
            app()
    except typer.Exit as end:
        raise SystemExit(end.exit_code) from None


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


@app.command()
def run(
    scene: SceneName,
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
    with reported_errors():
        study_scene, directory = _load(scene, set_, out)
        from kc2spice.workflow import run as study

        with shown_progress(quiet) as progress:
            result = study.run(
                study_scene, directory, progress, trust=trust, deck=deck, keep=keep, png=png
            )
        if as_json:
            print(json.dumps({**result, "directory": str(directory.absolute())}))
        elif not quiet:
            show_result(result, directory)


@app.command()
def export(
    scene: Annotated[
        str | None,
        typer.Argument(
            metavar="SCENE",
            help="Gallery name or path of a TOML file.",
            autocompletion=_scene_names,
        ),
    ] = None,
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
    with reported_errors():
        if rom is not None:
            if scene is not None or set_ or tolerance is not None or count is not None:
                raise UsageError(
                    "a reduced model is final", where="--rom", expected="no scene and no scene keys"
                )
            return export_rom(rom, out, dialect, dense, as_json, quiet)
        if scene is None:
            raise UsageError("nothing to export", expected="SCENE or --rom FILE")
        overrides = [*(set_ or []), *([] if tolerance is None else [f"rom.tolerance={tolerance}"])]
        study_scene, directory = _load(scene, overrides, out)
        from kc2spice.workflow.export import export as write_netlists

        with shown_progress(quiet) as progress:
            files = write_netlists(
                study_scene, directory, dialect, progress, trust=trust, count=count
            )
        if as_json:
            names = [path.name for path in files]
            where = str(directory.absolute())
            print(json.dumps({"scene": study_scene.name, "directory": where, "files": names}))
        elif not quiet:
            print_table("files", [(str(path),) for path in files])


@app.command()
def verify(
    scene: Annotated[
        str | None,
        typer.Argument(
            metavar="SCENE", help="Gallery name or TOML file.", autocompletion=_scene_names
        ),
    ] = None,
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

    Writes verify.json and verify.html into DIR (default ./NAME_verify). Exit code 4 when a
    gate of the scene is missed.
    """
    with reported_errors():
        from kc2spice.scene.load import gallery, load_scene

        if (scene is None) is not all_:
            raise UsageError("give either a SCENE or --all", where="verify")
        names = [scene] if scene is not None else list(gallery())
        loaded = [load_scene(name, set_ or []) for name in names]
        directory = out or Path("verify" if all_ else f"{loaded[0].name}_verify")
        from kc2spice.netlist.deck import read_deck
        from kc2spice.workflow.verify.verify import verify as verify_scenes

        shipped = None if deck is None else read_deck(deck)
        with shown_progress(quiet) as progress:
            found = verify_scenes(
                loaded, directory, full=full, deck=shipped, trust=trust, progress=progress
            )
        passed = all(record["passed"] for record in found.values())
        if as_json:
            record = {"passed": passed, "scenes": found} if all_ else next(iter(found.values()))
            print(json.dumps({**record, "directory": str(directory.absolute())}))
        elif not quiet:
            show_verdicts(found, directory)
        if not passed:
            raise typer.Exit(GateMissedError.exit_code)


@app.command()
def explain(scene: SceneName, set_: Set = None, as_json: AsJson = False) -> None:
    """Say what is modelled, its numerical settings, what was left out and why."""
    with reported_errors():
        import textwrap
        from dataclasses import asdict

        from kc2spice.core.progress import Clock, silent
        from kc2spice.scene.hash import scene_hash
        from kc2spice.scene.load import load_scene
        from kc2spice.scene.plan import plan
        from kc2spice.workflow.models import build_models

        loaded = load_scene(scene, set_ or [])
        timed = loaded.analysis.type == "transient"
        build = build_models(loaded, Clock(silent)) if timed else None
        limit = None if build is None else build.largest
        found = plan(loaded, build)
        if as_json:
            head = {"scene": loaded.name, "hash": scene_hash(loaded)}
            step = None if limit is None else {"s": limit.step, "why": limit.why}
            print(json.dumps({**head, "largest_step": step, **asdict(found)}))
            return
        print(textwrap.fill(f"{loaded.name}: {loaded.title}", COLUMNS))
        print(f"scene hash {scene_hash(loaded)}\n")
        show_plan(found)
        if limit is not None:
            print(textwrap.fill(f"largest step {limit.step:.3g} s: {limit.why}", COLUMNS))


@app.command()
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
    with reported_errors():
        from dataclasses import asdict

        from kc2spice.scene.keys import scene_keys
        from kc2spice.scene.load import gallery, load_scene

        if keys and parts:
            raise UsageError("give either --keys or --parts", where="scenes")
        if parts:
            from kc2spice.scene.partdocs import part_docs

            docs = list(part_docs())
            if as_json:
                print(json.dumps([asdict(doc) for doc in docs]))
            else:
                show_parts(docs)
            return
        if keys and as_json:
            print(json.dumps([asdict(key) for key in scene_keys()]))
            return
        if keys:
            show_keys(scene_keys())
            return
        found = {name: load_scene(name).title for name in gallery()}
        if as_json:
            print(json.dumps(found))
        else:
            print_table("scenes", list(found.items()))


@app.command()
def doctor(as_json: AsJson = False) -> None:
    """Check ngspice and libraries; print the fix for what is missing."""
    with reported_errors():
        from dataclasses import asdict

        from kc2spice.cli.doctor import examine

        findings = list(examine())
        if as_json:
            print(json.dumps({"findings": [asdict(finding) for finding in findings]}))
        else:
            show_findings(findings)
        if any(finding.needed and not finding.ok for finding in findings):
            raise typer.Exit(3)


app.command()(reduce)
app.command()(bench)
app.command()(sweep)


def _load(name: str, overrides: list[str] | None, out: Path | None) -> tuple["Scene", Path]:
    from kc2spice.scene.load import load_scene

    loaded = load_scene(name, overrides or [])
    return loaded, out if out is not None else Path(loaded.name)
