"""Capacitance of a gap that a voltage closes, and the least stiffness of the gap's stop.

At a constant voltage, the electrostatic force is proportional to 1 / d^2, where d is the distance
between the electrodes. Close to d = 0, the electrostatic force exceeds the force of every stop, so
each stop has a second equilibrium, which is unstable. If the plate rests on its stop, the second
equilibrium is nearer to the electrode. An iteration that oversteps the stable equilibrium could end
at the second equilibrium, or behind the electrode. Below the distance ``least``, the inverse
distance therefore continues along its tangent, so that the force is constant::

    1 / d                                  d > least
    1 / least + (least - d) / least^2      d <= least

The distance ``least`` is :data:`LEAST_SHARE` of the distance that the stop leaves, d0 = gap -
travel. At a stable equilibrium of a rigid plate, d is at least 2/3 d0. For such an equilibrium, the
stiffness of the stop must be at least ``27 eps A v^2 / (8 d0^3)``, as at pull-in onto a spring with
the gap d0 (S. D. Senturia, Microsystem Design, 2001, chapter 6). A run fails if the distance is
below ``least``.
"""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from kc2spice.core.errors import UsageError
from kc2spice.core.quantities import EPSILON_0
from kc2spice.core.si_prefix_format import format_quantity
from kc2spice.physics import Declaration
from kc2spice.scene.checks import Check
from kc2spice.scene.part_records import NeglectedEffect
from kc2spice.scene.scene_classes import Part, Scene

# Smallest distance in which the force still follows 1 / d^2, divided by the distance that the stop
# leaves. Above 2/3, contacts would be inaccurate; far below 2/3, unstable equilibria would remain.
LEAST_SHARE = 0.5
# Factor between the suggested and the least stiffness of a stop. The stop of the suggested
# stiffness also absorbs the electrostatic work of an impact.
STIFFNESS_MARGIN = 4.0


def write_limited_gap(gap: str, least: str) -> str:
    """Return the expression of a distance that is not below ``least``."""
    return f"({least} + max(0, {gap} - {least}))"


def write_inverse_gap(gap: str, least: str) -> str:
    """Return the expression of 1 / ``gap``, continued by its tangent below ``least``."""
    limited = write_limited_gap(gap, least)
    return f"(1/{limited} + ({limited} - {gap})/{least}^2)"


def list_ramp_effects(scene: Scene) -> Iterator[NeglectedEffect]:
    """List the neglected effect of a voltage ramp: pull-in lags behind the voltage.

    The list is empty unless the analysis is a transient.

    Near pull-in, the displacement of a plate of mass m follows the equation ``y'' = 6 y^2 + t``, in
    units that depend on the rise r of the voltage. The solution of the equation diverges at t =
    2.38 (Boutroux, Annales scientifiques de l'Ecole normale superieure 30 (1913) 255). At pull-in,
    a voltage that rises by r [V/s] therefore exceeds the static pull-in voltage V by the fraction
    ``3.15 (r / (2 pi f V))^0.8``, where f [Hz] is the resonance frequency.
    """
    if scene.analysis.type == "transient":
        yield NeglectedEffect(
            "difference between the pull-in voltage of a transient and the static pull-in voltage",
            "the motion lags behind a rising voltage",
            "about 3*(r / (2*pi*f*V))^0.8 times the static pull-in voltage V [V], for a voltage "
            "ramp r [V/s] and the resonance frequency f [Hz]; more with strong damping, zero in a "
            "dc sweep",
        )


def list_travel_errors(part: Part[Any]) -> Iterator[UsageError]:
    """Yield an error if the stop is behind the fixed electrode."""
    keys = part.keys
    if not keys.travel < keys.gap:
        yield part.wrong(
            "travel",
            "the stop is behind the fixed electrode",
            got=f"{keys.travel:g} m",
            expected=f"less than the gap, {keys.gap:g} m",
        )


def check_stop_indentation(
    part: Part[Any], declaration: Declaration, known: Mapping[str, np.ndarray]
) -> Iterator[Check]:
    """Yield a check that the indentation of the stop leaves enough of the gap open.

    ``known`` contains the recorded waveforms of coordinates, keyed by name.
    """
    keys, depths = part.keys, declaration.compute_stop_depths(part.keys, known)
    if not depths or "v" not in known:
        return
    remaining, depth = keys.gap - keys.travel, max(*depths.values(), 0.0)
    volts = float(np.max(np.abs(known["v"])))
    field = EPSILON_0 * keys.permittivity * keys.area * volts**2
    stiffness = STIFFNESS_MARGIN * max(
        27 * field / (8 * remaining**3), keys.stop * depth / remaining
    )
    rounded = format_quantity(float(f"{stiffness:.1e}"), "N/m")
    yield Check(
        f"indentation of the stop of {part.name}",
        depth,
        LEAST_SHARE * remaining,
        "m",
        "the stop is too soft for the force that closes the gap: "
        f'raise the stiffness, for example to {part.key_prefix}.stop = "{rounded}"',
    )
