"""Solution of a scene from its equations, with the full models of its parts.

Statics and frequency responses are solved directly. Transients are in
:mod:`kc2spice.workflow.verify.full_transient`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from itertools import chain
from typing import Any

from kc2spice.core.constitutive_laws import Law, PortBody
from kc2spice.core.errors import SimulationError
from kc2spice.core.progress import StageTimer
from kc2spice.core.waveforms import Waveforms
from kc2spice.equations.networks import Network
from kc2spice.equations.recorded_sources import select_networks_to_solve
from kc2spice.equations.scene_laws import get_scene_laws, store_laws
from kc2spice.rom.full_model_surrogate import make_surrogate
from kc2spice.rom.linear_model import LinearModel
from kc2spice.scene.scene_classes import BuiltScene
from kc2spice.workflow.verify.full_transient import (
    FullSolution,
    add_differences,
    compute_full_model_differences,
    list_port_bodies,
)
from kc2spice.workflow.verify.law_solution import LawSolution, solve_without_transient

MAX_DIRECT_UNKNOWNS = 3000  # number of unknowns up to which every frequency is solved directly


def with_full_models(build: BuiltScene, clock: StageTimer) -> BuiltScene | None:
    """Return the built scene with full, not reduced, models; None without full models.

    The result is None if no part has a full model. In a transient, only bodies have full models. In
    a transient, the integrator represents each full model by relations between the quantities at
    the model's ports.
    """
    timed = build.scene.analysis.type == "transient"
    result = {}
    for part in build.scene.parts.values():
        if part.is_body or not timed:
            full = part.type.build(part, build.scene, clock, full=True)
            if full is not None:
                result[part.name] = (
                    _make_sparse_full_model(full) if isinstance(full, LinearModel) else full
                )
    return _with_models(build, result) if result else None


def with_finer_models(
    build: BuiltScene, parts: Iterable[str], clock: StageTimer
) -> BuiltScene | None:
    """Return the built scene with finer discretisations, or None if no part has any.

    The result is None if no part has a finer discretisation. Examples are a squeezed gas film with
    more branches and a conductor with more current loops.
    """
    scene, result = build.scene, {}
    for name in parts:
        finer = scene.parts[name].type.build(scene.parts[name], scene, clock, full=True)
        if finer is not None:
            result[name] = finer
    return _with_models(build, result) if result else None


def _with_models(build: BuiltScene, models: Mapping[str, Any]) -> BuiltScene:
    """Return the built scene with the models of some parts replaced."""
    return store_laws(replace(build, models={**build.models, **models}))


def _make_sparse_full_model(model: LinearModel) -> LinearModel:
    """Return a full model with sparse matrices.

    The law of a sparse model has equations only at the ports of the model.
    """
    if not model.pencil.is_dense:
        return model
    from scipy import sparse

    matrices = {k: sparse.csc_array(P) for k in "MEKA" if (P := getattr(model, k)) is not None}
    return replace(model, **matrices)


def solve_full_models(
    build: BuiltScene,
    full: BuiltScene,
    ours: Waveforms,
    exact: LawSolution,
    replayed: Mapping[str, str],
    clock: StageTimer,
    thorough: bool,
) -> FullSolution | None:
    """Solve the scene with its full models; None if no network contains a full model.

    ``ours`` contains the waveforms that ngspice computed. Sources impose waveforms of ``ours`` on
    the nets in ``replayed``. ``exact`` is the solution of the equations with reduced models, which
    kc2spice computes without ngspice. With ``thorough``,
    :data:`kc2spice.workflow.verify.full_transient.FULL_STEP_FACTOR` times as many steps are
    allowed, and no full model is replaced by a surrogate.

    Raises
    ------
    SimulationError : there is no equilibrium, or a step does not converge.
    """
    networks = select_networks_to_solve(get_scene_laws(full), ours, replayed)
    if build.scene.analysis.type != "transient":
        words = "at its ports"
        if build.scene.analysis.is_small_signal:
            stop = float(build.scene.analysis.stop or 0.0)
            networks = networks if thorough else _with_surrogates(networks, stop, clock)
            points = ours.scale.size
            for body in chain.from_iterable(map(list_port_bodies, networks)):
                # the body kept its full model, because no surrogate is accurate enough
                if body.model.order > MAX_DIRECT_UNKNOWNS:
                    words = f"{body.model.order} unknowns at {points} frequencies, solved at each"
        with clock.time_stage("full model", words):
            return FullSolution(solve_without_transient(networks, full, ours))
    networks = list(filter(list_port_bodies, networks))
    if not networks:
        return None
    rows = (
        compute_full_model_differences(network, build, exact, clock, thorough)
        for network in networks
    )
    fine, coarse, notes = zip(*rows, strict=True)
    end = min(float(item.time[-1]) for item in fine)
    waves, coarse_waves = (add_differences(exact, items, end) for items in (fine, coarse))
    return FullSolution(waves, coarse_waves, end, notes)


def _with_surrogates(networks: list[Network], stop: float, clock: StageTimer) -> list[Network]:
    """Replace large full models of networks by small surrogates with a checked error.

    All copies of a body have the same surrogate.
    """
    bodies: dict[int, PortBody] = {}

    def replace_by_surrogate(law: Law) -> Law:
        """Return a part's equations with a surrogate in place of a large full model."""
        if not isinstance(law, PortBody) or law.model.order <= MAX_DIRECT_UNKNOWNS:
            return law
        if id(law.model) not in bodies:
            with clock.time_stage("full model", f"{law.name}: basis against direct solutions"):
                try:
                    model, _ = make_surrogate(law.model, (0.0, stop))
                except SimulationError:
                    model = law.model
            bodies[id(law.model)] = replace(law, model=model, responses={})
        return replace(bodies[id(law.model)], name=law.name)

    return [
        replace(network, laws=tuple(map(replace_by_surrogate, network.laws)))
        for network in networks
    ]
