"""The part ``sensor``: position sensor with bandwidth, offset and noise.

A controller can use the measured position.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from pydantic import Field

from kc2spice.core import constitutive_laws as laws
from kc2spice.core.domains import DISPLACEMENT, TRANSLATION
from kc2spice.core.errors import UsageError
from kc2spice.core.key_actions import DeleteKey
from kc2spice.core.quantities import BOLTZMANN, DEFAULT_TEMPERATURE, Frequency, Length, Section
from kc2spice.core.si_prefix_format import format_quantity
from kc2spice.netlist.circuit import Element, Item, Param
from kc2spice.netlist.number_and_name_spelling import format_number
from kc2spice.netlist.shared_cards import attach_comments
from kc2spice.netlist.subcircuit_library import Header, Subcircuit
from kc2spice.parts.mechanics import sphere
from kc2spice.physics.declaration import Declaration, displacement, measured
from kc2spice.physics.declaration_cards import get_state_node
from kc2spice.physics.law import DeclaredLaw
from kc2spice.physics.part import make_declared_subcircuit
from kc2spice.scene.part_records import PartResult
from kc2spice.scene.parttype import register_part_type
from kc2spice.scene.scene_classes import (
    GROUND,
    BuiltScene,
    GovernedScene,
    JoinedScene,
    Part,
    PartType,
    Scene,
    Terminal,
)

# voltage of a displacement pin, divided by the displacement [V/m]
VOLTS_PER_METRE = f"{DISPLACEMENT.pin_value_per_si_unit:g}"


class SensorKeys(Section):
    """Keys of a position sensor: bandwidth, offset and white noise."""

    bandwidth: Frequency = Field(
        1e6,
        gt=0,
        description=(
            "Bandwidth of the position sensor, which is modelled as a first-order low-pass filter"
        ),
    )
    offset: Length = Field(0.0, description="Constant error of the measured position")
    noise: Length = Field(
        0.0,
        ge=0,
        description=(
            "Rms noise of each sample of the measured position; the sample rate is twice the "
            "bandwidth"
        ),
    )


def declare_sensor(keys: SensorKeys) -> Declaration:
    """Return the declaration of the noise-free sensor.

    A first-order low-pass filter filters the position. The output of the sensor is the filtered
    position plus the offset.
    """
    return Declaration(
        "sensor",
        "position sensor",
        Section,
        (measured(displacement("x", "of", "ref")),),
        states={"followed": f"{2 * math.pi:.11g}*bandwidth*({VOLTS_PER_METRE}*x - followed)"},
        outputs={"out": f"{DISPLACEMENT.factor:g}*followed + offset"},
        given=(
            Param("bandwidth", keys.bandwidth, "Hz", "bandwidth of the reading", 0.0),
            Param("offset", keys.offset, "m", "added to the reading"),
        ),
        rating="no range; compare the reading with the range of your sensor",
        validity="linear, one pole, constant temperature",
        base="ref",
        metered=False,
    )


class Sensor(PartType[SensorKeys]):
    """Part type ``sensor``: position sensor with bandwidth, offset and noise."""

    name = "sensor"
    title = "position sensor with bandwidth, offset and noise"
    schema = SensorKeys
    source = "closed form"
    noise = ("Rnoise",)
    example = """
[sensor]
part = "sensor"
bandwidth = "100 kHz"
pins = { of = "push.out" }

[push]
part = "source"
kind = "displacement"
dc = "1 um"
"""

    def pins(self, part: Part[SensorKeys], scene: JoinedScene) -> tuple[Terminal, ...]:
        """Return the pins of the part in the order of its subcircuit."""
        return (
            Terminal.signal("of", DISPLACEMENT, required=True),
            Terminal.signal("out", DISPLACEMENT, signal_out=True),
            Terminal.from_domain("ref", TRANSLATION, GROUND),
        )

    def problems(self, part: Part[SensorKeys], scene: GovernedScene) -> Iterator[UsageError]:
        """Yield an error if the analysis does not permit noise."""
        kinds = ("transient", "noise")
        if part.keys.noise and scene.analysis.type not in kinds:
            yield part.wrong(
                "noise",
                "the noise of a sensor does not apply to this analysis",
                got=scene.analysis.type,
                expected=f"analysis.type {' or '.join(kinds)}, or a sensor without noise",
                hint=DeleteKey("noise"),
            )

    def subcircuits(
        self, part: Part[SensorKeys], build: BuiltScene, header: Header
    ) -> tuple[Subcircuit, ...]:
        """Return the subcircuit of the part, as a tuple of length 1."""
        d, keys = declare_sensor(part.keys), part.keys
        cards: tuple[Item, ...] = ()
        size = DISPLACEMENT.pin_value_per_si_unit * keys.noise
        if keys.noise and build.has_noise:
            # The white noise is the noise voltage of a resistor of 1 Ohm, multiplied by a gain.
            root = math.sqrt(4 * BOLTZMANN * DEFAULT_TEMPERATURE * keys.bandwidth)
            cards = attach_comments((
                "* noise of 1 Ohm at 27 C times a gain",
                Element.from_words("Rnoise", "drawn", "ref", "1"),
                Element.from_words("Gnoise", "ref", "out", "drawn", "ref", size / root),
            ))  # fmt: skip
        elif keys.noise:
            step = format_number(0.5 / keys.bandwidth)
            wave = f"TRNOISE({format_number(size)} {step} 0 0)"
            cards = attach_comments((
                f"* noise in {DISPLACEMENT.pin_unit}, a new random value at every {step} s",
                Element.from_words("Inoise", "ref", "out", "DC", "0", wave),
            ))  # fmt: skip
        name = build.libraries[part.name]
        return (
            make_declared_subcircuit(
                header, name, d, d.compute_parameter_values(Section()), more=cards
            ),
        )

    def settable_quantities(self, part: Part[SensorKeys], build: BuiltScene) -> Mapping[str, float]:
        """Return the settable quantity: the sensor's voltage for the initial height."""
        start = sphere.find_initial_height(part, "of", build.scene)
        if start is None:
            return {}
        return {
            f"x{part.name}.{get_state_node('followed')}": DISPLACEMENT.pin_value_per_si_unit * start
        }

    def vectors(self, part: Part[SensorKeys], build: BuiltScene) -> Mapping[str, PartResult]:
        """Return the ngspice vectors: expressions of the part's results, keyed by name."""
        return {f"{part.name}.y": build.get_pin_vector(part, "out")}

    def law(
        self, part: Part[SensorKeys], build: BuiltScene
    ) -> laws.Equations | laws.MissingEquations:
        """Return the part's law: its model equations, solved by kc2spice without ngspice."""
        if part.keys.noise:
            return laws.MissingEquations("its noise is a random waveform of the simulator")
        n, d = part.name, declare_sensor(part.keys)
        height = sphere.find_height_offset(part, "of", build.scene)
        values = d.compute_parameter_values(Section()) | {"offset": part.keys.offset + height}
        declared_law = DeclaredLaw(n, d, tuple(values.values()))
        pins = tuple((pin, f"{n}.{pin}") for pin in ("of", "out", "ref"))
        result = laws.scale_wave(f"{n}.out", DISPLACEMENT.factor)
        return laws.Equations((declared_law,), pins, {f"{n}.y": result})

    def notes(self, part: Part[SensorKeys], scene: Scene) -> Iterator[str]:
        """Yield the assumptions of the model and the effects that it neglects."""
        keys = part.keys
        offset, noise = format_quantity(keys.offset, "m"), format_quantity(keys.noise, "m")
        yield f"{format_quantity(keys.bandwidth, 'Hz')}, offset {offset}, noise {noise} rms"


register_part_type(Sensor())
