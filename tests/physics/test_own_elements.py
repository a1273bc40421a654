"""Chip, imprint and impact against a model assembled by hand, of which only the nodes are ours.

Both solution methods of the product take their matrices, rings and contact from the same modules;
here elements, boundary conditions, rings, gaps, contact and time steps are other code.
"""

import numpy as np
import own_elements
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import eigh
from support import StackKeys, make_stack_setup

from bench.usual.contact import contact_surface
from bench.usual.statics import imprint
from bench.usual.system import quarter
from bench.usual.transient import Ball, transient

RADIUS, PENALTY, MASS = 1e-3, 1e8, 8e-6
CHIP = StackKeys(
    layers=2, mesh={"sectors": 4, "rings": 2, "ring_spacing": 100e-6, "outer_rings": 2}
)


@pytest.fixture(scope="module")
def own():
    x, y, z = make_stack_setup(CHIP)[0].node_positions
    plane = np.column_stack([x, y])[z == 0]
    M, K, k, c, free, top = own_elements.chip(plane, 5, np.unique(z))
    return M, K, k, c, own_elements.ring_shapes(free, top, (0, 1, 2), 5)


def gaps():
    r = np.array([0.0, 100e-6, 200e-6])
    return RADIUS - np.sqrt(RADIUS**2 - r**2)


def test_matrices_are_those_assembled_by_hand(own):
    M, K, k, c, shapes = own
    system = quarter(CHIP)
    pairs = {"M": (system.M.toarray(), M), "K": (system.K_uu.toarray(), K),
             "k": (system.k_uV, k), "c": (system.c_VV, c), "B": (system.B, shapes)}  # fmt: skip
    for name, (found, exact) in pairs.items():
        assert np.abs(found - exact).max() < 1e-12 * np.abs(exact).max(), name


@pytest.mark.parametrize("electrical", ["open", "short"])
def test_imprint_by_hand(own, electrical):
    """Springs are closed one after the other until every one that is compressed is."""
    _, K, k, c, shapes = own
    depth = np.array([1e-6, 8e-6, 40e-6])
    stiff = K + np.outer(k, k) / c if electrical == "open" else K
    expected = []
    for d in depth:
        closed = np.zeros(3, dtype=bool)
        while True:
            W = shapes[:, closed]
            pushed = PENALTY * W @ (d - gaps()[closed])
            u = np.linalg.solve(stiff + PENALTY * W @ W.T, -pushed)
            reached = shapes.T @ u + d - gaps()
            if not (reached[~closed] > 0).any():
                break
            closed |= reached > 0
        assert (reached[closed] > 0).all()
        expected.append(PENALTY * np.maximum(reached, 0))
    surface = contact_surface(CHIP, PENALTY, RADIUS)
    found = imprint(quarter(CHIP), surface, depth, electrical)
    assert [int((row > 0).sum()) for row in expected] == [1, 2, 3]
    np.testing.assert_allclose(found.ring_force, expected, rtol=1e-9, atol=1e-9)


@pytest.mark.slow
def test_impact_by_hand(own):
    """In modes, with adaptive steps; what is left is the error of steps of 5 ns."""
    M, K, _, _, shapes = own
    square, V = eigh(K, M)
    rings, beta, n = V.T @ shapes, CHIP.damping.zeta / (np.pi * CHIP.damping.at), len(square)

    def slope(_, z):
        a, v, (y, w) = z[:n], z[n : 2 * n], z[2 * n :]
        force = PENALTY * np.maximum(rings.T @ a - y - gaps(), 0)
        return np.r_[v, -square * (a + beta * v) - rings @ force, w, force.sum() / MASS]

    linear = np.zeros((2 * n + 2, 2 * n + 2))
    linear[:n, n : 2 * n], linear[2 * n, 2 * n + 1] = np.eye(n), 1.0
    linear[n : 2 * n, : 2 * n] = -np.hstack([np.diag(square), beta * np.diag(square)])

    def jacobian(_, z):
        R = np.vstack([rings, np.zeros((n, 3)), -np.ones(3), np.zeros(3)])
        R = R[:, rings.T @ z[:n] - z[2 * n] > gaps()]
        pushed = PENALTY * np.vstack([0 * R[:n], R[:n], 0 * R[:1], R[2 * n : 2 * n + 1] / MASS])
        return linear - pushed @ R.T

    start = np.r_[np.zeros(2 * n), 1e-7, -1.0]
    stop = 4e-6
    exact = solve_ivp(slope, (0, stop), start, "Radau", rtol=1e-7, atol=1e-13, jac=jacobian)
    found = transient(
        quarter(CHIP), contact_surface(CHIP, PENALTY, RADIUS), Ball(MASS, 1e-7, -1.0),
        step=5e-9, stop=stop, is_open=False,
    )  # fmt: skip
    travel = 1e-7 - found.height.min()
    assert travel > 1e-6
    assert found.height[-1] == pytest.approx(exact.y[2 * n, -1], abs=3e-4 * travel)
    assert found.velocity[-1] == pytest.approx(exact.y[-1, -1], abs=3e-4)
