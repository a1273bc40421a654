"""The scene's analysis with the full models of its parts in place of the reduced ones.

Statics and frequency responses are solved outright; :mod:`kc2spice.workflow.verify.full_transient`
does transients.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

from kc2spice.core.errors import SimulationError
from kc2spice.core.laws import Law, PortBody
from kc2spice.core.waveforms import Waveforms
from kc2spice.equations.circuits import Circuit
from kc2spice.equations.replay import moving
from kc2spice.rom.linear import LinearModel
from kc2spice.rom.reduce import surrogate
from kc2spice.scene.model import Build
from kc2spice.workflow.verify.full_transient import FullSolution, _added, _followed
from kc2spice.workflow.verify.law_solution import Reference, steady

DIRECT = 3000  # unknowns up to which every frequency is solved directly


def full_build(build: Build, clock: Any) -> Build | None:
    """The scene with every model that has a full one behind it replaced by that; None if none has.

    In time only bodies have, whose full models are followed at their ports.
    """
    timed = build.scene.analysis.type == "transient"
    result = {}
    for part in build.scene.parts.values():
        if part.reduced or not timed:
            full = part.type.build(part, build.scene, clock, full=True)
            if full is not None:
                result[part.name] = _sparse(full) if isinstance(full, LinearModel) else full
    return replace(build, models={**build.models, **result}) if result else None


def finer_build(build: Build, parts: Iterable[str], clock: Any) -> Build | None:
    """The scene with the finer discretisation of these ``parts``, such as a film with more branches
    or a conductor with more loops; None if none of them has one."""
    scene, result = build.scene, {}
    for name in parts:
        finer = scene.parts[name].type.build(scene.parts[name], scene, clock, full=True)
        if finer is not None:
            result[name] = finer
    return replace(build, models={**build.models, **result}) if result else None


def _sparse(model: LinearModel) -> LinearModel:
    """A full model given as arrays, in the form that is followed at its ports."""
    if not model.pencil.is_dense:
        return model
    from scipy import sparse

    matrices = {k: sparse.csc_array(P) for k in "MEKA" if (P := getattr(model, k)) is not None}
    return replace(model, **matrices)


def full_solution(
    build: Build,
    full: Build,
    ours: Waveforms,
    exact: Reference,
    replayed: Mapping[str, str],
    clock: Any,
    whole: bool,
) -> FullSolution | None:
    """The scene with its full models; None where no circuit has one.

    ``ours`` are ngspice's waves, which give ``replayed`` nets, and ``exact`` the solution with the
    reduced models. ``whole`` follows the full model for :data:`WHOLE` times as many steps, at most
    to the end, and takes no surrogate for it.

    Raises
    ------
    SimulationError : no equilibrium, or a step that does not settle.
    """
    parts = moving(full, ours, replayed)
    if build.scene.analysis.type != "transient":
        words = "at its ports"
        if build.scene.analysis.small:
            parts = _with_surrogates(parts, float(build.scene.analysis.stop or 0.0), clock, whole)
            points = ours.scale.size
            for law in (law for c in parts for law in c.laws if isinstance(law, PortBody)):
                if law.model.order > DIRECT:  # no basis is as good: a solution each
                    words = f"{law.model.order} unknowns at {points} frequencies, solved at each"
        with clock.stage("full model", words):
            return FullSolution(steady(parts, full, ours))
    parts = [c for c in parts if any(isinstance(law, PortBody) for law in c.laws)]
    if not parts:
        return None
    fine, coarse, notes = zip(
        *(_followed(c, build, exact, clock, whole) for c in parts), strict=True
    )
    end = min(float(item.time[-1]) for item in fine)
    return FullSolution(_added(exact, fine, end), _added(exact, coarse, end), end, notes)


def _with_surrogates(
    circuits: list[Circuit], stop: float, clock: Any, whole: bool
) -> list[Circuit]:
    """Large models replaced by a basis that is certified against direct solutions, one for all
    copies of a body."""
    small: dict[int, PortBody] = {}

    def replaced(law: Law) -> Law:
        if not isinstance(law, PortBody) or law.model.order <= DIRECT or whole:
            return law
        if id(law.model) not in small:
            with clock.stage("full model", f"{law.name}: basis against direct solutions"):
                try:
                    model, _ = surrogate(law.model, (0.0, stop))
                except SimulationError:
                    model = law.model
            small[id(law.model)] = replace(law, model=model, known={})
        return replace(small[id(law.model)], name=law.name)

    return [replace(c, laws=tuple(replaced(law) for law in c.laws)) for c in circuits]
