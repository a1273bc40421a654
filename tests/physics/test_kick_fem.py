"""Piezoelectric FE model against closed forms and exact properties."""

import numpy as np
import pytest
from scipy.sparse.linalg import eigsh
from support import StackKeys, choose_level_spans, make_stack

from bench.usual.system import quarter

# Rings wide enough for quadratic cells: strong grading would fold them.
SMALL = {"sectors": 4, "rings": 2, "ring_spacing": 300e-6, "outer_rings": 2}
VARIANTS = [{}, {"refine": 2}, {"order": 2}]


def small_kick(layers: int = 3, **mesh) -> StackKeys:
    return StackKeys(layers=layers, mesh={**SMALL, **mesh})


@pytest.mark.parametrize("change", VARIANTS)
def test_matrices_are_exactly_symmetric_and_definite(change):
    system = quarter(small_kick(**change))
    for matrix in (system.M, system.K_uu, system.K_pp):
        assert (matrix != matrix.T).nnz == 0
        if matrix.shape[0]:
            assert np.linalg.eigvalsh(matrix.toarray())[0] > 0


def test_several_layers_in_an_element_move_resonances_and_compliance_by_little():
    """Against one element for each of 60 layers; the error is stated as (m / n)^2."""
    facts, soft = {}, {}
    for several in (1, 5):
        tall = StackKeys(height=6e-3, layers=60, mesh={**SMALL, "layers_per_element": several})
        assert choose_level_spans(tall).sum() == 60
        assert choose_level_spans(tall).max() == several
        model = make_stack(tall).model
        facts[several] = model.facts
        answer = model.pencil.factorise_shifted_stiffness(0.0).solve(model.B[:, 0])
        soft[several] = model.B[:, 0] @ answer
    assert facts[5]["unknowns"] < 0.4 * facts[1]["unknowns"]
    for name in ("resonance_short_hz", "resonance_open_hz"):
        assert 0 < facts[5][name] / facts[1][name] - 1 < (5 / 60) ** 2
    assert soft[5] == pytest.approx(soft[1], rel=2e-3)


def test_quadratic_and_refined_meshes_approach_one_resonance():
    def first(**mesh) -> float:
        system = quarter(StackKeys(layers=4, mesh={**SMALL, "rings": 1, **mesh}))
        assert mesh == {} or system.K_pp.shape[0] > 0
        return np.sqrt(eigsh(system.K_uu, 1, M=system.M, sigma=0.0)[0][0])

    coarse, fine, quadratic = first(), first(refine=2), first(order=2)
    assert coarse > fine > quadratic  # Galerkin: from above
    assert (fine - quadratic) < 0.4 * (coarse - quadratic)  # second order
