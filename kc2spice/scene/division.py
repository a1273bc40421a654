"""How the error of a scene's result is divided over the stages, and who set what."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from kc2spice.scene.budget import (
    REDUCTION,
    STEPPING,
    TRANSIENT,
    divide,
    known_error,
    lookup_error,
)
from kc2spice.scene.schema import Scene

KEYS = {
    "reduction": ("rom.order", "rom.tolerance", "rom.band"),
    "time stepping": ("solver.reltol", "solver.chgtol"),
    "lookup": ("catch.points",),
}


@dataclass(frozen=True)
class Share:
    """One stage: its part of error_budget and the error expected of its settings.

    ``share`` is None where the stage is no part of the budget, ``expected`` where no error is
    known. Both are relative.
    """

    stage: str
    share: float | None
    expected: float | None
    settings: str
    why: str


def division(scene: Scene) -> tuple[Share, ...]:
    """Every stage of the scene; the shares add up to ``error_budget`` at most."""
    return (*_meshes(scene), *_stages(scene), *_controller(scene))


def parts(scene: Scene) -> tuple[str, ...]:
    """The parts of a scene that have models with an error."""
    return tuple(part for part in ("kick", "catch") if getattr(scene, part) is not None)


def _stages(scene: Scene) -> Iterator[Share]:
    budget = scene.error_budget
    for stage, setting in divide(scene.experiment, parts(scene), budget or 1.0).items():
        values = {name: _value(scene, name) for name in KEYS[stage]}
        text = ", ".join(f"{k} {_short(v)}" for k, v in values.items() if v is not None)
        own = budget is not None and scene.budgeted.issuperset(
            name for name, value in values.items() if value is not None and name in _counted(scene)
        )
        yield Share(
            stage,
            setting.error if own else None,
            _expected(scene, stage, values),
            text,
            "error_budget" if own else "set by the scene",
        )


def _counted(scene: Scene) -> set[str]:
    """Keys that must be the budget's for a stage to be within its share."""
    names = {name for keys in KEYS.values() for name in keys}
    return names if scene.experiment in TRANSIENT else names - {"rom.band"}


def _expected(scene: Scene, stage: str, values: dict[str, Any]) -> float | None:
    if stage == "lookup":
        return lookup_error(scene.experiment, values["catch.points"])
    if scene.experiment not in TRANSIENT:
        return scene.rom.tolerance
    return known_error(REDUCTION if stage == "reduction" else STEPPING, values)


def _value(scene: Scene, name: str) -> Any:
    section, key = name.split(".")
    return getattr(getattr(scene, section), key)


def _short(value: Any) -> str:
    return " … ".join(f"{each:g}" for each in value) if isinstance(value, tuple) else f"{value:g}"


def _meshes(scene: Scene) -> Iterator[Share]:
    """Meshes are the user's: that of the chip is the paper's, and finer rings are another model."""
    if scene.kick is not None:
        mesh, why = scene.kick.mesh, "fixed by kick.mesh, not part of the budget"
        contact = scene.contact is not None and scene.experiment in TRANSIENT
        yield Share(
            "mesh",
            None,
            0.02 if contact else None,
            f"kick.mesh.refine {mesh.refine}, ring_spacing {mesh.ring_spacing:g} m",
            f"{why}; finer rings move launch and impact by 2 %" if contact else why,
        )
    if scene.catch is not None:
        yield Share(
            "field mesh",
            None,
            4e-4,
            f"catch.refine {scene.catch.refine}, positions {scene.catch.positions}",
            "fixed by catch.refine and positions, not part of the budget; of the largest force",
        )


def _controller(scene: Scene) -> Iterator[Share]:
    if scene.control is not None:
        yield Share(
            "controller",
            None,
            3.5e-5,
            "op-amps with finite gain",
            "not part of the budget: what real op-amps do to the position, against an ideal PID",
        )
