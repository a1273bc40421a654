"""The models of a scene's parts: FE, reduction and field tables, built once and cached."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kc2spice.cache import cached
from kc2spice.fem.emtable import EMTable, current_pairs, em_cases
from kc2spice.fem.magnetics import catch_table
from kc2spice.fem.mesh import kick_mesh
from kc2spice.fem.piezo import assemble_kick
from kc2spice.fem.system import Port
from kc2spice.rom.facts import condensed_facts
from kc2spice.rom.modal import resonators, whole_device
from kc2spice.rom.model import Certificate, ResonatorModel
from kc2spice.rom.reduce import reduce_condensed
from kc2spice.rom.schur import condense
from kc2spice.scene.need import need
from kc2spice.scene.schema import Scene
from kc2spice.study.progress import Clock


@dataclass(frozen=True)
class KickModel:
    """The reduced chip, whole device, with the facts of the full model it came from.

    ``ring_radii`` (rings,) [m] are those of the mechanical ports, ``sectors`` the symmetry sectors
    that make the device.
    """

    resonators: ResonatorModel
    ring_radii: np.ndarray
    sectors: int
    facts: dict[str, float]


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


def _kick(scene: Scene, clock: Clock) -> KickModel:
    kick = need(scene.kick, "kick")

    def build() -> KickModel:
        with clock.stage("mesh", "chip mesh"):
            mesh = kick_mesh(kick)
        with clock.stage("assemble", "piezoelectric matrices"):
            system = assemble_kick(kick, mesh)
        with clock.stage("reduce", "factorisation and Krylov basis"):
            condensed = condense(system)
            modal = resonators(reduce_condensed(condensed, scene.rom))
            facts = condensed_facts(condensed)
        whole = whole_device(modal, system.sectors)
        return KickModel(whole, system.ring_radii, system.sectors, facts)

    # The drive pulse and the electrical boundary act on the circuit, not on the chip's model.
    key = {
        "kick": kick.model_dump(exclude={"drive", "electrical"}),
        "rom": scene.rom,
    }
    model, _ = cached(
        "kick", key, build, classes=(KickModel, ResonatorModel, Certificate, Port),
        sources=("kc2spice.fem", "kc2spice.rom"),
    )  # fmt: skip
    return model


def _table(scene: Scene, clock: Clock) -> EMTable:
    catch, sphere = need(scene.catch, "catch"), need(scene.sphere, "sphere")

    def build() -> EMTable:
        with clock.stage("magnetics", "field of the catch actuator") as share:
            return catch_table(catch, sphere, lambda done, total: share(done / total))

    key = {"catch": catch, "radius": sphere.radius}
    table, _ = cached("catch", key, build, classes=(EMTable,), sources=("kc2spice.fem",))
    return table


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
