"""Names and words of the facts of a model that state the error of its mesh.

``mesh_error_resonance`` is the estimated relative error of the first resonance, and so on. Parts
that solve a field on a mesh or on rings write these facts; results, headers and ``explain`` print
them.
"""

from __future__ import annotations

from collections.abc import Mapping

IN_PLANE = 4.0  # number of unknowns of a plane mesh that need as much time as one unknown in space
MESH_ERROR = "mesh_error_"  # begins the names of facts that are relative errors of other facts
_MESH_ERRORS = {  # the words for what follows
    "resonance": "first resonance", "capacitance": "capacitance", "stroke": "stroke",
    "resistance": "thermal resistance",
    "compliance": "compliance", "modes": "lowest modes up to", "force": "force",
    "inductance": "inductance", "rings": "flux, force and loss",
}  # fmt: skip
NOT_ESTIMATED = "error not estimated, because the matrices state no mesh"


def mesh_errors(facts: Mapping[str, float]) -> dict[str, float]:
    """List the estimated relative mesh errors, by words for the quantities."""
    errors = {}
    for name, words in _MESH_ERRORS.items():
        if f"{MESH_ERROR}{name}" in facts:
            errors[words] = facts[f"{MESH_ERROR}{name}"]
    return errors


def mesh_facts(facts: Mapping[str, float]) -> dict[str, float]:
    """Select the ``facts`` that :func:`mesh_errors` reads."""
    names = filter(facts.__contains__, map(MESH_ERROR.__add__, _MESH_ERRORS))
    return {name: float(facts[name]) for name in names}


def describe_mesh_errors(facts: Mapping[str, float]) -> str:
    """Estimated errors of a mesh in words, empty without an estimate.

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
