"""Estimates of the errors of frequencies and static responses due to the mesh.

``A(u, v)`` is the energy product of two fields u and v of displacements and potentials. The errors
of frequencies, capacitances and strokes follow from three errors: e_w of a mode w, e_v of the
response v to a voltage, and e_p of the response p to a force:

    df/f = -A(e_w, e_w) / (2 A(w, w)),   dC = A(e_v, e_v),   d(stroke) = A(e_p, e_v).

On triangles, tetrahedra and quadrilaterals, each error e is estimated by the correction that cubic
shape functions yield (:mod:`kc2spice.bodies.enriched_model`). At edges of electrodes and supports,
the solution is singular and converges slowly as the polynomial degree rises. The cubic functions
therefore correct only the share :data:`CORRECTED_SHARE` of the error. On hexahedra, cubic functions
would need more time than the model itself. On hexahedra, e is the difference between recovered and
computed strain and electric field (:mod:`kc2spice.fem.field_recovery`).

In the error of a stroke, positive and negative contributions may cancel by chance. To prevent an
underestimate, a second term is added to the error estimate of a stroke. On hexahedra, this term is
:data:`ABSOLUTE_SHARE` times the sum of the absolute contributions of the elements. On other
elements, this term is :data:`BOUND_SHARE` times the bound ``sqrt(A(e_p, e_p) A(e_v, e_v))``. The
factors of both terms were determined by comparison with much finer meshes.
``tests/physics/test_mesh_error.py`` checks that an estimate is at least half and at most twice the
true error.
"""

from __future__ import annotations

import numpy as np
from skfem.mesh import MeshHex

from kc2spice.bodies.enriched_model import correct_responses
from kc2spice.bodies.undamped_models import FiniteElementModel, UndampedResponses
from kc2spice.core.mesh_error import MESH_ERROR_PREFIX
from kc2spice.fem.field_recovery import compute_energy_products

# Share of the energy error that cubic functions correct.
# If the solution varies like r^a at the distance r from a singular edge, the energy error of
# functions of degree p is proportional to p^(-4 a).
# Cubic instead of quadratic functions then correct the share 1 - (2/3)^(4 a) of the error.
# The share is 0.56 at an electrode edge (a = 0.5), and 0.68 at a clamp (a = 0.7).
# On the meshes of tests/physics/test_mesh_error.py, the corrected share is 0.4 to 0.9.
CORRECTED_SHARE = 0.6
# Share of the error bound that is added to the error estimate of a stroke.
# If an energy product is below a tenth of the bound, the estimate without this share is half of the
# error.
BOUND_SHARE = 0.05
# Factor of the sum of absolute element contributions in the error estimate of a static response.
# In beams, the contributions of elements partly cancel: their signed sum is 0.3 of the error.
ABSOLUTE_SHARE = 1 / 3
MIN_CORRECTION_RATIO = 0.1  # smallest corrected value, relative to the uncorrected value
# Smallest relative mesh error that a model states.
# Smaller estimates are rounding errors, or are due to ports.
MIN_STATED_ERROR = 1e-4


def estimate_mesh_errors(
    device: FiniteElementModel, answers: UndampedResponses, sectors: int = 1
) -> dict[str, float]:
    """Estimate relative mesh errors of frequencies and static responses of a body.

    Return a mapping of names to relative errors. Each name is :data:`MESH_ERROR_PREFIX` followed by
    ``resonance``, ``modes``, ``capacitance``, ``stroke`` or ``compliance``. The error of ``modes``
    is the largest frequency error of all computed modes. The body consists of ``sectors`` equal
    solids, of which one is modelled.
    """
    volts = answers.static.shape[1]
    estimate = (
        _estimate_by_recovery if isinstance(device.solid.mesh, MeshHex) else _estimate_by_enrichment
    )
    frequencies, products = estimate(device, answers, sectors)
    changes = {}
    if frequencies.size:
        largest = frequencies[np.abs(frequencies).argmax()]
        changes = {"resonance": frequencies[0], "modes": largest}
    if volts:
        changes["capacitance"] = products[0, 0] / answers.facts["capacitance_free_f"]
    for name, stroke in answers.facts.items():
        if name.startswith("free_stroke_") and stroke:
            changes["stroke"] = products[0, -1] / stroke
    if not volts and answers.pushed.shape[1]:
        pushed = answers.pushed[:, 0]
        changes["compliance"] = products[-1, -1] / (pushed @ (device.model.K @ pushed))
    return {
        f"{MESH_ERROR_PREFIX}{name}": _convert_to_relative_error(change)
        for name, change in changes.items()
    }


def _estimate_by_enrichment(
    device: FiniteElementModel, answers: UndampedResponses, sectors: int
) -> tuple[np.ndarray, np.ndarray]:
    """Estimate errors of frequencies and static responses by cubic shape functions.

    Return two arrays. The first array, of shape (modes,), contains the relative frequency change of
    each mode. The second array, of shape (a, a), contains the energy product of the errors of each
    pair of static responses.
    """
    corrections = correct_responses(device, answers, sectors)
    products = corrections.products
    size = np.sqrt(np.abs(np.diag(products)))
    products = _add_in_quadrature(products, BOUND_SHARE * np.outer(size, size))
    return corrections.frequencies / CORRECTED_SHARE, products / CORRECTED_SHARE


def _estimate_by_recovery(
    device: FiniteElementModel, answers: UndampedResponses, sectors: int
) -> tuple[np.ndarray, np.ndarray]:
    """Estimate errors of frequencies and responses by recovered strains and fields.

    The returned quantities are the same as in :func:`_estimate_by_enrichment`.
    """
    n, volts = answers.modes.shape[1], answers.static.shape[1]
    z = np.hstack([answers.modes, answers.static, answers.pushed])
    voltages = np.zeros((volts, z.shape[1]))
    voltages[:, n : n + volts] = np.eye(volts)
    products = compute_energy_products(device.solid, *device.compute_nodal_values(z, voltages))
    energy, error = np.diag(products.solution), np.diag(products.error)
    static = products.error[n:, n:].copy()
    if volts:
        static[0] = _add_in_quadrature(static[0], ABSOLUTE_SHARE * products.spread[n, n:])
    return -0.5 * error[:n] / energy[:n], sectors * static


def _add_in_quadrature(values: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return the root of the sum of two squares, with the signs of ``values``."""
    return np.copysign(np.hypot(values, others), values)


def _convert_to_relative_error(change: float) -> float:
    """Convert a relative change to an error relative to the corrected value."""
    return float(max(abs(change) / max(1 + change, MIN_CORRECTION_RATIO), MIN_STATED_ERROR))
