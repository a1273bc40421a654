"""Estimate of time points and CPU time of a run in which bodies ring.

The time step control of the simulator resolves every mode that rings. A contact also excites modes
above the band of the reduction. In a time step ``h``, the error of the trapezoidal rule for a mode
with the angular frequency ``w`` is ``(w h)^3 / 12``, relative to the amplitude. While the mode
rings, the time steps are therefore ``(12 * reltol)^(1/3) / w`` for the relative tolerance
``reltol``.
Without damping, the ringing lasts until the end of the run.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import accumulate

import numpy as np

from kc2spice.core.domains import ELECTRICAL, HEAT
from kc2spice.core.si_prefix_format import format_quantity
from kc2spice.core.user_warnings import warn_user
from kc2spice.netlist.deck import Deck
from kc2spice.rom.linear_model import LinearModel
from kc2spice.rom.modal_models import compute_resonators
from kc2spice.scene.scene_classes import BuiltScene, Scene

# Natural logarithm of the ratio of the initial amplitude to the amplitude at which ringing ends.
LOG_AMPLITUDE_RATIO = math.log(1e3)
# Number of time points above which a warning is printed.
# A body with 24 states needs half a minute of CPU time for MANY_POINTS time points.
MANY_POINTS = 3e5
# CPU time [s] of ngspice per time point is POINT_SECONDS plus STATE_SECONDS for each state.
# Both CPU times were measured on a 2.5 GHz processor with kick_and_catch for 24 and 178 states.
POINT_SECONDS = 5e-5
STATE_SECONDS = 1.4e-6


@dataclass(frozen=True)
class RingingEstimate:
    """Estimate of ringing: time points and CPU time that a body costs if it rings.

    ``points`` is the number of time points, and ``seconds`` the CPU time [s]. ``frequency`` is the
    frequency [Hz] of the fastest mode that rings until the end of the run.
    """

    part: str
    points: float
    seconds: float
    frequency: float

    def __str__(self) -> str:
        top = format_quantity(self.frequency, "Hz", 3)
        return (
            f"{self.part} rings at frequencies up to {top} until the end of the run, because its "
            f"damping is low. The ringing takes about {self.points:.2g} time points and "
            f"{self.seconds:.2g} s of CPU time. A larger {self.part}.damping or an earlier "
            "solver.stop reduces the number of time points and the CPU time"
        )


def estimate_time_per_point(states: int) -> float:
    """Return the CPU time [s] per time point, from the number of states of a body."""
    return POINT_SECONDS + STATE_SECONDS * states


def estimate_ringing(
    part: str, rom: LinearModel, stop: float, reltol: float
) -> RingingEstimate | None:
    """Estimate the time points and CPU time that the ringing of a body costs in a run.

    Parameters
    ----------
    part : str
        Name of the body.
    rom : LinearModel
        Reduced model of the body.
    stop : float
        Duration [s] of the run after the start of the ringing.
    reltol : float
        Relative error that the simulator accepts in a time step.

    Returns
    -------
    RingingEstimate or None
        Number of time points and CPU time; None if the modes of the model are unknown. The number
        of time points is ``sum_i w_i * (t_i - t_{i-1}) / (12 * reltol)^(1/3)``, with the fastest
        mode first. In this sum, ``t_i`` is the latest time at which mode i, or any faster mode,
        still rings. ``t_0`` is zero.
    """
    model = compute_resonators(rom)
    if model is None:
        return None
    heavy = model.inertia > 0
    omega, damp = model.omega[heavy], model.damp[heavy]
    fastest = np.argsort(-omega)
    omega, rate = omega[fastest], damp[fastest] / 2
    lasts = np.minimum(stop, LOG_AMPLITUDE_RATIO / np.maximum(rate, LOG_AMPLITUDE_RATIO / stop))
    until = np.array([*accumulate(lasts, max)])
    # for each mode: time [s] during which the mode still rings and all faster modes have decayed
    spans = np.diff(until, prepend=0.0)
    points = float(omega @ spans) / (12 * reltol) ** (1 / 3)
    last = omega[lasts >= stop]
    seconds = points * estimate_time_per_point(model.order)
    return RingingEstimate(part, points, seconds, float(last.max(initial=0.0)) / (2 * math.pi))


def warn_of_long_run(build: BuiltScene, deck: Deck) -> None:
    """Print a warning before a run that needs more than MANY_POINTS time points.

    The number of time points depends on the largest time step. If a contact determines the time
    steps, the number of time points depends on the ringing of a body.
    """
    scene = build.scene
    if scene.analysis.type != "transient":
        return
    if any(row.overrides_others for row in scene.numerics):
        _warn_of_ringing(build, deck)
        return
    assert build.largest_step is not None
    points = scene.stop_time / build.largest_step.step
    if points > MANY_POINTS:
        models = [model for model in build.models.values() if isinstance(model, LinearModel)]
        seconds = points * estimate_time_per_point(sum(model.order for model in models))
        step = format_quantity(build.largest_step.step, "s", 3)
        end = "solver.stop" if scene.analysis.stop is None else "analysis.stop"
        larger = "A larger solver.max_step or a smaller" if scene.solver.max_step else "A smaller"
        warn_user(
            f"this run needs at least {points:.2g} time points and {seconds:.2g} s of CPU time, "
            f"because its largest time step is {step} ({build.largest_step.why}). {larger} "
            f"{end} reduces the number of points{_suggest_mean_power(scene)}"
        )


def _suggest_mean_power(scene: Scene) -> str:
    """Return advice on temperatures from a mean power; empty if no part is heated.

    A periodic source heats a part during many periods, whose time points are many. A pin ``heat``
    of a part without electrical pins, such as a ``heat_body``, receives heat.
    """
    heated = [
        name
        for name in scene.parts
        if scene.nets.get((name, HEAT), "0") != "0"
        and any(terminal.domain is ELECTRICAL for terminal in scene.pins(name))
    ]
    if not heated or not scene.period:
        return ""
    return (
        f". To compute temperatures without a transient, read the mean power from a probe of "
        f"{heated[0]}.power in an `ac` analysis, and use this power as `dc` of a source of the "
        "kind `heat_flow`"
    )


def _warn_of_ringing(build: BuiltScene, deck: Deck) -> None:
    """Print a warning if a body's ringing needs more than MANY_POINTS time points."""
    scene = build.scene
    for name, model in build.models.items():
        if not isinstance(model, LinearModel):
            continue
        drive = getattr(scene.parts[name].keys, "drive", None)
        span = scene.stop_time - getattr(drive, "start", 0.0)
        if span <= 0:  # the drive begins after the end of the run
            continue
        result = estimate_ringing(name, model, span, deck.reltol)
        if result is not None and result.points > MANY_POINTS and result.frequency:
            warn_user(str(result))
