"""``python -m laboratory`` with ``tests/benchmarks`` on the path; ``make bench`` runs it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from kc2spice.cli.console import print_table, reported_errors, shown_progress
from laboratory.page import bench_sections, machine_line
from laboratory.run import PARTS, bench


def main(
    part: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME", help=f"Only this part: {', '.join(PARTS)}. Repeatable; default: all."
        ),
    ] = None,
    out: Annotated[Path, typer.Option("--out", "-o", metavar="DIR", help="Where to write.")] = Path(
        "bench"
    ),
    repeats: Annotated[int, typer.Option(min=1, help="Runs of each point; the median counts.")] = 5,
    quick: Annotated[
        bool, typer.Option("--quick", help="Coarse models and few points: shape, not numbers.")
    ] = False,
    full_sweep: Annotated[
        bool,
        typer.Option(
            "--full-sweep", help="Also run what is otherwise timed on a sample or left out: hours."
        ),
    ] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="One JSON object on stdout, all else on stderr.")
    ] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress, no tables.")] = False,
) -> None:
    """Measure speed against error: ngspice, its peers and a lower bound.

    Writes bench.json, bench.md and a plot of each plane. A target that is missed is
    a row of the table, not a failure of the command.
    """
    with reported_errors():
        with shown_progress(quiet) as progress:
            record = bench(
                out, part or (), quick=quick, full_sweep=full_sweep, repeats=repeats,
                progress=progress,
            )  # fmt: skip
        if as_json:
            print(json.dumps({**record, "directory": str(out.absolute())}))
        elif not quiet:
            _show(record, out)


def _show(record: dict[str, Any], out: Path) -> None:
    print(machine_line(record))
    for section in bench_sections(record):
        print_table(section.title, section.rows, header=section.head)
        if section.note:
            print(f"  {section.note}\n")
    print(f"all of it, with plots: {out / 'bench.md'}")


if __name__ == "__main__":
    typer.run(main)
