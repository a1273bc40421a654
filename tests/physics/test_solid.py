"""Solids on tetrahedra against closed forms: patch tests, beams, rods, capacitors, convergence."""

import numpy as np
import pytest
from scipy.optimize import brentq
from skfem.mesh import MeshHex, MeshTet, MeshTet2
from support import (
    BoundaryConditions,
    DampingKeys,
    Port,
    PortLoad,
    Solid,
    UsageError,
    assemble_solid,
    compute_node_shares,
    find_material,
    make_damped_model,
    spread_force,
)

STEEL = find_material({"density": 7800, "youngs_modulus": "200 GPa", "poisson_ratio": 0.3})
# without lateral contraction, clamps do what beam theory says
SLENDER = find_material({"density": 7800, "youngs_modulus": "200 GPa", "poisson_ratio": 0.0})
PZT = find_material("PZT-5A")
UNDAMPED = DampingKeys(ratio=0)


def box(size, cuts, made_of, hexahedra=False):
    lines = [np.linspace(0, length, n + 1) for length, n in zip(size, cuts, strict=True)]
    mesh = (
        MeshHex.init_tensor(*lines)
        if hexahedra
        else MeshTet2.from_mesh(MeshTet.init_tensor(*lines))
    )
    return Solid(mesh, (made_of,), np.zeros(mesh.nelements, int))


def places(solid):
    return solid.basis(1).doflocs


def plane(solid, axis, value):
    return np.flatnonzero(np.abs(places(solid)[axis] - value) < 1e-9)


def end(solid, axis, value):
    return solid.mesh.facets_satisfying(lambda x: np.abs(x[axis] - value) < 1e-9)


def make_fixed_mask(solid, *pairs):
    """Mask with the displacements of nodes fixed along axes."""
    mask = np.zeros((places(solid).shape[1], solid.component_count), bool)
    for nodes, axes in pairs:
        mask[np.ix_(nodes, axes)] = True
    return mask.ravel()


def distorted(kind):
    mesh = kind.init_tensor(*(np.linspace(0, 1, 4),) * 3)
    inner = np.setdiff1d(np.arange(mesh.nvertices), mesh.boundary_nodes())
    moved = mesh.p.copy()
    moved[:, inner] += np.random.default_rng(1).uniform(-0.05, 0.05, (3, inner.size))
    mesh = kind(moved, mesh.t)
    return MeshTet2.from_mesh(mesh) if kind is MeshTet else mesh


@pytest.mark.parametrize("kind", [MeshTet, MeshHex])
def test_patch_of_anisotropic_piezoelectric(kind):
    made_of = find_material("quartz").rotate_z_axis((0.3, -0.5, 0.8))
    mesh = distorted(kind)
    solid = Solid(mesh, (made_of,), np.zeros(mesh.nelements, int))
    full, x = assemble_solid(solid), places(solid)
    A = np.random.default_rng(2).standard_normal((3, 3))
    b = 1e9 * np.array([0.4, -1.1, 0.7])
    u, phi = (A @ x).T.ravel(), b @ x
    inner = np.all((x > 1e-9) & (x < 1 - 1e-9), axis=0)
    force = full.K_uu @ u + full.K_up @ phi
    charge = full.K_up.T @ u - full.K_pp @ phi
    assert np.abs(force[np.repeat(inner, 3)]).max() < 1e-12 * np.abs(full.K_uu @ u).max()
    assert np.abs(charge[inner]).max() < 1e-12 * np.abs(charge).max()
    S = np.array(
        [A[0, 0], A[1, 1], A[2, 2], A[1, 2] + A[2, 1], A[0, 2] + A[2, 0], A[0, 1] + A[1, 0]]
    )
    assert u @ (full.K_uu @ u) == pytest.approx(S @ made_of.C @ S, rel=1e-12)
    assert u @ (full.K_up @ phi) == pytest.approx(S @ made_of.e.T @ b, rel=1e-10)
    assert phi @ (full.K_pp @ phi) == pytest.approx(b @ made_of.eps_S @ b, rel=1e-12)
    # distorted hexahedra have linear fields alone
    field, square = (x[0] * x[1], 1 / 9) if kind is MeshTet else (x[0], 1 / 3)
    moved = np.kron(field, [1, 0, 0])
    assert moved @ (full.M @ moved) == pytest.approx(made_of.density * square, rel=1e-12)


def test_the_deflection_of_a_cantilever_follows_euler_and_bernoulli():
    L, w, h = 0.1, 2e-3, 2e-3
    solid = box((L, w, h), (40, 2, 2), SLENDER)
    tip = PortLoad(
        Port("tip", "mechanical"),
        spread_force(compute_node_shares(solid, facets=end(solid, 0, L)), np.eye(3)[2], solid),
    )
    base = Port("base", "acceleration")
    fixed = make_fixed_mask(solid, (plane(solid, 0, 0.0), (0, 1, 2)))
    model = make_damped_model(
        solid,
        BoundaryConditions(fixed, shapes=[tip], base=[(base, np.eye(3)[2])], damping=UNDAMPED),
    ).model
    EI, line = 200e9 * w * h**3 / 12, 7800 * w * h
    found = model.transfer(np.zeros(1))[0].real
    assert found[0, 0] == pytest.approx(L**3 / (3 * EI), rel=3e-3)
    assert found[0, 1] == pytest.approx(-line * L**4 / (8 * EI), rel=3e-3)
    first = 1.8751041**2 / (2 * np.pi) * np.sqrt(EI / line) / L**2
    assert model.facts["resonance_hz"] == pytest.approx(first, rel=3e-3)
    assert model.facts["mass_kg"] == pytest.approx(line * L, rel=1e-12)


def test_free_rod_poled_along_its_length_has_the_resonances_of_k33():
    L, w = 20e-3, 1e-3
    solid = box((w, w, L), (1, 1, 24), PZT)
    model = make_damped_model(solid, BoundaryConditions(
        make_fixed_mask(solid),
        {"anode": plane(solid, 2, L), "cathode": plane(solid, 2, 0.0)},
        "cathode",
    )).model  # fmt: skip
    s33, d33, eps = np.linalg.inv(PZT.C)[2, 2], PZT.d[2, 2], PZT.eps_T[2, 2]
    k2 = d33**2 / (s33 * eps)
    parallel = 1 / (2 * L * np.sqrt(PZT.density * s33 * (1 - k2)))
    ratio = brentq(lambda q: np.tan(np.pi / 2 * q) / (np.pi / 2 * q) * k2 - 1, 0.3, 0.9999)
    assert model.facts["resonance_open_hz"] == pytest.approx(parallel, rel=2e-3)
    assert model.facts["resonance_short_hz"] == pytest.approx(ratio * parallel, rel=2e-3)
    assert model.facts["capacitance_free_f"] == pytest.approx(eps * w * w / L, rel=1e-6)


@pytest.mark.parametrize(("axis", "kind"), [(0, "tetrahedra"), (2, "hexahedra")])
def test_longitudinal_wave_converges_with_the_fourth_power(axis, kind):
    """All sides on rollers, so that the plane wave ``cos(pi x / L)`` is exact."""
    errors = []
    L, cuts = 1e-2, (2, 4)
    exact = np.sqrt(STEEL.C[0, 0] / STEEL.density) / (2 * L)
    for n in cuts:
        size, split = np.full(3, L / 4), [1, 1, 1]
        size[axis], split[axis] = L, n
        solid = box(size, split, STEEL, kind == "hexahedra")
        x = places(solid)
        sides = [(np.flatnonzero((x[a] < 1e-9) | (x[a] > size[a] - 1e-9)), (a,))
                 for a in range(3) if a != axis]  # fmt: skip
        near = spread_force(
            compute_node_shares(solid, facets=end(solid, axis, 0.0)), np.eye(3)[axis], solid
        )
        far = spread_force(
            compute_node_shares(solid, facets=end(solid, axis, L)), np.eye(3)[axis], solid
        )
        pull = PortLoad(Port("pull", "mechanical"), far - near)  # keeps out the even, rigid ones
        squeeze = PortLoad(Port("push", "mechanical"), far)
        fixed = make_fixed_mask(solid, *sides)
        model = make_damped_model(
            solid,
            BoundaryConditions(fixed, shapes=[squeeze, pull], damping=DampingKeys(ratio=0, at=1e5)),
        ).model
        frequencies = np.sort(np.abs(model.select(["pull"]).poles().imag))
        first = frequencies[frequencies > 1e3][0] / (2 * np.pi)
        errors.append(abs(first / exact - 1))
    assert np.log2(errors[0] / errors[1]) > 3.6
    assert errors[1] < 3e-4


def test_elements_turned_inside_out_are_refused():
    mesh = MeshTet2.from_mesh(MeshTet.init_tensor(*(np.linspace(0, 1, 2),) * 3))
    doflocs = mesh.doflocs.copy()
    doflocs[:, mesh.nvertices] += 0.6
    with pytest.raises(UsageError, match="negative volume"):
        Solid(MeshTet2(doflocs, mesh.t), (STEEL,), np.zeros(mesh.nelements, int))
