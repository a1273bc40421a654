"""Bodies with a mesh, whose inner fields a run can compute.

If the key ``fields`` is set, the full model computes stress and electric field from the waveforms
at the ports (:mod:`kc2spice.bodies.fields`). The results for each material are the largest
principal stress and the largest electric field, each with its limit. A run also draws the body at
the instant of the largest stress, and writes the fields at this instant to a VTU file. In an ``ac``
analysis, the results are the largest amplitudes at the largest resonances. An ``ac`` analysis also
draws the shapes of the lowest modes.
"""

from __future__ import annotations

import json
import re
from abc import abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import filterfalse
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from kc2spice.core.domains import ACCELERATION, BASE, TRANSLATION
from kc2spice.core.errors import UsageError, wrong
from kc2spice.core.figure import Curve, Figure, FileWriter, Panel, Shape
from kc2spice.core.key_actions import DeleteKey
from kc2spice.core.mesh_error_descriptions import MESH_LIMIT_NAME, list_limited_errors
from kc2spice.core.progress import StageTimer
from kc2spice.core.quantities import USUAL_Q_FACTOR
from kc2spice.core.si_prefix_format import format_quantity
from kc2spice.core.waveforms import Waveforms
from kc2spice.fem.body_keys import DampingKeys
from kc2spice.fem.materials import Material, advise_missing_ceramic_keys
from kc2spice.parts.bodies._body_figures import draw_deformed_body, draw_modes
from kc2spice.parts.bodies._body_model import find_damping
from kc2spice.parts.bodies._body_ports import get_wave_name
from kc2spice.parts.bodies._linear_body_keys import FieldKeys, FieldKeysT
from kc2spice.parts.bodies._material_losses import (
    describe_unused_loss_tangents,
    find_unused_losses,
    list_neglected_losses,
)
from kc2spice.parts.bodies._neglected_effects import (
    Envelope,
    estimate_neglected_effects,
    make_beam_envelope,
    make_disc_envelope,
)
from kc2spice.parts.bodies._sounding_body import SoundingBody
from kc2spice.physics.conductors import OPTIONAL_HEAT_PINS
from kc2spice.rom.linear_model import LinearModel, Port
from kc2spice.scene.checks import Check, Metric, RunEnergyBalance
from kc2spice.scene.part_records import NeglectedEffect
from kc2spice.scene.plausibility import UnusualValueError, check_layers
from kc2spice.scene.scene_classes import (
    GROUND,
    BuiltScene,
    DeclaredScene,
    GovernedScene,
    Part,
    Scene,
)

if TYPE_CHECKING:
    from kc2spice.bodies.fields import Extreme, NodalMotion
    from kc2spice.bodies.solid_models import BondedBlocks
    from kc2spice.bodies.undamped_models import FiniteElementModel

_COARSE_MESH_ADVICE = (
    "refine the mesh by the key `refine`, or set `error_budget`, which refines all settings"
)
_UNRESOLVED_ADVICE = "the model is wrong above the limit: lower the frequency, or refine the mesh"
# smallest plausible share of the strain energy in a ceramic part of a body
MIN_ENERGY_SHARE = 0.01
MAX_DRAWN_MODES = 6  # number of drawn modes, starting from the lowest
_SINGULARITY_ADVICE = (
    "check the stress in the VTU file: at clamp edges and re-entrant corners, the computed stress "
    "grows without limit as the mesh is refined"
)
# For each quantity: word and unit in the name of its metric, label of its plot axis, and
# consequence of exceeding its limit.
_FIELD_DESCRIPTIONS = {
    "principal_stress": (
        "stress", "pa", "largest principal stress in MPa",
        f"the material may crack; {_SINGULARITY_ADVICE}",
    ),
    "electric_field": (
        "field", "v_m", "largest field in kV/mm", "the material may break down; lower the drive",
    ),
    "opposing_field": (
        "opposing_field", "v_m", "largest field opposite to the poling in kV/mm",
        "the material may depolarise; drive it in its poling direction, or lower the drive",
    ),
}  # fmt: skip


@dataclass(frozen=True)
class RecoveredFields:
    """Motion of a body in a run, and the extremes of stress and electric field."""

    motion: NodalMotion
    extremes: tuple[Extreme, ...]

    def select_extremes(self, quantity: str) -> list[Extreme]:
        """Return the extremes of one field quantity, one for each material."""
        return [item for item in self.extremes if item.quantity == quantity]

    @property
    def worst_stress(self) -> Extreme:
        """Stress extreme closest to its limit; without limits, the largest stress."""
        stresses = self.select_extremes("principal_stress")
        limited = [item for item in stresses if item.limit]
        if not limited:
            return max(stresses, key=lambda item: item.value)
        return max(limited, key=lambda item: item.value / (item.limit or 1.0))


def check_q_factor(
    name: str, damping: DampingKeys, materials: Iterable[Material]
) -> Iterator[UsageError]:
    """Yield a warning if the Q factor of a body far exceeds that of its materials.

    The reciprocal of a body's Q factor is the mean of the reciprocal Q factors of its materials,
    weighted by strain energy. A material with the share w of the strain energy and the Q factor Q
    therefore limits the Q factor of the body to Q / w. Materials without a known Q factor, such as
    quartz and silicon, set no limit.
    """
    q_factors = [(one.quality, one.name) for one in materials if one.quality is not None]
    key = damping.stated_loss_key
    if not q_factors or key in ("", "per_material"):
        return
    lowest, material = min(q_factors)
    limit, q_factor = lowest / MIN_ENERGY_SHARE, 0.5 / damping.zeta
    if limit < q_factor < USUAL_Q_FACTOR.high:
        yield UnusualValueError(
            f"more than {1 / MIN_ENERGY_SHARE:g} times the Q factor of {material}, {lowest:g}",
            where=f"{name}.damping.{key}",
            got=f"a Q factor of {q_factor:g}",
            hint=f"a plausible Q factor of this body is at most {limit:g}",
        )


class MeshedBody(SoundingBody[FieldKeysT]):
    """Base class of bodies with a mesh and the key ``fields``."""

    @abstractmethod
    def envelope(self, part: Part[FieldKeysT], scene: DeclaredScene) -> Envelope:
        """Return the outer size of the body, used to estimate neglected effects."""

    @abstractmethod
    def describe_support(self, part: Part[FieldKeysT]) -> str:
        """Describe how the body is supported, for the list of neglected effects."""

    def list_neglected_effects(
        self, part: Part[FieldKeysT], scene: Scene
    ) -> Iterator[NeglectedEffect]:
        """Yield the effects of air, glue, electrodes and support that the model neglects."""
        yield from super().list_neglected_effects(part, scene)
        yield from list_neglected_losses(
            part.name, part.keys, find_damping(part), self.base_material
        )
        yield from estimate_neglected_effects(
            part.name,
            self.envelope(part, scene),
            self.describe_support(part),
            heated=self.gives_off_heat(part, scene),
        )

    @abstractmethod
    def make_fe_model(self, part: Part[FieldKeysT], scene: GovernedScene) -> FiniteElementModel:
        """Build the finite-element model of the whole body, with its mesh."""

    def get_fe_model(self, part: Part[FieldKeysT], scene: GovernedScene) -> FiniteElementModel:
        """Return the finite-element model of the body, from the workspace if possible.

        The workspace contains the latest model of each part type, because consecutive scenes often
        reduce the same model differently.
        """
        key = json.dumps([part.name, self.make_full_model_key(part, scene)], sort_keys=True)
        return scene.workspace.get_or_compute(
            f"device {self.name}", key, lambda: self.make_fe_model(part, scene)
        )

    def make_full_model(
        self, part: Part[FieldKeysT], scene: GovernedScene, clock: StageTimer
    ) -> LinearModel:
        """Return the unreduced linear model of the body with its ports."""
        with clock.time_stage("assemble", f"mesh and matrices of {part.name}"):
            return self.get_fe_model(part, scene).model

    def problems(self, part: Part[FieldKeysT], scene: GovernedScene) -> Iterator[UsageError]:
        """Yield an error for each invalid key of the part."""
        yield from super().problems(part, scene)
        yield from find_field_problems(part, scene, harmonic=True)
        with suppress(UsageError):  # another check reports an invalid material
            yield from find_unused_losses(
                part.name, part.keys, find_damping(part), self.base_material
            )

    def notes(self, part: Part[FieldKeysT], scene: Scene) -> Iterator[str | NeglectedEffect]:
        """Yield the assumptions of the model and the effects that it neglects."""
        yield from super().notes(part, scene)
        yield from describe_unused_loss_tangents(part.keys, find_damping(part), self.base_material)

    def metrics(
        self, part: Part[FieldKeysT], build: BuiltScene, waves: Waveforms
    ) -> Mapping[str, object]:
        """Return the metrics of the part, keyed by name."""
        result = dict(super().metrics(part, build, waves))
        recovered = self.recover_inner_fields(part, build, waves)
        if recovered is None:
            return result
        for item in recovered.extremes:
            quantity, word, *_ = _FIELD_DESCRIPTIONS[item.quantity]
            of = f"{make_metric_word(item.material)}_{word}"
            result[f"{quantity}_{of}"] = Metric(item.value, item.unit)
            if item.limit is not None:
                result[f"{quantity}_limit_{of}"] = Metric(item.limit, item.unit)
        at = recovered.worst_stress.at
        if "frequency" in waves:
            return result | {"worst_stress_frequency_hz": Metric(at, "Hz")}
        return result | {"worst_stress_time_s": Metric(at, "s")}

    def checks(
        self, part: Part[FieldKeysT], build: BuiltScene, waves: Waveforms
    ) -> Iterator[Check | RunEnergyBalance]:
        """Yield checks of the body: mesh errors, stress and electric field."""
        yield from super().checks(part, build, waves)
        yield from check_mesh(part, build, waves)
        recovered = self.recover_inner_fields(part, build, waves)
        for item in recovered.extremes if recovered else ():
            if item.limit is not None:
                what = item.quantity.replace("_", " ")
                name = f"{what} in {item.material} of {part.name}"
                if "frequency" in waves:
                    name += f" at {format_quantity(item.at, 'Hz')}"
                advice = _FIELD_DESCRIPTIONS[item.quantity][-1]
                yield Check(name, item.value, item.limit, item.unit, advice, "warn")

    def figures(
        self, part: Part[FieldKeysT], build: BuiltScene, waves: Waveforms
    ) -> Iterator[Figure | FileWriter]:
        """Yield the figures of the part, and the writers of its additional output files."""
        yield from super().figures(part, build, waves)
        if part.keys.fields:
            from kc2spice.bodies.fields import compute_lowest_modes

            device, model = (
                self.get_fe_model(part, build.scene),
                build.model(part, LinearModel),
            )
            end = np.inf if model.certificate is None else model.certificate.band_hz[1]
            hertz, columns = compute_lowest_modes(device, MAX_DRAWN_MODES, end)
            if hertz.size:
                name, title = f"{part.name}_modes", f"Modes of {part.name}"
                caption = (
                    "Undamped modes that the ports excite, electrodes shorted; the colours show "
                )
                caption += "displacements relative to the largest."
                panels = tuple(draw_modes(device, hertz, columns))
                yield Figure(name, title, caption, panels, columns=3)
        recovered = self.recover_inner_fields(part, build, waves)
        if recovered is not None:
            from kc2spice.bodies.fields import write_vtu

            harmonic, motion = "frequency" in waves, recovered.motion
            if not harmonic:
                yield _plot_extremes(part.name, recovered)
            worst, device = recovered.worst_stress, motion.device
            kind = "stress closest to its limit" if worst.limit else "largest stress"
            summary = f"{kind}: {1e-6 * worst.value:.3g} MPa in "
            place = format_quantity(worst.at, "Hz") if harmonic else f"{1e3 * worst.at:.4g} ms"
            states = {"": (motion.get_sample(worst.sample), f"{place}; {summary}{worst.material}")}
            for k, t in enumerate(list_field_instants(part), 1):
                state = motion.find_nearest_sample(t)
                states[f"_{k}"] = state, f"{1e3 * t:.4g} ms, a time listed in {part.name}.fields"
            for stem, (state, what) in states.items():
                panel, factor = draw_deformed_body(device, *state)
                caption = f"At {what}; displacements scaled by {factor:g}."
                name = f"{part.name}_deformed{stem}"
                yield Figure(name, f"Deformed {part.name}", caption, (panel,))
                fields = partial(write_vtu, device=device, z=state[0], voltages=state[1])
                yield FileWriter(f"{part.name}_fields{stem}.vtu", fields)

    def recover_inner_fields(
        self, part: Part[FieldKeysT], build: BuiltScene, waves: Waveforms
    ) -> RecoveredFields | None:
        """Return motion, stress and electric field inside the body during a run.

        The result is None without the key ``fields``, and in analyses other than ``transient`` and
        ``ac``.

        Raises
        ------
        UsageError : the run does not record the load of a port.
        """
        if not part.keys.fields or not {"time", "frequency"} & set(waves):
            return None

        def recover_fields() -> tuple[Waveforms, RecoveredFields]:
            """Compute the waveforms of the fields and their extremes in each material."""
            from kc2spice.bodies.fields import find_extremes, recover_motion, recover_vibration

            loads = self.list_port_loads(part, build, waves)
            port_names = self.used_port_names(part, build.scene)
            if unknown := [*filterfalse(loads.__contains__, port_names)]:
                raise wrong(
                    f"{part.name}.fields",
                    "fields cannot be computed, because the run does not record all port loads",
                    got=f"a load of port {unknown[0]} that the run does not record",
                    expected="only contacts, springs, dampers, masses and sources at the port",
                    hint="connect only these part types to the port, or delete the key `fields`",
                )
            device = self.get_fe_model(part, build.scene)
            if "time" in waves:
                motion = recover_motion(device, waves["time"], loads)
                return waves, RecoveredFields(motion, tuple(find_extremes(motion)))
            motion = recover_vibration(device, waves["frequency"], loads)
            extremes = find_extremes(motion, np.arange(motion.scale.size))
            return waves, RecoveredFields(motion, tuple(extremes))

        # The key ``id(waves)`` stays unique, because the stored result refers to ``waves``.
        kind = f"fields of {part.name}"
        return build.workspace.get_or_compute(kind, id(waves), recover_fields)[1]


def find_field_problems(
    part: Part[FieldKeys], scene: GovernedScene, *, harmonic: bool
) -> Iterator[UsageError]:
    """Yield the error of an invalid key ``fields``.

    The key ``fields`` is valid only in transients. With the argument ``harmonic``, ``fields =
    true`` is also valid in an ac analysis, which then computes amplitudes.
    """
    kind, instants = scene.analysis.type, list_field_instants(part)
    computed = harmonic and kind == "ac" and not instants
    if kind != "transient" and part.keys.fields and not computed:
        expected = "a transient analysis, or fields = false"
        if harmonic:
            expected = "a transient analysis, fields = true in an ac analysis, or fields = false"
        yield wrong(
            f"{part.name}.fields",
            "this value of the key `fields` needs a transient analysis",
            got=f"analysis {kind}",
            expected=expected,
            hint=DeleteKey("fields"),
        )
        return
    outside = [t for t in instants if not 0 <= t <= scene.stop_time]
    if outside:
        expected = f"times from 0 to {scene.stop_time:g} s"
        yield wrong(
            f"{part.name}.fields",
            "a time in the key `fields` is outside the simulated time range",
            got=f"{outside[0]:g} s",
            expected=expected,
            hint=f"write a time from 0 to {scene.stop_time:g} s in its place",
        )


def check_mesh(part: Part, build: BuiltScene, waves: Waveforms) -> Iterator[Check]:
    """Yield checks of the mesh after a run: error estimates and highest frequency.

    The mesh must resolve all frequencies up to the end of the frequency range. In a transient, the
    mesh must resolve the band of the reduced model.
    """
    certificate = build.model(part, LinearModel).certificate
    highest = 0.0 if certificate is None else certificate.band_hz[1]
    if "frequency" in waves:
        highest = float(waves["frequency"].real.max())
    yield from check_mesh_values(part.name, build.get_model_values(part), highest)


def check_mesh_values(name: str, values: Mapping[str, float], highest: float) -> Iterator[Check]:
    """Yield checks of mesh errors, and of a frequency that the mesh does not resolve.

    ``name`` is the name of the part, ``values`` are the values of its model, and ``highest`` [Hz]
    is the highest frequency at which the model is used.
    """
    for words, error, limit in list_limited_errors(values):
        yield Check(
            f"mesh of {name}, {words}",
            error,
            limit,
            "relative, estimated",
            _COARSE_MESH_ADVICE,
            "warn",
            label=f"mesh error of {name}, {words}",
        )
    resolved = values.get(MESH_LIMIT_NAME)
    if resolved is not None and highest > resolved:
        words, label = f"mesh of {name}, highest frequency", f"highest frequency, mesh of {name}"
        yield Check(words, highest, resolved, "Hz", _UNRESOLVED_ADVICE, "warn", label=label)


def list_field_instants(part: Part[FieldKeys]) -> tuple[float, ...]:
    """Return the times [s] listed in the key ``fields``; empty without a list."""
    return part.keys.fields if isinstance(part.keys.fields, tuple) else ()


def list_layer_materials(layers: Iterable[Any]) -> dict[str, str | dict[str, Any]]:
    """Return the name or the table of the material of each layer, by the key of the material."""
    return {f"layers[{i}].material": layer.material for i, layer in enumerate(layers)}


def make_missing_ceramic_error(
    where: str, problem: str, layers: Iterable[Any], materials: Iterable[Material]
) -> UsageError:
    """Make the error for a part at ``where`` without a layer of a piezoelectric material."""
    return wrong(
        f"{where}.layers",
        problem,
        got=", ".join(f"layers[{i}] ({one.name})" for i, one in enumerate(materials)),
        expected='a layer of a piezoelectric material, such as "PZT-5A"',
        hint=advise_missing_ceramic_keys(list_layer_materials(layers))
        or 'write  material = "PZT-5A"  in one of the layers',
    )


class BondedBody(MeshedBody[FieldKeysT]):
    """Base class of bodies that consist of bonded blocks.

    The function ``structure`` derives the blocks from the keys of the part. A block is a box or
    ring of one material.
    """

    discretisations = ("mesh.refine",)
    optional_pins: ClassVar[Mapping[str, str]] = {
        "front_face": "pins.front_face",
        "back_face": "pins.back_face",
        **OPTIONAL_HEAT_PINS,
    }
    # whether models omit the port ``base`` of a moving support in scenes that do not join ``base``
    base_is_optional: ClassVar[bool] = False
    structure: Callable[[Any, str], BondedBlocks]

    def is_clamped(self, part: Part[FieldKeysT]) -> bool:
        """Return whether the rim is clamped, so that air cannot flow around the body."""
        return False

    def make_bonded_blocks(self, part: Part[FieldKeysT]) -> BondedBlocks:
        """Make the bonded blocks of the body, with electrodes, supports and ports."""
        return _build_bonded_blocks(self, part.keys.model_dump_json(exclude={"rom"}), part.name)

    def select_used_ports(self, part: Part[FieldKeysT], scene: DeclaredScene) -> BondedBlocks:
        """Return the bonded blocks of a body without its unused optional ports.

        The optional ports are faces and, for some bodies, the port ``base``. A support that the
        scene connects to ground is at rest, and needs no port.
        """
        bonded, named = self.make_bonded_blocks(part), {}
        for name, face in bonded.faces.items():
            if name in part.pins or scene.is_target(part.name, name):
                named[name] = face
        shaken = scene.ports == "all" or not self.base_is_optional or _joins_base(part, scene)
        return replace(bonded, faces=named, moved=bonded.moved and shaken)

    def make_full_model_key(
        self, part: Part[FieldKeysT], scene: GovernedScene
    ) -> Mapping[str, Any]:
        """Return the cache key of the full model, including the used optional ports."""
        key, used = (
            dict(super().make_full_model_key(part, scene)),
            self.select_used_ports(part, scene),
        )
        if used.faces:
            key["faces"] = [*used.faces]
        if used.moved and self.base_is_optional:
            key["moved"] = True
        return key

    def ports(self, part: Part[FieldKeysT], scene: DeclaredScene) -> tuple[Port, ...]:
        """Return the ports of the part's model."""
        return self.select_used_ports(part, scene).all_ports

    def pin_directions(
        self, part: Part[FieldKeysT], scene: DeclaredScene
    ) -> Mapping[str, tuple[float, ...]]:
        """Return the upward unit vector of each mechanical port, keyed by pin name."""
        result = {}
        for port in self.ports(part, scene):
            if port.domain in (TRANSLATION, ACCELERATION):
                result[port.terminals[0]] = (0.0, 0.0, 1.0)
        return result

    def find_largest_deflection(
        self, part: Part[FieldKeysT], build: BuiltScene, waves: Waveforms
    ) -> float | None:
        """Return the largest recorded displacement [m] of a port; None without a recorded port.

        The displacement of a radiating face or of a patch is the mean over its area.
        """
        if build.scene.analysis.type == "noise":
            return None
        recorded = list(self._face_displacements(part, build, waves).values())
        ports = self.used_ports(part, build.scene)
        for port in ports:
            name = get_wave_name(part.name, ports, port)
            if port.domain is TRANSLATION and name in waves:
                recorded.append(waves[name])
        return max((float(np.abs(wave).max()) for wave in recorded), default=None)

    def make_fe_model(self, part: Part[FieldKeysT], scene: GovernedScene) -> FiniteElementModel:
        """Build the finite-element model of the bonded blocks."""
        return self.select_used_ports(part, scene).build_fe_model()

    def make_full_model_on_mesh(
        self,
        part: Part[FieldKeysT],
        scene: GovernedScene,
        clock: StageTimer,
        like: Part[FieldKeysT],
    ) -> LinearModel:
        """Return the full model of a changed part on the original mesh with moved nodes."""
        body = replace(self.select_used_ports(part, scene), like=self.make_bonded_blocks(like))
        return body.build_fe_model().model

    def material_voltage_rating(self, part: Part[FieldKeysT]) -> float | None:
        """Return the voltage rating [V] that follows from the material."""
        return self.make_bonded_blocks(part).depoling_voltage

    def dimensions(self, part: Part[FieldKeysT]) -> int:
        """Return the number of spatial dimensions of the mesh."""
        return len(self.make_bonded_blocks(part).blocks[0].box)

    def envelope(self, part: Part[FieldKeysT], scene: DeclaredScene) -> Envelope:
        """Return the outer size of the blocks, used to estimate neglected effects."""
        blocks = self.make_bonded_blocks(part).blocks
        if len(blocks[0].box) == 3:
            return make_beam_envelope(blocks)
        baffled = self.is_clamped(part)
        return make_disc_envelope(blocks, baffled, hasattr(part.keys, "layers"))

    def indentation_modulus(self, part: Part[FieldKeysT]) -> float | None:
        """Return the indentation modulus [Pa] of the top layer; None without layers."""
        top = self.make_bonded_blocks(part).blocks[-1].material
        return top.indentation_modulus if hasattr(part.keys, "layers") else None

    def problems(self, part: Part[FieldKeysT], scene: GovernedScene) -> Iterator[UsageError]:
        """Yield an error for each invalid key of a body, and for each implausible layer.

        The width of a layer is the key ``width`` of the body, or otherwise the diameter of the
        layer.
        """
        yield from super().problems(part, scene)
        if getattr(part.keys, "support", "") == "free" and _joins_base(part, scene):
            yield part.wrong(
                "support",
                f"{part.name} is free, so it has no support that its pin {BASE} could move",
                got=f'support = "free", with a connection of {part.name}.{BASE}',
                expected=f'a support other than "free", or no connection of {part.name}.{BASE}',
                hint=f"delete the connection of {part.name}.{BASE}, or add a support",
            )
        layers, width = getattr(part.keys, "layers", ()), getattr(part.keys, "width", None)
        bonded = self.make_bonded_blocks(part)
        result = [
            (
                width or layer.diameter,
                layer.thickness,
                block.material.is_piezoelectric,
                getattr(layer, "electrodes", None),
            )
            for layer, block in zip(layers, bonded.blocks, strict=False)
        ]
        yield from check_layers(f"{part.name}.layers", result, plate=width is None)
        materials = [block.material for block in bonded.blocks]
        yield from check_q_factor(part.name, bonded.damping, materials)

    def outline(self, part: Part[FieldKeysT], scene: Scene) -> Iterator[Shape]:
        """Yield the side view of the bonded blocks; the top is at height zero.

        A block with a bore is drawn on both sides of the axis. The first block of each kind has an
        entry in the legend.
        """
        blocks, known = self.make_bonded_blocks(part).blocks, set[str]()
        top = max(block.box[-1][1] for block in blocks)
        for block in blocks:
            made_of, (inner, outer), (low, high) = block.material, block.box[0], block.box[-1]
            if len(block.box) == 3:  # the middle of a beam is drawn at x = 0
                outer /= 2
            label = f"{part.name}: {made_of.name}, {2e3 * outer:g} mm by {1e3 * (high - low):g} mm"
            kind: Literal["ceramic", "metal"] = "ceramic" if made_of.is_piezoelectric else "metal"
            for x in ((outer + inner) / 2, -(outer + inner) / 2) if inner else (0.0,):
                wide = outer - inner if inner else 2 * outer
                legend = "" if label in known else label
                yield Shape(x, (low + high) / 2 - top, wide, high - low, kind, legend)
                known.add(label)


def _joins_base(part: Part, scene: DeclaredScene) -> bool:
    """Return whether the scene connects the pin ``base`` of a body to another pin."""
    return part.pins.get(BASE, GROUND) != GROUND or scene.is_target(part.name, BASE)


@lru_cache(maxsize=32)
def _build_bonded_blocks(kind: BondedBody, keys: str, name: str) -> BondedBlocks:
    """Build the bonded blocks of a body from the JSON text of its keys."""
    return kind.structure(kind.schema.model_validate_json(keys), name)


def make_metric_word(material: str) -> str:
    """Return a material name in letters, digits and underscores for metric names."""
    return re.sub(r"[^a-z0-9]+", "_", material.lower()).strip("_")


def _plot_extremes(name: str, recovered: RecoveredFields) -> Figure:
    """Plot the largest stress and electric field in each material versus time."""
    panels = []
    for quantity, (_, _, label, _) in _FIELD_DESCRIPTIONS.items():
        rows = recovered.select_extremes(quantity)
        # omit each curve that repeats a curve of the electric field
        if quantity == "opposing_field":
            rows = [e for e in rows if e.limit and e.value > 0]
        if not rows:
            continue
        curves, levels = [], dict[float, str]()
        for e in rows:
            curves.append(Curve(e.material, 1e3 * e.scale, 1e-6 * e.curve))
            if e.limit and e.value > 0.2 * e.limit:
                levels[1e-6 * e.limit] = "limit"
        panels.append(Panel("time in ms", label, tuple(curves), levels=tuple(levels.items())))
    caption = "Largest value in each material at any Gauss point; a limit is drawn if a value "
    caption += "exceeds 20 % of it."
    return Figure(f"{name}_stress", f"Stress and field in {name}", caption, tuple(panels))
