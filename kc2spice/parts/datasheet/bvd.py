"""The part ``bvd``: piezoelectric resonator from its data sheet.

The data sheet states resonances, capacitance, coupling and losses.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import Annotated

import numpy as np
from pydantic import BeforeValidator, Field

from kc2spice.core.errors import UsageError
from kc2spice.core.quantities import (
    Capacitance,
    Frequency,
    Inductance,
    Ratio,
    Resistance,
    make_invalid_value_error,
)
from kc2spice.netlist.circuit import Param, make_positive_parameter
from kc2spice.netlist.number_and_name_spelling import round_to_digits
from kc2spice.parts.datasheet._resonator import (
    TWO_PI,
    RatedKeys,
    Resonator,
    ResonatorNetlist,
    ResonatorPart,
    list_mode_suffixes,
    make_unknowns_relation,
    write_tolerance_note,
)
from kc2spice.parts.datasheet._stated_values import Relation, StatedValues
from kc2spice.scene.parttype import register_part_type
from kc2spice.scene.scene_classes import GovernedScene, Part

MAX_MODES = 8
CAPACITANCE_FREQUENCY = 1e3  # Hz, at which data sheets usually state capacitances
FREQUENCY_ROUNDING = 5e-4  # largest relative rounding error of a frequency with four digits
# Effective coupling coefficient of a disc of brass and ceramic: the mean of the finite-element
# scenes buzzer_7bb_…, rounded to two digits.
USUAL_COUPLING = 0.36
COUPLING_ADVICE = (
    f"add keff; if the data sheet does not state keff, assume  keff = {USUAL_COUPLING}: buzzer "
    "discs have 0.33 to 0.39"
)
# Start values of the fit: ratio of motional to clamped capacitance, and Q factor.
# These start values belong to a ceramic with a coupling coefficient of 0.22.
START_RATIO = 0.05
START_QUALITY = 100.0
# smallest ratio of motional to clamped capacitance, below the ratio of any crystal
SMALLEST_RATIO = 1e-9
# Start values of the fit for frequencies [Hz] and capacitances [F] that are not stated.
START_FREQUENCY = 1e4
START_CAPACITANCE = 1e-9


def _convert_to_sequence(value: object) -> object:
    """Return a single value as a tuple; return a list unchanged."""
    if isinstance(value, (list, tuple)):
        if value == []:  # the user wrote []; the default of a missing key is an empty tuple
            raise make_invalid_value_error(
                "the list is empty",
                "a value, or a list with one value for each mode",
                hint="write the value of the lowest mode",
            )
        return value
    return (value,)


Modes = BeforeValidator(_convert_to_sequence)


class BvdKeys(RatedKeys):
    """Data-sheet values that determine a resonator; redundant values must agree.

    For a resonator with several modes, each value is a list with one entry for each mode.
    """

    fs: Annotated[tuple[Annotated[Frequency, Field(gt=0)], ...], Modes] = Field(
        (),
        description=(
            "Series resonance frequency of each mode, at which the reactance of the motional "
            "branch is zero"
        ),
    )
    fp: Annotated[tuple[Annotated[Frequency, Field(gt=0)], ...], Modes] = Field(
        (),
        description=(
            "Parallel resonance frequency (antiresonance) of each mode, for the circuit "
            "without losses"
        ),
    )
    keff: Annotated[tuple[Annotated[Ratio, Field(gt=0, lt=1)], ...], Modes] = Field(
        (), description="Effective coupling factor of each mode, sqrt(1 - (fs/fp)^2)"
    )
    cm: Annotated[tuple[Annotated[Capacitance, Field(gt=0)], ...], Modes] = Field(
        (), description="Motional capacitance of each mode, also called C1"
    )
    lm: Annotated[tuple[Annotated[Inductance, Field(gt=0)], ...], Modes] = Field(
        (), description="Motional inductance of each mode, also called L1"
    )
    rm: Annotated[tuple[Annotated[Resistance, Field(gt=0)], ...], Modes] = Field(
        (), description="Motional resistance of each mode, also called R1"
    )
    qm: Annotated[tuple[Annotated[Ratio, Field(gt=0)], ...], Modes] = Field(
        (), description="Mechanical Q factor of each mode, 1/(2 pi fs rm cm)"
    )
    zs: Annotated[tuple[Annotated[Resistance, Field(gt=0)], ...], Modes] = Field(
        (),
        description="Magnitude of the resonator's impedance at the series resonance of each mode",
    )
    c0: Capacitance | None = Field(
        None,
        gt=0,
        description=(
            "Clamped capacitance of the resonator, in parallel with the motional branches"
        ),
    )
    c_low: Capacitance | None = Field(
        None,
        gt=0,
        description=(
            "Capacitance of the resonator at the frequency `c_low_at`, below all resonances"
        ),
    )
    c_low_at: Frequency = Field(
        CAPACITANCE_FREQUENCY,
        ge=0,
        lt=1e12,
        description="Frequency at which the capacitance `c_low` was measured",
    )
    tolerance: dict[str, Annotated[Ratio, Field(gt=0, lt=1)]] = Field(
        {},
        description=(
            "Relative tolerances of data-sheet values, each under the key of its value: for "
            "example, tolerance = { c_low = '30 %' } is the tolerance of the key `c_low`"
        ),
    )


# Functions that compute the data-sheet values of a mode, by key.
MODE_VALUES: Mapping[str, Callable[..., float]] = {
    "fs": lambda circuit, mode: circuit.fs[mode],
    "fp": lambda circuit, mode: circuit.fp[mode],
    "keff": lambda circuit, mode: circuit.compute_coupling(mode),
    "cm": lambda circuit, mode: circuit.cm[mode],
    "lm": lambda circuit, mode: circuit.lm[mode],
    "rm": lambda circuit, mode: circuit.rm[mode],
    "qm": lambda circuit, mode: circuit.compute_q_factor(mode),
    "zs": lambda circuit, mode: 1 / abs(circuit.admittance(np.array(circuit.fs[mode]))),
}
VALUE_UNITS_OF_SHEET = {
    "fs": "Hz", "fp": "Hz", "keff": "", "cm": "F", "lm": "H", "rm": "Ohm", "qm": "", "zs": "Ohm",
    "c0": "F", "c_low": "F",
}  # fmt: skip
VALUE_NAMES = {
    "fs": "series resonance",
    "fp": "parallel resonance",
    "keff": "effective coupling coefficient",
    "cm": "motional capacitance",
    "rm": "motional resistance",
    "qm": "mechanical Q factor",
    "zs": "impedance at the series resonance",
    "c0": "clamped capacitance",
}
_REACTIVE_SHARE = f"{TWO_PI!r}*fs*c0*zs"  # impedance zs relative to the reactance of c0, at fs


class Bvd(ResonatorPart[BvdKeys]):
    """Part type ``bvd``: resonator from its data sheet (Butterworth-Van Dyke model)."""

    name = "bvd"
    title = "resonator from its data sheet (Butterworth-Van Dyke)"
    schema = BvdKeys
    example = """
[bvd]
part = "bvd"
fs = "6.3 kHz"
keff = 0.22
c_low = "10 nF"
zs = "200 Ohm"
tolerance = { c_low = "30 %" }
pins = { anode = "drive.out" }

[drive]
part = "source"
ac = "1 V"

[analysis]
type = "ac"
start = "1 kHz"
stop = "10 kHz"
"""

    def problems(self, part: Part[BvdKeys], scene: GovernedScene) -> Iterator[UsageError]:
        """Yield an error if ``c_low_at`` is not below the lowest resonance frequency."""
        circuit = self.circuit(part, scene)
        if part.keys.c_low is not None and part.keys.c_low_at >= min(circuit.fs):
            yield part.wrong(
                "c_low_at",
                "the frequency of the low-frequency capacitance is above the lowest resonance",
                got=f"{part.keys.c_low_at:g} Hz, the resonance is at {min(circuit.fs):.5g} Hz",
                expected="a frequency below the lowest series resonance",
                hint="set c_low_at to the frequency of the capacitance in the data sheet",
            )

    def resonator(self, part: Part[BvdKeys]) -> Resonator:
        """Return the circuit elements of the resonator, computed from its data sheet."""
        keys, modes = part.keys, self._count_modes(part)
        stated: dict[str, float] = {}
        for name in MODE_VALUES:
            labels = _list_mode_labels(name, modes)
            stated |= dict(zip(labels, getattr(keys, name), strict=False))
        stated |= {name: v for name in ("c0", "c_low") if (v := getattr(keys, name)) is not None}
        self._require_tolerance_values(part)
        start = _choose_initial_unknowns(keys, modes)
        for problem in _find_impossible_pairs(part, start):
            raise problem
        tolerance = {label: keys.tolerance.get(label.partition("[")[0]) for label in stated}
        values = StatedValues(
            part.name,
            stated,
            _list_relations(modes, keys.c_low_at),
            start,
            VALUE_UNITS_OF_SHEET,
            {label: value for label, value in tolerance.items() if value is not None},
            {label: FREQUENCY_ROUNDING for label in stated if label[:2] in ("fs", "fp")},
            part.overridden_keys,
            {"keff": COUPLING_ADVICE},
        )
        return Resonator.from_unknowns(values.solve())

    def _count_modes(self, part: Part[BvdKeys]) -> int:
        """Return the number of modes; raise an error if key lists differ in length."""
        counts = {name: len(v) for name in MODE_VALUES if (v := getattr(part.keys, name))}
        most = max(counts.values(), default=1)
        short = [name for name, count in counts.items() if count < most]
        if short or most > MAX_MODES:
            name = min(counts, key=lambda key: counts[key]) if short else max(counts)
            raise part.wrong(
                name,
                "the lists of modes differ in length"
                if short
                else "the resonator has too many modes",
                got="numbers of values: "
                + ", ".join(f"{count} in {key}" for key, count in counts.items()),
                expected=f"one value for each of {most} modes in each list"
                if short
                else f"at most {MAX_MODES} modes",
                hint=f"state {most} values in {' and in '.join(short)}"
                if short
                else f"state at most {MAX_MODES} values in each list",
            )
        return most

    def _require_tolerance_values(self, part: Part[BvdKeys]) -> None:
        """Require a stated value for each tolerance; reject a tolerance without a value."""
        for name in part.keys.tolerance:
            if not (name in VALUE_UNITS_OF_SHEET and getattr(part.keys, name)):
                values = [key for key in VALUE_UNITS_OF_SHEET if getattr(part.keys, key)]
                raise part.wrong(
                    f"tolerance.{name}",
                    f"the part states a tolerance of {name}, but no value of {name}",
                    got=name,
                    expected=f"one of {', '.join(values)}",
                    hint=f"state {name}, or delete its tolerance"
                    if name in VALUE_UNITS_OF_SHEET
                    else None,
                )

    def make_resonator_netlist(self, part: Part[BvdKeys], circuit: Resonator) -> ResonatorNetlist:
        """Return the netlist parameters, and the equations of the circuit elements."""
        keys, modes = part.keys, len(circuit.fs)
        ends, params, constants = list_mode_suffixes(modes), list[Param](), dict[str, str]()
        conditions: dict[str, str] = {}
        level = "c0" if keys.c_low is None else "c_low"
        total, fixed = ["1"], []
        for n, end in enumerate(ends):
            ratio, loss = _choose_capacitance_key(keys, modes), _choose_loss_key(keys, modes)
            for key in ("fs", ratio, loss):
                params.append(_make_mode_parameter(keys, circuit, key, n, end))
            slow = f"/(1-{keys.c_low_at**2!r}/(fs{end}*fs{end}))"
            if ratio == "fp":
                conditions["fp_must_be_above_fs"] = "ln(fp-fs)"
            if ratio == "cm":
                fixed.append(f"-cm{end}{slow}")
                continue
            square = f"keff{end}*keff{end}" if ratio == "keff" else "(1-fs*fs/(fp*fp))"
            constants[f"ratio{end}"] = f"{square}/(1-{square})"
            total.append(f"ratio{end}{slow}")
        value = round_to_digits(
            circuit.c0 if level == "c0" else circuit.compute_capacitance(keys.c_low_at)
        )
        params.append(
            make_positive_parameter(level, value, "F", _describe_parameter(keys, level, value))
        )
        if level == "c_low":
            constants["c0"] = f"(c_low{''.join(fixed)})/({'+'.join(total)})"
            if ratio == "cm":
                conditions["c_low_must_be_above_the_sum_of_cm"] = "ln(c0)"
        for end in ends:
            constants |= _write_element_equations(end, ratio, loss)
        if loss == "zs":
            conditions["zs_must_be_below_the_reactance_of_c0"] = f"ln(1-{_REACTIVE_SHARE})"
        return ResonatorNetlist(tuple(params), constants, tuple(ends), conditions)


def _find_impossible_pairs(part: Part[BvdKeys], start: np.ndarray) -> Iterator[UsageError]:
    """Yield an error for each pair of stated values that no resonator can have."""
    keys = part.keys
    for fs, fp in zip(keys.fs, keys.fp, strict=False):
        if fs >= fp:
            yield part.wrong(
                "fp",
                "the parallel resonance is not above the series resonance",
                got=f"fs = {fs:g} Hz and fp = {fp:g} Hz",
                expected="fp above fs",
                hint=(
                    "exchange the values of `fs` and `fp`"
                    if fs > fp
                    else "take `fs` at the minimum and `fp` at the maximum of the impedance"
                ),
            )
    if keys.c0 and keys.c_low and keys.c0 >= keys.c_low:
        yield part.wrong(
            "c_low",
            "the low-frequency capacitance is not greater than the clamped capacitance",
            got=f"c0 = {keys.c0:g} F and c_low = {keys.c_low:g} F",
            expected="c_low above c0",
            hint="exchange the values of `c0` and `c_low`, or delete the key `c0`",
        )
    if len(keys.zs) == 1:
        zs, reactance = keys.zs[0], 1 / (TWO_PI * start[1] * start[0])
        if zs >= reactance:
            yield part.wrong(
                "zs",
                (
                    "the impedance at the series resonance exceeds the reactance of the clamped "
                    "capacitance"
                ),
                got=f"zs = {zs:g} Ohm",
                expected=f"less than {reactance:.4g} Ohm, the reactance of the clamped capacitance",
                hint="check the values and units of zs and of the capacitance",
            )


def _list_mode_labels(name: str, modes: int) -> list[str]:
    """Return the labels of a data-sheet value, one for each mode.

    The labels are ``name[0]``, ``name[1]``, …. For a single mode, the label is ``name`` itself.
    """
    return [name] if modes == 1 else [f"{name}[{n}]" for n in range(modes)]


def _list_relations(modes: int, low: float) -> dict[str, Relation]:
    """Return all possible data-sheet values as functions of the unknowns."""
    result: dict[str, Relation] = {}
    for name, function in MODE_VALUES.items():
        functions = (make_unknowns_relation(partial(function, mode=n)) for n in range(modes))
        result |= dict(zip(_list_mode_labels(name, modes), functions, strict=True))
    result["c0"] = lambda unknowns: float(unknowns[0])
    result["c_low"] = lambda unknowns: Resonator.from_unknowns(unknowns).compute_capacitance(low)
    return result


def _choose_initial_unknowns(keys: BvdKeys, modes: int) -> np.ndarray:
    """Choose the start values of the unknowns for the fit.

    The start values are stated values, or values of a typical ceramic.
    """
    ratio = np.full(modes, START_RATIO)
    if keys.keff:
        ratio = np.square(keys.keff) / (1 - np.square(keys.keff))
    elif keys.fs and keys.fp:
        ratio = np.maximum(np.square(keys.fp) / np.square(keys.fs) - 1, SMALLEST_RATIO)
    low_capacitance = keys.c_low or max(keys.cm, default=START_CAPACITANCE) / ratio[0]
    c0 = keys.c0 or low_capacitance / (1 + ratio.sum())
    cm = np.array(keys.cm) if keys.cm else ratio * c0
    fs = np.full(modes, START_FREQUENCY)
    if keys.fs:
        fs = np.array(keys.fs)
    elif keys.fp:
        fs = np.array(keys.fp) / np.sqrt(1 + ratio)
    elif keys.lm:
        fs = 1 / (TWO_PI * np.sqrt(np.array(keys.lm) * cm))
    if keys.lm and not keys.cm:
        cm = 1 / ((TWO_PI * fs) ** 2 * np.array(keys.lm))
    quality = np.array(keys.qm) if keys.qm else START_QUALITY
    rm = np.array(keys.rm or keys.zs) if keys.rm or keys.zs else 1 / (TWO_PI * fs * cm * quality)
    return np.concatenate([[c0], fs, cm, rm])


def _choose_capacitance_key(keys: BvdKeys, modes: int) -> str:
    """Choose the netlist parameter that determines the motional capacitances."""
    if keys.cm:
        return "cm"
    return "fp" if keys.fp and not keys.keff and modes == 1 else "keff"


def _choose_loss_key(keys: BvdKeys, modes: int) -> str:
    """Choose the loss key that determines the motional resistances, such as ``qm``."""
    if keys.qm or keys.rm:
        return "rm" if keys.rm else "qm"
    return "zs" if modes == 1 else "rm"


def _describe_parameter(keys: BvdKeys, key: str, value: float) -> str:
    """Describe a netlist parameter and its tolerance as text."""
    words = f"capacitance at {keys.c_low_at:g} Hz" if key == "c_low" else VALUE_NAMES[key]
    return words + write_tolerance_note(value, keys.tolerance.get(key))


def _make_mode_parameter(keys: BvdKeys, circuit: Resonator, key: str, mode: int, end: str) -> Param:
    """Return a netlist parameter of one mode.

    The netlist computes ``cm`` of a mode from ``c0`` and the coupling coefficient ``keff``.
    Therefore, ``keff`` is the coupling coefficient of a resonator with this mode only: ``keff^2 =
    cm / (c0 + cm)``.
    """
    value = MODE_VALUES[key](circuit, mode)
    if key == "keff":
        value = (circuit.cm[mode] / (circuit.c0 + circuit.cm[mode])) ** 0.5
    unit, value = VALUE_UNITS_OF_SHEET[key] or "-", round_to_digits(value)
    result = make_positive_parameter(
        f"{key}{end}", value, unit, _describe_parameter(keys, key, value)
    )
    if key == "keff":
        return replace(result, high=1.0)
    is_above_c_low = key == "fs" and keys.c_low is not None and keys.c_low_at > 0
    return replace(result, low=keys.c_low_at) if is_above_c_low else result


def _write_element_equations(end: str, ratio: str, loss: str) -> dict[str, str]:
    """Write the equations of the circuit elements of a mode, keyed by element.

    Elements that are netlist parameters have no equation.
    """
    fs, cm, rm = f"fs{end}", f"cm{end}", f"rm{end}"
    result = {} if ratio == "cm" else {cm: f"c0*ratio{end}"}
    result[f"lm{end}"] = f"1/({TWO_PI**2!r}*{fs}*{fs}*{cm})"
    if loss == "qm":
        result[rm] = f"1/({TWO_PI!r}*{fs}*{cm}*qm{end})"
    if loss == "zs":
        result[rm] = f"zs/sqrt(1-{_REACTIVE_SHARE}*({_REACTIVE_SHARE}))"
    return result


register_part_type(Bvd())
