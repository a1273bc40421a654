"""The part ``listener``: sound pressure in the far field of radiating surfaces."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
from pydantic import Field

from kc2spice.core import constitutive_laws as laws
from kc2spice.core.domains import ACOUSTIC, AMBIENT, SIGNAL
from kc2spice.core.errors import UsageError, unknown
from kc2spice.core.figure import Curve, Figure, Panel, format_axis_label, get_axis_label_and_factor
from kc2spice.core.quantities import ListenerDistance, Ratio, Section
from kc2spice.core.si_prefix_format import format_quantity
from kc2spice.core.sound_level import SoundLevel, compute_level
from kc2spice.core.user_warnings import warn_user
from kc2spice.core.waveforms import Waveforms
from kc2spice.netlist.circuit import Circuit, Element, Item, Pin, make_positive_parameter
from kc2spice.netlist.number_and_name_spelling import format_comment, format_number
from kc2spice.netlist.subcircuit_library import Header, Subcircuit
from kc2spice.parts.acoustics._acoustic_part import RATING
from kc2spice.parts.acoustics._far_field import (
    find_first_null,
    get_baffled_radius,
    propagate_response,
    propagate_wave,
)
from kc2spice.parts.acoustics.radiation import REFERENCE_DISTANCE, SOUND, RadiationKeys
from kc2spice.scene.checks import Metric
from kc2spice.scene.highest_frequency import find_highest_frequency
from kc2spice.scene.part_records import NeglectedEffect, PartResult
from kc2spice.scene.parttype import register_part_type
from kc2spice.scene.scene_classes import (
    GROUND,
    BuiltScene,
    DeclaredScene,
    GovernedScene,
    JoinedScene,
    Part,
    PartType,
    Scene,
    Terminal,
)

OUT = "out"  # pin whose voltage is the sound pressure
RADIATION = "radiation"  # part type of the radiating surfaces
RIGHT_ANGLE = 90.0  # largest angle [degrees] between the axis and a listener in front of a baffle
# Functions that apply directivity and propagation delay to a sound pressure, keyed by the
# independent variable of the pressure.
_PROPAGATIONS = {"frequency": propagate_response, "time": propagate_wave}
LOG_DECADES = 1.3  # frequency range in decades above which the frequency axis is logarithmic


class ListenerKeys(Section):
    """Keys of a listener: its position, and the surfaces whose sound it receives."""

    sources: tuple[str, ...] = Field(
        (),
        max_length=64,
        description=(
            "Radiating surfaces (parts of type `radiation`) whose sound reaches the "
            "listener; by default all radiating surfaces of the scene"
        ),
    )
    distance: ListenerDistance = Field(
        1.0,
        ge=1e-6,
        le=1e7,
        description="Distance of the listener from the centre of the radiating surfaces",
    )
    angle: Ratio = Field(
        0.0,
        ge=0,
        le=180,
        description=(
            "Angle in degrees between the axis of the radiating surfaces and the direction "
            "to the listener"
        ),
    )


class Listener(PartType[ListenerKeys]):
    """Part type ``listener``: sum of far-field sound pressures of several surfaces.

    A surface has the volume velocity U and the radius a, and r is the distance of the listener. A
    piston in a baffle has the sound pressure ``p = j omega rho U D / (2 pi r) exp(-j k r)`` with
    the directivity ``D = 2 J1(x) / x``, ``x = k a sin(angle)``. A sphere with the pressure
    p_surface on its surface has the sound pressure ``p = p_surface (a / r) exp(-j k (r - a))`` (L.
    E. Kinsler et al., Fundamentals of Acoustics, 4th ed., sections 7.1 and 7.4). For an open end of
    area S with the pressure p_end, the pressure on the axis is used at all angles: ``p = j omega
    rho (U + p_end S / (rho c)) / (4 pi r) exp(-j k r)`` (H. Levine, J. Schwinger, Phys. Rev. 73
    (1948) 383).
    """

    name, title = "listener", "sound pressure at a point in the far field"
    origin_of_pins = "A part has a pin `sound1`, `sound2`, … for each surface in its key `sources`."
    schema = ListenerKeys
    source = "closed form"
    example = """
[listener]
part = "listener"
distance = "10 cm"

[front]
part = "radiation"
radius = "10 mm"
pins = { face = "push.out" }

[push]
part = "source"
kind = "volume_velocity"
ac = "1e-6 m3/s"

[analysis]
type = "ac"
start = "100 Hz"
stop = "20 kHz"

[probes]
level_at_1khz = { of = "listener.pressure", take = "spl", at = "1 kHz" }
"""

    def list_radiating_surfaces(
        self, part: Part[ListenerKeys], scene: DeclaredScene
    ) -> tuple[Part[RadiationKeys], ...]:
        """Return the radiating surfaces whose sound reaches the listener."""
        every = {item.name: item for item in scene.list_parts_with_schema(RADIATION, RadiationKeys)}
        if not part.keys.sources:
            return tuple(every.values())
        return tuple(every[name] for name in part.keys.sources if name in every)

    # --- scene ------------------------------------------------------------------------------------

    def pins(self, part: Part[ListenerKeys], scene: JoinedScene) -> tuple[Terminal, ...]:
        """Return the pins of the part in the order of its subcircuit."""
        unit = ACOUSTIC.across.pin_unit
        count = len(self.list_radiating_surfaces(part, scene))
        inputs = (Terminal(name, unit, SIGNAL, required=True) for name in _list_input_names(count))
        out = Terminal(OUT, unit, SIGNAL, signal_out=True)
        return (*inputs, out, Terminal.from_domain(AMBIENT, ACOUSTIC, GROUND))

    def default_joins(self, part: Part[ListenerKeys], scene: GovernedScene) -> Mapping[str, str]:
        """Return the default connections of the inputs to ``sound`` pins of surfaces."""
        sources = self.list_radiating_surfaces(part, scene)
        targets = (f"{source.name}.{SOUND}" for source in sources)
        return dict(zip(_list_input_names(len(sources)), targets, strict=True))

    def problems(self, part: Part[ListenerKeys], scene: GovernedScene) -> Iterator[UsageError]:
        """Yield an error for each invalid key of the part."""
        known = [item.name for item in scene.list_parts(RADIATION)]
        for k, name in enumerate(part.keys.sources):
            if name not in known:
                yield unknown(
                    "the scene has no part of type radiation with this name",
                    name,
                    known,
                    f"{part.name}.sources.{k}",
                )
            elif name in part.keys.sources[:k]:
                yield part.wrong(
                    f"sources.{k}",
                    "sources contains this name twice",
                    got=name,
                    expected="each name once",
                    hint=f"delete the second {name}",
                )
        sources = self.list_radiating_surfaces(part, scene)
        if not sources:
            yield part.wrong(
                "sources",
                "the scene has no radiating surface for the listener",
                got="no part of type radiation",
                expected='a part with part = "radiation"',
                hint='add for example  [surface] with part = "radiation" and radius = "10 mm"',
            )
            return
        first = sources[0].keys.fluid
        for source in sources[1:]:
            if source.keys.fluid != first:
                yield part.wrong(
                    "sources",
                    "the sources of a listener are in different fluids",
                    got=f"{source.name} in another fluid than {sources[0].name}",
                    expected="sources in one fluid",
                    hint=f"write the same value of the key `fluid` in [{source.name}] as in "
                    f"[{sources[0].name}]",
                )
        for item in sources:
            if item.pins.get(AMBIENT, GROUND) != GROUND:
                yield part.wrong(
                    "sources",
                    f"a listener needs surfaces whose pin {AMBIENT} is connected to {GROUND}",
                    got=f"{item.name}.{AMBIENT} = {item.pins[AMBIENT]}",
                    expected=f"{item.name}.{AMBIENT} connected to {GROUND}",
                    hint=f"delete {AMBIENT} from the pins of {item.name}",
                )
        for item in sources:
            if item.keys.shape == "sphere" and part.keys.distance < item.keys.surface_radius:
                got, least = f"{part.keys.distance:g} m", item.keys.surface_radius
                yield part.wrong(
                    "distance",
                    f"the listener is inside of the sphere {item.name}",
                    got=got,
                    expected=f"at least {least:g} m",
                    hint=f"raise the key `distance` to {least:g} m",
                )
        baffled = [item.name for item in sources if item.keys.shape == "baffled_piston"]
        if part.keys.angle > RIGHT_ANGLE and baffled:
            yield part.wrong(
                "angle",
                f"the listener is behind the baffle of {baffled[0]}",
                got=f"{part.keys.angle:g}",
                expected="at most 90 degrees",
                hint="lower the key `angle` to 90",
            )
        self._warn_of_limits(part, sources, scene)

    def _warn_of_limits(
        self,
        part: Part[ListenerKeys],
        sources: tuple[Part[RadiationKeys], ...],
        scene: GovernedScene,
    ) -> None:
        """Warn of limits: a listener in the near field, or an angle without effect."""
        keys, top = part.keys, find_highest_frequency(scene)
        limit = min(map(self._find_largest_frequency, [part] * len(sources), sources))
        if scene.analysis.is_small_signal and top > limit:
            warn_user(
                f"{part.name}: at a distance of {format_quantity(keys.distance, 'm')}, the "
                f"pressure is inaccurate above {format_quantity(limit, 'Hz')}, where the far-field "
                f"formula is invalid; the analysis ends at {format_quantity(top, 'Hz')}"
            )
        surfaces = [source.keys for source in sources]
        if scene.analysis.type == "noise" and any(map(get_baffled_radius, surfaces)) and keys.angle:
            null = format_quantity(find_first_null(surfaces, keys.angle), "Hz")
            warn_user(
                f"{part.name}: a noise analysis neglects the key `angle`, so the computed sound "
                f"pressure is much too large above {null}"
            )

    def _find_largest_frequency(
        self, part: Part[ListenerKeys], source: Part[RadiationKeys]
    ) -> float:
        """Return the largest frequency [Hz] at which the listener is in the far field.

        At this frequency, the distance of the listener equals S / wavelength for a surface of the
        area S. The frequency is infinite for a sphere, which has no near field of the pressure.
        """
        if source.keys.shape == "sphere":
            return math.inf
        area = source.keys.radiator.area * source.keys.surface_radius**2
        return part.keys.distance * source.keys.fluid.sound_speed / area

    # --- netlist ----------------------------------------------------------------------------------

    def subcircuits(
        self, part: Part[ListenerKeys], build: BuiltScene, header: Header
    ) -> tuple[Subcircuit, ...]:
        """Return the subcircuit of the part, as a tuple of length 1."""
        from kc2spice.synthesis.library_headers import (
            format_parameter_defaults,
            write_part_header,
        )  # loads slowly

        name, sources = build.libraries[part.name], self.list_radiating_surfaces(part, build.scene)
        pins = tuple(Pin(pin.name, pin.unit, pin.flow) for pin in build.scene.pins(part.name))
        params = (
            make_positive_parameter(
                "distance", part.keys.distance, "m", "distance of the listener"
            ),
        )
        words = ", ".join(
            f"{pin} is the sound of {source.name}"
            for pin, source in zip(_list_input_names(len(sources)), sources, strict=True)
        )
        title = f"{name}: {self.title}; {words}"
        validity = (
            "far field on the axis; propagation delay and directivity are neglected; inputs are "
            f"pressures at {REFERENCE_DISTANCE:g} m; constant temperature"
        )
        head = write_part_header(header, title, pins, params, rating=RATING, validity=validity)
        items = tuple(_write_sum(len(sources)))
        names = tuple(pin.name for pin in pins)
        circuit = Circuit(name, names, format_parameter_defaults(params), items, notes=head)
        tree, text = Circuit(items=(circuit,)), format_comment(title)
        return (Subcircuit(name, pins, params, tree, title=text, header_lines=len(head)),)

    # --- results ----------------------------------------------------------------------------------

    def vectors(self, part: Part[ListenerKeys], build: BuiltScene) -> Mapping[str, PartResult]:
        """Return the ngspice vectors: expressions of the part's results, keyed by name."""
        sources = self.list_radiating_surfaces(part, build.scene)
        pressure = replace(
            build.get_pin_vector(part, OUT),
            level_reference=sources[0].keys.fluid.level_reference_pressure,
            corrected=build.scene.analysis.type in ("ac", "transient"),
        )
        return {f"{part.name}.{ACOUSTIC.across.symbol}": pressure}

    def law(self, part: Part[ListenerKeys], build: BuiltScene) -> laws.Equations:
        """Return empty model equations, because the pressure is computed after a run."""
        return laws.Equations()

    def corrected_waves(
        self, part: Part[ListenerKeys], build: BuiltScene, waves: Waveforms
    ) -> Mapping[str, np.ndarray]:
        """Return the sound pressure at the listener, with propagation delay and directivity."""
        sources, keys = self.list_radiating_surfaces(part, build.scene), part.keys
        scale = next(iter(waves))
        propagate = _PROPAGATIONS.get(scale)
        sounds = {f"{source.name}.{SOUND}": source.keys for source in sources}
        if propagate is None or not sounds.keys() <= waves.data.keys():
            return {}
        pressures = []
        for name, surface in sounds.items():
            sound, x = waves[name], waves.scale.real
            pressures.append(propagate(surface, sound, x, keys.distance, keys.angle))
        share = REFERENCE_DISTANCE / keys.distance
        return {f"{part.name}.{ACOUSTIC.across.symbol}": share * np.sum(pressures, axis=0)}

    def _compute_levels(
        self, part: Part[ListenerKeys], build: BuiltScene, waves: Waveforms
    ) -> np.ndarray:
        """Return the sound pressure level [dB] at each frequency of an ac analysis."""
        fluid = self.list_radiating_surfaces(part, build.scene)[0].keys.fluid
        pressure = np.abs(waves[f"{part.name}.{ACOUSTIC.across.symbol}"])
        return compute_level(pressure / math.sqrt(2.0), fluid.level_reference_pressure)

    def metrics(
        self, part: Part[ListenerKeys], build: BuiltScene, waves: Waveforms
    ) -> Mapping[str, object]:
        """Return the metrics of the part, keyed by name."""
        if build.scene.analysis.type != "ac":
            return {}
        frequency, levels = waves["frequency"].real, self._compute_levels(part, build, waves)
        largest = int(levels.argmax())
        return {
            "frequency_hz": Metric(frequency.tolist(), "Hz", curve=True),
            "level_db": Metric(levels.tolist(), "dB", curve=True),
            "peak_level_db": Metric(float(levels[largest]), "dB"),
            "peak_level_frequency_hz": Metric(float(frequency[largest]), "Hz"),
        }

    def _is_level_probed(self, part: Part[ListenerKeys], scene: Scene) -> bool:
        """Return whether a probe measures the sound pressure level of the listener."""
        name = f"{part.name}.{ACOUSTIC.across.symbol}"
        return any(probe.take == "spl" and probe.of == name for probe in scene.probes.values())

    def figures(
        self, part: Part[ListenerKeys], build: BuiltScene, waves: Waveforms
    ) -> Iterator[Figure]:
        """Yield the figures of the part for the report."""
        if build.scene.analysis.type != "ac" or self._is_level_probed(part, build.scene):
            return
        frequency, levels = waves["frequency"].real, self._compute_levels(part, build, waves)
        axis, factor = get_axis_label_and_factor("frequency", frequency)
        log = frequency[0] > 0 and math.log10(frequency[-1] / frequency[0]) > LOG_DECADES
        fluid = self.list_radiating_surfaces(part, build.scene)[0].keys.fluid
        scale = SoundLevel(fluid.level_reference_pressure)
        curve = Curve("", factor * frequency, levels)
        panel = Panel(axis, format_axis_label("level", scale.unit), (curve,), log_x=log)
        largest = int(levels.argmax())
        title = (
            f"{part.name}: at most {levels[largest]:.1f} dB, at "
            f"{format_quantity(float(f'{frequency[largest]:.4g}'), 'Hz')}"
        )
        place = format_quantity(part.keys.distance, "m")
        caption = (
            f"Sound pressure level (rms, {scale.reference_text}) at {place} and "
            f"{part.keys.angle:g}° from the axis, in a free far field."
        )
        yield Figure(f"{part.name}_level", title, caption, (panel,))

    def notes(self, part: Part[ListenerKeys], scene: Scene) -> Iterator[str | NeglectedEffect]:
        """Yield the assumptions of the model and the effects that it neglects."""
        keys, sources = part.keys, self.list_radiating_surfaces(part, scene)
        names = ", ".join(source.name for source in sources)
        fluid = sources[0].keys.fluid
        delay = format_quantity(float(f"{keys.distance / fluid.sound_speed:.3g}"), "s")
        yield (
            f"far field of {names} at {format_quantity(keys.distance, 'm')}, {keys.angle:g} "
            f"degrees from the axis, which the sound reaches after {delay}; the pin {OUT} does not "
            "include this delay"
        )
        if len(sources) > 1:
            yield NeglectedEffect(
                "differences of the distance",
                "all sources are at the same distance",
                "not estimated",
            )
        surfaces = [source.keys for source in sources]
        if keys.angle and any(map(get_baffled_radius, surfaces)):
            yield NeglectedEffect(
                "directivity in the netlist",
                f"the pin {OUT} gives the pressure on the axis",
                f"first null at {format_quantity(find_first_null(surfaces, keys.angle), 'Hz')}",
            )
        if any(source.keys.shape == "free_piston" for source in sources):
            why = "the result is the pressure on the axis"
            yield NeglectedEffect("directivity of an open end", why, "not estimated")
        size = "about 0.5 dB per metre at 20 kHz in air"
        yield NeglectedEffect("absorption in the fluid", "the fluid is lossless", size)


def _list_input_names(count: int) -> tuple[str, ...]:
    """Return the names of ``count`` input pins, one for each radiating surface."""
    return tuple(f"{SOUND}{k}" for k in range(1, count + 1))


def _write_sum(count: int) -> Iterator[Item]:
    """Yield the cards that sum all inputs and divide the sum by the distance."""
    base, gain = AMBIENT, f"{{{format_number(REFERENCE_DISTANCE)}/distance}}"
    for k, pin in enumerate(_list_input_names(count), 1):
        end = OUT if k == count else f"sum{k}"
        yield Element.from_words(f"E{k}", end, base, pin, AMBIENT, gain)
        base = end


register_part_type(Listener())
