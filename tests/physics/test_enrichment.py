"""Shape functions of one degree more, and the corrections by them, against polynomials, an
independent element of scikit-fem and direct solutions."""

import numpy as np
import pytest
import skfem
from drawn_meshes import drawn
from scipy import linalg
from skfem.mesh import MeshQuad, MeshTet, MeshTri
from support import (
    Solid,
    assemble_enrichment,
    assemble_solid,
    compute_undamped_responses,
    correct_responses,
    disc,
    enrich_model,
    evaluate_shape_functions,
    find_material,
    make_enrichment,
)

STEEL, PZT = find_material("steel"), find_material("PZT-5A").rotate_z_axis((0, 0, 1))


def skewed(mesh):
    """The mesh with shuffled nodes and corners, moved as a whole by a linear map."""
    random = np.random.default_rng(3)
    order = random.permutation(mesh.p.shape[1])
    t = np.argsort(order)[mesh.t]
    for column in t.T:  # rotations about the last corner of a tetrahedron, else of all corners
        turning = column[: 3 if len(column) == 4 and mesh.dim() == 3 else None]
        turning[:] = np.roll(turning, random.integers(len(turning)))
    A = np.eye(mesh.dim()) + 0.2 * np.tri(mesh.dim(), k=-1)
    return type(mesh)(A @ mesh.p[:, order] + 0.1, t)


MESHES = {
    "tetrahedra": skewed(MeshTet.init_tensor(*[np.array([0.0, 0.3, 1.0])] * 3)),
    "triangles": skewed(MeshTri.init_tensor(*[np.array([0.0, 0.4, 1.0])] * 2)),
    "quadrilaterals": skewed(MeshQuad.init_tensor(*[np.array([0.0, 0.4, 1.0])] * 2)),
}


def solid_of(name, substance):
    mesh = MESHES[name]
    return Solid(mesh, (substance,), np.zeros(mesh.nelements, int), axisymmetric=mesh.dim() == 2)


def cubic(x):
    """A polynomial of third degree and its gradient at places (d, …)."""
    weights = np.array([1.0, -0.7, 0.4])[: len(x)]
    line = np.tensordot(weights, x, 1) + 0.3
    return line**3 + x[0] ** 2 * x[1], np.array([
        3 * w * line**2 + (2 * x[0] * x[1] if axis == 0 else x[0] ** 2 if axis == 1 else 0.0)
        for axis, w in enumerate(weights)
    ])  # fmt: skip


def rule(solid):
    """Points and weights that are exact for polynomials of high degree: on tetrahedra those of a
    cube, of which one end shrinks to an edge and a corner."""
    if not isinstance(solid.mesh, MeshTet):
        return solid.basis(8)
    (x, y, z), weights = skfem.quadrature.get_quadrature(skfem.refdom.RefHex, 12)
    points = np.array([x, y * (1 - x), z * (1 - x) * (1 - y)])
    return solid.basis(quadrature=(points, weights * (1 - x) ** 2 * (1 - y)))


def expand(solid, enrichment):
    """Coefficients of :func:`cubic` in nodes and functions, by least squares at all points, and
    the largest remainder."""
    basis = rule(solid)
    functions = evaluate_shape_functions(solid, basis.X)
    places, _ = cubic(np.asarray(basis.global_coordinates()))
    n, rows = solid.node_positions.shape[1], places.size
    A = np.zeros((rows, n + enrichment.function_count))
    row = np.arange(rows).reshape(places.shape)
    for local, function in enumerate(basis.basis):
        A[row, basis.element_dofs[local][:, None]] += np.asarray(function[0])
    for local, function in enumerate(functions):
        values = enrichment.signs[local][:, None] * function.values
        A[row, n + enrichment.numbers[local][:, None]] += values
    solution = np.linalg.lstsq(A, places.ravel(), rcond=None)[0]
    return solution, np.abs(A @ solution - places.ravel()).max()


@pytest.mark.parametrize("name", MESHES)
def test_cubic_polynomials_are_in_the_span(name):
    """Neighbours share functions with one sign: else no coefficients fit both."""
    solid = solid_of(name, STEEL)
    enrichment = make_enrichment(solid)
    coefficients, remainder = expand(solid, enrichment)
    assert remainder < 1e-11
    at_nodes, _ = cubic(solid.node_positions)
    np.testing.assert_allclose(coefficients[: len(at_nodes)], at_nodes, atol=1e-10)
    functions = np.abs(coefficients[len(at_nodes) :])
    assert functions.max() > 1e-3  # quadratic functions alone do not span them


@pytest.mark.parametrize("name", MESHES)
def test_energy_of_cubic_fields_is_that_of_their_gradients(name):
    """Displacement along z and potential both cubic, from the gradients in closed form."""
    solid = solid_of(name, PZT)
    enrichment = make_enrichment(solid)
    d, count = solid.component_count, enrichment.function_count
    more = assemble_enrichment(enrichment, np.ones((count, d), bool), np.ones(count, bool))
    coefficients, _ = expand(solid, enrichment)
    node, function = np.split(coefficients, [solid.node_positions.shape[1]])
    along_z = np.eye(d)[-1]
    u, w = np.kron(node, along_z), np.kron(function, along_z)
    full = assemble_solid(solid)
    elastic = u @ full.K_uu @ u + 2 * w @ more.K_nodes @ u + w @ more.K @ w
    coupled = u @ full.K_up @ node + w @ more.C_nodes @ node
    coupled += function @ more.D_nodes @ u + w @ more.C @ function
    electric = node @ full.K_pp @ node + 2 * function @ more.P_nodes @ node
    electric += function @ more.P @ function
    inertia = u @ full.M @ u + 2 * w @ more.M_nodes @ u + w @ more.M @ w

    basis = rule(solid)
    places = np.asarray(basis.global_coordinates())
    value, gradient = cubic(places)
    volume = basis.dx * (2 * np.pi * places[0] if d == 2 else 1.0)
    slope = np.zeros((3, *value.shape))
    slope[[0, 2] if d == 2 else [0, 1, 2]] = gradient
    strain = np.zeros((6, *value.shape))
    strain[2], strain[3], strain[4] = slope[2], slope[1], slope[0]

    def integral(left, matrix, right):
        return np.sum(volume * np.einsum("i...,ij,j...->...", left, matrix, right))

    assert elastic == pytest.approx(integral(strain, PZT.C, strain), rel=1e-9)
    assert coupled == pytest.approx(integral(slope, PZT.e, strain), rel=1e-9)
    assert electric == pytest.approx(integral(slope, PZT.eps_S, slope), rel=1e-9)
    # the solid integrates its mass in order 4, which the radius raises to 5
    exact = PZT.density * np.sum(volume * value**2)
    assert inertia == pytest.approx(exact, rel=1e-5 if name == "triangles" else 1e-9)


def test_modes_are_those_of_cubic_triangles():
    """Against the element of third degree of scikit-fem, on a body of revolution so far from its
    axis that the rule of the solid's matrices is accurate."""
    mesh = MESHES["triangles"].translated((1e5, 0.0))
    solid = Solid(mesh, (STEEL,), np.zeros(mesh.nelements, int), axisymmetric=True)
    enrichment = make_enrichment(solid)
    count, full = enrichment.function_count, assemble_solid(solid)
    more = assemble_enrichment(enrichment, np.ones((count, 2), bool), np.zeros(count, bool))
    K = np.block([[full.K_uu.toarray(), more.K_nodes.T.toarray()],
                  [more.K_nodes.toarray(), more.K.toarray()]])  # fmt: skip
    M = np.block([[full.M.toarray(), more.M_nodes.T.toarray()],
                  [more.M_nodes.toarray(), more.M.toarray()]])  # fmt: skip
    basis = skfem.Basis(solid.mesh, skfem.ElementVector(skfem.ElementTriP3()), intorder=7)

    def strain(u, x):
        g = u.grad
        return np.array([g[0, 0], u[0] / x[0], g[1, 1], 0 * u[0], g[0, 1] + g[1, 0], 0 * u[0]])

    @skfem.BilinearForm
    def stiffness(u, v, w):
        energy = np.einsum("i...,ij,j...->...", strain(v, w.x), STEEL.C, strain(u, w.x))
        return 2 * np.pi * w.x[0] * energy

    @skfem.BilinearForm
    def mass(u, v, w):
        return 2 * np.pi * w.x[0] * STEEL.density * (u[0] * v[0] + u[1] * v[1])

    third = linalg.eigh(stiffness.assemble(basis).toarray(), mass.assemble(basis).toarray())[0]
    mine = linalg.eigh(K, M)[0]
    assert len(mine) == len(third)
    np.testing.assert_allclose(mine[3:20], third[3:20], rtol=1e-6)  # three move as if rigid


LAYERS = [{"material": "brass", "diameter": 20e-3, "thickness": 0.5e-3},
          {"material": "PZT-5A", "diameter": 14e-3, "thickness": 0.5e-3}]  # fmt: skip


def direct(device, answers):
    """Corrections by dense matrices of all unknowns."""
    model = enrich_model(device, answers.solve)
    K, C, P, M = (
        np.block([[block.mesh.toarray(), block.right.toarray()],
                  [block.left.toarray(), block.functions.toarray()]])
        for block in (model.K, model.C, model.P, model.M)
    )  # fmt: skip
    k, volts = answers.modes.shape[1], answers.static.shape[1]
    z = np.hstack([answers.static, answers.pushed])
    _, (r_u, r_p) = model.extend_responses(z, np.eye(volts, z.shape[1]))
    S = np.block([[K + device.shift * M, C], [C.T, -P]])
    e = np.linalg.solve(S, np.vstack([r_u, r_p]))
    products = np.vstack([r_u, r_p]).T @ e
    squares = linalg.eigh(K + C @ np.linalg.solve(P, C.T), M, eigvals_only=True)
    z = answers.modes[:, :1]
    first = float(((z.T @ (device.model.K @ z)) / (z.T @ (device.model.M @ z)))[0, 0])
    assert k
    return np.sqrt(squares[np.abs(squares / first - 1).argmin()] / first) - 1, products


@pytest.mark.parametrize("support", ["free", "clamped"])
def test_corrections_are_those_of_a_direct_solution(support):
    """Corrections of few vectors and of all unknowns agree to a twentieth."""
    device = disc.make_disc_blocks({"layers": LAYERS, "support": support}).build_fe_model()
    answers = compute_undamped_responses(device.model, device.shift)
    corrections = correct_responses(device, answers)
    first, products = direct(device, answers)
    assert corrections.frequencies[0] == pytest.approx(first, rel=0.05)
    np.testing.assert_allclose(corrections.products, products, rtol=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("number", [1, 8, 33])
def test_corrections_of_tetrahedra_are_those_of_a_direct_solution(tmp_path, number):
    _, make, _ = drawn(number)
    device = make(1, tmp_path)
    answers = compute_undamped_responses(device.model, device.shift)
    corrections = correct_responses(device, answers)
    first, products = direct(device, answers)
    assert corrections.frequencies[0] == pytest.approx(first, rel=0.1)
    np.testing.assert_allclose(np.diag(corrections.products), np.diag(products), rtol=0.1)
