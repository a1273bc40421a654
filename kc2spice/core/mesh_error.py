"""Estimated mesh errors of a model: names of the values, and their descriptions.

``mesh_error_resonance`` is the estimated relative error of the first resonance, and so on. Parts
that solve a field on a mesh or on rings write these values; results, headers and ``explain`` print
them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

# number of unknowns of a plane mesh that take as long as one unknown of a solid mesh
PLANE_UNKNOWN_RATIO = 4.0
MESH_ERROR_PREFIX = "mesh_error_"  # prefix of values that are relative errors of other values
NOT_ESTIMATED = "error not estimated, because the matrices state no mesh"


class MeshQuantity(NamedTuple):
    """Quantity of a model that depends on the mesh.

    ``values`` is the pattern of the names of its values. A run warns and ``verify`` fails if its
    relative error exceeds ``coarse``, a usual tolerance of data sheets.
    """

    words: str
    values: str = ""
    coarse: float | None = None


MESH_QUANTITIES = {  # keyed by the suffix of the name of the error
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


def mesh_errors(facts: Mapping[str, float]) -> dict[str, float]:
    """List the estimated relative mesh errors, keyed by a description of the quantity."""
    return {item.words: error for item, error in _estimates(facts)}


def limited_errors(facts: Mapping[str, float]) -> Iterator[tuple[str, float, float]]:
    """Yield description, estimated error and limit of each quantity that has a limit."""
    for item, error in _estimates(facts):
        if item.coarse is not None:
            yield item.words, error, item.coarse


def select_mesh_values(facts: Mapping[str, float]) -> dict[str, float]:
    """Select the values of a model that :func:`mesh_errors` reads."""
    names = filter(facts.__contains__, map(MESH_ERROR_PREFIX.__add__, MESH_QUANTITIES))
    return {name: float(facts[name]) for name in names}


def _estimates(facts: Mapping[str, float]) -> Iterator[tuple[MeshQuantity, float]]:
    """Yield each quantity with its estimated error."""
    for name, item in MESH_QUANTITIES.items():
        if f"{MESH_ERROR_PREFIX}{name}" in facts:
            yield item, facts[f"{MESH_ERROR_PREFIX}{name}"]


def describe_mesh_errors(facts: Mapping[str, float]) -> str:
    """Describe the estimated mesh errors; the text is empty without an estimate.

    Parameters
    ----------
    facts : numbers of a model by name.

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
    errors = mesh_errors(facts).items()
    return ", ".join(f"{words} {100 * error:.2g} %" for words, error in errors)
