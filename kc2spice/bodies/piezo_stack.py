"""The multilayer piezoelectric stack: ring-shaped contact ports on its top, one electrode pair."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from kc2spice.bodies.coupled import electromechanical
from kc2spice.fem.piezo.assembly import assemble_kick
from kc2spice.rom.linear import LinearModel, with_potentials

if TYPE_CHECKING:
    from kc2spice.fem.piezo.keys import Chip
    from kc2spice.fem.piezo.mesh import KickMesh
    from kc2spice.fem.piezo.system import PiezoSystem


def piezo_stack(kick: Chip, mesh: KickMesh | None = None) -> LinearModel:
    """The whole stack: ports ``ring0``...``ringN`` (mean displacement of each ring of the top,
    upwards, against a force spread over it) and ``anode`` (pins ``anode``, ``cathode``), with
    facts.

    ``kick`` holds the keys of a ``piezo_stack`` part (side, height, layers, material, mesh,
    damping); ``mesh`` is built from it unless given.

    Raises
    ------
    SimulationError : the model is not positive definite (an impossible material).
    """
    return from_sector(assemble_kick(kick, mesh))


def from_sector(system: PiezoSystem) -> LinearModel:
    """The device of which ``system`` is one of ``sectors`` that move alike, with its facts.

    The unknowns stay those of one sector. Inertia, stiffness and charge are ``sectors`` times the
    sector's; a force on a whole ring is shared by the sectors, which all answer with the
    displacement of one, so B is that of the sector and the electrical column ``sectors`` times it.
    """
    n = float(system.sectors)
    model = with_potentials(
        M=n * system.M, K_uu=n * system.K_uu, K_up=n * system.K_up, K_pp=n * system.K_pp,
        k_uV=n * system.k_uV, k_pV=n * system.k_pV, c_VV=n * system.c_VV, B=system.B,
        ports=system.ports,
        alpha=system.alpha, beta=system.beta, name="piezo_stack",
    )  # fmt: skip
    facts = {"unknowns": system.unknowns, "mass_kg": n * system.mass}
    facts |= electromechanical(model, system.shift)
    facts["free_stroke_m_per_100v"] = 100 * facts.pop("free_stroke_m_per_v")  # as data sheets do
    return replace(model, facts=facts)
