"""Every argument and option of the command line, stated once.

A row's name is that of a parameter, or ``command.parameter`` where commands differ.
"""

from importlib import resources
from pathlib import Path

import typer


def _names(incomplete: str) -> list[str]:
    """What the shell offers; file names come from the shell itself."""
    names = (item.name for item in (resources.files("kc2spice") / "scenes").iterdir())
    return sorted(n[:-5] for n in names if n.startswith(incomplete) and n.endswith(".toml"))


def _directory(text: str) -> Path:
    if not text.strip():  # Path("") would be where one stands
        raise typer.BadParameter("names no directory; . is the one you are in")
    return Path(text)


PARAMETERS = {
    "scene": typer.Argument(
        metavar="SCENE",
        help="Gallery name (see 'scenes') or path of a TOML file.",
        autocompletion=_names,
    ),
    "sweep.scene": typer.Argument(
        metavar="SCENE", help="Gallery name, study name, or path of a TOML file of either."
    ),
    "model": typer.Argument(
        metavar="MODEL",
        help="NAME of Matrix Market or Harwell-Boeing files NAME.M .E .K .B .C (first order .A "
        ".B .C .D .E; heat .E .K), also NAME_K.mtx; a .npz or .mat file with such matrices; "
        "files of Abaqus, CalculiX, Nastran, Ansys; SCENE:PART for a scene's body; a measured "
        "response (.s1p, .s2p, .csv, .txt, .mat), which becomes a passive circuit. NAME.toml "
        "beside it names ports, units, supports and band; docs/matrices.md lists its keys.",
    ),
    "target": typer.Argument(metavar="SCENE:PART", help="A body of a scene."),
    "data": typer.Argument(metavar="DATA", help="Its measured impedance: .s1p, .csv, .txt, .mat."),
    "out": typer.Option(
        "--out",
        "-o",
        metavar="DIR",
        parser=_directory,
        help="Where to write; default: ./NAME, ./NAME_verify, ./NAME_bench, ./NAME_sweep, "
        "./NAME_rom or ./PART_fit.",
    ),
    "set_": typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Override a key, e.g. --set kick.drive.voltage=80 or --set control.kd='25 A s/m', or "
        "all that a TOML file has, such as that of a fit. Repeatable; numbers are SI.",
    ),
    "sweep.set_": typer.Option(
        "--set",
        metavar="KEY=RANGE",
        help="a:b:n, log:a:b:n, x,y,z, normal(mu,sigma,n), uniform(a,b,n) with or without "
        "units, or one value. KEY is a scene key (beam.layers[0].thickness too), or "
        "param.PART.NAME for a parameter of a subcircuit. Repeatable.",
    ),
    "trust": typer.Option(
        "--trust", help="Let included netlists act on this machine; see 'include'."
    ),
    "as_json": typer.Option("--json", help="One JSON object on stdout, everything else on stderr."),
    "quiet": typer.Option("--quiet", "-q", help="No progress, no tables."),
    "run.deck": typer.Option(
        metavar="FILE",
        help="Run this netlist, edited by hand, instead of SCENE's own; same metrics, checks "
        "and plots.",
    ),
    "verify.deck": typer.Option(metavar="FILE", help="Take SCENE's deck from disk, as it stands."),
    "png": typer.Option("--png", help="Write the report's figures as PNG files too."),
    "keep": typer.Option(
        "--keep", help="Keep the simulator's raw file, for waveform viewers, and its log."
    ),
    "dialect": typer.Option(help="Language to write: ngspice, xyce, ltspice or verilog-a."),
    "export.tolerance": typer.Option(metavar="X", help="Short for --set rom.tolerance=X."),
    "count": typer.Option(metavar="N", help="An array: N copies of SCENE in one deck, no symbols."),
    "rom": typer.Option(metavar="FILE", help="Reduced model of 'reduce' instead of a scene."),
    "dense": typer.Option("--dense", help="With --rom: couple all states instead of blocks."),
    "all_": typer.Option("--all", help="Verify every built-in scene."),
    "full": typer.Option(
        "--full",
        help="Follow full models 100 times as long, if need be to the scene's end, and solve "
        "large ones at all frequencies.",
    ),
    "keys": typer.Option("--keys", help="List every key that a scene may have instead."),
    "parts": typer.Option("--parts", help="List part types with their pins and keys instead."),
    "band": typer.Option(
        metavar="F0 F1",
        help="Hz; default: that of NAME.toml, else up to the fifth natural frequency.",
    ),
    "tolerance": typer.Option(
        metavar="X", help="Largest relative error over the band; default: 1e-4."
    ),
    "order": typer.Option(metavar="Q", help="Number of states instead of a tolerance."),
    "norm": typer.Option(
        metavar="NORM",
        help="Of the error: pointwise (relative at every frequency, notches included) or peak "
        "(relative to the largest value in the band; default where all ports are signals).",
    ),
    "vary": typer.Option(
        metavar="KEY[=LOW:HIGH]",
        help="A key below the part, such as layers[0].thickness or damping.quality, and its "
        "range in SI; else 30 % about the scene's value, ten times of losses. Repeatable.",
    ),
    "error": typer.Option(metavar="X", min=1e-12, max=1.0, help="Largest error that you accept."),
    "bench.metric": typer.Option(
        metavar="NAME",
        help="Whose error counts, as in result.json; repeatable. Default: bench.metric of the "
        "scene, else every number that converges.",
    ),
    "sweep.metric": typer.Option(
        metavar="NAME",
        help="Column of the table, repeatable; default: all metrics. Any number of result.json "
        "by its path: model.kick.resonance_short_hz, checks.NAME, rom.order.",
    ),
    "repeats": typer.Option(min=1, help="Runs of each; the median counts."),
    "zipped": typer.Option(
        "--zip", help="Step through all ranges together; else they are crossed."
    ),
    "latin": typer.Option("--latin", help="Draw by Latin hypercube instead of independently."),
    "seed": typer.Option(min=0, help="Of all draws."),
    "table_format": typer.Option("--format", metavar="csv|parquet", help="Of the table."),
    "workers": typer.Option(min=1, help="Points at a time; default: all cores."),
    "dask": typer.Option(metavar="ADDRESS", help="Run on a Dask scheduler, or on 'local' workers."),
    "timeout": typer.Option(metavar="S", min=0.1, help="Longest time for one ngspice run."),
    "retry_failed": typer.Option(
        "--retry-failed",
        help="Run all points again that failed; without it those whose run was interrupted.",
    ),
    "dry_run": typer.Option("--dry-run", help="Say what would be run and stop."),
}
