"""The table of the catch actuator: evaluation, coenergy, files, bad input."""

import numpy as np
import pytest

from kc2spice.core.errors import SimulationError, UsageError
from kc2spice.fem.magnetics import table as emtable
from kc2spice.fem.magnetics.field import catch_table, coil_resistance
from kc2spice.fem.magnetics.keys import Catch
from kc2spice.fem.magnetics.table import EMTable


@pytest.fixture
def table() -> EMTable:
    """A smooth actuator in closed form: c = d(flux)/dy, c11 = dL11/dy / 2, c12 = dM/dy."""
    y = np.linspace(-1.0, 1.0, 21)
    flux0 = np.column_stack([np.sin(y), np.cos(y)])
    own, mutual = 3 + 0.1 * np.sin(2 * y), 1 + 0.1 * np.cos(y)
    inductance = np.stack([np.stack([own, mutual], -1), np.stack([mutual, own], -1)], -1)
    return EMTable(
        y=y,
        c0=y**3,
        c1=np.cos(y),
        c2=-np.sin(y),
        c11=0.1 * np.cos(2 * y),
        c12=-0.1 * np.sin(y),
        c22=0.1 * np.cos(2 * y),
        flux0=flux0,
        inductance=inductance,
        resistance=np.array([1.0, 2.0]),
        unknowns=7,
    )


def flux_linkage(table: EMTable, y: np.ndarray, *currents: np.ndarray | float) -> np.ndarray:
    """What the coils of the subcircuit link: ``dF / di`` integrated, and ``L i``."""
    _, f1, f2, *_ = np.moveaxis(table.potentials(y), -1, 0)
    i = np.stack(np.broadcast_arrays(*currents), axis=-1)
    return np.stack([f1, f2], -1) + np.squeeze(emtable.inductances(table, y) @ i[..., None], -1)


def test_flux_slope_is_force_slope(table: EMTable) -> None:
    """d lambda_k / dy = dF / di_k between the nodes, which is what conserves energy."""
    y, step, i = np.linspace(-0.97, 0.93, 39), 1e-4, np.array([0.3, -0.8])
    flux = [flux_linkage(table, y + s, *i) for s in (step, -step)]
    by_y = (flux[0] - flux[1]) / (2 * step)
    for k in range(2):
        probe = np.eye(2)[k] * 0.5
        by_i = emtable.force(table, y, *(i + probe)) - emtable.force(table, y, *(i - probe))
        np.testing.assert_allclose(by_y[:, k], by_i, atol=1e-8)  # differences: step^2


def test_no_energy_is_gained_on_a_closed_path(table: EMTable) -> None:
    """Electrical work in equals mechanical work out around a loop in (y, i1, i2)."""
    s = 2 * np.pi * np.arange(4000) / 4000
    y, i1, i2 = 0.6 * np.sin(s), 0.5 + np.cos(s), np.sin(2 * s)
    ahead = [np.roll(x, -1) for x in (y, i1, i2)]
    flux = flux_linkage(table, y, i1, i2)
    flux_step = flux_linkage(table, *ahead) - flux
    middle = [(a + b) / 2 for a, b in zip((y, i1, i2), ahead, strict=True)]
    electrical = np.sum(flux_step * np.column_stack(middle[1:]))
    mechanical = np.sum(emtable.force(table, *middle) * (ahead[0] - y))
    assert abs(mechanical) > 0.1
    assert electrical == pytest.approx(mechanical, rel=1e-5)  # midpoint rule on 4000 steps


@pytest.mark.parametrize("y", [-1.1, 1.0001, np.nan, np.array([0.0, 2.0])])
def test_outside_the_table_raises(table: EMTable, y: object) -> None:
    with pytest.raises(SimulationError, match="outside the table"):
        emtable.coefficients(table, y)


def test_resistance_of_the_winding() -> None:
    catch = Catch()
    assert coil_resistance(catch, catch.lower) == pytest.approx(1596, abs=0.5)  # data: design note


def test_sphere_must_fit_and_stay_in_the_air() -> None:
    with pytest.raises(UsageError, match="does not fit"):
        catch_table(Catch(), 1.3e-3)
    with pytest.raises(UsageError, match="leaves the air"):
        catch_table(Catch(y_max=17e-3), 1e-3)
    with pytest.raises(UsageError, match="lower than what stands in it"):
        catch_table(Catch(air_height=5e-3), 1e-3)
