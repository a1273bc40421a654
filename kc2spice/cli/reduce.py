"""The command ``reduce``, and what ``export --rom`` does."""

import json
from pathlib import Path
from typing import Annotated

import typer

from kc2spice.cli.console import directory, print_table, reported_errors, shown_progress
from kc2spice.cli.tables import above_band


def reduce(
    model: Annotated[
        str,
        typer.Argument(
            metavar="MODEL",
            help="NAME of Matrix Market or Harwell-Boeing files NAME.M .E .K .B .C (first order .A "
            ".B .C .D .E; heat .E .K), also NAME_K.mtx; a .npz or .mat file with such matrices; "
            "files of Abaqus, CalculiX, Nastran, Ansys; SCENE:PART for a scene's body. NAME.toml "
            "beside it names ports, units, supports and band; docs/matrices.md lists its keys.",
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            metavar="DIR",
            parser=directory,
            help="Where to write; default: ./NAME_rom.",
        ),
    ] = None,
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
    as_json: Annotated[
        bool, typer.Option("--json", help="One JSON object on stdout, everything else on stderr.")
    ] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress, no tables.")] = False,
) -> None:
    """Reduce matrices of another tool to a model of certified error.

    An unstable model ends with exit code 4.
    """
    with reported_errors():
        from kc2spice.workflow.reduce import reduce as reduce_study
        from kc2spice.workflow.reduce import require_stable

        with shown_progress(quiet) as progress:
            found = reduce_study(
                model,
                out,
                band=band,
                tolerance=tolerance,
                order=order,
                norm=norm,
                progress=progress,
            )
        if as_json:
            print(json.dumps(found))
        elif not quiet:
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
        require_stable(found)


def export_rom(
    rom: Path, out: Path | None, dialect: str, dense: bool, as_json: bool, quiet: bool
) -> None:
    """Write subcircuit, symbols and first deck of a reduced model and say where they are."""
    from kc2spice.workflow.reduce import export_rom as export_study

    written = export_study(rom, out, dialect=dialect, dense=dense)
    if as_json:
        where = str(written[0].parent.absolute())
        files = [path.name for path in written]
        print(json.dumps({"rom": str(rom), "directory": where, "files": files}))
    elif not quiet:
        print_table("files", [(str(path),) for path in written])
