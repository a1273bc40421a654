"""The part ``throw``: a sphere that hits a body.

Section 2.2.2 and Fig. 9 of Schütz, Maeter and Bechtold, Actuators 10 (2021) 279, describe the
experiment. The part sets the motion of the sphere at t = 0, and computes the metrics of the impact.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np
from pydantic import Field

from kc2spice.core import constitutive_laws as laws
from kc2spice.core.errors import UsageError
from kc2spice.core.quantities import Length, Section, Velocity
from kc2spice.core.si_prefix_format import format_quantity
from kc2spice.core.waveforms import Waveforms
from kc2spice.netlist.circuit import Item
from kc2spice.parts.mechanics import _contact_surfaces
from kc2spice.parts.mechanics.sphere import find_sphere
from kc2spice.scene.checks import SOLUTION_PAIRS, Gate, Metric
from kc2spice.scene.part_records import InitialState, NumericalRequirements
from kc2spice.scene.parttype import register_part_type
from kc2spice.scene.scene_classes import (
    BuiltScene,
    DeclaredScene,
    GovernedScene,
    Part,
    Scene,
    WiredScene,
)


class ThrowKeys(Section):
    """Keys of the impact of a free sphere on a body."""

    velocity: Velocity = Field(
        -1.0, description="Initial velocity of the thrown sphere, negative for a downward motion"
    )
    gap: Length = Field(
        1e-6, ge=0, description="Initial gap between the thrown sphere and the body"
    )
    of: str | None = Field(
        None,
        description="Name of the sphere that is thrown; by default the only sphere of the scene",
    )


class Throw(_contact_surfaces.TouchablePart[ThrowKeys]):
    """Part type ``throw``: initial velocity and initial height of a sphere."""

    name = "throw"
    title = "velocity and height of a sphere at t = 0"
    schema = ThrowKeys
    source = "initial state"

    def cards(self, part: Part[ThrowKeys], build: BuiltScene) -> tuple[Item, ...]:
        """Return no cards, because the part only sets an initial state."""
        return ()

    def problems(self, part: Part[ThrowKeys], scene: GovernedScene) -> Iterator[UsageError]:
        """Yield an error if the sphere does not move towards the contact."""
        find_sphere(part, scene)
        if part.keys.velocity >= 0:
            yield part.wrong(
                "velocity",
                "the sphere does not move towards the contact",
                got=f"{part.keys.velocity:g} m/s",
                expected="negative (downwards)",
                hint=f'write  "-{abs(part.keys.velocity or 1):g} m/s"',
            )

    def governed_parts(
        self, part: Part[ThrowKeys], scene: DeclaredScene
    ) -> Mapping[str, InitialState]:
        """Return the sphere, whose velocity and gap at t = 0 this experiment prescribes."""
        return {find_sphere(part, scene).name: InitialState(part.keys.velocity, part.keys.gap)}

    def numerics(self, part: Part[ThrowKeys], scene: WiredScene) -> Iterator[NumericalRequirements]:
        """Yield a requirement on the charge tolerance ``chgtol`` for slow impacts.

        The tolerance ``chgtol`` is proportional to the impact speed.
        """
        speed = max(1e-3, _compute_impact_speed(part, scene))
        yield NumericalRequirements(f"impact at {speed:.3g} m/s", chgtol=min(1.0, speed))

    def largest_indentations(
        self, part: Part[ThrowKeys], scene: GovernedScene
    ) -> Iterator[_contact_surfaces.LargestIndentation]:
        """Yield the largest indentation that the thrown sphere causes at each contact."""
        ball, speed = find_sphere(part, scene), _compute_impact_speed(part, scene)
        why, mass = f"impact at {speed:.3g} m/s", ball.keys.mass
        key = f"{part.name}.velocity"
        yield from _contact_surfaces.estimate_impact_indentation(ball, mass, scene, speed, why, key)

    def metrics(
        self, part: Part[ThrowKeys], build: BuiltScene, waves: Waveforms
    ) -> Mapping[str, object]:
        """Return the metrics of the impact.

        Positions are relative to the height of first contact. The metric ``max_force_n`` is the
        largest contact force on one symmetry sector of the body, not on the complete body.
        """
        pair = _contact_surfaces.find_single_contact(build.scene)
        if pair is None or "time" not in waves:
            return {}
        ball = find_sphere(part, build.scene)
        t, y = waves["time"], waves[f"{ball.name}.y"] - ball.keys.radius
        force = waves[f"{pair.part.name}.force"]
        leave = _contact_surfaces.find_separation(
            t, force, waves[f"{ball.name}.v"], power=pair.contact_force.power
        )
        time, lowest = find_minimum(t, y)
        return {
            "min_position_m": Metric(lowest, "m"),
            "time_of_min_s": Metric(time, "s"),
            "separation_time_s": Metric(leave[0] if leave else None, "s"),
            "rebound_velocity_m_s": Metric(leave[1] if leave else None, "m/s"),
            "max_force_n": Metric(float(force.max() / pair.lower_surface.sectors), "N"),
        }

    def checks(self, part: Part[ThrowKeys], build: BuiltScene, waves: Waveforms) -> Iterator[Gate]:
        """Yield the checks of the part after a run."""
        gates, ball = build.scene.gates, find_sphere(part, build.scene).name
        pair = _contact_surfaces.find_single_contact(build.scene)
        law = pair.estimate_basis_error() if pair else 0.0
        place = dict.fromkeys(SOLUTION_PAIRS, max(gates.position, law)) | {
            "ngspice_vs_rom": gates.position
        }
        yield Gate("position over travel", f"{ball}.y", place, "travel", is_main=True)
        speed = dict.fromkeys(SOLUTION_PAIRS, gates.rebound_velocity)
        yield Gate("rebound velocity", "rebound_velocity_m_s", speed)
        time = dict.fromkeys(SOLUTION_PAIRS, gates.separation_time)
        yield Gate("separation time", "separation_time_s", time, "absolute", "s")

    def law(self, part: Part[ThrowKeys], build: BuiltScene) -> laws.Equations:
        """Return empty model equations, because the part only sets an initial state."""
        return laws.Equations()

    def notes(self, part: Part[ThrowKeys], scene: Scene) -> Iterator[str]:
        """Yield the assumptions of the model and the effects that it neglects."""
        keys = part.keys
        yield f"{keys.velocity:g} m/s from {format_quantity(keys.gap, 'm')}"


def _compute_impact_speed(part: Part[ThrowKeys], scene: DeclaredScene) -> float:
    """Return the speed [m/s] of the sphere at the impact."""
    return math.sqrt(part.keys.velocity**2 + 2 * max(scene.gravity, 0.0) * part.keys.gap)


def find_minimum(t: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Return the time and the value of the minimum of ``y``.

    The minimum is the vertex of a parabola through the lowest sample and its two neighbours.
    """
    k = int(np.argmin(y))
    if k in (0, t.size - 1):
        return float(t[k]), float(y[k])
    s, z = t[k - 1 : k + 2] - t[k], y[k - 1 : k + 2] - y[k]
    left, right = z[0] / s[0], z[2] / s[2]
    curvature = (right - left) / (s[2] - s[0])
    if curvature <= 0.0:
        return float(t[k]), float(y[k])
    slope = left - curvature * s[0]
    shift = -slope / (2 * curvature)
    return float(t[k] + shift), float(y[k] + slope * shift / 2)


register_part_type(Throw())
