"""Fit of a part's keys to measured impedances, by the equations of the scene.

The model of each curve is the small-signal response of the whole scene, with the key values of the
curve's measurement. The residuals are ``log(Y_model / Y) / noise``, as in :mod:`.fit`. The unknowns
are the logarithms of the values, limited to their ranges.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import OptimizeResult, least_squares

from kc2spice.core.errors import SimulationError, UsageError, list_candidates
from kc2spice.core.progress import Progress, StageTimer
from kc2spice.core.user_warnings import warn_user
from kc2spice.equations.networks import Network
from kc2spice.equations.scene_laws import get_scene_laws
from kc2spice.parts.bodies._varied_keys import VariedKey, read_key_values
from kc2spice.reference.small_signal_analysis import LinearisedSystem
from kc2spice.reference.system import assemble_system
from kc2spice.scene.load import load_scene
from kc2spice.scene.scene_classes import Scene
from kc2spice.workflow.fit_curves import MeasuredCurve
from kc2spice.workflow.fit_keys import name_scene_keys
from kc2spice.workflow.fit_record import compute_error_statistics, describe_values, match_resonances
from kc2spice.workflow.misfit import WARNING_MISFIT
from kc2spice.workflow.part_models import build_models

# smallest assumed relative noise, because contact resistance and temperature also cause errors
MIN_NOISE = 1e-3
DIFFERENCE_STEP = 1e-5  # step of forward differences in the logarithm of a value
MAX_EVALUATIONS = 60  # largest number of steps of the least-squares fit
# Residual, in units of the noise, that is assigned to values that the part cannot have.
# This large residual keeps the descent away from impossible values.
IMPOSSIBLE_RESIDUAL = 1e4
# Names of voltage and current of two-terminal parts. Bodies and data-sheet resonators have the
# second pair of names.
_IMPEDANCE_RESULTS = (("v", "i"), ("voltage", "current"))
MISFIT_ADVICE = (
    "vary more keys, or restrict each curve by band to frequencies that the model covers"
)


def compute_admittance(scene: Scene, part: str, frequencies: np.ndarray) -> np.ndarray:
    """Return the admittance [S] of a part: its current divided by its voltage.

    Parameters
    ----------
    scene : Scene
        Scene with a source that has an ``ac`` amplitude.
    part : str
        Name of the part.
    frequencies : (n,) array
        Frequencies [Hz].

    Raises
    ------
    UsageError : the part has no voltage and current, a part of the scene has no equations, or no
        source drives the part.

    Examples
    --------
    >>> import kc2spice as kc
    >>> pins = {"a": "drive.out", "b": "gnd"}
    >>> wire = {"part": "resistor", "resistance": "50 Ohm", "pins": pins}
    >>> scene = kc.load_scene({"wire": wire, "drive": {"part": "source", "ac": "1 V"}})
    >>> print(compute_admittance(scene, "wire", np.array([1e3])).real)
    [0.02]
    """
    network, voltage_name, current_name = _find_network(scene, part)
    system = assemble_system(network.laws, network.joins)
    amplitudes = np.array(list(map(attrgetter("ac"), system.sources)), dtype=complex)
    rates = 2j * np.pi * np.asarray(frequencies, dtype=float)
    systems = [LinearisedSystem(system, rates[0]), LinearisedSystem(system, rates[-1])]
    pairs = zip(*((s.F, s.G, s.C0, s.C1) for s in systems), strict=True)
    constant = all(np.array_equal(first, last) for first, last in pairs)
    result = np.zeros(len(rates), dtype=complex)
    for k, rate in enumerate(rates):
        linear = systems[0] if constant else LinearisedSystem(system, rate)
        waves = dict(zip(system.names, linear.respond(rate, amplitudes), strict=True))
        voltage = network.results[voltage_name].combine(waves)
        if voltage == 0:
            raise UsageError(
                "no source drives this part",
                where=part,
                got="a voltage of 0 V",
                expected="a source with an ac amplitude on the net of the part",
                hint='add  ac = "1 V"  to the source',
            )
        result[k] = network.results[current_name].combine(waves) / voltage
    return result


def require_impedance(scene: Scene, part: str) -> None:
    """Raise an error if the scene's equations do not determine a part's impedance.

    Raises
    ------
    UsageError : the part is a source, the part has no voltage and current, or a part of the scene
        has no equations.
    """
    _reject_source(scene, part)
    _find_network(scene, part)


def _reject_source(scene: Scene, part: str) -> None:
    """Raise an error if the part is a source; the message lists suitable parts."""
    if scene.get_part(part, where=part).type.name != "source":
        return
    names = []
    for name, item in get_scene_laws(build_models(scene, StageTimer())).equations.items():
        is_source = name not in scene.parts or scene.parts[name].type.name == "source"
        if not is_source and _find_impedance_results(name, item.results) is not None:
            names.append(name)
    expected = "a part with an impedance"
    raise UsageError(
        "a source has no impedance that can be fitted",
        where=part,
        got="a part of type source",
        expected=f"{expected}: {list_candidates(part, names)}" if names else expected,
        hint=f"fit the part {names[0]} in place of {part}"
        if names
        else "add the measured part to the scene",
    )


def _find_impedance_results(part: str, results: Collection[str]) -> tuple[str, str] | None:
    """Return names of voltage and current results for a part's impedance, or None.

    The result is None if the part does not have both results.
    """
    for voltage, current in _IMPEDANCE_RESULTS:
        pair = f"{part}.{voltage}", f"{part}.{current}"
        if pair[0] in results and pair[1] in results:
            return pair
    return None


def _find_network(scene: Scene, part: str) -> tuple[Network, str, str]:
    """Return the network of a part, and the names of the part's voltage and current."""
    kind = scene.get_part(part, where=part).type.name
    laws = get_scene_laws(build_models(scene, StageTimer()))
    results = laws.equations[part].results if part in laws.equations else {}
    pair = _find_impedance_results(part, results)
    if part not in laws.parts_without_law and pair is None:
        raise UsageError(
            "this part has no impedance",
            where=part,
            got=f"a part of type {kind}",
            expected="a body with electrodes, or a part with a voltage and a current as results",
            hint="kc2spice explain SCENE lists the parts with their types",
        )
    if laws.parts_without_law or pair is None:
        raise UsageError(
            "parts of the scene have no equations, so that no response can be fitted",
            where=part,
            got=", ".join(laws.parts_without_law),
            expected="parts with equations only",
            hint="replace these parts, such as a netlist, by resistors and sources",
        )
    return next((item, *pair) for item in laws.networks if item.results.keys() >= set(pair))


@dataclass(frozen=True, eq=False)
class CircuitFit:
    """Least-squares fit of a part's keys to measured curves.

    The unknowns of the fit are the logarithms of the absolute values of the keys.
    """

    scene: Scene
    part: str
    curves: Sequence[MeasuredCurve]
    keys: Sequence[VariedKey]
    progress: Progress
    counted: list[int] = field(default_factory=lambda: [0])

    @property
    def fitted_curves(self) -> list[MeasuredCurve]:
        """Curves that the fit uses, without curves that are only predicted."""
        return [curve for curve in self.curves if not curve.predict]

    @cached_property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper limits of the logarithm of the absolute value of each key."""
        ends = np.log(np.abs([[item.low, item.high] for item in self.keys]))
        return ends.min(axis=1), ends.max(axis=1)

    def compute_key_values(self, x: np.ndarray) -> dict[str, float]:
        """Convert logarithms to the values of the keys."""
        signs = np.sign([item.low for item in self.keys])
        values = signs * np.exp(np.clip(x, *self.bounds))
        return dict(zip(map(attrgetter("key"), self.keys), values.tolist(), strict=True))

    def name_scene_keys(self, values: Mapping[str, float]) -> dict[str, float]:
        """Rename keys of the part to their dotted names in the scene; keep the values."""
        return name_scene_keys(self.scene, self.part, values)

    def admittance(self, curve: MeasuredCurve, values: Mapping[str, float]) -> np.ndarray:
        """Compute the admittance [S] of the part under the conditions of a measured curve.

        ``values`` are values of the fitted keys. The ``overrides`` of ``curve`` set scene keys to
        the conditions of the measurement, such as an added mass.
        """
        self.counted[0] += 1
        # for each fitted curve, a fit step computes 1 + (number of varied keys) responses
        most = MAX_EVALUATIONS * len(self.fitted_curves) * (1 + len(self.keys))
        done = (self.counted[0] - 1) / most
        text = f"response {self.counted[0]} of at most {most}"
        self.progress("fit", done if done < 1 else None, text)
        overrides = {**self.name_scene_keys(values), **curve.overrides}
        return compute_admittance(load_scene(self.scene, overrides), self.part, curve.data.f)

    def residuals(self, values: Mapping[str, float]) -> np.ndarray:
        """Return the residuals of all curves, divided by the noise of their data.

        The real parts of all curves come before the imaginary parts.
        """
        rows = []
        for curve in self.fitted_curves:
            ratio = np.log(self.admittance(curve, values) / curve.Y)
            rows.append(ratio / max(curve.data.noise, MIN_NOISE))
        result = np.concatenate(rows)
        return np.concatenate([result.real, result.imag])

    def compute_fit_residuals(self, x: np.ndarray) -> np.ndarray:
        """Compute the fit residuals at ``x``, the logarithms of the values of fitted keys.

        If the scene rejects the key values, or the simulation fails, all residuals are set to the
        large number :data:`IMPOSSIBLE_RESIDUAL`.
        """
        try:
            return self.residuals(self.compute_key_values(x))
        except (UsageError, SimulationError):
            count = sum(len(curve.data.f) for curve in self.fitted_curves)
            return np.full(2 * count, IMPOSSIBLE_RESIDUAL)

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        """Return the derivatives of the residuals with respect to logarithms of the keys.

        The result is an array of shape (2 * n, keys). The derivatives are computed by one-sided
        differences inside the range.
        """
        columns, middle, first = [], np.mean(self.bounds, axis=0), self.compute_fit_residuals(x)
        for k in range(len(x)):
            step = np.zeros_like(x)
            step[k] = DIFFERENCE_STEP if x[k] <= middle[k] else -DIFFERENCE_STEP
            columns.append((self.compute_fit_residuals(x + step) - first) / step[k])
        return np.column_stack(columns)

    def solve(self) -> OptimizeResult:
        """Fit the keys by least squares, beginning at the values of the scene.

        Raises
        ------
        UsageError : the scene of a curve is not valid with the start values of the keys.
        """
        values = read_key_values(self.keys)
        self.residuals(values)  # raises the error of an invalid scene before the fit
        start = np.log(np.abs(list(values.values())))
        return least_squares(
            self.compute_fit_residuals, start, self.jacobian, self.bounds,
            x_scale="jac", xtol=1e-8, ftol=1e-8, max_nfev=MAX_EVALUATIONS,
        )  # fmt: skip


def fit_circuit(problem: CircuitFit, where: str) -> dict[str, Any]:
    """Fit keys of a circuit to all curves; return the record with the responses.

    The entry ``responses`` contains the admittances of each curve before and after the fit. ``fit
    --json`` prints the record without the entry ``responses``.

    Raises
    ------
    UsageError : a key does not change the impedance, or the scene of a curve is not valid.
    """
    keys, solved = problem.keys, problem.solve()
    values = problem.compute_key_values(solved.x)
    if solved.status == 0:
        warn_user(
            f"{where}: the fit did not converge within {MAX_EVALUATIONS} steps; its values are the "
            "best that it found; vary fewer keys, or give narrower ranges"
        )
    described = describe_values(keys, values, solved.jac, solved.fun)
    responses, rows, sizes = [], [], []
    for curve in problem.curves:
        before = problem.admittance(curve, read_key_values(keys))
        after = problem.admittance(curve, values)
        size = np.abs(np.abs(curve.Y / after) - 1)  # relative error of |Z|
        responses.append((curve, before, after))
        rows.append(_describe_curve(curve, size))
        if not curve.predict:
            sizes.append(size)
    misfit, caution = described["misfit"], None
    if misfit > WARNING_MISFIT:
        caution = (
            f"the model does not describe the data: a misfit of {misfit:.1f} times the noise; "
            f"{MISFIT_ADVICE}"
        )
        warn_user(f"{where}: {caution}")
    curve, before, after = responses[0]
    return {
        "part": problem.part,
        "data": where,
        "read": [curve.data.description for curve in problem.curves],
        **described,
        "values": problem.name_scene_keys(values),
        "error": compute_error_statistics(np.concatenate(sizes)),
        "curves": rows,
        "noise": float(np.median([curve.data.noise for curve in problem.fitted_curves])),
        "caution": caution,
        "resonances": match_resonances(curve.data, before, after),
        "starts": [{**values, "cost": float(solved.cost)}],
        "other_minima": 0,
        "models": 0,
        "notes": [note for curve in problem.curves for note in curve.data.notes],
        "responses": responses,
    }


def _describe_curve(curve: MeasuredCurve, size: np.ndarray) -> dict[str, Any]:
    """Return the record of a curve, with the errors of its impedance magnitude.

    ``size`` contains the relative errors of the impedance magnitude ``|Z|``.
    """
    return {
        "data": Path(curve.data.where).name,
        "set": dict(curve.overrides),
        "predict": curve.predict,
        **compute_error_statistics(size),
    }
