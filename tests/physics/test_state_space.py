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


def test_low_modes_keep_their_digits_beside_stiff_ones():
    """Twelve decades of stiffness: the product of both eigenvalues is the determinant. The stiff
    one, far beyond any band, may lose what the low one keeps."""
    a, b, c = 1.0, 0.3e6, 1e12
    high = 0.5 * (a + c + np.hypot(a - c, 2 * b))
    poles = np.sort(np.linalg.eigvals(scaled_blocks([[a, b], [b, c]])).imag)[2:]
    assert poles[0] == pytest.approx(np.sqrt((a * c - b * b) / high), rel=1e-9)
    assert poles[1] == pytest.approx(np.sqrt(high), rel=1e-4)
