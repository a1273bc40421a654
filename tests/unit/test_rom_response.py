"""Where a response is looked at, and how errors are measured, against closed forms."""

import numpy as np
import pytest

from kc2spice.core.errors import SimulationError
from kc2spice.rom.linear import LinearModel, Port
from kc2spice.rom.pencil import Pencil
from kc2spice.rom.response import (
    FLANK,
    FLOOR,
    Judge,
    Response,
    above_band,
    relative_error,
    relative_size,
    telling,
)  # fmt: skip

TWO_PI = 2 * np.pi


def resonators(hertz, ratio, B, C=None, D=None):
    """Pencil of unit masses on springs, resonant at ``hertz``."""
    w = TWO_PI * np.asarray(hertz, dtype=float)
    B = np.asarray(B, dtype=float)
    C = B.T if C is None else np.asarray(C, dtype=float)
    D = np.zeros((len(C), B.shape[1])) if D is None else np.asarray(D, dtype=float)
    parts = np.diag(w**2), np.diag(2 * np.broadcast_to(ratio, w.shape) * w), np.eye(len(w))
    return Pencil(parts, B, C, D)


def direct(pencil, s):
    """``C P(s)^-1 B + D`` by numpy's solver."""
    P = sum(s[:, None, None] ** k * each for k, each in enumerate(pencil.coefficients))
    return pencil.C @ np.linalg.solve(P, pencil.B.astype(complex)[None]) + pencil.D


# ------------------------------------------------------------------------------- frequencies


@pytest.mark.parametrize("entry", [(0, 0), (0, 1), (1, 1)])
def test_telling_frequencies_are_close_to_each_notch_and_resonance(entry):
    """``1/(a^2 - w^2) + r/(b^2 - w^2)`` is zero at ``w^2 = (b^2 + r a^2)/(1 + r)``."""
    a, b = 23.0, 71.0
    B = np.array([[1.0, 1.0], [1.0, 3.0]])
    response = Response(resonators([a, b], 0.0, B))
    r = (B[:, entry[0]] * B[:, entry[1]])[1]
    notch = np.sqrt((b**2 + r * a**2) / (1 + r))
    band = 0.0, 100.0
    frequency = telling(response, band, True)
    assert frequency[0] == 0.0
    assert (np.diff(frequency) > 0).all()
    assert frequency[-1] == 100.0
    size = np.abs(response.transfer(2j * np.pi * frequency))[:, *entry]
    near = np.abs(frequency - notch).argmin()
    assert (
        size[near] < FLOOR * size.max()
    )  # where a notch is deeper, errors count against the floor
    for pole in (a, b):
        assert np.abs(frequency / pole - 1).min() == pytest.approx(FLANK, rel=0.03)


def test_each_of_many_notches_is_found():
    """Between two resonances of a driving point lies a zero: 149 of them in the band."""
    hertz = np.arange(1.0, 151.0)
    response = Response(resonators(hertz, 0.0, np.ones((150, 1))))
    frequency = telling(response, (0.5, 150.5), False)
    size = np.abs(response.transfer(2j * np.pi * frequency))[:, 0, 0]
    between = (np.floor(frequency) == each for each in hertz[:-1])
    assert max(size[inside].min() for inside in between) < FLOOR * size.max()
    assert (np.diff(frequency) > 1e-12 * frequency[1:]).all()  # or a maximum hides beside its twin


# --------------------------------------------------------------------------------- responses


def full(n, rng):
    return rng.standard_normal((n, n)) + 3 * n * np.eye(n)


@pytest.mark.parametrize("n", [3, 13, 30])
@pytest.mark.parametrize("form", ["decoupled", "coupled", "first order", "heat", "free"])
def test_a_response_is_that_of_the_matrices(form, n):
    rng = np.random.default_rng(n)
    root, other = rng.standard_normal((2, n, n))
    K, M = root @ root.T + np.eye(n), other @ other.T + np.eye(n)
    parts = {
        "decoupled": (K, 0.01 * K + 0.1 * M, M),
        "coupled": (K, 0.1 * full(n, rng), M),
        "first order": (full(n, rng), full(n, rng)),
        "heat": (K, M),
        "free": (root[:, 1:] @ root[:, 1:].T, 0 * K, M),
    }[form]
    pencil = Pencil(parts, *(rng.standard_normal(s) for s in ((n, 2), (3, n), (3, 2))))
    response = Response(pencil)
    assert response.decoupled is (form in ("decoupled", "heat", "free"))
    assert (response.modes is None) is (n == 3 and not response.decoupled)
    s = np.array([0.3j, 1.0 + 2j, 20j])
    exact = direct(pencil, s)
    np.testing.assert_allclose(response.transfer(s), exact, rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(
        pencil.C @ response.states(s) + pencil.D, exact, rtol=1e-8, atol=1e-10
    )


@pytest.mark.parametrize("free", [1, 2])
def test_modes_that_cost_next_to_nothing_do_not_drown_the_others(free):
    """Chains apart, each held as a whole by a spring that is rounding of its links; the sum over
    their modes."""
    n = 8
    links = np.eye(n - 1, n) - np.eye(n - 1, n, k=1)
    if free == 2:
        links[n // 2 - 1] = 0.0
    hold = np.kron(np.eye(free), np.ones((n // free, n // free))) * 1e-14
    K = links.T @ links + hold
    pencil = Pencil((K, 0 * K, np.eye(n)), np.eye(n)[:, [0]], np.eye(n)[[1]], np.zeros((1, 1)))
    found = Response(pencil)
    assert found.decoupled
    values, phi = np.linalg.eigh(links.T @ links)
    s = 1j * np.array([1e-3, 0.1, 1.0, 5.0])
    exact = (phi[0] * phi[1] / (s[:, None] ** 2 + values * (values > 1e-12))).sum(axis=1)
    np.testing.assert_allclose(found.transfer(s)[:, 0, 0], exact, rtol=1e-7)


def test_a_defective_model_is_not_taken_apart():
    """A chain of equal first-order lags has one eigenvector; that of a free mass has two poles."""
    n = 14
    lags = Pencil((np.eye(n) - np.eye(n, k=1), np.eye(n)), np.eye(n)[:, [-1]], np.eye(n)[[0]],
                  np.zeros((1, 1)))  # fmt: skip
    response = Response(lags)
    assert response.modes is None
    np.testing.assert_allclose(response.transfer(np.array([1j]))[0, 0, 0], (1 + 1j) ** -n)


def test_eigenvectors_that_cost_digits_are_not_used():
    """Of lags of nearly equal rates, condition 1e8."""
    n = 14
    rates = 1 + 0.1 * np.arange(n)
    pencil = Pencil((np.diag(rates) - np.eye(n, k=1), np.eye(n)), np.eye(n)[:, [-1]],
                    np.eye(n)[[0]], np.zeros((1, 1)))  # fmt: skip
    exact = 1 / np.prod(1j + rates)
    assert Response(pencil).transfer(np.array([1j]))[0, 0, 0] == pytest.approx(exact, rel=1e-9)


# ------------------------------------------------------------------------------------ errors


def test_errors_are_relative_to_the_entry_or_to_a_part_of_its_peak():
    reference = np.array([[2.0, 0.0], [-1e-9, 0.0], [4j, 0.0]])[:, :, None]
    apart = np.array([[0.5, 0.0], [8e-9, 0.0], [1.0, 0.0]])[:, :, None]
    size = relative_size(apart, reference)
    np.testing.assert_allclose(size[:, 0, 0], [0.25, 8e-9 / (4 * FLOOR), 0.25])
    assert not size[:, 1].any()
    assert relative_error(reference + apart, reference) == pytest.approx(0.25)
    assert relative_error(np.zeros((3, 0, 1)), np.zeros((3, 0, 1))) == 0.0


def bent(pencil, size, hertz, width):
    """``pencil`` whose response is off by up to about ``size`` around ``hertz``."""

    class Bent(Response):
        def transfer(self, s):
            off = size * np.exp(-(((s.imag / TWO_PI - hertz) / width) ** 2))
            return super().transfer(s) * (1 + off[:, None, None])

    return Bent(pencil)


def test_the_largest_error_is_found_between_the_frequencies():
    pencil = resonators([1000.0], 0.1, [[1.0]])
    judge = Judge(Response(pencil), np.linspace(0.0, 100.0, 11), (0.0, 100.0))
    between = judge.error(bent(pencil, 1e-3, 54.4, 3.0))  # the nearest see 1.1e-4 and 2.9e-5
    assert between == pytest.approx(1e-3, rel=1e-3)
    fine = Judge(Response(pencil), np.linspace(0.0, 100.0, 201), (0.0, 100.0))
    for hertz in (0.2, 99.8):  # beside the first or the last one
        assert fine.error(bent(pencil, 1e-3, hertz, 0.15)) == pytest.approx(1e-3, rel=1e-2)
    for hertz in (-1.0, 101.0):  # at an end it is largest there
        at_the_end = judge.error(bent(pencil, 1e-3, hertz, 3.0))
        assert at_the_end == pytest.approx(1e-3 * np.exp(-1 / 9), rel=1e-6)
    assert judge.error(Response(pencil)) == 0.0


# kinds as files spell them: equal words, not the same objects
PORTS = tuple(Port(name, "".join(list(kind))) for name, kind in
              (("drive", "input"), ("tip", "mechanical"), ("reading", "output"),
               ("anode", "electrical"), ("turn", "rotational")))  # fmt: skip


def test_the_error_above_the_band_is_that_of_each_mechanical_ports_own_compliance():
    columns, rows = (0, 1, 2, 3), (1, 3, 2, 0)  # of drive, tip, anode, turn; tip, reading, …
    own = np.diag([1.0, 2.0, 3.0, 4.0])
    exact = resonators([20.0, 21.0, 22.0, 20.0 + 1e-9], 1e-2, own[:, columns], own[rows, :])
    # rows: tip from unknown 1, reading from 3, anode from 2, turn from 0 (with the drive's)
    B, C = exact.B.copy(), exact.C.copy()
    B[0, 3] = 5.0  # the turn moves unknown 0, which its row reads
    exact = Pencil(exact.coefficients, B, C, exact.D)
    wrong = C.copy()
    wrong[0] *= 1.25  # tip
    wrong[1] *= 9.0  # reading
    wrong[2] *= 7.0  # anode
    wrong[3] *= 1 - 0.125  # turn
    found = Pencil(exact.coefficients, B, wrong, exact.D)
    judged = above_band(PORTS, Response(exact), Response(found), (0.0, 5.0))
    assert judged == (pytest.approx((10.0, 0.25)), pytest.approx((20.0, 0.25)))
    signals = (PORTS[0], PORTS[3])
    assert above_band(signals, Response(exact), Response(found), (0.0, 5.0)) == ()


def test_a_pole_among_the_frequencies_is_an_error():
    with pytest.raises(SimulationError, match="pole"):
        LinearModel(M=np.eye(1), K=np.zeros((1, 1)), B=np.eye(1)).transfer(np.zeros(1))
