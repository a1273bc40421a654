"""Verdict on a run: checks of parts and time steps, and energy balances."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from kc2spice.core.waveforms import Waveforms
from kc2spice.scene import noise_analysis
from kc2spice.scene.checks import Check, Gate, RunEnergyBalance, Verdict
from kc2spice.scene.plausibility import check_usual_results
from kc2spice.scene.scene_classes import BuiltScene
from kc2spice.workflow.time_step import list_step_checks

# relative change of a flight's height, divided by the relative change of the launch velocity
HEIGHT_PER_VELOCITY = 2.0
# largest accepted relative error of an energy balance, divided by error_budget
BALANCE_SHARE = 0.03


def form_verdict(waves: Waveforms, build: BuiltScene) -> Verdict:
    """Return the verdict on a run: its checks, energy balances and error limits.

    The verdict omits each check that the scene disables. A large ``error_budget`` raises the limits
    of all energy balances in proportion.
    """
    scene = build.scene
    checks: list[Check] = []
    balances: dict[str, RunEnergyBalance] = {}
    gates: list[tuple[str, Gate]] = []
    for name, part in scene.parts.items():
        for row in (
            part.type.checks(part, build, waves) if name not in build.unchecked_parts else ()
        ):
            if isinstance(row, Check):
                checks.append(row)
            elif isinstance(row, RunEnergyBalance):
                balances[name] = row
            else:
                gates.append((name, row))
    checks += (
        noise_analysis.check_noise(waves)
        if build.has_noise
        else list_step_checks(build, waves, balances)
    )
    checks += check_usual_results(waves, build)
    if scene.checks.energy == "off":
        balances = {}
    slack = max(1.0, BALANCE_SHARE * (scene.error_budget or 0.0) / 1e-4)
    checks += [
        Check(
            f"energy of {name}",
            result.relative_imbalance,
            slack * result.limit,
            "of the energy exchanged",
            result.advice,
            scene.checks.energy,
            coarse=True,
            label=f"energy balance of {name}",
        )
        for name, result in balances.items()
    ]
    active = tuple(check for check in add_undecided_warnings(checks) if check.action != "off")
    return Verdict(active, tuple(balances.items()), tuple(gates))


def add_undecided_warnings(checks: Sequence[Check]) -> Iterator[Check]:
    """Yield all checks; add warnings or advice if model errors may change an outcome.

    A relative error e of the launch velocity v changes the height of a flight, v^2 / 2 g, by the
    relative amount 2 e. The outcome of a check is undecided if the distance between the motion and
    the limit of the check is smaller than the possible change of the motion due to errors of
    reduced bodies.
    """
    error = max((check.value for check in checks if check.loaded), default=0.0)
    for check in checks:
        change = HEIGHT_PER_VELOCITY * error * check.travel
        if check.distance >= change:
            yield check
            continue
        side = "inside" if check.passed else "outside"
        advice = (
            f"an extreme position of the motion is {check.distance:.3g} {check.unit} {side} the "
            "permitted range, less than the effect of the estimated error of the reduced bodies "
            f"({error:.2%}): the result is inconclusive"
        )
        if check.passed:
            yield check
            name = f"{check.name} undecided"
            label = check.undecided_label
            yield Check(name, change, check.distance, check.unit, advice, "warn", label=label)
        else:
            yield replace(check, advice=f"{check.advice}; {advice}")
