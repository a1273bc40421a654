"""Loudspeaker, or voice coil with a cone, from Thiele-Small parameters."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from kc2spice.core import constitutive_laws as laws
from kc2spice.core.errors import UsageError, list_candidates
from kc2spice.core.figure import Figure
from kc2spice.core.probe_values import find_response_maximum
from kc2spice.core.si_prefix_format import format_quantity
from kc2spice.core.waveforms import Waveforms
from kc2spice.netlist.circuit import make_positive_parameter
from kc2spice.netlist.number_and_name_spelling import round_to_digits
from kc2spice.parts.datasheet._efficiency import compute_efficiency
from kc2spice.parts.datasheet._ladders import (
    CREEP_BAND,
    SEMI_INDUCTANCE_BAND,
    RelaxationLadder,
    fit_creep_ladder,
    make_semi_inductance_ladder,
)
from kc2spice.parts.datasheet._loudspeaker_circuit import (
    COIL,
    FRONT,
    REAR,
    SemiInductance,
    SpeakerParameters,
    compute_baffle_air_mass,
    declare_massless_driver,
    declare_moving_mass,
)
from kc2spice.parts.datasheet._loudspeaker_keys import (
    AREA_KEYS,
    DRIVER_PARAMETERS,
    DRIVER_UNITS,
    EXAMPLE_WOOFER,
    USUAL_QTS,
    LoudspeakerKeys,
    compute_thiele_small,
    make_relation,
)
from kc2spice.parts.datasheet._resonator import (
    TWO_PI,
    PartWithPartNumber,
    write_tolerance_note,
)
from kc2spice.parts.datasheet._stated_values import StatedValues
from kc2spice.physics import Declaration, current
from kc2spice.physics.part import get_across_vector
from kc2spice.physics.part_with_mass import DeclaredPartWithMass
from kc2spice.scene.checks import Check, Metric
from kc2spice.scene.part_records import EquilibriumConditions, NeglectedEffect, PartResult
from kc2spice.scene.parttype import register_part_type
from kc2spice.scene.plausibility import check_usual_range
from kc2spice.scene.scene_classes import (
    BuiltScene,
    DeclaredScene,
    GovernedScene,
    JoinedScene,
    Part,
    Scene,
    Terminal,
    WiredScene,
)

RADIATION = "radiation"  # part type that models the mass of the air at the cone
# Default ratio le / re [s] for a data sheet without le.
# With this ratio le / re, the corner frequency of the coil is 159 kHz, far above the audio band.
INDUCTANCE_TIME = 1e-6


def _list_connected_sides(part: Part, scene: DeclaredScene) -> tuple[str, ...]:
    """List the connected sides of the loudspeaker: ``front``, ``rear``, both or none."""
    return tuple(
        side for side in (FRONT, REAR) if side in part.pins or scene.is_target(part.name, side)
    )


def _read_semi_inductance(part: Part[LoudspeakerKeys]) -> SemiInductance | None:
    """Return the semi-inductance of the voice coil from the keys; None without one.

    Return None if the keys describe a constant inductance.

    Raises
    ------
    UsageError : a key has no effect, because another key is missing.
    """
    keys = part.keys
    if keys.ke is None and keys.rss is None:
        if keys.leb is not None:
            raise part.wrong(
                "leb",
                "the key `leb` applies only to a voice coil with a semi-inductance",
                got=f"{keys.leb:g} H without ke and rss",
                expected="the key `leb` together with `ke` or `rss`",
                hint="rename the key `leb` to `le`, or add the key `ke`",
            )
        return None
    if keys.ke is None and keys.le is None:
        raise part.wrong(
            "rss",
            "this resistance has no inductance in parallel",
            got=f"{keys.rss:g} Ohm without le and ke",
            expected="rss together with le or ke",
            hint="add the key `le` or `ke`, or delete the key `rss`",
        )
    values = (getattr(keys, name) or 0.0 for name in SemiInductance._fields)
    return SemiInductance(*values)


def _require_area_and_mass(part: Part[LoudspeakerKeys], driver: SpeakerParameters) -> None:
    """Raise an error if a driver with acoustic pins has no area or too little mass.

    The moving mass must exceed the mass of the air that it includes.
    """
    if driver.sd is None or driver.mmd is None:
        raise part.wrong(
            "sd",
            "a loudspeaker with acoustic pins needs the area of its cone",
            got="no sd",
            expected="the key `sd`; or `vas` and `cms`; or `vas`, `fs` and `mms`",
            hint='add for example  sd = "132 cm2"',
        )
    if driver.mmd <= 0:
        load = driver.mms - driver.mmd
        raise part.wrong(
            "mms",
            "the moving mass is smaller than the mass of the air that moves with the cone",
            got=f"{1e3 * driver.mms:.4g} g",
            expected=(
                f"more than the air mass of {1e3 * load:.4g} g, which is 16/3 rho a^3 for a cone "
                f"of {1e4 * driver.sd:.4g} cm2"
            ),
            hint="check the units of mms and sd",
        )


class Loudspeaker(PartWithPartNumber[LoudspeakerKeys], DeclaredPartWithMass[LoudspeakerKeys]):
    """Part type ``loudspeaker``: loudspeaker from its Thiele-Small parameters."""

    name, title = "loudspeaker", "loudspeaker from its Thiele-Small parameters"
    schema = LoudspeakerKeys
    source = "data sheet"
    noise = ("Rnoise",)
    moving_pins = ("cone", "frame")
    moving_frame_advice = (
        "for a moving frame, use a voice_coil between cone and frame, and a mass at each of them"
    )
    optional_pins: ClassVar[Mapping[str, str]] = {
        FRONT: f"pins.{FRONT}",
        REAR: f"pins.{REAR}",
        "ambient": f"pins.{FRONT} or pins.{REAR}",
    }
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

    def shared_data(self, part: Part[LoudspeakerKeys], scene: GovernedScene) -> SpeakerParameters:
        """Return the parameters of the loudspeaker, which other parts read."""
        return self.solve_parameters(part)

    def problems(self, part: Part[LoudspeakerKeys], scene: GovernedScene) -> Iterator[UsageError]:
        """Yield an error for each invalid key; warn about an unusual Q factor."""
        yield from super().problems(part, scene)
        driver = self._find_parameters(part, scene)
        hint = "are the data-sheet values and their units right?"
        yield from check_usual_range(f"{part.name}.qts", driver.qts, USUAL_QTS, hint)

    def solve_parameters(self, part: Part[LoudspeakerKeys]) -> SpeakerParameters:
        """Compute the driver parameters from the data-sheet keys of the part."""
        keys = part.keys
        stated = {key: value for key in DRIVER_UNITS if (value := getattr(keys, key)) is not None}
        for name in keys.tolerance:
            if name not in stated:
                raise part.wrong(
                    f"tolerance.{name}",
                    f"the part states a tolerance of {name}, but no value of {name}",
                    got=name,
                    expected=f"one of {list_candidates(name, stated)}",
                    hint=f"add the key `{name}` to {part.name}, or delete `tolerance.{name}`",
                )
        has_area = any(getattr(keys, key) for key in AREA_KEYS)
        names = tuple(name for name in EXAMPLE_WOOFER if name != "sd" or has_area)
        known = [key for key in DRIVER_UNITS if key not in AREA_KEYS or has_area]
        first = EXAMPLE_WOOFER | {name: stated[name] for name in names if name in stated}
        # The iteration must begin with a positive mmd, even for a large cone.
        if "mmd" in stated and "mms" not in stated:
            first["mms"] = stated["mmd"] + 2 * compute_baffle_air_mass(first["sd"])
        start = np.array(list(map(first.__getitem__, names)))
        relations = {key: make_relation(key, names) for key in known}
        tolerance = dict(keys.tolerance)
        suspects = part.overridden_keys
        values = StatedValues(
            part.name, stated, relations, start, DRIVER_UNITS, tolerance, {}, suspects
        )
        unknowns = dict(zip(names, values.solve().tolist(), strict=True))
        sizes = compute_thiele_small({"sd": EXAMPLE_WOOFER["sd"]} | unknowns)
        driver = SpeakerParameters(
            **{key: sizes[key] for key in DRIVER_PARAMETERS},
            le=INDUCTANCE_TIME * sizes["re"] if keys.le is None else keys.le,
            sd=unknowns.get("sd"),
            mmd=sizes["mmd"] if has_area else None,
            creep=keys.creep or 0.0,
            semi=_read_semi_inductance(part),
        )
        if driver.creep and driver.creep_resistance >= driver.rms:
            raise part.wrong(
                "creep",
                "creep alone has higher losses at fs than the whole suspension",
                got=f"{keys.creep:g}, which is {driver.creep_resistance:.4g} N s/m at fs",
                expected=f"less than the mechanical resistance rms = {driver.rms:.4g} N s/m",
                hint="enter a smaller creep, or a smaller qms",
            )
        return driver

    def _find_parameters(
        self, part: Part[LoudspeakerKeys], scene: GovernedScene
    ) -> SpeakerParameters:
        """Return the driver parameters that the scene stores, or compute the parameters."""
        record = scene.get_record(part)
        if record is None or not isinstance(record.shared_data, SpeakerParameters):
            return self.solve_parameters(part)
        return record.shared_data

    def make_declaration(self, part: Part[LoudspeakerKeys], scene: GovernedScene) -> Declaration:
        """Return the declaration of the part for the values of its keys."""
        driver, tolerance = self._find_parameters(part, scene), part.keys.tolerance
        params = []
        for key, (unit, words) in DRIVER_PARAMETERS.items():
            value = round_to_digits(getattr(driver, key))
            note = words + write_tolerance_note(value, tolerance.get(key))
            params.append(make_positive_parameter(key, value, unit, note))
        if driver.semi is None:
            params.append(
                make_positive_parameter("le", driver.le, "H", "inductance of the voice coil")
            )
        sides = _list_connected_sides(part, scene)
        if sides:
            _require_area_and_mass(part, driver)
        return declare_massless_driver(tuple(params), driver, sides)

    def pins(self, part: Part[LoudspeakerKeys], scene: JoinedScene) -> tuple[Terminal, ...]:
        """Return the pins of the part in the order of its subcircuit.

        The pin ``cone`` may stay unconnected.
        """
        pins = super().pins(part, scene)
        return tuple(replace(pin, required=False) if pin.name == "cone" else pin for pin in pins)

    def declare_mass(self, part: Part[LoudspeakerKeys], scene: WiredScene) -> Declaration:
        """Return the declaration of the moving mass of the loudspeaker.

        The declared mass excludes the air mass that connected parts of type ``radiation`` model.
        """
        driver = self._find_parameters(part, scene)
        sides = [
            side
            for side in _list_connected_sides(part, scene)
            if RADIATION in scene.list_joined_types(part.name, side)
        ]
        air = 0.0 if driver.sd is None else len(sides) * compute_baffle_air_mass(driver.sd)
        return declare_moving_mass(driver.mms, air, part.keys.added_mass or 0.0)

    def equilibrium_conditions(
        self, part: Part[LoudspeakerKeys], scene: WiredScene
    ) -> EquilibriumConditions:
        """Return the pins between which the suspension transmits a constant force.

        These pins are ``cone`` and ``frame``. As the cone has a mass, its velocity cannot jump.
        """
        return EquilibriumConditions((self.moving_pins,), inertial_pins=self.moving_pins[:1])

    def vectors(self, part: Part[LoudspeakerKeys], build: BuiltScene) -> Mapping[str, PartResult]:
        """Return the ngspice vectors: expressions of the part's results, keyed by name.

        The current and voltage of the voice coil are added to the results of the declaration.
        """
        result, n = dict(super().vectors(part, build)), part.name
        if f"{n}.{COIL}" in result:
            coil = current("i", "plus", "minus")
            result[f"{n}.v"] = get_across_vector(build, part, coil)
            result[f"{n}.i"] = replace(result[f"{n}.{COIL}"], leaves=("minus",))
        return result

    def law(self, part: Part[LoudspeakerKeys], build: BuiltScene) -> laws.Equations:
        """Return the part's law: its model equations, solved by kc2spice without ngspice."""
        equations, n = super().law(part, build), part.name
        results = dict(equations.results)
        if f"{n}.{COIL}" in results:
            results[f"{n}.v"] = laws.subtract_waves(f"{n}.plus", f"{n}.minus")
            results[f"{n}.i"] = results[f"{n}.{COIL}"]
        return replace(equations, results=results)

    def checks(
        self, part: Part[LoudspeakerKeys], build: BuiltScene, waves: Waveforms
    ) -> Iterator[Any]:
        """Yield the checks of the part after a run."""
        yield from super().checks(part, build, waves)
        limit, x = part.keys.xmax, waves.data.get(f"{part.name}.x")
        if limit is not None and x is not None:
            advice = "beyond xmax, force factor and compliance change: lower the drive"
            largest = float(np.abs(x).max())
            name, label = f"excursion of {part.name}", f"peak |excursion| of {part.name}"
            yield Check(name, largest, limit, "m", advice, "warn", label=label)

    def _compute_impedances(
        self, part: Part[LoudspeakerKeys], waves: Waveforms
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Return the frequencies [Hz] and impedances [Ohm] of a small-signal analysis."""
        known = [waves.data.get(f"{part.name}.{result}") for result in ("v", "i")]
        if "frequency" not in waves or known[0] is None or known[1] is None:
            return None
        return waves["frequency"].real, known[0] / known[1]

    def metrics(
        self, part: Part[LoudspeakerKeys], build: BuiltScene, waves: Waveforms
    ) -> Mapping[str, object]:
        """Return the metrics of the part, keyed by name."""
        result = self._compute_impedances(part, waves)
        if result is None:
            share = compute_efficiency(part, build.scene, waves) if "time" in waves else None
            return {} if share is None else {"efficiency": Metric(float(share[0]), "")}
        frequency, z = result
        rows = {
            "frequency_hz": Metric(frequency.tolist(), "Hz", curve=True),
            "impedance_ohm": Metric(np.abs(z).tolist(), "Ohm", curve=True),
        }
        size = np.abs(z)
        if 0 < np.argmax(size) < len(size) - 1:  # the frequency range contains the maximum
            peak, largest = find_response_maximum(frequency, size)
            rows["largest_impedance_hz"] = Metric(peak, "Hz")
            rows["largest_impedance_ohm"] = Metric(largest, "Ohm")
        share = compute_efficiency(part, build.scene, waves)
        return (
            rows if share is None else rows | {"efficiency": Metric(share.tolist(), "", curve=True)}
        )

    def figures(
        self, part: Part[LoudspeakerKeys], build: BuiltScene, waves: Waveforms
    ) -> Iterator[Figure]:
        """Yield the figures of the part for the report."""
        result = self._compute_impedances(part, waves)
        if result is not None:
            how = f"of the impedance at the pins of {part.name}: maximum at resonance."
            from kc2spice.parts.bodies._body_figures import plot_impedances

            yield plot_impedances(part.name, result[0], {"": result[1]}, how)
        x = waves.data.get(f"{part.name}.x")
        if x is not None:
            from kc2spice.parts.acoustics._displacement_figure import plot_displacements

            caption = "Displacement of the cone."
            if limit := part.keys.xmax:
                caption += f" The largest linear displacement is {format_quantity(limit, 'm')}."
            yield from plot_displacements(part.name, waves, {"": x}, caption)

    def _describe_air(
        self, part: Part[LoudspeakerKeys], scene: Scene, area: float, sides: tuple[str, ...]
    ) -> Iterator[str | NeglectedEffect]:
        """Yield a note on the air mass at each side of the cone.

        The note states which part contains the mass of the air.
        """
        load = f"{1e3 * compute_baffle_air_mass(area):.3g} g"
        for side in (FRONT, REAR):
            if side not in sides:
                yield NeglectedEffect(
                    f"radiation at the {side}",
                    f"mms includes an air load of {load} at the {side}",
                    "radiation resistance not estimated",
                )
            elif RADIATION in scene.list_joined_types(part.name, side):
                yield f"the radiation part models the air load at the {side}, {load} of mms"
            else:
                yield f"mms includes the air load at the {side}: {load}, as for a baffled piston"

    def notes(self, part: Part[LoudspeakerKeys], scene: Scene) -> Iterator[str | NeglectedEffect]:
        """Yield the assumptions of the model and the effects that it neglects."""
        driver = self._find_parameters(part, scene)
        peak = driver.re * (1 + driver.qms / driver.qes)
        yield f"fs {driver.fs:.4g} Hz, Qts {driver.qts:.4g}, impedance at fs {peak:.4g} Ω"
        yield NeglectedEffect(
            "large excursions", "Bl and compliance are constant", "see part voice_coil"
        )
        sides = _list_connected_sides(part, scene)
        if not sides:
            yield NeglectedEffect(
                "radiation", "mms includes the air load", "radiation resistance not estimated"
            )
        elif driver.sd is not None:
            yield from self._describe_air(part, scene, driver.sd, sides)
        if driver.semi is None:
            yield NeglectedEffect(
                "eddy currents in the pole", "le is constant", "impedance above 1 kHz"
            )
        elif driver.semi.ke:
            yield _describe_ladder(
                "ke", make_semi_inductance_ladder(), SEMI_INDUCTANCE_BAND, 1 / TWO_PI
            )
        if driver.creep:
            yield _describe_ladder("creep", fit_creep_ladder(), CREEP_BAND, driver.fs)
        yield from self.list_neglected_effects(part, scene)


def _describe_ladder(
    key: str, ladder: RelaxationLadder, band: tuple[float, float], unit: float
) -> str:
    """Describe the elements, the band and the error of a relaxation ladder as text.

    ``band`` contains the lowest and the highest frequency as multiples of ``unit`` [Hz].
    """
    low, high = (f"{unit * end:.3g}" for end in band)
    return (
        f"{key}: a ladder of {len(ladder.corners)} elements from {low} to {high} Hz, whose largest "
        f"error is {ladder.error:.2%}"
    )


register_part_type(Loudspeaker())
