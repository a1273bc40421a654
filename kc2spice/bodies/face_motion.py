"""Differences between the motion of a radiating face and of a piston.

The differences change the radiated sound. An acoustic port represents a face only by its volume
velocity. A face in an infinite baffle has the surface S and the normal velocity v. At the wave
number k, the pressure of the face in the far field is

    p = j omega rho / (2 pi r) exp(-j k r) F,     F(direction) = int v exp(j k x . direction) dS.

On the axis, F is the volume velocity for any distribution of v. In other directions, F depends on
the distribution of v. Therefore, the radiated power ``int |F|^2 dOmega`` also depends on the
distribution of v. A piston of radius a has ``F = 2 J1(x) / x int v dS`` with ``x = k a
sin(angle)``.

Without a baffle, the sound of the back of a thin disc cancels the sound of the front. The disc of
radius a then radiates as a dipole. At small k a, the field of the disc on the axis, relative to the
field in a baffle, is ``k / 2 int v g dS / int v dS``. The function ``g = (4 / pi) (a^2 - r^2)^1/2``
is the difference in velocity potential across a rigid disc that moves at a velocity of 1 (H. Lamb,
Hydrodynamics, 6th ed., section 102).

In a closed volume, the mean of v over the face compresses the fluid. The difference of v from its
mean is a sum of the volume's cross modes psi_n with the amplitudes v_n. The cross modes do not
propagate below their cut-off frequencies. In a cylinder of depth h with cross wave numbers kappa_n,
the near field of these modes has the mass

    sum_n rho |v_n|^2 coth(g_n h) / g_n <= rho coth(g_1 h) / g_1 int |v - mean|^2 dS,

with ``g_n^2 = kappa_n^2 - k^2``. In the formula of this mass, v is the normal velocity for a motion
of the body with unit amplitude.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.special import j0, j1

from kc2spice.bodies.undamped_models import FiniteElementModel

FACE_QUADRATURE = 5  # highest polynomial degree that is integrated exactly over a face
# Radius of a cylinder times its lowest cross wave number; the key True is for axisymmetric motions.
# This product of radius and wave number is the first positive zero of J1', or of J1 if
# axisymmetric.
CROSS_MODES = {False: 1.841183781340659, True: 3.831705970207512}
# Numbers of directions at which the far field in a half-space is sampled.
# At k a = 20, 30 polar angles would be sufficient.
POLAR_ANGLES, AZIMUTHS = 48, 32


@dataclass(frozen=True, eq=False)
class FaceMotion:
    """Normal displacement of a face at integration points, for several motions.

    Attributes
    ----------
    places : positions (d, points) [m] of the integration points; radius and height for a body of
        revolution.
    areas : area (points,) [m^2] that each integration point represents.
    normal : displacement (points, motions) along the outward normal.
    axis : unit vector (d,) of the face's mean outward normal.
    axisymmetric : whether the body is a body of revolution.
    """

    places: np.ndarray
    areas: np.ndarray
    normal: np.ndarray
    axis: np.ndarray
    axisymmetric: bool

    @property
    def area(self) -> float:
        """Area of the face [m^2]."""
        return float(self.areas.sum())

    @cached_property
    def displaced_volumes(self) -> np.ndarray:
        """Volume [m^3] that the face displaces in each motion, of shape (motions,)."""
        return np.asarray(self.areas @ self.normal)

    @property
    def piston_ratios(self) -> np.ndarray:
        """Ratio of mean to rms normal velocity of the face, for each motion.

        The returned array has the shape (motions,). For a piston, the ratio is 1.
        """
        rms = np.sqrt(self.areas @ np.abs(self.normal) ** 2 / self.area)
        return np.abs(self.displaced_volumes) / (self.area * np.where(rms > 0, rms, 1.0))

    @property
    def peak_ratios(self) -> np.ndarray:
        """Largest normal displacement of the face relative to the mean, for each motion.

        The returned array has the shape (motions,). For a piston, the ratio is 1.
        """
        mean = np.abs(self.displaced_volumes) / self.area
        return np.asarray(np.abs(self.normal).max(axis=0) / np.where(mean > 0, mean, np.inf))

    @cached_property
    def _in_plane_coordinates(self) -> np.ndarray:
        """In-plane coordinates of the integration points, relative to the face's centre.

        The returned array has the shape (2, points).
        """
        centre = self.places @ self.areas / self.area
        first = np.linalg.svd(self.axis[None])[2][1:]
        return np.asarray(first @ (self.places - centre[:, None]))

    def compute_far_field(self, wave_number: float, sines: np.ndarray) -> np.ndarray:
        """Return the far-field integral of the face's normal displacement over the face.

        The docstring of this module defines the integral as ``F``. The returned array has the shape
        (angles, azimuths, motions). ``sines`` are the sines of the angles between the directions
        and the face's axis.
        """
        if self.axisymmetric:
            kernel = j0(wave_number * np.outer(sines, self.places[0]))[:, None]
        else:
            turn = 2 * np.pi * np.arange(AZIMUTHS) / AZIMUTHS
            rows = np.stack([np.cos(turn), np.sin(turn)], axis=-1) @ self._in_plane_coordinates
            kernel = np.exp(1j * wave_number * sines[:, None, None] * rows)
        return np.asarray(kernel @ (self.areas[:, None] * self.normal))

    def compute_power_ratios(self, wave_number: float, radius: float) -> np.ndarray:
        """Return the radiated power of the face for each motion, relative to a piston.

        The piston has the ``radius`` [m] and the same volume velocity as the face. Face and piston
        are in an infinite baffle. The returned array has the shape (motions,).
        """
        cosines, weights = np.polynomial.legendre.leggauss(POLAR_ANGLES)
        cosines, weights = (cosines + 1) / 2, weights / 2
        sines = np.sqrt(1 - cosines**2)
        field = np.abs(self.compute_far_field(wave_number, sines)) ** 2
        power = weights @ field.mean(axis=1)
        x = wave_number * radius * sines
        piston = weights @ (2 * j1(x) / x) ** 2
        return np.asarray(power / (piston * self.displaced_volumes**2))

    def bound_near_field_masses(self, depth: float, wave_number: float) -> np.ndarray:
        """Return an upper bound of the mass that the near field adds to each motion.

        The fluid has the density 1 and fills a cylinder of the ``depth`` [m] in front of the face.
        If a cross mode of the cylinder propagates, the bound of the mass is infinite. The returned
        array has the shape (motions,).
        """
        radius = np.sqrt(self.area / np.pi)
        cross = (CROSS_MODES[self.axisymmetric] / radius) ** 2 - wave_number**2
        if cross <= 0:
            return np.full(self.normal.shape[1], np.inf)
        uneven = self.normal - self.displaced_volumes / self.area
        decay = np.sqrt(cross)
        return np.asarray(self.areas @ np.abs(uneven) ** 2 / (decay * np.tanh(decay * depth)))

    def compute_unbaffled_ratios(self, wave_number: float) -> np.ndarray:
        """Return the ratio of the far fields without and with a baffle, for each motion.

        The returned ratio is for the sound pressure on the axis of a thin body of revolution, for
        small k a. The docstring of this module contains the formula. The returned array has the
        shape (motions,).
        """
        square = self.area / np.pi - self.places[0] ** 2
        potential = 4 / np.pi * np.sqrt(np.maximum(square, 0.0))
        moment = (self.areas * potential) @ self.normal
        return np.asarray(wave_number / 2 * np.abs(moment / self.displaced_volumes))


def sample_face_motion(device: FiniteElementModel, facets: np.ndarray, z: np.ndarray) -> FaceMotion:
    """Return the normal displacement of a face in several motions of a body.

    ``facets`` are the numbers of the face's facets. ``z`` of shape (n, motions) contains the
    unknowns of the model for each motion.
    """
    solid = device.solid
    basis = solid.make_facet_basis(facets, FACE_QUADRATURE)
    places = np.asarray(basis.global_coordinates())
    around = 2 * np.pi * places[0] if solid.axisymmetric else 1.0
    normals = np.asarray(basis.normals)
    areas = basis.dx * around
    points = np.arange(areas.size).reshape(areas.shape)
    operator = sparse.csc_array((areas.size, solid.node_positions.shape[1]))
    for function, nodes in zip(basis.basis, basis.element_dofs, strict=True):
        values = np.broadcast_to(np.asarray(function[0]), areas.shape)
        columns = np.broadcast_to(nodes[:, None], areas.shape)
        entries = (values.ravel(), (points.ravel(), columns.ravel()))
        operator = operator + sparse.csc_array(sparse.coo_array(entries, shape=operator.shape))
    u = device.displacement @ z
    normal = np.zeros((areas.size, z.shape[1]))
    for axis, n in enumerate(normals):
        normal += n.reshape(-1, 1) * (operator @ u[axis :: solid.component_count])
    mean = normals.reshape(len(normals), -1) @ areas.ravel()
    size = np.linalg.norm(mean)
    return FaceMotion(
        places.reshape(len(places), -1),
        areas.ravel(),
        normal,
        mean / size if size else np.eye(len(mean))[-1],
        solid.axisymmetric,
    )
