"""Reduction over ranges of parameters: task, reduced model and certificate.

The input of a reduction is a function that returns the full-order model for given values of the
parameters. The result is a :class:`ModelOverRanges`. The module
:mod:`kc2spice.rom.resonators_over_ranges` reduces mechanical and piezoelectric models. The module
:mod:`kc2spice.rom.heat_model_reduction_over_ranges` reduces thermal models.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar

from kc2spice.core.attribute_advice import WRITING_METHODS, AdvisesOnAttributes
from kc2spice.rom.linear_model import Certificate, LinearModel, Norm, Port
from kc2spice.rom.parametric_models import Full, ParameterAxis, Values

if TYPE_CHECKING:
    from kc2spice.rom.stability import StabilityProof


@dataclass(frozen=True)
class RangeTask:
    """Task of a reduction over parameter ranges: full models and required accuracy.

    ``full(values)`` returns the full-order model for values of the parameters. ``axes`` contains
    the ranges of the parameters. The largest relative error in the ``band`` [Hz], measured in the
    ``norm``, must be at most ``tolerance``. The function ``progress`` is called with the number of
    computed full models and the number of required full models.
    """

    full: Full
    axes: Sequence[ParameterAxis]
    band: tuple[float, float]
    tolerance: float
    progress: Callable[[int, int], None] = lambda done, of: None
    norm: Norm = "pointwise"


@dataclass(frozen=True, eq=False, kw_only=True)
class ModelOverRanges(AdvisesOnAttributes, ABC):
    """Reduced-order model that is valid over ranges of parameters.

    ``defaults``, ``units`` and ``descriptions`` are keyed by parameter. For a body of a scene, the
    three mappings are empty, because the keys of the body contain the same information.
    """

    _attribute_advice: ClassVar[Mapping[str, str]] = {
        **dict.fromkeys(
            WRITING_METHODS,
            'kc.parametric_subcircuit(MODEL, "NAME").write("NAME.lib") writes the netlist',
        ),
        **dict.fromkeys(
            ("transfer", "plot"), "evaluate(VALUES) returns a model without parameters"
        ),
    }

    ports: tuple[Port, ...]
    name: str = "model"
    certificate: Certificate | None = None
    defaults: Mapping[str, float] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    descriptions: Mapping[str, str] = field(default_factory=dict)

    @property
    @abstractmethod
    def parameter_axes(self) -> dict[str, ParameterAxis]:
        """Axes of the parameters, each with its range, keyed by the name of the parameter."""

    @abstractmethod
    def evaluate(self, values: Values) -> LinearModel:
        """Return the reduced model for given ``values`` of all parameters.

        Raises
        ------
        UsageError : a parameter has no value, or a value outside of the parameter's range.
        """


def record_model_values(full: Full) -> tuple[Full, list[tuple[Values, Mapping[str, float]]]]:
    """Wrap the model builder ``full`` to record the values of each model it builds.

    The first result is the wrapped function. The second result is the list of records. A record
    contains the parameter values and the ``facts`` (such as masses and error estimates) of the
    model.
    """
    facts: list[tuple[Values, Mapping[str, float]]] = []

    def build_full_model(values: Values) -> LinearModel:
        """Build the full model, and record its properties and the parameter values."""
        model = full(values)
        facts.append((dict(values), model.facts))
        return model

    return build_full_model, facts


def certify_over_ranges(
    task: RangeTask, error: float, checks: int, proof: StabilityProof, *, passive: bool = True
) -> Certificate:
    """Return the certificate of a reduced model over the parameter ranges.

    ``error`` is the largest relative difference from full-order models that the reduction did not
    use. ``checks`` is the number of compared full-order models.
    """
    return Certificate(
        band_hz=task.band,
        error_estimate=error,
        method=f"largest difference from {checks} full models at parameter values that the "
        "reduction did not use",
        stable=proof.stable,
        passive=proof.passive and passive,
        norm=task.norm,
    )
