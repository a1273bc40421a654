"""Reductions of large bodies that are free to move, against direct solutions.

Their rigid-body modes are deflated, so that all factors are real. The reference solutions factorise
the unreduced matrices at each frequency by scipy.
"""

import numpy as np
import pytest
import scipy
import skfem
from scipy import sparse
from scipy.sparse.linalg import splu
from skfem.helpers import ddot, dot, eye, grad, sym_grad, trace
from support import (
    LinearModel,
    Port,
    make_piezoelectric_model,
    reduce_model,
    split_free_body,
    stability,
)
from support import factor as factors
from support import pencil as pencils

BAND = (50e3, 400e3)
BETA = 2 * 0.005 / (2 * np.pi * 200e3)  # s; a damping ratio of 0.5 % at 200 kHz


@pytest.fixture
def real_factors(monkeypatch):
    """Any factor of a complex matrix is an error."""
    original = pencils.factorise_two_sided

    def two_sided(matrix, *, symmetric):
        assert not np.iscomplexobj(matrix)
        return original(matrix, symmetric=symmetric)

    monkeypatch.setattr(pencils, "factorise_two_sided", two_sided)


CELLS, LENGTH = (7, 7, 6), 10e-3


def ceramic_mesh(cells, length):
    """Mesh of a cube in bricks."""
    return skfem.MeshHex.init_tensor(*(np.linspace(0, length, count + 1) for count in cells))


def ceramic_block(cells=CELLS, length=LENGTH):
    """A cube of piezoelectric ceramic in trilinear bricks, with electrodes on two faces.

    The result has the blocks of :func:`make_piezoelectric_model`, and one force along the axis.
    """
    mesh = ceramic_mesh(cells, length)
    solid = skfem.Basis(mesh, skfem.ElementVector(skfem.ElementHex1()))
    electric = solid.with_element(skfem.ElementHex1())
    young, poisson, density, permittivity = 80e9, 0.3, 7500.0, 1.5e-8
    shear, lame = young / 2.6, young * poisson / (1.3 * 0.4)

    def stress(field):
        """The constants e33 = 14, e31 = -4, e15 = 10 C/m^2 times a field."""
        x, y, z = field
        zero = 0 * x
        return np.array([[-4 * z, zero, 10 * x], [zero, -4 * z, 10 * y], [10 * x, 10 * y, 14 * z]])

    @skfem.BilinearForm
    def elastic(u, v, w):
        strain = sym_grad(u)
        return ddot(2 * shear * strain + lame * eye(trace(strain), 3), sym_grad(v))

    coupling = skfem.BilinearForm(lambda p, v, w: ddot(stress(grad(p)), sym_grad(v)))
    dielectric = skfem.BilinearForm(lambda p, q, w: permittivity * dot(grad(p), grad(q)))
    mass = skfem.BilinearForm(lambda u, v, w: density * dot(u, v))
    K_uu, M, C = elastic.assemble(solid), mass.assemble(solid), dielectric.assemble(electric)
    K_up = coupling.assemble(electric, solid)
    z = mesh.p[2]
    live, ground = np.flatnonzero(z > 0.999 * length), np.flatnonzero(z < 1e-3 * length)
    inner = np.setdiff1d(np.arange(z.size), np.r_[live, ground])
    one = np.ones(live.size)
    force = np.zeros((K_uu.shape[0], 1))
    force[solid.nodal_dofs[2, live], 0] = 1 / live.size
    return {
        "M": M.tocsc(),
        "K_uu": K_uu.tocsc(),
        "K_up": K_up.tocsc()[:, inner],
        "K_pp": C.tocsc()[inner][:, inner],
        "k_uV": (K_up.tocsc()[:, live] @ one)[:, None],
        "k_pV": (C.tocsc()[inner][:, live] @ one)[:, None],
        "c_VV": one @ C.tocsc()[live][:, live] @ one,
        "B": force,
    }


def ceramic_response(blocks, frequency):
    """Response of the ports by the equations with the potentials as unknowns."""
    n, m = blocks["K_up"].shape
    force = blocks["B"].shape[1]
    right = np.zeros((n + m, force + 1), complex)
    result = []
    for s in 2j * np.pi * frequency:
        # the condensed stiffness is damped, of which the coupling is a part
        factor = 1 + s * BETA
        P = sparse.block_array(
            [[factor * blocks["K_uu"] + s**2 * blocks["M"], factor * blocks["K_up"]],
             [factor * blocks["K_up"].T, -factor * blocks["K_pp"]]]
        )  # fmt: skip
        lift = splu(blocks["K_pp"]).solve(-blocks["k_pV"])
        drive = -blocks["k_uV"] - blocks["K_up"] @ lift
        right[:n, :force], right[:n, force:] = blocks["B"], drive
        x = splu(P.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.1).solve(right)[:n]
        C0 = blocks["c_VV"] + blocks["k_pV"].T @ lift
        D = scipy.linalg.block_diag(np.zeros((force, force)), C0)
        result.append(right[:n].T @ x + D)
    return np.array(result)


@pytest.fixture(scope="module")
def ceramic():
    """Blocks of the ceramic cube, frequencies [Hz], and the response to force and voltage."""
    blocks = ceramic_block()
    frequency = np.random.default_rng(5).uniform(*BAND, 6)
    return blocks, frequency, ceramic_response(blocks, frequency)


@pytest.mark.parametrize("names", [("anode",), ("face", "anode")])
def test_a_free_ceramic_block_needs_real_factors_only(ceramic, real_factors, names):
    """The electrodes alone do not move the whole block, and the force does."""
    blocks, frequency, exact = ceramic
    ports = [Port("face", "mechanical"), Port("anode", "electrical")]
    full = make_piezoelectric_model(ports=ports, rayleigh=(0.0, BETA), **blocks).select(names)
    rom = reduce_model(full, tolerance=1e-3, band=BAND)
    exact = exact[:, -len(names) :, -len(names) :]
    error = np.abs(rom.transfer(frequency) - exact) / np.abs(exact)
    assert error.max() <= rom.certificate.error_estimate <= 1e-3
    assert rom.certificate.stable
    assert rom.certificate.passive


@pytest.mark.slow
@pytest.mark.parametrize("clamped", [False, True])
def test_large_ceramic_bodies_need_no_pivots(ceramic, monkeypatch, clamped):
    """A clamped one is proven definite by the pivots of its factor, without another factor."""
    monkeypatch.setattr(pencils, "QUASI_DEFINITE_UNKNOWNS", 0)
    monkeypatch.setattr(factors, "DISSECTION_UNKNOWNS", 100)
    blocks, frequency, exact = ceramic

    def refuse(*_, **__):
        pytest.fail("a matrix was factorised")

    for module in (factors, pencils):
        monkeypatch.setattr(module, "factorise_two_sided", refuse)
    if clamped:
        mobile = np.flatnonzero(np.repeat(ceramic_mesh(CELLS, LENGTH).p[0] > 0, 3))
        rows = {"M", "K_uu", "K_up", "k_uV", "B"}
        blocks = {key: P[mobile] if key in rows else P for key, P in blocks.items()}
        blocks |= {key: blocks[key][:, mobile] for key in ("M", "K_uu")}
        exact = ceramic_response(blocks, frequency)
        # the mass is proven by Lanczos steps
        monkeypatch.setattr(stability, "MAX_FACTORED_UNKNOWNS", 0)
        monkeypatch.setattr(stability, "factorise", refuse)
    ports = [Port("face", "mechanical"), Port("anode", "electrical")]
    full = make_piezoelectric_model(ports=ports, rayleigh=(0.0, BETA), **blocks)
    if clamped:
        assert full.pencil.factorise_shifted_stiffness(0.0).negative == blocks["K_pp"].shape[0]
    rom = reduce_model(full, tolerance=1e-3, band=BAND)
    error = np.abs(rom.transfer(frequency) - exact) / np.abs(exact)
    assert error.max() <= rom.certificate.error_estimate <= 1e-3
    assert rom.certificate.stable
    assert rom.certificate.passive


def chains(count, length):
    """Equal chains of masses on springs that are not connected: each is free to move."""
    links = sparse.diags_array([-1.0, 1.0], offsets=[0, 1], shape=(length - 1, length))
    K = sparse.kron(sparse.eye_array(count), links.T @ links)
    B = np.zeros((count * length, count))
    B[np.arange(count) * length, np.arange(count)] = 1.0
    return sparse.eye_array(count * length, format="csc"), K.tocsc(), B


@pytest.mark.slow
def test_more_rigid_body_modes_than_one_block_of_vectors(real_factors):
    """Each chain has one; its response is a sum over its modes, known in closed form."""
    count, length, beta = 9, 150, 0.1
    M, K, B = chains(count, length)
    full = LinearModel(M=M, K=K, B=B, rayleigh=(0.0, beta))
    rom = reduce_model(full, tolerance=1e-3, band=(0.0, 0.03), method="response POD")
    k = np.arange(length)
    squares = 4 * np.sin(np.pi * k / (2 * length)) ** 2
    shares = np.where(k, 2, 1) / length * np.cos(np.pi * k / (2 * length)) ** 2
    frequency = np.linspace(1e-3, 0.03, 20)
    s = 2j * np.pi * frequency[:, None]
    exact = (shares / (s**2 + s * beta * squares + squares)).sum(axis=1)
    found = rom.transfer(frequency)
    diagonal = np.einsum("fii->fi", found)
    assert (np.abs(diagonal - exact[:, None]) / np.abs(exact[:, None])).max() <= 1e-3
    assert rom.pencil.free or (np.abs(rom.poles()) < 1e-9).sum() >= 2 * count


def test_a_soft_support_is_not_taken_for_a_rigid_body_mode():
    M, K, B = chains(1, 1500)
    omega, n = 2 * np.pi * 0.03, 1500
    unsupported = LinearModel(M=M, K=K, B=B, rayleigh=(0.0, 0.1))
    modes = split_free_body(unsupported.pencil, omega).modes
    assert np.abs(np.abs(modes) - 1 / np.sqrt(n)).max() <= 1e-12
    assert modes.shape == (n, 1)
    for stiffness in (1e-6, 1e-3, 1.0):
        support = sparse.csc_array(([stiffness], ([0], [0])), shape=(n, n))
        model = LinearModel(M=M, K=K + support, B=B, rayleigh=(0.0, 0.1))
        assert split_free_body(model.pencil, omega) is None


@pytest.mark.slow
def test_a_free_body_can_have_any_prescribed_order():
    """Its error against a direct solution is within the estimate."""
    M, K, B = chains(1, 1500)
    model = LinearModel(M=M, K=K, B=B, rayleigh=(0.0, 0.1))
    rom = reduce_model(model, order=24, band=(0.0, 0.03))
    assert rom.order == 24
    f = np.array([0.004, 0.011, 0.025])
    exact = model.transfer(f)
    error = (np.abs(rom.transfer(f) - exact) / np.abs(exact)).max()
    assert error <= rom.certificate.error_estimate
