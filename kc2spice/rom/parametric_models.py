"""Reduced models that are valid over ranges of parameters.

One basis V spans the modes and the static responses of full models at samples of the parameters.
``V'M V``, ``V'K V``, ``V'B`` and D are then smooth functions of the parameters. Products of
Chebyshev polynomials of the parameters' logarithms approximate the matrices. The approximation
is exact at the samples. The projection on V preserves definiteness. Because the method does not
track single modes, the natural frequencies of modes may cross or repel each other inside the
parameter ranges. Parameters may move the mesh, but must not change the topology of the mesh. The
dependence on parameters that only scale the damping is exact and needs no samples. Source: P.
Benner, S. Gugercin, K. Willcox, SIAM Review 57 (2015) 483, section 4 (a global basis).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import combinations_with_replacement, product
from typing import Any

import numpy as np
import scipy

from kc2spice.core.errors import UsageError
from kc2spice.linalg.factor import Factor
from kc2spice.rom.linear_model import LinearModel
from kc2spice.rom.pencil import Matrix, Pencil, SchurComplement, to_dense

MAX_ALL_MODES = 700  # up to this size, computing all modes is as fast as computing a few
MODE_BAND_RATIO = 2.0  # highest frequency of a retained mode, relative to the end of the band
MIN_MODES = 10  # smallest number of computed modes
MAX_PARAMETERS = 4  # more parameters would need hundreds of full models
# degree of polynomials, keyed by number of parameters
DEFAULT_DEGREES = {0: 0, 1: 6, 2: 5, 3: 4, 4: 3}
# amount by which the degree is raised if polynomials of the default degree are too inaccurate
DEGREE_STEP = 2
# Largest degree of the polynomials, keyed by number of parameters.
# The largest degrees need 11, 55 and 84 full models for 1, 2 and 3 parameters.
MAX_DEGREES = {1: 10, 2: 9, 3: 6}
# In a range from zero to ``high``, this share of ``high`` is added to values before the logarithm.
# For values far below the added offset, the coordinate is a linear function of the value.
LOG_OFFSET_RATIO = 1e-6
# A basis vector is omitted if (energy / largest energy of a basis vector) is below this ratio.
# The ratio is far below 1e-8, because stiff motions of thin plates have 1e8 times the energy of
# soft motions.
# With a ratio of 1e-12, the reduced model of a thin plate would have an error of 1e-4.
DEPENDENT_COLUMN = 1e-15

Values = Mapping[str, float]
Full = Callable[[Values], LinearModel]


@dataclass(frozen=True)
class ParameterAxis:
    """Range of a parameter, with a logarithmic coordinate from -1 to 1.

    The coordinate is -1 at ``low`` and 1 at ``high``. If ``from_zero`` is true, the range may begin
    at zero. If ``low`` is zero, :data:`LOG_OFFSET_RATIO` times ``high`` is added to the parameter
    value before the logarithm.

    Raises
    ------
    UsageError : the ends of the range are not two different numbers of the same sign.
    """

    name: str
    low: float
    high: float
    from_zero: bool = False

    def __post_init__(self) -> None:
        begins_at_zero = self.from_zero and 0 == self.low < self.high
        if not (self.low * self.high > 0 or begins_at_zero) or self.low == self.high:
            raise UsageError(
                "this entry is not a valid range of a parameter",
                where=self.name,
                got=f"{self.low:g} to {self.high:g}",
                expected="two different numbers of the same sign",
            )

    @property
    def log_offset(self) -> float:
        """Offset that is added to a value before the logarithm is computed."""
        return 0.0 if self.low else LOG_OFFSET_RATIO * self.high

    @property
    def middle_value(self) -> float:
        """Value of the parameter in the middle of the logarithmic range."""
        return self.value(0.0)

    def value(self, x: float) -> float:
        """Return the value of the parameter at a normalised coordinate ``x``."""
        low, high = self.low + self.log_offset, self.high + self.log_offset
        return low * float((high / low) ** (0.5 * (x + 1))) - self.log_offset

    def compute_coordinate(self, value: float) -> float:
        """Compute the range coordinate of a value; nan if value and range differ in sign."""
        low, high = self.low + self.log_offset, self.high + self.log_offset
        if not (value + self.log_offset) / low > 0:
            return float("nan")
        return float(2 * np.log((value + self.log_offset) / low) / np.log(high / low) - 1)


def require_values_in_ranges(axes: Iterable[ParameterAxis], values: Values) -> None:
    """Reject parameter ``values`` that are missing or outside of their ranges.

    Raises
    ------
    UsageError : a parameter is missing or outside of its range.
    """
    for axis in axes:
        if (
            axis.name not in values
            or not abs(axis.compute_coordinate(values[axis.name])) <= 1 + 1e-9
        ):
            raise UsageError(
                "the value is outside of the range of the parameter",
                where=axis.name,
                got=values.get(axis.name),
                expected=f"{axis.low:g} to {axis.high:g}",
                hint="widen the range of the parameter in rom.parameters",
            )


@dataclass(frozen=True)
class DampingParameter:
    """Parameter that changes only the Rayleigh damping coefficients alpha and beta.

    Both coefficients are proportional to powers of the parameter. The attributes ``alpha`` and
    ``beta`` are the exponents of these powers.
    """

    axis: ParameterAxis
    alpha: float
    beta: float


@dataclass(frozen=True, eq=False, kw_only=True)
class ParameterPolynomials:
    """Polynomials that approximate the matrices of a model over ranges of parameters.

    Each matrix is a sum of terms. The factor of a term is a product of Chebyshev polynomials, one
    for the coordinate of each parameter in ``axes``. ``exponents`` (terms, axes) contains the
    degrees of these polynomials. The parameters in ``losses`` only scale the damping.
    """

    axes: tuple[ParameterAxis, ...]
    losses: tuple[DampingParameter, ...]
    exponents: np.ndarray

    @property
    def parameter_axes(self) -> dict[str, ParameterAxis]:
        """Axes of the parameters, each with its range, keyed by the name of the parameter."""
        return {axis.name: axis for axis in (*self.axes, *(item.axis for item in self.losses))}

    def compute_products(self, values: Values) -> np.ndarray:
        """Return the value of each polynomial term at parameter ``values``.

        Raises
        ------
        UsageError : a parameter is missing or outside of its range.
        """
        require_values_in_ranges(self.parameter_axes.values(), values)
        x = np.array([[axis.compute_coordinate(values[axis.name]) for axis in self.axes]])
        return np.asarray(evaluate_polynomials(x, self.exponents)[0])

    def compute_damping(self, pair: Iterable[float], values: Values) -> tuple[float, float]:
        """Return the Rayleigh coefficients alpha and beta at parameter ``values``.

        ``pair`` contains alpha and beta for damping parameters in the middle of their ranges. The
        attribute ``losses`` lists the damping parameters.
        """
        alpha, beta = pair
        for loss in self.losses:
            share = values[loss.axis.name] / loss.axis.middle_value
            alpha, beta = alpha * share**loss.alpha, beta * share**loss.beta
        return alpha, beta


@dataclass(frozen=True, eq=False, kw_only=True)
class DenseParametricModel(ParameterPolynomials):
    """Reduced model over ranges of parameters, with dense matrices.

    ``terms`` contains the coefficients of the polynomials for each of M, K, B, D and E, or
    ``rayleigh`` instead of E. The first index of each array is the number of the term.
    """

    frame: LinearModel
    terms: Mapping[str, np.ndarray]

    def evaluate(self, values: Values) -> LinearModel:
        """Return the reduced model for ``values`` of all parameters.

        Raises
        ------
        UsageError : a parameter is missing or outside of its range.
        """
        weights = self.compute_products(values)
        result: dict[str, Any] = {
            letter: np.tensordot(weights, c, 1) for letter, c in self.terms.items()
        }
        if "rayleigh" in result:
            result["rayleigh"] = self.compute_damping(result["rayleigh"], values)
        return LinearModel(**result, ports=self.frame.ports, name=self.frame.name)


def reduce_over_parameters(
    full: Full,
    axes: Sequence[ParameterAxis],
    band: tuple[float, float],
    *,
    degree: int | None = None,
    progress: Callable[[int, int], None] = lambda done, of: None,
) -> DenseParametricModel:
    """Reduce the full models ``full(values)`` over the parameter ranges ``axes``.

    The result is accurate up to the end of ``band`` [Hz]. ``degree`` is the total degree of the
    polynomials. Before each full model, ``progress`` is called with the number of this model and
    the total number of full models.

    Raises
    ------
    UsageError : a full model is not symmetric, not of second order or not collocated, or the number
    of unknowns changes within the parameter ranges.
    """
    cached_model = cache(lambda key: full(dict(key)))

    def build_full_model(values: Values) -> LinearModel:
        """Return the full model for parameter ``values``, computed only once."""
        return cached_model(tuple(sorted(values.items())))

    middle = {axis.name: axis.middle_value for axis in axes}
    frame = _require_symmetric_model_of_fixed_mesh(build_full_model(middle), None)
    losses = list[DampingParameter]()
    for axis in axes:
        if loss := _find_damping_parameter(build_full_model, axis, middle, frame):
            losses.append(loss)
    stiffness_axes = tuple(axis for axis in axes if axis not in [loss.axis for loss in losses])
    degree = DEFAULT_DEGREES.get(len(stiffness_axes), 2) if degree is None else degree
    exponents = list_exponents(len(stiffness_axes), degree)
    # the samples are approximate Fekete points of a Chebyshev grid, one sample per polynomial
    grid = np.sin(0.5 * np.pi * np.arange(-degree, degree + 1, 2) / max(degree, 1))
    points = np.array(list(product(grid, repeat=len(stiffness_axes))))
    *_, selected = scipy.linalg.qr(
        evaluate_polynomials(points, exponents).T, mode="economic", pivoting=True
    )
    points = points[np.sort(selected[: len(exponents)])]
    models = []
    for number, x in enumerate(points):
        progress(number + 1, len(points))
        values = {axis.name: axis.value(v) for axis, v in zip(stiffness_axes, x, strict=True)}
        models.append(
            _require_symmetric_model_of_fixed_mesh(build_full_model(middle | values), frame)
        )
    V = _orthonormalise(
        [_compute_modes_and_static_responses(model.pencil, band) for model in models], frame.M
    )
    pencils = [model.pencil.project(V) for model in models]
    rows = {
        "M": [p.coefficients[2] for p in pencils],
        "K": [p.coefficients[0] for p in pencils],
        "B": [p.B for p in pencils],
        "D": [p.D for p in pencils],
    }
    if frame.rayleigh is None:
        rows["E"] = [p.coefficients[1] for p in pencils]
    else:
        rows["rayleigh"] = [np.array(model.rayleigh) for model in models]
    table = evaluate_polynomials(points, exponents)
    terms = {
        letter: np.linalg.solve(table, np.reshape(values, (len(points), -1))).reshape(
            -1, *np.shape(values[0])
        )
        for letter, values in rows.items()
    }
    return DenseParametricModel(
        axes=stiffness_axes,
        losses=tuple(losses),
        exponents=exponents,
        frame=replace(frame, facts={}),
        terms=terms,
    )


def choose_higher_degree(model: DenseParametricModel) -> int | None:
    """Return the next higher polynomial degree, or None above :data:`MAX_DEGREES`."""
    degree = int(model.exponents.sum(axis=1).max()) + DEGREE_STEP
    return degree if degree <= MAX_DEGREES.get(len(model.axes), 0) else None


def compute_modal_transfer(model: LinearModel, frequency: np.ndarray) -> np.ndarray:
    """Compute the transfer matrices of a full model by modal superposition.

    Return an array of shape (frequencies, outputs, inputs). Modes up to twice the highest frequency
    in ``frequency`` [Hz] are included. The static responses represent all higher modes. The
    computation takes a second for models whose direct solution takes minutes.
    """
    f = np.asarray(frequency, dtype=float)
    return project_on_modes(model, float(f.max())).transfer(2j * np.pi * f)


def project_on_modes(model: LinearModel, top: float) -> Pencil:
    """Project a full model on the modes up to twice the frequency ``top`` [Hz].

    The basis also contains the part of the static responses that the modes do not represent.
    """
    return model.pencil.project(
        _orthonormalise([_compute_modes_and_static_responses(model.pencil, (0.0, top))], model.M)
    )


def compute_natural_modes(
    pencil: Pencil, top: float, square: float, inverse: Factor
) -> tuple[np.ndarray, np.ndarray]:
    """Compute the squared natural frequencies (k,) and the mode shapes.

    The result contains all modes up to ``top`` [rad/s], and at least :data:`MIN_MODES` modes. The
    mode shapes (n, k) are M-orthonormal. ``inverse`` is a factorisation of the matrix ``K - square
    * M`` for the scalar ``square`` [1/s^2].
    """
    K, M = pencil.coefficients[0], pencil.coefficients[2]
    n = pencil.size
    if n <= MAX_ALL_MODES:
        w2, V = scipy.linalg.eigh(to_dense(K), to_dense(M))
        count = min(n, max(MIN_MODES, int(np.searchsorted(w2, top**2))))
        return w2[:count], V[:, :count]
    count, operator = MIN_MODES, scipy.sparse.linalg.LinearOperator
    solve = operator((n, n), inverse.solve, dtype=float)
    applied = (
        K if not isinstance(K, SchurComplement) else operator((n, n), K.__matmul__, dtype=float)
    )
    start = np.random.default_rng(0).normal(size=n)
    while True:
        w2, V = scipy.sparse.linalg.eigsh(applied, count, M=M, sigma=square, OPinv=solve, v0=start)
        order = np.argsort(w2)
        if w2[order[-1]] >= top**2 or 2 * count >= n:
            return w2[order], V[:, order]
        count *= 2


def _require_symmetric_model_of_fixed_mesh(
    model: LinearModel, frame: LinearModel | None
) -> LinearModel:
    """Require a symmetric model whose mesh does not change with the parameters."""
    if model.first_order or not model.symmetric:
        raise UsageError(
            "the model of this part cannot have parameters",
            where=model.name,
            expected="a symmetric second-order model with collocated ports",
        )
    if frame is not None and model.order != frame.order:
        raise UsageError(
            "the number of mesh cells changes within the ranges of the parameters",
            where=model.name,
            got=f"{model.order} and {frame.order} unknowns",
            expected="ranges in which the mesh has the same number of cells",
        )
    return model


def _compute_modes_and_static_responses(pencil: Pencil, band: tuple[float, float]) -> np.ndarray:
    """Compute mode shapes and static responses as basis vectors.

    The static responses do not contain the contributions of the mode shapes.

    The modes have frequencies up to :data:`MODE_BAND_RATIO` times the end of the ``band`` [Hz].
    """
    top, M = 2 * np.pi * band[1], pencil.coefficients[2]
    # K is regular if the body is supported
    square = 0.0 if pencil.is_factorised else -((top / 3) ** 2)
    inverse = pencil.factorise_shifted_stiffness(square)
    _, V = compute_natural_modes(pencil, MODE_BAND_RATIO * top, square, inverse)
    static_responses = inverse.solve(pencil.B)
    # the basis also contains the derivative of the response with respect to s^2
    static_responses = np.column_stack([static_responses, inverse.solve(M @ static_responses)])
    for _ in range(2):
        static_responses = static_responses - V @ (V.T @ (M @ static_responses))
    return np.column_stack([V, static_responses])


def _orthonormalise(columns: Sequence[np.ndarray], M: Matrix) -> np.ndarray:
    """Return M-orthonormal columns that span the space of ``columns``.

    Directions that consist of rounding errors are omitted.
    """
    V = np.hstack(columns)
    size = np.sqrt(np.einsum("ij,ij->j", V, M @ V))
    V = V[:, size > 0] / size[size > 0]
    for least in (DEPENDENT_COLUMN, 0.0):  # the second pass removes rounding errors
        w, T = np.linalg.eigh(V.T @ (M @ V))
        significant = w > least * w[-1]
        V = V @ (T[:, significant] / np.sqrt(w[significant]))
    return np.asarray(V)


def _find_damping_parameter(
    full: Full, axis: ParameterAxis, middle: Values, frame: LinearModel
) -> DampingParameter | None:
    """Find the damping parameter of an axis along which only the damping varies.

    A damping parameter only multiplies the Rayleigh coefficients by powers of the parameter. The
    result is None if the parameter of ``axis`` changes one of the matrices M, K, B and D.
    """
    if frame.rayleigh is None:
        return None
    places = (-1.0, 1.0, 0.3)
    models = []
    for x in places:  # the first model already shows whether the parameter changes other matrices
        model = full({**middle, axis.name: axis.value(x)})
        if model.rayleigh is None or not _differs_in_damping_only(model, frame):
            return None
        models.append(model)
    share = np.log([axis.value(x) / axis.middle_value for x in places])
    powers = []
    for k, at_middle in enumerate(frame.rayleigh):
        sizes = [model.rayleigh[k] for model in models if model.rayleigh]
        if at_middle == 0.0 and not any(sizes):
            powers.append(0.0)
            continue
        if at_middle <= 0.0 or min(sizes) <= 0.0:
            return None
        power = np.log(np.array(sizes) / at_middle) / share
        if np.ptp(power) > 1e-6:
            return None
        powers.append(float(np.round(power.mean(), 6)))
    return DampingParameter(axis, *powers) if any(powers) else None


def _differs_in_damping_only(one: LinearModel, other: LinearModel) -> bool:
    """Return whether two models differ only in damping."""
    if one.order != other.order:
        return False
    pairs = [(one.M, other.M), (one.B, other.B), (one.D, other.D)]
    if isinstance(one.K, SchurComplement) and isinstance(other.K, SchurComplement):
        pairs += [(getattr(one.K, k), getattr(other.K, k)) for k in ("uu", "up", "pp")]
    else:
        pairs += [(one.K, other.K)]
    return all(a.shape == b.shape and not (min(a.shape) and abs(a - b).max()) for a, b in pairs)


def list_exponents(axes: int, degree: int) -> np.ndarray:
    """Return the exponents of all products of powers up to a total ``degree``.

    The result is an array of shape (terms, axes).
    """
    rows = []
    for total in range(degree + 1):
        for selected in combinations_with_replacement(range(axes), total):
            rows.append(np.bincount(selected, minlength=axes))
    return np.array(rows, dtype=int).reshape(len(rows), axes)


def evaluate_polynomials(x: np.ndarray, exponents: np.ndarray) -> np.ndarray:
    """Return products of Chebyshev polynomials at coordinates ``x`` (points, axes).

    ``exponents`` (terms, axes) contains the degrees. The result has the shape (points, terms).
    """
    angles = np.arccos(np.clip(x, -1.0, 1.0))
    return np.asarray(np.cos(angles[:, None, :] * exponents[None]).prod(axis=2))
