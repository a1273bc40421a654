"""The ring mesh: size, circles, volume and refusals."""

import numpy as np
import pytest

from kc2spice.bodies.piezo_stack import stack_setup
from kc2spice.core.errors import UsageError
from kc2spice.fem.piezo.keys import Chip
from kc2spice.fem.piezo.mesh import kick_mesh


@pytest.mark.parametrize("change", [{}, {"refine": 2}, {"order": 2}, {"sectors": 4, "rings": 1}])
def test_hexahedra_fill_the_quarter_chip(change):
    kick = Chip(mesh=change)
    cells = stack_setup(kick)[0].basis(5).dx
    assert cells.sum() == pytest.approx((kick.side / 2) ** 2 * kick.height, rel=1e-12)
    assert cells.min() > 0  # no cell turned inside out


@pytest.mark.parametrize("change", [{}, {"refine": 3}, {"order": 2}, {"ring_spacing": 25e-6}])
def test_ring_nodes_lie_on_their_circles_at_equal_angles(change):
    kick = Chip(mesh=change)
    mesh = kick_mesh(kick)
    assert len(mesh.rings) == kick.mesh.rings + 1
    for number, ring in enumerate(mesh.rings):
        x, y = mesh.plane[ring].T
        np.testing.assert_allclose(np.hypot(x, y), number * kick.mesh.ring_spacing, atol=1e-18)
        if number:
            np.testing.assert_allclose(np.arctan2(y, x), np.linspace(0, np.pi / 2, len(ring)))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"ring_spacing": 300e-6}, "contact ring beyond the chip"),
        ({"rings": 40}, "contact ring beyond the chip"),
        ({"sectors": 9}, "even number"),
    ],
)
def test_meshes_that_cannot_be_are_refused(change, words):
    with pytest.raises(UsageError, match=words):
        kick_mesh(Chip(mesh=change))
