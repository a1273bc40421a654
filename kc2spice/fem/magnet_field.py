"""Force, flux and inductance of the electromagnetic catch.

Force, flux and inductance depend on the height y of the sphere. The axisymmetric magnetostatic
field is computed with scikit-fem. The unknown is ``a = A_phi / r``, where A_phi is the vector
potential. Since the unknown ``a`` is a smooth and even function of r, no boundary condition is
necessary on the axis. The magnetic field is ``B_y = b(a)``, ``B_r = -r da/dy`` with ``b(a) = 2 a +
r da/dr``. The potential energy is ::

    P(a) = 1/2 int nu (B_r^2 + B_y^2) dV - int nu B_rem b(a) dV - int J r a dV,   dV = 2 pi r dr dy

where nu is the reluctivity, B_rem the remanence and J the current density. The solution minimises P
with ``a = 0`` on the surface of the air cylinder (Schütz, Maeter and Bechtold, Actuators 10 (2021)
279, section 2.2.1). The force on the sphere is ``-dP/dy``. In this derivative, each point of the
air around the sphere moves by g dy. The weight g decreases from 1 on the sphere to 0 on the outline
of the *mover*. The force from this derivative equals the force from the Maxwell stress, averaged
over a thick shell. Henrotte, Deliege and Hameyer call the average over a shell the eggshell
approach (COMPEL 23(4), 2004).

The materials are linear, so the field at each height is a superposition of four fields. The sources
of these fields are the ring magnet, the sphere magnet, and the currents in two coils. One
factorisation with four right-hand sides therefore gives force and flux for all currents. Schütz et
al. solve 369 separate field problems to compute the force at all heights and currents. All element
matrices are assembled once.

A new mesh for each height of the sphere would cost time and add numerical noise to the force.
Therefore the *mover*, which is a box around the sphere, is meshed only once, symmetrically about
the equator of the sphere. The *stator*, which is the air cylinder with the ring magnet and the
coils, is also meshed once, with a regular lattice in the bore. At each height of the sphere, the
mesh of the box around the sphere replaces the lattice cells inside this box. The nodes on the
outline of the mover coincide with nodes of the lattice.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import chain, product
from math import ceil, floor, hypot, pi
from operator import attrgetter
from types import ModuleType
from typing import Any

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree
from skfem import Basis, BilinearForm, ElementTriP2, LinearForm, MeshTri, MeshTri2, condense, solve
from skfem.models.poisson import laplace

from kc2spice.core.errors import SimulationError, wrong
from kc2spice.core.gmsh_session import gmsh_session
from kc2spice.core.magnets import MagnetostaticTable
from kc2spice.core.quantities import MU_0
from kc2spice.fem.magnet_keys import CatchKeys, RingKeys
from kc2spice.linalg.factor import Factor, factorise_supernodal

# Minimum number of sphere heights that are selected to estimate the error of the field.
# At each selected height, the field is also computed with elements of twice the size.
MIN_COMPARED_HEIGHTS = 5
RING, SPHERE, LOWER, UPPER = range(4)  # column numbers of the load vectors and of the fields
# Element sizes for refine = 1, relative to the sphere's radius, and increase of size per distance.
# With these element sizes, the force error is at most 1e-5 of the largest force.
# Most of the force error is due to the mesh around the magnets and coils.
# An irregular mesh in the far field of the sphere would cause a spurious force.
_LATTICE_SIZE, _SPHERE_SIZE, _PART_SIZE, _CORNER_SIZE, _SIZE_GROWTH = (
    1 / 8,
    1 / 8,
    1 / 10,
    1 / 16,
    0.12,
)


def compute_magnetostatic_table(
    catch: CatchKeys, radius: float, progress: Callable[[float], None] = lambda share: None
) -> MagnetostaticTable:
    """Compute the magnetostatic table: force, flux and inductance over sphere height.

    The table contains ``catch.positions`` heights from ``catch.y_min`` to ``catch.y_max``.
    ``progress`` is called with the completed fraction after each height. For some heights, the
    field is also computed on a mesh with elements of twice the size.

    Raises
    ------
    UsageError : the sphere leaves the air cylinder, or the air cylinder is not higher than the
        magnet and the coils together.
    SimulationError : a computed field does not satisfy the field equations.
    """
    positions = choose_compared_height_count(catch.positions)
    settings = {"refine": catch.refine / 2, "positions": positions}
    rough = catch.model_copy(update=settings)  # refine may be below 1, unlike in a scene
    return replace(_sweep_heights(catch, radius, progress), coarser=_sweep_heights(rough, radius))


def choose_compared_height_count(count: int) -> int:
    """Choose the count of sphere heights at which two meshes are compared.

    At these heights, the field is also solved with a coarser mesh. At least five of the ``count``
    heights are chosen. If ``count`` is less than five, all heights are chosen. With the chosen
    number, the compared heights are an equally spaced selection from all ``count`` heights.
    """
    return next(
        (n for n in range(MIN_COMPARED_HEIGHTS, count) if (count - 1) % (n - 1) == 0), count
    )


def _sweep_heights(
    catch: CatchKeys, radius: float, progress: Callable[[float], None] = lambda share: None
) -> MagnetostaticTable:
    """Compute force, flux and inductance at all heights with one element size."""
    y = list_sphere_heights(catch)
    forces = np.empty((y.size, 4, 4))
    fluxes = np.empty((y.size, 2, 4))
    unknowns = 0
    for done, (index, equations_at) in enumerate(assemble_field_equations(catch, radius), 1):
        fields = equations_at.solve(equations_at.loads)
        forces[index] = equations_at.compute_force_matrix(fields)
        fluxes[index] = (equations_at.loads.T @ fields)[[LOWER, UPPER]]
        unknowns = max(unknowns, equations_at.free.size)
        progress(done / y.size)
    sign = get_ring_direction(catch)
    inductance = fluxes[:, :, [LOWER, UPPER]]
    length = [catch.turns * pi * (c.inner + c.outer) for c in (catch.lower, catch.upper)]
    # row of each force matrix for both magnets together; its columns are the four field sources
    magnets = sign * forces[:, RING] + forces[:, SPHERE]
    force = (
        forces[:, RING, RING] + forces[:, SPHERE, SPHERE] + 2 * sign * forces[:, RING, SPHERE],
        2 * magnets[:, LOWER],
        2 * magnets[:, UPPER],
        forces[:, LOWER, LOWER],
        2 * forces[:, LOWER, UPPER],
        forces[:, UPPER, UPPER],
    )
    return MagnetostaticTable(
        y=y,
        coefficients=np.column_stack(force),
        flux0=sign * fluxes[:, :, RING] + fluxes[:, :, SPHERE],
        inductance=(inductance + inductance.transpose(0, 2, 1)) / 2,
        resistance=catch.resistivity * np.array(length) / (pi * catch.wire_diameter**2 / 4),
        unknowns=unknowns,
    )


def list_sphere_heights(catch: CatchKeys) -> np.ndarray:
    """Return the heights [m] of the sphere's centre in the magnetostatic table.

    The heights are measured from the surface on which the sphere rests.
    """
    return np.linspace(catch.y_min, catch.y_max, catch.positions)


def get_ring_direction(catch: CatchKeys) -> float:
    """Return 1 if ring and sphere are magnetised in the same direction, otherwise -1."""
    return 1.0 if catch.polarity == "parallel" else -1.0


@dataclass(frozen=True, eq=False)
class FieldEquations:
    """Equations of the magnetic field of magnets, coils and a sphere at one height.

    The equations ``matrix @ a = loads`` determine the ``free`` unknowns. All other unknowns are
    zero.
    """

    matrix: sparse.csc_array
    loads: np.ndarray  # (n, 4)
    free: np.ndarray
    mover: np.ndarray  # indices of the unknowns in the mover
    stretch: sparse.csr_array  # matrix S of the force -1/2 a' S a; a: the unknowns in the mover

    def solve(self, loads: np.ndarray) -> np.ndarray:
        """Solve the magnetic field equations for several load vectors.

        The fields and the loads are arrays of shape (unknowns, load vectors).

        Raises
        ------
        SimulationError : the fields do not satisfy the field equations.
        """
        a = np.zeros(loads.shape)
        # minimum degree order, because nested dissection would take longer than the factorisation
        factor = Factor(self.matrix, factorise_supernodal(self.matrix))
        a[self.free] = factor.solve(loads[self.free])
        return a

    def compute_force_matrix(self, a: np.ndarray) -> np.ndarray:
        """Compute the matrix Q [N]; the force of fields with amplitudes q is ``q' Q q``.

        The columns of ``a`` (unknowns, k) are k fields. The matrix Q has the shape (k, k). If the k
        fields are superposed with the amplitudes q (k,), the force is ``q' Q q``.
        """
        near = a[self.mover]
        return -0.5 * near.T @ (self.stretch @ near)


def assemble_field_equations(
    catch: CatchKeys, radius: float
) -> Iterator[tuple[int, FieldEquations]]:
    """Assemble the field equations at each sphere height; yield index and equations.

    The same two meshes are used for all heights that differ by a multiple of the lattice pitch.
    """
    y = list_sphere_heights(catch)
    pitch = choose_lattice_pitch(catch, radius, (y[-1] - y[0]) / (y.size - 1))
    offset = np.round((y - y[0]) / pitch, 6) % 1.0
    for value in np.unique(offset):
        selected = np.flatnonzero(offset == value)
        lattice = make_bore(catch, radius, pitch, y[selected[0]], y[selected[-1]])
        equations_at = make_field_assembler(catch, lattice)
        for index in selected.tolist():
            yield index, equations_at(y[index])


@dataclass(frozen=True, eq=False)
class ElementMatrices:
    """Element matrices of one mesh, with the row and column numbers of all entries.

    The entries ``local[:, e]`` of element e are in the rows ``rows[:, e]`` and columns
    ``cols[:, e]`` of the assembled matrix.
    """

    points: np.ndarray  # (2, n): positions of the unknowns [m]
    rows: np.ndarray
    cols: np.ndarray
    local: np.ndarray
    loads: np.ndarray  # (n, 4): loads of the ring, the sphere, and 1 A in the lower and upper coil


def make_field_assembler(catch: CatchKeys, bore: BoreLattice) -> Callable[[float], FieldEquations]:
    """Make a function that assembles the field equations for a sphere at a height.

    The stator and the mover are each meshed only once. ``bore`` is the regular lattice of cells in
    the bore of the stator. The argument of the returned function is the height [m] of the sphere's
    centre, which must be equal to the height of a lattice point.
    """
    mesh, sphere = mesh_mover(bore)
    coercivity = catch.remanence / (catch.mu_r * MU_0)
    moved = _compute_element_matrices(
        catch, mesh, sphere, {SPHERE: (_coercivity_load, coercivity, sphere)}
    )
    r, y = moved.points
    edge = 1e-6 * bore.pitch
    rim = np.flatnonzero((r > bore.wall - edge) | (np.abs(y) > bore.half - edge))
    # The force [N] is -1/2 a' S a with the matrix S, named ``stretch``, and the field a.
    # S is an integral over the air in the mover, where the displacement weight g varies.
    # The weight g is 1 in the sphere, 0 on the outline of the mover, and harmonic in between.
    basis = _make_basis(mesh)
    g, core = np.zeros(basis.N), np.unique(basis.element_dofs[:, sphere])
    g[core] = 1.0
    g = solve(*condense(laplace.assemble(basis), x=g, D=np.union1d(core, rim)))
    outside = _make_basis(mesh, np.flatnonzero(~sphere))
    stretch = sparse.csr_array(
        _stiffness_derivative.assemble(outside, g=outside.interpolate(g)) / MU_0
    )

    mesh = mesh_stator(catch, bore)
    centres = mesh.p[:, mesh.t].mean(axis=1)
    (r, y), boxes = centres, list(map(get_section, list_actuator_sections(catch)))
    ring, *coils = ((r > a) & (r < c) & (y > b) & (y < d) for a, b, c, d in boxes)
    sources = {RING: (_coercivity_load, coercivity, ring)}
    for column, coil, inside in zip((LOWER, UPPER), (catch.lower, catch.upper), coils, strict=True):
        density = catch.turns / ((coil.outer - coil.inner) * coil.height)
        sources[column] = (_current_load, density, inside)
    stator = _compute_element_matrices(catch, mesh, ring, sources)
    movable = (r < bore.wall) & (y > bore.bottom) & (y < bore.bottom + bore.rows * bore.pitch)
    _, low, right, high = get_air_section(catch)
    r, y = stator.points
    edge = 1e-9 * (high - low)
    free = (r < right - edge) & (y > low + edge) & (y < high - edge)
    lookup, count, more = cKDTree(stator.points.T), stator.points.shape[1], moved.points.shape[1]

    def assemble_equations(height: float) -> FieldEquations:
        """Return the field equations for one height [m] of the sphere's centre."""
        mover = count + np.arange(more)
        distance, mover[rim] = lookup.query((moved.points[:, rim] + [[0], [height]]).T)
        if not np.max(distance) < 1e-6 * bore.pitch:
            raise SimulationError(
                "internal error: the meshes of stator and sphere do not match",
                where="magnetic field of the coils",
                got=f"sphere at y = {height:g} m",
                expected="nodes of both meshes with equal coordinates",
                hint="report this error with your scene file",
            )
        keep = ~(movable & (np.abs(centres[1] - height) < bore.half))
        row = np.concatenate([stator.rows[:, keep].ravel(), mover[moved.rows].ravel()])
        col = np.concatenate([stator.cols[:, keep].ravel(), mover[moved.cols].ravel()])
        data = np.concatenate([stator.local[:, keep].ravel(), moved.local.ravel()])
        active = np.zeros(count + more, dtype=bool)
        active[row] = True
        active[:count] &= free
        solved, number = np.flatnonzero(active), np.cumsum(active) - 1
        both = active[row] & active[col]
        places = (number[row[both]], number[col[both]])
        matrix = sparse.coo_array((data[both], places), shape=(solved.size, solved.size))
        loads = np.zeros((count + more, 4))
        loads[:count] = stator.loads
        loads[mover] += moved.loads
        return FieldEquations(matrix.tocsc(), loads, solved, mover, stretch)

    return assemble_equations


def _compute_element_matrices(
    catch: CatchKeys,
    mesh: MeshTri2,
    magnet: np.ndarray,
    sources: dict[int, tuple[LinearForm, float, np.ndarray]],
) -> ElementMatrices:
    """Compute the element matrices of a mesh and the load vectors of its sources.

    The elements ``magnet`` have the permeability of the magnets. Each source consists of a linear
    form, a factor, and a mask of the elements that contain the source. The keys of ``sources`` are
    columns of the load vectors.
    """
    basis = _make_basis(mesh)
    loads = np.zeros((basis.N, 4))
    for column, (form, size, inside) in sources.items():
        loads[:, column] = size * form.assemble(_make_basis(mesh, np.flatnonzero(inside)))
    coo = _stiffness_form.coo_data(basis)
    rows, cols = coo.indices.reshape(2, -1, mesh.nelements)
    reluctivity = np.where(magnet, 1 / catch.mu_r, 1.0) / MU_0
    local = coo.data.reshape(-1, mesh.nelements) * reluctivity
    return ElementMatrices(basis.doflocs, rows, cols, local, loads)


def _make_basis(mesh: MeshTri2, elements: np.ndarray | None = None) -> Basis:
    """Return a finite-element basis with a quadrature rule that is exact to degree 5.

    On triangles with straight edges, the integrands are polynomials of degree 5.
    """
    return Basis(mesh, ElementTriP2(), intorder=6, elements=elements)


@BilinearForm
def _stiffness_form(u: Any, v: Any, w: Any) -> np.ndarray:
    """Return the integrand of the stiffness matrix of the magnetic field."""
    r = w.x[0]
    bu, bv = 2 * u + r * u.grad[0], 2 * v + r * v.grad[0]
    return 2 * pi * r * (bu * bv + r**2 * u.grad[1] * v.grad[1])


@BilinearForm
def _stiffness_derivative(u: Any, v: Any, w: Any) -> np.ndarray:
    """Return the derivative of the stiffness with respect to a shift along y.

    Each point of the air moves by the shift times the weight ``g`` at this point.
    """
    r, (g_r, g_y) = w.x[0], w.g.grad
    bu, bv = 2 * u + r * u.grad[0], 2 * v + r * v.grad[0]
    shear = g_r * r * (u.grad[1] * bv + bu * v.grad[1])
    return 2 * pi * r * (g_y * (bu * bv - r**2 * u.grad[1] * v.grad[1]) - shear)


@LinearForm
def _coercivity_load(v: Any, w: Any) -> np.ndarray:
    """Return the load integrand of an axially magnetised magnet of coercivity 1 A/m.

    The coercivity is the remanence divided by the permeability.
    """
    r = w.x[0]
    return 2 * pi * r * (2 * v + r * v.grad[0])


@LinearForm
def _current_load(v: Any, w: Any) -> np.ndarray:
    """Return the integrand of the load vector for a current density of 1 A/m^2.

    The scalar product of the load vector and a field ``a`` is the flux linkage of a coil with one
    turn per square metre.
    """
    return 2 * pi * w.x[0] ** 2 * v


@dataclass(frozen=True)
class BoreLattice:
    """Regular lattice of cells in the bore in which the sphere moves.

    All lengths are in metres. ``bottom`` is the y coordinate of the lowest line of the lattice. The
    lattice consists of ``rows`` rows of cells with the height ``pitch``. Each row consists of
    ``columns`` cells from the axis to the radius ``wall``. The mover extends from ``half`` below to
    ``half`` above the sphere's centre. All element sizes are proportional to ``size``. ``radius``
    is the radius of the sphere.
    """

    radius: float
    wall: float
    pitch: float
    columns: int
    half: float
    bottom: float
    rows: int
    size: float


def list_actuator_sections(catch: CatchKeys) -> tuple[RingKeys, RingKeys, RingKeys]:
    """Return the sections of the ring magnet, the lower coil and the upper coil."""
    return catch.ring, catch.lower, catch.upper


def get_section(part: RingKeys) -> tuple[float, float, float, float]:
    """Return r_min, y_min, r_max and y_max [m] of a rectangular section."""
    return part.inner, part.y - part.height / 2, part.outer, part.y + part.height / 2


def get_air_section(catch: CatchKeys) -> tuple[float, float, float, float]:
    """Return r_min, y_min, r_max and y_max [m] of the section of the air cylinder.

    The air cylinder is centred on the actuator. Source: Schütz, Maeter and Bechtold, Actuators 10
    (2021) 279, section 2.2.1.
    """
    boxes = list(map(get_section, list_actuator_sections(catch)))
    _, bottoms, _, tops = zip(*boxes, strict=True)
    low, high = min(bottoms), max(tops)
    if high - low >= catch.air_height:
        raise wrong(
            "catch.air_height",
            "the cylinder of air in the field model is shorter than the magnet and coils inside it",
            got=f"{catch.air_height:g} m",
            expected=(
                f"more than {high - low:g} m; for a small field error, several times that height"
            ),
            hint=f"raise air_height to {3 * (high - low):g} m",
        )
    centre = (low + high) / 2
    return 0.0, centre - catch.air_height / 2, catch.air_radius, centre + catch.air_height / 2


def choose_lattice_pitch(catch: CatchKeys, radius: float, spacing: float) -> float:
    """Choose the lattice pitch [m]: an integer multiple or fraction of ``spacing``.

    The pitch is the height of the lattice cells. ``spacing`` [m] is the distance between
    consecutive heights of the sphere.
    """
    target = min(_LATTICE_SIZE * radius, _compute_narrowest_gap(catch, radius)) / catch.refine
    ratio = spacing / target
    return spacing / ceil(ratio) if ratio >= 1 else spacing * floor(1 / ratio)


def make_bore(
    catch: CatchKeys, radius: float, pitch: float, lowest: float, highest: float
) -> BoreLattice:
    """Make the lattice of mesh cells in the bore in which the sphere moves.

    The sphere's centre moves from the height ``lowest`` to the height ``highest`` [m].

    Raises
    ------
    UsageError : the sphere leaves the air cylinder.
    """
    gap = _compute_narrowest_gap(catch, radius)
    wall = radius + gap / 2
    half = pitch * ceil(wall / pitch)
    bottom, top = lowest - half, highest + half
    _, floor, _, ceiling = get_air_section(catch)
    if bottom <= floor + pitch or top >= ceiling - pitch:
        least, most = floor + half + pitch, ceiling - half - pitch
        expected = f"within {1e3 * least:.4g} mm to {1e3 * most:.4g} mm"
        hint = f'for example  y_max = "{1e3 * (most - pitch):.3g} mm"'
        if bottom <= floor + pitch:
            hint = f'for example  y_min = "{1e3 * (least + pitch):.3g} mm"'
        raise wrong(
            "catch.y_min, catch.y_max",
            "the height range of the sphere extends beyond the cylinder of air in the field model",
            got=f"{1e3 * lowest:.4g} mm to {1e3 * highest:.4g} mm",
            expected=expected,
            hint=hint,
        )
    size = radius / catch.refine
    columns = ceil(wall / (_LATTICE_SIZE * size))
    return BoreLattice(
        radius, wall, pitch, columns, half, bottom, round((top - bottom) / pitch), size
    )


def mesh_stator(catch: CatchKeys, bore: BoreLattice) -> MeshTri2:
    """Mesh the section of the stator with triangles, which form a lattice in the bore."""
    top = bore.bottom + bore.rows * bore.pitch
    boxes = list(map(get_section, list_actuator_sections(catch)))
    shapes = [get_air_section(catch), (0.0, bore.bottom, bore.wall, top), *boxes]
    corners = [*chain.from_iterable(product(box[::2], box[1::2]) for box in boxes)]

    def compute_element_size(r: float, y: float) -> float:
        """Return the element size [m] at a point of the section."""
        to_corner = min(hypot(r - a, y - b) for a, b in corners)
        to_part = min(
            hypot(max(a - r, 0.0, r - c), max(b - y, 0.0, y - d)) for a, b, c, d in shapes[1:]
        )
        near = min(_CORNER_SIZE * bore.size + _SIZE_GROWTH * to_corner, _PART_SIZE * bore.size)
        return near + _SIZE_GROWTH * to_part / catch.refine

    with gmsh_session() as gmsh:
        occ = gmsh.model.occ
        plates = [(2, occ.addRectangle(a, b, 0, c - a, d - b)) for a, b, c, d in shapes]
        _, pieces = occ.fragment(plates[:1], plates[1:])
        occ.synchronize()
        lattice = pieces[1][0]
        for _, curve in gmsh.model.getBoundary([lattice], oriented=False):
            _, low, _, _, high, _ = gmsh.model.getBoundingBox(1, curve)
            cells = bore.rows if high - low > bore.pitch / 2 else bore.columns
            gmsh.model.mesh.setTransfiniteCurve(curve, cells + 1)
        gmsh.model.mesh.setTransfiniteSurface(lattice[1], "AlternateLeft")
        points, triangles = _generate_mesh(gmsh, compute_element_size)
    return MeshTri2.from_mesh(MeshTri(points, triangles))


def mesh_mover(bore: BoreLattice) -> tuple[MeshTri2, np.ndarray]:
    """Mesh half the axial section of the mover: the sphere and the air around it.

    The centre of the sphere is the origin. The second returned array is a mask of the triangles
    inside the sphere. Triangle edges on the surface of the sphere are curved, with middle nodes on
    the surface.
    """
    outline = [(0, 0), (bore.radius, 0), (bore.wall, 0), (bore.wall, bore.half)]
    outline += [(0, bore.half), (0, bore.radius)]
    with gmsh_session() as gmsh:
        geo = gmsh.model.geo
        p = [geo.addPoint(r, y, 0) for r, y in outline]
        lines = list(map(geo.addLine, p, [*p[1:], p[0]]))
        arc = geo.addCircleArc(p[1], p[0], p[5])
        geo.addPlaneSurface([geo.addCurveLoop([lines[0], arc, lines[5]])])
        geo.addPlaneSurface([geo.addCurveLoop([*lines[1:5], -arc])])
        geo.synchronize()
        gmsh.model.mesh.setTransfiniteCurve(lines[2], round(bore.half / bore.pitch) + 1)
        gmsh.model.mesh.setTransfiniteCurve(lines[3], bore.columns + 1)
        points, triangles = _generate_mesh(gmsh, lambda r, y: _SPHERE_SIZE * bore.size)
    # The mesh is completed by its mirror image about y = 0. Both halves share the nodes on y = 0.
    on_line = np.abs(points[1]) < 1e-9 * np.ptp(points[1])
    points = np.where(on_line, [points[0], np.zeros_like(points[0])], points)
    image = np.arange(points.shape[1])
    image[~on_line] = points.shape[1] + np.arange(np.count_nonzero(~on_line))
    both = np.hstack([points, points[:, ~on_line] * [[1], [-1]]])
    flat = MeshTri(both, np.hstack([triangles, image[triangles]]))
    mesh = MeshTri2.from_mesh(flat)
    inside = np.hypot(*flat.p[:, flat.t].mean(axis=1)) < bore.radius * (1 - 1e-9)
    inside &= (np.hypot(*flat.p)[flat.t] <= bore.radius * (1 + 1e-9)).all(axis=0)
    left, right = flat.f2t
    surface = (right >= 0) & (inside[left] != inside[np.maximum(right, 0)])
    middle = mesh.dofs.facet_dofs[0, surface]
    mesh.doflocs[:, middle] *= bore.radius / np.hypot(*mesh.doflocs[:, middle])
    return mesh, inside


def _compute_narrowest_gap(catch: CatchKeys, radius: float) -> float:
    """Return the radial gap [m] between the sphere and the narrowest bore of a part."""
    return min(map(attrgetter("inner"), list_actuator_sections(catch))) - radius


def _generate_mesh(
    gmsh: ModuleType, size: Callable[[float, float], float]
) -> tuple[np.ndarray, np.ndarray]:
    """Mesh the surfaces of the current gmsh model; return vertices and triangles.

    The vertices have the shape (2, n), and the triangles the shape (3, t). ``size(r, y)`` is the
    element size at the point ``r``, ``y``.
    """
    gmsh.option.setNumber("Mesh.MeshSizeExtendFromBoundary", 0)
    gmsh.model.mesh.setSizeCallback(lambda dim, tag, x, y, z, given: size(x, y))
    gmsh.model.mesh.generate(2)
    tags, flat, _ = gmsh.model.mesh.getNodes()
    _, nodes = gmsh.model.mesh.getElementsByType(2)
    used, triangles = np.unique(nodes, return_inverse=True)
    order = np.argsort(tags)
    points = flat.reshape(-1, 3)[order[np.searchsorted(tags, used, sorter=order)], :2]
    return points.T.copy(), triangles.reshape(-1, 3).T.copy()
