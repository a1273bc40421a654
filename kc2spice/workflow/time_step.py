"""Largest time step of a transient, and the effect of time steps on waveforms.

The error control of ngspice keeps the error of each step below a tolerance. At a resonance, the
errors of thousands of steps add up. With steps ``h``, the trapezoidal rule reduces every natural
frequency ``w`` by the fraction ``(w h)^2 / 12``. A drive at a resonance frequency of the circuit
therefore misses the resonance of the numerical solution. Gear's method adds damping. The
trapezoidal rule and Gear's method change the exponential ``e^(r t)`` into an exponential with
another rate. The numerical solution of a linear circuit is therefore known in closed form. The
largest step whose error is within :data:`RMS_ERROR_LIMIT` is determined from the numerical
solution.

Natural modes with a Q factor below :data:`RESONANT_Q` do not limit the step, because the error
control resolves them. Waves that consist only of rounding errors also do not limit the step.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from operator import attrgetter
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from kc2spice.core.constitutive_laws import evaluate_combinations
from kc2spice.core.domains import DOMAINS
from kc2spice.core.errors import SimulationError, UsageError
from kc2spice.core.si_prefix_format import format_quantity
from kc2spice.core.waveforms import Waveform, Waveforms
from kc2spice.equations.networks import Network, get_law_name, list_pin_kinds
from kc2spice.equations.recorded_sources import find_replayed_nets, make_net_source
from kc2spice.equations.scene_laws import get_scene_laws
from kc2spice.scene.checks import Check, RunEnergyBalance
from kc2spice.scene.part_records import STEP_SET_BY_USER, PartResult, StepLimit
from kc2spice.scene.scene_classes import BuiltScene

if TYPE_CHECKING:
    from kc2spice.reference.small_signal_analysis import ExponentialSolution, LinearisedSystem

# Largest permitted errors of the rms value of a wave, and of the wave itself.
# Each error is relative to the largest value of the same quantity.
RMS_ERROR_LIMIT = 5e-4
SHAPE_ERROR_LIMIT = 1e-3
# number of time points above which SHAPE_ERROR_LIMIT no longer reduces the step
MAX_SHAPE_POINTS = 2e5
# number of time points above which RMS_ERROR_LIMIT no longer reduces the step
MAX_RMS_POINTS = 4e6
# Largest relative error of the amplitude of a mode, if a part with unknown equations, such as a
# user's netlist, excites the mode.
# At half-power frequencies of a mode with the Q factor Q, a relative shift s of the natural
# frequency changes the amplitude by the fraction Q s.
MODE_AMPLITUDE_ERROR = 2.5e-3
EQUAL_STEP_RATIO = 1.1  # largest ratio of two steps that count as equal
MIN_POINTS = 1000  # smallest number of points of a run
# Largest step [s] in nonlinear circuits; error control resolves faster changes.
NONLINEAR_STEP = 10e-6
# Q factor up to which a mode counts as aperiodic: 0.5, with a margin for rounding errors
APERIODIC_Q = 0.6
RESONANT_Q = 2.0  # Q factor above which the errors of steps accumulate
SAMPLE_COUNT = 2500
WINDOW_COUNT = 16
# largest number of time points at which a run is compared with the exact solution
MAX_COMPARED_POINTS = 30_000
# Smallest peak of a waveform that is compared with the exact solution, relative to the largest peak
# of all waveforms with the same unit.
# The iterations of ngspice do not refine waveforms whose peak is below MIN_RELATIVE_SIZE times the
# largest peak of all waveforms with the same unit.
MIN_RELATIVE_SIZE = 1e-5
# smallest peak of a waveform that is compared with the exact solution, keyed by unit
MIN_SIZE = {"A": 1e-11, "V": 1e-6, "N": 1e-11, "m": 1e-12, "m/s": 1e-9}
# time around jumps that is left out of comparisons, relative to the duration of the run
EVENT_MARGIN = 1e-9
FAILURE_LIMIT = 1e-2
# Change of a voltage in one step above which the time of its edge is uncertain by half the step.
# The change is relative to the range of the voltage.
EDGE_SHARE = 0.2
# largest share of the area of a voltage that may be uncertain due to unresolved edges
EDGE_LIMIT = 1e-2
MIN_EDGE_VALUE = 1e-3  # smallest uncertain share of the area that is reported
MAX_UNKNOWNS = 600  # the exact solution of circuits with more unknowns would take minutes


def choose_largest_step(build: BuiltScene) -> StepLimit:
    """Return the largest time step of a transient, with the reason for it.

    The result is ``solver.max_step`` if the scene sets this key. If the scene does not set
    ``solver.max_step``, the result is the smallest of the step limits of all parts and of all
    resonances of linear circuits.
    """
    scene = build.scene
    if scene.solver.max_step is not None:
        return StepLimit(scene.solver.max_step, STEP_SET_BY_USER)
    scales = scene.numerics
    decided = min(
        filter(attrgetter("overrides_others"), scales), key=attrgetter("step"), default=None
    )
    if decided is not None:
        return StepLimit(min(decided.step, scene.stop_time), decided.description)
    limits = [StepLimit(scene.stop_time / MIN_POINTS, f"1/{MIN_POINTS} of the run")]
    limits += [StepLimit(row.step, row.description) for row in scales]
    start = min(limits, key=attrgetter("step"))
    linearised = find_linearised_scene(build)
    if not linearised.is_resolved_by_error_control and start.step > NONLINEAR_STEP:
        start = StepLimit(NONLINEAR_STEP, "parts that are not known to be linear")
    rule, limits = INTEGRATION_RULES[scene.solver.method], [start]
    for motion in linearised.exact_solutions:
        if motion is not None:
            limits.append(find_step(motion, start, rule))
    limits += _limit_steps_by_natural_modes(linearised, start, rule)
    return min(limits, key=attrgetter("step"))


def find_step_reason(build: BuiltScene) -> str:
    """Return the reason for the time step limit; empty if the scene sets the limit."""
    if build.scene.solver.max_step or build.largest_step is None:
        return ""
    return build.largest_step.why


def _is_thermal_and_aperiodic(network: Network, motion: ExponentialSolution) -> bool:
    """Return whether a network conducts heat and has no oscillating mode.

    ``motion`` is the exact solution of the linear equations that approximate the network near its
    state of rest.

    Heat has no inertia. A thermal network without oscillating modes therefore needs no limit of the
    time step: error control resolves its time constants. The losses of electrical parts, and the
    resistances of warm conductors, change as slowly as the temperatures.
    """
    kinds = set(list_pin_kinds(network.laws).values())
    heat = any(DOMAINS[kind].is_relaxing for kind in kinds)
    return heat and not (motion.modes.q_factors > APERIODIC_Q).any()


@dataclass(frozen=True)
class LinearisedScene:
    """Networks of a scene, linearised at rest, and their exact transient solutions.

    The choice of the largest step, and the check of the steps after a run, use the same object. The
    object computes the eigenvalues of the networks when they are first needed.
    """

    build: BuiltScene

    def belongs_to(self, build: BuiltScene) -> bool:
        """Return whether this linearisation belongs to the scene and models of ``build``."""
        return self.build.scene is build.scene and self.build.models is build.models

    @property
    def is_resolved_by_error_control(self) -> bool:
        """Whether the simulator's error control suffices for all nonlinear networks.

        Error control suffices if every network is linear, or conducts heat and does not oscillate.
        The result is false if a part is in no network.
        """
        for network, motion in zip(self.networks, self.exact_solutions, strict=True):
            if motion is None or not (
                motion.linear.exact or _is_thermal_and_aperiodic(network, motion)
            ):
                return False
        return not self.parts_without_network

    @cached_property
    def _networks_and_other_parts(self) -> tuple[tuple[Network, ...], tuple[str, ...]]:
        """Networks with unknowns, and names of the parts that belong to no network."""
        try:
            laws = get_scene_laws(self.build)
            networks, missing = laws.networks, laws.parts_without_law
        except UsageError:
            return (), tuple(self.build.scene.parts)
        return tuple(item for item in networks if not item.has_sources_only), missing

    @property
    def networks(self) -> tuple[Network, ...]:
        """Networks of the scene, except networks that consist only of sources."""
        return self._networks_and_other_parts[0]

    @property
    def parts_without_network(self) -> tuple[str, ...]:
        """Names of the parts that belong to no network, as their equations are unknown."""
        return self._networks_and_other_parts[1]

    @cached_property
    def systems(self) -> tuple[LinearisedSystem | None, ...]:
        """Linearised equations of each network; None for networks that cannot be linearised."""
        return tuple(map(_linearise_network, self.networks))

    @cached_property
    def exact_solutions(self) -> tuple[ExponentialSolution | None, ...]:
        """Exact solution of each network; None if a network is too large or unsolvable."""
        stop = self.build.scene.stop_time
        return tuple(_solve_from_rest(system, stop) for system in self.systems)


def find_linearised_scene(build: BuiltScene) -> LinearisedScene:
    """Return the linearised scene that is stored in ``build``, or make a new one.

    A new linearised scene is made if a key or a model of ``build`` has changed since the stored
    linearised scene was made.
    """
    known = build.linearised
    if isinstance(known, LinearisedScene) and known.belongs_to(build):
        return known
    return LinearisedScene(build)


def with_linearised_scene(build: BuiltScene) -> BuiltScene:
    """Return a copy of a built scene, with its linearised scene stored in the copy.

    The returned copy computes each linearised network only once, when the network is first used.
    """
    return replace(build, linearised=find_linearised_scene(build))


def _linearise_network(network: Network) -> LinearisedSystem | None:
    """Linearise a network at rest; return None if it is too large or has no equilibrium."""
    # imported here, because the modules load scipy
    from kc2spice.reference.small_signal_analysis import LinearisedSystem
    from kc2spice.reference.system import assemble_system

    try:
        return LinearisedSystem(assemble_system(network.laws, network.joins, MAX_UNKNOWNS))
    except (SimulationError, UsageError, np.linalg.LinAlgError):
        return None


def _solve_from_rest(system: LinearisedSystem | None, stop: float) -> ExponentialSolution | None:
    """Solve linearised equations exactly up to the time ``stop`` [s], starting from rest.

    The result is None if there are no equations, or if they have no exact solution.
    """
    if system is None:
        return None
    waves = tuple(source.wave for source in system.system.sources)
    return system.compute_transient_solution(waves, stop)


# --- rules of integration -------------------------------------------------------------------------


class IntegrationRule(NamedTuple):
    """Numerical integration rule, described by its effect on exponential functions.

    The step of the rule is ``h``. ``rates`` returns, for an exponential ``e^(r t)``, the rate of
    the numerical solution. The exact response of a mode with the rate r to a source ``e^(j w t)``
    is ``1 / (j w - r)``. The numerical response is ``1 / (s - r)``, where ``s = axis(j w, h)``.
    """

    rates: Callable[[np.ndarray, float], np.ndarray]
    axis: Callable[[np.ndarray, float], np.ndarray]


INTEGRATION_RULES = {
    "trap": IntegrationRule(
        lambda r, h: np.log((1 + r * h / 2) / (1 - r * h / 2)) / h,
        lambda jw, h: 2 / h * np.tanh(jw * h / 2),
    ),
    "gear": IntegrationRule(
        lambda r, h: np.log((2 + np.sqrt(1 + 2 * r * h)) / (3 - 2 * r * h)) / h,
        lambda jw, h: (1.5 - 2 * np.exp(-jw * h) + 0.5 * np.exp(-2 * jw * h)) / h,
    ),
}


def find_step(motion: ExponentialSolution, start: StepLimit, rule: IntegrationRule) -> StepLimit:
    """Return the largest time step with which an integration rule is accurate.

    The step is at most ``start``. The error of the rms value of a wave is at most
    :data:`RMS_ERROR_LIMIT`. The error of the wave itself is at most :data:`SHAPE_ERROR_LIMIT`,
    unless this limit requires :data:`MAX_SHAPE_POINTS` points or more.
    """
    peaks = motion.find_peak_amplitudes()
    t = motion.choose_sample_times(SAMPLE_COUNT)
    outputs = np.arange(len(motion.linear.system.names))
    exact = motion.evaluate_waves(t, outputs)
    real = np.abs(exact).max(axis=0) > motion.estimate_rounding()
    outputs, exact = outputs[real], exact[:, real]
    modes = motion.modes
    if not outputs.size:
        return start
    resonant = modes.q_factors > RESONANT_Q

    def is_accurate(h: float) -> bool:
        """Return whether the integration rule is accurate with a time step.

        ``h`` is the time step [s].
        """

        def compute_discrete_rates(exact: np.ndarray) -> np.ndarray:
            """Convert exact exponential rates [1/s] to the rates of the numerical solution."""
            return np.where(resonant, rule.rates(exact, h), exact)

        tried = motion.evaluate_waves(
            t, outputs, compute_discrete_rates, lambda jw: rule.axis(jw, h)
        )
        amplitude, shape = find_largest_errors(t, tried, exact)
        points = motion.stop / h
        return (amplitude <= RMS_ERROR_LIMIT or points >= MAX_RMS_POINTS) and (
            shape <= SHAPE_ERROR_LIMIT or points >= MAX_SHAPE_POINTS
        )

    h = _bisect_step(is_accurate, motion.stop, start.step)
    if h == start.step:
        return start
    observed = (peaks[:, outputs] / np.abs(exact).max(axis=0)).max(axis=1)
    errors = observed * _compute_mode_errors(modes.rates, rule, h, motion.stop)
    reasons = []
    if resonant.any():
        worst = int(np.argmax(np.where(resonant, errors, -1.0)))
        reasons.append(_describe_resonance(modes.rates[worst], modes.q_factors[worst]))
    reasons += [f"sine at {format_quantity(wave.frequency, 'Hz', 4)}" for _, wave in motion.sines]
    return StepLimit(float(f"{h:.3g}"), "; ".join(dict.fromkeys(reasons)))


def _bisect_step(is_accurate: Callable[[float], bool], stop: float, start: float) -> float:
    """Return the largest accurate time step [s], at most ``start``.

    The run ends at the time ``stop`` [s], and has at most :data:`MAX_RMS_POINTS` time points.
    """
    if is_accurate(start):
        return start
    low, high = stop / MAX_RMS_POINTS, start
    while high / low > EQUAL_STEP_RATIO:
        middle = math.sqrt(low * high)
        low, high = (middle, high) if is_accurate(middle) else (low, middle)
    return low


def _limit_steps_by_natural_modes(
    linearised: LinearisedScene, start: StepLimit, rule: IntegrationRule
) -> Iterator[StepLimit]:
    """Yield time steps that resolve natural modes, for networks without an exact solution.

    A part without equations, such as a user's netlist, may excite a network at any frequency. The
    natural modes are therefore computed twice: for free nets between the network and the part
    without equations, and for prescribed values of these nets. Each resonant mode limits the step
    according to its contribution to the waveforms. If the nets are prescribed and an exact solution
    exists, the contribution of a mode is computed from the exact solution. Otherwise, the
    contribution of a mode is estimated from its natural frequency.
    """
    build, missing = linearised.build, linearised.parts_without_network
    stop, networks, systems = build.scene.stop_time, linearised.networks, linearised.systems
    for network, system, motion in zip(networks, systems, linearised.exact_solutions, strict=True):
        if motion is None or _has_unmodelled_neighbour(build, network, missing):
            poles = _find_poles(network, system)
            yield _find_step_of_modes(poles, _estimate_mode_shares(poles, stop), start, stop, rule)
    for network, driven in _list_networks_with_prescribed_nets(build):
        system = _linearise_network(network)
        motion = _solve_from_rest(system, stop)
        if motion is None:
            poles = _find_poles(network, system)
            shares = _estimate_mode_shares(poles, stop)
        else:
            poles, shares = motion.modes.rates, _find_mode_shares(motion, driven)
        yield _find_step_of_modes(poles, shares, start, stop, rule)


def _find_poles(network: Network, system: LinearisedSystem | None) -> np.ndarray:
    """Return the poles [1/s] of a network that is linearised at rest; empty if unknown.

    ``system`` contains the linearised equations of the network, or is None if there is no
    equilibrium. The poles of a linear network do not depend on the equilibrium, which may not
    exist: for example, a body without a support has no equilibrium.
    """
    # imported here, because the modules load scipy
    from kc2spice.reference.small_signal_analysis import LinearisedSystem
    from kc2spice.reference.system import assemble_system

    try:
        if system is None:
            equations = assemble_system(network.laws, network.joins, MAX_UNKNOWNS)
            if equations.devices:
                return np.zeros(0, dtype=complex)
            system = LinearisedSystem(equations, point=(np.zeros(equations.size), []))
        return system.poles
    except (SimulationError, UsageError, np.linalg.LinAlgError):
        return np.zeros(0, dtype=complex)


def _list_networks_with_prescribed_nets(
    build: BuiltScene,
) -> Iterator[tuple[Network, frozenset[str]]]:
    """Yield networks in which ideal sources replace the parts without equations.

    A part without equations is, for example, a user's netlist. The sources prescribe the value 0 on
    the nets of these parts. Each item contains a network and the names of all sources.
    """
    laws, rest = get_scene_laws(build), Waveform(((0.0, 0.0),))
    try:
        nets = find_replayed_nets(laws) or {}
        sources = {net: make_net_source(net, kind, rest) for net, kind in nets.items()}
        networks = laws.build_networks(sources) if sources else ()
    except UsageError:
        return
    names = frozenset(source.name for source in sources.values())
    for network in networks:
        if not network.has_sources_only and not names.isdisjoint(network.law_names):
            yield network, names


def _estimate_mode_shares(poles: np.ndarray, stop: float) -> np.ndarray:
    """Estimate how much the modes contribute to waveforms, from their poles alone.

    The share of a resonant mode decreases with the third power of its frequency. The slowest
    resonant mode has the share 1, and modes without resonance have the share 0. Poles whose period
    exceeds the end time ``stop`` [s] also have the share 0. For example, the exact pole of a
    rigid-body mode is 0, and rounding errors change it into a pole with a very long period.
    """
    q_factors = np.abs(poles) / np.maximum(-2 * poles.real, 1e-30)
    resonant = (q_factors > RESONANT_Q) & (np.abs(poles) * stop > 2 * math.pi)
    frequencies = np.where(resonant, np.abs(poles), np.inf)
    slowest = frequencies.min(initial=np.inf)
    return np.asarray((slowest / frequencies) ** 3 if resonant.any() else np.zeros(poles.size))


def _find_mode_shares(motion: ExponentialSolution, driven: Collection[str]) -> np.ndarray:
    """Return how much each resonant mode contributes to waveforms, relative to the largest.

    The sources with the names ``driven`` change as the square of the time. Such sources excite
    modes of high frequency only weakly, as do the high harmonics of a square wave. The result (m,)
    is the largest share of each mode in any waveform, and 0 for modes without resonance.
    """
    # imported here, because the module loads scipy
    from kc2spice.reference.small_signal_analysis import CANCELLATION_ROUNDING

    modes = motion.modes
    resonant, shares = modes.q_factors > RESONANT_Q, np.zeros(modes.rates.size)
    for k, source in enumerate(motion.linear.system.sources):
        if source.name in driven:
            amplitudes = resonant * np.abs(modes.drive[:, k] / modes.rates**3)
            peaks = amplitudes * np.abs(modes.out)
            largest = peaks.max(axis=1, initial=0.0)
            real = largest > CANCELLATION_ROUNDING * (modes.terms @ amplitudes)
            relative = peaks[real] / largest[real, None]
            shares = np.maximum(shares, relative.max(axis=0, initial=0.0))
    return shares


def _find_step_of_modes(
    rates: np.ndarray, shares: np.ndarray, start: StepLimit, stop: float, rule: IntegrationRule
) -> StepLimit:
    """Return the largest time step with which modes keep their frequency and damping.

    ``rates`` (m,) [1/s] are the poles of the modes, and ``shares`` (m,) their shares in the
    waveforms.
    """

    def compute_waveform_errors(h: float) -> np.ndarray:
        """Compute the relative waveform error of each mode, (m,), for a time step [s]."""
        return shares * _compute_mode_errors(rates, rule, h, stop)

    limit = 2 * MODE_AMPLITUDE_ERROR
    h = _bisect_step(
        lambda h: float(compute_waveform_errors(h).max(initial=0.0)) <= limit, stop, start.step
    )
    if h == start.step:
        return start
    worst = int(compute_waveform_errors(h).argmax())
    quality = abs(rates[worst]) / max(-2 * rates[worst].real, 1e-30)
    return StepLimit(float(f"{h:.3g}"), _describe_resonance(rates[worst], quality))


def _compute_mode_errors(
    rates: np.ndarray, rule: IntegrationRule, h: float, stop: float
) -> np.ndarray:
    """Compute the relative error of each mode (m,), for the time step ``h`` [s].

    The step changes the pole r of a mode, an element of ``rates`` (m,) [1/s], by ``d``. The mode
    remembers its excitation for the time ``T = min(-1 / Re r, stop)``. The relative change of the
    mode is about ``|d| T``.
    """
    lasting = np.minimum(-1 / np.minimum(rates.real, -1e-30), stop)
    return np.asarray(np.abs(rule.rates(rates, h) - rates) * lasting)


def _describe_resonance(rate: complex, quality: float) -> str:
    """Describe a natural mode by its frequency and its Q factor."""
    damped = f"Q {quality:.3g}" if quality < 1e6 else "undamped"
    return f"natural mode at {format_quantity(abs(rate) / (2 * math.pi), 'Hz', 4)}, {damped}"


def find_largest_errors(t: np.ndarray, ours: np.ndarray, exact: np.ndarray) -> tuple[float, float]:
    """Return the largest errors of rms and instantaneous values of waveforms.

    ``ours`` and ``exact`` are arrays of shape (times, waveforms). The rms values are computed in
    :data:`WINDOW_COUNT` time windows. Errors of rms values are relative to the largest rms value
    that the waveform has in any window. Errors of instantaneous values are relative to the largest
    magnitude of the waveform.
    """
    edges = np.linspace(t[0], t[-1], WINDOW_COUNT + 1)[1:-1]
    cuts = np.unique([0, *np.searchsorted(t, edges)])
    share = np.gradient(t)[:, None]  # weights of the points in the rms: their time intervals [s]
    length = np.maximum(np.add.reduceat(share, cuts, axis=0), 1e-300)
    mine = np.sqrt(np.add.reduceat(share * ours**2, cuts, axis=0) / length)
    true = np.sqrt(np.add.reduceat(share * exact**2, cuts, axis=0) / length)
    rms = np.abs(mine - true).max(axis=0) / np.maximum(true.max(axis=0), 1e-300)
    value = np.abs(ours - exact).max(axis=0) / np.maximum(np.abs(exact).max(axis=0), 1e-300)
    return float(rms.max(initial=0.0)), float(value.max(initial=0.0))


# --- checks of a run ------------------------------------------------------------------------------


def list_step_checks(
    build: BuiltScene, waves: Waveforms, balances: Mapping[str, RunEnergyBalance]
) -> Iterator[Check]:
    """Yield checks of the effect of the time steps on the waveforms of a run.

    The waveforms of a linear circuit are compared with the exact solution of the circuit. The
    comparison with the exact solution is left out if a contact determines the steps, because such
    steps do not resolve all vibrations. In any other circuit, the outputs of each linear body are
    compared with its exact response to the recorded loads. If a contact determines the steps, a
    violated check of a body prints a warning and does not fail the run. A voltage at a part with
    unknown equations, such as a user's netlist, is checked for edges between two time points.
    """
    scene = build.scene
    if scene.analysis.type != "transient" or "time" not in waves:
        return
    yield from _list_edge_checks(build, waves)
    decided = any(map(attrgetter("overrides_others"), scene.numerics))
    known = not decided and not build.unchecked_parts
    worst, exact = _compare_with_exact_solutions(build, waves) if known else ((0.0, 0.0, ""), set())
    if worst[2]:
        name, label = "time steps compared with the exact solution", "time-step error"
        yield _make_step_check(name, label, worst, build)
    for part, balance in balances.items():
        if part in exact:
            continue
        differences = []
        for name, (simulated, true) in balance.exact.items():
            if true.any():
                errors = find_largest_errors(waves["time"], simulated[:, None], true[:, None])
                differences.append((*errors, name))
        if differences:
            name = f"time steps of {part} compared with its exact response"
            check = _make_step_check(name, f"time-step error of {part}", max(differences), build)
            yield replace(check, action="warn") if decided else check


def _list_edge_checks(build: BuiltScene, waves: Waveforms) -> Iterator[Check]:
    """Yield a check of the least resolved voltage edges at parts without equations."""
    edges, name = find_least_resolved_edges(build, waves)
    if edges.share > MIN_EDGE_VALUE:
        step = format_quantity(float(f"{edges.sufficient_step:.1e}"), "s")
        yield Check(
            f"edges of {name}",
            edges.share,
            EDGE_LIMIT,
            "of the area of its range",
            "edges lie between two time points, so their times are uncertain: set "
            f"solver.max_step to {step}, and lower it further if this warning remains",
            "warn",
            label=f"unresolved edges of {name}",
        )


def find_least_resolved_edges(build: BuiltScene, waves: Waveforms) -> tuple[UnresolvedEdges, str]:
    """Find the least resolved edges of all voltages at parts without equations.

    Return the edges, and the name of the voltage. The uncertain share of the voltage's area is 0 if
    no time step contains an edge, or if every part of the scene has equations.
    """
    parts = find_linearised_scene(build).parts_without_network
    nodes = {f"v({net})" for (part, _), net in build.scene.nets.items() if part in parts}
    found = [(UnresolvedEdges(0.0, math.inf), "")]
    for name, result in build.results.vectors.items():
        voltage = name in waves and result.unit == "V" and result.voltage is not None
        if voltage and not nodes.isdisjoint(node for _, node in result.terms):
            edges = measure_unresolved_edges(waves["time"], waves[name])
            if edges is not None:
                found.append((edges, name))
    return max(found)


class UnresolvedEdges(NamedTuple):
    """Uncertain share of a voltage's area, and the mean time step [s] at its edges."""

    share: float
    step: float

    @property
    def sufficient_step(self) -> float:
        """Largest time step [s] at which a voltage's uncertain area is within its limit."""
        return self.step * min(1.0, EDGE_LIMIT / self.share) if self.share else math.inf


def measure_unresolved_edges(time: np.ndarray, volts: np.ndarray) -> UnresolvedEdges | None:
    """Measure the uncertainty of a voltage's area that is due to unresolved edges.

    A step with an edge changes the voltage by more than :data:`EDGE_SHARE` of its range. The time
    of the edge is uncertain by half the step. The range includes 0 V. Return None if no step
    contains an edge.

    >>> measure_unresolved_edges(np.array([0.0, 1.0, 2.0, 4.0]), np.array([0.0, 0.0, 5.0, 5.0]))
    UnresolvedEdges(share=0.125, step=1.0)
    """
    span = max(0.0, float(volts.max())) - min(0.0, float(volts.min()))
    duration = float(time[-1] - time[0])
    jumps, steps = np.abs(np.diff(volts)), np.diff(time)
    edge = jumps > EDGE_SHARE * span
    if span < MIN_SIZE["V"] or duration <= 0 or not edge.any():
        return None
    area = float((jumps[edge] * steps[edge]).sum())
    return UnresolvedEdges(area / 2 / (span * duration), area / float(jumps[edge].sum()))


def _compare_with_exact_solutions(
    build: BuiltScene, waves: Waveforms
) -> tuple[tuple[float, float, str], set[str]]:
    """Compare the waveforms of linear circuits with the exact solutions.

    Return the largest deviation of a waveform, and the names of the compared parts.
    """
    exact, worst = set[str](), (0.0, 0.0, "")
    linearised = find_linearised_scene(build)
    for network, motion in zip(linearised.networks, linearised.exact_solutions, strict=True):
        if _has_unmodelled_neighbour(build, network, linearised.parts_without_network):
            continue
        if motion is not None and motion.linear.exact and motion.is_moving:
            worst = max(
                worst, _find_largest_deviation(network, motion, waves, build.results.vectors)
            )
            exact |= network.law_names
    return worst, exact


def _make_step_check(
    name: str, label: str, largest: tuple[float, float, str], build: BuiltScene
) -> Check:
    """Return the check of a waveform's deviation due to the time steps.

    ``largest`` describes the waveform whose rms value deviates most from the exact solution. The
    entries are the deviation of the rms value, the largest deviation at a time point, and the name
    of the waveform.
    """
    amplitude, _, wave = largest
    advice = "the time steps are too coarse for a resonance: "
    if reason := find_step_reason(build):
        advice += f"choose an earlier end time; reason for the short time steps: {reason}"
    else:
        advice += "leave solver.max_step out, or lower it"
    return Check(
        name,
        amplitude,
        FAILURE_LIMIT,
        f"of the rms of {wave}",
        advice,
        coarse=True,
        wiring=True,
        label=label,
    )


def _has_unmodelled_neighbour(build: BuiltScene, network: Network, missing: Sequence[str]) -> bool:
    """Return whether a network is joined to a part that has no equations."""
    parts, scene = set(map(get_law_name, network.law_names)), build.scene
    for name, pin in scene.nets:
        if name in parts and not set(missing).isdisjoint(dict(scene.list_joined_pins(name, pin))):
            return True
    return False


def _find_largest_deviation(
    network: Network,
    motion: ExponentialSolution,
    waves: Waveforms,
    vectors: Mapping[str, PartResult],
) -> tuple[float, float, str]:
    """Return the largest deviation of a network's waveforms from its exact solution.

    Waveforms that consist only of rounding errors are left out.
    """
    time = waves["time"]
    pick = np.unique(np.linspace(0, time.size - 1, min(time.size, MAX_COMPARED_POINTS)).astype(int))
    # Points near times at which currents jump are left out.
    # An edge of a source, and therefore a jump, can begin at the end of the run.
    corners = np.append(motion.corner_times, motion.stop)
    near = np.searchsorted(corners, time[pick])
    neighbours = corners[np.clip([near - 1, near], 0, corners.size - 1)]
    pick = pick[np.abs(time[pick] - neighbours).min(axis=0) > EVENT_MARGIN * motion.stop]
    at, names = time[pick], motion.linear.system.names
    exact = dict(zip(names, motion.evaluate_waves(at, np.arange(len(names))).T, strict=True))
    rounding = dict(zip(names, motion.estimate_rounding(), strict=True))
    result: dict[str, tuple[np.ndarray, str]] = {}
    largest: dict[str, float] = {}
    for name, true in evaluate_combinations(network.results, exact, at).items():
        noise = sum(abs(factor) * rounding[wave] for factor, wave in network.results[name].terms)
        unit = vectors[name].unit if name in vectors else ""
        size = float(np.abs(true).max())
        if name in waves and size > max(noise, MIN_SIZE.get(unit, 0.0)):
            result[name] = true, unit
            largest[unit] = max(largest.get(unit, 0.0), size)
    worst = (0.0, 0.0, "")
    for name, (true, unit) in result.items():
        if np.abs(true).max() > MIN_RELATIVE_SIZE * largest[unit]:
            errors = find_largest_errors(at, waves[name][pick][:, None], true[:, None])
            worst = max(worst, (*errors, name))
    return worst
