"""The models of a scene's parts: FE, reduction and field tables, built once and cached."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from kc2spice.core.cache import cached
from kc2spice.core.progress import Clock
from kc2spice.fem.magnetics.table import EMTable, current_pairs, em_cases
from kc2spice.rom.linear import Certificate, LinearModel, Port
from kc2spice.rom.modal import Resonators, resonators
from kc2spice.scene.need import need
from kc2spice.scene.rings import kept_rings
from kc2spice.scene.schema import Drive, Kick, Scene

# What builds is imported where it builds: most runs find their models in the cache.
if TYPE_CHECKING:
    from kc2spice.fem.piezo.mesh import KickMesh
    from kc2spice.fem.piezo.system import PiezoSystem


@dataclass(frozen=True, eq=False)
class KickModel:
    """The reduced chip, whole device, with the facts of the full model it came from.

    ``ring_radii`` (rings,) [m] are those of the mechanical ports, ``sectors`` the symmetry sectors
    that make the device.
    """

    model: LinearModel
    ring_radii: np.ndarray
    sectors: int

    @property
    def facts(self) -> dict[str, float]:
        """Numbers of the full model."""
        return dict(self.model.facts)

    @cached_property
    def resonators(self) -> Resonators:
        """The chip as decoupled resonators."""
        return resonators(self.model)


@dataclass(frozen=True)
class Models:
    """What the netlist is made from; None for a part that the scene does not have."""

    kick: KickModel | None
    table: EMTable | None


def build_models(scene: Scene, clock: Clock) -> Models:
    """Build or fetch the models of the parts that the scene names, and only those."""
    return Models(
        kick=None if scene.kick is None else _kick(scene, clock),
        table=None if scene.catch is None else _table(scene, clock),
    )


def model_keys(scene: Scene) -> dict[str, dict[str, Any]]:
    """What the chip's matrices, their reduction and the catch's field depend on, where present.

    Scenes with equal entries share that model. Pulse, drivers and electrical boundary act on the
    circuit, the field is linear in the remanence and moves with its parts: none is part of a model.
    """
    keys: dict[str, dict[str, Any]] = {}
    if scene.kick is not None:
        keys["chip"] = scene.kick.model_dump(mode="json", exclude={"drive", "electrical", "driver"})
        keys["reduction"] = {
            "kick": keys["chip"], "rings": kept_rings(scene),
            "rom": scene.rom.model_dump(mode="json"),
        }  # fmt: skip
    if scene.catch is not None:
        apart = {"remanence", "shift", "points", "driver"}
        catch = scene.catch.model_dump(mode="json", exclude=apart)
        keys["field"] = {"catch": catch, "radius": need(scene.sphere, "sphere").radius}
    return keys


# The last chip stays in memory: the next scene often asks for another reduction of the same one.
@lru_cache(maxsize=1)
def _mesh(chip: Kick) -> KickMesh:
    from kc2spice.fem.piezo.mesh import kick_mesh

    return kick_mesh(chip)


@lru_cache(maxsize=1)
def _assembled(chip: Kick) -> PiezoSystem:
    from kc2spice.fem.piezo.assembly import assemble_kick

    return assemble_kick(chip, _mesh(chip))


@lru_cache(maxsize=1)
def _device(chip: Kick) -> LinearModel:
    from kc2spice.bodies.piezo_stack import from_sector

    return from_sector(_assembled(chip))


def _kick(scene: Scene, clock: Clock) -> KickModel:
    chip = need(scene.kick, "kick").model_copy(
        update={"drive": Drive(), "electrical": "driven", "driver": None}
    )

    def build() -> KickModel:
        from kc2spice.rom.reduce import reduce

        with clock.stage("mesh", "chip mesh"):
            _mesh(chip)
        with clock.stage("assemble", "piezoelectric matrices"):
            sector = _assembled(chip)
        with clock.stage("reduce", "factorisation and Krylov basis"):
            device = _device(chip)
            rings = sector.ring_radii[: kept_rings(scene)]
            kept = device.select([*(f"R{k}" for k in range(rings.size)), "anode"])
            rom = scene.rom
            small = reduce(kept, order=rom.order, tolerance=rom.tolerance, band=rom.band)
        return KickModel(small, rings, sector.sectors)

    model, _ = cached(
        "kick", model_keys(scene)["reduction"], build,
        classes=(KickModel, LinearModel, Certificate, Port),
        sources=("kc2spice.linalg", "kc2spice.fem", "kc2spice.rom", "kc2spice.bodies"),
    )  # fmt: skip
    return model


def _table(scene: Scene, clock: Clock) -> EMTable:
    catch, sphere = need(scene.catch, "catch"), need(scene.sphere, "sphere")
    unit = catch.model_copy(update={"remanence": 1.0, "shift": 0.0, "driver": None})

    def build() -> EMTable:
        from kc2spice.fem.magnetics.field import catch_table

        with clock.stage("magnetics", "field of the catch actuator") as share:
            return catch_table(unit, sphere, lambda done, total: share(done / total))

    key = model_keys(scene)["field"]
    table, _ = cached(
        "catch", key, build, classes=(EMTable,), sources=("kc2spice.linalg", "kc2spice.fem")
    )
    return mounted(table, catch.remanence, catch.shift)


def mounted(table: EMTable, factor: float, shift: float) -> EMTable:
    """The table for ``factor`` times the remanence, of an actuator ``shift`` [m] higher; exact.

    In linear materials the pull between the magnets grows with the square, what a current adds in
    proportion, and what currents do alone not at all. Air box and ring move together.
    """
    return replace(
        table,
        y=table.y + shift,
        c0=factor**2 * table.c0,
        c1=factor * table.c1,
        c2=factor * table.c2,
        flux0=factor * table.flux0,
    )


def model_facts(models: Models) -> dict[str, dict[str, float]]:
    """``model`` of ``result.json``: the numbers by which an engineer knows the actuators."""
    facts: dict[str, dict[str, float]] = {}
    if models.kick is not None:
        facts["kick"] = models.kick.facts
    if models.table is not None:
        facts["catch"] = _table_facts(models.table)
    return facts


def _table_facts(table: EMTable) -> dict[str, float]:
    return {
        "unknowns": table.unknowns,
        "force_max_n": float(abs(em_cases(table, current_pairs())).max()),
        "coil_resistance_ohm": float(table.resistance[0]),
        "coil_inductance_h": float(table.inductance[:, 0, 0].mean()),
        "coil_mutual_h": float(table.inductance[:, 0, 1].mean()),
    }
