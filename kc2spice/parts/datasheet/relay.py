"""Relay from its data sheet: coil, armature with hysteresis, and contacts."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from pydantic import Field

from kc2spice.core.errors import UsageError
from kc2spice.core.quantities import CoilInductance, Ratio, Resistance, Section, Time, Voltage
from kc2spice.core.si_prefix_format import format_quantity
from kc2spice.core.waveforms import Waveforms
from kc2spice.fem.thermal_materials import find_resistance_coefficient
from kc2spice.netlist.circuit import Param, make_positive_parameter
from kc2spice.netlist.number_and_name_spelling import round_to_digits
from kc2spice.parts.datasheet._resonator import (
    PartNumberKeys,
    PartWithPartNumber,
    write_tolerance_note,
)
from kc2spice.physics import Declaration, DeclaredPart, current, voltage
from kc2spice.physics.conductors import ConductorKeys
from kc2spice.scene.checks import Metric
from kc2spice.scene.part_records import NeglectedEffect, NumericalRequirements
from kc2spice.scene.parttype import register_part_type
from kc2spice.scene.scene_classes import (
    BuiltScene,
    GovernedScene,
    JoinedScene,
    Part,
    Scene,
    Terminal,
    WiredScene,
)

# Assumed rise time of the current, divided by the operate time, if the inductance is not known.
CURRENT_RISE_SHARE = 0.9
# time from one end of the armature's travel to the middle, divided by the time constant
HALF_WAY_TIME = math.log(2)
CONTACT_POSITION = 0.5  # position of the armature, from 0 to 1, at which the contacts switch


class RelayKeys(ConductorKeys, PartNumberKeys):
    """Keys of a relay from its data sheet.

    The armature pulls in when the product of current and coil resistance exceeds ``pick_up``. The
    armature releases when the product of current and coil resistance falls below ``release``.
    """

    resistance: Resistance = Field(gt=0, description="Resistance of the relay's coil")
    voltage: Voltage = Field(gt=0, description="Rated voltage of the relay's coil")
    pick_up: Voltage = Field(gt=0, description="Coil voltage at which the armature pulls in")
    release: Voltage = Field(gt=0, description="Coil voltage at which the armature releases")
    inductance: CoilInductance | None = Field(
        None,
        gt=0,
        description=(
            "Inductance of the relay's coil; by default computed from the key `operate_time`"
        ),
    )
    operate_time: Time | None = Field(
        None,
        gt=0,
        description=(
            "Time from the application of the rated voltage to the closing of the relay's contact"
        ),
    )
    contact_resistance: Resistance = Field(
        0.1, gt=0, description="Resistance of a closed contact of the relay"
    )
    insulation_resistance: Resistance = Field(
        1e8, gt=0, description="Resistance of an open contact of the relay"
    )
    changeover: bool = Field(
        False,
        description="Whether the relay also has a normally closed contact, whose pin is `nc`",
    )
    resistance_tolerance: Ratio | None = Field(
        None, gt=0, lt=1, description="Relative tolerance of the resistance of the relay's coil"
    )


@dataclass(frozen=True)
class RelayTiming:
    """Coil inductance [H] and armature time constant [s] of a relay."""

    inductance: float
    armature: float


def solve_timing(part: Part[RelayKeys]) -> RelayTiming:
    """Compute coil inductance and armature time constant from the operate time.

    Inductance and time constant together give the operate time in the data sheet. At the rated
    voltage V, the current reaches the pick-up current after the time ``L/R ln(V / (V - Vp))``. L
    and R are the inductance and the resistance of the coil, and Vp is the pick-up voltage. The
    armature then needs ``ln 2`` time constants to the middle of its travel.
    """
    keys = part.keys
    if not keys.release < keys.pick_up < keys.voltage:
        raise part.wrong(
            "pick_up",
            "the voltages are not in the order release < pick_up < voltage",
            got=(
                f"release {keys.release:g} V, pick_up {keys.pick_up:g} V, voltage "
                f"{keys.voltage:g} V"
            ),
            expected="release below pick_up, and pick_up below the rated voltage",
            hint=f'exchange release and pick_up: pick_up = "{keys.release:g} V" and '
            f'release = "{keys.pick_up:g} V"'
            if keys.pick_up <= keys.release < keys.voltage
            else f"raise voltage above pick_up, {keys.pick_up:g} V, or correct pick_up",
        )
    rise = -math.log1p(-keys.pick_up / keys.voltage)
    if keys.operate_time is None and keys.inductance is None:
        raise part.wrong(
            "",
            "the relay has neither inductance nor operate_time",
            got="neither inductance nor operate_time",
            expected="the operate time in the data sheet, the inductance of the coil, or both",
            hint='add  operate_time = "10 ms"',
        )
    if keys.operate_time is None:
        assert keys.inductance is not None
        electrical = keys.inductance / keys.resistance * rise
        mechanical = (1 / CURRENT_RISE_SHARE - 1) * electrical
        return RelayTiming(keys.inductance, mechanical / HALF_WAY_TIME)
    if keys.inductance is None:
        electrical = CURRENT_RISE_SHARE * keys.operate_time
        inductance = electrical / rise * keys.resistance
        return RelayTiming(inductance, (keys.operate_time - electrical) / HALF_WAY_TIME)
    electrical = keys.inductance / keys.resistance * rise
    if electrical >= keys.operate_time:
        most = keys.operate_time / rise * keys.resistance
        raise part.wrong(
            "operate_time",
            "operate_time contradicts inductance",
            got=f"operate_time = {keys.operate_time:g} s and inductance = {keys.inductance:g} H",
            expected=(
                f"an inductance below {most:.4g} H, or an operate time above the rise time of the "
                f"current, which is {electrical:.4g} s"
            ),
            hint="correct or delete one of the two values",
        )
    return RelayTiming(keys.inductance, (keys.operate_time - electrical) / HALF_WAY_TIME)


def measure_delay(time: np.ndarray, cause: np.ndarray, effect: np.ndarray) -> float | None:
    """Return the delay [s] between upward zero crossings of a cause and its effect.

    The result is None if the cause or the effect does not rise through zero exactly once.

    Examples
    --------
    >>> time = np.array([0.0, 1.0, 2.0, 3.0])
    >>> measure_delay(time, np.array([-1.0, 1.0, 1.0, 1.0]), np.array([-1.0, -1.0, -1.0, 1.0]))
    2.0
    """
    moments = []
    for wave in (cause, effect):
        rises = np.flatnonzero((wave[:-1] < 0) & (wave[1:] >= 0))
        if len(rises) != 1:
            return None
        k = int(rises[0])
        share = wave[k] / (wave[k] - wave[k + 1])
        moments.append(float(time[k] + share * (time[k + 1] - time[k])))
    return moments[1] - moments[0]


def declare_relay(params: tuple[Param, ...], changeover: bool) -> Declaration:
    """Return the declaration of the coil, the armature and the contacts of a relay.

    The position of the armature is 0 at rest, and at most 1. While the voltage across the coil
    resistance exceeds the pick-up voltage, the armature moves towards position 1, where it is fully
    pulled in. An armature beyond the middle of its travel moves towards position 1 as long as the
    voltage exceeds the release voltage. The contacts switch when the armature is in the middle. The
    relay is not polarised: it operates with either sign of the voltage.
    """
    closed, opened = "1/contact_resistance", "1/insulation_resistance"
    step = f"({closed} - {opened})*above(armature - 0.5)"
    branches = [current("i", "plus", "minus"), voltage("v_no", "no", "com", "i_no")]
    content = f"0.5*resistance*i^2 + 0.5*v_no^2*({opened} + {step})"
    if changeover:
        branches.append(voltage("v_nc", "nc", "com", "i_nc"))
        content += f" + 0.5*v_nc^2*({closed} - {step})"
    # the two terms are for the two signs of the current; at most one of them is 1
    operated = "(above(resistance*i - pick_up) + above(-resistance*i - pick_up))"
    held = "(above(resistance*i - release) + above(-resistance*i - release))"
    kept = f"{held}*above(armature - 0.5)"
    return Declaration(
        "relay",
        "relay from its data sheet",
        Section,
        tuple(branches),
        coenergy="0.5*inductance*i^2",
        content=content,
        given=params,
        states={"armature": f"({operated} + (1 - {operated})*{kept} - armature)/armature_time"},
        conductors=("i",),
        temperature_coefficient=find_resistance_coefficient("copper"),
        rating="not known; compare contact currents and coil power with the data sheet",
    )


class Relay(PartWithPartNumber[RelayKeys], DeclaredPart[RelayKeys]):
    """Part type ``relay``: relay with one contact, modelled from its data sheet."""

    name, title = "relay", "relay with one contact from its data sheet"
    schema = RelayKeys
    source = "data sheet"
    noise = ("Rnoise",)
    example = """
[relay]
part = "relay"
resistance = "70 Ohm"
voltage = "5 V"
pick_up = "3.75 V"
release = "0.5 V"
operate_time = "10 ms"
pins = { plus = "drive.out", no = "supply.out" }

[drive]
part = "source"
pulse = { high = "5 V", width = "30 ms", edge = "10 us", start = "1 ms" }

[supply]
part = "source"
dc = "12 V"

[load]
part = "resistor"
resistance = "100 Ohm"
pins = { a = "relay.com", b = "gnd" }
"""

    def shared_data(self, part: Part[RelayKeys], scene: GovernedScene) -> RelayTiming:
        """Return coil inductance and armature time constant, which other parts read."""
        return solve_timing(part)

    def problems(self, part: Part[RelayKeys], scene: GovernedScene) -> Iterator[UsageError]:
        """Yield an error for each invalid key of the part."""
        yield from super().problems(part, scene)
        keys = part.keys
        if keys.contact_resistance >= keys.insulation_resistance:
            yield part.wrong(
                "insulation_resistance",
                "an open contact conducts better than a closed contact",
                got=f"{keys.insulation_resistance:g} Ohm",
                expected=f"above contact_resistance, {keys.contact_resistance:g} Ohm",
                hint=(
                    "state the resistance of the closed contact as `contact_resistance`, and the "
                    "resistance of the open contact as `insulation_resistance`"
                ),
            )

    def make_declaration(self, part: Part[RelayKeys], scene: GovernedScene) -> Declaration:
        """Return the declaration of the part for the values of its keys."""
        keys, record = part.keys, scene.get_record(part)
        detail = record.shared_data if record is not None else None
        times = detail if isinstance(detail, RelayTiming) else solve_timing(part)
        words = "coil resistance" + write_tolerance_note(keys.resistance, keys.resistance_tolerance)
        inductance, armature = map(round_to_digits, (times.inductance, times.armature))
        params = (
            make_positive_parameter("resistance", keys.resistance, "Ohm", words),
            make_positive_parameter("inductance", inductance, "H", "coil inductance"),
            make_positive_parameter(
                "pick_up", keys.pick_up, "V", "coil voltage at which it operates"
            ),
            make_positive_parameter(
                "release", keys.release, "V", "coil voltage at which it releases"
            ),
            make_positive_parameter(
                "armature_time", armature, "s", "time constant of the armature"
            ),
            make_positive_parameter(
                "contact_resistance", keys.contact_resistance, "Ohm", "closed contact"
            ),
            make_positive_parameter(
                "insulation_resistance", keys.insulation_resistance, "Ohm", "open contact"
            ),
        )
        return declare_relay(params, keys.changeover)

    def pins(self, part: Part[RelayKeys], scene: JoinedScene) -> tuple[Terminal, ...]:
        """Return the pins of the part in the order of its subcircuit.

        The pins ``no`` and ``nc`` of the contacts may stay unconnected.
        """
        pins = super().pins(part, scene)
        return tuple(replace(p, required=False) if p.name in ("no", "nc") else p for p in pins)

    def numerics(self, part: Part[RelayKeys], scene: WiredScene) -> Iterator[NumericalRequirements]:
        """Yield numerical requirements: time steps that resolve the armature's motion.

        If the equations of the relay are nonlinear, the analyses ``dc`` and ``op`` also require a
        smaller Newton tolerance.
        """
        yield from super().numerics(part, scene)
        times = solve_timing(part)
        yield NumericalRequirements(
            f"a tenth of the time constant of {part.name}", 0.1 * times.armature
        )

    def metrics(
        self, part: Part[RelayKeys], build: BuiltScene, waves: Waveforms
    ) -> Mapping[str, object]:
        """Return the largest coil current, and a transient's operate and release times.

        A time is absent if the relay does not operate or release exactly once. Without the key
        ``inductance``, the release time is also absent, because the inductance computed from the
        operate time is too large for an accurate release time.
        """
        keys = part.keys
        columns = [waves.data.get(f"{part.name}.{result}") for result in ("v", "i", "armature")]
        if "time" not in waves or any(column is None for column in columns):
            return {}
        volts, amperes, armature = map(np.asarray, columns)
        volts = np.abs(volts)  # the relay operates with either sign
        result = {"coil_current_a": Metric(float(np.abs(amperes).max()), "A")}
        time, travel = waves["time"], armature - CONTACT_POSITION
        times = {"operate_time_s": measure_delay(time, volts - keys.pick_up, travel)}
        if keys.inductance is not None:
            times["release_time_s"] = measure_delay(time, keys.release - volts, -travel)
        for name, delay in times.items():
            if delay is not None:
                result[name] = Metric(delay, "s")
        return result

    def notes(self, part: Part[RelayKeys], scene: Scene) -> Iterator[str | NeglectedEffect]:
        """Yield the assumptions of the model and the effects that it neglects."""
        keys, times = part.keys, solve_timing(part)
        yield (
            f"operates at {keys.pick_up:g} V, releases at {keys.release:g} V, coil "
            f"{format_quantity(keys.resistance, 'Ohm')} and "
            f"{format_quantity(times.inductance, 'H', 3)}"
        )
        if keys.inductance is None:
            share = f"{100 * CURRENT_RISE_SHARE:g} % of the operate time"
            yield NeglectedEffect(
                "contribution of the armature motion to the operate time",
                f"the rise of the coil current is assumed to take {share}",
                "not estimated",
            )
        yield NeglectedEffect("contact bounce", "each contact switches once", "a few milliseconds")
        yield NeglectedEffect(
            "change of the coil inductance with the armature position",
            "constant inductance",
            "no dip of the coil current when the armature moves",
        )
        yield NeglectedEffect("arcs", "contacts are resistances", "not estimated")
        yield from self.list_neglected_effects(part, scene)


register_part_type(Relay())
