"""Plane ``loop``: five milliseconds of kick, flight and catch, and its ratios."""

from laboratory.points import Outcome, Ratio, fastest
from laboratory.transient import Transient
from laboratory.variants import NO_INERTIA

LIMITS = {"launch": 1e-4, "position_m": 1e-7}
TARGET = 0.05  # s of CPU


def loop(setup):
    """Methods of ``kick_and_catch``; ratios are taken between points within ``LIMITS``."""
    plane = Transient(setup.scene("kick_and_catch"), setup).plane()
    every = _family(plane, "ngspice")
    ours = fastest(every, LIMITS)
    # peers and lower bound solve the form with inertia behind the contact
    same = fastest((p for p in every if p.family != NO_INERTIA), LIMITS)
    scipy = fastest(
        (p for p in _family(plane, "scipy") if p.family != "scipy, specialised"), LIMITS
    )
    special = fastest(_family(plane, "scipy, specialised"), LIMITS)
    bound = fastest(_family(plane, "lower bound"), LIMITS)
    at = "at launch error 1e-4 and position error 0.1 um"
    ratios = (
        Ratio(
            "loop_cpu_s", None if ours is None else ours.time.median,
            None if ours is None else ours.error, TARGET, f"ngspice, 5 ms, {at}: {_label(ours)}",
            at_least=False, unit="s", errors={} if ours is None else ours.errors,
        ),
        _ratio("loop_vs_scipy", scipy, same, 2.0,
               f"fastest general scipy integrator over ngspice {at}"),
        _ratio("loop_vs_scipy_specialised", special, same, 2.0,
               f"scipy with exact modes in flight and located events over ngspice {at}"),
        _ratio("loop_vs_floor", bound, same, None, f"lower bound over ngspice {at}"),
    )  # fmt: skip
    return Outcome((plane,), ratios)


def _family(plane, start):
    return [point for point in plane.points if point.family.startswith(start)]


def _label(point):
    return "none" if point is None else point.label


def _ratio(name, over, ours, target, what):
    """Time of ``over`` in times of ``ours``, with the error of the less exact of the two."""
    if over is None or ours is None:
        return Ratio(name, None, None, target, what)
    worse = max((over, ours), key=lambda point: point.error)
    what = f"{what}: {over.label} / {ours.label}"
    value = over.time.median / ours.time.median
    return Ratio(name, value, worse.error, target, what, errors=worse.errors)
