"""Solution of a scene from its equations, without a netlist.

Statics and frequency responses are solved directly from :mod:`kc2spice.equations`. The independent
integrator (:mod:`kc2spice.reference`) solves transients.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from kc2spice.core.constitutive_laws import evaluate_combinations, scale_wave
from kc2spice.core.waveforms import Waveforms
from kc2spice.equations.networks import Network, get_law_name
from kc2spice.equations.recorded_sources import select_networks_to_solve
from kc2spice.equations.scene_laws import get_scene_laws
from kc2spice.reference import equilibrium
from kc2spice.reference.radau_integrator import Trajectory, solve_transient
from kc2spice.reference.small_signal_analysis import solve_ac, solve_noise
from kc2spice.reference.system import assemble_system
from kc2spice.scene.results import NOISE_WAVE
from kc2spice.scene.scene_classes import BuiltScene

# Relative tolerance of the integrator.
# At a tolerance of 1e-8, a sphere that rings at megahertz loses 5e-7 of its energy.
INTEGRATOR_RTOL = 1.5e-9


@dataclass(frozen=True)
class LawSolution:
    """Reference solution of a scene: waveforms from its parts' laws, without ngspice.

    ``results`` are the waves that both ngspice and the equations determine. ``imbalance`` is the
    error of the energy balance of a transient, relative to the exchanged energy; None for other
    analyses. ``runs`` are the integrated networks with their trajectories.
    """

    results: Waveforms
    imbalance: float | None = None
    runs: tuple[tuple[Network, Trajectory], ...] = ()


def solve_laws(
    build: BuiltScene,
    waves: Waveforms,
    replayed: Mapping[str, str] | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> LawSolution:
    """Solve the equations (laws) of a scene at the times or sweep points of ``waves``.

    ``waves`` are the results of ngspice. On the nets ``replayed``
    (:func:`kc2spice.equations.recorded_sources.find_replayed_nets`), sources prescribe the values
    of ngspice.

    Raises
    ------
    UsageError : the equations contradict each other.
    SimulationError : there is no equilibrium, or an equation is outside its valid range.
    """
    networks = select_networks_to_solve(get_scene_laws(build), waves, replayed or {})
    if build.scene.analysis.type != "transient":
        return LawSolution(solve_without_transient(networks, build, waves))
    stop = build.scene.stop_time
    times = np.minimum(np.unique(waves["time"]), stop)
    systems = [assemble_system(network.laws, network.joins) for network in networks]
    results = [
        solve_transient(system, stop, INTEGRATOR_RTOL, times, progress) for system in systems
    ]
    runs = tuple(zip(networks, results, strict=True))
    grid = np.unique(np.concatenate([times, *(run.time for run in results)]))
    data = {"time": grid}
    for network, run in runs:
        data |= evaluate_combinations(network.results, replace(run, time=grid).waves, grid)
    balances = [run.energy for run in results]
    turnover = sum(balance.turnover for balance in balances)
    imbalance = sum(abs(balance.residual) for balance in balances) / turnover if turnover else None
    return LawSolution(Waveforms(data, {}), imbalance, runs)


def solve_without_transient(
    networks: Iterable[Network], build: BuiltScene, waves: Waveforms
) -> Waveforms:
    """Solve networks for all analyses except transients.

    The solutions are computed at the frequencies or swept values of ``waves``.
    """
    scale, points = next(iter(waves.data.items()))
    points = points.real
    data = {scale: points}
    for network in networks:
        if build.has_noise:
            data |= _solve_noise(network, build, points)
        else:
            data |= evaluate_combinations(
                network.results, _solve_network_without_transient(network, build, points), points
            )
    return Waveforms(data, {})


def _solve_noise(network: Network, build: BuiltScene, points: np.ndarray) -> dict[str, np.ndarray]:
    """Return the noise density of the output; empty if the network lacks the output."""
    name = str(build.scene.analysis.output)
    law_pins = {f"{link.part}.{link.pin}": link.law_pin for link in get_scene_laws(build).pin_links}
    output = network.results.get(name)
    if output is None and name in law_pins:
        output = scale_wave(law_pins[name])
    if output is None or output.rate or get_law_name(output.terms[0][1]) not in network.law_names:
        return {}
    return {NOISE_WAVE: solve_noise(network.laws, network.joins, output, points)}


def _solve_network_without_transient(
    network: Network, build: BuiltScene, points: np.ndarray
) -> Mapping[str, np.ndarray]:
    """Solve a network for an ac, dc or operating point analysis, without a transient."""
    system, kind = assemble_system(network.laws, network.joins), build.scene.analysis.type
    if kind == "ac":
        return solve_ac(system, points)
    source, values = None, np.zeros(1)
    sweep = build.dc_sweep
    if sweep is not None:
        (first, last), values = sweep.ends, sweep.values
        if build.scene.analysis.back:
            values = last - np.sign(last - first) * np.abs(values - last)
        source = network.sweeps.get((sweep.part, sweep.key))
    if source is not None:
        return equilibrium.solve_dc(system, source[0], source[1] * values)
    point = equilibrium.solve_operating_point(system)
    return {name: np.full(values.size, value) for name, value in point.items()}
