"""State space of models of every form: the same transfer function, in coordinates of the energy."""

import re

import numpy as np
import pytest

from kc2spice.core.errors import UsageError
from kc2spice.rom.linear import Certificate, LinearModel, Port
from kc2spice.spice.realize import subcircuit

N = 6
RNG = np.random.default_rng(5)


def definite(rank=N, n=N):
    root = RNG.standard_normal((n, rank))
    return root @ root.T


B, C, D = RNG.standard_normal((N, 2)), RNG.standard_normal((3, N)), RNG.standard_normal((3, 2))
K, M, E = definite() + np.eye(N), definite() + np.eye(N), 0.1 * definite()
SKEW = RNG.standard_normal((N, N))
HEAVY = np.diag([1.0, 2.0, 3.0, 0.0, 0.0, 0.0])
LIGHT = np.zeros((N, N))
LIGHT[:5, :5] = definite(5, 5)  # the last coordinate has neither mass nor damping
MODELS = {
    "definite": {"M": M, "E": E, "K": K},
    "lossless": {"M": M, "E": 0 * E, "K": K},
    "free": {"M": M, "E": E, "K": definite(N - 1)},
    "stiffness that is not symmetric": {"M": M, "E": E, "K": K + 0.1 * SKEW},
    "mass that is not symmetric": {"M": M + 0.1 * SKEW, "E": E, "K": K},
    "massless, damped": {"M": HEAVY, "E": E, "K": K},
    "massless, undamped": {"M": HEAVY, "E": np.diag([0.1] * 3 + [0.0] * 3), "K": K},
    "massless, one undamped": {"M": HEAVY, "E": LIGHT, "K": K + 0.1 * SKEW},
    "heat": {"E": M, "A": -K},
    "first order": {"E": M + 0.1 * SKEW, "A": -K + SKEW},
    "with algebraic equations": {"E": HEAVY + 0.2 * HEAVY @ SKEW @ HEAVY, "A": -K + SKEW},
}


@pytest.mark.parametrize("name", MODELS)
def test_the_transfer_function_is_that_of_the_matrices(name):
    parts = MODELS[name]
    a, b, c, d = LinearModel(**parts, B=B, C=C, D=D).state_space()
    for s in (0.3j, 1.0 + 2.0j, 40.0j):
        if "A" in parts:
            P = s * parts["E"] - parts["A"]
        else:
            P = s**2 * parts["M"] + s * parts["E"] + parts["K"]
        found = c @ np.linalg.solve(s * np.eye(len(a)) - a, b) + d
        np.testing.assert_allclose(found, C @ np.linalg.solve(P, B) + D, rtol=1e-8, atol=1e-9)


def test_energy_shows_in_the_form():
    def of(name, **change):
        return LinearModel(**MODELS[name] | change, B=B, C=C).state_space()[0]

    lossless, heat, lossy = of("lossless"), of("heat"), of("definite")
    np.testing.assert_allclose(lossless, -lossless.T, atol=1e-12 * abs(lossless).max())
    assert (heat == heat.T).all()
    assert np.linalg.eigvalsh(lossy + lossy.T).max() < 1e-12 * abs(lossy).max()
    modal = of("definite", E=0.1 * M + 0.02 * K)
    blocks = np.kron(np.eye(N), np.ones((2, 2)))
    assert (modal[blocks == 0] == 0).all()


@pytest.mark.parametrize(
    ("parts", "says"),
    [
        ({"M": np.triu(HEAVY + np.eye(N, k=1)), "E": E, "K": K}, "singular and not symmetric"),
        ({"M": HEAVY, "E": 0 * E, "K": np.diag([1.0] * 5 + [0.0])}, "without stiffness"),
        ({"M": HEAVY, "E": np.eye(N, k=3) + np.eye(N, k=-3), "K": K}, "coupled by damping alone"),
        ({"E": HEAVY, "A": -np.diag([1.0] * 5 + [0.0])}, "do not determine"),
    ],
)
def test_what_has_no_state_space_is_refused(parts, says):
    with pytest.raises(UsageError, match=says):
        LinearModel(**parts, B=B, C=C).state_space()


@pytest.mark.parametrize("omega", [0.1, 1e6])
def test_a_turning_pair_of_a_netlist_is_balanced_however_slow(omega):
    """``z1' = a z1 + w z2``, ``z2' = -w z1 + a z2``, each over the same capacitance."""
    A = omega * np.array([[-0.1, 4.0], [-0.25, -0.1]])
    slow = LinearModel(E=np.eye(2), A=A, B=np.ones((2, 1)), C=np.ones((1, 2)))
    values = dict(re.findall(r"(?m)^([GC][az]\S+) .* (\S+)$", subcircuit(slow, "slow").text))
    over, back, farad = (float(values[card]) for card in ("Ga1_2", "Ga2_1", "Cz1"))
    assert farad == float(values["Cz2"])
    assert over / farad == pytest.approx(omega, rel=1e-9)
    assert back == pytest.approx(-over, rel=1e-9)


def test_kinds_of_ports_that_files_spell_are_known():
    kinds = {"u1": ["in", "put"], "tip": ["mechan", "ical"], "y1": ["out", "put"]}
    ports = [Port(name, "".join(spelled)) for name, spelled in kinds.items()]
    model = LinearModel(M=M, K=K, B=B, C=C[:2], ports=tuple(ports))
    assert (model.inputs, model.outputs) == (("u1", "tip"), ("tip", "y1"))


def scaled_blocks(K, top=None, **more):
    """A of unit masses on ``K``; ``top`` [Hz] is the end of a certificate's band."""
    known = None if top is None else Certificate((0.0, top), 1e-3, "told", True, True)
    one = np.eye(len(K))
    parts = {"M": one, "K": np.asarray(K, dtype=float), "B": one, "C": one} | more
    return LinearModel(**parts, certificate=known).state_space()[0]


def test_positions_are_scaled_by_their_own_frequency_or_the_band():
    """Both states of a mode are velocities: ``w z`` and ``z'``; of a free mass ``2 pi f z``."""
    np.testing.assert_allclose(scaled_blocks([[9.0]], 5.0), [[0, 3], [-3, 0]])
    np.testing.assert_allclose(scaled_blocks([[0.0]], 5.0), [[0, 10 * np.pi], [0, 0]])
    np.testing.assert_allclose(scaled_blocks([[0.0]]), [[0, 1], [0, 0]])
    both = scaled_blocks(np.diag([0.0, 16.0]))
    exact = np.zeros((4, 4))
    exact[0, 1] = exact[2, 3] = 4.0  # the root of the largest stiffness over mass
    exact[3, 2] = -4.0
    np.testing.assert_allclose(both, exact, atol=1e-12)
    growing = scaled_blocks([[-9.0]])
    np.testing.assert_allclose(growing, [[0, 3], [3, 0]])
    circulating = np.array([[4.0, 1.0], [0.0, 4.0]])
    A = scaled_blocks(circulating, 0.5)
    np.testing.assert_allclose(A[[0, 2], [1, 3]], np.pi)
    np.testing.assert_allclose(A[np.ix_([1, 3], [0, 2])], -circulating / np.pi)
    M = np.array([[1.0, 0.5], [0.0, 2.0]])
    A = scaled_blocks(np.diag([4.0, 9.0]), 0.5, M=M, E=0.1 * np.eye(2))
    np.testing.assert_allclose(A[:2], [[0, 0, np.pi, 0], [0, 0, 0, np.pi]])
    np.testing.assert_allclose(M @ A[2:, :2], -np.diag([4.0, 9.0]) / np.pi)
    np.testing.assert_allclose(M @ A[2:, 2:], -0.1 * np.eye(2))


@pytest.mark.parametrize("share", [0.9e-13, 1.1e-13])
def test_a_stiffness_that_is_rounding_at_the_end_of_the_band_is_none(share):
    omega = 100 * np.pi
    w = omega if share < 1e-13 else omega * np.sqrt(share)
    exact = [[0, w], [0 if share < 1e-13 else -w, 0]]
    np.testing.assert_allclose(scaled_blocks([[share * omega**2]], 50.0), exact)


@pytest.mark.parametrize("unit", [1.0, 1e-3, 10.0])
@pytest.mark.parametrize(("mass", "states"), [(0.9e-13, 5), (1.1e-13, 6)])
def test_a_mass_that_is_rounding_of_another_is_none(mass, states, unit):
    """A damped coordinate without mass is of first order."""
    M, E, K = (unit * np.diag(P) for P in ([1, 0.5, mass], [0.1, 0.1, 0.5], [4, 9, 1.0]))
    A = scaled_blocks(K, M=M, E=E)
    assert len(A) == states
    assert np.abs(np.linalg.eigvals(A) + 2.0).min() < (1e-6 if states == 5 else 1e-3)


@pytest.mark.parametrize("unit", [1.0, 10.0])
@pytest.mark.parametrize(("damp", "states"), [(0.9e-13, 2), (-0.9e-13, 2), (1.1e-13, 3)])
def test_a_damping_that_is_rounding_of_another_is_none(damp, states, unit):
    """Of a coordinate without mass, which then follows at once."""
    M, E, K = (unit * np.diag(P) for P in ([1.0, 0.0], [5.0, 5 * damp], [4.0, 1.0]))
    assert len(scaled_blocks(K, M=M, E=E)) == states


@pytest.mark.parametrize("unit", [0.1, 10.0])
@pytest.mark.parametrize(("share", "states"), [(0.9e-13, 2), (1.1e-13, 3)])
def test_an_equation_whose_rate_is_rounding_of_another_is_algebraic(share, states, unit):
    E = unit * np.diag([1.0, 0.5, share])
    for each in (E, E[[1, 0, 2]]):  # symmetric or not
        A = LinearModel(E=each, A=-unit * np.eye(3), B=np.eye(3)).state_space()[0]
        assert len(A) == states


@pytest.mark.parametrize("unit", [0.1, 10.0])
@pytest.mark.parametrize(("apart", "equal"), [(1.8e-10, True), (2.2e-10, False)])
def test_first_order_is_symmetric_but_for_rounding(apart, equal, unit):
    one = np.eye(2)
    A = -unit * np.array([[2.0, 1.0], [1.0 + apart, 2.0]])
    found = LinearModel(E=4 * one, A=A, B=one).state_space()[0]
    assert np.array_equal(found, found.T) is equal


def test_low_modes_keep_their_digits_beside_stiff_ones():
    """Twelve decades of stiffness: the product of both eigenvalues is the determinant. The stiff
    one, far beyond any band, may lose what the low one keeps."""
    a, b, c = 1.0, 0.3e6, 1e12
    high = 0.5 * (a + c + np.hypot(a - c, 2 * b))
    poles = np.sort(np.linalg.eigvals(scaled_blocks([[a, b], [b, c]])).imag)[2:]
    assert poles[0] == pytest.approx(np.sqrt((a * c - b * b) / high), rel=1e-9)
    assert poles[1] == pytest.approx(np.sqrt(high), rel=1e-4)


def test_coupling_that_is_rounding_is_left_out():
    for between, whole in ((1e-11, False), (1e-9, True)):
        E = np.array([[0.1, between], [between, 0.1]])
        A = scaled_blocks(np.diag([1.0, 4.0]), E=E)
        assert bool(A[1, 3]) is whole
