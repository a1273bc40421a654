"""Names and descriptions of the estimated mesh errors of a model.

For example, ``mesh_error_resonance`` is the estimated relative error of the first resonance. Parts
that solve a field on a mesh or on rings compute these error estimates. Results, netlist headers and
the command ``explain`` print them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

# number of plane-mesh unknowns that take as much computing time as one solid-mesh unknown
PLANE_UNKNOWN_RATIO = 4.0
MESH_ERROR_PREFIX = "mesh_error_"  # prefix of the names of relative mesh errors
NOT_ESTIMATED = "error not estimated, because the matrices state no mesh"


class MeshQuantity(NamedTuple):
    """Quantity of a model whose value depends on the mesh.

    ``value_names`` is a pattern of the names of the quantity's values. If the relative mesh error
    exceeds ``warning_limit``, a run prints a warning and ``verify`` fails. The limits are usual
    tolerances of data sheets.
    """

    description: str
    value_names: str = ""
    warning_limit: float | None = None


MESH_QUANTITIES = {  # keyed by the name of the mesh error without prefix
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
    """Return the estimated relative mesh errors, keyed by a description of the quantity."""
    return {item.description: error for item, error in _list_estimated_errors(facts)}


def list_limited_errors(facts: Mapping[str, float]) -> Iterator[tuple[str, float, float]]:
    """Yield description, estimated mesh error and limit of each quantity that has a limit."""
    for item, error in _list_estimated_errors(facts):
        if item.warning_limit is not None:
            yield item.description, error, item.warning_limit


def select_mesh_values(facts: Mapping[str, float]) -> dict[str, float]:
    """Select the mesh errors among the values of a model, for :func:`list_mesh_errors`."""
    names = filter(facts.__contains__, map(MESH_ERROR_PREFIX.__add__, MESH_QUANTITIES))
    return {name: float(facts[name]) for name in names}


def _list_estimated_errors(facts: Mapping[str, float]) -> Iterator[tuple[MeshQuantity, float]]:
    """Yield each mesh-dependent quantity with its estimated error."""
    for name, item in MESH_QUANTITIES.items():
        if f"{MESH_ERROR_PREFIX}{name}" in facts:
            yield item, facts[f"{MESH_ERROR_PREFIX}{name}"]


def describe_mesh_errors(facts: Mapping[str, float]) -> str:
    """Describe the estimated mesh errors; the text is empty without an estimate.

    Parameters
    ----------
    facts : values of a model by name, including its mesh errors.

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
