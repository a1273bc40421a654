"""The public functions of kc2spice, in the words of the command line.

Everything here is also found in the package itself: ``import kc2spice as kc; kc.run(...)``.
Exceptions are those of :mod:`kc2spice.core.errors`, at hand as ``kc.errors``.
"""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import ExitStack, nullcontext
from dataclasses import dataclass, field, replace
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from kc2spice.core import __version__
from kc2spice.core.errors import UsageError, unknown
from kc2spice.core.extras import import_optional
from kc2spice.core.figure import Figure
from kc2spice.core.files import staged
from kc2spice.core.progress import Clock
from kc2spice.core.quantities import quantity
from kc2spice.core.waveforms import SCALES, Waveforms, write_record, write_waveforms
from kc2spice.netlist.deck import Deck
from kc2spice.rom.linear import LinearModel, Norm
from kc2spice.scene.judge import Check
from kc2spice.scene.load import load_scene
from kc2spice.scene.model import Scene
from kc2spice.scene.parttype import register as register_part
from kc2spice.scene.settings import Probe
from kc2spice.sim.ngspice import find_ngspice, run_deck, write_files
from kc2spice.workflow.decks import prepared, spare_other_decks
from kc2spice.workflow.run import Completed, complete, write_run_files

__all__ = [
    "Result",
    "Table",
    "build",
    "deck",
    "reduce",
    "register_part",
    "run",
    "simulate",
    "sweep",
]
AnyScene = Scene | str | Path | Mapping[str, Any]  # what :func:`kc2spice.load_scene` takes
Function = Callable[[float, Mapping[str, float]], float]


def build(scene: AnyScene) -> dict[str, LinearModel]:
    """The full model of every body of a scene, by the body's name.

    The models have all ports that the bodies offer and as many unknowns as their meshes; nothing is
    reduced. Parts that are no bodies (drivers, contacts, …) have no entry.

    Raises
    ------
    UsageError : as :func:`kc2spice.load_scene`, or a model's file cannot be read.
    """
    from kc2spice.parts._linear_body import LinearBody, full_alone

    loaded = load_scene(scene)
    return {
        part.name: replace(full_alone(part, loaded, Clock()), name=part.name)
        for part in loaded.parts.values()
        if isinstance(part.type, LinearBody)
    }


def reduce(
    model: LinearModel,
    *,
    tolerance: float | None = None,
    order: int | None = None,
    band: tuple[float | str, float | str] | None = None,
    norm: Norm | None = None,
    contact: bool = False,
    parameters: Mapping[str, Any] | None = None,
) -> LinearModel:
    """Reduce a linear model to the smallest one within ``tolerance``, or to ``order`` states.

    The result has the same ports in the same order and a ``certificate`` of its error with respect
    to ``model``: the largest error of any transfer function over ``band``, two frequencies in Hz or
    as texts (``"20 kHz"``), relative at every frequency (``norm="pointwise"``) or to the entry's
    largest value in the band (``"peak"``, the default for models whose ports are all signals).
    ``contact`` keeps some of what a contact excites above the band, as models of scenes do.
    Without a band it is the model's own, else up to a little above the fifth natural frequency. An
    order of a symmetric definite model is the block Arnoldi reduction at s0 = 0 of Schütz, Maeter
    and Bechtold, Actuators 10 (2021) 279, section 2.3.

    Raises
    ------
    UsageError : not exactly one of ``tolerance`` and ``order``, or one that is out of range; an
        unknown norm; ``parameters``, which matrices have none of: a body of a scene has them.
    SimulationError : the tolerance cannot be met, or a point of the band is a pole.
    """
    from kc2spice.rom import reduce as reduction

    if not isinstance(model, LinearModel):
        raise UsageError(
            "not a linear model",
            where="model",
            got=f"{type(model).__name__} {model!r}"[:120],
            expected="a kc.LinearModel",
            hint="kc.read_model(PATH) reads one, kc.LinearModel(M=M, K=K, B=B) makes one",
        )
    if parameters:
        raise UsageError(
            "matrices have no parameters to vary",
            where="parameters",
            got=", ".join(parameters),
            expected="keys of a body in a scene, under its rom.parameters",
            hint='kc.deck(kc.load_scene(SCENE, {"PART.rom": {"parameters": {KEY: [LOW, HIGH]}}})), '
            "whose parts are the subcircuits",
        )
    if band is not None:
        if isinstance(band, (str, float, int)) or len(band) != 2:
            raise UsageError(
                "not a frequency band",
                where="band",
                got=repr(band),
                expected='two frequencies, such as (0, 20e3) or (0, "20 kHz")',
            )
        low, high = (quantity(frequency, "Hz", where="band") for frequency in band)
        band = low, high
    if tolerance is not None:
        tolerance = quantity(tolerance, "", where="tolerance")
    norm = norm or reduction.default_norm(model)
    return reduction.reduce(
        model, tolerance=tolerance, order=order, band=band, norm=norm, contact=contact
    )


def deck(scene: AnyScene, *, trust: bool = False) -> Deck:
    """The netlist of a scene with its libraries; ``deck.files`` maps file names to texts.

    Builds and reduces what the scene needs, from the cache where it can. ``trust`` lets netlists
    that the scene includes act on the machine.

    Raises
    ------
    UsageError : as :func:`kc2spice.load_scene`, or a circuit that is wired wrongly.
    """
    return prepared(load_scene(scene), Clock(), trust=trust)[1]


def run(
    scene: AnyScene,
    out: str | Path | None = None,
    *,
    deck: str | Path | None = None,
    trust: bool = False,
    functions: Mapping[str, Function] | None = None,
    overrides: Mapping[str, Any] | None = None,
) -> Result:
    """Build, reduce, export and simulate a scene.

    Parameters
    ----------
    out : directory for what ``kc2spice run`` writes there; nothing is kept without it.
    deck : a netlist of this scene that was edited by hand, to be run instead of the scene's own.
    trust : let netlists and Python files that the scene names act on the machine.
    functions : ``function(time, inputs) -> output`` of each ``controller`` part by its name, in SI,
        instead of the Python file beside the scene. A run that is repeated with other settings
        begins at time 0 again. A function with a memory must then reset it; a file is read again.
    overrides : as those of :func:`kc2spice.load_scene`.

    Raises
    ------
    UsageError : as :func:`kc2spice.load_scene`; a ``deck`` that lacks what the metrics need; an
        ``out`` that cannot be written, noticed before anything is computed.
    MissingToolError : no ngspice.
    SimulationError : ngspice or a check of its result failed. With ``out``, deck and log are kept
        in ``OUT.failed`` until a run with the same ``out`` succeeds.
    """
    if out is not None and not isinstance(out, (str, Path)):
        raise UsageError(
            "not a directory",
            where="out",
            got=repr(out)[:120],
            expected="a path",
            hint='other values of keys: kc.run(SCENE, overrides={"rom.order": 10})',
        )
    loaded = load_scene(scene, overrides or {})
    edited = None if deck is None else Path(deck)
    kept = None if out is None else Path(out)
    place = tempfile.TemporaryDirectory(prefix="kc2spice-") if kept is None else staged(kept)
    with place as name:
        work = Path(name)
        done = complete(loaded, work, out=kept, trust=trust, deck=edited, functions=functions)
        if kept is not None:
            write_run_files(done, work)
    answer = done.run
    more: dict[str, Any] = {"figures": {item.name: item for item in done.figures}, "_done": done}
    return _result(answer.deck, answer.waves, done.record, answer.verdict.checks, **more)


def simulate(deck: Deck, *, timeout: float | None = None) -> Result:
    """Run a deck in ngspice, for its waveforms; ``timeout`` is in seconds of wall clock.

    Metrics and checks are those of a scene's parts, so they need the scene: :func:`run`, with an
    edited netlist as its ``deck``.

    Raises
    ------
    UsageError : not a deck.
    MissingToolError : no ngspice.
    SimulationError : ngspice failed or stopped early; the message says where.
    """
    if not isinstance(deck, Deck):
        got = type(deck).__name__
        raise UsageError("not a deck", where="deck", got=got, hint="kc.run runs a scene")
    with tempfile.TemporaryDirectory(prefix="kc2spice-") as work:
        waves = run_deck(deck, Path(work), timeout=timeout)
    record = {"scene": deck.name, "version": __version__, "netlist": deck.main}
    return _result(deck, waves, record)


@dataclass(frozen=True, repr=False, eq=False)
class Result:
    """What a simulation gave.

    Attributes
    ----------
    scene : name of the scene or deck.
    metrics : numbers by name, in the SI unit that ``record["metric_units"]`` states.
    waves : arrays (points,) in SI by name, over ``scale``; complex in an ``ac`` analysis.
    units : SI unit of each wave.
    checks : what was held against physics: ``name``, ``value``, ``limit``, ``passed``, ``advice``.
    record : everything that ``result.json`` says, but for the names of files.
    deck : the deck that gave this result.
    figures : plots of the scene's parts by name, for :meth:`plot`.
    """

    scene: str
    metrics: Mapping[str, Any]
    waves: Mapping[str, np.ndarray]
    units: Mapping[str, str]
    checks: tuple[Check, ...]
    record: Mapping[str, Any]
    deck: Deck
    figures: Mapping[str, Figure] = field(default_factory=dict)
    _done: Completed | None = None

    @property
    def scale(self) -> str:
        """Name of the wave that all others are over: ``time``, ``frequency`` or ``sweep``."""
        return next(iter(self.waves))

    @property
    def time(self) -> np.ndarray:
        """Time points [s] (points,), unequally spaced; UsageError unless it was a transient."""
        return self._over("time")

    @property
    def frequency(self) -> np.ndarray:
        """Frequencies [Hz] (points,); UsageError unless it was an ``ac`` analysis."""
        return self._over("frequency")

    def _over(self, scale: str) -> np.ndarray:
        if self.scale != scale:
            raise UsageError(f"this result is not over {scale}", where=self.scene, got=self.scale)
        return self.waves[scale]

    def plot(self, *names: str) -> Any:
        """Draw waves, or one of ``figures``, or without names the first of the figures.

        Waves of one unit share a pair of axes; complex ones are drawn by magnitude. Returns a
        matplotlib figure that notebooks show by themselves; ``.savefig(path)`` writes it.

        Raises
        ------
        UsageError : no such wave or figure, or a single point.
        """
        from kc2spice.report.figures import notebook_figure
        from kc2spice.report.run_page import probe_figures

        if not names and self.figures:
            names = (next(iter(self.figures)),)
        if len(names) == 1 and names[0] in self.figures:
            return notebook_figure(self.figures[names[0]])
        known = [name for name in self.waves if name != self.scale]
        for name in names:
            if name not in known:
                raise unknown("no such wave or figure", name, [*self.figures, *known], self.scene)
        probes = {name: Probe(of=name) for name in names or known}
        for figure in probe_figures(probes, Waveforms(dict(self.waves), {}), self.units):
            return notebook_figure(figure)
        raise UsageError("a single point is no curve", where=self.scene, got=self.scale)

    def to_xarray(self) -> Any:
        """Return the waves as an ``xarray.Dataset`` over time, frequency or sweep.

        Returns
        -------
        xarray.Dataset
            One variable for each wave in SI, with its unit in ``attrs["units"]``. The coordinate is
            that of ``scale``. Complex waves stay complex.

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
        variables = {
            name: xarray.Variable((self.scale,), wave, {"units": self.units.get(name, "")})
            for name, wave in self.waves.items()
        }
        coordinate = {self.scale: variables.pop(self.scale)}
        return xarray.Dataset(variables, coordinate, {"scene": self.scene})

    def save(self, out: str | Path, *, png: bool = False) -> Path:
        """Write deck, libraries, waveforms, ``result.json`` and, of a scene, ``report.html``; with
        ``png`` its figures as files too.

        Returns the directory ``out``; it gets all files at once or none.

        Raises
        ------
        UsageError : ``out`` cannot be written, or another deck there includes another library of
            the same name.
        """
        with staged(out) as work:
            spare_other_decks(Path(out), self.deck.files)
            if self._done is not None:
                write_run_files(self._done, work, png=png)
            else:
                write_files(self.deck.files, work)
                waves = Waveforms(dict(self.waves), {})
                files = [*self.deck.files, *write_waveforms(waves, self.units, work)]
                write_record({**self.record, "files": [*files, "result.json"]}, work)
        return Path(out)

    def __repr__(self) -> str:
        points = self.waves[self.scale].size
        head = f"<Result {self.scene}: {points} points over {self.scale}, "
        head += f"{len(self.waves) - 1} waves"
        failed = [check.name for check in self.checks if not check.passed]
        if self.checks:
            head += f", {len(self.checks)} checks " + (f"FAILED {failed}" if failed else "passed")
        lines = [f"  {name} = {_shown(value)}" for name, value in self.metrics.items()]
        return "\n".join([head + ">", *lines])

    def _repr_html_(self) -> str:
        rows = [(name, _shown(value)) for name, value in self.metrics.items()]
        return f"<p>{escape(repr(self).splitlines()[0])}</p>{_html(('metric', 'value'), rows)}"


def _html(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table for notebooks."""
    cells = [("th", head), *(("td", row) for row in rows)]
    lines = ("".join(f"<{tag}>{escape(c)}</{tag}>" for c in row) for tag, row in cells)
    return f"<table><tr>{'</tr><tr>'.join(lines)}</tr></table>"


def _shown(value: Any) -> str:
    """A metric in one line; arrays by their length."""
    if isinstance(value, bool) or value is None or isinstance(value, str):
        return str(value)
    if isinstance(value, (int, float)):
        return f"{value:.6g}"
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {_shown(item)}" for key, item in value.items())
    return f"{len(value)} values" if hasattr(value, "__len__") else str(value)


def _result(
    deck: Deck,
    waves: Waveforms,
    record: Mapping[str, Any],
    checks: tuple[Check, ...] = (),
    **more: Any,
) -> Result:
    scale = next(iter(waves.data))
    units = {scale: SCALES.get(scale, ""), **deck.units}
    metrics = record.get("metrics", {})
    return Result(record["scene"], metrics, waves.data, units, checks, record, deck, **more)


class Table(tuple[dict[str, Any], ...]):
    """Rows of a sweep, each a mapping; ``columns`` names each swept key, each metric that is one
    number, ``status``.

    ``status`` is ``"ok"``, or ``"failed: "`` and the reason why a point has no metrics (they are
    None then).
    """

    @property
    def columns(self) -> tuple[str, ...]:
        """Names, in the order of every row."""
        return tuple(next(iter(self)))

    def __getitem__(self, column: Any) -> Any:
        """A column by name, or a row by number."""
        if not isinstance(column, str):
            return super().__getitem__(column)
        if column not in self.columns:
            raise unknown("no such column", column, self.columns)
        return [row[column] for row in self]

    def save(self, path: str | Path) -> Path:
        """Write the table as CSV."""
        from kc2spice.workflow.sweep.run import write_csv

        write_csv({name: self[name] for name in self.columns}, Path(path))
        return Path(path)

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

    def _cells(self) -> list[list[str]]:
        return [[_shown(value) for value in row.values()] for row in self]

    def __repr__(self) -> str:
        cells = [list(self.columns), *self._cells()]
        widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
        lines = (map(str.rjust, row, widths) for row in cells)
        return "\n".join(map("  ".join, lines))

    def _repr_html_(self) -> str:
        return _html(self.columns, self._cells())


def sweep(
    scene: AnyScene,
    values: Mapping[str, Sequence[Any]],
    *,
    executor: Executor | None = None,
    workers: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Table:
    """Run a scene at every combination of ``values``, the last key varying fastest.

    The loop is that of ``kc2spice sweep``; use the command for tables that survive a kill.

    Parameters
    ----------
    values : dotted keys and the values that each takes.
    executor : where the points run: any :class:`concurrent.futures.Executor`, such as
        ``dask.distributed.Client(ADDRESS).get_executor()``; threads of this process unless given.
        Workers elsewhere get a scene's files along if it is given by name or path.
    workers : simulations at a time; the number of processors unless given.
    progress : called with the number of points that are done and that of all.

    Returns
    -------
    Table : a row for each point. What goes wrong with one point stands in its ``status``.

    Raises
    ------
    UsageError : no values, or a point that is no scene; noticed before anything is run.
    MissingToolError : no ngspice.
    """
    from kc2spice.workflow.sweep.plan import make_plan
    from kc2spice.workflow.sweep.point import Job, scene_text
    from kc2spice.workflow.sweep.run import columns, cores, outcomes, planned

    if not values or not all(len(item) for item in values.values()):
        raise UsageError("nothing to sweep", where="values", expected="{key: [value, …]}")
    if executor is None:
        find_ngspice()
    named = isinstance(scene, (str, Path))
    source = scene_text(str(scene)) if named else load_scene(scene)
    plan = make_plan({key: tuple(item) for key, item in values.items()})
    asked = planned(Job(source), plan, dict.fromkeys(plan.keys, ""))
    result: dict[int, Any] = {}
    with ExitStack() as opened, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        count = workers or cores()
        pool = executor or opened.enter_context(ThreadPoolExecutor(count))
        for index, outcome in outcomes(asked, range(plan.size), lambda: nullcontext((pool, count))):
            result[index] = outcome
            if progress is not None:
                progress(len(result), plan.size)
    table = columns(result, plan)
    return Table(dict(zip(table, row, strict=True)) for row in zip(*table.values(), strict=True))
