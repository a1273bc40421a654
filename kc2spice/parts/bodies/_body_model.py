"""Full and reduced models of a linear part, and the cache keys of these models."""

from __future__ import annotations

import hashlib
import json
import math
import stat
from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel

from kc2spice.core.cache import load_or_build
from kc2spice.core.errors import UsageError, wrong
from kc2spice.core.key_actions import DeleteKey, SetKey
from kc2spice.core.progress import StageTimer
from kc2spice.core.si_prefix_format import format_quantity
from kc2spice.core.user_warnings import warn_user
from kc2spice.fem.body_keys import DampingKeys
from kc2spice.fem.materials import MaterialTable
from kc2spice.parts.bodies._body_ports import BodyPorts, requires_massless_ports
from kc2spice.parts.bodies._linear_body_keys import LinearKeysT
from kc2spice.parts.bodies._material_losses import find_largest_tangent
from kc2spice.parts.bodies._varied_keys import (
    RANGES_KEY,
    check_parameter_ranges,
    get_middle_values,
    list_varied_keys,
    read_key_values,
    with_values,
)
from kc2spice.rom.complex_material_constants import ComplexConstants
from kc2spice.rom.linear_model import Certificate, LinearModel, Port
from kc2spice.rom.modal_models import compute_resonators
from kc2spice.rom.parametric_models import DampingParameter, ParameterAxis
from kc2spice.rom.range_reduction import ModelOverRanges, RangeTask
from kc2spice.rom.resonators_over_ranges import ResonatorsOverRanges
from kc2spice.scene.scene_classes import GovernedScene, Part, Scene
from kc2spice.scene.settings import RomKeys

if TYPE_CHECKING:
    from kc2spice.rom.time_domain_errors import ReductionsByOrder

# Default relative tolerance of a reduction over parameter ranges.
RANGE_TOLERANCE = 1e-4
# The default band of a transient ends at this frequency [Hz] or at a higher frequency.
# A default band must not end too low, because switching in a circuit excites unknown frequencies.
MIN_BAND_END = 10e3
# Largest number of natural frequencies in the default band.
# Natural frequencies of higher modes depend on the mesh.
BAND_MODES = 20
# Keys of a body that do not affect its full and reduced models.
_IRRELEVANT_KEYS = {"rom", "fields", "rated_voltage", "number"}
# Packages and modules whose source code affects every full and reduced model.
MODEL_SOURCES = (
    "kc2spice.linalg", "kc2spice.fem", "kc2spice.rom", "kc2spice.bodies",
    "kc2spice.core.domains", "kc2spice.core.gmsh_session", "kc2spice.core.naming",
    "kc2spice.core.quantities", "kc2spice.core.untrusted_files",
    "kc2spice.parts.bodies._varied_keys", "kc2spice.parts.bodies._mesh_keys",
    "kc2spice.physics.conductors",
)  # fmt: skip


class BodyModel(BodyPorts[LinearKeysT]):
    """Part with a linear model, which is reduced and cached.

    A subclass builds the model of the whole device (:meth:`make_full_model`). The keys of the part
    or of the scene state the band of the reduction, and its order or tolerance.
    """

    # Classes of the objects in a reduced model over parameter ranges, which the cache needs to
    # store the model.
    range_classes: tuple[type, ...] = (ResonatorsOverRanges, DampingParameter)
    ranges_from_zero = False  # whether parameter ranges of the part may begin at zero
    # Class that validates the material tables in the keys of the part.
    material_table: type[BaseModel] = MaterialTable
    # Built-in material that supplies the missing values of a material table; none by default.
    base_material = ""

    @abstractmethod
    def make_full_model(
        self, part: Part[LinearKeysT], scene: GovernedScene, clock: StageTimer
    ) -> LinearModel:
        """Return the unreduced model of the whole body."""

    def make_full_model_on_mesh(
        self,
        part: Part[LinearKeysT],
        scene: GovernedScene,
        clock: StageTimer,
        like: Part[LinearKeysT],
    ) -> LinearModel:
        """Return the full model of a changed part on the original mesh with moved nodes.

        ``like`` is the original part, and ``part`` is a copy with other values of keys. The nodes
        of the mesh of ``like`` are moved to the geometry of ``part``.
        """
        return self.make_full_model(part, scene, clock)

    def make_full_model_key(
        self, part: Part[LinearKeysT], scene: GovernedScene
    ) -> Mapping[str, Any]:
        """Return the cache key of the full model, with all data that determine the model."""
        return {"keys": part.keys.model_dump(mode="json", exclude=_IRRELEVANT_KEYS)}

    def problems(self, part: Part[LinearKeysT], scene: GovernedScene) -> Iterator[UsageError]:
        """Yield an error for each invalid key of the part."""
        yield from check_parameter_ranges(part, scene)

    def _find_reduction_settings(self, part: Part[LinearKeysT], scene: Scene) -> RomKeys | None:
        """Return the reduction settings of the body or the scene; None without settings.

        A table ``rom`` with only ``parameters`` does not count as reduction settings.
        """
        specified: RomKeys | None = part.keys.rom
        if specified is not None and specified.model_fields_set != {"parameters"}:
            return specified
        return scene.rom if "rom" in scene.frame.model_fields_set else None

    def choose_reduction(self, part: Part[LinearKeysT], scene: Scene) -> RomKeys:
        """Return the reduction settings that the scene states, or default settings.

        By default, the settings are a tolerance and a band. In an ``ac`` analysis, the band ends 20
        % above the last frequency. In a transient, the band ends at the highest excited frequency
        (:meth:`PartType.numerics`), but usually not above natural frequency number
        :data:`BAND_MODES` of the body. In an ``ac`` analysis, the tolerance is 1e-3, a tenth of
        usual mesh errors. This tolerance is larger than the rounding errors of a thin free plate,
        which are about 1e-4 at resonances.
        """
        specified, result = part.keys.rom, self._find_reduction_settings(part, scene)
        if result is None and scene.analysis.is_small_signal:
            low, high = scene.analysis.start, float(scene.analysis.stop or 1.0)
            result = RomKeys(tolerance=1e-3, band=(0.8 * low, 1.2 * high))
        elif result is None:
            content = max((row.highest_frequency for row in scene.numerics), default=0.0)
            result = RomKeys(tolerance=1e-4, band=(0.0, max(content, self.get_min_band_end(scene))))
        if specified is None or result is specified:
            return result
        return result.model_copy(update={"parameters": specified.parameters})

    def find_least_band_end(self, part: Part[LinearKeysT], scene: Scene) -> float | None:
        """Return the frequency [Hz] that a transient's default band must at least reach.

        The result is None in other analyses, and with a band that the user states. The lower limit
        does not depend on the natural frequencies of the body.
        """
        if (
            self._find_reduction_settings(part, scene) is not None
            or scene.analysis.type != "transient"
        ):
            return None
        content = (row.highest_frequency for row in scene.numerics if math.isfinite(row.step))
        return max([self.get_min_band_end(scene), *content])

    def get_min_band_end(self, scene: Scene) -> float:
        """Return the lowest frequency [Hz] at which a default band may end."""
        return MIN_BAND_END

    def model_key(self, part: Part[LinearKeysT], scene: Scene) -> Mapping[str, Any]:
        """Return the cache key of the reduced model: all data that determine the model."""
        rom = get_reduction_settings(part, scene)
        settings = rom.model_dump(mode="json")
        result = {
            "type": self.name,
            "full": self.make_full_model_key(part, scene),
            "ports": self.used_port_names(part, scene),
            "rom": settings,
        }
        least_end = self.find_least_band_end(part, scene)
        reached = {} if least_end is None else {"sure": least_end, "motions": BAND_MODES}
        return result | reached | {"massless": requires_massless_ports(part, scene)}

    def reduce_body_over_ranges(
        self, part: Part[LinearKeysT], scene: Scene, clock: StageTimer
    ) -> ModelOverRanges:
        """Return the reduced model over the ranges of ``rom.parameters``."""
        keys = list_varied_keys(part)
        middle = with_values(part, get_middle_values(keys))
        target, key = get_reduction_settings(part, scene), self.model_key(middle, scene)
        specified = part.keys.rom
        if read_loss_tangent(part):
            raise wrong(
                f"{part.name}.damping.loss_tangent",
                "a netlist with parameters cannot contain a dielectric loss",
                got=read_loss_tangent(part),
                expected="0",
                hint=DeleteKey("loss_tangent"),
            )
        if has_complex_constants(part):
            raise wrong(
                f"{part.name}.damping.model",
                "a netlist with parameters can only have viscous damping",
                got="ieee176",
                expected='"rayleigh", the loss model of viscous damping',
                hint='write  model = "rayleigh"',
            )
        if getattr(getattr(part.keys, "damping", None), "per_material", False):
            raise wrong(
                f"{part.name}.damping.per_material",
                "a netlist with parameters needs the same damping for all materials",
                got="true",
                expected="`ratio`, `quality` or `loss_factor`",
                hint=SetKey(
                    part.name, "damping", "{ quality = 50 }", end=", with the Q factor of the body"
                ),
            )
        if self.gives_off_heat(part, scene):
            raise wrong(
                f"{part.name}.{RANGES_KEY}",
                "a netlist with parameters cannot have a heat pin",
                got=", ".join(i.key for i in keys),
                expected="no parameters",
                hint=f"delete {RANGES_KEY}, or disconnect the heat pin",
            )
        if scene.analysis.type == "noise":
            raise wrong(
                f"{part.name}.{RANGES_KEY}",
                "a netlist with parameters contains no thermal noise, so it does not support a "
                "noise analysis",
                got=", ".join(i.key for i in keys),
                expected="no parameters",
                hint=f"delete {RANGES_KEY} for this analysis",
            )
        ordered = target.order is not None and "order" in target.model_fields_set
        if ordered and specified is not None and specified.order:
            raise wrong(
                f"{part.name}.rom.order",
                "rom.order cannot be combined with rom.parameters",
                got=target.order,
                expected="rom.tolerance",
                hint="delete the key `order` from the table rom",
            )
        key = {**key, "box": [[item.key, item.low, item.high] for item in keys]}

        def build() -> ModelOverRanges:
            """Build the reduced model of the part over the parameter ranges."""

            def make_model_at_values(values: Mapping[str, float]) -> LinearModel:
                """Return the full model for other values of the varied keys."""
                other = with_values(part, values)
                return self.make_full_model_on_mesh(other, scene, clock, middle).select(
                    key["ports"]
                )

            band = self.limit_band(
                target.band, key, lambda: make_model_at_values(get_middle_values(keys))
            )
            text = f"model of {part.name} over {len(keys)} parameters"
            with clock.time_stage("reduce", text) as share:
                task = RangeTask(
                    make_model_at_values,
                    [item.parameter_axis for item in keys],
                    band,
                    target.tolerance or RANGE_TOLERANCE,
                    lambda done, of: share(done / of),
                    target.norm or "pointwise",
                )
                return self.reduce_over_key_ranges(part, task)

        def load_reduced_model() -> ModelOverRanges:
            """Read the reduced model over the parameter ranges from the cache, or build it."""
            classes = (*self.range_classes, ParameterAxis, Certificate, Port)
            return load_or_build("box", key, build, classes=classes, sources=self.source_modules())

        return scene.workspace.get_or_compute(f"range of {part.name}", key, load_reduced_model)

    def reduce_over_key_ranges(self, part: Part[LinearKeysT], task: RangeTask) -> ModelOverRanges:
        """Return a reduced model of the part over the parameter ranges of ``task``."""
        from kc2spice.rom.resonators_over_ranges import reduce_over_ranges

        return reduce_over_ranges(task)

    def _has_constant_loss_factors(self, part: Part[LinearKeysT]) -> bool:
        """Return whether the body has loss factors that are constant over frequency."""
        return find_largest_loss_tangent(part) > 0 or has_complex_constants(part)

    def _make_mid_range_full_model(
        self, part: Part[LinearKeysT], scene: Scene, clock: StageTimer
    ) -> LinearModel:
        """Make the full model with only the used ports, meshed for mid-range key values."""
        keys, names = list_varied_keys(part), self.used_port_names(part, scene)
        if not keys:
            return self.make_full_model(part, scene, clock).select(names)
        middle = with_values(part, get_middle_values(keys))
        return self.make_full_model_on_mesh(part, scene, clock, middle).select(names)

    def build(
        self, part: Part[LinearKeysT], scene: Scene, clock: StageTimer, full: bool = False
    ) -> LinearModel | None:
        """Build the reduced model of the part, or the full model if ``full`` is true."""
        if full:
            # The matrices of a full model cannot represent losses that are constant over frequency.
            return (
                None
                if self._has_constant_loss_factors(part)
                else self._make_mid_range_full_model(part, scene, clock)
            )
        if keys := list_varied_keys(part):
            return self.reduce_body_over_ranges(part, scene, clock).evaluate(read_key_values(keys))
        # ``build`` uses these variables, so the cache key contains their values, and hashes of the
        # modules with the code of ``build``.
        target, model_key = get_reduction_settings(part, scene), self.model_key(part, scene)
        constants = has_complex_constants(part)

        def build() -> LinearModel:
            """Build the reduced model of the part with its losses."""
            from kc2spice.rom.complex_material_constants import make_complex_constants_model
            from kc2spice.rom.error_estimate import choose_default_norm
            from kc2spice.rom.modal_models import add_dielectric_loss, make_highest_modes_massless
            from kc2spice.rom.soft_support import support_softly

            orders = self.get_reductions_by_order(part, scene, clock)
            selected = orders.model
            with clock.time_stage("reduce", f"reduction of {part.name}"):
                order = None if target.order is None else min(target.order, selected.order)
                band = self.limit_band(target.band, model_key, lambda: selected)
                norm = target.norm or choose_default_norm(selected)
                if constants:
                    selected = _replace_by_least_damping(part, selected, band)
                aims: dict[str, Any] = {"order": order, "tolerance": target.tolerance}
                aims |= {"band": band, "norm": norm}
                small = self.reduce_body(part, orders, selected, aims)
            modal = compute_resonators(small)  # eigenvalues are computed only once
            tangents = find_loss_tangents(part, small)
            if modal is None and any(tangents) and not constants:
                small = support_softly(small, band)
                modal = compute_resonators(small)
            if modal is None and constants:
                raise wrong(
                    f"{part.name}.damping.model",
                    'the complex material constants of model = "ieee176" cannot be combined with '
                    "damping that couples modes, or with a rigid-body mode",
                    got='model = "ieee176", with coupled modes or a rigid-body mode',
                    expected=(
                        "damping by `ratio`, `quality` or `loss_factor`, and no rigid-body mode"
                    ),
                    hint="support the body, or let `rom.band` begin above 0 Hz",
                )
            if modal is not None and model_key["massless"]:
                modal = make_highest_modes_massless(modal, target.tolerance)
            labels: dict[str, Any] = {"name": small.name, "facts": small.facts, "band": small.band}
            if modal is not None and constants:
                losses = make_complex_constants(part, selected)
                return replace(make_complex_constants_model(modal, losses), **labels)
            result = small if modal is None else replace(modal.to_linear_model(), **labels)
            return add_dielectric_loss(result, tangents) if any(tangents) else result

        kinds = (LinearModel, Certificate, Port)
        return load_or_build("body", model_key, build, classes=kinds, sources=self.source_modules())

    def limit_band(
        self,
        band: tuple[float, float],
        key: Mapping[str, Any],
        full: Callable[[], LinearModel],
    ) -> tuple[float, float]:
        """Exclude high natural frequencies from the default band of a transient.

        The band ends at natural frequency number :data:`BAND_MODES` of the full model, but not
        below the frequency that :meth:`find_least_band_end` returns. Bands of other analyses, and
        bands that the user states, are unchanged.
        """
        from kc2spice.rom.band import find_band_end

        (low, high), least_end = band, key.get("sure")
        if least_end is not None and high > least_end:
            high = min(high, max(least_end, find_band_end(full().pencil, BAND_MODES, high)))
        return low, high

    def reduce_body(
        self,
        part: Part[LinearKeysT],
        orders: ReductionsByOrder,
        model: LinearModel,
        aims: Mapping[str, Any],
    ) -> LinearModel:
        """Reduce a full model to an order or a tolerance in a frequency band.

        ``aims`` contains order, tolerance, band and norm.
        """
        from kc2spice.rom.reduce import reduce_model

        if aims["order"] is not None and model is orders.model:
            return orders.reduce(aims["order"], aims["band"], aims["norm"])
        # A contact, a switch or a tabulated drive excites modes above the band.
        return reduce_model(model, **aims, contact=True)

    def get_reductions_by_order(
        self, part: Part[LinearKeysT], scene: Scene, clock: StageTimer
    ) -> ReductionsByOrder:
        """Return the object that reduces the full model to any order on request.

        The returned object remains in the workspace,
        because the next scene often needs another order of the same model.
        """
        from kc2spice.rom.time_domain_errors import ReductionsByOrder

        names = self.used_port_names(part, scene)
        key = json.dumps(
            [part.name, self.make_full_model_key(part, scene), names], sort_keys=True, default=str
        )

        def make_reductions() -> ReductionsByOrder:
            """Make the object that computes reductions of the full model on request."""
            return ReductionsByOrder(self._make_mid_range_full_model(part, scene, clock))

        return scene.workspace.get_or_compute(f"orders {self.name}", key, make_reductions)

    def source_modules(self) -> tuple[str, ...]:
        """Return the modules whose source code determines the models of this part type."""
        classes = (kind.__module__ for kind in type(self).__mro__ if issubclass(kind, BodyPorts))
        return (*MODEL_SOURCES, *classes)


def read_loss_tangent(part: Part) -> float:
    """Return the dielectric loss tangent of a body from the key ``damping``, or 0."""
    return float(getattr(getattr(part.keys, "damping", None), "loss_tangent", None) or 0.0)


def find_largest_loss_tangent(part: Part) -> float:
    """Return the loss tangent of a body, or the largest loss tangent of its materials.

    The result is 0 if the model has no dielectric loss.
    """
    if not getattr(getattr(part.keys, "damping", None), "uses_material_tangents", False):
        return read_loss_tangent(part)
    assert isinstance(part.type, BodyModel)
    return find_largest_tangent(part.keys, part.type.base_material)


def find_loss_tangents(part: Part, model: LinearModel) -> list[float]:
    """Return the loss tangent of each electrode of a model.

    A loss tangent in the key ``damping`` applies to all electrodes. Otherwise, the loss tangents
    follow from the materials (:func:`kc2spice.bodies.solid_models.make_damped_model`).
    """
    ports = [port.name for port in model.ports if port.electrical]
    if tangent := read_loss_tangent(part):
        return [tangent] * max(len(ports), 1)
    from kc2spice.bodies.solid_models import get_loss_tangent_key

    return [model.facts.get(get_loss_tangent_key(port), 0.0) for port in ports]


def has_complex_constants(part: Part) -> bool:
    """Return whether complex material constants (IEEE 176) represent the losses."""
    return getattr(getattr(part.keys, "damping", None), "model", None) == "ieee176"


def find_damping(part: Part) -> DampingKeys:
    """Return the damping settings from the key ``damping`` of a body."""
    # Not all bodies have the key ``damping``.
    damping: DampingKeys = part.keys.damping  # type: ignore[attr-defined]
    return damping


def make_complex_constants(part: Part, model: LinearModel) -> ComplexConstants:
    """Return the complex material constants that represent a body's damping.

    The constants are valid at the frequency in the key ``damping.at``. Without the key
    ``damping.at``, the constants are valid at the first resonance of the ``model``.

    Raises
    ------
    UsageError : the key ``damping.at`` is missing, and the model has no resonance.
    """
    damping, facts = find_damping(part), model.facts
    at = damping.find_ratio_frequency(facts.get("resonance_short_hz", facts.get("resonance_hz")))
    if at is None:
        raise wrong(
            f"{part.name}.damping.at",
            "the body has no resonance, so its damping needs a frequency",
            expected="the frequency at which Q factor and loss tangent apply",
            hint='add  at = "1 kHz"  to damping, with a frequency of your band',
        )
    return ComplexConstants(2 * damping.zeta, read_loss_tangent(part), at)


def _replace_by_least_damping(
    part: Part, model: LinearModel, band: tuple[float, float]
) -> LinearModel:
    """Return ``model`` with its constant losses replaced by smaller, viscous losses.

    At the end of the band, the viscous losses equal the constant losses of the complex material
    constants. At lower frequencies, the viscous losses are smaller than the constant losses.
    Because the actual constant losses are larger, the error of a reduction is at most its error
    with the viscous losses.
    """
    loss = make_complex_constants(part, model).loss_factor
    return replace(model, E=None, rayleigh=(0.0, loss / (2 * math.pi * band[1])))


def find_full_model(part: Part, scene: Scene, clock: StageTimer) -> LinearModel | None:
    """Return a body's full model; None if its matrices cannot represent the losses."""
    kind = part.type
    assert isinstance(kind, BodyModel)
    return kind.build(part, scene, clock, full=True)


def full_model_without_scene(part: Part, scene: GovernedScene, clock: StageTimer) -> LinearModel:
    """Return the full model of a body without its scene; warn about neglected losses."""
    if tangent := find_largest_loss_tangent(part):
        key = "per_material" if find_damping(part).uses_material_tangents else "loss_tangent"
        warn_user(
            f"{part.name}.damping.{key}: this model neglects the loss tangent {tangent:g}, "
            f"because matrices cannot represent a loss tangent that is independent of frequency; "
            f"to include the dielectric loss, run or export the scene"
        )
    if has_complex_constants(part):
        warn_user(
            f"{part.name}.damping.model = ieee176: the matrices of {part.name} contain viscous "
            f"damping, because matrices cannot represent a loss factor that is independent of "
            f"frequency; to include this loss factor, run or export the scene"
        )
    kind = part.type
    assert isinstance(kind, BodyModel)
    return kind.make_full_model(part, scene, clock)


def find_scene_band(part: Part, scene: Scene, full: LinearModel) -> tuple[float, float]:
    """Return the frequency band [Hz] for the reduction of ``part`` in a scene."""
    kind = part.type
    assert isinstance(kind, BodyModel)
    target, key = get_reduction_settings(part, scene), kind.model_key(part, scene)
    return kind.limit_band(target.band, key, lambda: full)


def describe_reduction_target(rom: RomKeys) -> str:
    """Describe the order or tolerance and the band of a reduction as text."""
    low, high = rom.band
    target = f"order {rom.order}"
    if rom.tolerance is not None:
        target = f"an error below {100 * rom.tolerance:g} %"
    return f"{target} from {format_quantity(low, 'Hz')} to {format_quantity(high, 'Hz')}"


def get_reduction_settings(part: Part, scene: Scene) -> RomKeys:
    """Return the reduction settings of a body from its record in the scene."""
    result = scene.records[part.name].reduction
    assert result is not None
    return result


def hash_file(path: Path) -> str:
    """Return a hash of a file's content, which does not depend on its path."""
    try:
        result = path.stat()
        if not stat.S_ISREG(result.st_mode):
            return "no regular file"
        return _hash_content(path, result.st_size, result.st_mtime_ns)
    except OSError:
        return "absent"


@lru_cache(maxsize=64)
def _hash_content(path: Path, size: int, changed: int) -> str:
    """Return the hash of a file's content, cached by path, size and modification time."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
