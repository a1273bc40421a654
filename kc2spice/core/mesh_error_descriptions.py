"""Names and descriptions of the estimated mesh errors of a model.

For example, ``mesh_error_resonance`` is the estimated relative error of the first resonance. Parts
compute these error estimates if their model is a mesh or a set of rings. The estimates are printed
in results and netlist headers, and by the command ``explain``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

# this many unknowns of a plane mesh take as much computing time as one unknown of a solid mesh
PLANE_UNKNOWN_RATIO = 4.0
MESH_ERROR_PREFIX = "mesh_error_"  # prefix of the names of relative mesh errors
# in a mapping of model values, the key of the highest frequency [Hz] that the mesh resolves
MESH_LIMIT_NAME = "mesh_limit_hz"
NOT_ESTIMATED = "error not estimated, because the matrices come without a mesh"


class MeshQuantity(NamedTuple):
    """Quantity of a model that depends on the mesh, with a limit of its mesh error.

    ``value_names`` is a pattern, such as ``free_stroke_*``, for the names of values of this
    quantity. If the relative mesh error exceeds ``warning_limit``, a run prints a warning and
    ``verify`` fails. The limits equal the usual tolerances in data sheets.
    """

    description: str
    value_names: str = ""
    warning_limit: float | None = None


MESH_QUANTITIES = {  # keyed by the name of the mesh error without ``mesh_error_``
    "resonance": MeshQuantity("first resonance", "resonance_short_hz", 0.03),
    "capacitance": MeshQuantity("capacitance", "capacitance_free_f", 0.05),
    "stroke": MeshQuantity("stroke", "free_stroke_*", 0.1),
    "resistance": MeshQuantity("thermal resistance", "thermal_resistance_*", 0.05),
    "compliance": MeshQuantity("compliance"),
    "modes": MeshQuantity("lowest modes up to"),
    "force": MeshQuantity("force"),
    "inductance": MeshQuantity("inductance"),
    "rings": MeshQuantity("flux, force and loss"),
}


def list_mesh_errors(facts: Mapping[str, float]) -> dict[str, float]:
    """Return the estimated relative mesh errors, keyed by a description of the result."""
    return {item.description: error for item, error in _list_estimated_errors(facts)}


def list_limited_errors(facts: Mapping[str, float]) -> Iterator[tuple[str, float, float]]:
    """Yield description, mesh error and limit of each result that has a warning limit."""
    for item, error in _list_estimated_errors(facts):
        if item.warning_limit is not None:
            yield item.description, error, item.warning_limit


def select_mesh_errors(facts: Mapping[str, float]) -> dict[str, float]:
    """Select the estimated mesh errors from the ``facts`` of a model."""
    names = filter(facts.__contains__, map(MESH_ERROR_PREFIX.__add__, MESH_QUANTITIES))
    return {name: float(facts[name]) for name in names}


def _list_estimated_errors(facts: Mapping[str, float]) -> Iterator[tuple[MeshQuantity, float]]:
    """Yield each quantity whose mesh error is estimated, together with this error."""
    for name, item in MESH_QUANTITIES.items():
        if f"{MESH_ERROR_PREFIX}{name}" in facts:
            yield item, facts[f"{MESH_ERROR_PREFIX}{name}"]


def describe_mesh_errors(facts: Mapping[str, float]) -> str:
    """Describe estimated mesh errors in percent; return empty text if there are none.

    Parameters
    ----------
    facts : values of a model, including its mesh errors, keyed by name.

    Returns
    -------
    str
        The quantities with their errors in percent.

    Examples
    --------
    >>> facts = {"mesh_error_resonance": 0.0213, "mesh_error_stroke": 0.05, "mass_kg": 1.0}
    >>> describe_mesh_errors(facts)
    'first resonance 2.1 %, stroke 5 %'
    """
    errors = list_mesh_errors(facts).items()
    return ", ".join(f"{words} {100 * error:.2g} %" for words, error in errors)
