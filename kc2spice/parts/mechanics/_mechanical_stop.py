"""Stop that limits a displacement and returns part of the impact energy.

Plates, combs and armatures can have a stop. Beyond the displacement ``travel``, the moving part
indents the stop by d at the rate v = dd/dt. The force of the stop is::

    F = stop d (1 + loss v / sqrt(v^2 + slow^2) + damping v)
    loss = (1 - restitution^2) / (1 + restitution^2)

Without ``damping``, a mass that is faster than ``slow`` feels ``1 + loss`` times the stiffness
``stop`` while d increases, and ``1 - loss`` times this stiffness while d decreases. If the impact
speed is above ``slow``, the mass rebounds with the fraction ``restitution^2`` of its kinetic energy
before the impact. If the impact speed is below ``slow``, the mass comes to rest. Source: O. R.
Walton, R. L. Braun, J. Rheol. 30 (1986) 949. The damping term is proportional to the stiffness (H.
Hunt, F. R. E. Crossley, J. Appl. Mech. 42 (1975) 440).
"""

from typing import Annotated

from pydantic import Field

from kc2spice.core.quantities import Ratio, Section, si

# Velocity [m/s] below which a mass does not rebound.
# A mass that rebounds with this velocity would rise by only a nanometre at a deceleration of
# 5 m/s2.
MIN_STRIKE_VELOCITY = 1e-4


class StopKeys(Section):
    """Keys of a stop: coefficient of restitution, and damping coefficient."""

    restitution: Ratio = Field(
        0.5,
        ge=0,
        le=1,
        description=(
            "Coefficient of restitution of the stop: speed after an impact divided by the "
            "speed before the impact"
        ),
    )
    damping: Annotated[float, si("s/m")] = Field(
        0.0,
        ge=0,
        description="Hunt-Crossley damping coefficient: the force of the stop is "
        "multiplied by 1 + damping * (closing speed); requires restitution = 1",
    )


STOP_CONSTANTS = {
    "loss": "(1 - restitution*restitution)/(1 + restitution*restitution)",
    "slow": repr(MIN_STRIKE_VELOCITY),
}
STOP_NEGLECTED = (
    "sticking and wear of the stop, dependence of the rebound on the impact speed",
    "constant stiffness, constant coefficient of restitution",
    "not estimated",
)


def write_stop_energy(indentation: str, share: str = "") -> str:
    """Return the expression of a stop's energy, multiplied by the factor ``share``.

    The expression ``indentation`` is negative as long as the stop is not reached.
    """
    return f"0.5*{share}stop*max(0, {indentation})^2"


def write_stop_loss(indentation: str, rate: str, share: str = "") -> str:
    """Return the expression of a stop's dissipative force, times the factor ``share``.

    ``rate`` is the velocity of the coordinate on which the force acts.
    """
    factor = f"(loss*{rate}/sqrt({rate}^2 + slow*slow) + damping*{rate})"
    return f"{share}stop*max(0, {indentation})*{factor}"
