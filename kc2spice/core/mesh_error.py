"""Names and words of the facts of a body that state what its mesh costs.

``mesh_error_resonance`` is the estimated relative error of the first resonance, and so on; those
who build a body write these facts, results, headers and ``explain`` read them.
"""

from __future__ import annotations

from collections.abc import Mapping

MESH_ERROR = "mesh_error_"  # begins the names of facts that are relative errors of other facts
_MESH_ERRORS = {  # the words for what follows
    "resonance": "first resonance", "capacitance": "capacitance", "stroke": "stroke",
    "compliance": "compliance", "modes": "lowest modes up to",
}  # fmt: skip


def mesh_errors(facts: Mapping[str, float]) -> dict[str, float]:
    """Estimated relative errors that the mesh of a body causes, by what they are errors of."""
    found = {words: facts.get(f"{MESH_ERROR}{name}") for name, words in _MESH_ERRORS.items()}
    return {words: error for words, error in found.items() if error is not None}
