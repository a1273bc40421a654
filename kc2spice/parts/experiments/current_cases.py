"""The part ``current_cases``: force of two coils on a sphere versus its height.

Fig. 6 of Schütz, Maeter and Bechtold, Actuators 10 (2021) 279, shows the force. The force is
computed for every pair of currents from a list.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import product

import numpy as np
from pydantic import Field

from kc2spice.core import constitutive_laws as laws
from kc2spice.core.domains import DISPLACEMENT, TRANSLATION
from kc2spice.core.magnets import MagnetostaticTable
from kc2spice.core.quantities import Current, Section
from kc2spice.core.waveforms import Waveforms, make_constant_waveform
from kc2spice.netlist.circuit import Element, Item
from kc2spice.netlist.number_and_name_spelling import format_number
from kc2spice.netlist.shared_cards import Line, attach_comments
from kc2spice.parts.magnetics.ring_magnet_coils import RingMagnetCoilsKeys
from kc2spice.parts.mechanics.sphere import find_sphere
from kc2spice.physics import coils
from kc2spice.scene.checks import SOLUTION_PAIRS, Check, Gate, Metric
from kc2spice.scene.part_records import Governed, PartResult, SweptSource
from kc2spice.scene.parttype import register_part_type
from kc2spice.scene.scene_classes import (
    GROUND,
    BuiltScene,
    DeclaredScene,
    JoinedScene,
    Part,
    PartType,
    Scene,
    Terminal,
    WiredScene,
)

# number of heights at which the force is computed: five for each segment of the table
LOOKUP_HEIGHTS = 2001


class CurrentCasesKeys(Section):
    """Keys of a force experiment: the currents in each coil.

    A dc sweep moves the sphere through all heights of the force table.
    """

    currents: tuple[Current, ...] = Field(
        (-0.1, 0.0, 0.1),
        min_length=1,
        max_length=1000,
        description=(
            "List of coil currents. The force is computed for every combination of one listed "
            "current in the lower coil and one listed current in the upper coil"
        ),
    )


class CurrentCases(PartType[CurrentCasesKeys]):
    """Part type ``current_cases``: force on a sphere for several cases of currents.

    The force of two coils is computed as a function of the height of the sphere, for several pairs
    of currents.
    """

    name = "current_cases"
    title = "force on a sphere versus height for every pair of coil currents"
    schema = CurrentCasesKeys
    source = "ideal sources"

    def generate_tables(
        self, part: Part[CurrentCasesKeys], data: Mapping[str, object]
    ) -> Mapping[str, Mapping[str, object]]:
        """Return a mapping with one table, ``analysis``: a dc sweep of the height."""
        sweep = {"type": "dc", "sweep": f"{part.name}.height", "points": LOOKUP_HEIGHTS}
        return {"analysis": sweep}

    def pins(self, part: Part[CurrentCasesKeys], scene: JoinedScene) -> tuple[Terminal, ...]:
        """Return the pins of the part in the order of its subcircuit."""
        height = Terminal.signal("y", DISPLACEMENT, signal_out=True)
        return height, Terminal.make_rate_pin("v", TRANSLATION, GROUND)

    def governed_parts(
        self, part: Part[CurrentCasesKeys], scene: DeclaredScene
    ) -> Mapping[str, Governed]:
        """Return the sphere, which this experiment moves, and the coils, which it copies."""
        return {_find_sphere(part, scene): "moved", _find_coils(part, scene).name: "copied"}

    def cards(self, part: Part[CurrentCasesKeys], build: BuiltScene) -> tuple[Item, ...]:
        """Return the cards of the part at the top level of the deck."""
        library, y = build.libraries[_find_coils(part, build.scene).name], build.get_net(part, "y")
        height = Element.from_words(build.get_inner_name(part, "Vheight"), y, "0", "0")
        cards: list[Line] = [height.with_unit(DISPLACEMENT.pin_unit)]
        for k, (lower, upper) in enumerate(list_current_pairs(part)):
            a, b = build.get_inner_name(part, f"lower{k}"), build.get_inner_name(part, f"upper{k}")
            force = build.get_inner_name(part, f"force{k}")
            cards += [
                f"* {format_number(lower)} A in the lower, "
                f"{format_number(upper)} A in the upper coil",
                Element.from_words(
                    build.get_inner_name(part, f"Xcatch{k}"), a, "0", b, "0", y, force, "0", library
                ),
                Element.from_words(build.get_inner_name(part, f"Ilower{k}"), "0", a, lower),
                Element.from_words(build.get_inner_name(part, f"Iupper{k}"), "0", b, upper),
                Element.from_words(build.get_inner_name(part, f"Vforce{k}"), force, "0", "0"),
            ]
        return attach_comments(cards)

    def list_inner_names(
        self, part: Part[CurrentCasesKeys], scene: WiredScene
    ) -> Iterator[tuple[str, ...]]:
        """Yield the names of inner nodes and elements, one set per pair of coil currents."""
        yield ("Vheight",)
        words = "lower", "upper", "force", "Xcatch", "Ilower", "Iupper", "Vforce"
        for k, word in product(range(len(list_current_pairs(part))), words):
            yield (f"{word}{k}",)

    def settable_quantities(
        self, part: Part[CurrentCasesKeys], build: BuiltScene
    ) -> Mapping[str, SweptSource]:
        """Return the settable quantity ``height``: the source that a dc sweep varies."""
        keys = _find_coils(part, build.scene).keys
        heights = keys.y_min + keys.shift, keys.y_max + keys.shift
        return {
            "height": SweptSource(
                build.get_inner_name(part, "Vheight"), DISPLACEMENT.pin_value_per_si_unit, heights
            )
        }

    def vectors(self, part: Part[CurrentCasesKeys], build: BuiltScene) -> Mapping[str, PartResult]:
        """Return the ngspice vectors: expressions of the part's results, keyed by name."""
        result = {f"{_find_sphere(part, build.scene)}.y": build.get_pin_vector(part, "y")}
        for k, name in enumerate(_list_force_names(part, build)):
            result[name] = PartResult(
                f"i({build.get_inner_name(part, f'Vforce{k}').lower()})", 1.0, "N"
            )
        return result

    def metrics(
        self, part: Part[CurrentCasesKeys], build: BuiltScene, waves: Waveforms
    ) -> Mapping[str, object]:
        """Return the metrics of the part, keyed by name."""
        forces = _read_recorded_forces(part, build, waves)
        return {
            "force_max_n": Metric(float(np.abs(forces).max()), "N"),
            "position_m": Metric(waves[f"{_find_sphere(part, build.scene)}.y"].tolist(), "m"),
            "current_pairs_a": Metric(list(map(list, list_current_pairs(part))), "A"),
            "force_n": Metric(forces.tolist(), "N"),
        }

    def law(self, part: Part[CurrentCasesKeys], build: BuiltScene) -> laws.Equations:
        """Return the model equations of the coils, repeated for each pair of currents.

        A source prescribes the height of the sphere on which the coils act.
        """
        n, pulled, fed = part.name, _find_sphere(part, build.scene), _find_coils(part, build.scene)
        table, height = build.model(fed, MagnetostaticTable), [f"{n}.out"]
        result: list[laws.Law] = [laws.IdealSource(n, "displacement", make_constant_waveform(0.0))]
        results = {f"{pulled}.y": laws.scale_wave(f"{n}.out")}
        for k, force in enumerate(_list_force_names(part, build)):
            case = f"{fed.name} {k}"  # with a space, the name differs from all part names
            lower, upper = list_current_pairs(part)[k]
            declared = coils.declare_prescribed_currents()
            result.append(coils.make_law(case, declared, table, lower=lower, upper=upper))
            height.append(f"{case}.y")
            results[force] = laws.scale_wave(f"{case}.y.through", -1.0)
        pins, sweeps = (("y", f"{n}.out"),), {"height": (n, 1.0)}
        return laws.Equations(tuple(result), pins, results, sweeps, (tuple(height),))

    def checks(
        self, part: Part[CurrentCasesKeys], build: BuiltScene, waves: Waveforms
    ) -> Iterator[Check | Gate]:
        """Yield checks of the force table: jumps of its slope, and errors of the force.

        The check limits the jumps of the slope between segments of the table. Each segment of the
        force table contains several heights of the sweep. Therefore, the slope before a jump is
        computed in one segment, and the slope after the jump in the next segment.
        """
        forces = _read_recorded_forces(part, build, waves)
        slope = np.diff(forces, axis=1) / np.diff(waves[f"{_find_sphere(part, build.scene)}.y"])
        jump = float(np.abs(np.diff(slope, axis=1)).max() / np.abs(slope).max())
        limit = build.scene.gates.lookup_slope
        advice = f"raise {_find_coils(part, build.scene).name}.points"
        name, unit = "slope discontinuity of the force table", "of the largest slope"
        yield Check(name, jump, limit, unit, advice, "warn")
        gates = build.scene.gates
        limits = dict.fromkeys(SOLUTION_PAIRS, gates.field) | {"ngspice_vs_rom": gates.lookup}
        of = f"{_find_coils(part, build.scene).name}.force.*"
        yield Gate("force, relative to the largest force", of, limits, "largest", is_main=True)

    def notes(self, part: Part[CurrentCasesKeys], scene: Scene) -> Iterator[str]:
        """Yield the assumptions of the model and the effects that it neglects."""
        yield f"{len(list_current_pairs(part))} pairs of currents"


def list_current_pairs(part: Part[CurrentCasesKeys]) -> list[tuple[float, float]]:
    """Return all pairs of currents [A] in the lower and the upper coil."""
    return [*product(part.keys.currents, part.keys.currents)]


def _list_force_names(part: Part[CurrentCasesKeys], build: BuiltScene) -> list[str]:
    """Return the result names of the forces, one for each current pair."""
    name = _find_coils(part, build.scene).name
    return [f"{name}.force.{k}" for k in range(len(list_current_pairs(part)))]


def _read_recorded_forces(
    part: Part[CurrentCasesKeys], build: BuiltScene, waves: Waveforms
) -> np.ndarray:
    """Return the recorded forces [N] as an array of shape (current pairs, heights)."""
    return np.array([*map(waves.__getitem__, _list_force_names(part, build))])


def _find_coils(part: Part[CurrentCasesKeys], scene: DeclaredScene) -> Part[RingMagnetCoilsKeys]:
    """Return the coils of the experiment."""
    return scene.find_partner(part, "ring_magnet_coils").with_schema(RingMagnetCoilsKeys)


def _find_sphere(part: Part[CurrentCasesKeys], scene: DeclaredScene) -> str:
    """Return the name of the sphere on which the coils of the experiment act."""
    return find_sphere(_find_coils(part, scene), scene).name


register_part_type(CurrentCases())
