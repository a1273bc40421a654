"""Arguments and options of the command line.

A key of ``PARAMETERS`` is the name of a parameter of a command function. If a parameter differs
between commands, the keys of the parameter have the form ``command.parameter``.
"""

from importlib import resources
from pathlib import Path
from typing import Any

import typer

from kc2spice.core.error_norms import NORM_WORDS
from kc2spice.core.errors import UsageError


def _complete_scene_names(incomplete: str) -> list[str]:
    """Return the names of built-in scenes that begin with ``incomplete``.

    The shell itself completes names of files.
    """
    names = (item.name for item in (resources.files("kc2spice") / "scenes").iterdir())
    return sorted(n[:-5] for n in names if n.startswith(incomplete) and n.endswith(".toml"))


def _list_dialects() -> str:
    """List the built-in netlist dialects in one string, separated by commas.

    The names of the dialects are read from file names, because importing the printers takes 0.2 s.
    """
    folder = resources.files("kc2spice") / "netlist" / "printers" / "dialects"
    stems = (item.name.removesuffix(".py") for item in folder.iterdir())
    names = sorted(stem for stem in stems if stem.isidentifier() and stem[0] != "_")
    return ", ".join(("ngspice", *names, "verilog-a"))


def _check_directory(text: str) -> Path:
    """Return ``text`` as the path of an output directory; reject an empty string."""
    if not text.strip():  # Path("") would be the current directory
        raise UsageError(
            "the name of the directory is empty",
            where="--out",
            got=repr(text),
            expected="a directory",
            hint="write --out . for the current directory",
        )
    return Path(text)


def _make_out_option(default: str) -> Any:
    """Make the option ``--out`` with a default directory."""
    text = f"Directory into which output files are written. Default: {default}."
    return typer.Option("--out", "-o", metavar="DIR", parser=_check_directory, help=text)


PARAMETERS = {
    "scene": typer.Argument(
        metavar="SCENE",
        help=(
            "Name of a built-in scene, part number from the parts library, or path of a TOML file."
        ),
        autocompletion=_complete_scene_names,
    ),
    "scenes.scene": typer.Argument(
        metavar="SCENE",
        help=(
            "Built-in scene or part number whose TOML text is printed. Default: list all built-in "
            "scenes."
        ),
        autocompletion=_complete_scene_names,
    ),
    "sweep.scene": typer.Argument(
        metavar="SCENE", help="Name of a built-in scene or study, or path of a TOML file."
    ),
    "model": typer.Argument(
        metavar="MODEL",
        help=(
            "Model to reduce: SCENE:PART for a body of a scene, or a file. Matrices: a .npz or "
            ".mat file, or NAME for the files NAME.M, NAME.K, … in Matrix Market or "
            "Harwell-Boeing format. A second-order model has the matrices M, E (damping), K, B "
            "and C; a first-order model E x' = A x + B u, y = C x + D u has E, A, B, C and D. "
            "Other programs: a file of Abaqus, CalculiX, Nastran or Ansys. Measurements: a "
            "frequency response (.s1p, .s2p, .csv, .txt, .zma, .mat), or a table of a thermal "
            "transient. For every kind of file, NAME.toml in the same folder states ports, units "
            "and band."
        ),
    ),
    "target": typer.Argument(
        metavar="SCENE:PART",
        help="Scene, and name of the part that is fitted, separated by a colon.",
    ),
    "data": typer.Argument(
        metavar="DATA",
        help=(
            "File of the measured impedance (.s1p, .csv, .txt, .zma or .mat), or a .toml "
            "file that lists several measured curves."
        ),
    ),
    "run.out": _make_out_option("./SCENE"),
    "export.out": _make_out_option("./SCENE, or beside the reduced model"),
    "verify.out": _make_out_option("./SCENE_verify"),
    "reduce.out": _make_out_option("./NAME_rom"),
    "fit.out": _make_out_option("./PART_fit"),
    "bench.out": _make_out_option("./SCENE_bench"),
    "sweep.out": _make_out_option("./SCENE_sweep"),
    "set_": typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help=(
            "Override a key of the scene. VALUE is a number in SI units, or text with a "
            "unit. A TOML file in place of KEY=VALUE overrides all keys that the file "
            "contains. Repeatable."
        ),
    ),
    "sweep.set_": typer.Option(
        "--set",
        metavar="KEY=RANGE",
        help=(
            "Vary a key of the scene, or param.PART.NAME, a parameter of the part's subcircuit. "
            "RANGE is a:b:n (linear), log:a:b:n, x,y,z (a list), normal(mu,sigma,n), "
            "uniform(a,b,n), or one value. Repeatable."
        ),
    ),
    "trust": typer.Option(
        "--trust",
        help=(
            "Allow included netlists to run commands and access files. With this option, kc2spice "
            "prints a warning, not an error, if ngspice ignores or replaces a line of a netlist."
        ),
    ),
    "as_json": typer.Option("--json", help="Print one JSON object instead of tables."),
    "quiet": typer.Option("--quiet", "-q", help="Print neither progress messages nor tables."),
    "run.deck": typer.Option(
        metavar="FILE",
        help=(
            "Run this edited netlist of the scene, and compute the metrics and checks of the scene."
        ),
    ),
    "verify.deck": typer.Option(
        metavar="FILE", help="Verify this edited netlist of the scene in place of a new export."
    ),
    "verbose": typer.Option(
        "--verbose", "-v", help="Print all tables of the report, not only the main results."
    ),
    "png": typer.Option("--png", help="Also write the figures of the report as PNG files."),
    "keep": typer.Option("--keep", help="Keep the raw file and the log file of the simulator."),
    "dialect": typer.Option(
        metavar="DIALECT",
        help=f"Simulator for which the netlist is written: {_list_dialects()}, or a simulator "
        "that an installed plug-in package adds.",
    ),
    "export.tolerance": typer.Option(
        metavar="X",
        help=(
            "Largest permitted relative error of every reduced model. Default: the tolerance "
            "in the scene."
        ),
    ),
    "count": typer.Option(metavar="N", help="Write N copies of the scene into one netlist file."),
    "rom": typer.Option(
        metavar="FILE",
        help=(
            "Export a reduced model instead of a scene. FILE is the file NAME_rom/NAME_rom.npz "
            "that `kc2spice reduce` writes."
        ),
    ),
    "dense": typer.Option(
        "--dense",
        help=(
            "With --rom: write the model as one dense state-space system instead of one "
            "block for each mode."
        ),
    ),
    "all_": typer.Option("--all", help="Verify every built-in scene."),
    "full": typer.Option(
        "--full",
        help=(
            "Verify more thoroughly, but slower: integrate full models over up to 400 000 time "
            "steps (default: 4 000), and solve full models of more than 3 000 unknowns at all "
            "frequencies of the comparison (default: 3 frequencies)."
        ),
    ),
    "search": typer.Argument(
        metavar="SEARCH",
        help=(
            "Words to search for in the part number, maker and device of each part. Default: "
            "all parts."
        ),
    ),
    "keys": typer.Option("--keys", help="List every key that a scene may have."),
    "parts": typer.Option("--parts", help="List the part types that a scene may contain."),
    "part_type": typer.Option(
        "--part", metavar="TYPE", help="List the pins and keys of a part type, with an example."
    ),
    "band": typer.Option(
        metavar="F0 F1",
        help=(
            "Lowest and highest frequency of the band in which the error is estimated [Hz]. "
            "Default: the band stated in the scene or in the file NAME.toml of the model, "
            "otherwise 0 Hz to slightly above the fifth natural frequency. The natural frequencies "
            "of a first-order model are 1/(2 pi tau), where tau are its time constants."
        ),
    ),
    "tolerance": typer.Option(
        metavar="X",
        help="Largest permitted relative error of the reduced model in the band. Default: 1e-4.",
    ),
    "order": typer.Option(
        metavar="Q",
        help=(
            "Number of unknowns of the reduced model; a second-order model of Q unknowns has "
            "2 Q first-order states. Cannot be combined with --tolerance."
        ),
    ),
    "method": typer.Option(
        metavar="NAME",
        help=(
            "Reduction method, such as 'response POD'. By default, response POD; if all ports are "
            "signals, balanced truncation is tried too, and replaces response POD if it saves at "
            "least about 10 % of the states. 'compare' prints a table with the number of states "
            "of each method."
        ),
    ),
    "solver": typer.Option(
        metavar="NAME",
        help=(
            "Direct solver for the linear equations of the reduction, such as pardiso (requires "
            "pip install 'kc2spice[fast]'). Default: CHOLMOD for symmetric positive definite "
            "matrices, SuperLU for most other matrices."
        ),
    ),
    "norm": typer.Option(
        metavar="NORM",
        help=(
            f"Norm of the error: pointwise (relative to {NORM_WORDS['pointwise']}) or "
            f"peak (relative to {NORM_WORDS['peak']}). Default: peak if all ports "
            "are signals, otherwise pointwise."
        ),
    ),
    "dc": typer.Option(
        metavar="OHM",
        help=(
            "Resistance of a measured one-port at zero frequency, such as '80 mOhm'; "
            "'open' for a one-port without a DC path. Default: extrapolation from "
            "the lowest frequencies."
        ),
    ),
    "shunt": typer.Option(
        metavar="OHM",
        help=(
            "Resistance in series with the part in a measurement of gain and phase, such as "
            "'100 Ohm'. Required for tables of gain and phase."
        ),
    ),
    "power": typer.Option(
        metavar="W",
        help=(
            "Heating power that was switched on or off at time zero of the measured "
            "transient, such as '2 W'. Required for tables of temperatures."
        ),
    ),
    "network": typer.Option(
        metavar="FORM",
        help=(
            "Form of the thermal RC network for a model with one thermal port: foster or "
            "cauer. Default: foster."
        ),
    ),
    "vary": typer.Option(
        metavar="KEY[=LOW:HIGH]",
        help=(
            "Key that the command fits, and the range of its value, such as "
            "damping.quality=10:200. Numbers without a unit are in SI units. "
            "Default range: 1/1.3 to 1.3 times the value "
            "in the scene; for losses, a tenth to ten times the value in the scene. Repeatable."
        ),
    ),
    "error": typer.Option(
        metavar="X",
        min=1e-12,
        max=1.0,
        help=(
            "Largest permitted relative error of every metric; the command finds the "
            "fastest settings within this limit."
        ),
    ),
    "bench.metric": typer.Option(
        metavar="NAME",
        help=(
            "Metric whose error must not exceed --error. Default: the key `bench.metric` of the "
            "scene, otherwise all metrics that change by at most 1 % between the two finest "
            "settings. Repeatable."
        ),
    ),
    "sweep.metric": typer.Option(
        metavar="NAME",
        help=(
            "Column of the output table: a metric, or the path of a number in result.json, "
            "such as model.kick.resonance_short_hz. Default: all metrics. Repeatable."
        ),
    ),
    "repeats": typer.Option(
        metavar="N",
        min=1,
        help="Number of runs with the same settings; the median of the CPU times is used.",
    ),
    "zipped": typer.Option(
        "--zip",
        help=(
            "Combine the first values of all keys, then the second values, and so on. "
            "Default: every combination of values, except that keys with random values always "
            "vary together."
        ),
    ),
    "latin": typer.Option(
        "--latin", help="Choose random values of keys by Latin hypercube sampling."
    ),
    "seed": typer.Option(metavar="N", min=0, help="Seed of the random number generator."),
    "table_format": typer.Option(
        "--format", metavar="FORMAT", help="File format of the table of results: csv or parquet."
    ),
    "workers": typer.Option(
        metavar="N",
        min=1,
        help=(
            "Number of sweep points that are computed in parallel. Default: number of "
            "processor cores."
        ),
    ),
    "dask": typer.Option(
        metavar="ADDRESS",
        help=(
            "Address of the Dask scheduler that computes the sweep points, or 'local' for "
            "workers on this machine."
        ),
    ),
    "timeout": typer.Option(
        metavar="S", min=0.1, help="Longest permitted time of one run of ngspice [s]."
    ),
    "retry_failed": typer.Option(
        "--retry-failed",
        help=(
            "Repeat failed and interrupted sweep points. Default: repeat only interrupted points."
        ),
    ),
    "dry_run": typer.Option("--dry-run", help="Print the planned runs without running them."),
}
