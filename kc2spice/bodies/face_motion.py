"""Differences between the motion of a radiating face and of a piston.

A face does not move exactly like a piston, and the difference in motion changes the radiated sound.
An acoustic port represents a face only by its volume velocity. A face in an infinite baffle has the
surface S and the normal velocity v. At the wave number k, the pressure of the face in the far field
is

    p = j omega rho / (2 pi r) exp(-j k r) F,     F(direction) = int v exp(j k x . direction) dS.

On the axis, F is the volume velocity for any distribution of v. In directions off the axis, the
integral F depends on the distribution of the normal velocity v over the face. Therefore, the
radiated power ``int |F|^2 dOmega`` also depends on the distribution of v. A piston of radius a has
``F = 2 J1(x) / x int v dS`` with ``x = k a sin(angle)``.

Without a baffle, the sound of the back of a thin plate cancels the sound of the front. The plate
then radiates as a dipole. At small k a, removal of the baffle multiplies the on-axis pressure
magnitude of the plate by ``(k / 2) int v g dS / int v dS``, with the normal velocity v and the
velocity-potential difference g at unit velocity. The function g is the difference in velocity
potential between front and back of a rigid plate, divided by the velocity of the plate. For an
ellipse with the half-axes a and b,

    g = 2 b sqrt(1 - x^2 / a^2 - y^2 / b^2) / E(m),     m = 1 - b^2 / a^2,

with the complete elliptic integral E(m) of the second kind, which is pi / 2 for a disc (H. Lamb,
Hydrodynamics, 6th ed., sections 102 and 108). For a long strip, g is ``2 sqrt(b^2 - y^2)``. For a
rectangular plate with the sides 2 a and 2 b, the velocity-potential difference g is approximately
``2 sqrt(b^2 - y^2) / E(m)``. The mean g of this approximation is 4 % to 10 % too large for a
rectangular plate.

The back of a thick body can move otherwise than its front. The whole surface of a body, with the
outward normal velocity v_s, displaces the volume velocity ``Q_s = int v_s dS``. At low frequencies,
the field without a baffle is the sum of the fields of a monopole and a dipole, whose phases differ
by 90 degrees. The strength of the monopole is the volume velocity Q_s. The strength D of the dipole
is the sum of ``int z v_s dS`` and ``(1 - Q_s / (2 Q)) int v g dS``, where z is the coordinate along
the axis of the face. Let ``Q = int v dS`` be the volume velocity of the face. At the wave number k,
removal of the baffle multiplies the magnitude of the pressure by ``|Q_s + j k D| / (2 |Q|)``. A
rigid body has ``Q_s = 0``. If only the face moves, ``Q_s = Q``, and removal of the baffle lowers
the pressure at low frequencies by 6 dB.

In a closed volume, the mean of v over the face compresses the fluid. The difference of v from its
mean is a sum of the volume's cross modes psi_n with the amplitudes v_n. The cross modes do not
propagate below their cut-off frequencies. In a cylinder of depth h, the near field of the cross
modes has the mass

    sum_n rho |v_n|^2 coth(g_n h) / g_n <= rho coth(g_1 h) / g_1 int |v - mean|^2 dS,

where ``g_n^2 = kappa_n^2 - k^2``, kappa_n is the wave number of cross mode n over the
cross-section, and k is the wave number of sound. In the formula of this mass, v is the normal
velocity for a motion of the body with unit amplitude.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.special import ellipe, j0, j1

from kc2spice.bodies.undamped_models import FiniteElementModel

FACE_QUADRATURE = 5  # highest polynomial degree that is integrated exactly over a face
# Radius of a cylinder times the lowest wave number of its cross modes.
# For axisymmetric motions, the key is True, and the value is the first positive zero of the Bessel
# function J1.
# For all other motions, the key is False, and the value is the first positive zero of the
# derivative J1'.
CROSS_MODES = {False: 1.841183781340659, True: 3.831705970207512}
# Numbers of directions at which the far field in a half-space is sampled.
# 30 polar angles are sufficient if the wave number times the radius of the face is 20.
POLAR_ANGLES, AZIMUTHS = 48, 32
# A face counts as a rectangle if it fills more than this share of its smallest bounding rectangle.
# A face that fills at most MIN_RECTANGLE_SHARE of its bounding rectangle counts as an ellipse.
# An exact ellipse fills pi / 4 = 0.79 of its bounding rectangle.
# The bounding rectangle contains the integration points of the face.
MIN_RECTANGLE_SHARE = 0.9
BOX_ANGLES = 90  # number of angles in a quarter turn among which the smallest rectangle is searched


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

    def select_motions(self, select: np.ndarray) -> FaceMotion:
        """Return the face with only the selected motions."""
        return replace(self, normal=self.normal[:, select])

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

    def compute_velocity_potential_differences(self) -> np.ndarray:
        """Compute the velocity-potential differences [m] across a plate at unit velocity.

        The rigid plate has the shape of the face, and moves at a velocity of 1. The docstring of
        this module contains the formulas. The returned array has the shape (points,).
        """
        if self.axisymmetric:
            square = self.area / np.pi - self.places[0] ** 2
            return np.asarray(4 / np.pi * np.sqrt(np.maximum(square, 0.0)))
        boxes = []
        for angle in np.arange(BOX_ANGLES) * np.pi / (2 * BOX_ANGLES):
            cosine, sine = np.cos(angle), np.sin(angle)
            x = np.array([[cosine, sine], [-sine, cosine]]) @ self._in_plane_coordinates
            boxes.append(x - (x.max(axis=1) + x.min(axis=1))[:, None] / 2)
        x = min(boxes, key=lambda box: np.prod(box.max(axis=1)))
        x = x[np.argsort(-x.max(axis=1))]
        a, b = x.max(axis=1)
        share = self.area / (4 * a * b)
        rectangular = share > MIN_RECTANGLE_SHARE
        # The integration points do not reach the face's edge. Therefore, a and b are scaled so that
        # a rectangle or ellipse with these half-axes has the face's area.
        factor = np.sqrt(share if rectangular else 4 * share / np.pi)
        a, b = factor * a, factor * b
        square = 1 - (x[1] / b) ** 2 - (0.0 if rectangular else (x[0] / a) ** 2)
        return np.asarray(2 * b / ellipe(1 - (b / a) ** 2) * np.sqrt(np.maximum(square, 0.0)))

    def compute_unbaffled_ratios(
        self, wave_number: float, surface: FaceMotion | None = None
    ) -> np.ndarray:
        """Compute the ratio of the far fields without and with a baffle, for each motion.

        The returned ratio is for the sound pressure on the axis of the face, for small k a. The
        docstring of this module contains the formula. ``surface`` contains the displacement of the
        whole surface of the body for each motion; without ``surface``, the body is a thin plate.
        The returned array has the shape (motions,).
        """
        face_volume, volume = self.displaced_volumes, np.zeros(self.normal.shape[1])
        moment = (self.areas * self.compute_velocity_potential_differences()) @ self.normal
        if surface is not None:
            volume = surface.displaced_volumes
            height = self.axis @ surface.places
            height -= surface.areas @ height / surface.area
            moment = (1 - volume / (2 * face_volume)) * moment
            moment += (surface.areas * height) @ surface.normal
        return np.asarray(np.hypot(volume, wave_number * moment) / (2 * np.abs(face_volume)))


def sample_face_motion(device: FiniteElementModel, facets: np.ndarray, z: np.ndarray) -> FaceMotion:
    """Return the normal displacement of a face in several motions of a body.

    ``facets`` contains the mesh indices of the facets that form the face. ``z`` of shape (n,
    motions) contains the unknowns of the model for each motion.
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
