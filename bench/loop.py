"""Plane ``loop``: five milliseconds of kick, flight and catch, and its ratios."""

from bench.points import Outcome, Ratio, fastest, speed_up
from bench.transient import SPECIALISED, Transient
from bench.variants import NO_INERTIA

LIMITS = {"launch": 1e-4, "position_m": 1e-7}
TARGET = 0.05  # s of CPU


def loop(setup):
    """Methods of ``kick_and_catch``; ratios are taken between points within ``LIMITS``."""
    plane = Transient(setup.scene("kick_and_catch"), setup).plane()

    def best(family, but=None):
        found = (p for p in plane.points if p.family.startswith(family) and p.family != but)
        return fastest(found, LIMITS)

    ours = best("ngspice")
    same = best("ngspice", NO_INERTIA)  # peers and lower bound solve the form with inertia

    def over(name, other, target, what):
        """With the error of the less exact of the two."""
        both = [each for each in (other, same) if each is not None]
        worse = max(both, key=lambda point: point.error, default=None)
        labels = " / ".join(each.label for each in both)
        what = f"time of {what} divided by time of ngspice {at}: {labels}"
        taken = {} if worse is None else {"error": worse.error, "errors": worse.errors}
        return speed_up(name, other and other.time, same, target, what, **taken)

    at = "at launch error 1e-4 and position error 0.1 um"
    ratios = (
        Ratio(
            "loop_cpu_s", ours and ours.time.median, ours and ours.error, TARGET,
            f"ngspice, 5 ms, {at}: {ours and ours.label}",
            at_least=False, unit="s", errors=ours.errors if ours else {},
        ),
        over("loop_vs_scipy", best("scipy", SPECIALISED), 2.0,
             "the fastest general scipy integrator"),
        over("loop_vs_scipy_specialised", best(SPECIALISED), 2.0,
             "scipy with exact modes in flight and located events"),
        over("loop_vs_floor", best("lower bound"), None, "the compiled lower bound"),
    )  # fmt: skip
    return Outcome((plane,), ratios)
