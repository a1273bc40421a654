"""Eddy currents in a conducting body of revolution between coaxial coils.

The body is divided into rings of rectangular section. If the skin depth is small, the rings below
the surfaces of the body are thin. The ring currents i and the coil currents j satisfy ``L di/dt + R
i = -d/dt (m j)``. The inductances L and the resistances R of the rings are constant. Only the
mutual inductances m between rings and coils depend on the height y of the body. The modes v satisfy
``R v = rate L v`` and ``v' L v = 1``. Each mode is equivalent to a current loop with the inductance
1 H and the resistance ``rate`` Ohm. The mutual inductances between this loop and the coils are ``v'
m(y)``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import product, starmap

import numpy as np
from numpy.polynomial import chebyshev

from kc2spice.core.equality import EqualByContent
from kc2spice.core.errors import wrong
from kc2spice.core.mesh_error_descriptions import MESH_ERROR_PREFIX
from kc2spice.core.quantities import MU_0

# number of heights (Chebyshev points) at which mutual inductances of coils and rings are computed
HEIGHT_NODES = 40
SELF_DIVISIONS = 24  # number of cells along the longer side of a coil, for its self-inductance
MUTUAL_DIVISIONS = 16  # number of Gauss points along the longer side, for mutual inductances
MIN_FILL = 0.02  # smallest conducting fraction of a section; rings below this fraction are omitted
# distance from the axis, in cell widths, below which a section is evaluated at four points
AXIS_CELLS = 4
# distances of the Gauss points from the centre of a section, divided by the section's side length
GAUSS_POINTS = (-0.5 / 3**0.5, 0.5 / 3**0.5)
# Two sections are distant if (distance / longest side of both sections) is at least FAR_RATIO.
# For distant sections, the distance between the centres replaces the mean distance.
FAR_RATIO = 40.0
DEFAULT_RINGS = 400  # default number of rings per body
# skin depth, divided by the thickness of the outermost layer of a body with DEFAULT_RINGS rings
LAYERS_PER_DEPTH = 3.0
LAYER_GROWTH = 1.35  # thickness of a layer, relative to the next layer towards the surface
# Largest number of rings in a sphere if DEFAULT_RINGS rings are requested.
# All cells of a sphere have equal sizes, whereas the surface layers of other bodies are thin.
# At a small skin depth, a sphere therefore needs more rings than other bodies.
MAX_SPHERE_RINGS = 1500
MAX_RINGS = 3000  # largest number of rings; each dense matrix then occupies 70 MB
# A model of current loops is compared with a finer division of the body into rings, at
# COMPARED_HEIGHTS heights and at COMPARED_HEIGHTS frequencies.
COMPARED_HEIGHTS = 5
SLOPE_STEP = 1e-4  # height step of finite differences, relative to the range of heights


def compute_mutual_inductance(
    r: np.ndarray, z: np.ndarray, other: np.ndarray, height: np.ndarray
) -> np.ndarray:
    """Compute the mutual inductance [H] of two coaxial circles.

    The circles have the radii ``r`` and ``other`` [m] and the axial positions ``z`` and ``height``
    [m]. Arrays of different shapes are broadcast. The mutual inductance is infinite if the circles
    coincide. Source: Maxwell, A Treatise on Electricity and Magnetism, art. 701.
    """
    from scipy.special import ellipe, ellipkm1

    apart = (z - height) ** 2
    across = (r + other) ** 2 + apart
    # For close circles, the elliptic integral K is accurate if it is computed from 1 - k^2
    k2, rest = 4 * r * other / across, ((r - other) ** 2 + apart) / across
    result = (1 - k2 / 2) * ellipkm1(rest) - ellipe(k2)
    return np.asarray(MU_0 * np.sqrt(across) * result)


@dataclass(frozen=True, eq=False)
class RingCells:
    """Coaxial current-carrying rings with rectangular sections.

    The sections have the width ``wide`` [m] and the height ``tall`` [m]. ``r``, ``z``, ``wide``,
    ``tall`` and ``filled`` are arrays of shape (n,). The centres of the sections are at the radii
    ``r`` [m] and the axial positions ``z`` [m]. ``filled`` contains the fraction of each section
    that carries current.
    """

    r: np.ndarray
    z: np.ndarray
    wide: np.ndarray
    tall: np.ndarray
    filled: np.ndarray

    @cached_property
    def inductance(self) -> np.ndarray:
        """Self- and mutual inductances (n, n) [H] for a uniform current in each section.

        In the formula for two circles, the logarithm is replaced by its mean over both sections (J.
        C. Maxwell, Trans. R. Soc. Edinburgh 26 (1872) 729). The part of the formula without the
        logarithm is evaluated for circles through the centres of both sections. For sections near
        the axis, the part without the logarithm is less smooth, so it is averaged over four points
        of each section.
        """
        r, z = self.r, self.z
        logs = self._mean_log_distances
        result, near = _compute_section_mutuals(r, z, r, z, logs), r < AXIS_CELLS * self.wide
        steps = [(i * self.wide, j * self.tall) for i, j in product(GAUSS_POINTS, GAUSS_POINTS)]
        part = np.zeros((np.count_nonzero(near), r.size))
        for (u, v), (s, t) in product(steps, steps):
            ends = r[near] + u[near], z[near] + v[near], r + s, z + t
            part += _compute_section_mutuals(*ends, logs[near]) / len(steps) ** 2
        result[near], result[:, near] = part, part.T
        return result

    @cached_property
    def _mean_log_distances(self) -> np.ndarray:
        """Mean logarithm of the distance [m] between the points of any two sections.

        The array of shape (n, n) contains all pairs of n sections.
        """
        x, y = np.subtract.outer(self.r, self.r), np.subtract.outer(self.z, self.z)
        result = np.hypot(x, y)
        longest = np.maximum(self.wide, self.tall)
        near = result < FAR_RATIO * np.maximum.outer(longest, longest)
        result[~near] = np.log(result[~near])
        a, b = np.nonzero(np.triu(near))
        sides = self.wide[a], self.wide[b], self.tall[a], self.tall[b]
        result[a, b] = result[b, a] = _compute_mean_log_distance(x[a, b], y[a, b], *sides)
        return result

    @cached_property
    def resistance(self) -> np.ndarray:
        """Resistance [Ohm] of each ring for a conductivity of 1 S/m."""
        return 2 * np.pi * self.r / (self.wide * self.tall * self.filled)


def _compute_section_mutuals(
    r: np.ndarray, z: np.ndarray, other: np.ndarray, height: np.ndarray, logs: np.ndarray
) -> np.ndarray:
    """Compute the mutual inductances [H] of rings with rectangular sections.

    Each of n rings is coupled to each of m rings. The mutual inductances of circles are corrected
    for the size of the sections. ``logs`` contains the mean logarithms of the distance between
    points of two sections. Both ``logs`` and the returned array have the shape (n, m).
    """
    r, z = r[:, None], z[:, None]
    same = (r == other) & (z == height)
    distance = np.where(same, 1.0, np.hypot(r - other, z - height))
    with np.errstate(divide="ignore", invalid="ignore"):
        between = np.where(
            same, MU_0 * r * (np.log(8 * r) - 2), compute_mutual_inductance(r, z, other, height)
        )
    return np.asarray(between + MU_0 * np.sqrt(r * other) * (np.log(distance) - logs))


def _compute_mean_log_distance(
    x: np.ndarray, y: np.ndarray, a: np.ndarray, c: np.ndarray, b: np.ndarray, d: np.ndarray
) -> np.ndarray:
    """Compute the mean logarithm of the distances between points of two rectangles.

    Along x and y, the first rectangle has the sides ``a`` and ``b``, and the second rectangle the
    sides ``c`` and ``d``. The distance between their centres is ``x`` along x and ``y`` along y.
    The mean is computed from fourth differences of the fourfold integral of ``ln(x^2 + y^2) / 2``.
    """
    result = np.zeros_like(x)
    ends = ((1, 1, 1), (-1, -1, 1), (1, -1, -1), (-1, 1, -1))
    for (i, j, p), (k, m, q) in product(ends, ends):
        u, v = np.abs(x + (i * a + j * c) / 2) + 1e-30, np.abs(y + (k * b + m * d) / 2) + 1e-30
        angles = u**3 * v * np.arctan2(v, u) + u * v**3 * np.arctan2(u, v)
        logs = (u**2 * v**2 / 4 - (u**4 + v**4) / 24) * np.log(u**2 + v**2)
        result += p * q * (logs + angles / 3 - 25 / 24 * u**2 * v**2)
    return result / (2 * a * b * c * d)


def divide_section(
    inner: float,
    outer: float,
    low: float,
    high: float,
    count: int,
    inside: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None,
    depth: float = np.inf,
) -> RingCells:
    """Divide a rectangular section into an approximate number of nearly square cells.

    The number of cells is about ``count``. The cells below the surfaces are thinner if the other
    cells are not small compared with the skin ``depth`` [m]. Current flows only where ``inside(r,
    z)`` is true.
    """
    wide, tall = outer - inner, high - low
    thinnest = depth / LAYERS_PER_DEPTH * np.sqrt(DEFAULT_RINGS / count)
    if inside is not None:
        most = min(MAX_SPHERE_RINGS * count / DEFAULT_RINGS, MAX_RINGS)
        count, thinnest = int(max(count, min(most, wide * tall / thinnest**2))), np.inf
    side = np.sqrt(wide * tall / count)
    # _divide_length makes at least three cells to resolve the skin effect across the shortest side
    across = inner + _divide_length(wide, side, thinnest, 2 if inner else 1)
    along = low + _divide_length(tall, side, thinnest, 2)
    r, z = _make_grid_points(_compute_midpoints(across), _compute_midpoints(along))
    a, b = _make_grid_points(np.diff(across), np.diff(along))
    if inside is None:
        return RingCells(r, z, a, b, np.ones(r.size))
    offsets = (np.arange(16) + 0.5) / 16 - 0.5
    u, v = _make_grid_points(offsets * a[0], offsets * b[0])
    filled = inside(r[:, None] + u, z[:, None] + v).mean(axis=1)
    present = filled > MIN_FILL
    return RingCells(r[present], z[present], a[present], b[present], filled[present])


def _make_grid_points(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the coordinates (2, n) of all points of a rectangular grid."""
    return np.reshape(np.meshgrid(x, y), (2, -1))


def _compute_midpoints(edges: np.ndarray) -> np.ndarray:
    """Return the midpoints between neighbouring edges of cells."""
    return np.asarray((edges[1:] + edges[:-1]) / 2)


def _divide_length(length: float, side: float, thinnest: float, surfaces: int) -> np.ndarray:
    """Divide a length into cells of similar size, with thin layers below surfaces.

    The positions of the edges of cells and layers are returned. Layers are added only if the cells
    are thicker than ``thinnest``, which is the thickness of the outermost layer. Each layer is
    thicker than the next layer outwards. If ``surfaces`` is 1, the layers are at the upper end; if
    ``surfaces`` is 2, the layers are at both ends.
    """
    count = max(3, round(length / side))
    if thinnest >= length / count:
        return np.linspace(0.0, length, count + 1)
    layers, room = [thinnest], length / surfaces
    while layers[-1] * LAYER_GROWTH < side and sum(layers) + layers[-1] * LAYER_GROWTH < room:
        layers.append(layers[-1] * LAYER_GROWTH)
    left = length - surfaces * sum(layers)
    inner = np.full(max(1, int(np.ceil(left / min(side, layers[-1] * LAYER_GROWTH)))), left)
    sizes = [*(layers if surfaces == 2 else ()), *(inner / inner.size), *layers[::-1]]
    edges = np.concatenate([[0.0], np.cumsum(sizes)])
    return np.asarray(edges * length / edges[-1])


@dataclass(frozen=True)
class Winding:
    """Coaxial winding with uniformly distributed turns in a rectangular section.

    The centre of the section is at ``radius`` [m] and the axial position ``y`` [m]. The section has
    the dimensions ``width`` and ``height`` [m].
    """

    radius: float
    width: float
    height: float
    y: float
    turns: float

    @cached_property
    def cells(self) -> RingCells:
        """Cells into which the section of the winding is divided."""
        half, longest = (self.width / 2, self.height / 2), max(self.width, self.height)
        parts = [
            max(2, round(SELF_DIVISIONS * side / longest)) for side in (self.width, self.height)
        ]
        r = self.radius - half[0] + self.width * (np.arange(parts[0]) + 0.5) / parts[0]
        z = self.y - half[1] + self.height * (np.arange(parts[1]) + 0.5) / parts[1]
        r, z = _make_grid_points(r, z)
        even = np.ones_like(r)
        return RingCells(r, z, self.width / parts[0] * even, self.height / parts[1] * even, even)

    def couple_circles(self, r: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Compute mutual inductances [H] between the winding and coaxial circles.

        The circles have the radii ``r`` [m] and the axial positions ``z`` [m].
        """
        sides = np.array([self.width, self.height])
        counts = np.maximum(3, np.round(MUTUAL_DIVISIONS * sides / sides.max())).astype(int)
        (x, p), (y, q) = map(np.polynomial.legendre.leggauss, counts)
        at, height = self.radius + self.width / 2 * x, self.y + self.height / 2 * y
        result = compute_mutual_inductance(
            r[..., None, None], z[..., None, None], at[:, None], height
        )
        return np.asarray(self.turns * np.einsum("...ij,i,j->...", result, p / 2, q / 2))

    def couple_sheet(self, sheet: Winding, heights: np.ndarray) -> np.ndarray:
        """Compute mutual inductances [H] between the winding and a sheet at n heights.

        The current sheet is a winding of zero width. For each mutual inductance, the sheet is moved
        up by one of the ``heights`` (n,) [m]. The integral along the height of the sheet is
        computed at Gauss points.
        """
        x, p = np.polynomial.legendre.leggauss(MUTUAL_DIVISIONS)
        z = heights[:, None] + sheet.y + sheet.height / 2 * x
        return np.asarray(
            sheet.turns * self.couple_circles(np.full_like(z, sheet.radius), z) @ p / 2
        )

    def compute_coupling_inductance(self, other: Winding) -> float:
        """Compute the mutual inductance [H] between this winding and another winding.

        If ``other`` equals this winding, the result is the self-inductance. Source for the
        self-inductance of a winding of zero width: L. Lorenz, Ann. Phys. 7 (1879) 161.
        """
        if other == self and not self.width:
            from scipy.special import ellipe, ellipkm1

            k2 = 4 * self.radius**2 / (4 * self.radius**2 + self.height**2)
            shape = (2 * k2 - 1) * ellipe(k2) + (1 - k2) * ellipkm1(1 - k2)
            scale = 8 * MU_0 * self.radius**3 / (3 * self.height**2)
            return float(self.turns**2 * scale * (shape / k2**1.5 - 1))
        if other == self:
            return float(self.turns**2 * self.cells.inductance.mean())
        return float(other.turns * self.couple_circles(other.cells.r, other.cells.z).mean())


@dataclass(frozen=True, eq=False)
class LoopModel(EqualByContent):
    """Model of a conducting body: k current loops that are coupled to c coils.

    Each loop has the inductance 1 H. ``rates`` (k,) [Ohm] contains the resistances of the loops for
    a conductivity of 1 S/m. ``inductance`` (c, c) [H] is the inductance matrix of the coils.

    ``couplings`` (c, k, degree + 1) contains polynomial coefficients, lowest power first, of the
    mutual inductances between coils and loops. The polynomials are functions of ``2 (y - low) /
    (high - low) - 1``. With magnets, the shape is (c + 1, k, degree + 1), and the last row is the
    magnet flux in the loops.

    ``error`` estimates the error due to the small number of loops. The error is the effect of all
    omitted loops on flux and force up to ``frequency`` [Hz], relative to the largest flux and
    force. ``rings`` is the number of rings of the body. ``ring_error`` estimates the error of flux,
    force and loss due to the division into rings.
    """

    rates: np.ndarray
    couplings: np.ndarray
    inductance: np.ndarray
    low: float
    high: float
    error: float
    rings: int
    frequency: float = 0.0
    ring_error: float = 0.0

    @property
    def facts(self) -> dict[str, float]:
        """Facts of the loop model: counts and error estimates of its rings and loops."""
        if not self.rates.size:
            return {}
        known = {"rings": float(self.rings), "loops": float(self.rates.size)}
        return known | {f"{MESH_ERROR_PREFIX}rings": self.ring_error, "loop_error": self.error}

    def compute_eddy_current_effect(
        self, heights: np.ndarray, s: complex, conductivity: float
    ) -> EddyCurrentEffect:
        """Compute the effect of the body's eddy currents on the fluxes of the coils.

        ``heights`` [m] contains the positions of the body along the common axis, for which the
        effect is computed. ``s`` [1/s] is the Laplace variable, and ``conductivity`` [S/m] is the
        conductivity of the body.
        """
        x = (2 * heights - self.low - self.high) / (self.high - self.low)
        powers = x[:, None] ** np.arange(self.couplings.shape[2])
        slopes = np.arange(1, self.couplings.shape[2]) * self.couplings[:, :, 1:]
        m = np.einsum("ckd,yd->cyk", self.couplings, powers)
        slope = np.einsum("ckd,yd->cyk", slopes, powers[:, :-1]) * 2 / (self.high - self.low)
        share = s * conductivity / (self.rates + s * conductivity)
        form = "iyk,jyk,k->ijy"
        return EddyCurrentEffect(np.einsum(form, m, m, share), np.einsum(form, slope, m, share))


@dataclass(frozen=True, eq=False)
class EddyCurrentEffect(EqualByContent):
    """Effect of a conducting body's eddy currents on the fluxes of coils.

    The last axis of both arrays is the height of the body. ``flux`` (c, c, heights) [H] is the
    reduction of the flux in the first coil for each ampere in the second coil. ``slope`` (c, c,
    heights) [H/m] is the derivative of ``flux`` with respect to the height of the body for constant
    currents in the body.
    """

    flux: np.ndarray
    slope: np.ndarray

    def find_largest_difference(self, exact: EddyCurrentEffect) -> float:
        """Return the largest relative difference of flux, slope or loss from a reference.

        ``exact`` is the reference.
        """
        pairs = [(self.flux, exact.flux), (self.slope, exact.slope)]
        coils = np.arange(len(self.flux))
        pairs.append((self.flux[coils, coils].imag, exact.flux[coils, coils].imag))
        return max(float((np.abs(a - b).max(-1) / np.abs(b).max(-1)).max()) for a, b in pairs)


def compare_loops_with_rings(
    body: RingCells,
    ladder: LoopModel,
    coils: Sequence[Winding],
    magnets: Sequence[Winding],
    conductivity: float,
) -> float:
    """Compare current loops with all rings of a body; return the largest error.

    The ring currents are computed without modes, at several heights and at frequencies up to the
    largest frequency of the loop model. :meth:`EddyCurrentEffect.find_largest_difference` defines
    the relative difference.
    """
    half, middle = (ladder.high - ladder.low) / 2, (ladder.high + ladder.low) / 2
    heights = middle + half * chebyshev.chebpts1(COMPARED_HEIGHTS)
    step, worst = 2 * SLOPE_STEP * half, 0.0

    couplings = partial(_compute_couplings, body, coils, magnets)
    m = couplings(heights)
    slope = (couplings(heights + step) - couplings(heights - step)) / (2 * step)
    for speed in 2 * np.pi * ladder.frequency * np.geomspace(0.01, 1, COMPARED_HEIGHTS):
        impedance = body.inductance + np.diag(body.resistance / (1j * speed * conductivity))
        currents = np.linalg.solve(impedance, m.reshape(-1, body.r.size).T).T.reshape(m.shape)
        form = "iyn,jyn->ijy"
        exact = EddyCurrentEffect(np.einsum(form, m, currents), np.einsum(form, slope, currents))
        worst = max(
            worst,
            ladder.compute_eddy_current_effect(
                heights, 1j * speed, conductivity
            ).find_largest_difference(exact),
        )
    return worst


def _compute_couplings(
    body: RingCells, coils: Sequence[Winding], magnets: Sequence[Winding], heights: np.ndarray
) -> np.ndarray:
    """Compute the mutual inductances [H] between coils and rings.

    ``heights`` [m] are the positions of the body along the common axis. The returned array has the
    shape (c, heights, n). If there are magnets, the sum of the mutual inductances between magnets
    and rings is appended as a last row.
    """
    at = body.r, body.z + heights[:, None]
    m = [coil.couple_circles(*at) for coil in coils]
    if magnets:
        m.append(sum((magnet.couple_circles(*at) for magnet in magnets), np.zeros_like(at[1])))
    return np.array(m)


def reduce_to_loops(
    body: RingCells,
    coils: Sequence[Winding],
    magnets: Sequence[Winding],
    low: float,
    high: float,
    conductivity: float,
    frequency: float,
    tolerance: float,
) -> LoopModel:
    """Reduce a body of many conducting rings to a few current loops.

    The loops are valid for axial positions of the body from ``low`` to ``high`` [m], and for
    frequencies up to ``frequency`` [Hz]. The number of loops is the smallest number that satisfies
    the ``tolerance``. The loops are modes in a subspace of the body's currents. The subspace
    contains the currents that coils and magnets cause at several heights and frequencies. A magnet
    is represented by a winding with a current of 1 A. The ``turns`` of this winding equal the
    magnet's surface current in ampere. The coupling of a magnet to a loop is a flux [Wb].

    Raises
    ------
    UsageError : the mutual inductances between coils and loops are not smooth functions of the
        height, for example because body and coil touch.
    """
    nodes, heights = _list_chebyshev_heights(low, high)
    inductance = _compute_coil_inductance(coils)
    m = _compute_couplings(body, coils, magnets, heights)
    from scipy.linalg import eigh

    rates, modes = eigh(np.diag(body.resistance), body.inductance)
    couplings = m @ modes
    couplings /= np.linalg.norm(couplings, axis=2).max(axis=1)[:, None, None]
    speeds = 2 * np.pi * frequency * conductivity * np.geomspace(1e-3, 1, 13)
    basis, error = _compute_current_basis(rates, couplings, speeds, nodes, tolerance)
    reduced, turn = np.linalg.eigh(basis.T * rates @ basis)
    result = m @ modes @ basis @ turn
    polynomials = _fit_power_series(nodes, result, tolerance)
    return LoopModel(reduced, polynomials, inductance, low, high, error, body.r.size, frequency)


def make_current_loop(
    sheets: Sequence[Winding],
    coils: Sequence[Winding],
    magnets: Sequence[Winding],
    low: float,
    high: float,
    tolerance: float,
) -> LoopModel:
    """Make the model of one current loop from the current sheets that form the loop.

    The current distribution consists of the current ``sheets`` and forms one loop.
    :func:`reduce_to_loops` describes the other arguments.

    Raises
    ------
    UsageError : the mutual inductances between coils and loop are not smooth functions of the
        height, for example because body and coil touch.
    """
    nodes, heights = _list_chebyshev_heights(low, high)

    def compute_flux_linkage(windings: Sequence[Winding]) -> np.ndarray:
        """Return the flux linkage between all current sheets and windings at each height."""
        return sum(
            starmap(Winding.couple_sheet, product(windings, sheets, (heights,))),
            np.zeros(HEIGHT_NODES),
        )

    m = [compute_flux_linkage([coil]) for coil in coils]
    if magnets:
        m.append(compute_flux_linkage(magnets))
    polynomials = _fit_power_series(nodes, np.array(m)[:, :, None], tolerance)
    return LoopModel(np.empty(0), polynomials, _compute_coil_inductance(coils), low, high, 0.0, 0)


def _list_chebyshev_heights(low: float, high: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the Chebyshev points between -1 and 1, and the corresponding heights [m]."""
    nodes = chebyshev.chebpts1(HEIGHT_NODES)
    return nodes, low + (nodes + 1) * (high - low) / 2


def _compute_coil_inductance(coils: Sequence[Winding]) -> np.ndarray:
    """Compute the inductance matrix [H] of the coils."""
    return np.array([list(map(a.compute_coupling_inductance, coils)) for a in coils])


def _compute_current_basis(
    rates: np.ndarray, mutual: np.ndarray, speeds: np.ndarray, nodes: np.ndarray, tolerance: float
) -> tuple[np.ndarray, float]:
    """Compute an orthonormal basis of the body's currents, and the basis error.

    ``speeds`` contains angular frequencies [rad/s]. The returned error is the largest relative
    error of flux and force at any angular frequency in ``speeds``. The basis is computed from the
    currents that coils with the couplings ``mutual`` (c, heights, n) cause at the angular
    frequencies ``speeds[::2]``.
    """

    def compute_currents(speeds: np.ndarray, couplings: np.ndarray) -> np.ndarray:
        """Compute the current amplitude of each eddy-current mode at several frequencies."""
        return couplings[:, :, None, :] * (1j * speeds / (rates[:, None] + 1j * speeds)).T

    sampled = compute_currents(speeds[::2], mutual[:, ::3]).reshape(-1, rates.size)
    left, _, _ = np.linalg.svd(np.concatenate([sampled.real, sampled.imag]).T, full_matrices=False)
    slopes = chebyshev.chebval(nodes, chebyshev.chebder(_fit_chebyshev(nodes, mutual))).transpose(
        0, 2, 1
    )

    def compute_flux_and_force(
        rate: np.ndarray, at: np.ndarray, slope: np.ndarray
    ) -> list[np.ndarray]:
        """Return the frequency responses of flux and force due to the body's currents."""
        share = 1j * speeds / (rate[:, None] + 1j * speeds)
        return [np.einsum("iyn,jyn,nf->ijyf", at, other, share) for other in (at, slope)]

    exact = compute_flux_and_force(rates, mutual, slopes)
    error = np.inf
    for count in range(1, left.shape[1] + 1):
        basis = left[:, :count]
        reduced, turn = np.linalg.eigh(basis.T * rates @ basis)
        part = compute_flux_and_force(reduced, mutual @ basis @ turn, slopes @ basis @ turn)
        error = max(np.abs(a - b).max() / np.abs(a).max() for a, b in zip(exact, part, strict=True))
        if error < tolerance:
            break
    return basis, float(error)


def _fit_chebyshev(nodes: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Compute the Chebyshev coefficients of functions from values at Chebyshev points.

    The returned coefficients have the shape (points, coils, loops), and ``values`` has the shape
    (coils, points, loops).
    """
    count, _, k = values.shape
    table = values.transpose(1, 0, 2).reshape(nodes.size, -1)
    result = chebyshev.chebvander(nodes, nodes.size - 1).T @ table * (2 / nodes.size)
    result[0] /= 2
    return result.reshape(nodes.size, count, k)


def _fit_power_series(nodes: np.ndarray, values: np.ndarray, tolerance: float) -> np.ndarray:
    """Fit polynomials to values at Chebyshev points; return coefficients of powers.

    ``values`` (coils, points, loops) contains mutual inductances at Chebyshev points. The returned
    coefficients have the shape (coils, loops, degree + 1). The degree is the smallest degree for
    which the relative error of the slopes is below ``tolerance / 10`` for each coil.
    """
    c = _fit_chebyshev(nodes, values)
    # the largest slope of the Chebyshev polynomial of degree n on the interval from -1 to 1 is n^2
    order = np.arange(nodes.size)[:, None, None] ** 2
    size = np.abs(chebyshev.chebval(nodes, chebyshev.chebder(c))).max(axis=(1, 2))
    tails = np.cumsum((order * np.abs(c))[::-1], axis=0)[::-1].max(axis=2) / size
    degree = next(
        (n for n in range(2, nodes.size) if tails[n + 1 :].max(initial=0.0) < tolerance / 10), 0
    )
    if not 0 < degree < 3 * nodes.size // 4:
        error = tails[3 * nodes.size // 4].max()
        raise wrong(
            None,
            "no polynomial represents the magnetic coupling, which changes too fast with the "
            "height of the moving body",
            got=f"a polynomial whose slope has a relative error of {error:.1g}",
            expected=f"a polynomial whose slope has a relative error below {tolerance / 10:g}",
            hint=(
                f"raise the key `tolerance`, now {tolerance:g}, or choose `y_min` and `y_max` "
                "further from the windings"
            ),
        )
    flat = c[: degree + 1].reshape(degree + 1, -1)
    series = list(map(chebyshev.cheb2poly, flat.T))
    powers = np.array([np.pad(item, (0, degree + 1 - item.size)) for item in series])
    return powers.reshape(*values.shape[::2], degree + 1)
