"""The command ``bench``: its options and its tables."""

import json
import shlex
from pathlib import Path
from typing import Annotated, Any

import typer

from kc2spice.cli.console import directory, print_table, reported_errors, shown_progress
from kc2spice.core.errors import GateMissedError


def bench(
    scene: Annotated[
        str,
        typer.Argument(metavar="SCENE", help="Gallery name (see 'scenes') or path of a TOML file."),
    ],
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
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            metavar="DIR",
            parser=directory,
            help="Where to write; default: ./NAME_bench.",
        ),
    ] = None,
    set_: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Override a key. Repeatable."),
    ] = None,
    repeats: Annotated[int, typer.Option(min=1, help="Runs of each; the median counts.")] = (5),
    trust: Annotated[
        bool, typer.Option("--trust", help="Let included netlists act on this machine.")
    ] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="One JSON object on stdout, all else on stderr.")
    ] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress, no tables.")] = False,
) -> None:
    """Measure SCENE's error against time over its settings; recommend the cheapest one.

    Settings are the numerical ones that 'explain' lists, but meshes, which take no time of the
    simulator; the reference has all of them at their finest. Exit code 4 when no setting is within
    --error.
    """
    with reported_errors():
        from kc2spice.scene.load import load_scene
        from kc2spice.workflow.bench import bench as measure

        given = list(set_ or [])
        loaded = load_scene(scene, given)
        directory = out or Path(f"{loaded.name}_bench")
        with shown_progress(quiet) as progress:
            record = measure(
                loaded,
                directory,
                error=error,
                metric=tuple(metric or ()),
                repeats=repeats,
                trust=trust,
                progress=progress,
            )
        if as_json:
            print(json.dumps({**record, "directory": str(directory.absolute())}))
        elif not quiet:
            _show(scene, given, record, directory)
        if record["recommended"] is None:
            raise typer.Exit(GateMissedError.exit_code)


def _show(scene: str, given: list[str], record: dict[str, Any], directory: Path) -> None:
    from kc2spice.report.bench_page import HEAD, point_rows, recommendation

    front = {**record, "points": [p for p in record["points"] if p["front"] or p["own"]]}
    print_table("front", point_rows(front), HEAD)
    print_table("bench", recommendation(record))
    if record["recommended"] is not None:
        words = [word for each in given for word in ("--set", each)]
        words += record["recommended"]["set"]
        print(f"kc2spice run {' '.join(map(shlex.quote, (scene, *words)))}")
    print(f"all of it: {directory / 'bench.html'}")
