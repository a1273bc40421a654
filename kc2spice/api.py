"""Python functions of kc2spice; run, export, verify and sweep are also commands.

``import kc2spice as kc`` provides all functions, for example ``kc.run(...)``. The module
:mod:`kc2spice.core.errors`, also called ``kc.errors``, defines all exceptions.
"""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import ExitStack, nullcontext, suppress
from dataclasses import dataclass, field, replace
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from kc2spice.core import __version__
from kc2spice.core.argument_and_option_names import check_arguments, use_arguments_in_errors
from kc2spice.core.attribute_advice import WRITING_METHODS, AdvisesOnAttributes, make_index_error
from kc2spice.core.errors import NamedValues, UsageError, unknown
from kc2spice.core.figure import Figure
from kc2spice.core.files import require_path, stage_directory
from kc2spice.core.optional_libraries import import_optional
from kc2spice.core.progress import StageTimer
from kc2spice.core.waveforms import SCALES, Waveforms, write_record, write_waveforms
from kc2spice.netlist.deck import Deck
from kc2spice.rom.linear_model import LinearModel
from kc2spice.scene.checks import Check
from kc2spice.scene.load import load_scene
from kc2spice.scene.parttype import register_part
from kc2spice.scene.scene_classes import Scene
from kc2spice.scene.settings import ProbeKeys
from kc2spice.sim.ngspice import find_ngspice, run_deck, write_files
from kc2spice.workflow.decks import prepare_deck, protect_other_decks
from kc2spice.workflow.run import CompletedRun, complete_run, write_run_files

__all__ = [
    "Result",
    "Table",
    "build",
    "deck",
    "export",
    "register_part",
    "run",
    "simulate",
    "sweep",
    "verify",
]
# forms of a scene that :func:`kc2spice.load_scene` accepts
AnyScene = Scene | str | Path | Mapping[str, Any]
Function = Callable[[float, Mapping[str, float]], float]


@check_arguments
def build(scene: AnyScene) -> dict[str, LinearModel]:
    """Build the unreduced finite-element model of every body of a scene.

    Each full model has all ports of a body and all unknowns of the body's mesh. No model is
    reduced. Parts that are not bodies, such as drivers and contacts, have no entry in the returned
    mapping.

    Parameters
    ----------
    scene : Scene, str, Path or mapping
        Scene in any form that :func:`kc2spice.load_scene` reads.

    Returns
    -------
    dict[str, LinearModel]
        Full models in SI units, keyed by the name of the body.

    Raises
    ------
    UsageError : the scene is invalid (see :func:`kc2spice.load_scene`), or the file of a model
        cannot be read.

    Examples
    --------
    A ceramic disc has the mass pi r^2 t rho of its cylinder, here 1.178 g.

    >>> import kc2spice as kc
    >>> layer = {"diameter": "20 mm", "thickness": "0.5 mm", "material": "PZT-4"}
    >>> models = kc.build({"plate": {"part": "disc", "layers": [layer]}})
    >>> [port.name for port in models["plate"].ports]
    ['centre', 'anode']
    >>> print(f"{1e3 * models['plate'].facts['mass_kg']:.3f} g")
    1.178 g
    """
    from kc2spice.parts.bodies._body_model import full_model_without_scene
    from kc2spice.parts.bodies._linear_body import LinearBody

    loaded = load_scene(scene)
    models = NamedValues()
    for name, part in loaded.parts.items():
        if isinstance(part.type, LinearBody):
            with loaded.locate_errors(name):
                model = full_model_without_scene(part, loaded, StageTimer())
            models[name] = replace(model, name=name)
    return models


@check_arguments
def deck(scene: AnyScene, *, trust: bool = False) -> Deck:
    """Return the netlist of a scene and the subcircuit libraries of its parts.

    The models that the scene needs are built and reduced, or read from the cache.

    Parameters
    ----------
    scene : Scene, str, Path or mapping
        Scene in any form that :func:`kc2spice.load_scene` reads.
    trust : bool, default False
        Whether files that the scene includes may run commands and write files on this machine.

    Returns
    -------
    Deck
        Netlist and libraries; ``files`` maps the name of each file to its text.

    Raises
    ------
    UsageError : the scene is invalid (see :func:`kc2spice.load_scene`), or the circuit has a wiring
        error.

    Examples
    --------
    >>> import kc2spice as kc
    >>> lamp = {
    ...     "name": "lamp",
    ...     "drive": {"part": "source", "dc": "12 V"},
    ...     "lamp": {"part": "resistor", "resistance": "6 Ohm", "pins": {"a": "drive.out"}},
    ...     "analysis": {"type": "op"},
    ... }
    >>> deck = kc.deck(lamp)
    >>> list(deck.files)
    ['lamp.cir']
    >>> "Rlamp drive_out 0 6" in deck.files["lamp.cir"]
    True
    """
    _require_flags(trust=trust)
    return prepare_deck(load_scene(scene), StageTimer(), trust=trust)[1]


@check_arguments
def run(
    scene: AnyScene,
    out: str | Path | None = None,
    *,
    deck: str | Path | None = None,
    trust: bool = False,
    functions: Mapping[str, Function] | None = None,
    overrides: Mapping[str, Any] | None = None,
) -> Result:
    """Build and reduce the models of a scene, write netlists and simulate the scene.

    Parameters
    ----------
    scene : Scene, str, Path or mapping
        Scene in any form that :func:`kc2spice.load_scene` reads.
    out : str or Path, optional
        Directory for the files that ``kc2spice run`` writes. By default, no file is written.
    deck : str or Path, optional
        Path of a hand-edited netlist of this scene, which is simulated instead of the generated
        netlist.
    trust : bool, default False
        Whether files that the scene includes may run commands and write files on this machine.
    functions : mapping of str to callable, optional
        Control functions, keyed by the name of their ``controller`` part. These control functions
        replace the functions in the Python file beside the scene. Each function has the form
        ``function(time, inputs) -> output``, in SI units. If the simulation is repeated with other
        settings, ``time`` begins at 0 again. At the start of each repeated simulation, a control
        function must reset the values that it stores between calls. The Python file beside the
        scene is loaded again for each simulation.
    overrides : mapping, optional
        New values of keys of the scene, by dotted key, as for :func:`kc2spice.load_scene`.

    Returns
    -------
    Result
        Metrics, waves and checks of the simulation, in SI units.

    Raises
    ------
    UsageError : the scene is invalid (see :func:`kc2spice.load_scene`), ``deck`` lacks vectors that
        the metrics need, or ``out`` cannot be written, which is checked before the computation.
    MissingToolError : ngspice is not installed.
    SimulationError : ngspice or a check of its result failed. If ``out`` is given, the deck and the
        log of a failed run are kept in ``OUT.failed`` until a run with the same ``out`` succeeds.

    Examples
    --------
    A lamp of 6 Ohm at 12 V draws 2 A.

    >>> import kc2spice as kc
    >>> lamp = {
    ...     "name": "lamp",
    ...     "drive": {"part": "source", "dc": "12 V"},
    ...     "lamp": {"part": "resistor", "resistance": "6 Ohm", "pins": {"a": "drive.out"}},
    ...     "analysis": {"type": "op"},
    ...     "probes": {"current_a": {"of": "lamp.i"}},
    ... }
    >>> result = kc.run(lamp)
    >>> print(f"{result.metrics['current_a']:.4f} A")
    2.0000 A
    >>> half = kc.run(lamp, overrides={"drive.dc": "6 V"})
    >>> print(f"{half.metrics['current_a']:.4f} A")
    1.0000 A
    """
    _require_flags(trust=trust)
    directory = None if out is None else require_path(out)
    with use_arguments_in_errors("overrides"):
        loaded = load_scene(scene, overrides or {})
    edited = None if deck is None else _require_deck_path(deck)
    output = (
        tempfile.TemporaryDirectory(prefix="kc2spice-")
        if directory is None
        else stage_directory(directory)
    )
    clock = StageTimer()
    with output as name:
        work = Path(name)
        completed_run = complete_run(
            loaded, work, clock, out=directory, trust=trust, deck=edited, functions=functions
        )
        simulated = completed_run.run
        figures = {item.name: item for item in completed_run.figures}
        extra_fields: dict[str, Any] = {"figures": figures, "_done": completed_run}
        checks = simulated.verdict.checks
        result = _make_result(
            simulated.deck, simulated.waves, completed_run.record, checks, **extra_fields
        )
        if directory is not None:
            write_run_files(completed_run, work, clock)
    return result


@check_arguments
def simulate(deck: Deck, *, timeout: float | None = None) -> Result:
    """Simulate a deck in ngspice and return its waveforms or frequency responses.

    The result has no metrics and no checks, because both require the parts of a scene. To compute
    metrics and checks for an edited netlist, call :func:`run` with its argument ``deck``.

    Parameters
    ----------
    deck : Deck
        Netlist with its libraries, for example the result of :func:`deck`.
    timeout : float, optional
        Largest wall-clock time of ngspice in s. By default, the wall-clock time is not limited.

    Returns
    -------
    Result
        Waves of the simulation in SI units, without metrics and checks.

    Raises
    ------
    UsageError : ``deck`` is not a :class:`Deck`.
    MissingToolError : ngspice is not installed.
    SimulationError : ngspice failed or stopped early; the message contains the simulated time.

    Examples
    --------
    >>> import kc2spice as kc
    >>> lamp = {
    ...     "name": "lamp",
    ...     "drive": {"part": "source", "dc": "12 V"},
    ...     "lamp": {"part": "resistor", "resistance": "6 Ohm", "pins": {"a": "drive.out"}},
    ...     "analysis": {"type": "op"},
    ... }
    >>> result = kc.simulate(kc.deck(lamp))
    >>> print(f"{result.waves['lamp.i'][0]:.4f} {result.units['lamp.i']}")
    2.0000 A
    """
    if not isinstance(deck, Deck):
        got = type(deck).__name__
        raise UsageError(
            "this object is not a deck",
            where="deck",
            got=got,
            hint="to simulate a scene, write kc.run(SCENE)",
        )
    is_number = isinstance(timeout, (int, float)) and not isinstance(timeout, bool)
    if timeout is not None and not (is_number and timeout > 0):
        raise UsageError(
            "this value is not a time in seconds",
            where="timeout",
            got=repr(timeout)[:120],
            expected="a number above 0, or None for no limit",
            hint="for example timeout=60",
        )
    with tempfile.TemporaryDirectory(prefix="kc2spice-") as work:
        waves = run_deck(deck, Path(work), timeout=timeout)
    record = {"scene": deck.name, "version": __version__, "netlist": deck.main_file_name}
    return _make_result(deck, waves, record)


@check_arguments
def export(
    scene: AnyScene, out: str | Path, *, dialect: str = "ngspice", trust: bool = False
) -> list[Path]:
    """Write netlists and symbols of a scene into a directory, without a simulation.

    Parameters
    ----------
    scene : Scene, str, Path or mapping
        Scene in any form that :func:`kc2spice.load_scene` reads.
    out : str or Path
        Directory to write into, created if it does not exist.
    dialect : str, optional
        Dialect of the netlists, by default ngspice.
    trust : bool, default False
        Whether files that the scene includes may run commands and write files on this machine.

    Returns
    -------
    list of Path
        Paths of the written files.

    Raises
    ------
    UsageError : an unknown dialect, or a dialect that cannot represent a part of the scene.
    GateMissedError : the error of a body's circuit exceeds the tolerance of its model reduction.

    Examples
    --------
    >>> import kc2spice as kc
    >>> lamp = {
    ...     "name": "lamp",
    ...     "drive": {"part": "source", "dc": "12 V"},
    ...     "lamp": {"part": "resistor", "resistance": "6 Ohm", "pins": {"a": "drive.out"}},
    ...     "analysis": {"type": "op"},
    ... }
    >>> [path.name for path in kc.export(lamp, "netlists", dialect="xyce")]
    ['lamp.cir']
    """
    # ``export_scene`` is imported here, because ``run`` does not need this module
    from kc2spice.workflow.export import export_scene

    _require_flags(trust=trust)
    with use_arguments_in_errors("values"):
        return export_scene(load_scene(scene), require_path(out), dialect, trust=trust)


@check_arguments
def verify(
    scene: AnyScene, out: str | Path | None = None, *, full: bool = False, trust: bool = False
) -> dict[str, Any]:
    """Compare the ngspice simulation of a scene with two independent solutions.

    The first independent solution integrates the equations of the parts in scipy, with the reduced
    models of bodies. The second independent solution uses the full models of bodies.

    Parameters
    ----------
    scene : Scene, str, Path or mapping
        Scene in any form that :func:`kc2spice.load_scene` reads.
    out : str or Path, optional
        Directory of ``verify.json`` and ``verify.html``. By default no files are written.
    full : bool, optional
        Whether to integrate the full models over up to 400 000 steps instead of 4 000, and to solve
        full models of more than 3 000 unknowns at all frequencies of the comparison, not only at 3.
    trust : bool, default False
        Whether files that the scene includes may run commands and write files on this machine.

    Returns
    -------
    dict
        Result of the verification: whether the scene ``passed``, and the ``checks``, ``errors``,
        ``metrics`` and ``notes`` of the scene.

    Raises
    ------
    MissingToolError : ngspice is not installed.
    SimulationError : ngspice or the solver of an independent solution failed.

    Examples
    --------
    >>> import kc2spice as kc
    >>> lamp = {
    ...     "name": "lamp",
    ...     "drive": {"part": "source", "dc": "12 V"},
    ...     "lamp": {"part": "resistor", "resistance": "6 Ohm", "pins": {"a": "drive.out"}},
    ...     "analysis": {"type": "op"},
    ...     "probes": {"current_a": {"of": "lamp.i"}},
    ... }
    >>> kc.verify(lamp)["passed"]
    True
    """
    # ``verify_scenes`` is imported here, because ``run`` does not need this module
    from kc2spice.workflow.verify.scene_verification import verify_scenes

    _require_flags(full=full, trust=trust)
    loaded = load_scene(scene)
    with tempfile.TemporaryDirectory(prefix="kc2spice-") as work:
        folder = Path(work) / "verify" if out is None else require_path(out)
        record = verify_scenes([loaded], folder, full=full, trust=trust)
    return NamedValues(record["scenes"][loaded.name])


@dataclass(frozen=True, repr=False, eq=False)
class Result(AdvisesOnAttributes):
    """Waveforms, metrics, checks, deck and figures of a simulation.

    Attributes
    ----------
    scene : name of the scene or deck.
    metrics : numbers by name, in the SI unit that ``record["metric_units"]`` states. In an ``ac``
        analysis, curves such as ``impedance_ohm`` are arrays over the frequency. An unknown
        name in ``metrics``, ``waves`` or ``units`` raises a KeyError that lists similar names.
    waves : arrays of shape (points,) in SI units, keyed by name, with one value for each time,
        frequency or swept value. The waveforms of an ``ac`` analysis are complex arrays.
    units : SI unit of each waveform, keyed by the name of the waveform.
    checks : checks of physical laws, such as conservation of energy, each with ``name``, ``value``,
        ``limit``, ``passed`` and ``advice``.
    record : the content of ``result.json`` without the names of files.
    deck : the deck of the simulation.
    figures : plots of the parts of the scene by name, for :meth:`plot`.
    """

    _attribute_advice: ClassVar[Mapping[str, str]] = {
        **dict.fromkeys(WRITING_METHODS, 'save("DIRECTORY") writes all files of the result'),
        "to_dataframe": "to_xarray().to_dataframe() returns a pandas DataFrame",
        "show": "plot() draws the result",
        "summary": "print(RESULT) prints the metrics",
    }

    scene: str
    metrics: Mapping[str, Any]
    waves: Mapping[str, np.ndarray]
    units: Mapping[str, str]
    checks: tuple[Check, ...]
    record: Mapping[str, Any]
    deck: Deck
    figures: Mapping[str, Figure] = field(default_factory=dict)
    _done: CompletedRun | None = None

    if not TYPE_CHECKING:  # otherwise mypy would accept every index

        def __getitem__(self, name: object) -> Any:
            """Raise the error about an index, with advice on where the numbers are."""
            place = "waves" if name in self.waves else "metrics"
            raise make_index_error(self, f"RESULT.{place}[{name!r}] returns the values")

    @property
    def scale(self) -> str:
        """Name of the scale: independent variable ``time``, ``frequency`` or ``sweep``."""
        return next(iter(self.waves))

    @property
    def time(self) -> np.ndarray:
        """Time points [s], an unequally spaced array of shape (points,).

        Raises
        ------
        UsageError : the analysis was not a transient.
        """
        return self._require_independent_variable("time")

    @property
    def frequency(self) -> np.ndarray:
        """Frequencies [Hz], an array of shape (points,).

        Raises
        ------
        UsageError : the analysis was not an ``ac`` analysis.
        """
        return self._require_independent_variable("frequency")

    def _require_independent_variable(self, name: str) -> np.ndarray:
        """Require that the independent variable is ``name``, and return its values."""
        if self.scale != name:
            raise UsageError(
                f"this result is not a function of {name}",
                where=self.scene,
                got=f"a result that is a function of {self.scale}",
                expected=f"a result that is a function of {name}",
                hint=f'write result.waves["{self.scale}"], or run an analysis of '
                f'type "{"transient" if name == "time" else "ac"}"',
            )
        return self.waves[name]

    def plot(self, *names: str) -> Any:
        """Plot the waveforms with the given names, or the figure with the given name.

        Without names, the first of ``figures`` is drawn. Waves of one unit share a pair of axes.
        Complex waves are drawn by magnitude. The method returns a matplotlib figure, which
        notebooks display, and whose method ``.savefig(path)`` writes a file.

        Raises
        ------
        UsageError : the wave or figure does not exist, or the wave has only one point.
        """
        from kc2spice.report.matplotlib_figures import make_notebook_figure
        from kc2spice.report.probe_figure import plot_probes

        if not names and self.figures:
            names = (next(iter(self.figures)),)
        if len(names) == 1 and names[0] in self.figures:
            return make_notebook_figure(self.figures[names[0]])
        _, *wave_names = self.waves
        for name in names:
            if name not in wave_names:
                raise unknown(
                    "the result has neither a waveform nor a plot of this name",
                    name,
                    [*self.figures, *wave_names],
                    self.scene,
                )
        probes = {name: ProbeKeys(of=name) for name in names or wave_names}
        for figure in plot_probes(probes, Waveforms(dict(self.waves), {}), self.units):
            return make_notebook_figure(figure)
        raise UsageError(
            "this result has fewer than two points, so it cannot be drawn",
            where=self.scene,
            got=self.scale,
            expected="a result over time, frequency or a sweep",
            hint="print result.metrics or result.waves",
        )

    def to_xarray(self) -> Any:
        """Return the waveforms as an ``xarray.Dataset`` over time, frequency or swept key.

        Returns
        -------
        xarray.Dataset
            One variable for each wave in SI units, with its unit in ``attrs["units"]``. The
            coordinate of the dataset is time, frequency or the swept key. Complex waves stay
            complex.

        Raises
        ------
        MissingToolError : xarray is not installed.

        Examples
        --------
        >>> import kc2spice as kc
        >>> waves = kc.run("buzzer_7bb_20_6").to_xarray()
        >>> waves["disc.current"].attrs["units"]
        'A'
        """
        xarray = import_optional("xarray", "to_xarray")
        variables = {}
        for name, wave in self.waves.items():
            units = {"units": self.units.get(name, "")}
            variables[name] = xarray.Variable((self.scale,), wave, units)
        coordinate = {self.scale: variables.pop(self.scale)}
        return xarray.Dataset(variables, coordinate, {"scene": self.scene})

    def save(self, out: str | Path, *, png: bool = False) -> Path:
        """Write the files of ``kc2spice run`` into a directory and return its path.

        The written files are deck, libraries, waveforms, ``result.json`` and, for a scene,
        ``report.html``. With ``png``, each figure is also written as a PNG file. Either all files
        are written to ``out``, or no file is written.

        Raises
        ------
        UsageError : ``out`` cannot be written, or another deck in ``out`` includes a different
            library of the same name.
        """
        folder = require_path(out)
        with stage_directory(folder) as work:
            protect_other_decks(folder, self.deck.files)
            if self._done is not None:
                write_run_files(
                    self._done, work, StageTimer(wall_s=dict(self._done.wall_s)), png=png
                )
            else:
                write_files(self.deck.files, work)
                waves = Waveforms(dict(self.waves), {})
                files = [*self.deck.files, *write_waveforms(waves, self.units, work)]
                write_record({**self.record, "files": [*files, "result.json"]}, work)
        return folder

    def __repr__(self) -> str:
        points = self.waves[self.scale].size
        head = f"<Result {self.scene}: {points} points over {self.scale}, "
        head += f"{len(self.waves) - 1} waves"
        failed = [check.name for check in self.checks if not check.passed]
        if self.checks:
            head += f", {len(self.checks)} checks " + (f"FAILED {failed}" if failed else "passed")
        lines = [f"  {name} = {_summarize(value)}" for name, value in self.metrics.items()]
        return "\n".join([head + ">", *lines])

    def _repr_html_(self) -> str:
        """Return the result as an HTML table for notebooks."""
        rows = zip(self.metrics, map(_summarize, self.metrics.values()), strict=True)
        table = _format_html_table(("metric", "value"), rows)
        return f"<p>{escape(repr(self).splitlines()[0])}</p>{table}"


def _format_html_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table in HTML for notebooks."""
    lines = ["".join(f"<th>{escape(cell)}</th>" for cell in head)]
    for row in rows:
        lines.append("".join(f"<td>{escape(cell)}</td>" for cell in row))
    return f"<table><tr>{'</tr><tr>'.join(lines)}</tr></table>"


def _summarize(value: Any) -> str:
    """Return a metric as text on one line; for an array, only its number of values."""
    if isinstance(value, bool) or value is None or isinstance(value, str):
        return str(value)
    if isinstance(value, (int, float)):
        return f"{value:.6g}"
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {_summarize(item)}" for key, item in value.items())
    return f"{len(value)} values" if hasattr(value, "__len__") else str(value)


def _make_result(
    deck: Deck,
    waves: Waveforms,
    record: Mapping[str, Any],
    checks: tuple[Check, ...] = (),
    **more: Any,
) -> Result:
    """Combine deck, waveforms, record and checks of a run into a :class:`Result`."""
    scale = next(iter(waves.data))
    units = {scale: SCALES.get(scale, ""), **deck.units}
    metrics = NamedValues({**record.get("metrics", {}), **record.get("curves", {})})
    data = NamedValues(waves.data)
    return Result(record["scene"], metrics, data, NamedValues(units), checks, record, deck, **more)


class Table(AdvisesOnAttributes, tuple[dict[str, Any], ...]):
    """Table of a sweep: for each point, a mapping of column names to values.

    The columns of the table are the swept keys, the metrics that are single numbers, and
    ``status``. ``status`` is ``"ok"``, or ``"failed: "`` and the reason. The metrics of a failed
    point are None.
    """

    _attribute_advice: ClassVar[Mapping[str, str]] = {
        **dict.fromkeys(WRITING_METHODS, 'save("NAME.csv") writes the table'),
        "to_pandas": "to_dataframe() returns a pandas DataFrame",
        "plot": "to_dataframe().plot(x=KEY, y=METRIC) plots METRIC versus KEY",
        "rows": "the table itself is a sequence of rows",
    }

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns, in the order of the keys of each row."""
        return tuple(next(iter(self), ()))

    def __getitem__(self, column: Any) -> Any:
        """Return a column by name, or a row by number."""
        if not isinstance(column, str):
            return super().__getitem__(column)
        if column not in self.columns:
            raise unknown("the table has no such column", column, self.columns)
        return [row[column] for row in self]

    def save(self, path: str | Path) -> Path:
        """Write the table to a file and return its path.

        The format is Parquet if the name ends in ``.parquet``, otherwise CSV. Missing folders of
        the path are created.

        Raises
        ------
        UsageError : the name has the suffix of another format, such as ``.xlsx``, or the file
            cannot be written.
        MissingToolError : the format is Parquet, and pyarrow is not installed.
        """
        from kc2spice.workflow.sweep.row_store import save_table

        return save_table({name: self[name] for name in self.columns}, path)

    def to_dataframe(self) -> Any:
        """Return the table as a ``pandas.DataFrame`` with the same columns.

        Returns
        -------
        pandas.DataFrame
            One row for each point. Metrics of failed points are NaN.

        Raises
        ------
        MissingToolError : pandas is not installed.

        Examples
        --------
        >>> Table([{"r": 1.0, "status": "ok"}]).to_dataframe().shape
        (1, 2)
        """
        pandas = import_optional("pandas", "to_dataframe")
        return pandas.DataFrame({name: self[name] for name in self.columns})

    def _format_cells(self) -> list[list[str]]:
        """Return the texts of all cells of the table, row by row."""
        return [list(map(_summarize, row.values())) for row in self]

    def __repr__(self) -> str:
        cells = [list(self.columns), *self._format_cells()]
        widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
        lines = (map(str.rjust, row, widths) for row in cells)
        return "\n".join(map("  ".join, lines))

    def _repr_html_(self) -> str:
        """Return the rows as an HTML table for notebooks."""
        return _format_html_table(self.columns, self._format_cells())


def _require_flags(**flags: object) -> None:
    """Raise an error if an argument that is either True or False has another value.

    The string ``"False"``, for example, would otherwise count as true.
    """
    for name, value in flags.items():
        if not isinstance(value, (bool, np.bool_)):
            raise UsageError(
                "this value is neither True nor False",
                where=name,
                got=repr(value)[:120],
                expected="True or False",
                hint=f"write {name}=False, or {name}=True",
            )


def _require_deck_path(deck: object) -> Path:
    """Return the argument ``deck`` as a path; reject all other objects."""
    if isinstance(deck, (str, Path)):
        return Path(deck)
    raise UsageError(
        "deck is not the path of a netlist",
        where="deck",
        got=type(deck).__name__,
        expected="the path of a deck that kc.export or kc.run wrote",
        hint="to simulate a deck without a file, write kc.simulate(DECK)"
        if isinstance(deck, Deck)
        else 'for example deck="netlists/SCENE.cir"',
    )


def _require_sweep_options(executor: object, workers: object, progress: object) -> None:
    """Reject an executor, worker count or progress function of a wrong type.

    Raises
    ------
    UsageError : ``executor`` has no method ``submit``, ``workers`` is not a whole number from 1 on,
        or ``progress`` cannot be called.
    """
    if workers is not None and not (
        isinstance(workers, (int, np.integer)) and not isinstance(workers, bool) and workers >= 1
    ):
        raise UsageError(
            "workers is not a valid number of parallel simulations",
            where="workers",
            got=repr(workers),
            expected="a whole number from 1 on, or None for the number of processors",
            hint="for example workers=2",
        )
    if executor is not None and not callable(getattr(executor, "submit", None)):
        raise UsageError(
            "this object is not an executor",
            where="executor",
            got=repr(executor)[:120],
            expected="an object with the method submit, such as a ThreadPoolExecutor",
            hint="leave out executor, or write workers=2 for two parallel simulations",
        )
    if progress is not None and not callable(progress):
        raise UsageError(
            "this object is not a function",
            where="progress",
            got=repr(progress)[:120],
            expected="a function of the number of finished points and the number of all points",
            hint="for example progress=print",
        )


def _suggest_value_list(item: object) -> str:
    """Suggest how to write the values of a swept key as a list or NumPy array."""
    from kc2spice.core.unit_spelling import find_range_ends

    text = item if isinstance(item, str) else ""
    words = text.removeprefix("log:").split(":")
    if ends := find_range_ends(text):
        words = [*ends, "5"]
    if len(words) == 3:
        try:
            first, last, count = float(words[0]), float(words[1]), int(words[2])
        except ValueError:
            return f"write a list of values, such as {list(map(str.strip, words[:2]))}"
        function = "geomspace" if text.startswith("log:") else "linspace"
        return f"write numpy.{function}({first:g}, {last:g}, {count})"
    values: list[Any] = [word.strip() for word in text.split(",")]
    with suppress(ValueError):
        values = list(map(float, values))
    return f"write {values}" if len(values) > 1 else f"write [{item!r}] for a single value"


def _require_lists(values: Mapping[str, Sequence[Any]]) -> None:
    """Raise an error unless every key of a sweep has a non-empty list of values.

    Raises
    ------
    UsageError : ``values`` is not a mapping, or the values of a key are not a list, or a list is
        empty.
    """
    expected = "a mapping of keys to lists, such as {'load.resistance': ['1 kOhm', '2 kOhm']}"
    if not isinstance(values, Mapping):
        raise UsageError(
            "this object is not a mapping",
            where="values",
            got=repr(values)[:120],
            expected=expected,
            hint="write a mapping with the values of each key",
        )
    for key, item in values.items():
        if isinstance(item, str) or not hasattr(item, "__len__"):
            raise UsageError(
                "the values of a key are not a list",
                where=f"values: {key}",
                got=repr(item)[:120],
                expected=expected,
                hint=_suggest_value_list(item),
            )
    if not values or not all(map(len, values.values())):
        raise UsageError(
            "no key has more than one value to sweep",
            where="values",
            got=repr(dict(values))[:120],
            expected=expected,
            hint="write a list of values for at least one key",
        )


@check_arguments
def sweep(
    scene: AnyScene,
    values: Mapping[str, Sequence[Any]],
    *,
    executor: Executor | None = None,
    workers: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Table:
    """Run a scene at every combination of values; the last key varies fastest.

    This function and the command ``kc2spice sweep`` run the same points. Only the command
    ``kc2spice sweep`` can continue an interrupted sweep; this function cannot.

    Parameters
    ----------
    scene : Scene, str, Path or mapping
        Scene in any form that :func:`kc2spice.load_scene` reads.
    values : mapping of str to sequence
        Values of each swept key by its dotted name: numbers in SI units, or strings with a unit.
    executor : concurrent.futures.Executor, optional
        Executor that runs the points, such as ``dask.distributed.Client(ADDRESS).get_executor()``.
        By default, threads of this process run the points. Workers on other machines receive the
        files of the scene only if ``scene`` is a name or a path.
    workers : int, optional
        Number of simulations that run in parallel. The default is the number of processors.
    progress : callable, optional
        Function that is called after each point as ``progress(done, total)``, with the number of
        finished points and the number of all points.

    Returns
    -------
    Table
        One row for each point. The column ``status`` contains the reason if a point failed.

    Raises
    ------
    UsageError : ``values`` is empty or a point is invalid; raised before the first run.
    MissingToolError : ngspice is not installed.

    Examples
    --------
    A lamp of 3 or 6 Ohm at 12 V draws 4 or 2 A.

    >>> import kc2spice as kc
    >>> lamp = {
    ...     "name": "lamp",
    ...     "drive": {"part": "source", "dc": "12 V"},
    ...     "lamp": {"part": "resistor", "resistance": "6 Ohm", "pins": {"a": "drive.out"}},
    ...     "analysis": {"type": "op"},
    ...     "probes": {"current_a": {"of": "lamp.i"}},
    ... }
    >>> kc.sweep(lamp, {"lamp.resistance": ["3 Ohm", "6 Ohm"]}, workers=1)
    lamp.resistance  current_a  status
              3 Ohm          4      ok
              6 Ohm          2      ok
    """
    from kc2spice.workflow.sweep.grid import make_plan
    from kc2spice.workflow.sweep.point import SweepSettings, read_scene_text
    from kc2spice.workflow.sweep.row_store import collect_columns
    from kc2spice.workflow.sweep.sweep_execution import make_sweep_of_points, run_points
    from kc2spice.workflow.sweep.workers import count_available_cores

    _require_lists(values)
    _require_sweep_options(executor, workers, progress)
    if executor is None:
        find_ngspice()
    by_name = isinstance(scene, (str, Path))
    source = read_scene_text(str(scene)) if by_name else load_scene(scene)
    plan = make_plan({key: tuple(item) for key, item in values.items()})
    with use_arguments_in_errors("values"):
        definition = make_sweep_of_points(SweepSettings(source), plan, dict.fromkeys(plan.keys, ""))
    result: dict[int, Any] = {}
    with ExitStack() as stack, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        count = workers or count_available_cores()
        pool = executor or stack.enter_context(ThreadPoolExecutor(count))
        for index, outcome in run_points(
            definition, range(plan.size), lambda: nullcontext((pool, count))
        ):
            result[index] = outcome
            if progress is not None:
                progress(len(result), plan.size)
    table = collect_columns(result, plan)
    return Table(dict(zip(table, row, strict=True)) for row in zip(*table.values(), strict=True))
