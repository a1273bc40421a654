"""The scene's analysis by its laws: statics and frequency responses outright, transients by the
independent integrator (:mod:`kc2spice.reference`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from kc2spice.core.laws import reading
from kc2spice.core.waveforms import Waveforms
from kc2spice.equations.circuits import Circuit, _owner, read
from kc2spice.equations.replay import moving
from kc2spice.equations.scene_laws import _laws
from kc2spice.reference import equilibrium
from kc2spice.reference.integrate import Result, transient
from kc2spice.reference.linear import ac, noise
from kc2spice.scene.model import Build
from kc2spice.workflow.meters import WAVE, sweep_values, swept

RTOL = 1.5e-9  # integrator; at 1e-8 a sphere ringing at megahertz loses 5e-7 of its energy


@dataclass(frozen=True)
class Reference:
    """The scene's analysis by the reduced models' laws.

    ``results`` are the waves of ngspice that the laws know as well; ``imbalance`` is the share of
    the turned-over energy that the integration cannot account for, None where no time passes.
    """

    results: Waveforms
    imbalance: float | None = None
    runs: tuple[tuple[Circuit, Result], ...] = ()


def solve(
    build: Build,
    waves: Waveforms,
    replayed: Mapping[str, str] | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> Reference:
    """The analysis of the scene at the points of ``waves``, those of ngspice.

    On the nets ``replayed`` (see :func:`replayed_nets`) it is given what ngspice has there.

    Raises
    ------
    UsageError : the laws do not fit each other.
    SimulationError : no equilibrium, or a law left its range.
    """
    parts = moving(build, waves, replayed or {})
    if build.scene.analysis.type != "transient":
        return Reference(steady(parts, build, waves))
    stop = build.scene.stop
    times = np.minimum(np.unique(waves["time"]), stop)
    runs = [(c, transient(c.system(), stop, RTOL, times, progress)) for c in parts]
    grid = np.unique(np.concatenate([times, *(run.time for _, run in runs)]))
    data = {"time": grid}
    for circuit, run in runs:
        data |= read(circuit, replace(run, time=grid).waves, grid)
    balances = [run.energy for _, run in runs]
    turnover = sum(balance.turnover for balance in balances)
    imbalance = sum(abs(balance.residual) for balance in balances) / turnover if turnover else None
    return Reference(Waveforms(data, {}), imbalance, tuple(runs))


def steady(parts: Iterable[Circuit], build: Build, waves: Waveforms) -> Waveforms:
    """:func:`solve` for circuits in which no time passes."""
    scale, points = next(iter(waves.data.items()))
    points = points.real
    data = {scale: points}
    for circuit in parts:
        if build.noisy:
            data |= _noise(circuit, build, points)
        else:
            data |= read(circuit, _steady(circuit, build, points), points)
    return Waveforms(data, {})


def _noise(circuit: Circuit, build: Build, points: np.ndarray) -> dict[str, np.ndarray]:
    """Density of the output's noise, where this circuit has it."""
    name = str(build.scene.analysis.output)
    ends = {f"{part}.{pin}": end for _, part, pin, end in _laws(build).ends}
    of = circuit.readings.get(name) or (reading(ends[name]) if name in ends else None)
    if of is None or _owner(of.terms[0][1]) not in {law.name for law in circuit.laws}:
        return {}
    return {WAVE: noise(circuit.laws, circuit.joins, of, points)}


def _steady(circuit: Circuit, build: Build, points: np.ndarray) -> Mapping[str, np.ndarray]:
    system, kind = circuit.system(), build.scene.analysis.type
    if kind == "ac":
        return ac(system, points)
    source, values = None, np.zeros(1)
    if kind == "dc":
        part, key, result = swept(build)
        assert result.range is not None
        values, last = sweep_values(build), result.range[1]
        if build.scene.analysis.back:
            values = last - np.sign(last - result.range[0]) * np.abs(values - last)
        source = circuit.sweeps.get((part.name, key))
    if source is not None:
        return equilibrium.dc(system, source[0], source[1] * values)
    point = equilibrium.operating_point(system)
    return {name: np.full(values.size, value) for name, value in point.items()}
