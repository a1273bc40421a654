"""Reduction over ranges of parameters: task, reduced model and certificate.

The input of a reduction is a function that returns the full-order model for given values of the
parameters. The result is a :class:`ModelOverRanges`. The reductions are in
:mod:`kc2spice.rom.resonators_over_ranges` for resonators, and in
:mod:`kc2spice.rom.heat_range_reduction` for heat networks.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from kc2spice.rom.linear_model import Certificate, LinearModel, Norm, Port
from kc2spice.rom.parametric_models import Full, ParameterAxis, Values

if TYPE_CHECKING:
    from kc2spice.rom.stability import StabilityProof


@dataclass(frozen=True)
class RangeTask:
    """Task of a reduction: full-order models ``full(values)``, ranges, and required accuracy.

    The largest relative error in the ``band`` [Hz], measured in the ``norm``, must be at most
    ``tolerance``. The function ``progress`` is called with the number of computed full models and
    the number of required full models.
    """

    full: Full
    axes: Sequence[ParameterAxis]
    band: tuple[float, float]
    tolerance: float
    progress: Callable[[int, int], None] = lambda done, of: None
    norm: Norm = "pointwise"


@dataclass(frozen=True, eq=False, kw_only=True)
class ModelOverRanges(ABC):
    """Reduced-order model that is valid over ranges of parameters.

    ``defaults``, ``units`` and ``descriptions`` are keyed by parameter. These three mappings are
    empty for a body of a scene, because the keys of the body contain the same information.
    """

    ports: tuple[Port, ...]
    name: str = "model"
    certificate: Certificate | None = None
    defaults: Mapping[str, float] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    descriptions: Mapping[str, str] = field(default_factory=dict)

    @property
    @abstractmethod
    def parameter_axes(self) -> dict[str, ParameterAxis]:
        """Axis of each parameter, with its range, keyed by the name of the parameter."""

    @abstractmethod
    def evaluate(self, values: Values) -> LinearModel:
        """Return the reduced model for ``values`` of all parameters.

        Raises
        ------
        UsageError : a parameter is missing or outside of its range.
        """


def record_model_values(full: Full) -> tuple[Full, list[tuple[Values, Mapping[str, float]]]]:
    """Return a function like ``full`` that records the values of each computed model.

    The second result is the list of records: pairs of the parameter values and the facts of the
    model.
    """
    facts: list[tuple[Values, Mapping[str, float]]] = []

    def compute_full(values: Values) -> LinearModel:
        """Build the full model, and record its ``facts`` with the parameter values."""
        model = full(values)
        facts.append((dict(values), model.facts))
        return model

    return compute_full, facts


def certify_over_ranges(
    task: RangeTask, error: float, checks: int, proof: StabilityProof, *, passive: bool = True
) -> Certificate:
    """Return the certificate of a reduced model over the parameter ranges.

    ``error`` is the largest difference to ``checks`` full-order models that the reduction did not
    use.
    """
    return Certificate(
        band_hz=task.band,
        error_estimate=error,
        method=f"over the parameter ranges: difference to {checks} full models that were not used "
        "for the reduction",
        stable=proof.stable,
        passive=proof.passive and passive,
        norm=task.norm,
    )
