"""Checks of the keys of a scene, before the parts of the scene are joined."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain
from math import inf
from operator import attrgetter

from kc2spice.core.errors import UsageError, join_words, list_candidates
from kc2spice.core.key_actions import DeleteKey, SetKey
from kc2spice.core.probe_values import make_outside_error
from kc2spice.core.quantities import USUAL_GRAVITY, convert_quantity
from kc2spice.core.schemas import KeyPath, find_unit, join_path
from kc2spice.core.si_prefix_format import format_quantity
from kc2spice.core.toml_text import format_toml
from kc2spice.core.user_warnings import warn_user
from kc2spice.core.waveforms import Waveform
from kc2spice.scene.part_method_calls import PERIOD_TOLERANCE
from kc2spice.scene.plausibility import (
    ImplausibleValueError,
    apply_check_action,
    check_plausible_values,
    check_usual_range,
)
from kc2spice.scene.scene_classes import Scene
from kc2spice.scene.settings import ANALYSIS_UNITS, Analysis, ProbeKeys

MAX_TIME_POINTS = 1e7  # largest number of time points in a transient
# duration of a transient that an error message proposes, divided by the largest time step
USUAL_STEPS = 1000
# A frequency in mHz probably means MHz if analysis.stop is at least MILLIHERTZ_RATIO times as high.
MILLIHERTZ_RATIO = 1e6
# A frequency in mHz also probably means MHz if a transient contains at most
# SMALLEST_PERIOD_SHARE of its period, so that a sine of this frequency is nearly constant.
SMALLEST_PERIOD_SHARE = 1e-3
_MILLIHERTZ = re.compile(r"\s*(\d+\.?\d*(?:[eE][+-]?\d+)?)\s*mHz\s*")
# keys of ``solver`` that only a transient uses
TRANSIENT_SOLVER_KEYS = ("stop", "max_step", "trtol", "method", "ringing")
# smallest frequency step that a simulator resolves, relative to the last frequency
SMALLEST_STEP_RATIO = 1e-12


def check_scene(scene: Scene) -> Iterator[UsageError]:
    """Yield an error for every invalid key or combination of keys of a scene."""
    if not scene.parts:
        yield UsageError(
            "the scene has no parts",
            where="",
            expected="at least one table with part = TYPE",
            hint="begin with a built-in scene:  kc2spice scenes buzzer_square > my.toml",
        )
        return
    yield from _check_parts(scene)
    _warn_of_gravity(scene)
    _warn_of_millihertz(scene)
    _warn_of_late_waveforms(scene)
    yield from _check_includes(scene)
    yield from _check_largest_step(scene)
    yield from _check_unused_keys(scene)
    _warn_of_unused_solver_keys(scene)
    yield from _check_sweep_keys(scene)
    yield from _check_frequencies(scene)
    yield from _check_noise_output(scene.analysis)
    yield from _check_noise_start(scene.analysis)
    if scene.analysis.type == "dc":
        yield from _check_swept_key(scene)
    for name, probe in scene.probes.items():
        yield from _check_level_probe(f"probes.{name}", probe, scene.analysis)
        for key, place in probe.positions_by_key.items():
            yield from _check_probe_position(f"probes.{name}.{key}", place, scene)


def _check_parts(scene: Scene) -> Iterator[UsageError]:
    """Yield the errors of parts; errors about implausible values come last."""
    implausible = list(check_usual_range("gravity", scene.gravity, USUAL_GRAVITY))
    for part in scene.parts.values():
        implausible_keys = check_plausible_values(part.name, part.keys)
        for problem in chain(implausible_keys, part.type.problems(part, scene)):
            if isinstance(problem, ImplausibleValueError):
                implausible.append(problem)
            else:
                yield problem
    yield from apply_check_action(implausible, scene.checks.plausible)


def _warn_of_gravity(scene: Scene) -> None:
    """Warn about a stated gravity that acts on no part, or that acts upwards."""
    if "gravity" not in scene.frame.model_fields_set or not scene.gravity:
        return
    if any(part.type.has_weight(part) for part in scene.parts.values()):
        if scene.gravity < 0:
            warn_user(
                f"gravity: {scene.gravity:g} m/s2 acts upwards, because the key `gravity` is "
                "positive downwards: delete the minus sign if the weight acts downwards"
            )
        return
    massive = (name for name, part in scene.parts.items() if hasattr(part.keys, "weight"))
    name = next(massive, None)
    action = f"write  weight = true  in [{name}]" if name else "delete the key"
    warn_user(
        f"the key `gravity` has no effect, because it acts on no part of this scene: {action}"
    )


def _warn_of_millihertz(scene: Scene) -> None:
    """Warn about each frequency in mHz that is far below the frequencies of the run.

    The prefix m (milli) may be a misspelling of the prefix M (mega).
    """
    analysis, duration = scene.analysis, scene.stop_time
    if analysis.is_small_signal and analysis.stop:
        limit = analysis.stop / MILLIHERTZ_RATIO
        reference = f"analysis.stop, {format_quantity(analysis.stop, 'Hz')}"
    elif analysis.type == "transient" and duration > 0:
        limit = SMALLEST_PERIOD_SHARE / duration
        reference = (
            f"the frequency range of a transient analysis of {format_quantity(duration, 's')}"
        )
    else:
        return
    for path, text in _list_texts(scene.tables, ()):
        match = _MILLIHERTZ.fullmatch(text)
        if match and 1e-3 * float(match[1]) <= limit:
            warn_user(
                f"{join_path(path)}: {text} is a frequency in millihertz, far below {reference}: "
                f'write  "{match[1]} MHz"  if you mean megahertz'
            )


def _list_texts(value: object, path: KeyPath) -> Iterator[tuple[KeyPath, str]]:
    """Yield all texts in nested tables and lists, each with the path of its key."""
    if isinstance(value, str):
        yield path, value
    items = value.items() if isinstance(value, Mapping) else ()
    for key, item in enumerate(value) if isinstance(value, list) else items:
        yield from _list_texts(item, (*path, key))


def _warn_of_late_waveforms(scene: Scene) -> None:
    """Warn about each source whose waveform begins after the end of the transient."""
    if scene.analysis.type != "transient":
        return
    for part in scene.parts.values():
        wave = getattr(part.keys, "waveform", None) or part.type.voltage(part, scene)
        begin = wave.find_first_change() if isinstance(wave, Waveform) else None
        if begin is not None and begin >= scene.stop_time:
            warn_user(
                f"{part.name}: the waveform begins at {format_quantity(begin, 's')}, but the "
                f"transient ends at {format_quantity(scene.stop_time, 's')}, so this source stays "
                "constant: let the waveform begin earlier, or raise analysis.stop"
            )


def _check_includes(scene: Scene) -> Iterator[UsageError]:
    """Yield an error if the scene includes netlists, but no part uses a netlist."""
    if scene.include and not any(part.is_user_netlist for part in scene.parts.values()):
        yield UsageError(
            "no part uses these included netlists",
            where="include",
            got=", ".join(scene.include),
            expected="a netlist part with a subcircuit of these files",
            hint='delete include, or write part = "netlist" in the table of a part',
        )


def _check_largest_step(scene: Scene) -> Iterator[UsageError]:
    """Yield an error if the largest time step is too long or too short."""
    step = scene.solver.max_step
    if scene.analysis.type != "transient" or not step:
        return
    stop_key = "solver.stop" if scene.analysis.stop is None else "analysis.stop"
    where = scene.select_overridden_key(stop_key, "solver.max_step")
    if step > scene.stop_time and where == stop_key:
        table, _, key = stop_key.partition(".")
        yield UsageError(
            "the simulation is shorter than its largest time step",
            where=where,
            got=format_quantity(scene.stop_time, "s"),
            expected=f"at least `solver.max_step`, {format_quantity(step, 's')}",
            hint=SetKey(table, key, f'"{format_quantity(USUAL_STEPS * step, "s")}"'),
        )
    elif step > scene.stop_time:
        yield UsageError(
            "the time step is longer than the simulation",
            where="solver.max_step",
            got=f"{step:g} s",
            expected=f"at most the duration of the simulation, {scene.stop_time:g} s",
            hint=DeleteKey("max_step", place="[solver]"),
        )
    points = scene.stop_time / step
    if points > MAX_TIME_POINTS:
        yield UsageError(
            "the run has too many time points",
            where=where,
            got=f"{scene.stop_time:g} s in steps of {step:g} s: {points:.2g} points",
            expected=f"at most {MAX_TIME_POINTS:g}",
            hint="raise solver.max_step, or lower analysis.stop or solver.stop"
            if where == "solver.max_step"
            else f"lower {where}, or raise solver.max_step",
        )


def _check_sweep_keys(scene: Scene) -> Iterator[UsageError]:
    """Yield an error if the key ``sweep`` or ``back`` is set without a dc analysis.

    The key ``back`` also requires that the sweep varies a source.
    """
    selected = scene.analysis
    if selected.type != "dc" and selected.sweep is not None:
        yield UsageError(
            "analysis.sweep needs a dc analysis",
            where="analysis.sweep",
            got=f"{selected.type} and a sweep",
            expected='type = "dc", or no sweep',
            hint="kc2spice sweep SCENE --set KEY=FROM:TO:POINTS runs an analysis at each value",
        )
    if selected.back:
        source = scene.parts.get((selected.sweep or "").removesuffix(".dc"))
        if selected.type != "dc" or source is None or source.type.name != "source":
            yield UsageError(
                "the key `back` needs a dc sweep of a source",
                where="analysis.back",
                got=f'type = "{selected.type}", '
                + (f'sweep = "{selected.sweep}"' if selected.sweep else "no key sweep"),
                expected='type = "dc" and sweep = "SOURCE.dc", or back = false',
                hint=DeleteKey("back"),
            )


def _check_frequencies(scene: Scene) -> Iterator[UsageError]:
    """Yield an error if an ``ac`` or ``noise`` analysis has no valid frequency range."""
    selected = scene.analysis
    if not selected.is_small_signal:
        return
    start, stop = selected.start, selected.stop or 0.0
    if selected.stop is None:
        yield UsageError(
            f"the key `analysis.stop` of the {selected.type} analysis is missing",
            where="analysis",
            got=f'type = "{selected.type}" without stop',
            expected='the last frequency, such as stop = "100 kHz"',
            hint=SetKey("analysis", "stop", '"100 kHz"', verb="add"),
        )
    elif not stop - start > SMALLEST_STEP_RATIO * selected.points * stop:
        yield UsageError(
            "the frequency range is empty"
            if stop <= start
            else "the frequency range is too narrow",
            where=scene.select_overridden_key("analysis.start", "analysis.stop"),
            got=" to ".join(format_quantity(end, "Hz", 12) for end in (start, stop)),
            expected=f"a stop above the start, {format_quantity(start, 'Hz')}"
            if stop <= start
            else f"stop - start of more than {SMALLEST_STEP_RATIO * selected.points:g} times stop",
            hint=f'exchange the two values: start = "{format_quantity(stop, "Hz", 12)}"  and  '
            f'stop = "{format_quantity(start, "Hz", 12)}"'
            if 0 < stop < start
            else f'for example  stop = "{format_quantity(10 * start, "Hz")}"',
        )
    stated = selected.model_fields_set
    if selected.type == "ac" and start == 0 and "start" in stated and "scale" not in stated:
        yield UsageError(
            "a logarithmic range cannot begin at zero",
            where="analysis.start",
            got=f"{start:g} Hz",
            expected='above 0, or scale = "linear"',
            hint=SetKey("analysis", "scale", '"linear"', end=" for equal steps from 0 Hz on"),
        )
    if selected.scale != "log":
        return
    if start <= 0:
        yield UsageError(
            "a logarithmic range cannot begin at zero",
            where="analysis.start",
            got=f"{start:g} Hz",
            expected='above 0, or scale = "linear"',
            hint=f'for example  start = "{stop / 1000:g} Hz"',
        )
    elif math.isinf(stop / start):
        yield UsageError(
            "the frequency range has too many decades",
            where="analysis.start",
            got=f"{start:g} … {stop:g} Hz",
            expected="at most 308 decades",
            hint=f'for example  start = "{stop / 1000:g} Hz"',
        )


def _check_noise_output(selected: Analysis) -> Iterator[UsageError]:
    """Yield an error if the key ``output`` is missing or does not suit the analysis."""
    expected = 'output = "PART.RESULT" or "PART.PIN" with type = "noise"'
    if selected.type == "noise" and selected.output is None:
        yield UsageError(
            "the key `analysis.output` of the noise analysis is missing",
            where="analysis",
            got='type = "noise" without output',
            expected=expected,
            hint=SetKey("analysis", "output", '"PART.RESULT"', verb="add"),
        )
    elif selected.type != "noise" and selected.output is not None:
        yield UsageError(
            f"the key `output` has no effect in the {selected.type} analysis",
            where="analysis.output",
            got=f'type = "{selected.type}", output = "{selected.output}"',
            expected=expected,
            hint=DeleteKey("output", place="[analysis]"),
        )


def _check_noise_start(selected: Analysis) -> Iterator[UsageError]:
    """Yield an error if a noise analysis begins at 0 Hz, which ngspice rejects."""
    start, stop = selected.start, selected.stop
    if selected.type == "noise" and start <= 0 and stop:
        yield UsageError(
            "a noise analysis cannot begin at 0 Hz",
            where="analysis.start",
            got=f"{start:g} Hz",
            expected=f"above 0 Hz and below the stop, {format_quantity(stop, 'Hz')}",
            hint=SetKey("analysis", "start", f'"{stop / 1000:g} Hz"', verb="add"),
        )


def _check_swept_key(scene: Scene) -> Iterator[UsageError]:
    """Yield an error if the key that a dc analysis sweeps belongs to no part.

    The units of the first and the last value of the sweep are also checked.
    """
    selected = scene.analysis
    name, _, _ = (selected.sweep or "").partition(".")
    if name not in scene.parts:
        sources = [part.name for part in scene.list_parts("source")]
        missing = selected.sweep is None
        listed = list_candidates(name, sources) if sources else "this scene has no source"
        yield UsageError(
            "the key `analysis.sweep` of the dc analysis is missing"
            if missing
            else f"this scene has no part {name!r}",
            where="analysis" if missing else "analysis.sweep",
            got='type = "dc" without sweep' if missing else repr(selected.sweep),
            expected=f"PART.dc of a source of the scene: {listed}",
            hint=SetKey("analysis", "sweep", f'"{sources[0]}.dc"')
            if sources
            else SetKey("analysis", "type", '"op"', end=", which needs no source"),
        )
    unit = _find_independent_variable_unit(scene)
    for key, value in (("from", selected.from_), ("to", selected.to)):
        if unit is not None and isinstance(value, str):
            convert_quantity(value, unit, where=f"analysis.{key}")


# types of analysis that read a key of ``analysis``
_ANALYSIS_TYPES_BY_KEY = {
    "stop": ("transient", "ac", "noise"),
    "start": ("ac", "noise"),
    "scale": ("ac", "noise"),
    "points": ("ac", "noise", "dc"),
    "from_": ("dc",),
    "to": ("dc",),
    "sweep": ("dc",),
    "back": ("dc",),
    "output": ("noise",),
}
# If only keys of this list are unused, separate functions yield the errors about the unused keys.
# If further keys are unused, :func:`_check_unused_keys` yields one error about all unused keys.
_SEPARATELY_CHECKED_KEYS = ("sweep", "back", "output")


def _check_unused_keys(scene: Scene) -> Iterator[UsageError]:
    """Yield one error about all keys of ``analysis`` that have no effect."""
    selected = scene.analysis
    unused = [
        name
        for name, types in _ANALYSIS_TYPES_BY_KEY.items()
        if selected.type not in types and getattr(selected, name) is not None
        and name in selected.model_fields_set
    ]  # fmt: skip
    changed = scene.source is not None and scene.source.overrides_key("analysis.type")
    if not unused or (not changed and set(unused) <= set(_SEPARATELY_CHECKED_KEYS)):
        return
    keys = [name.rstrip("_") for name in unused]
    quoted = _quote_keys(keys)
    is_single = len(keys) == 1
    types = " or ".join(_ANALYSIS_TYPES_BY_KEY[unused[0]])
    used = [
        name.rstrip("_") for name, kinds in _ANALYSIS_TYPES_BY_KEY.items() if selected.type in kinds
    ]
    yield UsageError(
        f"the key{'' if is_single else 's'} {quoted} {'has' if is_single else 'have'} no effect "
        f"in the {selected.type} analysis",
        where="analysis.type" if changed else f"analysis.{keys[0]}",
        got=f"{', '.join(keys)} with type = {selected.type}",
        expected=f"{keys[0]} with type = {types}"
        if is_single
        else f"with type = {selected.type}, only these keys: {', '.join(['type', *used])}",
        hint=_advise_analysis_keys(scene, keys),
    )


def _quote_keys(keys: Sequence[str]) -> str:
    """Return names of keys in backticks, as a list in a sentence.

    >>> _quote_keys(["stop", "start", "scale"])
    '`stop`, `start` and `scale`'
    """
    return join_words([f"`{key}`" for key in keys])


def _advise_analysis_keys(scene: Scene, unused: Sequence[str]) -> str:
    """Return a hint to delete unused keys of ``analysis``, and to add a missing key ``sweep``.

    If an override changes the type of the analysis, the hint is to override all keys.
    """
    selected, source = scene.analysis, scene.source
    added = {}
    if selected.type == "dc" and selected.sweep is None and (parts := scene.list_parts("source")):
        added["sweep"] = f"{parts[0].name}.dc"
    if source is not None and source.overrides_key("analysis.type"):
        stated = scene.tables.get("analysis", {})
        table = {key: value for key, value in stated.items() if key not in unused} | added
        origin = source.overrides["analysis", "type"]
        action = SetKey("", "analysis", format_toml(table))
        if origin.file is not None:
            deletion = DeleteKey("analysis.type", place=origin.file)
            return f"{deletion}, and {action.write_as_option('add')}"
        if origin.is_option:
            end = f"  in place of --set analysis.type={selected.type}"
            return action.write_as_option("write", end)
        return f"write  'analysis': {table!r}  in place of 'analysis.type': {selected.type!r}"
    quoted = _quote_keys(unused)
    addition = "".join(f', and add  {key} = "{value}"' for key, value in added.items())
    return f"delete the key{'' if len(unused) == 1 else 's'} {quoted} of [analysis]{addition}"


def _warn_of_unused_solver_keys(scene: Scene) -> None:
    """Warn about ``solver`` keys that have no effect in a run without time steps."""
    kind, stated = scene.analysis.type, scene.solver.model_fields_set
    for key in TRANSIENT_SOLVER_KEYS if kind != "transient" else ():
        if key in stated and getattr(scene.solver, key) is not None:
            warn_user(f"the key `solver.{key}` has no effect in the {kind} analysis")


def check_periods(scene: Scene) -> Iterator[UsageError]:
    """Yield an error for each probe that reads more periods than the run contains."""
    for name, probe in scene.probes.items():
        if probe.periods is not None:
            yield from _check_period_count(f"probes.{name}.periods", probe.periods, scene)


def _check_period_count(where: str, count: int, scene: Scene) -> Iterator[UsageError]:
    """Yield an error if the run does not contain at least ``count`` periods."""
    if scene.analysis.type != "transient":
        yield UsageError(
            "the key `periods` needs a transient analysis",
            where=where,
            got=f"{scene.analysis.type} analysis",
            expected="a transient analysis, or the keys `from` and `to` in place of `periods`",
            hint=DeleteKey("periods"),
        )
        return
    period = scene.period
    if period is None:
        known = sorted(set(map(attrgetter("period"), scene.numerics)) - {0.0})
        periods = ", ".join(map("{:.4g} s".format, known))
        yield UsageError(
            "the sources of this scene have no common period",
            where=where,
            got=f"periods {periods}" if periods else "no source with a period",
            expected="sines and pulse trains whose periods divide the longest one",
            hint='replace the key `periods` by the keys `from` and `to`, such as  from = "8 ms"',
        )
    elif count * period > scene.stop_time * (1 + PERIOD_TOLERANCE):
        fitting = int(scene.stop_time / period)
        yield UsageError(
            "the time window of this probe is longer than the run",
            where=where,
            got=f"{count} periods of {period:.4g} s",
            expected=f"at most {scene.stop_time:g} s, the end of the transient",
            hint=f"write periods = {fitting}" if fitting else "raise the stop of the analysis",
        )


def _check_level_probe(where: str, probe: ProbeKeys, selected: Analysis) -> Iterator[UsageError]:
    """Yield an error for a sound pressure level that the analysis cannot compute."""
    if probe.take != "spl":
        return
    kinds = ("ac",) if probe.at is not None else ("ac", "transient")
    if selected.type not in kinds:
        yield UsageError(
            "this analysis cannot compute this sound pressure level",
            where=f"{where}.take",
            got=f"{selected.type} analysis{' and the key `at`' if probe.at is not None else ''}",
            expected=f"type = {' or '.join(kinds)}",
            hint=SetKey("analysis", "type", f'"{kinds[0]}"', end=", or delete this probe"),
        )


def _check_probe_position(where: str, place: float, scene: Scene) -> Iterator[UsageError]:
    """Yield an error if a probe reads a point outside of the range of the analysis."""
    selected, part_unit = scene.analysis, getattr(place, "unit", "")
    unit = _find_independent_variable_unit(scene)
    if part_unit and unit is not None and part_unit != unit:
        examples = {"s": '"2 ms"', "Hz": '"46 Hz"', "": "a plain number"}
        article = "an" if selected.type in ("ac", "op") else "a"
        hint = f"write a value in {unit}" if unit else "write the value without a unit"
        yield UsageError(
            f"the unit of this value does not match {article} {selected.type} analysis",
            where=where,
            got=f"a value in {part_unit}",
            expected=f"a value in {unit}, such as {examples.get(unit, repr(f'1 {unit}'))}",
            hint=hint,
        )
        return
    band = (selected.start, selected.stop or 0.0)
    ends = {"ac": band, "noise": band, "transient": (0.0, scene.stop_time)}
    first, last = ends.get(selected.type, (-inf, inf))
    if not first <= place <= last:
        yield make_outside_error(where, place, first, last, unit or "")


def _find_independent_variable_unit(scene: Scene) -> str | None:
    """Return the unit of the independent variable: time, frequency or swept key.

    The result is None if the unit is unknown.
    """
    selected = scene.analysis
    if selected.type != "dc":
        return ANALYSIS_UNITS.get(selected.type)
    name, _, key = (selected.sweep or "").partition(".")
    part = scene.parts.get(name)
    if part is None:
        return None
    part_unit = getattr(part.keys, "unit", None)
    field = type(part.keys).model_fields.get(key)
    return part_unit if isinstance(part_unit, str) else None if field is None else find_unit(field)
