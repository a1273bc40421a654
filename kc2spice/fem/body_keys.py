"""Scene keys for damping and mesh that are common to all parametric bodies."""

from __future__ import annotations

import math
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from kc2spice.core.key_actions import DeleteKey
from kc2spice.core.quantities import (
    Count,
    DampingRatio,
    Frequency,
    LossFactor,
    QFactor,
    Rate,
    Ratio,
    RefinementRule,
    Section,
    make_invalid_value_error,
)


class BodyMeshKeys(Section):
    """Scene keys of a body's mesh, such as the refinement factor.

    ``refine`` is the number of equal parts into which each cell edge is divided.
    """

    refine: Annotated[Count, RefinementRule(2.0, model=True, mesh=True)] = Field(
        1,
        ge=1,
        le=8,
        description=(
            "Refinement factor of the body's mesh: number of equal parts into which each "
            "cell edge is divided"
        ),
    )


def reject_overcritical_damping(ratio: float, expected: str, hint: str) -> None:
    """Reject a damping ratio of at least 1, with which a body does not oscillate."""
    if ratio >= 1:
        raise make_invalid_value_error("the damping is overcritical", expected, hint=hint)


class DampingKeys(Section):
    """Scene keys of the mechanical and dielectric losses of a body.

    ``model = "rayleigh"`` selects viscous damping with the matrix ``E = alpha M + beta K``, where M
    is the mass matrix and K the stiffness matrix. The body has the damping ratio ``zeta`` at the
    frequency ``at``, by default the first resonance of the body. Instead of ``zeta``, a Q factor
    ``1/(2 zeta)`` or a loss factor ``2 zeta`` may be given. If one damping ratio ``zeta`` at the
    frequency f is given, ``beta`` is ``zeta / (pi f)``; the key ``at`` states f. Two damping ratios
    at two frequencies determine ``alpha`` and ``beta`` by the equation ``zeta = alpha/(2 omega) +
    beta omega/2``. With ``per_material``, E is the sum of ``K_i/(Q_i omega)`` over all materials i.
    Q_i is the Q factor of material i, and K_i the stiffness matrix of its elements. The loss
    tangent of the body is then the mean of the loss tangents of its piezoelectric materials,
    weighted by the energy of their electric fields. The key ``loss_tangent`` replaces this mean.

    ``model = "ieee176"`` selects the complex material constants of IEEE Std 176. The Q factor is
    then the same for all modes. The scene states the material constants at the frequency ``at``, by
    default the first resonance of the body.
    """

    ratio: DampingRatio | tuple[DampingRatio, DampingRatio] | None = Field(
        None,
        description=(
            "Damping ratio (fraction of critical damping) at `damping.at`, or two "
            "damping ratios for two frequencies"
        ),
    )
    quality: QFactor | None = Field(
        None,
        gt=0,
        description=(
            "Mechanical Q factor of the body, 1 / (2 * ratio); can be stated instead of "
            "`damping.ratio`"
        ),
    )
    loss_factor: LossFactor | None = Field(
        None,
        ge=0,
        description=(
            "Mechanical loss factor of the body, 2 * ratio; can be stated instead of "
            "`damping.ratio`"
        ),
    )
    per_material: bool = Field(
        False,
        description=(
            "Whether the losses of the body follow from the Q factors and loss tangents of its "
            "materials"
        ),
    )
    at: Frequency | tuple[Frequency, Frequency] | None = Field(
        None,
        description=(
            "Frequency at which the damping ratio applies; by default the first resonance of "
            "the body"
        ),
    )
    alpha: Rate = Field(
        0.0,
        ge=0,
        description="Coefficient alpha of the damping matrix alpha M, where M is the mass matrix",
    )
    loss_tangent: Ratio | None = Field(
        None,
        ge=0,
        le=1,
        description=(
            "Dielectric loss tangent of the mechanically free body at 1 kHz, as stated in "
            "data sheets"
        ),
    )

    model: Literal["rayleigh", "ieee176"] = Field(
        "rayleigh",
        description=(
            "Loss model: viscous damping (rayleigh), or complex material constants with a "
            "constant Q factor (ieee176)"
        ),
    )

    @model_validator(mode="after")
    def _reject_rayleigh_keys(self) -> DampingKeys:
        """Reject keys of Rayleigh damping together with ``model = "ieee176"``."""
        if self.model == "ieee176":
            others = {"per_material": self.per_material, "alpha": self.alpha}
            others["two ratios"] = isinstance(self.ratio, tuple)
            for name, value in others.items():
                if value:
                    raise make_invalid_value_error(
                        f'{name} applies only to model = "rayleigh"; write one quality instead',
                        None,
                        hint=f'delete {name}, or write  model = "rayleigh"',
                    )
        return self

    @model_validator(mode="after")
    def _require_consistent_damping(self) -> DampingKeys:
        """Require consistent damping keys: valid values, and no damping stated twice."""
        choices = [self.ratio, self.quality, self.loss_factor]
        if sum(item is not None for item in choices) + self.per_material > 1:
            names = "ratio", "quality", "loss_factor", "per_material"
            stated = [name for name in names if getattr(self, name) not in (None, False)]
            raise make_invalid_value_error(
                f"the damping is stated twice, by {' and '.join(stated)}",
                f"one of {', '.join(names)}",
                hint=DeleteKey(stated[0]),
            )
        two = isinstance(self.ratio, tuple), isinstance(self.at, tuple)
        if two[0] != two[1]:
            raise make_invalid_value_error(
                "two values of ratio need two frequencies in at",
                None,
                hint='write for example  ratio = [0.01, 0.02]  and  at = ["1 kHz", "5 kHz"]',
            )
        values = np.atleast_1d([x for x in (self.ratio,) if x is not None]).ravel()
        if (values < 0).any() or (self.at is not None and np.min(self.at) <= 0):
            raise make_invalid_value_error(
                "a damping ratio is negative, or a frequency is not greater than 0",
                "a damping ratio of at least 0, and a frequency above 0",
                hint='for example  ratio = 0.01  and  at = "5 kHz"',
            )
        reject_overcritical_damping(
            self.zeta,
            "a damping ratio below 1, a Q factor above 0.5, or a loss factor below 2",
            "for 1 % damping, write ratio = 0.01 or quality = 50",
        )
        if two[0] and (self.at[0] == self.at[1] or min(self._solve_two_ratios()) < 0 or self.alpha):  # type: ignore[index]
            raise make_invalid_value_error(
                (
                    "Rayleigh damping cannot have these two damping ratios: for frequencies f1 < "
                    "f2, zeta2/zeta1 must be between f1/f2 and f2/f1"
                ),
                None,
                hint="write one ratio with one frequency",
            )
        return self

    def _solve_two_ratios(self) -> tuple[float, float]:
        """Compute the Rayleigh coefficients alpha and beta from two damping ratios."""
        omega = 2 * math.pi * np.asarray(self.at, dtype=float)
        ratios = np.asarray(self.ratio, dtype=float)
        alpha, beta = np.linalg.solve(np.column_stack([0.5 / omega, 0.5 * omega]), ratios)
        return float(alpha), float(beta)

    @property
    def zeta(self) -> float:
        """Damping ratio at the frequency ``at``; 1 % by default."""
        if self.quality is not None:
            return 0.5 / self.quality
        if self.loss_factor is not None:
            return 0.5 * self.loss_factor
        if isinstance(self.ratio, tuple):
            return max(self.ratio)
        return 0.01 if self.ratio is None else self.ratio

    @property
    def stated_loss_key(self) -> str:
        """Damping key that states the loss of the body; empty if no key states it."""
        names = ("ratio", "quality", "loss_factor", "per_material")
        return next((name for name in names if getattr(self, name)), "")

    @property
    def uses_material_tangents(self) -> bool:
        """Whether the loss tangents of the materials determine the dielectric loss."""
        return self.per_material and self.loss_tangent is None

    @property
    def key_at_first_resonance(self) -> str:
        """Damping key whose value applies at the first resonance; empty if none is stated.

        With the key ``at``, or with complex constants, no value depends on the first resonance.
        """
        return "" if self.at is not None or self.model == "ieee176" else self.stated_loss_key

    def find_ratio_frequency(self, resonance_hz: float | None) -> float | None:
        """Return the frequency [Hz] at which the damping ratio is :attr:`zeta`."""
        return resonance_hz if self.at is None else float(np.min(self.at))

    def compute_rayleigh_factors(self, resonance_hz: float) -> tuple[float, float]:
        """Return ``alpha`` [1/s] and ``beta`` [s] of the damping ``E = alpha M + beta K``."""
        if isinstance(self.ratio, tuple):
            return self._solve_two_ratios()
        at = self.find_ratio_frequency(resonance_hz)
        assert at is not None
        return self.alpha, self.zeta / (math.pi * at)
