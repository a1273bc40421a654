"""Reduction of heat models whose ports have prescribed temperatures.

The unknowns of a model ``E T' + K T = B q`` are divided into the prescribed temperatures ``T_i`` of
ports, such as isothermal faces, and all other temperatures ``T_e``. The static responses to the
prescribed temperatures are ``Psi``:

    T_e = Psi T_i + x,    Psi = -K_ee^-1 K_ei,
    E_ee x' + K_ee x = B_e q - (E_ei + E_ee Psi) T_i'.

A congruence reduces the model of ``T_e``, whose inputs are q, ``K_ei T_i`` and ``E_ei T_i'``. The
reduced model of the temperatures ``T_e``, which are not prescribed, also gives accurate heat flows
(:mod:`kc2spice.rom.prescribed_flows`). A congruence with ``Psi`` and with the basis of the reduced
``T_e`` reduces the whole model. E and K remain symmetric and positive semi-definite, so the model
is passive. The static responses to prescribed temperatures are exact. R. R. Craig and M. C. C.
Bampton, AIAA Journal 6 (1968) 1313, describe the method for structures.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy import sparse

from kc2spice.core.errors import SimulationError, UsageError, wrong
from kc2spice.rom.error_estimate import make_inaccuracy_error
from kc2spice.rom.linear_model import LinearModel
from kc2spice.rom.prescribed_flows import FlowReference, make_driven_model
from kc2spice.rom.prescribed_temperature_split import (
    DENSE,
    SplitHeatModel,
    get_symmetric_part,
    remove_inactive_ports,
    split_prescribed_ports,
    transform_to_modal_coordinates,
)
from kc2spice.rom.reduce import reduce_model

# Largest number of attempts to reduce a model. If the heat flows are not accurate enough, the next
# attempt has a smaller tolerance of the temperatures.
ATTEMPTS = 6
# Smallest tolerance of the temperatures; smaller tolerances would be near the rounding errors.
SMALLEST_TOLERANCE = 1e-9
REFERENCE_TOLERANCE = 1e-4  # tolerance of the reference model if the order is prescribed


def reduce_with_prescribed_temperatures(
    model: LinearModel,
    prescribed: Sequence[str],
    parts: SplitHeatModel | None = None,
    *,
    flows: bool = True,
    measured: bool = True,
    **aims: Any,
) -> LinearModel:
    """Reduce a heat model that has ports with prescribed temperatures.

    Parameters
    ----------
    model : heat model with E and K; the column of B of each prescribed port contains a single 1.
    prescribed : names of the ports with prescribed temperatures.
    parts : the result of :func:`split_prescribed_ports`, if already known.
    flows : whether the basis also represents the heat flows into prescribed ports.
    measured : whether the error estimate, which must meet the tolerance, includes heat flows into
        prescribed ports.
    aims : ``band``, ``norm``, ``tolerance`` and ``order`` of
        :func:`kc2spice.rom.reduce.reduce_model`.

    Returns
    -------
    LinearModel
        Model with the ports of ``model`` in the same order. The error estimate in the certificate
        covers temperatures and, if ``measured`` is true, heat flows into prescribed ports.

    Raises
    ------
    UsageError : the model of the temperatures that are not prescribed cannot be reduced by a
        congruence.
    SimulationError : the error exceeds the tolerance.
    """
    if not prescribed:
        return _reduce_definite_model(model, aims)
    parts, tolerance = parts or split_prescribed_ports(model, prescribed), aims["tolerance"]
    if not flows:
        return _assemble_reduced_model(
            model, parts, _reduce_definite_model(remove_inactive_ports(parts.inner), aims)
        )
    if not measured:
        return _assemble_reduced_model(model, parts, _reduce_inner_model(model, parts, aims))
    band, norm = aims["band"], aims["norm"]
    reference = FlowReference.from_full_model(
        model, parts, band, norm, tolerance or REFERENCE_TOLERANCE
    )
    inner_tolerance = tolerance
    for _ in range(ATTEMPTS):
        small = _reduce_inner_model(model, parts, {**aims, "tolerance": inner_tolerance})
        result = _assemble_reduced_model(model, parts, small)
        certificate = result.certificate
        assert certificate is not None  # every reduced model has a certificate
        error = reference.compute_error(result, split_prescribed_ports(result, prescribed))
        worst = max(error, certificate.error_estimate)
        if aims["order"] is not None or worst <= tolerance:
            return replace(result, certificate=replace(certificate, error_estimate=worst))
        inner_tolerance *= 0.5 * tolerance / error
        if inner_tolerance < SMALLEST_TOLERANCE:
            break
    raise make_inaccuracy_error(
        "the heat flows into ports of prescribed temperature are too inaccurate",
        f"an error of {error:.1e}",
        tolerance,
        "increase rom.tolerance, or narrow rom.band",
    )


def _reduce_inner_model(
    model: LinearModel, parts: SplitHeatModel, aims: Mapping[str, Any]
) -> LinearModel:
    """Reduce the model of all temperatures that are not prescribed."""
    try:
        return _reduce_definite_model(make_driven_model(model, parts), aims)
    except SimulationError:
        return _reduce_definite_model(make_driven_model(model, parts, stored=False), aims)


def _assemble_reduced_model(
    model: LinearModel, parts: SplitHeatModel, small: LinearModel
) -> LinearModel:
    """Combine static responses and a reduced inner model into a reduced heat model.

    ``small`` is the reduced model of the temperatures that are not prescribed.
    """
    if small.basis is None:
        raise make_no_congruence_error(model)
    n, at, others = len(parts.at), parts.at, parts.others
    V = np.zeros((model.order, n + small.order))
    V[others, :n], V[at, :n] = parts.psi, np.eye(n)
    V[others, n:] = small.basis
    K_small = np.zeros((V.shape[1],) * 2)
    K_small[:n, :n] = parts.conductance
    K, E = map(sparse.csc_array, model.pencil.coefficients)
    K_small[n:, n:] = get_symmetric_part(small.basis.T @ (K[others][:, others] @ small.basis))
    E_small = get_symmetric_part(V.T @ (E @ V))
    return replace(
        LinearModel(E=E_small, K=K_small, B=V.T @ model.B, ports=model.ports),
        certificate=small.certificate,
        facts=model.facts,
        name=model.name,
        band=model.band,
        basis=V,
    )


def make_no_congruence_error(model: LinearModel) -> UsageError:
    """Make the error for a heat model that no congruence can reduce."""
    return wrong(
        model.name, "this heat model cannot be reduced to a tolerance", hint="set rom.order"
    )


def _reduce_definite_model(model: LinearModel, aims: Mapping[str, Any]) -> LinearModel:
    """Reduce a heat model whose conductance matrix K is positive definite.

    The decay rates of a small model can differ by a factor of 1e12. If decay rates differ by many
    orders of magnitude, the slowest rate could count as zero, as in a body without a thermal path.
    Therefore, small models are transformed to modal coordinates, in which K is the unit matrix.
    """
    if model.order > DENSE:
        return reduce_model(model, **aims)
    modal, shapes = transform_to_modal_coordinates(model)
    small = reduce_model(modal, **aims)
    return small if small.basis is None else replace(small, basis=shapes @ small.basis)
