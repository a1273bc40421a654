"""Public function and class for the reduction of models.

:func:`reduce` computes one reduced model. :class:`Reduction` computes several reduced models of one
full model, and factorises and solves the full model only once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import PurePath
from typing import TYPE_CHECKING, Any, ClassVar, overload

import numpy as np

from kc2spice.core.argument_and_option_names import check_arguments
from kc2spice.core.attribute_advice import WRITING_METHODS, AdvisesOnAttributes
from kc2spice.core.errors import UsageError
from kc2spice.core.quantities import convert_quantity
from kc2spice.linalg.solver import DirectSolver, use_solver
from kc2spice.rom.band import parse_band
from kc2spice.rom.certification import certify, certify_with_full_order
from kc2spice.rom.constraints import eliminate_algebraic_unknowns
from kc2spice.rom.error_estimate import choose_default_norm
from kc2spice.rom.linear_model import LinearModel, Norm
from kc2spice.rom.reduce import (
    MAX_INTERMEDIATE_SHARE,
    ReductionTarget,
    choose_band,
    compute_first_step,
    find_basis_of_order,
    find_smallest_basis,
    list_methods,
    reduce_model,
    require_valid_target,
    warn_of_inaccuracy,
)
from kc2spice.rom.reduced_basis import (
    MIN_ERROR_ESTIMATE,
    SAFETY_FACTOR,
    ReducedBasis,
    ReductionTask,
)
from kc2spice.rom.reductors.balanced_truncation import compute_hankel_singular_values
from kc2spice.rom.reductors.base import Reductor
from kc2spice.rom.reductors.rational_krylov import RationalKrylov
from kc2spice.rom.response import Response

if TYPE_CHECKING:
    from kc2spice.rom.affine import AffineModel
    from kc2spice.rom.range_reduction import ModelOverRanges

# Default value of the argument `tolerance` of the class Reduction.
# A Reduction solves the full model again only for tolerances below its argument `tolerance`.
# A default value of 1e-7 would need one or two more solutions of the full model than 1e-6.
DEFAULT_MIN_TOLERANCE = 1e-6


if TYPE_CHECKING:

    @overload
    def reduce(
        model: AffineModel,
        *,
        tolerance: float,
        band: tuple[float | str, float | str] | None = None,
        norm: Norm | None = None,
        solver: DirectSolver | str | None = None,
    ) -> ModelOverRanges:
        """Reduce an affine model to a tolerance over the ranges of its parameters."""
        ...

    @overload
    def reduce(
        model: LinearModel,
        *,
        tolerance: float | None = None,
        order: int | None = None,
        band: tuple[float | str, float | str] | None = None,
        norm: Norm | None = None,
        contact: bool = False,
        method: str | Reductor | None = None,
        parameters: Mapping[str, Any] | None = None,
        solver: DirectSolver | str | None = None,
    ) -> LinearModel:
        """Reduce a linear model to a tolerance or to a number of states."""
        ...


@check_arguments
def reduce(
    model: LinearModel | AffineModel,
    *,
    tolerance: float | None = None,
    order: int | None = None,
    band: tuple[float | str, float | str] | None = None,
    norm: Norm | None = None,
    contact: bool = False,
    method: str | Reductor | None = None,
    parameters: Mapping[str, Any] | None = None,
    solver: DirectSolver | str | None = None,
) -> LinearModel | ModelOverRanges:
    """Reduce a linear model to a tolerance or to a number of states.

    The reduced model has the ports of ``model``, in the same order. The ``certificate`` of the
    reduced model contains the largest error of any transfer function over ``band``, compared with
    ``model``. If ``order`` is given, a proportionally damped second-order model with a positive
    definite stiffness matrix is reduced by block Arnoldi at s0 = 0 (Schütz, Maeter and Bechtold,
    Actuators 10 (2021) 279, section 2.3).

    Parameters
    ----------
    model : LinearModel or AffineModel
        Full model of n unknowns, in SI units. An affine model is reduced to a ``tolerance`` over
        the ranges of all parameters. The arguments ``order``, ``contact`` and ``method`` do not
        apply to an affine model.
    tolerance : float, optional
        Largest permitted relative error over the band. The result is the smallest of the tried
        reductions within the tolerance.
    order : int, optional
        Number of unknowns of the reduced model. Exactly one of ``tolerance`` and ``order`` is
        required.
    band : tuple of two floats or strings, optional
        Lowest and highest frequency in Hz, or as strings such as ``"20 kHz"``. The default of
        ``band`` is the band of the model. If the model has no band, the band ends a little above
        the fifth natural frequency. The natural frequencies of a first-order model are the corner
        frequencies 1 / (2 pi tau) of its time constants tau.
    norm : "pointwise" or "peak", optional
        Divisor of the error of each response entry: the size of the entry at the same frequency,
        but at least a millionth of its peak (``"pointwise"``), or the largest size of the entry in
        the band (``"peak"``). The default is ``"peak"`` for models whose ports are all signals, and
        ``"pointwise"`` for all other models.
    contact : bool, default False
        Whether the reduced model also represents the response above the band. Contacts excite a
        body at frequencies above the band. Bodies of scenes are always reduced with
        ``contact=True``.
    method : str or Reductor, optional
        Method of reduction: an instance of a reductor class, the name of a method that is
        registered by :func:`kc2spice.register_reductor`, or the name of a built-in method:

        * ``"response POD"``: principal directions of the response over the band;
        * ``"response POD of both sides"``: principal directions of the responses of the model and
          of its dual model;
        * ``"balanced truncation"``: balanced states, after inputs and outputs are scaled by the
          peaks of the response;
        * ``"unscaled balanced truncation"``: balanced states, without scaling of inputs and
          outputs;
        * ``"frequency-limited balanced truncation"``: balanced states for frequencies in the band
          only;
        * ``"balanced truncation by congruence"``: balanced states of a symmetric first-order model;
        * ``"block Krylov"``: Krylov vectors with the expansion point at zero frequency;
        * ``"rational Krylov"``: responses and their derivatives at several frequencies;
        * ``"IRKA"``: local optimum in the H2 norm.

        By default, only methods are tried that preserve passivity: response POD, and for symmetric
        first-order models also balanced truncation by congruence. If all ports are signals, the
        other variants of balanced truncation are tried too, and replace response POD if they save
        at least about 10 % of the states. Passive symmetric models of first order, such as networks
        of resistors and capacitors, always remain passive. ``kc2spice reduce --method compare``
        compares all methods.
    parameters : mapping, optional
        Leave this argument out; any entry raises a UsageError, which explains where to state
        parameters. The parameters of a model are stated in a :class:`kc2spice.AffineModel`, or in
        the key ``rom.parameters`` of a body of a scene.
    solver : callable or "pardiso", optional
        Direct solver that replaces CHOLMOD and SuperLU. ``solver(matrix)`` factorises a sparse
        matrix. As for ``scipy.sparse.linalg.splu``, the returned object must have a method
        ``solve(rhs)`` for right-hand sides of shape (n, k). ``"pardiso"`` needs ``pip install
        'kc2spice[fast]'``.

    Returns
    -------
    LinearModel or ModelOverRanges
        Reduced model with the ports of ``model`` and with a ``certificate``. For an affine model,
        the result is a :class:`kc2spice.rom.range_reduction.ModelOverRanges`. The method
        ``evaluate(values)`` of a ``ModelOverRanges`` returns the reduced model for given values of
        the parameters. The function :func:`kc2spice.parametric_subcircuit` writes the netlist of a
        ``ModelOverRanges``.

    Raises
    ------
    UsageError : both or none of ``tolerance`` and ``order`` are given; a value is out of range; the
        norm or method is unknown; the method does not apply to the model; ``parameters`` is not
        empty; or ``solver`` does not solve linear systems.
    SimulationError : the tolerance cannot be met, or a point of the band is a pole.

    Examples
    --------
    Four masses of 1 g in a row, joined by springs of 2000 N/m, have their first resonance at 78 Hz.
    The static compliance at the tip equals the compliance of four springs in series, 0.002 m/N.

    >>> import numpy as np
    >>> import kc2spice as kc
    >>> stiffness = 2e3 * (np.diag([2.0, 2, 2, 1]) - np.eye(4, k=1) - np.eye(4, k=-1))
    >>> tip = kc.Port("tip", "mechanical")
    >>> chain = kc.LinearModel(M=1e-3 * np.eye(4), K=stiffness, B=np.eye(4)[:, 3:], ports=(tip,))
    >>> small = kc.reduce(chain, tolerance=1e-3, band=(0, "100 Hz"))
    >>> chain.order, small.order
    (4, 2)
    >>> small.certificate.error_estimate < 1e-3
    True
    >>> print(f"{small.transfer([0.0])[0, 0, 0].real:.5f} m/N")
    0.00200 m/N
    """
    if isinstance(model, LinearModel):
        if parameters:
            raise UsageError(
                "constant matrices cannot have parameters",
                where="parameters",
                got=", ".join(parameters),
                expected="a kc.AffineModel",
                hint="to vary a key of a body, write kc.deck(kc.load_scene(SCENE, "
                '{"PART.rom": {"parameters": {KEY: [LOW, HIGH]}}}))',
            )
        if tolerance is not None:
            tolerance = convert_quantity(tolerance, "", where="tolerance")
        return reduce_model(
            model,
            tolerance=tolerance,
            order=order,
            band=parse_band(band),
            norm=norm or choose_default_norm(model),
            contact=contact,
            method=method,
            solver=solver,
        )
    # imported here, because models without parameters do not need the module
    from kc2spice.rom.affine import AffineModel, reduce_affine

    if isinstance(model, AffineModel):
        _reject_unused_options(
            order=order, method=method, contact=contact or None, parameters=parameters or None
        )
        if tolerance is None:
            raise UsageError(
                "a model with parameters needs a tolerance",
                where="tolerance",
                expected="a relative error between 0 and 1",
                hint="add tolerance=1e-4",
            )
        tolerance = convert_quantity(tolerance, "", where="tolerance")
        with use_solver(solver):
            return reduce_affine(model, tolerance=tolerance, band=band, norm=norm)
    hint = "build a model, such as kc.LinearModel(M=M, K=K, B=B)"
    if isinstance(model, (str, PurePath)):
        hint = f"write kc.reduce(kc.read_model({str(model)!r}), ...)"
    raise UsageError(
        "this object is not a linear model",
        where="model",
        got=f"{type(model).__name__} {model!r}"[:120],
        expected="a kc.LinearModel",
        hint=hint,
    )


def _reject_unused_options(**options: object) -> None:
    """Raise UsageError for an argument that does not apply to a model with parameters."""
    for name, value in options.items():
        if value is not None:
            raise UsageError(
                f"the argument {name} does not apply to a model with parameters",
                where=name,
                got=value,
                expected="only the arguments tolerance, band, norm and solver",
                hint=f"leave {name} out",
            )


class Reduction(AdvisesOnAttributes):
    """Repeated reduction of one full-order model, for different tolerances or orders.

    The full-order model is factorised and solved only once. The solutions of the full-order model
    are reused for every reduction whose tolerance is at least the argument ``tolerance``. If
    :meth:`reduce` is called with a smaller tolerance, the full-order model is solved again.

    Parameters
    ----------
    model : LinearModel
        Full-order model of n unknowns, in SI units, without structural damping.
    band : tuple of two floats or strings, optional
        Lowest and highest frequency in Hz, or as strings such as ``"20 kHz"``. The default of
        ``band`` is the band of the model. If the model has no band, the band ends a little above
        the fifth natural frequency. The natural frequencies of a first-order model are the corner
        frequencies 1 / (2 pi tau) of its time constants tau.
    norm : "pointwise" or "peak", optional
        Divisor of the relative error, as for :func:`kc2spice.reduce`.
    tolerance : float, default 1e-6
        Smallest tolerance for which the basis of the intermediate model is accurate enough.
    method : str or Reductor, optional
        Method for all reduced models. By default, response POD and the variants of balanced
        truncation that suit the model are tried.
    points : sequence of floats, optional
        Expansion points in Hz. If ``points`` are given instead of ``method``, the basis consists of
        rational Krylov vectors at the expansion points.
    solver : callable or "pardiso", optional
        Direct solver, as for :func:`kc2spice.reduce`.

    Attributes
    ----------
    band : tuple of two floats
        Lowest and highest frequency in Hz.
    norm : str
        Norm of the relative error, ``"pointwise"`` or ``"peak"``.

    Raises
    ------
    UsageError : the model has structural damping; the band or norm is invalid; the method is
        unknown; or both ``method`` and ``points`` are given.

    Examples
    --------
    >>> import kc2spice as kc
    >>> K = 2 * np.eye(40) - np.eye(40, k=1) - np.eye(40, k=-1)
    >>> chain = kc.LinearModel(M=np.eye(40), K=K, B=np.eye(40)[:, :1], rayleigh=(0.0, 0.02))
    >>> reduction = kc.Reduction(chain, band=(0, 0.05), norm="peak")
    >>> [reduction.reduce(tolerance=tolerance).order for tolerance in (1e-1, 1e-3)]
    [4, 5]
    >>> reduction.error(6) < 1e-3 < reduction.error(4)
    True
    """

    _attribute_advice: ClassVar[Mapping[str, str]] = dict.fromkeys(
        (*WRITING_METHODS, "model", "plot"), "the method reduce(tolerance=1e-3) returns a model"
    )

    def __init__(
        self,
        model: LinearModel,
        *,
        band: tuple[float | str, float | str] | None = None,
        norm: Norm | None = None,
        tolerance: float = DEFAULT_MIN_TOLERANCE,
        method: str | Reductor | None = None,
        points: Sequence[float] | None = None,
        solver: DirectSolver | str | None = None,
    ) -> None:
        if points is not None:
            if method is not None:
                raise UsageError(
                    "method and points cannot be combined",
                    where="points",
                    got=method,
                    expected="either method or points",
                    hint="leave out points",
                )
            method = RationalKrylov(points)
        if model.structural:
            raise UsageError(
                "kc.Reduction does not apply to a model with structural damping",
                where=model.name,
                hint="use kc.reduce(model, tolerance=1e-4)",
            )
        self._target = ReductionTarget(
            tolerance, None, None, norm or choose_default_norm(model), False, method, exact=False
        )
        require_valid_target(self._target)
        self.model, self.norm = model, self._target.norm
        self._pencil = eliminate_algebraic_unknowns(model.pencil)
        self.band = choose_band(model, self._pencil, parse_band(band))
        self._bases: dict[int, tuple[Reductor | None, list[ReducedBasis]]] = {}
        self._solver = solver
        self._compute_intermediate(self._target)

    def _compute_intermediate(self, target: ReductionTarget) -> None:
        """Compute and store an intermediate model for the tolerance ``target.tolerance``."""
        assert target.tolerance is not None
        with use_solver(self._solver):
            self._intermediate, self._proof = compute_first_step(self._pencil, self.band, target)
        self._tolerance = target.tolerance
        self._task = ReductionTask.from_models(
            self.model, self._pencil, self._intermediate, self.band, self.norm
        )
        self._bases.clear()

    @property
    def points(self) -> tuple[float, ...]:
        """Expansion points [Hz] of the basis of the intermediate model, in order of use.

        The tuple is empty if the full model is small enough to be its own intermediate model.
        """
        return self._intermediate.points

    @property
    def basis(self) -> np.ndarray | None:
        """Basis vectors (n, k) of the first reduction step, in unknowns of the full model.

        The basis is None if constraints or massless unknowns were eliminated from the full model.
        """
        return self._intermediate.basis if self._pencil.size == self.model.order else None

    @property
    def stable(self) -> bool | None:
        """Whether the full-order model is stable, or None if stability is not proven."""
        return self._proof.stable

    @property
    def hankel(self) -> np.ndarray:
        """Hankel singular values of the intermediate model, in descending order.

        Balanced truncation to order q has an error of at most ``2 * sum(hankel[q:])``. At every
        frequency, ``2 * sum(hankel[q:])`` is an upper bound of the largest singular value of the
        difference between the intermediate response and the response of order q.

        Raises
        ------
        UsageError : the model is not strictly stable, or the intermediate model has more than 2000
            states.
        """
        singular_values = compute_hankel_singular_values(self._task)
        if singular_values is None:
            raise UsageError(
                "this model has no Hankel singular values",
                where=self.model.name,
                expected="a model with all poles in the left half-plane, and with a finite "
                "response at 0 Hz",
            )
        return singular_values

    def reduce(
        self,
        *,
        tolerance: float | None = None,
        order: int | None = None,
        method: str | Reductor | None = None,
    ) -> LinearModel:
        """Return the smallest model found within a tolerance, or the best of given order.

        Parameters
        ----------
        tolerance : float, optional
            Largest permitted relative error over the band.
        order : int, optional
            Number of unknowns of the reduced model. Exactly one of ``tolerance`` and ``order`` is
            required. If ``order`` is given, this method compares all congruences, but
            :func:`kc2spice.reduce` uses only block Arnoldi for definite models. If ``tolerance`` is
            given, the basis is also optimised, so that fewer unknowns suffice. With the same number
            of unknowns, a reduced model for a ``tolerance`` may therefore be more accurate than a
            reduced model for an ``order``.
        method : str or Reductor, optional
            Method for the returned model, by default the method of the object.

        Returns
        -------
        LinearModel
            Reduced-order model with a certificate. The method ``reconstruct`` of the reduced model
            returns the displacements of the full model.

        Raises
        ------
        UsageError, SimulationError : under the same conditions as in :func:`kc2spice.reduce`.
        """
        target = replace(self._target, tolerance=tolerance, order=order, exact=True)
        target = replace(target, method=self._target.method if method is None else method)
        require_valid_target(target)
        if tolerance is None:
            basis, order = self._find_basis_of_order(target)
        else:
            basis, order = self._find_basis_within(tolerance, target)
        rom = certify(basis, order)
        warn_of_inaccuracy(rom, self._intermediate.floor, tolerance)
        return certify_with_full_order(rom, self._proof)

    def error(self, order: int) -> float:
        """Return the error estimate of the reduced model of a given order.

        The reduced model is the result of :meth:`reduce`.
        """
        target = replace(self._target, tolerance=None, order=order)
        require_valid_target(target)
        basis, order = self._find_basis_of_order(target)
        return basis.estimate_model_error(order) + self._intermediate.floor

    def peak_error(self, rom: LinearModel) -> float:
        """Return the error estimate of a reduced model in the norm *peak*.

        Errors are relative to the peak of each entry of the response. A model with an inaccurate
        notch therefore has a small error in the norm *peak*, but a large error in the norm
        *pointwise*.
        """
        estimator = self._intermediate.make_estimator(self.band, "peak")
        difference = estimator.estimate_model_error(Response(rom.pencil.make_dense()))
        estimate = self._intermediate.error + SAFETY_FACTOR * difference
        return max(estimate, MIN_ERROR_ESTIMATE) + self._intermediate.floor

    def _find_basis_of_order(self, target: ReductionTarget) -> tuple[ReducedBasis, int]:
        """Return the basis with the smallest error at a prescribed order, and the order."""
        with use_solver(self._solver):
            return find_basis_of_order(
                self._task, list_methods(self._task, target), target, self._bases
            )

    def _find_basis_within(
        self, tolerance: float, target: ReductionTarget
    ) -> tuple[ReducedBasis, int]:
        """Find the basis with the fewest states for a tolerance; return it and its order."""
        if not self._is_accurate_within(tolerance):
            self._compute_intermediate(target)
        task = replace(self._task, tolerance=tolerance)
        with use_solver(self._solver):
            return find_smallest_basis(task, list_methods(task, target), target)

    def _is_accurate_within(self, tolerance: float) -> bool:
        """Return whether the intermediate model is accurate enough for a tolerance."""
        limit = max(MAX_INTERMEDIATE_SHARE * tolerance, self._intermediate.floor)
        return tolerance >= self._tolerance and self._intermediate.error <= limit
