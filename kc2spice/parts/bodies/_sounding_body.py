"""Bodies that radiate sound: warnings, neglected effects and sound level errors."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from itertools import chain
from typing import TYPE_CHECKING, Any

import numpy as np

from kc2spice.core.cache import load_or_build
from kc2spice.core.domains import ACOUSTIC
from kc2spice.core.figure import Figure, FileWriter
from kc2spice.core.progress import StageTimer
from kc2spice.core.si_prefix_format import format_quantity
from kc2spice.core.user_warnings import warn_user
from kc2spice.core.waveforms import Waveforms
from kc2spice.parts.acoustics._acoustic_part import AcousticPart
from kc2spice.parts.acoustics._fluids import FluidKeys
from kc2spice.parts.acoustics.radiation import RadiationKeys
from kc2spice.parts.bodies._body_ports import get_flow_name
from kc2spice.parts.bodies._linear_body import LinearBody
from kc2spice.parts.bodies._linear_body_keys import FieldKeysT
from kc2spice.rom.linear_model import LinearModel
from kc2spice.scene.checks import Metric
from kc2spice.scene.part_records import NeglectedEffect
from kc2spice.scene.scene_classes import BuiltScene, GovernedScene, Part, Scene

if TYPE_CHECKING:
    from kc2spice.bodies.undamped_models import FiniteElementModel
    from kc2spice.parts.bodies._face_response import FluidAtFace, LoadedFace
    from kc2spice.parts.bodies._face_sound_levels import FaceLevelEffects

MEAN_CAPTION = "Mean displacement of each radiating face along its outward normal."
# largest radius of a piston, relative to the radius of a circle with the area of its face, without
# a warning; the rim of a disc can increase the radius by a few percent
MAX_RADIUS_RATIO = 1.1
LEVEL_SOURCES = ("kc2spice.bodies", "kc2spice.fem", "kc2spice.linalg", "kc2spice.rom")


class SoundingBody(LinearBody[FieldKeysT]):
    """Meshed body with faces that can be connected to acoustic parts."""

    @abstractmethod
    def get_fe_model(self, part: Part[FieldKeysT], scene: GovernedScene) -> FiniteElementModel:
        """Return the full finite-element model with its mesh."""

    def make_models_on_rings(
        self,
        part: Part[FieldKeysT],
        scene: GovernedScene,
        node: float | None,
        changes: Iterable[float],
    ) -> dict[float, FiniteElementModel]:
        """Return full models on supporting rings, keyed by the diameter [m] of the ring.

        A free body is supported on its nodal circle, which has the diameter ``node``. ``changes``
        contains the relative changes of the ring's diameter. Diameters that are larger than the
        body are left out. If no ring supports the body, the returned dictionary is empty.
        """
        return {}

    def has_mirror_planes(self, part: Part[FieldKeysT]) -> bool:
        """Return whether the model is only a part of the body, cut at mirror planes."""
        return False

    def facing_fluids(self, part: Part[FieldKeysT], scene: Scene) -> dict[str, FluidAtFace]:
        """Return the fluid in front of each radiating face, keyed by port name."""
        from kc2spice.parts.bodies._face_response import FluidAtFace

        result = {}
        for port in self.used_ports(part, scene):
            if port.domain is not ACOUSTIC:
                continue
            facing = list[FluidAtFace]()
            for name, pin in scene.list_joined_pins(part.name, port.terminals[0]):
                kind, keys = scene.parts[name].type, scene.parts[name].keys
                if isinstance(kind, AcousticPart) and pin in kind.list_pressure_pins(
                    scene.parts[name]
                ):
                    assert isinstance(keys, FluidKeys)
                    radiation = keys if isinstance(keys, RadiationKeys) else None
                    volume = kind.get_fluid_volume(scene.parts[name])
                    facing.append(FluidAtFace((name,), keys.fluid, radiation, volume))
            if facing:
                direct = [item for item in facing if item.radiation is not None]
                others = direct[:1] or facing
                names = tuple(item.names[0] for item in others)
                volume = min(item.volume for item in others)
                result[port.name] = replace(others[0], names=names, volume=volume)
        return result

    def lightly_loaded_pins(self, part: Part[FieldKeysT], scene: Scene) -> set[str]:
        """Return the pins of faces with a light load: those that radiate into a gas."""
        facing = self.facing_fluids(part, scene)
        return {port for port, item in facing.items() if item.radiation and item.fluid.is_gas}

    def estimate_level_effects_by_port(
        self, part: Part[FieldKeysT], scene: Scene
    ) -> dict[str, FaceLevelEffects]:
        """Estimate effects of assumptions on each face's sound level, keyed by port."""
        result = {}
        for port, facing in self.facing_fluids(part, scene).items():
            levels = self._load_or_estimate_level_effects(part, scene, port, facing)
            if levels is not None:
                result[port] = levels
        return result

    def _load_or_estimate_level_effects(
        self, part: Part[FieldKeysT], scene: Scene, port: str, facing: FluidAtFace
    ) -> FaceLevelEffects | None:
        """Load or estimate the effects of assumptions on the sound level of a face.

        The result is loaded from the cache, or estimated with the full model.
        """
        from kc2spice.parts.acoustics._acoustic_load import collect_load
        from kc2spice.parts.bodies._face_response import MAX_MODES, LoadedFace
        from kc2spice.parts.bodies._face_sound_levels import FaceLevelEffects

        end = float(self.choose_reduction(part, scene).band[1])
        # A transient mainly excites the first mode, so only the first mode is compared with a
        # piston.
        count = MAX_MODES if scene.analysis.is_small_signal else 1
        faces = [item for item in self.used_ports(part, scene) if item.domain is ACOUSTIC]
        joined = tuple(item.name for item in faces)
        load = collect_load(scene, part.name, [item.terminals[0] for item in faces])
        radiation = facing.radiation
        key: dict[str, Any] = {
            "full": self.make_full_model_key(part, scene),
            "port": port,
            "end": end,
            "count": count,
            "fluid": facing.fluid.model_dump(mode="json"),
            "volume": facing.volume,
            "radiation": None
            if radiation is None
            else radiation.model_dump(mode="json", exclude={"motion"}),
            "load": {"ports": list(joined), **load.make_record()},
        }

        def estimate_effects() -> FaceLevelEffects | None:
            """Estimate the effects of assumptions about a face on the face's sound level.

            The estimate is computed with the full model.
            """
            face = LoadedFace(
                self.get_fe_model(part, scene), port, facing, joined, load, end, count
            )
            return self._estimate_level_effects(part, scene, face)

        def load_or_estimate_effects() -> FaceLevelEffects | None:
            """Load the assumptions' effects on the sound level, or estimate the effects."""
            sources = (*LEVEL_SOURCES, "kc2spice.parts.acoustics", "kc2spice.parts.bodies")
            return load_or_build(
                "face", key, estimate_effects, classes=(FaceLevelEffects,), sources=sources
            )

        return scene.workspace.get_or_compute(
            f"{port} of {part.name}", key, load_or_estimate_effects
        )

    def _estimate_level_effects(
        self, part: Part[FieldKeysT], scene: Scene, face: LoadedFace
    ) -> FaceLevelEffects | None:
        """Estimate level effects: how model assumptions change the sound level of a face.

        The assumptions concern the face and its support.
        """
        from kc2spice.parts.bodies._face_sound_levels import TOLERANCE, estimate_face_level_effects

        result = estimate_face_level_effects(face)
        if result is not None and self.has_mirror_planes(part):
            # The estimate without a baffle needs the shape of the whole face.
            result = replace(result, size=None, unbaffled=None)
        if result is None or result.detuned is None:
            return result
        rings = self.make_models_on_rings(part, scene, result.node, (-TOLERANCE, TOLERANCE))
        level, others = face.find_largest_level(result.resonance) if rings else 0.0, []
        for device in rings.values():
            changed = replace(face, device=device)
            others.append(changed.find_largest_level(result.resonance) - level)
        return replace(result, rings=tuple(rings), support=tuple(others))

    def build(
        self, part: Part[FieldKeysT], scene: Scene, clock: StageTimer, full: bool = False
    ) -> LinearModel | None:
        """Build the model of the body; warn about faces that do not move like a piston.

        If an acoustic part at a face states ``motion = "piston"``, there is no warning about this
        face.
        """
        from kc2spice.parts.bodies._face_sound_levels import describe_piston_difference

        result = super().build(part, scene, clock, full)
        facing = {} if full else self.facing_fluids(part, scene)
        if facing:
            self._warn_of_larger_radiators(part, scene, facing, result)
            for port, levels in self.estimate_level_effects_by_port(part, scene).items():
                name = f"{part.name}.{port}"
                text = describe_piston_difference(name, facing[port], levels)
                if text and not _states_piston_motion(facing[port].names, scene):
                    warn_user(text)
        return result

    def _warn_of_larger_radiators(
        self,
        part: Part[FieldKeysT],
        scene: Scene,
        facing_fluids: Mapping[str, FluidAtFace],
        model: LinearModel | None,
    ) -> None:
        """Warn about each radiating piston that is larger than the face to which it is joined.

        ``facing_fluids`` contains the fluid at each face, keyed by port. A face that several parts
        drive is not compared with its piston.
        """
        from kc2spice.bodies.solid_models import get_area_key

        if model is None or self.has_mirror_planes(part):
            return
        for port, facing in facing_fluids.items():
            keys, area = facing.radiation, model.facts.get(get_area_key(port))
            pins = scene.list_joined_pins(part.name, port)
            others = {name for name, _ in pins} - set(facing.names)
            moving = any(not isinstance(scene.parts[name].type, AcousticPart) for name in others)
            if keys is None or not area or keys.shape == "sphere" or moving:
                continue
            radius, face_radius = keys.surface_radius, float(np.sqrt(area / np.pi))
            if radius > MAX_RADIUS_RATIO * face_radius:
                key = "area" if keys.radius is None else "radius"
                warn_user(
                    f"{facing.names[0]}.{key}: the radiating piston, with a radius of "
                    f"{format_quantity(radius, 'm')}, is larger than {part.name}.{port}, whose "
                    f"area is that of a circle with a radius of {format_quantity(face_radius, 'm')}"
                    f": lower {key}, unless another surface radiates the sound"
                )

    def list_neglected_effects(
        self, part: Part[FieldKeysT], scene: Scene
    ) -> Iterator[NeglectedEffect]:
        """Yield the effects that the models of the body and of its sound neglect."""
        yield from super().list_neglected_effects(part, scene)
        facing = self.facing_fluids(part, scene)
        if not facing:
            return
        from kc2spice.parts.bodies._face_sound_levels import list_level_effects

        effects: dict[NeglectedEffect, None] = {}
        for port, levels in self.estimate_level_effects_by_port(part, scene).items():
            direct = facing[port].radiation is not None
            rows = list_level_effects(part.name, port, levels, direct=direct)
            effects |= dict.fromkeys(rows)
        yield from effects

    def figures(
        self, part: Part[FieldKeysT], build: BuiltScene, waves: Waveforms
    ) -> Iterator[Figure | FileWriter]:
        """Return the figures of the part, and the writers of its additional output files."""
        faces = self._plot_face_displacements(part, build, waves)
        return chain(super().figures(part, build, waves), faces)

    def _plot_face_displacements(
        self, part: Part[FieldKeysT], build: BuiltScene, waves: Waveforms
    ) -> Iterator[Figure]:
        """Yield the figure with the mean displacement of each radiating face."""
        displacements = self._face_displacements(part, build, waves)
        if not displacements:
            return
        from kc2spice.parts.acoustics._displacement_figure import plot_displacements

        caption = MEAN_CAPTION
        if "frequency" in waves:
            for port, levels in self.estimate_level_effects_by_port(part, build.scene).items():
                if port in displacements:
                    caption += f" {_describe_peak(port, levels, waves, displacements[port])}"
        yield from plot_displacements(
            part.name, waves, displacements, caption, quantity="mean displacement"
        )

    def _face_displacements(
        self, part: Part[FieldKeysT], build: BuiltScene, waves: Waveforms
    ) -> dict[str, np.ndarray]:
        """Return the mean displacement [m] of each face with a recorded volume velocity."""
        from kc2spice.bodies.solid_models import get_area_key
        from kc2spice.parts.acoustics._displacement_figure import integrate_flow

        result, model = {}, build.model(part, LinearModel)
        for port in self.used_ports(part, build.scene):
            flow = get_flow_name(part.name, model.ports, port) if port.domain is ACOUSTIC else ""
            area = model.facts.get(get_area_key(port.name))
            if flow in waves and area:
                # A positive volume velocity into the pin of a face moves the face inwards.
                result[port.name] = -integrate_flow(waves, waves[flow]) / area
        return result

    def metrics(
        self, part: Part[FieldKeysT], build: BuiltScene, waves: Waveforms
    ) -> Mapping[str, object]:
        """Return the metrics of the part, keyed by name."""
        result = super().metrics(part, build, waves)
        if not self.facing_fluids(part, build.scene):
            return result
        faces = self.estimate_level_effects_by_port(part, build.scene).values()
        totals = [levels.total_effect for levels in faces if levels.total_effect is not None]
        nodes = [levels.node for levels in faces if levels.node is not None]
        error = {"level_error_db": Metric(max(totals), "dB")} if totals else {}
        node = {"nodal_circle_m": Metric(nodes[0], "m")} if nodes else {}
        return {**error, **result, **node}


def _states_piston_motion(names: Iterable[str], scene: Scene) -> bool:
    """Return whether a part at a face states that the face moves like a piston."""
    keys = (scene.parts[name].keys for name in names)
    return any(isinstance(item, FluidKeys) and item.motion is not None for item in keys)


def _describe_peak(
    port: str, levels: FaceLevelEffects, waves: Waveforms, displacement: np.ndarray
) -> str:
    """Return a sentence on the largest displacement of a face at its resonance.

    The largest displacement is the product of the mean displacement and ``levels.peak``.
    """
    place = levels.resonance
    mean = float(np.interp(place, waves.scale.real, np.abs(displacement)))
    return (
        f"At {format_quantity(float(f'{place:.4g}'), 'Hz')}, the largest displacement of {port} is "
        f"about {levels.peak:.2g} times the mean: {format_quantity(levels.peak * mean, 'm', 2)}."
    )
