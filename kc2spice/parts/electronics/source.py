"""The part ``source``: independent source of a quantity of any physical domain."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from pydantic import Field, PrivateAttr, ValidationInfo, field_validator, model_validator

from kc2spice.core import constitutive_laws as laws
from kc2spice.core import waveforms as waves_
from kc2spice.core.domains import QUANTITIES, Domain, Quantity, Side
from kc2spice.core.errors import UsageError
from kc2spice.core.key_actions import ChangeKey, SetKey
from kc2spice.core.quantities import Section, convert_quantity, make_invalid_value_error
from kc2spice.core.si_prefix_format import format_quantity
from kc2spice.core.spectrum import find_waveform_frequency
from kc2spice.core.toml_text import clip_text, format_toml
from kc2spice.core.untrusted_files import locate_file_in_folder, read_bounded
from kc2spice.core.user_warnings import warn_user
from kc2spice.core.waveforms import PulseKeys, SineKeys, Waveform, Waveforms
from kc2spice.netlist.card_parser import split_words
from kc2spice.netlist.circuit import Element, Item
from kc2spice.netlist.number_and_name_spelling import format_number, format_voltage
from kc2spice.scene.checks import Check
from kc2spice.scene.part_records import (
    EquilibriumConditions,
    HighestFrequency,
    NumericalRequirements,
    PartResult,
    SweptSource,
)
from kc2spice.scene.parttype import register_part_type
from kc2spice.scene.scene_classes import (
    BuiltScene,
    DeclaredScene,
    GovernedScene,
    JoinedScene,
    Part,
    PartType,
    Scene,
    Terminal,
    WiredScene,
)


class SourceKind(NamedTuple):
    """Kind of a source: domain, and across or through quantity that it prescribes.

    The side is ``across`` (such as a voltage) or ``through`` (such as a current).
    """

    domain: Domain
    side: Side

    @property
    def quantity(self) -> Quantity:
        """Physical quantity that the source prescribes."""
        return self.domain.get_quantity(self.side)

    @property
    def unit(self) -> str:
        """SI unit of the quantity that the source prescribes."""
        return self.quantity.unit

    @property
    def netlist_factor(self) -> float:
        """Volts or amperes in the netlist that represent one SI unit of the source."""
        return self.quantity.pin_value_per_si_unit

    @property
    def letter(self) -> str:
        """First letter of the source's name in the netlist: V or I."""
        return "V" if self.side == "across" else "I"

    @property
    def value_unit(self) -> str:
        """Unit of the value in the netlist card; empty for the default unit of the card."""
        return self.domain.find_value_unit(self.letter)

    @property
    def prescribed_symbol(self) -> str:
        """Symbol of the prescribed quantity in result names."""
        return self.quantity.symbol


SOURCE_TYPES = {name: SourceKind(*place) for name, place in QUANTITIES.items()}
# Kinds of sources whose steps an inductance or a mass smooths.
# All other kinds of sources prescribe motions or flows, whose steps are not smoothed.
SMOOTHED_KINDS = ("voltage", "force")
WAVEFORM_KEYS = ("dc", "pulse", "sine", "pwl", "file")
MAX_ROWS = 100_000  # largest number of rows of a waveform file
# Time points per period of a sine.
# With 125 points, linear interpolation has an error of 4e-4 of the amplitude.
POINTS_PER_PERIOD = 125
# Time points per period of a pulse train. A half-bridge that drives a series resonance needs 137
# points per period because of its edges, and 141 points with this limit.
POINTS_PER_PULSE_PERIOD = 50
# Highest relevant frequency of an edge, multiplied by the duration of the edge.
# A pulse with edges of 1/200 of its width has 1e-4 of its energy above the highest relevant
# frequency.
EDGE_FACTOR = 0.5
# Highest resolved frequency, divided by the frequency of a sine that is switched on.
# When the resolved band ended at 3 times the frequency of the sine, a mode above the band had an
# error of 1.3 %.
RESOLVED_HARMONICS = 8.0
# Largest deviation of a simulated source from its definition, divided by its range of values.
MAX_DEVIATION = 1e-3


class SourceKeys(Section):
    """Keys of an independent source.

    One of the keys ``dc``, ``pulse``, ``sine``, ``pwl`` and ``file`` defines the waveform. Numbers
    without a unit have the SI unit of the quantity that ``kind`` selects.
    """

    kind: Literal[tuple(SOURCE_TYPES)] = Field(  # type: ignore[valid-type]
        "voltage", description="Quantity that the source prescribes, such as a voltage or a force"
    )
    dc: float | str | None = Field(
        None, description="Constant value of the source, in the unit of the source"
    )
    pulse: PulseKeys | None = None
    sine: SineKeys | None = None
    pwl: tuple[tuple[float | str, float | str], ...] | None = Field(
        None,
        description=("Waveform of the source as points [time, value], connected by straight lines"),
    )
    file: str | None = Field(
        None,
        description=(
            "CSV file in the scene's folder with the waveform of the source in the columns "
            "time and value"
        ),
    )
    ac: float | str = Field(
        0.0, description="Amplitude of the source in ac analyses, in the unit of the source"
    )
    _waveform: Waveform = PrivateAttr()
    _amplitude: float = PrivateAttr()

    @field_validator("pwl", mode="before")
    @classmethod
    def _require_corners(cls, rows: object) -> object:
        """Require that ``pwl`` is a list of waveform points, each a time and a value."""
        expected = "a list of points, [[TIME, VALUE], [TIME, VALUE], …]"
        hint = 'write for example  pwl = [[0, 0], ["1 ms", 1]]'
        if rows is None:
            return rows
        if not isinstance(rows, (list, tuple)):
            raise make_invalid_value_error("the points are not a list", expected, hint=hint)
        plain = [row for row in rows if not isinstance(row, (list, tuple))]
        if plain and len(plain) == len(rows):
            if len(rows) % 2 == 0:
                pairs = list(zip(rows[::2], rows[1::2], strict=True))
                hint = f"write  pwl = {clip_text(format_toml(pairs))}"
            raise make_invalid_value_error(
                "the points are not pairs of time and value", expected, hint=hint
            )
        for row in rows:
            if isinstance(row, (list, tuple)) and len(row) > 2:
                short = format_toml([row[:2]])[1:-1]
                hint = f"write  {short}  in place of  {format_toml([row])[1:-1]}"
                problem = f"a point has {len(row)} entries"
                raise make_invalid_value_error(problem, expected, hint=hint)
        return rows

    @model_validator(mode="after")
    def _read_waveform_and_amplitude(self, info: ValidationInfo) -> SourceKeys:
        """Read the waveform and the amplitude; reject a source with two waveform keys."""
        shapes = self._stated_waveform_keys
        if len(shapes) > 1:
            hint = f"delete the key `{shapes[0]}` or the key `{shapes[1]}`"
            if set(shapes) == {"dc", "sine"}:
                hint = f"delete the key `dc`, or {SineKeys.unsupported_key_hints['offset']}"
            raise make_invalid_value_error(
                "the source has two waveforms: " + " and ".join(shapes), "one of them", hint=hint
            )
        try:
            self._waveform = self._read_waveform((info.context or {}).get("home", Path()))
            self._amplitude = convert_quantity(self.ac, self.unit, where="ac")
        except UsageError as error:
            expected = error.expected or "numbers with units"
            raise make_invalid_value_error(
                error.message,
                expected,
                error.where,
                self._suggest_kind(error.where) or error.next_action,
            ) from None
        return self

    def _suggest_kind(self, where: str | None) -> SetKey | None:
        """Suggest the kind whose unit is the unit of a rejected value, or None.

        ``where`` is the dotted key of the value. A stated kind is not changed.
        """
        value: object = self
        for step in (where or "").split("."):
            if isinstance(value, tuple) and step.isdecimal():
                value = value[int(step)]
            else:
                value = getattr(value, step, None)
        if "kind" in self.model_fields_set or not isinstance(value, str):
            return None
        for kind, form in SOURCE_TYPES.items():
            with suppress(UsageError):
                convert_quantity(value, form.unit)
                return SetKey("", "kind", f'"{kind}"', verb="add", place="")
        return None

    @property
    def waveform_key(self) -> str:
        """Name of the key that defines the source's waveform; by default ``dc``."""
        return next(iter(self._stated_waveform_keys), "dc")

    @property
    def has_only_amplitude(self) -> bool:
        """Whether the source has the key ``ac``, but no waveform key."""
        return bool(self.amplitude) and not self._stated_waveform_keys

    @property
    def _stated_waveform_keys(self) -> list[str]:
        """Names of the waveform keys that the source states."""
        return [name for name in WAVEFORM_KEYS if getattr(self, name) is not None]

    @property
    def unit(self) -> str:
        """SI unit of the values of the source."""
        return SOURCE_TYPES[self.kind].unit

    @property
    def waveform(self) -> Waveform:
        """Waveform of the source versus time, in SI units."""
        return self._waveform

    @property
    def amplitude(self) -> float:
        """Amplitude of the source in an ac analysis, in SI units."""
        return self._amplitude

    def _read_waveform(self, home: Path) -> Waveform:
        """Return the waveform versus time in SI units.

        The key ``file`` is a path in the folder ``home``.

        Raises
        ------
        UsageError : a value has the wrong unit, times do not increase, or the file cannot be read.
        """
        unit = self.unit
        if self.pulse is not None:
            p = self.pulse
            low = convert_quantity(p.low, unit, where="pulse.low")
            high = convert_quantity(p.high, unit, where="pulse.high")
            if p.width < p.edge or p.edge <= 0:
                raise UsageError(
                    "the edge time of the pulse is longer than the pulse width",
                    where="pulse",
                    expected=f"an edge time above zero and at most the pulse width, {p.width:g} s",
                    hint=ChangeKey("lower", "pulse.edge", "to", f"{p.width / 10:g} s")
                    if p.width > 0
                    else None,
                )
            if p.period is not None and p.period < p.width + p.edge:
                raise UsageError(
                    "successive pulses overlap",
                    where="pulse",
                    expected=f"a period of at least width + edge, {p.width + p.edge:g} s",
                    hint=ChangeKey("raise", "pulse.period", "to", f"{p.width + p.edge:g} s"),
                )
            return waves_.make_pulse_waveform(
                low, high, p.start, p.width, p.edge, p.period, p.count
            )
        if self.sine is not None:
            s = self.sine
            return waves_.make_sine_waveform(
                convert_quantity(s.amplitude, unit, where="sine.amplitude"), s.frequency, s.start
            )
        if self.pwl is not None:
            points = []
            for k, (t, v) in enumerate(self.pwl):
                time = convert_quantity(t, "s", where=f"pwl.{k}.0")
                points.append([time, convert_quantity(v, unit, where=f"pwl.{k}.1")])
            return _make_waveform(np.array(points), "pwl")
        if self.file is not None:
            return _make_waveform(_read_table(home, self.file), self.file)
        return waves_.make_constant_waveform(
            convert_quantity(0.0 if self.dc is None else self.dc, unit, where="dc")
        )


def _warn_of_constant_waveform(part: Part[SourceKeys]) -> None:
    """Warn about a pulse, a sine or a list of points that is constant versus time."""
    keys = part.keys
    if keys.waveform_key == "dc" or keys.waveform.find_first_change() is not None:
        return
    level = format_quantity(float(keys.waveform(0.0)), keys.unit)
    problem, action = {
        "pulse": (
            f"`pulse.low` and `pulse.high` are both {level}",
            "set `pulse.low` and `pulse.high` to different values",
        ),
        "sine": ("`sine.amplitude` is 0", f'write for example  sine.amplitude = "1 {keys.unit}"'),
        "pwl": (f"all points of `pwl` have the value {level}", "change the value of a point"),
        "file": (f"all rows of `{keys.file}` have the value {level}", "change the value of a row"),
    }[keys.waveform_key]
    warn_user(f"{part.name}: {problem}, so this source is constant: {action}")


class Source(PartType[SourceKeys]):
    """Part type ``source``: independent source of a voltage, force or other quantity."""

    name = "source"
    title = "independent source: voltage, current, force, displacement or acceleration"
    schema = SourceKeys
    source = "ideal source"

    def pins(self, part: Part[SourceKeys], scene: JoinedScene) -> tuple[Terminal, ...]:
        """Return the pins of the part in the order of its subcircuit."""
        pins = SOURCE_TYPES[part.keys.kind].domain.units
        return (
            Terminal("out", *pins, required=True, kind_key="kind"),
            Terminal("ret", *pins, "gnd", kind_key="kind"),
        )

    def problems(self, part: Part[SourceKeys], scene: GovernedScene) -> Iterator[UsageError]:
        """Yield key errors; warn about a constant waveform and an unused ``ac`` amplitude.

        The default analysis is a transient, in which the key ``ac`` has no effect.
        """
        yield from super().problems(part, scene)
        _warn_of_constant_waveform(part)
        if part.keys.has_only_amplitude and "analysis" not in scene.frame.model_fields_set:
            warn_user(
                f"{part.name}: the key `ac` has no effect, because the scene has no [analysis] and "
                'a transient is the default: add  [analysis]  and below it  type = "ac"  and  '
                'stop = "100 kHz"'
            )

    def numerics(
        self, part: Part[SourceKeys], scene: WiredScene
    ) -> Iterator[NumericalRequirements]:
        """Yield numerical requirements: time steps that resolve edges and periods."""
        yield from list_waveform_numerics(part.name, part.keys.waveform)
        pulse = part.keys.pulse
        if pulse is not None and pulse.period:
            what = f"1/{POINTS_PER_PULSE_PERIOD} of a period of {part.name}, a pulse train"
            endless_period = pulse.period if pulse.count is None else 0.0
            yield NumericalRequirements(
                what, pulse.period / POINTS_PER_PULSE_PERIOD, period=endless_period
            )

    def voltage(self, part: Part[SourceKeys], scene: DeclaredScene) -> Waveform | None:
        """Return the prescribed voltage [V] versus time; None for other quantities."""
        return part.keys.waveform if part.keys.kind == "voltage" else None

    def has_ac_source(self, part: Part[SourceKeys], scene: DeclaredScene) -> bool:
        """Return whether the source is an ac source: whether its ``amplitude`` is not 0."""
        return part.keys.amplitude != 0

    def make_frequency_estimator(
        self, part: Part[SourceKeys], scene: DeclaredScene
    ) -> HighestFrequency:
        """Return a function that computes the highest relevant frequency [Hz]."""
        share = 1.0 if part.keys.kind in SMOOTHED_KINDS else 0.0
        return partial(_find_highest_filtered_frequency, part.keys.waveform, scene.stop_time, share)

    def equilibrium_conditions(
        self, part: Part[SourceKeys], scene: WiredScene
    ) -> EquilibriumConditions:
        """Return the equilibrium conditions: a constraint or a constant load at t = 0.

        A source of an across quantity prescribes the difference of this quantity between its pins.
        A source of a through quantity loads its pins with a constant flow.
        """
        pair = (("out", "ret"),)
        if SOURCE_TYPES[part.keys.kind].letter == "V":
            wave = part.keys.waveform
            moves = wave.amplitude or np.ptp(np.array(wave.points)[:, 1])
            # A sine that starts later also has a jump of its derivative.
            kinked = part.keys.kind == "displacement" and moves
            return EquilibriumConditions(
                pair, pair, jump_key=part.keys.waveform_key if kinked else ""
            )
        constant = part.keys.waveform(np.zeros(1))[0]
        return EquilibriumConditions(loaded_pins=("out", "ret") if constant else ())

    def cards(self, part: Part[SourceKeys], build: BuiltScene) -> tuple[Item, ...]:
        """Return the cards of the part at the top level of the deck."""
        kind = SOURCE_TYPES[part.keys.kind]
        ends = [build.get_net(part, "out"), build.get_net(part, "ret")]
        if kind.letter == "I":  # the source pushes current out of "out" and back into "ret"
            ends.reverse()
        if _sweeps_back(part, build.scene):
            swept = _write_sweep_cards(part, build, kind, ends)
            return tuple(card.with_unit(kind.value_unit) for card in swept)
        wave = part.keys.waveform.format_spice(kind.netlist_factor)
        size = kind.netlist_factor * part.keys.amplitude
        ac = ("AC", format_number(size)) if size else ()
        card = Element.from_words(f"{kind.letter}{part.name}", *ends, *split_words(wave), *ac)
        return (card.with_unit(kind.value_unit),)

    def list_inner_names(
        self, part: Part[SourceKeys], scene: WiredScene
    ) -> Iterator[tuple[str, ...]]:
        """Yield the names of the inner nodes that a dc sweep up and back down requires."""
        if _sweeps_back(part, scene):
            yield part.name, "swept"
            yield part.name, "folded"

    def settable_quantities(
        self, part: Part[SourceKeys], build: BuiltScene
    ) -> Mapping[str, SweptSource]:
        """Return the settable quantity ``dc``: the netlist source that a dc sweep varies."""
        kind = SOURCE_TYPES[part.keys.kind]
        if _sweeps_back(part, build.scene):
            return {
                "dc": SweptSource(
                    f"V{build.get_inner_name(part, part.name, 'swept')}", kind.netlist_factor
                )
            }
        return {"dc": SweptSource(f"{kind.letter}{part.name}", kind.netlist_factor)}

    def vectors(self, part: Part[SourceKeys], build: BuiltScene) -> Mapping[str, PartResult]:
        """Return the ngspice vectors: expressions of the part's results, keyed by name."""
        n, kind, result = part.name, SOURCE_TYPES[part.keys.kind], {}
        flow = kind.domain.through_variable
        name, factor, unit = f"{n}.{flow.symbol}", flow.factor, flow.unit
        if kind.letter == "V":
            result[name] = PartResult(f"i(v{n.lower()})", -factor, unit, ("out",), ("ret",))
        elif build.scene.analysis.type == "transient":
            pushed = (("out",), ("ret",)) if kind.domain.input_side == "through" else ()
            result[name] = PartResult(f"@i{n.lower()}[current]", factor, unit, *pushed)
        out, ret = build.get_net(part, "out"), build.get_net(part, "ret")
        if out != ret and (kind.letter == "V" or ret == "0"):
            across = kind.domain.across
            ends = format_voltage(out, ret)
            result[f"{n}.{across.symbol}"] = PartResult(ends, across.factor, across.unit)
        return result

    def checks(
        self, part: Part[SourceKeys], build: BuiltScene, waves: Waveforms
    ) -> Iterator[Check]:
        """Yield the check that the simulated source matches its definition.

        The simulated values and the defined values are compared at all time points.
        """
        result = waves.data.get(f"{part.name}.{SOURCE_TYPES[part.keys.kind].prescribed_symbol}")
        if result is None or "time" not in waves:
            return
        wave = part.keys.waveform
        expected = wave(waves["time"])
        swing = float(np.ptp(expected)) or float(np.abs(expected).max()) or 1.0
        off, name = float(np.abs(result - expected).max()) / swing, f"{part.name} drives as defined"
        advice = "report this error: the source in the netlist differs from the scene"
        label = f"waveform error of {part.name}"
        yield Check(name, off, MAX_DEVIATION, "of its swing", advice, wiring=True, label=label)

    def law(self, part: Part[SourceKeys], build: BuiltScene) -> laws.Equations:
        """Return the part's law: its model equations, solved by kc2spice without ngspice."""
        n, keys = part.name, part.keys
        wave, size = keys.waveform, complex(keys.amplitude)
        unloaded = keys.kind == "voltage" and _drives_only_signals(part, build)
        law = laws.IdealSource(n, "signal" if unloaded else keys.kind, wave, size)
        signal = law.sets_signal
        pins = (("out", f"{n}.out"),) if signal else (("out", f"{n}.out"), ("ret", f"{n}.ret"))
        domain = SOURCE_TYPES[keys.kind].domain
        across, through = (f"{n}.{item.symbol}" for item, _ in domain.quantities)
        results = {across: laws.scale_wave(f"{n}.out")}
        if not signal:
            results = {across: laws.subtract_waves(f"{n}.out", f"{n}.ret")}
            results[through] = laws.scale_wave(f"{n}.out.through", -1.0)
        return laws.Equations((law,), pins, results, {"dc": (n, 1.0)})

    def notes(self, part: Part[SourceKeys], scene: Scene) -> Iterator[str]:
        """Yield the assumptions of the model and the effects that it neglects."""
        yield _describe_waveform(part, scene)


def _describe_waveform(part: Part[SourceKeys], scene: Scene) -> str:
    """Describe quantity, amplitude and timing of a source in the analysis of the scene."""
    keys, selected = part.keys, scene.analysis
    name, show = keys.kind.replace("_", " "), partial(format_quantity, unit=keys.unit)
    if selected.is_small_signal:
        bias = float(keys.waveform(0.0))
        texts = [f"ac {show(keys.amplitude)}"] if keys.amplitude else []
        if bias or not texts:
            texts.append(f"dc {show(bias)}")
        return ", ".join((name, *texts))
    if selected.sweep == f"{part.name}.dc":
        ends = (show(convert_quantity(end, keys.unit)) for end in (selected.from_, selected.to))
        return f"{name}, swept from {' to '.join(ends)}"
    wave = keys.waveform
    if keys.sine is not None:
        text = f"{name} sine, amplitude {show(wave.amplitude)}, "
        text += format_quantity(wave.frequency, "Hz")
        return text + _describe_start(keys.sine.start)
    if keys.pulse is not None:
        pulse, time = keys.pulse, partial(format_quantity, unit="s")
        low, high = (convert_quantity(end, keys.unit) for end in (pulse.low, pulse.high))
        text = f"{name} pulse, {show(low)} to {show(high)}, width {time(pulse.width)}, "
        text += f"edges {time(pulse.edge)}"
        if pulse.period is not None:
            text += f", period {time(pulse.period)}"
        if pulse.count is not None:
            text += f", {pulse.count} pulses"
        return text + _describe_start(pulse.start)
    times, values = zip(*wave.points, strict=True)
    if len(times) == 1:
        return f"{name}, constant {show(values[0])}"
    span = f"{show(min(values))} to {show(max(values))}"
    return f"{name}, {len(times)} points, {span}, until {format_quantity(times[-1], 's')}"


def _describe_start(start: float) -> str:
    """Describe the time at which a waveform starts; "" if it starts at t = 0."""
    return f", from t = {format_quantity(start, 's')}" if start else ""


def _find_highest_filtered_frequency(
    wave: Waveform, stop: float, share: float, constant: float
) -> float:
    """Return the highest relevant frequency [Hz] of a low-pass filtered waveform.

    The waveform is filtered by a first-order low-pass filter. The time constant of the low-pass
    filter is ``share * constant`` [s]. If ``share`` is 0, the waveform is not filtered.
    """
    return find_waveform_frequency(wave, stop, share * constant)


def _sweeps_back(part: Part[SourceKeys], scene: DeclaredScene) -> bool:
    """Return whether a dc sweep of this source goes to its end value and back."""
    selected = scene.analysis
    moved = selected.type == "dc" and selected.sweep == f"{part.name}.dc"
    return moved and bool(selected.back)


def _write_sweep_cards(
    part: Part[SourceKeys], build: BuiltScene, kind: SourceKind, ends: list[str]
) -> Iterator[Element]:
    """Yield the netlist cards of a source for a dc sweep up and back down.

    The simulator sweeps an auxiliary voltage from the first value to beyond ``to``. Beyond ``to``,
    the value of the source is ``2 * to`` minus the auxiliary voltage. For the simulator, the dc
    sweep to the end value and back is a single sweep of the auxiliary voltage. Each point starts
    from the solution of the previous point.
    """
    selected = build.scene.analysis
    first = kind.netlist_factor * convert_quantity(selected.from_, kind.unit)
    last = kind.netlist_factor * convert_quantity(selected.to, kind.unit)
    swept = build.get_inner_name(part, part.name, "swept")
    folded = build.get_inner_name(part, part.name, "folded")
    end = format_number(last)
    value = f"{end}{'-' if first < last else '+'}abs(V({swept})-({end}))"
    yield Element.from_words(f"V{swept}", swept, "0", first)
    if kind.letter == "I":
        yield Element.behavioural_source(f"BI{part.name}", ends[0], ends[1], "I", value)
    else:
        yield Element.behavioural_source(f"B{folded}", folded, ends[1], "V", value)
        yield Element.from_words(f"V{part.name}", ends[0], folded, "0")


def list_waveform_numerics(name: str, wave: Waveform) -> Iterator[NumericalRequirements]:
    """Yield the longest permitted time step and the highest frequency of a waveform.

    The frequency of a sine, or the edges of a pulse, determine both the time step and the highest
    frequency.
    """
    if not wave.is_piecewise_linear:
        f = wave.frequency
        what = f"1/{POINTS_PER_PERIOD} of a period of {name}, a sine at {f:g} Hz"
        yield NumericalRequirements(
            what, 1 / (POINTS_PER_PERIOD * f), RESOLVED_HARMONICS * f, period=1 / f
        )
    else:
        times, values = np.array(wave.points).T
        moving = np.diff(times)[np.diff(values) != 0]
        if moving.size:
            yield NumericalRequirements(
                f"edges of {name}, {moving.min():g} s", highest_frequency=EDGE_FACTOR / moving.min()
            )


def _drives_only_signals(part: Part[SourceKeys], build: BuiltScene) -> bool:
    """Return whether all pins at the source are signal inputs, which draw no current."""
    scene = build.scene
    flows = {scene.terminals[end].flow for end in scene.list_joined_pins(part.name, "out")}
    return flows == {"-"} and build.get_net(part, "ret") == "0"


def _make_waveform(points: np.ndarray, data_name: str) -> Waveform:
    """Return the piecewise linear waveform through ``points``.

    The times of the points must increase.
    """
    key = "pwl" if data_name == "pwl" else "file"
    if len(points) < 2:
        point = f'["{points[0, 0] + 1e-3:g} s", {points[0, 1]:g}]' if len(points) else ""
        hint = "add at least two rows" if not point else f"add a second point, such as  {point}"
        row_count = f"{len(points)} row{'' if len(points) == 1 else 's'}"
        raise UsageError(
            f"{data_name} has {row_count}",
            where=key,
            expected="at least two rows of time and value",
            hint=hint,
        )
    late = np.flatnonzero(np.diff(points[:, 0]) <= 0)
    if late.size:
        first = int(late[0])
        raise UsageError(
            f"the times of {data_name} do not increase from row {first + 1} to row {first + 2}",
            where=key,
            expected="times that increase from row to row",
            hint="sort the rows by time, and delete rows with equal times",
        )
    return waves_.make_linear_waveform(points)


def _read_table(home: Path, name: str) -> np.ndarray:
    """Read the rows ``time, value`` of a CSV file in the folder of the scene."""
    path = locate_file_in_folder(home, name, "file")
    try:
        data = read_bounded(path, 40 * MAX_ROWS)
        rows = np.genfromtxt(io.BytesIO(data), delimiter=",", comments="#", ndmin=2)
    except FileNotFoundError:
        raise UsageError(
            "this file does not exist",
            where="file",
            expected="a CSV file in the scene's folder, with the columns time [s] and value",
            hint=f"copy the file to {path}",
        ) from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise UsageError(
            f"this file cannot be read: {reason}",
            where="file",
            expected="rows of two numbers: time [s], value",
            hint="write two numbers, separated by a comma, in each line",
        ) from None
    if rows.shape[1:] == (2,) and np.isnan(rows[0]).any():  # the first line is a header line
        rows = rows[1:]
    if rows.ndim != 2 or rows.shape[1] != 2 or not np.isfinite(rows).all():
        hint = "separate the numbers by a comma, and use a point as the decimal separator"
        if rows.ndim == 2 and rows.shape[1] > 2:
            hint = "delete all columns except time and value"
        elif b"RIFF" in data[:4] or b"\0" in data[:100]:
            hint = "export the waveform as a CSV file, with one line  TIME,VALUE  for each point"
        raise UsageError(
            "this file is not a table of two columns",
            where="file",
            expected="rows of two numbers: time [s], value",
            hint=hint,
        )
    return rows


register_part_type(Source())
