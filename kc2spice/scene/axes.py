"""Plan of a run: parts, nets, neglected effects and numerical settings (axes).

A key that trades computing time for accuracy has a :class:`kc2spice.core.quantities.Notch` in its
declaration. ``error_budget`` and ``bench`` vary the axes, and ``explain`` lists them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from annotated_types import Ge, Le, Lt
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from kc2spice.core.mesh_error import mesh_errors
from kc2spice.core.quantities import Notch
from kc2spice.scene.compose import describe_nets
from kc2spice.scene.frames import describe_frames
from kc2spice.scene.model import Build, Part, Scene
from kc2spice.scene.rows import Neglected
from kc2spice.scene.settings import Analysis, Rom, Solver

MAX_STEP_KEY = "solver.max_step"
MAX_TIME_POINTS = 2e5  # time points of a transient with its finest step
# ratio of the highest frequency to the band of a reduction: steps and contacts excite modes above
# the band
BAND_GROWTH = 2.0


@dataclass(frozen=True)
class Axis:
    """Numerical setting: its key, its value and its notch.

    ``name`` is the dotted name of the key.
    ``low`` and ``high`` bound the value. ``finer`` contains further keys that each finer setting
    needs. ``band`` belongs to the tolerance of a reduction: its highest frequency grows by
    ``wider`` with each finer notch. ``decades`` is the width of a grid with equally many points in
    each decade; finer grids contain the coarser ones. ``model`` marks settings that do not change
    the time of the simulator, and ``mesh`` settings of meshes.
    """

    name: str
    value: float
    notch: Notch
    low: float
    high: float
    finer: Mapping[str, Any] = field(default_factory=dict)
    band: tuple[float, float] | None = None
    wider: float = 1.0
    decades: float = 0.0
    model: bool = False
    mesh: bool = False

    def at(self, notches: float) -> dict[str, Any]:
        """Return keys refined by ``notches``; negative numbers make them coarser.

        The result is empty without a change.
        """
        value = self.notch.moved(self.value, notches)
        if self.decades and notches:
            item = round(math.ceil(self.value / self.decades) * self.notch.factor**notches)
            value = math.floor(item * self.decades)
        value = min(max(value, self.low), self.high)
        if not notches or value == self.value:
            return {}
        result: dict[str, Any] = {self.name: value}
        if notches > 0:
            result |= self.finer
        if self.band is not None:
            low, high = self.band
            top = float(f"{self.wider ** max(notches, 0.0) * high:.9g}")
            result[self.name.replace("tolerance", "band")] = [low, top]
        return result


def find_axes(build: Build) -> tuple[Axis, ...]:
    """Return the settings of a scene that trade time for error.

    The axes include the largest time step, if it is known or set.
    """
    return tuple(axis for axis in _list_axes(build) if axis.at(1.0))


def find_finest_axes(build: Build) -> tuple[Axis, ...]:
    """Return the settings at their finest value; only a coarser run can estimate their error."""
    return tuple(axis for axis in _list_axes(build) if not axis.at(1.0) and axis.at(-1.0))


def _list_axes(build: Build) -> Iterator[Axis]:
    """Yield all settings of a scene that have a notch."""
    scene = build.scene
    if scene.analysis.type == "transient":
        solver = {axis.name: axis for axis in _list_marked(scene.solver, "solver")}
        yield solver["solver.reltol"]
        yield replace(solver["solver.chgtol"], finer={"solver.ringing": "followed"})
        step: float | None = scene.solver.max_step
        if step is None and build.largest is not None:
            step = build.largest.step
        if step is not None:
            axis = _make_axis(MAX_STEP_KEY, step, Solver.model_fields["max_step"])
            yield replace(axis, low=min(step, scene.stop / MAX_TIME_POINTS))
    elif scene.analysis.is_small_signal and "analysis" in scene.tables:
        (axis,) = _list_marked(scene.analysis, "analysis")
        yield replace(axis, decades=_count_decades(scene.analysis))
    yield from _list_reductions(build)
    for part in scene.parts.values():
        yield from _list_marked(part.keys, part.key_prefix)


def _count_decades(analysis: Analysis) -> float:
    """Return the decades of a logarithmic range of frequencies; 0 on a linear scale."""
    if analysis.scale == "linear":
        return 0.0
    return math.log10(float(analysis.stop or analysis.start) / analysis.start)


def _list_marked(keys: BaseModel, prefix: str) -> Iterator[Axis]:
    """Yield the axes of marked keys in a table and its inner tables, except reductions."""
    for name, declared in type(keys).model_fields.items():
        value = getattr(keys, name)
        if isinstance(value, BaseModel) and not isinstance(value, Rom):
            yield from _list_marked(value, f"{prefix}.{name}")
        notch = _find_notch(declared)
        if notch is not None and value is not None and _is_used(notch, keys):
            yield _make_axis(f"{prefix}.{name}", value, declared)


def _is_used(notch: Notch, keys: BaseModel) -> bool:
    """Return whether the keys of a table have the values that its notch requires."""
    return all(getattr(keys, name) == value for name, value in notch.when)


def _list_reductions(build: Build) -> Iterator[Axis]:
    """Yield one axis for the scene's ``rom``, and one for each separate ``rom``."""
    scene = build.scene
    timed = scene.analysis.type == "transient"
    known: set[str] = set()
    for part in scene.parts.values():
        rom = scene.records[part.name].reduction
        if rom is None:
            continue
        separate = getattr(part.keys, "rom", None) is not None
        prefix = f"{part.key_prefix}.rom" if separate or not _is_common(part, scene) else "rom"
        if prefix in known:
            continue
        known.add(prefix)
        if rom.tolerance is None:
            yield _make_axis(f"{prefix}.order", int(rom.order or 1), Rom.model_fields["order"])
            continue
        band = rom.band
        if not separate and "rom" not in scene.tables:
            certificate = getattr(build.models.get(part.name), "certificate", None)
            band = rom.band if certificate is None else certificate.band_hz
        axis = _make_axis(f"{prefix}.tolerance", rom.tolerance, Rom.model_fields["tolerance"])
        # A run has one value of each parameter, so it needs no parameter range, and its band may be
        # wider.
        plain: dict[str, Any] = {f"{prefix}.parameters": {}} if rom.parameters else {}
        wider = (BAND_GROWTH**2 if plain else BAND_GROWTH) if timed else 1.0
        yield replace(axis, band=band, wider=wider, finer=plain)


def _is_common(part: Part, scene: Scene) -> bool:
    """Return whether one key changes the reductions of all bodies, including ``part``."""
    reduction = scene.records[part.name].reduction
    return all(record.reduction in (None, reduction) for record in scene.records.values())


def _make_axis(name: str, value: float, declared: FieldInfo) -> Axis:
    """Return the axis of a key with its notch and the bounds of its declaration."""
    notch = _find_notch(declared)
    assert notch is not None
    low, high = 0.0, math.inf
    for bound in declared.metadata:
        if isinstance(bound, Ge):
            low = bound.ge  # type: ignore[assignment]
        elif isinstance(bound, Le):
            high = bound.le  # type: ignore[assignment]
        elif isinstance(bound, Lt):
            high = min(high, bound.lt / 2)  # type: ignore[operator]
    if notch.factor < 1 and notch.finest:
        low = min(notch.finest, value)
    return Axis(name, value, notch, low, high, model=notch.model, mesh=notch.mesh)


def _find_notch(declared: FieldInfo) -> Notch | None:
    """Return the notch of a key, None without one."""
    return next((item for item in declared.metadata if isinstance(item, Notch)), None)


def apply_notches(selected: Sequence[Axis], notches: Mapping[str, float]) -> dict[str, Any]:
    """Return the keys of refined axes; ``notches`` are keyed by name of the axis."""
    result: dict[str, Any] = {}
    for axis in selected:
        result |= axis.at(notches.get(axis.name, 0.0))
    return result


def _describe_noise(part: Part, build: Build) -> str:
    """Describe the noise sources of a part, if the scene has a noise analysis."""
    result = part.type.noise
    noise = result if isinstance(result, str) else "thermal noise at 27 C" if result else "no noise"
    return f"; {noise}" if build.has_noise else ""


def _describe_mesh(part: Part, build: Build) -> str:
    """Describe the mesh of a part."""
    text = part.type.discretisation(part, build)
    return f"; {text}" if text else ""


def _estimate_mesh_error(axis: Axis, build: Build) -> float | None:
    """Return the error estimate of the mesh that an axis refines, None if unknown."""
    if not axis.mesh:
        return None
    errors: list[float] = []
    for part in build.scene.parts.values():
        if axis.name.startswith(f"{part.key_prefix}."):
            errors += mesh_errors(build.facts(part)).values()
    return max(errors, default=None)


def describe_plan(build: Build) -> dict[str, Any]:
    """Return the plan of a run, which is ``plan`` in ``result.json``.

    ``parts`` contains ``source`` and ``detail`` of each part, ``joins`` the nets, and ``frames``
    the origin of displacements. ``left_out`` lists each neglected effect once. ``settings`` lists
    the keys that trade time for error, with the relative ``error`` if it is known before a run.
    """
    scene = build.scene
    parts = []
    left_out: list[Neglected] = []
    for part in scene.parts.values():
        texts: list[str] = []
        for note in part.type.notes(part, scene):
            if isinstance(note, Neglected):
                left_out.append(note)
            else:
                texts.append(note)
        detail = "; ".join(texts) + _describe_mesh(part, build) + _describe_noise(part, build)
        parts.append({"part": part.name, "source": part.type.source, "detail": detail})
    settings = []
    for axis in find_axes(build):
        error = _estimate_mesh_error(axis, build)
        # The steps of a transient excite a body above the band of the tolerance.
        if scene.analysis.is_small_signal and axis.name.endswith("rom.tolerance"):
            error = axis.value
        settings.append({"key": axis.name, "value": axis.value, "error": error})
    return {
        "parts": parts,
        "joins": describe_nets(scene),
        "frames": list(describe_frames(scene)),
        "left_out": list(map(asdict, dict.fromkeys(left_out))),
        "error_budget": scene.error_budget,
        "settings": settings,
    }
