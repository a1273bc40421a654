"""Numerical settings of a scene, and the plan of a run.

A key that trades computing time for accuracy is a numerical setting. The declaration of such a key
contains a :class:`kc2spice.core.quantities.RefinementRule`. The key ``error_budget`` and the
command ``bench`` vary the settings. The plan of a run lists parts, nets, neglected effects and
numerical settings. The command ``explain`` prints the plan.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from annotated_types import Ge, Le, Lt
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from kc2spice.core.mesh_error_descriptions import list_mesh_errors
from kc2spice.core.quantities import RefinementRule
from kc2spice.core.schemas import find_unit
from kc2spice.core.si_prefix_format import format_quantity
from kc2spice.scene.net_formation import describe_nets
from kc2spice.scene.part_records import NeglectedEffect
from kc2spice.scene.reference_frames import describe_frames
from kc2spice.scene.scene_classes import BuiltScene, Part, Scene
from kc2spice.scene.settings import Analysis, RomKeys, SolverKeys

MAX_STEP_KEY = "solver.max_step"
MAX_TIME_POINTS = 2e5  # largest number of time points of a transient with the finest time step
# Factor by which each refinement step of a transient multiplies the upper band limit of a
# reduction. Voltage steps and contacts excite modes above the band.
BAND_GROWTH = 2.0


@dataclass(frozen=True)
class NumericalSetting:
    """Numerical setting: its key, its value and its refinement rule.

    ``name`` is the dotted name of the key. ``low`` and ``high`` are the limits of the value.
    ``finer`` contains further keys that are changed together with a refined setting, and their
    values. If the setting is the tolerance of a reduction, ``band`` is the frequency band [Hz] of
    the reduction. Each refinement step multiplies the highest frequency of the band by ``wider``.
    If the setting is the number of points of a logarithmic frequency grid, ``decades`` is the width
    of the grid in decades. A refined grid contains all points of the coarser grid. ``model`` is
    true for a setting, such as a mesh size, that affects the time to build a model but not the
    computing time of the simulator. ``mesh`` is true for a setting that determines the fineness of
    a mesh. ``unit`` is the SI unit of the value, "" for ratios, and None for counts.
    """

    name: str
    value: float
    rule: RefinementRule
    low: float
    high: float
    finer: Mapping[str, Any] = field(default_factory=dict)
    band: tuple[float, float] | None = None
    wider: float = 1.0
    decades: float = 0.0
    model: bool = False
    mesh: bool = False
    unit: str | None = None

    def refine_keys(self, steps: float) -> dict[str, Any]:
        """Refine a setting by some steps, and return the changed keys with new values.

        Negative ``steps`` make the setting coarser. The result is empty if no key changes.
        """
        value = self.rule.refine(self.value, steps)
        if self.decades and steps:
            item = round(math.ceil(self.value / self.decades) * self.rule.factor**steps)
            value = math.floor(item * self.decades)
        value = min(max(value, self.low), self.high)
        if not steps or value == self.value:
            return {}
        result: dict[str, Any] = {self.name: value}
        if steps > 0:
            result |= self.finer
        if self.band is not None:
            low, high = self.band
            top = float(f"{self.wider ** max(steps, 0.0) * high:.9g}")
            result[self.name.replace("tolerance", "band")] = [low, top]
        return result


def find_numerical_settings(build: BuiltScene) -> tuple[NumericalSetting, ...]:
    """Return those numerical settings of a scene that a run can refine.

    The settings include the largest time step, if the step is known or is set in the scene.
    """
    return tuple(setting for setting in _list_settings(build) if setting.refine_keys(1.0))


def find_finest_settings(build: BuiltScene) -> tuple[NumericalSetting, ...]:
    """Return those numerical settings of a scene that already have their finest value.

    Only a run with a coarser value can estimate the error of such a setting.
    """
    return tuple(
        setting
        for setting in _list_settings(build)
        if not setting.refine_keys(1.0) and setting.refine_keys(-1.0)
    )


def _list_settings(build: BuiltScene) -> Iterator[NumericalSetting]:
    """Yield all numerical settings of a scene that have a refinement rule."""
    scene = build.scene
    if scene.analysis.type == "transient":
        solver = {
            setting.name: setting for setting in _list_settings_of_keys(scene.solver, "solver")
        }
        yield solver["solver.reltol"]
        yield replace(solver["solver.chgtol"], finer={"solver.ringing": "followed"})
        step: float | None = scene.solver.max_step
        if step is None and build.largest_step is not None:
            step = build.largest_step.step
        if step is not None:
            setting = _make_setting(MAX_STEP_KEY, step, SolverKeys.model_fields["max_step"])
            yield replace(setting, low=min(step, scene.stop_time / MAX_TIME_POINTS))
    elif scene.analysis.is_small_signal and "analysis" in scene.tables:
        (setting,) = _list_settings_of_keys(scene.analysis, "analysis")
        yield replace(setting, decades=_count_decades(scene.analysis))
    elif scene.analysis.type == "dc" and "analysis" in scene.tables:
        yield from _list_settings_of_keys(scene.analysis, "analysis")
    yield from _list_reduction_settings(build)
    for part in scene.parts.values():
        yield from _list_settings_of_keys(part.keys, part.key_prefix)


def _count_decades(analysis: Analysis) -> float:
    """Return the number of decades of a frequency range, or 0 if it is linear."""
    if analysis.scale == "linear":
        return 0.0
    return math.log10(float(analysis.stop or analysis.start) / analysis.start)


def _list_settings_of_keys(keys: BaseModel, prefix: str) -> Iterator[NumericalSetting]:
    """Yield numerical settings in a table of keys and its subtables, except ``rom``."""
    for name, declared in type(keys).model_fields.items():
        value = getattr(keys, name)
        if isinstance(value, BaseModel) and not isinstance(value, RomKeys):
            yield from _list_settings_of_keys(value, f"{prefix}.{name}")
        rule = _find_rule(declared)
        if rule is not None and value is not None and _rule_applies(rule, keys):
            yield _make_setting(f"{prefix}.{name}", value, declared)


def _rule_applies(rule: RefinementRule, keys: BaseModel) -> bool:
    """Return whether a refinement rule applies to a table with the given keys."""
    return all(getattr(keys, name) == value for name, value in rule.when)


def _list_reduction_settings(build: BuiltScene) -> Iterator[NumericalSetting]:
    """Yield the tolerance or order setting of each table ``rom`` in the scene."""
    scene = build.scene
    timed = scene.analysis.type == "transient"
    known: set[str] = set()
    for part in scene.parts.values():
        rom = scene.records[part.name].reduction
        if rom is None:
            continue
        separate = _has_own_reduction_keys(part)
        prefix = _get_reduction_prefix(part, scene)
        if prefix in known:
            continue
        known.add(prefix)
        if rom.tolerance is None:
            yield _make_setting(
                f"{prefix}.order", int(rom.order or 1), RomKeys.model_fields["order"]
            )
            continue
        band = rom.band
        if not separate and "rom" not in scene.tables:
            certificate = getattr(build.models.get(part.name), "certificate", None)
            band = rom.band if certificate is None else certificate.band_hz
        setting = _make_setting(
            f"{prefix}.tolerance", rom.tolerance, RomKeys.model_fields["tolerance"]
        )
        # The refined reduction has no parameter ranges, because a run has only one value of each
        # parameter. The band of the refined reduction may be wider than the band of the scene.
        plain: dict[str, Any] = {f"{prefix}.parameters": {}} if rom.parameters else {}
        wider = (BAND_GROWTH**2 if plain else BAND_GROWTH) if timed else 1.0
        yield replace(setting, band=band, wider=wider, finer=plain)


def _has_own_reduction_keys(part: Part) -> bool:
    """Return whether the scene states a table ``rom`` for this part only."""
    return getattr(part.keys, "rom", None) is not None


def _get_reduction_prefix(part: Part, scene: Scene) -> str:
    """Get the prefix of a part's reduction keys: ``PART.rom`` or the common ``rom``."""
    if _has_own_reduction_keys(part) or not _has_common_reduction(part, scene):
        return f"{part.key_prefix}.rom"
    return "rom"


def _has_common_reduction(part: Part, scene: Scene) -> bool:
    """Return whether all reduced bodies have the same reduction settings as ``part``."""
    reduction = scene.records[part.name].reduction
    return all(record.reduction in (None, reduction) for record in scene.records.values())


def _make_setting(name: str, value: float, declared: FieldInfo) -> NumericalSetting:
    """Return the numerical setting of a key, with rule and limits of the key.

    ``declared`` is the declaration of the key, which contains its refinement rule and the limits of
    its value.
    """
    rule = _find_rule(declared)
    assert rule is not None
    low, high = 0.0, math.inf
    for bound in declared.metadata:
        if isinstance(bound, Ge):
            low = bound.ge  # type: ignore[assignment]
        elif isinstance(bound, Le):
            high = bound.le  # type: ignore[assignment]
        elif isinstance(bound, Lt):
            high = min(high, bound.lt / 2)  # type: ignore[operator]
    if rule.factor < 1 and rule.finest:
        low = min(rule.finest, value)
    unit = find_unit(declared)
    return NumericalSetting(
        name, value, rule, low, high, model=rule.model, mesh=rule.mesh, unit=unit
    )


def _find_rule(declared: FieldInfo) -> RefinementRule | None:
    """Return the refinement rule of a key, or None if the key has no rule."""
    return next((item for item in declared.metadata if isinstance(item, RefinementRule)), None)


def refine_settings(
    selected: Sequence[NumericalSetting], steps: Mapping[str, float]
) -> dict[str, Any]:
    """Refine all settings, and return the changed keys with their new values.

    ``steps`` contains the number of refinement steps of each setting.
    """
    result: dict[str, Any] = {}
    for setting in selected:
        result |= setting.refine_keys(steps.get(setting.name, 0.0))
    return result


def _describe_noise(part: Part, build: BuiltScene) -> str:
    """Describe a part's noise if the scene has a noise analysis; else return ""."""
    result = part.type.noise
    thermal = "thermal noise at 27 °C" if result else "no noise"
    noise = result if isinstance(result, str) else thermal
    return f"; {noise}" if build.has_noise else ""


def _describe_mesh(part: Part, build: BuiltScene) -> str:
    """Describe the mesh of a part."""
    text = part.type.describe_discretisation(part, build)
    return f"; {text}" if text else ""


def _estimate_setting_error(
    setting: NumericalSetting, build: BuiltScene
) -> tuple[float, str] | None:
    """Return the largest error estimate of a setting, with the quantity that has this error.

    The result is None for a setting whose error is not known before a run. The error of a mesh is
    the largest error of the results that depend on the mesh. The error of a reduction is that of
    the certificate, which holds within the band of the reduced model. In a transient, voltage steps
    also excite modes above the band.
    """
    scene, errors = build.scene, list[tuple[float, str]]()
    for part in scene.parts.values():
        certificate = getattr(build.models.get(part.name), "certificate", None)
        if setting.mesh and setting.name.startswith(f"{part.key_prefix}."):
            mesh_errors = list_mesh_errors(build.get_model_values(part))
            for description, error in mesh_errors.items():
                errors.append((error, description.removesuffix(" up to")))
        elif certificate is not None and _is_reduction_setting(setting, part, scene):
            errors.append((certificate.error_estimate, "reduced model, within its band"))
    return max(errors, default=None)


def _is_reduction_setting(setting: NumericalSetting, part: Part, scene: Scene) -> bool:
    """Return whether a setting is the tolerance or the order of a part's reduction."""
    if scene.records[part.name].reduction is None:
        return False
    return setting.name.rpartition(".")[0] == _get_reduction_prefix(part, scene)


def describe_analysis(scene: Scene) -> str:
    """Describe the analysis of a scene: its type, and its range.

    Examples
    --------
    >>> from kc2spice.scene.load import load_scene
    >>> describe_analysis(load_scene("harvester"))
    'ac, 40 Hz to 60 Hz'
    """
    selected = scene.analysis
    if selected.type == "transient":
        default = " (default)" if scene.has_default_stop_time else ""
        return f"transient, 0 s to {format_quantity(scene.stop_time, 's')}{default}"
    if selected.type == "dc":
        return f"dc, sweep of {selected.sweep}"
    if not selected.is_small_signal:
        return "operating point"
    low, high = selected.start, float(selected.stop or selected.start)
    return f"{selected.type}, {format_quantity(low, 'Hz')} to {format_quantity(high, 'Hz')}"


def describe_plan(build: BuiltScene) -> dict[str, Any]:
    """Return the plan of a run, which becomes the entry ``plan`` of ``result.json``.

    ``parts`` contains the origin of each part's model (``source``), such as a data sheet, and a
    description of the model (``detail``). ``joins`` describes the nets. ``frames`` describes the
    reference frames of displacements. ``left_out`` lists each neglected effect once. ``settings``
    lists the numerical settings. The ``error`` of a setting is the estimated relative error of the
    quantity ``error_of``, or None if the error is not known before a run. ``default_stop_s`` is the
    end time [s] of a transient, or None if the scene states the end time.
    """
    scene = build.scene
    parts = []
    left_out: list[NeglectedEffect] = []
    for part in scene.parts.values():
        texts: list[str] = []
        for note in part.type.notes(part, scene):
            if isinstance(note, NeglectedEffect):
                left_out.append(note)
            else:
                texts.append(note)
        detail = "; ".join(texts) + _describe_mesh(part, build) + _describe_noise(part, build)
        parts.append({"part": part.name, "source": part.type.source, "detail": detail})
    settings = []
    for setting in find_numerical_settings(build):
        error, of = _estimate_setting_error(setting, build) or (None, None)
        settings.append(
            {
                "key": setting.name,
                "value": setting.value,
                "error": error,
                "error_of": of,
                "unit": setting.unit,
            }
        )
    return {
        "parts": parts,
        "joins": describe_nets(scene),
        "frames": list(describe_frames(scene)),
        "left_out": list(map(asdict, dict.fromkeys(left_out))),
        "default_stop_s": scene.stop_time if scene.has_default_stop_time else None,
        "error_budget": scene.error_budget,
        "settings": settings,
    }
