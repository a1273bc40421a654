"""Piezoelectric FE model against closed forms and exact properties."""

import numpy as np
import pytest
from scipy.constants import epsilon_0
from scipy.sparse import block_array
from scipy.sparse.linalg import eigsh, spsolve

from kc2spice.bodies.piezo_stack import level_spans, stack_device
from kc2spice.bodies.stack_keys import Chip
from kc2spice.core.errors import UsageError
from kc2spice.core.quantities import validated
from kc2spice.fem.materials import material
from laboratory.usual.system import quarter

# Rings wide enough for quadratic cells: strong grading would fold them.
PAPER = material("THP51")
SMALL = {"sectors": 4, "rings": 2, "ring_spacing": 300e-6, "outer_rings": 2}
VARIANTS = [{}, {"refine": 2}, {"order": 2}]
TOGETHER = [{"layers_per_element": 5}, {"layers_per_element": 3, "refine": 2}]


def small_kick(layers: int = 3, **mesh) -> Chip:
    return Chip(layers=layers, mesh={**SMALL, **mesh})


def compliance_form() -> tuple[np.ndarray, np.ndarray]:
    """Strain-charge constants d (3, 6) and eps^T (3, 3), written out from the data sheet."""
    c11, c12, c13, c33, c44, c66 = 158.9e9, 113.0e9, 117.1e9, 144.2e9, 14.08e9, 22.94e9
    stiffness = [
        [c11, c12, c13, 0, 0, 0], [c12, c11, c13, 0, 0, 0], [c13, c13, c33, 0, 0, 0],
        [0, 0, 0, c44, 0, 0], [0, 0, 0, 0, c44, 0], [0, 0, 0, 0, 0, c66],
    ]  # fmt: skip
    e = [[0, 0, 0, 0, 13.38, 0], [0, 0, 0, 13.38, 0, 0], [-3.914, -3.914, 27.50, 0, 0, 0]]
    return e @ np.linalg.inv(stiffness), epsilon_0 * np.diag([3370.0, 3370.0, 3300.0])


def static_gains(system) -> tuple[np.ndarray, float]:
    """Ring displacements [m] and charge [C] of the sector at 1 V, potentials kept (oracle)."""
    n, volt = system.M.shape[0], 1e9  # potentials in GV: entries of one size
    K_up, K_pp = system.K_up * volt, system.K_pp * volt**2
    coupled = block_array([[system.K_uu, K_up], [K_up.T, -K_pp]], format="csc")
    x = spsolve(coupled, np.r_[-system.k_uV, volt * system.k_pV])
    u, p = x[:n], volt * x[n:]
    return system.B.T @ u, system.c_VV + system.k_pV @ p - system.k_uV @ u


@pytest.mark.parametrize("change", VARIANTS)
def test_matrices_are_exactly_symmetric_and_definite(change):
    system = quarter(small_kick(**change))
    for matrix in (system.M, system.K_uu, system.K_pp):
        assert (matrix != matrix.T).nnz == 0
        if matrix.shape[0]:
            assert np.linalg.eigvalsh(matrix.toarray())[0] > 0


@pytest.mark.parametrize("change", [*VARIANTS, *TOGETHER])
def test_free_stack_strokes_by_d33_and_stores_eps_t(change):
    """Laterally free layers in uniform field: strain d33 E, charge eps33^T E, both exact, also
    where an element holds several layers."""
    layers, area, height = 38 if change in TOGETHER else 3, 9e-6, 2e-3
    d, eps_t = compliance_form()
    system = quarter(small_kick(layers, **change))
    stroke, charge = static_gains(system)
    np.testing.assert_allclose(stroke, layers * d[2, 2], rtol=1e-10)
    assert 4 * charge == pytest.approx(eps_t[2, 2] * area * layers**2 / height, rel=1e-10)


@pytest.mark.parametrize("change", VARIANTS)
def test_clamped_stack_stores_eps_s(change):
    layers, area, height = 3, 9e-6, 2e-3
    d, eps_t = compliance_form()
    eps33_s = eps_t[2, 2] - np.array([-3.914, -3.914, 27.50, 0, 0, 0]) @ d[2]
    assert eps33_s / epsilon_0 == pytest.approx(803.5, abs=0.05)
    system = quarter(small_kick(layers, **change))
    charge = system.c_VV
    if system.K_pp.shape[0]:
        charge -= system.k_pV @ spsolve(system.K_pp, system.k_pV)
    assert 4 * charge == pytest.approx(eps33_s * area * layers**2 / height, rel=1e-10)


def test_several_layers_in_an_element_move_resonances_and_compliance_by_little():
    """Against one element for each of 60 layers; the error is stated as (m / n)^2."""
    facts, soft = {}, {}
    for several in (1, 5):
        tall = Chip(height=6e-3, layers=60, mesh={**SMALL, "layers_per_element": several})
        assert level_spans(tall).sum() == 60
        assert level_spans(tall).max() == several
        model = stack_device(tall).model
        facts[several] = model.facts
        answer = model.pencil.pencil_solver(0.0).solve(model.B[:, 0])
        soft[several] = model.B[:, 0] @ answer
    assert facts[5]["unknowns"] < 0.4 * facts[1]["unknowns"]
    for name in ("resonance_short_hz", "resonance_open_hz"):
        assert 0 < facts[5][name] / facts[1][name] - 1 < (5 / 60) ** 2
    assert soft[5] == pytest.approx(soft[1], rel=2e-3)


def test_slender_stack_rings_at_the_bar_frequency():
    """Clamped-free bar, anode shorted: f = sqrt(1 / (s33 rho)) / (4 h), up to lateral inertia."""
    kick = Chip(
        side=0.2e-3, height=2e-3, layers=25,
        mesh={"sectors": 4, "rings": 1, "ring_spacing": 40e-6, "outer_rings": 1},
    )  # fmt: skip
    system = quarter(kick)
    omega = np.sqrt(eigsh(system.K_uu, 1, M=system.M, sigma=0.0)[0][0])
    speed = np.sqrt(1 / np.linalg.inv(PAPER.C)[2, 2] / 7700)
    # Rayleigh's correction nu^2 pi^2 (r/h)^2 / 8 is 2e-3 here.
    assert omega / (2 * np.pi) == pytest.approx(speed / (4 * 2e-3), rel=4e-3)


def test_quadratic_and_refined_meshes_approach_one_resonance():
    def first(**mesh) -> float:
        system = quarter(Chip(layers=4, mesh={**SMALL, "rings": 1, **mesh}))
        assert mesh == {} or system.K_pp.shape[0] > 0
        return np.sqrt(eigsh(system.K_uu, 1, M=system.M, sigma=0.0)[0][0])

    coarse, fine, quadratic = first(), first(refine=2), first(order=2)
    assert coarse > fine > quadratic  # Galerkin: from above
    assert (fine - quadratic) < 0.4 * (coarse - quadratic)  # second order


def test_impossible_material_is_refused():
    with pytest.raises(UsageError, match="positive definite"):
        validated(Chip, {"material": {"permittivity": {"eps11": 100, "eps33": 100}}}, "stack")
