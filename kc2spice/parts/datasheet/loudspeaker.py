"""A loudspeaker or voice coil with its cone from Thiele-Small parameters."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from kc2spice.core import laws
from kc2spice.core.figure import Figure
from kc2spice.core.quantities import (
    AIR_DENSITY,
    SOUND_SPEED,
    Frequency,
    Inductance,
    Length,
    Mass,
    MechanicalDamping,
    Ratio,
    Resistance,
    Section,
    si,
)
from kc2spice.core.waveforms import Waveforms
from kc2spice.fem.thermal_materials import find_resistance_coefficient
from kc2spice.netlist.circuit import Param, positive_parameter
from kc2spice.netlist.library import Header, Subcircuit
from kc2spice.netlist.spelling import round_to_digits
from kc2spice.parts.datasheet._resonator import (
    TWO_PI,
    NumberedKeys,
    NumberedPart,
    tolerance_note,
)
from kc2spice.parts.datasheet._stated_values import Relation, StatedValues
from kc2spice.physics import Declaration, DeclaredPart, current, displacement
from kc2spice.physics.cards import subcircuit_items
from kc2spice.physics.conductors import ConductorKeys
from kc2spice.physics.law import DeclaredLaw
from kc2spice.physics.part import declared_subcircuit
from kc2spice.scene.checks import Check, Metric
from kc2spice.scene.model import (
    Build,
    GovernedScene,
    JoinedScene,
    Part,
    Scene,
    Terminal,
    WiredScene,
)
from kc2spice.scene.parttype import register
from kc2spice.scene.rows import Neglected, Rest

AIR_STIFFNESS = AIR_DENSITY * SOUND_SPEED**2  # Pa, rho c^2
# Unknowns, and a usual woofer of 17 cm where the iteration begins, in SI.
# s, le / re of a data sheet without le: a corner frequency of 159 kHz, above audio
INDUCTANCE_TIME = 1e-6
EXAMPLE_WOOFER = {"re": 6.0, "bl": 6.0, "mms": 15e-3, "cms": 1e-3, "rms": 1.0, "sd": 13e-3}
Area = Annotated[float, si("m2")]


class LoudspeakerKeys(ConductorKeys, NumberedKeys):
    """Any values of the sheet that determine the driver; further values must agree with these.

    ``Bl^2 = 2 pi fs mms re / qes``, ``qms = 2 pi fs mms / rms``, ``vas = rho c^2 sd^2 cms``
    (R. H. Small, J. Audio Eng. Soc. 20 (1972) 383).
    """

    fs: Frequency | None = Field(None, gt=0, description="Resonance frequency in free air")
    re: Resistance | None = Field(None, gt=0, description="DC resistance of the voice coil")
    le: Inductance | None = Field(
        None, gt=0, description="Inductance of the voice coil; by default 1 us * re"
    )
    qms: Ratio | None = Field(None, gt=0, description="Mechanical Q factor at fs")
    qes: Ratio | None = Field(None, gt=0, description="Electrical Q factor at fs")
    qts: Ratio | None = Field(None, gt=0, description="Total Q factor, qms * qes / (qms + qes)")
    bl: Annotated[float, si("N/A")] | None = Field(
        None, gt=0, description="Force factor B l, in N/A or T m"
    )
    mms: Mass | None = Field(None, gt=0, description="Moving mass including the air load")
    cms: Annotated[float, si("m/N")] | None = Field(
        None, gt=0, description="Compliance of the suspension"
    )
    rms: MechanicalDamping | None = Field(
        None, gt=0, description="Mechanical resistance of the suspension"
    )
    sd: Area | None = Field(None, gt=0, description="Effective area of the cone")
    vas: Annotated[float, si("m3")] | None = Field(
        None, gt=0, description="Volume of air that has the compliance of the suspension"
    )
    zmax: Resistance | None = Field(None, gt=0, description="Impedance at fs, re (1 + qms/qes)")
    xmax: Length | None = Field(
        None, gt=0, description="Largest linear displacement in one direction"
    )
    tolerance: dict[str, Annotated[Ratio, Field(gt=0, lt=1)]] = Field(
        {}, description="Relative tolerance of each value by its key, such as fs = '15 %'"
    )


DRIVER_UNITS = {
    "fs": "Hz", "re": "Ohm", "qms": "", "qes": "", "qts": "", "bl": "N/A", "mms": "kg",
    "cms": "m/N", "rms": "N s/m", "sd": "m2", "vas": "m3", "zmax": "Ohm",
}  # fmt: skip
# Parameters of the netlist with their units and words.
DRIVER_PARAMETERS = {
    "fs": ("Hz", "resonance frequency in free air"),
    "re": ("Ohm", "DC resistance of the voice coil"),
    "qms": ("-", "mechanical Q factor"),
    "qes": ("-", "electrical Q factor"),
    "mms": ("kg", "moving mass with its air load"),
}


def thiele_small(driver: Mapping[str, float]) -> dict[str, float]:
    """All values of a sheet from ``re``, ``bl``, ``mms``, ``cms``, ``rms`` and ``sd``."""
    w = 1 / math.sqrt(driver["mms"] * driver["cms"])
    qms = w * driver["mms"] / driver["rms"]
    qes = w * driver["mms"] * driver["re"] / driver["bl"] ** 2
    return dict(driver) | {
        "fs": w / TWO_PI,
        "qms": qms,
        "qes": qes,
        "qts": qms * qes / (qms + qes),
        "vas": AIR_STIFFNESS * driver["sd"] ** 2 * driver["cms"],
        "zmax": driver["re"] * (1 + qms / qes),
    }


def _relation(key: str, names: tuple[str, ...]) -> Relation:
    area = {"sd": EXAMPLE_WOOFER["sd"]}
    return lambda values: thiele_small(area | dict(zip(names, values.tolist(), strict=True)))[key]


@dataclass(frozen=True)
class SpeakerParameters:
    """Parameters of a driver in SI."""

    fs: float
    re: float
    qms: float
    qes: float
    mms: float
    le: float


def motor(params: tuple[Param, ...]) -> Declaration:
    """Voice coil and suspension, without the mass of the cone."""
    return Declaration(
        "loudspeaker",
        "loudspeaker from its Thiele-Small parameters",
        Section,
        (current("i", "plus", "minus"), displacement("x", "cone", "frame")),
        energy="0.5*x^2/cms",
        coenergy="i*bl*x + 0.5*le*i^2",
        content="0.5*re*i^2 + 0.5*rms*x_rate^2",
        given=params,
        constants={
            "omega": f"{TWO_PI!r}*fs",
            "bl": "sqrt(omega*mms*re/qes)",
            "cms": "1/(omega*omega*mms)",
            "rms": "omega*mms/qms",
        },
        conductors=("i",),
        temperature_coefficient=find_resistance_coefficient("copper"),
        rating="not known; i^2 re heats the coil, and xmax limits the excursion",
        sign="um and N count along plus current; 1 A into a pin pushes it that way with 1 N",
    )


def moving_mass(mass: float) -> Declaration:
    """The cone, whose mass has nodes of its own in the netlist of the motor."""
    return Declaration(
        "cone",
        "moving mass",
        Section,
        (displacement("m", "cone", "frame"),),
        kinetic="0.5*mms*m_rate^2",
        starts={"m": ("0", "0")},
        given=(positive_parameter("mms", mass, "kg", "moving mass"),),
    )


class Loudspeaker(NumberedPart[LoudspeakerKeys], DeclaredPart[LoudspeakerKeys]):
    name, title = "loudspeaker", "loudspeaker from its Thiele-Small parameters"
    schema = LoudspeakerKeys
    source = "data sheet"
    noise = ("Rnoise",)
    example = """
[loudspeaker]
part = "loudspeaker"
fs = "46.4 Hz"
re = "6.23 Ohm"
qms = 6.66
qes = 0.538
mms = "10.28 g"
pins = { plus = "drive.out" }

[drive]
part = "source"
ac = "1 V"

[analysis]
type = "ac"
start = "10 Hz"
stop = "1 kHz"
"""

    def detail(self, part: Part[LoudspeakerKeys], scene: GovernedScene) -> SpeakerParameters:
        return self.solve(part)

    def solve(self, part: Part[LoudspeakerKeys]) -> SpeakerParameters:
        """Parameters from the keys; UsageError if the keys do not determine the values."""
        keys = part.keys
        stated = {key: value for key in DRIVER_UNITS if (value := getattr(keys, key)) is not None}
        for name in keys.tolerance:
            if name not in stated:
                raise part.wrong(
                    f"tolerance.{name}",
                    "this tolerance belongs to a value that is missing",
                    name,
                    f"one of {', '.join(stated)}",
                )
        names = tuple(name for name in EXAMPLE_WOOFER if name != "sd" or keys.sd or keys.vas)
        known = [key for key in DRIVER_UNITS if key not in ("sd", "vas") or "sd" in names]
        start = np.array([stated.get(name, EXAMPLE_WOOFER[name]) for name in names])
        relations = {key: _relation(key, names) for key in known}
        tolerance = dict(keys.tolerance)
        values = StatedValues(part.name, stated, relations, start, DRIVER_UNITS, tolerance, {})
        unknowns = zip(names, values.solve().tolist(), strict=True)
        sizes = thiele_small({"sd": EXAMPLE_WOOFER["sd"]} | dict(unknowns))
        le = INDUCTANCE_TIME * sizes["re"] if keys.le is None else keys.le
        return SpeakerParameters(**{key: sizes[key] for key in DRIVER_PARAMETERS}, le=le)

    def _parameters(self, part: Part[LoudspeakerKeys], scene: GovernedScene) -> SpeakerParameters:
        record = scene.record(part)
        if record is None or not isinstance(record.detail, SpeakerParameters):
            return self.solve(part)
        return record.detail

    def declared(self, part: Part[LoudspeakerKeys], scene: GovernedScene) -> Declaration:
        driver, tolerance = self._parameters(part, scene), part.keys.tolerance
        params = []
        for key, (unit, words) in DRIVER_PARAMETERS.items():
            value = round_to_digits(getattr(driver, key))
            note = words + tolerance_note(value, tolerance.get(key))
            params.append(positive_parameter(key, value, unit, note))
        params.append(positive_parameter("le", driver.le, "H", "inductance of the voice coil"))
        return motor(tuple(params))

    def pins(self, part: Part[LoudspeakerKeys], scene: JoinedScene) -> tuple[Terminal, ...]:
        """Pins of the motor, of which the cone may stay free."""
        pins = super().pins(part, scene)
        return tuple(replace(pin, required=False) if pin.name == "cone" else pin for pin in pins)

    def inertial(self, part: Part[LoudspeakerKeys], scene: JoinedScene) -> tuple[str, ...]:
        return ("cone",)

    def at_rest(self, part: Part[LoudspeakerKeys], scene: WiredScene) -> Rest:
        return Rest((("cone", "frame"),), inert=("cone",))

    def subcircuits(
        self, part: Part[LoudspeakerKeys], build: Build, header: Header
    ) -> tuple[Subcircuit, ...]:
        d, name = self.resolved_built_declaration(part, build), build.libraries[part.name]
        cone = subcircuit_items(moving_mass(self._parameters(part, build.scene).mms))
        values = d.values(part.keys)
        return (declared_subcircuit(header, name, d, values, build.has_noise, cone),)

    def law(self, part: Part[LoudspeakerKeys], build: Build) -> laws.Equations:
        equations, n = super().law(part, build), part.name
        mass = self._parameters(part, build.scene).mms
        cone = DeclaredLaw(f"{n}_cone", moving_mass(mass), (mass,))
        nets = tuple((f"{n}.{pin}", f"{n}_cone.{pin}") for pin in ("cone", "frame"))
        return replace(equations, laws=(*equations.laws, cone), nets=nets)

    def checks(self, part: Part[LoudspeakerKeys], build: Build, waves: Waveforms) -> Iterator[Any]:
        yield from super().checks(part, build, waves)
        limit, x = part.keys.xmax, waves.data.get(f"{part.name}.x")
        if limit is not None and x is not None:
            advice = "the force factor and the compliance change there: lower the drive"
            largest = float(np.abs(x).max())
            yield Check(f"excursion of {part.name}", largest, limit, "m", advice, "warn")

    def _impedance(
        self, part: Part[LoudspeakerKeys], waves: Waveforms
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Frequencies [Hz] and impedances [Ohm] of a response to small signals."""
        known = [waves.data.get(f"{part.name}.{result}") for result in ("v", "i")]
        if "frequency" not in waves or known[0] is None or known[1] is None:
            return None
        return waves["frequency"].real, known[0] / known[1]

    def metrics(
        self, part: Part[LoudspeakerKeys], build: Build, waves: Waveforms
    ) -> Mapping[str, object]:
        result = self._impedance(part, waves)
        if result is None:
            return {}
        frequency, z = result
        return {
            "frequency_hz": Metric(frequency.tolist(), "Hz"),
            "impedance_ohm": Metric(np.abs(z).tolist(), "Ohm"),
        }

    def figures(
        self, part: Part[LoudspeakerKeys], build: Build, waves: Waveforms
    ) -> Iterator[Figure]:
        result = self._impedance(part, waves)
        if result is not None:
            how = f"as the circuit shows it at {part.name}: maximum at resonance."
            from kc2spice.parts.bodies._pictures import plot_impedances

            yield plot_impedances(part.name, result[0], {"": result[1]}, how)

    def notes(self, part: Part[LoudspeakerKeys], scene: Scene) -> Iterator[str | Neglected]:
        driver = self._parameters(part, scene)
        qts = driver.qms * driver.qes / (driver.qms + driver.qes)
        peak = driver.re * (1 + driver.qms / driver.qes)
        yield f"fs {driver.fs:.4g} Hz, Qts {qts:.4g}, impedance at fs {peak:.4g} Ohm"
        yield Neglected("large strokes", "Bl and compliance are constant", "see part voice_coil")
        yield Neglected("radiation", "mms includes the mass of the air", "resistance not estimated")
        yield Neglected("eddy currents in the pole", "le is constant", "impedance above 1 kHz")
        yield from self.neglected(part, scene)


register(Loudspeaker())
