"""Readers of ngspice's log and of its binary raw files.

The readers find failures and difficulties in the log, each with its node or part, and ignore
harmless messages. Raw files are checked for completeness.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import dropwhile
from operator import itemgetter
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from kc2spice.core.errors import SimulationError
from kc2spice.core.user_warnings import warn_user
from kc2spice.core.waveforms import Waveforms
from kc2spice.netlist.deck import Deck
from kc2spice.netlist.importer import DISPLAYED_PARAMETERS
from kc2spice.netlist.nodes import describe_node

# The kind "coarse" means that ngspice finished, but the result violates the energy balance.
FailureKind = Literal["timestep", "singular", "operating point", "coarse"]

# Messages that ngspice prints in a failed run, with any exit code.
_FATAL_MESSAGE = re.compile(
    r"timestep too small|iteration limit reached|run simulation\(s\) aborted|"
    r"simulation interrupted|there aren't any circuits|no such vector|fatal|"
    r"unknown subckt|can't find model|unknown parameter|undefined (?:parameter|number)|"
    r"cannot (?:find|open|compute|evaluate)|could not find|no such file|"
    r"not enough memory|out of memory|no space left|^\s*error\b|\bsyntax error\b",
    re.IGNORECASE,
)
# Messages about difficulties in the search for the operating point, such as "singular matrix".
# For exported decks, ngspice must find the operating point without such messages.
_DIFFICULTY_MESSAGE = re.compile(
    r"singular matrix|gmin step|gmin increment|trying gmin|source stepping|supplies reduced|"
    r"transient op|nodeset",
    re.IGNORECASE,
)
# Messages with the name of a node or a device, such as 'trouble with b-instance b.x1.b2'.
_NODE_MESSAGE = re.compile(
    r'trouble with (?:node |\S+-instance )?"?([^\s"]+?)"?(?:[:\s]|$)|check node (\S+)', re.I
)
# Messages about a parameter, value or card that ngspice ignored or replaced.
_ALTERED_MESSAGE = re.compile(
    r"\bignor(?:ed|ing)\b|\b(?:re)?set to\b|\bassumed?\b|\blimited to\b|\breplaced\b|"
    r"\bdefault(?:ed|ing|s)?\b|\bnot (?:yet )?(?:supported|implemented)\b|\bunsupported\b|"
    r"\bsetting\b.*\bto\b|\bis used\b|\bdisabled\b|\bskipped\b|\btreated as\b|\bobsolete\b",
    re.IGNORECASE,
)
# Harmless messages that _ALTERED_MESSAGE would match, for example about printed vectors.
# A source without a value is 0 V or 0 A by definition, so a message about it is harmless.
_HARMLESS_MESSAGE = re.compile(
    r"^\s*circuit:|line ignored since rawfile|has no value, DC 0 assumed|"
    r"dc value used for op instead of transient|no DC value, transient time 0 value used|"
    r"^\s*seed value for",
    re.IGNORECASE,
)
_MODEL_LINE = re.compile(r"model issue on line \d+", re.IGNORECASE)
_DISPLAYED_PARAMETER = re.compile(
    rf"unrecognized parameter \((?:{'|'.join(sorted(DISPLAYED_PARAMETERS))})\)", re.IGNORECASE
)
MAX_ALTERATIONS = 5  # largest number of messages about altered cards that an error quotes
_OPERATING_POINT_FAILURE = re.compile(
    r"DC solution failed|transient op failed|initial timepoint", re.IGNORECASE
)
# Messages that consist of a card that ngspice cannot read, and of the reason in the next line.
_CARD_ERROR = re.compile(
    r"^Error on line(?: \d+ or its substitute)?:?[ \t]*\n[ \t]+(.+?)[ \t]*\n[ \t]*(\S.*?)[ \t]*$",
    re.M | re.I,
)
_TIME_PATTERN = re.compile(r"time = ([-+0-9.eE]+)", re.IGNORECASE)
_STATISTICS_PATTERNS = {
    "accepted": r"Accepted timepoints = (\d+)",
    "rejected": r"Rejected timepoints = (\d+)",
    "iterations": r"Total iterations = (\d+)",
    "cpu_s": r"Total analysis time \(seconds\) = ([0-9.eE+-]+)",
}

_SWEEP_FAILURE = re.compile(r"DC:\s+timestep too small;\s+\w+_swept = ", re.IGNORECASE)
_ADVICE_BY_CAUSE: Mapping[FailureKind | None, str] = {
    "timestep": "time steps become small at discontinuities and in very stiff parts: try more "
    "damping, a softer stop for impacts, a stiffer stop for an electrostatic gap, hysteresis or a "
    "finite transition width of a switch, or a smaller solver.max_step",
    "singular": "look for loops of voltage sources, nodes between capacitors and parts of value 0",
    "operating point": "look for the included circuit's state at t = 0; give it a .nodeset",
}
# advice if a dc sweep finds no operating point at a value after the first value
_SWEEP_ADVICE = (
    "the state of the circuit jumps at this value of the sweep: try a stiffer stop for an "
    "electrostatic gap, a finite transition width of a switch, or an end of the sweep before this "
    "value"
)


@dataclass(frozen=True)
class Failure:
    """Failure of a simulator run, read from the log of the run.

    ``cause`` is the log line that reports the failure. ``node``, ``part`` and ``time`` [s] state
    where and when the failure occurred. ``kind`` is the kind of failure, which determines the
    settings of a retry. Unknown values are None. ``struggles`` are log lines about difficulties in
    the search for the operating point. ``partial`` contains the waveforms up to the failure, if
    any.
    """

    cause: str | None
    node: str | None = None
    time: float | None = None
    kind: FailureKind | None = None
    struggles: tuple[str, ...] = ()
    part: str | None = None
    partial: Waveforms | None = None


def find_failure(text: str) -> Failure:
    """Return the failure that the log of a run reports.

    ``text`` is the log of one run. If the log reports no failure, the cause is None.
    """
    lines = re.split(r"[\r\n]+", _CARD_ERROR.sub(r"error in the card \1: \2", text))
    errors, struggles = [], []
    for line in lines:
        if _FATAL_MESSAGE.search(line):
            errors.append(line.strip())
        elif _DIFFICULTY_MESSAGE.search(line):
            struggles.append(line.strip())
    cause = next(filter(_NODE_MESSAGE.search, errors), errors[0] if errors else None)
    suspects = [cause, *errors, *struggles] if cause else []
    kind: FailureKind | None = None
    if any("timestep too small" in line.lower() and _TIME_PATTERN.search(line) for line in errors):
        kind = "timestep"
    elif errors and _OPERATING_POINT_FAILURE.search(text):
        singular = "singular matrix" in "\n".join(struggles).lower()
        kind = "singular" if singular else "operating point"
    node = next(filter(None, map(_NODE_MESSAGE.search, suspects)), None)
    time = next(filter(None, map(_TIME_PATTERN.search, suspects)), None)
    return Failure(
        cause,
        (node[1] or node[2]) if node else None,
        float(time[1]) if time else None,
        kind,
        tuple(struggles),
    )


def list_changed_cards(text: str) -> tuple[str, ...]:
    """Return the lines of the log that report changed or ignored cards.

    Equal lines are returned only once. If the log contains the ``.model`` card that a line belongs
    to, the returned line begins with this card.
    """
    result: dict[str, None] = {}
    model, expected = "", False
    for line in filter(None, map(str.strip, re.split(r"[\r\n]+", text))):
        if expected:
            model, expected = line.removesuffix("...").strip(), False
        elif _MODEL_LINE.search(line):
            expected = True
        elif not _ALTERED_MESSAGE.search(line) or _HARMLESS_MESSAGE.search(line):
            model = ""
        else:
            result[f"{model}: {line}" if model else line] = None
    return tuple(result)


def read_statistics(text: str) -> dict[str, float]:
    """Read numbers of time points and iterations, and the CPU time [s], from a log.

    ngspice prints the statistics of a run if the deck contains ``.options acct``.
    """
    result = {}
    for key, pattern in _STATISTICS_PATTERNS.items():
        match = re.search(pattern, text)
        if match:
            result[key] = float(match[1])
    return result


# --- failed runs ----------------------------------------------------------------------------------


class FailedRunError(SimulationError):
    """Error for a run that ngspice aborted, stopped early, or ran with altered cards."""

    failure: Failure


def find_run_failure(
    deck: Deck, where: str, text: str, code: int = 0, last: float | None = None
) -> FailedRunError | None:
    """Return the error for a failed run; None if the run succeeded.

    ``text`` is the log, and ``code`` the exit code of the run. The last time point ``last`` [s] is
    compared with the end time of the deck, because ngspice can stop early without a message.
    """
    report, stop = find_failure(text), deck.stop
    reported = report.cause is not None or code != 0
    early = last is not None and stop is not None and not abs(last - stop) <= 1e-9 * stop
    if not reported and not early:
        return None
    part = describe_node(deck, report.node) if report.node else None
    blamed = report.node and f"node {report.node}"
    if reported:
        cause = report.cause or f"exit code {code}"
        at = None if report.time is None else f"t = {report.time:g} s"
        tail = None if report.cause else " | ".join(text.strip().splitlines()[-3:])
        got = ", ".join(filter(None, (blamed, part, at))) or tail
        error = FailedRunError(f"ngspice failed: {cause}", where=where, got=got)
    else:
        cause = "ngspice stopped before the end of the transient"
        got = ", ".join(filter(None, (f"last time point {last:g} s", blamed)))
        error = FailedRunError(cause, where=where, got=got, expected=f"{stop:g} s")
    error.failure = replace(report, cause=cause, part=part)
    error.hint = _ADVICE_BY_CAUSE.get(report.kind)
    if report.kind == "operating point" and _SWEEP_FAILURE.search(cause):
        error.hint = _SWEEP_ADVICE
    return error


def find_alteration_error(deck: Deck, where: str, text: str) -> FailedRunError | None:
    """Return the error for a run in which ngspice changed or ignored cards.

    ``text`` is the log. Return None if the deck is trusted, or if ngspice ignored only model
    parameters that LTspice merely displays. If the function returns None, it prints a warning for
    each card that ngspice changed or ignored.
    """
    altered = list_changed_cards(text)
    fatal = [] if deck.trusted else [row for row in altered if not _DISPLAYED_PARAMETER.search(row)]
    if not fatal:
        for row in altered:
            warn_user(f"ngspice: {row}")
        return None
    error = FailedRunError(
        "ngspice ignored or replaced a part of this netlist",
        where=where,
        got="; ".join(fatal[:MAX_ALTERATIONS]),
    )
    error.expected = "a netlist that ngspice simulates as it is written"
    error.hint = (
        "write it with parameters that ngspice has, or delete them; a netlist part for LTspice "
        'needs syntax = "ltspice"; --trust (trust=True in Python) runs it with a warning'
    )
    error.failure = Failure(fatal[0])
    return error


# Times, frequencies or swept values with at most this relative difference count as equal.
# ngspice adds up steps of the independent variable: the rounding error is 1e-16 per step, and
# 1e-13 in total.
SAME_POINT_TOLERANCE = 1e-11
_BINARY_MARK = b"Binary:\n"
_PLOT_MARK = b"Title:"
_MAX_HEADER_BYTES = 1 << 20  # largest size [bytes] of a plot's header in a raw file


class _Plot(NamedTuple):
    """Plot in a raw file; this is ngspice's term for the vectors of one analysis.

    ``declared_points`` is the number of points that the header of the plot states. ``table``
    contains the complete points in the file, one in each row. ``remaining_bytes`` is the number of
    bytes after the complete points. The next plot begins at the byte ``end``, which is None for the
    last plot.
    """

    names: tuple[str, ...]
    declared_points: int
    table: np.ndarray
    remaining_bytes: int
    end: int | None

    @property
    def finite_point_mask(self) -> np.ndarray:
        """Mask of the points that contain only finite numbers, of shape (points,).

        The imaginary part of the first column, the independent variable, is ignored, because
        ngspice does not initialise it for frequencies.
        """
        return np.isfinite(self.table[:, 0].real) & np.isfinite(self.table[:, 1:]).all(axis=1)

    def get_first_points(self, points: int) -> dict[str, np.ndarray]:
        """Return the first points of all vectors, keyed by vector name.

        ``points`` is the number of points that are read. The independent variable is real. With
        tiny time steps, ngspice can write several points at one time; the last of these points is
        returned.
        """
        rows = self.table[:points]
        if self.names[0] == "time" and len(rows):
            apart = np.diff(rows[:, 0].real, append=np.inf) > 0
            if not apart.all():
                rows = rows[apart]
        columns = map(np.array, (rows[:, 0].real, *rows[:, 1:].T))
        return dict(zip(self.names, columns, strict=True))


def read_raw(path: Path) -> dict[str, np.ndarray]:
    """Return the vectors of a raw file, keyed by name in lower case.

    The first vector is the independent variable, such as the time, and is real. If several analyses
    of one kind write plots with the same vectors, the plots are joined. The points of joined plots
    are sorted by the independent variable, and each of its values occurs only once. Plots whose
    vectors differ from the vectors of the first plot are omitted.

    Raises
    ------
    SimulationError : the file is missing, empty or truncated, contains more data than its header
        states, or contains values that are not finite.
    """
    if not path.is_file():
        raise SimulationError("the simulator wrote no raw file", where=str(path))
    plots = list(_read_plots(path))
    first = plots[0]
    plots = [first, *(plot for plot in plots[1:] if plot.names == first.names)]
    for plot in plots:
        if not plot.finite_point_mask.all():
            raise _make_corrupt_file_error(path, "it contains values that are not finite")
    if len(plots) == 1:
        return first.get_first_points(len(first.table))
    return join_analyses([plot.get_first_points(len(plot.table)) for plot in plots])


def join_analyses(analyses: Sequence[Mapping[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Return joined vectors of several analyses, sorted by the independent variable.

    The first vector of each analysis is its independent variable: time, frequency or swept value.
    Each value of the independent variable occurs only once.
    """
    result = {}
    for name in analyses[0]:
        result[name] = np.concatenate(list(map(itemgetter(name), analyses)))
    scale, order = np.unique(next(iter(result.values())), return_index=True)
    apart = np.diff(scale, prepend=-np.inf) > SAME_POINT_TOLERANCE * np.abs(scale)
    return {name: values[order[apart]] for name, values in result.items()}


def _read_plots(path: Path) -> Iterator[_Plot]:
    """Yield the plots of a raw file; an ngspice plot is the data set of one analysis.

    An error is raised if a plot does not contain all points that its header states.
    """
    begin: int | None = 0
    while begin is not None:
        plot = _read_plot(path, begin)
        if plot is None:
            raise _make_corrupt_file_error(path, "its header is cut off")
        points = len(plot.table)
        if points < 1 or (points, plot.remaining_bytes) != (plot.declared_points, 0):
            what = (
                f"its header states {plot.declared_points} points, but it contains {points} points "
                f"and {plot.remaining_bytes} bytes"
            )
            raise _make_corrupt_file_error(path, what)
        yield plot
        begin = plot.end


def read_partial_vectors(path: Path) -> dict[str, np.ndarray] | None:
    """Return the vectors of an aborted run, up to the first point that is not finite.

    Incomplete points are omitted. Return None if the file begins with fewer than two complete
    points of finite numbers.
    """
    try:
        plot = _read_plot(path)
    except (OSError, SimulationError):
        return None
    good = int(np.argmin(np.append(plot.finite_point_mask, False))) if plot else 0
    return plot.get_first_points(good) if plot and good > 1 else None


def read_last_scale_value(path: Path) -> float | None:
    """Return the last complete time, frequency or swept value in a raw file.

    Return None if the file contains no complete point.
    """
    plot = _read_plot(path) if path.is_file() else None
    return float(plot.table[-1, 0].real) if plot and len(plot.table) else None


def _read_plot(path: Path, begin: int = 0) -> _Plot | None:
    """Read the ngspice plot at byte ``begin``; None if its header is incomplete.

    Raises
    ------
    SimulationError : there is no header of a binary raw file at this byte.
    """
    with path.open("rb") as stream:
        stream.seek(begin)
        head = stream.read(_MAX_HEADER_BYTES)
    end = head.find(_BINARY_MARK)
    if end < 0:
        return None
    lines = head[:end].decode("utf-8", "replace").splitlines()
    fields = dict(line.split(":", 1) for line in lines if ":" in line and not line[:1].isspace())
    try:
        count, promised = int(fields["No. Variables"]), int(fields["No. Points"])
        _, *vectors = dropwhile(lambda line: not line.startswith("Variables:"), lines)
        names = tuple(line.split()[1].lower() for line in vectors[:count])
    except (KeyError, ValueError, IndexError):
        raise _make_corrupt_file_error(
            path, "it does not begin with the header of a binary raw file"
        ) from None
    if len(names) != count or count < 1:
        raise _make_corrupt_file_error(
            path, f"its header states {count} vectors, but it lists {len(names)} names"
        )
    kind = np.dtype(np.complex128 if "complex" in fields.get("Flags", "") else np.float64)
    offset = begin + end + len(_BINARY_MARK)
    complete, left = divmod(path.stat().st_size - offset, kind.itemsize * count)
    following = offset + promised * kind.itemsize * count
    follows = complete >= promised > 0 and _has_next_plot(path, following)
    if follows:
        complete, left = promised, 0
    table = (
        np.memmap(path, kind, "r", offset, (complete, count)) if complete else np.empty((0, count))
    )
    return _Plot(names, promised, table, left, following if follows else None)


def _has_next_plot(path: Path, offset: int) -> bool:
    """Return whether another plot of a raw file begins at a byte offset."""
    with path.open("rb") as stream:
        stream.seek(offset)
        return stream.read(len(_PLOT_MARK)) == _PLOT_MARK


def _make_corrupt_file_error(path: Path, damage: str) -> SimulationError:
    """Make the error about a damaged raw file, with a description of the damage."""
    return SimulationError(f"the raw file is damaged: {damage}", where=str(path))
