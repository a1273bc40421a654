"""The catch with real coils, in decks that only include its library, against closed forms."""

import numpy as np
import pytest
from device import bench
from scipy.integrate import solve_ivp

from kc2spice.fem.magnetics.table import EMTable, force, inductances
from kc2spice.parts.ring_magnet_coils import coil_subcircuit
from kc2spice.parts.sphere import SphereKeys, sphere_subcircuit
from kc2spice.sim.ngspice import run_deck

L0, M0, R0 = 43.8e-3, 7.3e-3, 1596.0
MASS = SphereKeys().mass


@pytest.fixture(scope="module")
def coils() -> EMTable:
    """Coils whose inductances vary by 5 %, ten times the catch's, with the force that follows."""
    y = np.linspace(-2.5e-3, 7.5e-3, 41)

    def bell(at, width):
        u = (y - at) / width
        return np.exp(-(u**2)), -2 * u / width * np.exp(-(u**2))

    (a1, d1), (a2, d2), (am, dm) = bell(1e-3, 2e-3), bell(4e-3, 2e-3), bell(2.5e-3, 3e-3)
    change = 0.05 * L0
    flux = 0.7e-3 * np.column_stack([a1, a2])
    inductance = np.empty((41, 2, 2))
    inductance[:, 0, 0], inductance[:, 1, 1] = L0 + change * a1, L0 + change * a2
    inductance[:, 0, 1] = inductance[:, 1, 0] = M0 + 0.3 * change * am
    return EMTable(
        y=y, c0=1e-3 * dm * 1e-3, c1=0.7e-3 * d1, c2=0.7e-3 * d2,
        c11=change * d1 / 2, c12=0.3 * change * dm, c22=change * d2 / 2,
        flux0=flux, inductance=inductance, resistance=np.array([R0, R0]), unknowns=0,
    )  # fmt: skip


# Thick wire of 50 Ohm, so that heat does not hide the work on the sphere.
FLIGHT = """Vlower lp 0 PULSE(0 6 2e-4 1e-6 1e-6 3e-4 6e-4)
Vupper up 0 PULSE(0 -4 1e-4 1e-6 1e-6 4e-4 7e-4)
Xcoil lp 0 up 0 y v 0 coil resistance_lower=50 resistance_upper=50
Xsphere v bottom y 0 sphere
.options reltol=1e-5 trtol=1 chgtol=1e-10
.tran 1e-6 2e-3 0 4e-7 uic"""
VECTORS = {
    "y": ("v(y)", 1e-6), "v": ("v(v)", 1.0),
    "v1": ("v(lp)", 1.0), "v2": ("v(up)", 1.0),
    "i1": ("v(xcoil.i1)", 1.0), "i2": ("v(xcoil.i2)", 1.0),
}  # fmt: skip


@pytest.fixture(scope="module")
def flight(header, coils, tmp_path_factory):
    sphere = sphere_subcircuit(header, MASS, 1e-3, 9.81, velocity=1.0, height=0.3e-3)
    deck = bench([coil_subcircuit(header, coils), sphere], FLIGHT, VECTORS, 2e-3)
    return run_deck(deck, tmp_path_factory.mktemp("flight"))


def test_flight_is_that_of_lagranges_equations(flight, coils):
    """Flux linkages integrated in scipy with the table's own splines."""
    resistance = np.array([50.0, 50.0])

    def volts(t):
        lower = 6.0 * np.interp((t - 2e-4) % 6e-4, [0, 1e-6, 3.01e-4, 3.02e-4], [0, 1, 1, 0])
        upper = -4.0 * np.interp((t - 1e-4) % 7e-4, [0, 1e-6, 4.01e-4, 4.02e-4], [0, 1, 1, 0])
        return np.array([lower * (t > 2e-4), upper * (t > 1e-4)])

    def rates(t, state):
        y, v, flux = state[0], state[1], state[2:]
        own = np.array([coils.potentials(y)[1], coils.potentials(y)[2]])
        i = np.linalg.solve(inductances(coils, y), flux - own)
        pull = force(coils, y, *i) / MASS - 9.81
        return np.concatenate([[v, pull], volts(t) - resistance * i])

    y0 = 1.3e-3
    start = np.concatenate([[y0, 1.0], coils.potentials(y0)[1:3]])
    exact = solve_ivp(rates, (0, 2e-3), start, "LSODA", rtol=1e-9, atol=1e-13, max_step=1e-6,
                      t_eval=np.linspace(0, 2e-3, 201))  # fmt: skip
    ours = np.interp(exact.t, flight["time"], flight["y"])
    assert np.abs(ours - exact.y[0]).max() < 0.1e-6  # of millimetres, through an unstable field
    speed = np.interp(exact.t, flight["time"], flight["v"])
    assert np.abs(speed - exact.y[1]).max() < 2e-4 * np.abs(exact.y[1]).max()
