"""Models whose matrices are sums of terms with factors that depend on parameters.

A matrix is ``M(p) = sum_i f_i(p) M_i``. The matrices M_i come from another program, and the factors
are functions of the parameters. The reduced model is a
:class:`kc2spice.rom.range_reduction.ModelOverRanges`. If keys of a scene's body are parameters of
the netlist, the reduced model of the body is also a ``ModelOverRanges``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import ClassVar

import numpy as np
import scipy

from kc2spice.core.attribute_advice import WRITING_METHODS, AdvisesOnAttributes
from kc2spice.core.domains import THERMAL
from kc2spice.core.errors import UsageError, unknown
from kc2spice.rom.band import parse_band
from kc2spice.rom.constraints import eliminate_algebraic_unknowns
from kc2spice.rom.error_estimate import choose_default_norm
from kc2spice.rom.linear_model import LinearModel, Norm
from kc2spice.rom.parametric_models import MAX_PARAMETERS, ParameterAxis, Values
from kc2spice.rom.pencil import Matrix
from kc2spice.rom.range_reduction import ModelOverRanges, RangeTask
from kc2spice.rom.reduce import ReductionTarget, choose_band, require_valid_target
from kc2spice.rom.resonators_over_ranges import reduce_over_ranges
from kc2spice.rom.stability import is_semidefinite

PARAMETRIC_MATRICES = "MKE"  # matrices that may depend on parameters; E only in heat models
Factor = Callable[[Values], float]


@dataclass(frozen=True)
class ModelParameter:
    """Parameter of a model, with default, range and unit.

    Raises
    ------
    UsageError : the range contains zero or is a single number, or the default is outside of the
    range.

    Examples
    --------
    >>> ModelParameter("thickness", 1.0, 0.8, 1.25, "mm").parameter_axis.middle_value
    1.0
    """

    name: str
    default: float
    low: float
    high: float
    unit: str = "-"
    description: str = ""

    def __post_init__(self) -> None:
        if not self.name.isidentifier() or not self.name.isascii():
            raise UsageError(
                "this text is not a valid name of a parameter",
                where=self.name,
                expected="letters, digits and _, a letter first",
            )
        if not self.parameter_axis.low <= self.default <= self.parameter_axis.high:
            raise UsageError(
                "the default value is outside of the range of this parameter",
                where=self.name,
                got=f"{self.default:g}",
                expected=f"{self.low:g} to {self.high:g}",
            )

    @property
    def parameter_axis(self) -> ParameterAxis:
        """Axis of the parameter: its name and its range, with the lower end first."""
        return ParameterAxis(self.name, min(self.low, self.high), max(self.low, self.high))


@dataclass(frozen=True, eq=False)
class AffineTerm:
    """Term ``factor(p) * matrix`` of a sum that defines one matrix of a model.

    ``letter`` names the matrix that contains the term: the stiffness K or the mass M. In a heat
    model, the matrix is the thermal conductance K or the heat capacity E. ``description`` is the
    name of the factor in error messages.
    """

    letter: str
    matrix: Matrix
    factor: Factor
    description: str = "factor"

    def __post_init__(self) -> None:
        if self.letter not in PARAMETRIC_MATRICES:
            raise unknown(
                "this matrix cannot depend on parameters", self.letter, PARAMETRIC_MATRICES, "terms"
            )
        object.__setattr__(self, "matrix", scipy.sparse.csc_array(self.matrix))

    def evaluate_term(self, values: Values) -> Matrix:
        """Evaluate this term of the sum, factor times matrix, at values of the parameters.

        Raises
        ------
        UsageError : the factor is not a finite number.
        """
        try:
            factor = float(self.factor(values))
        except (ArithmeticError, ValueError, TypeError) as error:
            raise self._make_factor_error(values, str(error)) from None
        if not np.isfinite(factor):
            raise self._make_factor_error(values, f"{factor}")
        return factor * self.matrix

    def _make_factor_error(self, values: Values, got: str) -> UsageError:
        """Make the error for a factor that is not a finite number."""
        return UsageError(
            f"the factor of matrix {self.letter} is not a number",
            where=self.description,
            got=f"{got} at {_describe_values(values)}",
            expected="a finite number over the ranges of all parameters",
        )


@dataclass(frozen=True, eq=False)
class AffineModel(AdvisesOnAttributes):
    """Model whose matrices (M and K, or E and K of heat models) depend on parameters.

    The stiffness is ``K(p) = K + sum f_i(p) K_i``. M and E are sums of the same form.

    Parameters
    ----------
    model : LinearModel
        Model with the constant part of each matrix, the ports and the damping. Damping is
        proportional to mass and stiffness (``rayleigh``), or absent. All ports of a heat model are
        thermal.
    terms : sequence of tuples
        Each tuple contains a letter ``"K"``, ``"M"`` or ``"E"``, a matrix (n, n), and a factor. The
        factor is a function whose argument is a mapping with the values of all parameters. In heat
        models, each factor is a product of parameters with the powers -1, 0 or 1.
    parameters : sequence of ModelParameter
        One to four parameters with their ranges.
    assemble : callable, optional
        Function that returns the full-order model for values of the parameters. If ``assemble`` is
        given, the model ignores ``terms``.

    Raises
    ------
    UsageError : there are no parameters or more than four, two parameters have the same name, or
        the matrices differ in size.

    Examples
    --------
    A spring of 100 N/m in parallel with a spring of stiffness k carries a mass of 10 g.

    >>> import kc2spice as kc
    >>> tip = kc.Port("tip", "mechanical")
    >>> fixed = kc.LinearModel(M=[[0.01]], K=[[100.0]], B=[[1.0]], ports=(tip,))
    >>> stiffness = kc.ModelParameter("k", 50.0, 25.0, 100.0, "N/m")
    >>> springs = kc.AffineModel(fixed, [("K", [[1.0]], lambda p: p["k"])], [stiffness])
    >>> float(springs.evaluate({"k": 100.0}).K[0, 0])
    200.0
    >>> reduced = kc.reduce(springs, tolerance=1e-3, band=(0, 30))
    >>> reduced.certificate.error_estimate < 1e-3
    True
    """

    _attribute_advice: ClassVar[Mapping[str, str]] = {
        **dict.fromkeys(
            (*WRITING_METHODS, "reduce"),
            "kc.reduce(MODEL, tolerance=1e-3) returns a reduced model; "
            'kc.parametric_subcircuit(REDUCED, "NAME").write("NAME.lib") writes its netlist',
        ),
        **dict.fromkeys(
            ("transfer", "plot", "ports"), "evaluate(VALUES) returns a model without parameters"
        ),
    }

    model: LinearModel
    terms: Sequence[AffineTerm | tuple[str, Matrix, Factor]] = ()
    parameters: Sequence[ModelParameter] = ()
    assemble: Callable[[Values], LinearModel] | None = None
    _terms: tuple[AffineTerm, ...] = field(default=(), init=False, repr=False)

    def __post_init__(self) -> None:
        if not isinstance(self.model, LinearModel):
            raise UsageError(
                "this object is not a linear model",
                where="model",
                got=repr(self.model)[:120],
                expected="a kc.LinearModel at the default values of the parameters",
                hint="build one by kc.LinearModel(M=M, K=K, B=B)",
            )
        names = [item.name.lower() for item in self.parameters]
        if not 1 <= len(names) <= MAX_PARAMETERS or len(set(names)) < len(names):
            raise UsageError(
                "the list of parameters is not valid",
                where=f"{self.model.name}: parameters",
                got=", ".join(names) or "no parameter",
                expected=f"1 to {MAX_PARAMETERS} parameters whose names differ in more than case",
            )
        terms = [t if isinstance(t, AffineTerm) else AffineTerm(*t) for t in self.terms]
        for term in terms:
            if term.letter not in self.parametric_letters:
                raise unknown(
                    "this matrix of the model cannot depend on parameters",
                    term.letter,
                    self.parametric_letters,
                    f"{self.model.name}: terms",
                )
        object.__setattr__(self, "_terms", tuple(terms))
        object.__setattr__(self, "parameters", tuple(self.parameters))

    @property
    def name(self) -> str:
        """Name of the model."""
        return self.model.name

    @property
    def conducts_heat(self) -> bool:
        """Whether the model is a heat model, ``E T' + K T = B q``."""
        return self.model.first_order and all(p.domain is THERMAL for p in self.model.ports)

    @property
    def parametric_letters(self) -> str:
        """Letters of the matrices that may depend on parameters, such as K for stiffness."""
        return "EK" if self.conducts_heat else "MK"

    @property
    def axes(self) -> tuple[ParameterAxis, ...]:
        """Axes of all parameters: the name and the range of each parameter."""
        return tuple(item.parameter_axis for item in self.parameters)

    @property
    def defaults(self) -> dict[str, float]:
        """Default values of the parameters, keyed by name."""
        return {item.name: item.default for item in self.parameters}

    def evaluate(self, values: Values) -> LinearModel:
        """Return the full-order model for values of the parameters.

        Parameters that ``values`` does not contain have their default values.

        Raises
        ------
        UsageError : a parameter is unknown, or a factor is not a number.
        """
        for name in values:
            if name not in self.defaults:
                raise unknown("the model has no such parameter", name, self.defaults, self.name)
        point = self.defaults | dict(values)
        if self.assemble is not None:
            return self.assemble(point)
        model = self.model
        if self.conducts_heat:
            K, E = model.pencil.coefficients
            sums = sum_affine_terms({"E": E, "K": K}, self._terms, point)
            E, K = sums["E"], sums["K"]
            return LinearModel(
                E=E, K=K, B=model.B, ports=model.ports, name=model.name, band=model.band
            )
        constant = {letter: getattr(model, letter) for letter in self.parametric_letters}
        return replace(model, **sum_affine_terms(constant, self._terms, point))


def sum_affine_terms(
    constant: Mapping[str, Matrix], terms: Iterable[AffineTerm], values: Values
) -> dict[str, Matrix]:
    """Return the sum of constant and parametric terms of each matrix, keyed by letter.

    ``values`` are the values of the parameters.

    Raises
    ------
    UsageError : a term and the constant matrix differ in size, or a factor is not a number.
    """
    result = dict(constant)
    for term in terms:
        known, addition = result.get(term.letter), term.evaluate_term(values)
        if known is not None and known.shape != addition.shape:
            raise UsageError(
                f"a term of matrix {term.letter} has a wrong size",
                where=term.description,
                got=" x ".join(map(str, addition.shape)),
                expected=" x ".join(map(str, known.shape)),
            )
        result[term.letter] = addition if known is None else known + addition
    return result


def reduce_affine(
    affine: AffineModel,
    *,
    tolerance: float,
    band: tuple[float | str, float | str] | None = None,
    norm: Norm | None = None,
    progress: Callable[[int, int], None] = lambda done, of: None,
) -> ModelOverRanges:
    """Reduce a model over the ranges of its parameters.

    Parameters
    ----------
    affine : AffineModel
        Full-order models, which must be symmetric and must not have signal ports.
    tolerance : float
        Largest permitted relative error of the response over the band and the parameter ranges.
    band : tuple of two floats or strings, optional
        Lowest and highest frequency: numbers in Hz, or strings with a unit. The default is the band
        of the model. If the model has no band, the default band ends a little above the fifth
        natural frequency in the middle of the parameter ranges.
    norm : "pointwise" or "peak", optional
        Definition of the relative error, as in :func:`kc2spice.reduce`.
    progress : callable, optional
        Function that is called with the number of full-order models solved so far, and with the
        total number of full-order models.

    Returns
    -------
    ModelOverRanges
        Resonators or a heat network over the ranges, with a certificate.

    Raises
    ------
    UsageError : the model has signal ports or damping that is not proportional, or a matrix is not
        positive definite in the whole range. The error also occurs if the band begins at 0 Hz and a
        port drives a rigid-body mode.
    SimulationError : the error exceeds the tolerance.
    """
    middle = {axis.name: axis.middle_value for axis in affine.axes}
    heat = affine.conducts_heat
    fit = _return_unchanged if heat else _complete_rayleigh_factors
    model = fit(affine.evaluate(middle))
    norm = norm or choose_default_norm(model)
    require_valid_target(ReductionTarget(tolerance, None, parse_band(band), norm, False, None))
    try:
        for ends in product(*((axis.low, axis.high) for axis in affine.axes)):
            _require_semidefinite(affine, dict(zip(middle, ends, strict=True)))
        limits = choose_band(model, eliminate_algebraic_unknowns(model.pencil), parse_band(band))
        task = RangeTask(
            lambda values: fit(affine.evaluate(values)),
            affine.axes,
            limits,
            tolerance,
            progress,
            norm,
        )
        result = _reduce_heat(task) if heat else reduce_over_ranges(task)
    except np.linalg.LinAlgError:
        raise _make_indefinite_error(
            affine, "a matrix that is not positive definite at parameter values within the ranges"
        ) from None
    units = {item.name: item.unit for item in affine.parameters}
    descriptions = {item.name: item.description for item in affine.parameters}
    return replace(result, defaults=affine.defaults, units=units, descriptions=descriptions)


def _require_semidefinite(affine: AffineModel, values: Values) -> None:
    """Check that K, and M or E, are positive semidefinite at parameter ``values``."""
    model = affine.evaluate(values)
    stiffness, *others = model.pencil.coefficients
    for letter, matrix in zip(
        "K" + affine.parametric_letters[0], (stiffness, others[-1]), strict=True
    ):
        if not is_semidefinite(matrix):
            raise _make_indefinite_error(affine, f"matrix {letter} at {_describe_values(values)}")


def _describe_values(values: Values) -> str:
    """Return the parameter values as text, such as ``length = 0.01``."""
    return ", ".join(f"{name} = {value:g}" for name, value in values.items())


def _make_indefinite_error(affine: AffineModel, got: str) -> UsageError:
    """Make the error for a matrix that is not positive definite over the ranges."""
    return UsageError(
        "a matrix is not positive definite over the ranges of the parameters",
        where=affine.name,
        got=got,
        expected=f"symmetric positive definite {affine.parametric_letters[0]} and K at all values "
        "of the parameters",
        hint="narrow the ranges, or check the factors and the signs of the terms",
    )


def _reduce_heat(task: RangeTask) -> ModelOverRanges:
    """Reduce heat models, whose inputs are heat flows, over ranges of parameters."""
    from kc2spice.rom.heat_model_reduction_over_ranges import (
        HeatReduction,
    )  # imported here: only needed for heat models

    return HeatReduction(task.full, task.axes).reduce(task)


def _return_unchanged(model: LinearModel) -> LinearModel:
    """Return ``model`` unchanged."""
    return model


def _complete_rayleigh_factors(model: LinearModel) -> LinearModel:
    """Add Rayleigh coefficients of zero to an undamped model.

    Models with proportional damping are returned unchanged.

    Raises
    ------
    UsageError : the model has structural damping.
    """
    if model.structural:
        raise UsageError(
            "a model with parameters needs Rayleigh damping in place of structural damping",
            where=model.name,
            got="structural damping",
            expected="either `alpha` and `beta`, or `ratio` and `at`, in the table damping",
        )
    if model.rayleigh is None and model.pencil.is_undamped:
        return replace(model, E=None, rayleigh=(0.0, 0.0))
    return model
