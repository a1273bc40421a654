"""Plan of a run: parts, joins, omissions, and the numerical settings, each an axis.

A key that trades time for error is marked with :class:`kc2spice.core.quantities.Notch` where it is
declared. ``error_budget`` and ``bench`` move along the same axes, and ``explain`` lists them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import chain
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

MAX_STEP = "solver.max_step"
MOST_POINTS = 2e5  # time points of a transient
WIDER = 2.0  # the highest frequency of a reduction, whose body steps and contacts excite above it


@dataclass(frozen=True)
class Axis:
    """A setting: the dotted ``name`` of its key, its ``value`` today, what a notch does to it.

    ``low`` and ``high`` bound the value. ``finer`` are further keys that any notch finer sets.
    ``band`` goes with a reduction's tolerance; its highest frequency grows by ``wider`` a notch
    finer. ``decades`` are those of a grid of equal points in each, whose finer ones contain it.
    ``model`` marks settings that cost no time of the simulator, ``mesh`` that of a mesh among them.
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
        """Return keys refined by ``notches`` (negative: coarser); empty if nothing changes."""
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


def axes(build: Build) -> tuple[Axis, ...]:
    """The settings of a scene that trade time for error; once its largest time step is known that
    too where the scene does not set it."""
    return tuple(axis for axis in _axes(build) if axis.at(1.0))


def finest_axes(build: Build) -> tuple[Axis, ...]:
    """The settings at their finest value: only a coarser run shows their error."""
    return tuple(axis for axis in _axes(build) if not axis.at(1.0) and axis.at(-1.0))


def _axes(build: Build) -> Iterator[Axis]:
    scene = build.scene
    if scene.analysis.type == "transient":
        solver = {axis.name: axis for axis in _marked(scene.solver, "solver")}
        yield solver["solver.reltol"]
        yield replace(solver["solver.chgtol"], finer={"solver.ringing": "followed"})
        step: float | None = scene.solver.max_step
        if step is None and build.largest is not None:
            step = build.largest.step
        if step is not None:
            axis = _axis(MAX_STEP, step, Solver.model_fields["max_step"])
            yield replace(axis, low=min(step, scene.stop / MOST_POINTS))
    elif scene.analysis.small and "analysis" in scene.tables:
        (axis,) = _marked(scene.analysis, "analysis")
        yield replace(axis, decades=_decades(scene.analysis))
    yield from _reductions(build)
    for part in scene.parts.values():
        yield from _marked(part.keys, part.key_prefix)


def _decades(analysis: Analysis) -> float:
    """Decades over which frequencies are equally spaced in each; 0 on a linear scale."""
    if analysis.scale == "linear":
        return 0.0
    return math.log10(float(analysis.stop or analysis.start) / analysis.start)


def _marked(keys: BaseModel, prefix: str) -> Iterator[Axis]:
    """Axes of the marked keys of a table and of the tables in it, but for reductions."""
    for name, declared in type(keys).model_fields.items():
        value = getattr(keys, name)
        if isinstance(value, BaseModel) and not isinstance(value, Rom):
            yield from _marked(value, f"{prefix}.{name}")
        notch = _notch(declared)
        if notch is not None and value is not None and notch.applies(keys):
            yield _axis(f"{prefix}.{name}", value, declared)


def _reductions(build: Build) -> Iterator[Axis]:
    """One axis for all bodies that follow the scene's ``rom``, one for each of its own."""
    scene = build.scene
    timed = scene.analysis.type == "transient"
    known: set[str] = set()
    for part in scene.parts.values():
        rom = scene.records[part.name].reduction
        if rom is None:
            continue
        separate = getattr(part.keys, "rom", None) is not None
        prefix = f"{part.key_prefix}.rom" if separate or not _alone(part, scene) else "rom"
        if prefix in known:
            continue
        known.add(prefix)
        if rom.tolerance is None:
            yield _axis(f"{prefix}.order", int(rom.order or 1), Rom.model_fields["order"])
            continue
        band = rom.band
        if not separate and "rom" not in scene.tables:
            certificate = getattr(build.models.get(part.name), "certificate", None)
            band = rom.band if certificate is None else certificate.band_hz
        axis = _axis(f"{prefix}.tolerance", rom.tolerance, Rom.model_fields["tolerance"])
        # At the values of a run no box is needed, nor a band as narrow as polynomials want it.
        plain: dict[str, Any] = {f"{prefix}.parameters": {}} if rom.parameters else {}
        wider = (WIDER**2 if plain else WIDER) if timed else 1.0
        yield replace(axis, band=band, wider=wider, finer=plain)


def _alone(part: Part, scene: Scene) -> bool:
    """Whether all reductions of the scene are that of ``part``, so that one key moves them all."""
    every = [record.reduction for record in scene.records.values()]
    reduction = scene.records[part.name].reduction
    return all(rom is None or rom == reduction for rom in every)


def _axis(name: str, value: float, declared: FieldInfo) -> Axis:
    notch = _notch(declared)
    assert notch is not None
    bounds: dict[type, float] = {
        type(m): getattr(m, type(m).__name__.lower())
        for m in declared.metadata
        if isinstance(m, (Ge, Le, Lt))
    }
    low, high = bounds.get(Ge, 0.0), bounds.get(Le, bounds.get(Lt, float("inf")) / 2)
    if notch.factor < 1 and notch.finest:
        low = min(notch.finest, value)
    return Axis(name, value, notch, low, high, model=notch.model, mesh=notch.mesh)


def _notch(declared: FieldInfo) -> Notch | None:
    return next((item for item in declared.metadata if isinstance(item, Notch)), None)


def keys_at(selected: Sequence[Axis], notches: Mapping[str, float]) -> dict[str, Any]:
    """Keys of a scene whose axes are moved by so many notches, by the names of the axes."""
    result: dict[str, Any] = {}
    for axis in selected:
        result |= axis.at(notches.get(axis.name, 0.0))
    return result


def _noise(part: Part, build: Build) -> str:
    """Noise sources of a part in words, if the scene has a noise analysis."""
    result = part.type.noise
    noise = result if isinstance(result, str) else "thermal noise at 27 C" if result else "no noise"
    return f"; {noise}" if build.noisy else ""


def _mesh(part: Part, build: Build) -> str:
    """Text of a part about its mesh."""
    text = part.type.discretisation(part, build)
    return f"; {text}" if text else ""


def _mesh_error(axis: Axis, build: Build) -> float | None:
    """The largest estimated error of the mesh that an axis refines, None where it is not known."""
    if not axis.mesh:
        return None
    parts = [p for p in build.scene.parts.values() if axis.name.startswith(f"{p.key_prefix}.")]
    errors = (mesh_errors(build.facts(part)).values() for part in parts)
    return max(chain.from_iterable(errors), default=None)


def plan(build: Build) -> dict[str, Any]:
    """Plan of a run, as in ``plan`` of ``result.json``.

    ``parts`` with ``source`` and ``detail``, ``joins`` (the nets), ``frames`` (what displacements
    count from), ``left_out`` (effects; those of several parts once), and ``settings``, what trades
    time for error, with the relative ``error`` known of each before a run: None where only a
    refined run can tell.
    """
    scene = build.scene
    parts = scene.parts.values()
    notes = {part.name: list(part.type.notes(part, scene)) for part in parts}
    left_out = (row for rows in notes.values() for row in rows if isinstance(row, Neglected))
    texts = {n: "; ".join(row for row in rows if isinstance(row, str)) for n, rows in notes.items()}
    detail = {p.name: texts[p.name] + _mesh(p, build) + _noise(p, build) for p in parts}
    settings = [
        {"key": axis.name, "value": axis.value, "error": _mesh_error(axis, build)}
        for axis in axes(build)
    ]
    for item in settings if scene.analysis.small else ():  # else steps excite what is above a band
        if str(item["key"]).endswith("rom.tolerance"):
            item["error"] = item["value"]
    return {
        "parts": [
            {"part": p.name, "source": p.type.source, "detail": detail[p.name]} for p in parts
        ],
        "joins": describe_nets(scene),
        "frames": list(describe_frames(scene)),
        "left_out": list(map(asdict, dict.fromkeys(left_out))),
        "error_budget": scene.error_budget,
        "settings": settings,
    }
