"""Additional small-signal analyses near resonances, and at frequencies of probes.

The input is an analysis command, and the equations of its scene. The module returns additional
analyses, with closely spaced frequencies, around each resonance that the frequencies of the scene
do not resolve. The resonances are the natural frequencies of the whole linear circuit, driver and
load included; :mod:`kc2spice.reference.small_signal_analysis` states the equations of the circuit.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress

import numpy as np

from kc2spice.core.errors import SimulationError, UsageError
from kc2spice.core.user_warnings import warn_user
from kc2spice.equations.scene_laws import SceneLaws
from kc2spice.netlist.deck import AnalysisCommand, with_frequencies
from kc2spice.reference.small_signal_analysis import LinearisedSystem
from kc2spice.reference.system import assemble_system
from kc2spice.rom.linear_model import LinearModel
from kc2spice.scene.scene_classes import BuiltScene

MAX_UNKNOWNS = 600  # the eigenvalues of systems with more unknowns would take seconds
# Near a pole p, a response is y = R / (j w - p).
# In the narrowest range, the spacing of points is a quarter of the half-width of the resonance.
# A parabola through 1/|y|^2 at three points gives the maximum of a single pole exactly.
# Other poles change the maximum by less than 1e-4 (tests/spice/test_resonant_maxima.py).
# Each further range is WIDENING_FACTOR times as wide, with the same number of points.
# The widest range around a resonance extends to each side by more than the spacing of the scene's
# frequencies.
# Around a resonance, the trapezoidal rule integrates |y|^2 with an error of at most 2 %.
# The tests in tests/spice/test_resonant_maxima.py measure the error of the integral by
# equipartition.
# The narrowest frequency range around a resonance extends by this number of half-widths of the
# resonance to each side.
NARROWEST_HALF_WIDTHS = 4.0
RANGE_POINTS = 33  # number of points in each range
WIDENING_FACTOR = 4.0
# Each resonance needs a few analyses of 33 points, which take the simulator about 10 ms.
MAX_RESONANCES = 100


def list_refined_analyses(command: AnalysisCommand, laws: SceneLaws) -> tuple[AnalysisCommand, ...]:
    """List refined analyses, near resonances and at the frequencies in keys of probes.

    ``command`` is the analysis of the scene. The frequencies in keys of probes become points of an
    analysis, because interpolation between two points would cause an error.

    A resonance at ``f`` with the pole ``p`` has the half-width ``|Re p| / (2 pi)``. A resonance is
    resolved if the spacing of the scene's frequencies near the resonance is at most a quarter of
    its half-width. For undamped resonances, whose response is infinite, no frequencies are added.

    A warning is printed if a part has no equations, such as a user's netlist. If a part has no
    equations, only the poles of the reduced models are known.
    """
    build = laws.build
    analysis = build.scene.analysis
    if not analysis.is_small_signal or analysis.stop is None:
        return ()
    resonances = [(f, width) for f, width in _find_narrow_resonances(laws) if width > 0.0]
    step = 2 * NARROWEST_HALF_WIDTHS / (RANGE_POINTS - 1)
    narrow = [
        (f, width) for f, width in resonances if step * width < _compute_frequency_spacing(build, f)
    ]
    if len(narrow) > MAX_RESONANCES:
        warn_user(
            f"{len(narrow)} resonances are narrower than the frequency step, and only the first "
            f"{MAX_RESONANCES} are resolved; raise analysis.points or narrow the frequency range"
        )
    commands = [
        with_frequencies(command, place, place, 1) for place in _list_probe_frequencies(build)
    ]
    for f, width in narrow[:MAX_RESONANCES]:
        commands += _list_widening_analyses(command, f, width, build)
    return tuple(commands)


def _list_probe_frequencies(build: BuiltScene) -> list[float]:
    """Return the frequencies [Hz] set in the table ``[probes]``, in ascending order.

    Frequencies outside of the scene's range are omitted.
    """
    analysis, result = build.scene.analysis, set[float]()
    for probe in build.scene.probes.values():
        result.update(probe.positions_by_key.values())
    first, last = analysis.start, float(analysis.stop or 0.0)
    return sorted(f for f in result if first < f < last)


def _list_widening_analyses(
    command: AnalysisCommand, f: float, width: float, build: BuiltScene
) -> Iterator[AnalysisCommand]:
    """Yield analyses around a resonance, with increasing frequency spans.

    ``f`` is the frequency [Hz] of the resonance.
    """
    analysis, reach = build.scene.analysis, NARROWEST_HALF_WIDTHS * width
    while True:
        start, stop = max(f - reach, analysis.start), min(f + reach, float(analysis.stop or 0.0))
        yield with_frequencies(command, start, stop, RANGE_POINTS)
        if reach > _compute_frequency_spacing(build, f):
            return
        reach *= WIDENING_FACTOR


def _compute_frequency_spacing(build: BuiltScene, f: float) -> float:
    """Return the spacing [Hz] of the scene's frequencies near ``f``."""
    analysis = build.scene.analysis
    stop = float(analysis.stop or 0.0)
    if analysis.scale == "linear":
        return (stop - analysis.start) / max(analysis.points - 1, 1)
    return f * math.expm1(math.log(stop / analysis.start) / max(analysis.points - 1, 1))


def _find_narrow_resonances(laws: SceneLaws) -> list[tuple[float, float]]:
    """Return ascending frequencies and half-widths [Hz] of resonances and notches.

    The frequencies are within the frequency range of the scene. A notch is included only if a probe
    reads the minimum of its response.
    """
    analysis = laws.build.scene.analysis
    poles = _find_poles_and_zeros(laws)
    f, width = np.abs(poles.imag) / (2 * np.pi), np.abs(poles.real) / (2 * np.pi)
    inside = (poles.imag > 0) & (f > analysis.start) & (f < float(analysis.stop or 0.0))
    rows = {(round(a, 9), round(b, 12)) for a, b in zip(f[inside], width[inside], strict=True)}
    return sorted(rows)


def _find_poles_and_zeros(laws: SceneLaws) -> np.ndarray:
    """Find the poles of the circuits, and the zeros of selected responses.

    Poles and zeros are complex numbers in 1/s. Zeros are included only in an ``ac`` analysis, for
    responses whose minimum a probe reads. For a circuit without equations, only the poles of the
    reduced models are returned. A warning is printed if a circuit has no equations, is too large,
    or has no operating point.
    """
    scene, causes = (
        laws.build.scene,
        [f"kc2spice has no equations for the part {name}" for name in laws.parts_without_law],
    )
    minima = {probe.of for probe in scene.probes.values() if probe.take == "min"}
    if scene.analysis.type != "ac":
        minima = set()
    poles, zeros = list[np.ndarray](), dict[str, np.ndarray]()
    for network in laws.networks:
        try:
            linear = LinearisedSystem(assemble_system(network.laws, network.joins, MAX_UNKNOWNS))
            poles.append(linear.poles)
        except (SimulationError, UsageError, np.linalg.LinAlgError) as error:
            causes.append(str(error).splitlines()[0])
            continue
        amplitudes = np.array([source.ac for source in linear.system.sources])
        for name in minima & network.results.keys():
            with suppress(SimulationError, UsageError, np.linalg.LinAlgError):
                zeros[name] = linear.find_zeros(network.results[name], amplitudes)
    models = [model for model in laws.build.models.values() if isinstance(model, LinearModel)]
    if models and causes:
        warn_user(
            f"the resonances of the circuit cannot be computed ({'; '.join(causes)}), so maxima of "
            "results are searched for only near the natural frequencies of the reduced models, and "
            "some may be missed"
        )
        poles += [model.poles() for model in models]
    if unknown := sorted(minima if laws.parts_without_law else minima - zeros.keys()):
        missing = ", ".join(laws.parts_without_law)
        reason = (
            f"kc2spice has no equations for {missing}"
            if missing
            else "the zeros of the response are unknown"
        )
        warn_user(
            f"the minimum of {', '.join(unknown)} is searched for only at the frequencies of "
            f"the analysis, because {reason}; raise analysis.points"
        )
    return np.concatenate([np.zeros(0, complex), *poles, *zeros.values()])
