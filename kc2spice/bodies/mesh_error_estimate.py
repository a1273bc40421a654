"""Estimates of the errors of frequencies and static responses due to the mesh.

``A(u, v)`` is the energy inner product of two fields u and v of displacements and potentials. Let
e_w be the error of a mode w, e_v the error of the static response to a voltage, and e_p the error
of the static response to a force. The errors of frequency, capacitance and stroke are energy inner
products of e_w, e_v and e_p:

    df/f = -A(e_w, e_w) / (2 A(w, w)),   dC = A(e_v, e_v),   d(stroke) = A(e_p, e_v).

On triangles, tetrahedra and quadrilaterals, each error e is estimated by the correction that cubic
shape functions yield (:mod:`kc2spice.bodies.enriched_model`). At edges of electrodes and supports,
the solution is singular and converges slowly as the polynomial degree rises. The cubic functions
therefore correct only the share :data:`CORRECTED_SHARE` of the error.

On hexahedra, the error e is estimated by the difference between recovered and computed strain and
electric field (:mod:`kc2spice.fem.field_recovery`). Recovery does not detect boundary layers that
are much shorter than an element, for example at a clamp. In meshes of long elements, the recovered
error can therefore be less than half of the true error. If a mesh has at most
:data:`MAX_CORRECTED_HEXAHEDRA` quadratic hexahedra, its errors are estimated both by recovery and
by cubic functions. Of the estimates by recovery and by cubic functions, the larger one is used. In
larger meshes, cubic functions would need too much memory.

In the error of a stroke, positive and negative contributions may cancel by chance. To prevent an
underestimate, a second term is added to the error estimate of a stroke. On hexahedra, the second
term is :data:`ABSOLUTE_SHARE` times the sum of the absolute values of all element contributions to
the recovered stroke error. On other elements, the second term is :data:`BOUND_SHARE` times the
bound ``sqrt(A(e_p, e_p) A(e_v, e_v))``. The factors :data:`ABSOLUTE_SHARE` and :data:`BOUND_SHARE`
were determined by comparison with much finer meshes. ``tests/physics/test_mesh_error.py`` checks
that an estimate is at least half and at most twice the true error.
"""

from __future__ import annotations

import numpy as np
from skfem.mesh import MeshHex

from kc2spice.bodies.enriched_model import correct_responses
from kc2spice.bodies.undamped_models import FiniteElementModel, UndampedResponses
from kc2spice.core.mesh_error_descriptions import MESH_ERROR_PREFIX
from kc2spice.fem.field_recovery import compute_energy_products

# Share of the energy error that cubic functions correct.
# Near a singular edge, the solution is proportional to r^a, where r is the distance to the edge.
# For elements of polynomial degree p, the energy error is then proportional to p^(-4 a).
# An error proportional to p^(-4 a) decreases by the share 1 - (2/3)^(4 a) if p rises from 2 to 3.
# At an electrode edge with the exponent a = 0.5, cubic functions correct 56 % of the energy error.
# At a clamp with the exponent a = 0.7, cubic functions correct 68 % of the energy error.
# On the meshes of tests/physics/test_mesh_error.py, cubic functions correct 0.4 to 0.9 of the
# energy error.
CORRECTED_SHARE = 0.6
# Share of the error bound that is added to the error estimate of a stroke.
# If an energy product is below a tenth of the bound, the estimate without this share is half of the
# error.
BOUND_SHARE = 0.05
# On hexahedra, ABSOLUTE_SHARE times the sum of the absolute element contributions to the error is
# added in quadrature to the error estimate of a static response.
# In beams, element contributions of both signs cancel: their sum is only 0.3 of the true error.
ABSOLUTE_SHARE = 1 / 3
# Largest number of hexahedra in a mesh whose errors are also estimated by cubic functions.
# Time to compute the correction, relative to the time to compute the model: 50 % for 480
# hexahedra, 70 % for 3840 hexahedra.
MAX_CORRECTED_HEXAHEDRA = 2000
MIN_CORRECTION_RATIO = 0.1  # smallest corrected value, relative to the uncorrected value
# Smallest relative mesh error that a model states.
# Estimates below MIN_STATED_ERROR are replaced by MIN_STATED_ERROR, because errors of this size
# consist of rounding errors or of errors of ports.
MIN_STATED_ERROR = 1e-4


def estimate_mesh_errors(
    device: FiniteElementModel, answers: UndampedResponses, sectors: int = 1
) -> dict[str, float]:
    """Estimate relative mesh errors of frequencies and static responses of a body.

    Return a dictionary with the relative errors of frequencies and static responses. The key of an
    error is :data:`MESH_ERROR_PREFIX` followed by ``resonance``, ``modes``, ``capacitance``,
    ``stroke`` or ``compliance``. The error of ``modes`` is the largest frequency error of all
    computed modes. The body consists of ``sectors`` equal solids, of which one is modelled.
    """
    volts = answers.static.shape[1]
    estimate = (
        _estimate_on_hexahedra
        if isinstance(device.solid.mesh, MeshHex)
        else _estimate_by_enrichment
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


def _estimate_on_hexahedra(
    device: FiniteElementModel, answers: UndampedResponses, sectors: int
) -> tuple[np.ndarray, np.ndarray]:
    """Estimate errors on hexahedra by recovery, and on small meshes also by cubic functions.

    The returned quantities are the same as in :func:`_estimate_by_enrichment`. On small meshes,
    each returned quantity is the larger one of both estimates.
    """
    recovered, solid = _estimate_by_recovery(device, answers, sectors), device.solid
    # elements with collapsed edges, and elements of degree 1, have no cubic functions
    plain = solid.order == 2 and solid.numbers is None
    if not plain or solid.mesh.nelements > MAX_CORRECTED_HEXAHEDRA:
        return recovered
    more = correct_responses(device, answers, sectors)
    frequencies, products = (
        np.where(np.abs(one) > np.abs(other) / CORRECTED_SHARE, one, other / CORRECTED_SHARE)
        for one, other in zip(recovered, (more.frequencies, more.products), strict=True)
    )
    return frequencies, products


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
