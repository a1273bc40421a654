"""Comparison of all reduction methods on one model (``reduce --method compare``)."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from kc2spice.bodies.readers.measured_admittance import is_measured
from kc2spice.core.errors import Kc2spiceError, UsageError
from kc2spice.core.progress import Progress, ignore_progress
from kc2spice.linalg.solver import require_solver
from kc2spice.rom.error_estimate import choose_default_norm
from kc2spice.rom.linear_model import LinearModel
from kc2spice.rom.reduce import reduce_model
from kc2spice.rom.reduction import DEFAULT_MIN_TOLERANCE, Reduction
from kc2spice.rom.reductors.registry import list_reductor_names, require_method_name
from kc2spice.workflow.reduction_of_models_from_files import DEFAULT_TOLERANCE, load_full_model

DEFAULT_ROW = "default"  # name of the row for a reduction without a prescribed method


def compare_methods(
    path: Path | str | LinearModel,
    *,
    band: tuple[float, float] | None = None,
    tolerance: float | None = None,
    order: int | None = None,
    norm: str | None = None,
    solver: str | None = None,
    progress: Progress = ignore_progress,
) -> dict[str, Any]:
    """Reduce a model by every reduction method, and compare the reduced models.

    Parameters
    ----------
    path : Path, str or LinearModel
        Matrices as for :func:`kc2spice.read_model`, ``SCENE:PART``, or a model.
    band, tolerance, order, norm, solver : optional
        As for :func:`kc2spice.workflow.reduction_of_models_from_files.reduce_file`.
    progress : callable, optional
        Called as ``progress(stage, done, text)`` before each method.

    Returns
    -------
    dict[str, Any]
        The output of ``kc2spice reduce --method compare --json``. ``methods`` contains a row for
        each method, and a row ``default`` for a reduction without the option ``--method``. Each row
        contains the ``order``, the number of first-order ``states``, the ``error_estimate`` in the
        selected norm, and the CPU time ``cpu_s``. The ``peak_error`` is relative to the peak of
        each response entry. ``first_order``, ``passive`` and ``reduction_method`` describe the
        reduced model. If a method fails, its row contains the ``reason`` instead.
        ``shared_cpu_s`` is the CPU time for computing the basis of the intermediate model; all
        methods use this basis. Only the CPU time in the row ``default`` includes this basis.
        ``stable`` states whether the full-order model is stable.

    Raises
    ------
    UsageError : the file cannot be read or is a measurement, or an option is invalid.

    Examples
    --------
    >>> import numpy as np
    >>> K = 2 * np.eye(20) - np.eye(20, k=1) - np.eye(20, k=-1)
    >>> np.savez("chain.npz", M=np.eye(20), E=0.05 * K, K=K, B=np.eye(20)[:, :1])
    >>> rows = compare_methods("chain.npz", band=(0.0, 0.05), tolerance=1e-2)["methods"]
    >>> next(row["states"] for row in rows if row["method"] == "response POD")
    6
    """
    model = path if isinstance(path, LinearModel) else _load_model(path)
    if tolerance is None and order is None:
        tolerance = DEFAULT_TOLERANCE
    progress("reduce", None, f"{model.order} equations")
    begin = time.process_time()
    reduction = Reduction(
        model,
        band=band,
        norm=norm or choose_default_norm(model),  # type: ignore[arg-type]
        tolerance=tolerance or DEFAULT_MIN_TOLERANCE,
        solver=require_solver(solver, "--solver"),
    )
    shared = time.process_time() - begin
    rows = []
    with warnings.catch_warnings():
        # Each model has an error estimate, so warnings of the single reductions are suppressed.
        warnings.simplefilter("ignore")
        names = list_reductor_names()
        for number, method in enumerate(names, 1):
            progress("reduce", None, f"method {number} of {len(names)}: {method}")
            rows.append(
                _run_method(
                    reduction,
                    method,
                    partial(reduction.reduce, tolerance=tolerance, order=order, method=method),
                )
            )
        progress("reduce", None, DEFAULT_ROW)
        default = partial(
            reduce_model,
            model,
            tolerance=tolerance,
            order=order,
            band=reduction.band,
            norm=reduction.norm,
            solver=solver,
        )
        rows.append(_run_method(reduction, DEFAULT_ROW, default))
    rows.sort(key=lambda row: (row["states"] is None, row["states"] or 0))
    return {
        "model": model.name,
        "unknowns": model.order,
        "norm": reduction.norm,
        "band_hz": list(reduction.band),
        "stable": reduction.stable,
        "shared_cpu_s": shared,
        "methods": rows,
    }


def require_method_option(name: str) -> None:
    """Raise an error if ``--method`` is not the name of a reduction method."""
    plugin_hint = "install its package as in docs/how-to/own_reductor.md"
    require_method_name(name, "--method", "leave out --method", plugin_hint)


def _load_model(path: Path | str) -> LinearModel:
    """Return the full model of a file or of a scene's body."""
    if is_measured(Path(path)):
        raise UsageError(
            "the option --method applies only to models, not to measured data",
            where="--method",
            got=path,
            expected="a file of matrices, or SCENE:PART",
            hint="leave out --method",
        )
    return load_full_model(path)


def _run_method(
    reduction: Reduction, method: str, reduce: Callable[[], LinearModel]
) -> dict[str, Any]:
    """Call a reduction; return states, errors and CPU time [s], or the failure.

    ``method`` is the name of the row. ``reduction`` estimates the error in the norm *peak*.
    """
    begin, rom, reason = time.process_time(), None, None
    try:
        rom = reduce()
    except Kc2spiceError as error:
        reason = error.message.removeprefix("this reduction method does not apply to the model: ")
    except Exception as error:  # an error in a user's method must not end the comparison
        reason = f"{type(error).__name__}: {error}"
    row: dict[str, Any] = {"method": method, "order": None, "states": None, "error_estimate": None}
    row |= {"peak_error": None, "first_order": None, "passive": None, "reduction_method": ""}
    if rom is not None:
        assert rom.certificate is not None
        row |= {
            "order": rom.order,
            "states": count_first_order_states(rom),
            "error_estimate": rom.certificate.error_estimate,
            "peak_error": reduction.peak_error(rom),
            "first_order": rom.first_order,
            "passive": rom.certificate.passive,
            "reduction_method": rom.certificate.reduction_method,
        }
    return row | {"cpu_s": time.process_time() - begin, "reason": reason}


def count_first_order_states(rom: LinearModel) -> int:
    """Return the number of first-order states of a model."""
    return rom.order * (1 if rom.first_order else 2)
