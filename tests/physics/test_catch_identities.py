"""Identities that the catch actuator's discrete field must keep, whatever the mesh."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from skfem import Basis, ElementTriP2, Functional
from support import LOWER, SPHERE, CatchKeys, compute_magnetostatic_table, make_field_assembler
from support import magnet_field as magmesh

RADIUS = 1e-3


@pytest.mark.slow
def test_polarity_reverses_only_the_ring_magnet() -> None:
    span = {"y_min": -2.5e-3, "y_max": 7.5e-3, "positions": 5}
    table, turned = (
        compute_magnetostatic_table(CatchKeys(polarity=way, **span), RADIUS)
        for way in ("parallel", "antiparallel")
    )
    # The ring's pull on the sphere as magnetised by a coil turns too: 3e-3 of c1 at mu_r 1.06.
    np.testing.assert_allclose(turned.coefficients[:, 1], table.coefficients[:, 1], rtol=1e-2)
    c0, other = table.coefficients[:, 0], turned.coefficients[:, 0]
    # What is left after the sign is the sphere's pull on the permeable ring and the mesh's error.
    assert np.max(np.abs(other + c0)) < 5e-3 * np.max(np.abs(c0))


@pytest.mark.slow
def test_force_is_the_slope_of_flux_and_inductance() -> None:
    # Positions every 62.5 um so that the derivative of a spline is no limit.
    table = compute_magnetostatic_table(
        CatchKeys(y_min=-0.5e-3, y_max=1.5e-3, positions=33), RADIUS
    )
    inner = slice(3, -3)
    flux = CubicSpline(table.y, table.flux0)(table.y, 1)[inner]
    inductance = CubicSpline(table.y, table.inductance)(table.y, 1)[inner]
    own, mutual = inductance[:, (0, 1), (0, 1)] / 2, inductance[:, 0, 1]
    slopes = (*flux.T, own[:, 0], mutual, own[:, 1])
    for k, slope in enumerate(slopes, 1):
        got = table.coefficients[inner, k]
        # Virtual work and flux come from different integrals; they meet as the mesh error goes.
        assert np.max(np.abs(got - slope)) < 1e-4 * np.max(np.abs(slope)), k


def test_coil_is_pushed_back() -> None:
    """Lorentz force on the lower coil in the sphere's field, which the shell knows nothing of."""
    catch = CatchKeys(mu_r=1.0, air_radius=0.1, air_height=0.3)
    pitch = magmesh.choose_lattice_pitch(catch, RADIUS, 0.25e-3)
    bore = magmesh.make_bore(catch, RADIUS, pitch, 0.0, 1e-3)
    system = make_field_assembler(catch, bore)(1e-3 - 4 * pitch)
    fields = system.solve(system.loads)
    stator = magmesh.mesh_stator(catch, bore)
    r, y = stator.p[:, stator.t].mean(axis=1)
    coil = catch.lower
    inside = (r > coil.inner) & (r < coil.outer) & (np.abs(y - coil.y) < coil.height / 2)
    basis = Basis(stator, ElementTriP2(), intorder=6, elements=np.flatnonzero(inside))
    density = catch.turns / ((coil.outer - coil.inner) * coil.height)

    @Functional
    def lorentz(w):  # J x B along y: -J B_r with B_r = -r da/dy
        return 2 * np.pi * w.x[0] ** 2 * density * w["a"].grad[1]

    of_sphere = basis.interpolate(fields[: basis.N, SPHERE])
    on_coil = lorentz.assemble(basis, a=of_sphere)
    c1 = 2 * system.compute_force_matrix(fields)[SPHERE, LOWER]
    assert abs(c1) > 0.1
    assert on_coil == pytest.approx(-c1, rel=1e-4)
