"""Steps of a reduction by themselves: which order, which directions, how far a basis reaches."""

import warnings
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import sparse

import kc2spice.rom.reduce as module
from kc2spice.core.errors import SimulationError, UsageError
from kc2spice.rom.band import natural_band
from kc2spice.rom.krylov import block_arnoldi, extend
from kc2spice.rom.linear import LinearModel, Port
from kc2spice.rom.memory import factor_bytes, require_memory
from kc2spice.rom.pencil import Pencil
from kc2spice.rom.reduce import Reduction, ordered, reduce
from kc2spice.rom.response import Response, grid, relative_size
from kc2spice.rom.structure import semidefinite, structure
from kc2spice.rom.subspace import (
    FLOOR,
    Subspace,
    _independent,
    _modes,
    _rational,
    _Search,
    _Sketch,
    _solution_error,
    _telling_quickly,
    _whole,
    _with_rounding,
    is_definite,
    subspace,
)  # fmt: skip
from kc2spice.rom.surrogate import surrogate

RNG = np.random.default_rng(8)


def definite(n, rank=None):
    root = RNG.standard_normal((n, rank or n))
    return root @ root.T


def chain(n, dashpot=0.0, rayleighed=False, **more):
    K = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    E = 1e-2 * K
    E[0, 0] += dashpot
    if rayleighed:
        return LinearModel(M=np.eye(n), K=K, B=np.eye(n)[:, [n // 5, n - 1]], rayleigh=(0.0, 1e-2))
    return LinearModel(M=np.eye(n), E=E, K=K, B=np.eye(n)[:, [n // 5, n - 1]], **more)


# ------------------------------------------------------------------------- which order is taken


class Told(Reduction):
    """A reduction whose errors and stability are told, not measured."""

    def __init__(self, size, good, stable=lambda order: True, first=0):
        self.__dict__.update(told=size, good=good, steady=stable, first=first)

    size = property(lambda self: self.told)

    def error(self, order):
        return 1e-5 if self.good(order) else 1e-2

    def structure(self, order):
        return SimpleNamespace(stable=self.steady(order))


@pytest.mark.parametrize(("own", "apart"), [(1e-5, 2e-3), (3e-4, 1e-4), (0.0, 1e-12)])
def test_an_estimate_has_the_subspaces_error_and_a_margin_on_the_difference(own, apart):
    """Never less than what direct solutions differ by."""
    one = chain(3).pencil
    found = object.__new__(Reduction)
    judge = SimpleNamespace(error=lambda less: apart * less.pencil.size)
    found.__dict__.update(pencil=one, space=SimpleNamespace(error=own), _judge=judge)
    for order in (1, 3):
        error = found.error(order)
        assert max(1e-11, own + order * apart) <= error <= max(1e-11, own + 1.5 * order * apart)


@pytest.mark.parametrize("least", [1, 2, 7, 19, 20])
def test_the_smallest_order_within_the_tolerance_is_found(least):
    assert Told(20, lambda order: order >= least).smallest(1e-5) == least


@pytest.mark.parametrize("good", [{20}, {19}, {12}, {9, 10, 11, 12}, {4}])
def test_where_all_directions_miss_the_tolerance_fewer_by_a_power_of_two_are_tried(good):
    assert Told(20, good.__contains__).smallest(1e-3) == min(good)


@pytest.mark.parametrize("fewer", [2**9, 2**10])
def test_at_most_512_directions_are_left_out(fewer):
    told = Told(1100, {1100 - fewer}.__contains__)
    if fewer == 512:
        assert told.smallest(1e-3) == 1100 - 512
    else:
        with pytest.raises(SimulationError, match="out of reach"):
            told.smallest(1e-3)


def test_the_directions_of_conservative_ports_are_kept():
    assert Told(20, lambda order: True, first=5).smallest(1e-3) == 5
    assert Told(21, {5}.__contains__, first=5).smallest(1e-3) == 5
    assert Told(3, lambda order: True, first=5).smallest(1e-3) == 3
    for first in (5, 6):
        with pytest.raises(SimulationError, match="out of reach") as caught:
            Told(20, {4}.__contains__, first=first).smallest(1e-3)
    assert caught.value.got == "estimate 1.0e-02 with up to 20 states"


def test_a_stable_model_does_not_lose_its_stability():
    assert Told(20, lambda order: order >= 3, lambda order: order >= 8).smallest(1e-3) == 8
    assert Told(20, lambda order: order >= 3, lambda order: False).smallest(1e-3) == 3


# --------------------------------------------------------------------------- what is asked for


@pytest.mark.parametrize(
    ("asked", "says"),
    [
        ({}, "either a tolerance or an order"),
        ({"tolerance": 1e-3, "order": 3}, "either a tolerance or an order"),
        ({"tolerance": 0.9e-10}, "not a tolerance"),
        ({"tolerance": 1.0}, "not a tolerance"),
        ({"order": 0}, "not an order"),
        ({"order": 3, "band": (0.0, 0.0)}, "not a frequency band"),
        ({"order": 3, "band": (0.2, 0.1)}, "not a frequency band"),
        ({"order": 3, "band": (-0.1, 0.1)}, "not a frequency band"),
        ({"order": 3, "band": (0.0, np.inf)}, "not a frequency band"),
    ],
)
def test_what_cannot_be_asked_for_is_refused(asked, says):
    with pytest.raises(UsageError, match=says):
        reduce(chain(20, dashpot=0.3), **asked)


@pytest.mark.parametrize("without", ["B", "C"])
def test_a_model_without_effective_ports_is_refused(without):
    parts = {"B": np.ones((3, 1)), "C": np.ones((1, 3))}
    parts[without] = 0 * parts[without]
    with pytest.raises(UsageError, match="no effective input or output"):
        reduce(LinearModel(M=np.eye(3), K=np.eye(3), **parts), order=1, band=(0.0, 1.0))


def test_the_band_is_that_asked_for_or_the_models_own():
    model = chain(20, dashpot=0.3, band=(0.0, 0.02))
    assert reduce(model, order=4).certificate.band_hz == (0.0, 0.02)
    assert reduce(model, order=4, band=(0.0, 0.03)).certificate.band_hz == (0.0, 0.03)
    assert reduce(model, order=4).band == (0.0, 0.02)


@pytest.mark.parametrize("apart", [0.4, 0.6])
def test_half_of_the_tolerance_is_left_to_the_full_models_own_solutions(apart, monkeypatch):
    monkeypatch.setattr("kc2spice.rom.subspace._solution_error", lambda *_: apart * 1e-3)
    model, band = chain(20, dashpot=0.3), (0.0, 0.05)
    assert reduce(model, order=9, band=band).certificate.error_estimate > apart * 1e-3
    if apart < 0.5:
        rom = reduce(model, tolerance=1e-3, band=band)
        assert apart * 1e-3 < rom.certificate.error_estimate <= 1e-3
    else:
        with pytest.raises(SimulationError, match="not that accurate"):
            reduce(model, tolerance=1e-3, band=band)


@pytest.mark.parametrize(
    ("asked", "target"),
    [({"tolerance": 1e-3}, 2e-5), ({"tolerance": 1e-10}, 1e-11), ({"order": 5}, 1e-8)],
)
def test_the_subspace_is_far_more_accurate_than_asked(asked, target, monkeypatch):
    seen = []

    def asking(pencil, band, wanted, limit, solver):
        seen.append(wanted)
        return subspace(pencil, band, wanted, limit, solver)

    monkeypatch.setattr(module, "subspace", asking)
    reduce(chain(20, dashpot=0.3), band=(0.0, 0.05), **asked)
    assert seen == [pytest.approx(target)]


@pytest.mark.parametrize("form", ["neither", "symmetric", "collocated"])
def test_a_model_that_is_not_its_own_dual_takes_the_better_of_two_bases(form):
    """Of its inputs alone, and of inputs and outputs."""
    n, band = 14, (0.0, 0.3)
    rng = np.random.default_rng(1)
    one_way = form != "symmetric"
    A = -np.diag(np.geomspace(0.1, 30, n)) + 0.3 * one_way * np.diag(rng.standard_normal(13), 1)
    B = rng.standard_normal((n, 2))
    C = B.T if form == "collocated" else rng.standard_normal((1, n))
    model = LinearModel(A=A, B=B, C=C)
    space = subspace(model.pencil, band, 1e-9, np.inf, "scipy")
    both = [ordered(model, space, band, side, 1e-5) for side in (False, True)]
    orders = [each.smallest(1e-5) for each in both]
    assert reduce(model, tolerance=1e-5, band=band).order == min(orders)
    fixed = reduce(model, order=5, band=band).certificate.error_estimate
    errors = [each.error(5) for each in
              (ordered(model, space, band, side, None) for side in (False, True))]  # fmt: skip
    assert fixed == pytest.approx(min(errors), rel=1e-3)
    assert errors[0] != pytest.approx(errors[1], rel=1e-2)
    with pytest.raises(UsageError, match="no model of this order") as caught:
        reduce(model, order=15, band=band)
    assert caught.value.expected == "1 to 14"
    assert reduce(model, order=14, band=band).order == 14


def test_only_rounding_beyond_the_tolerance_is_warned_of():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        rom = reduce(chain(20, dashpot=0.3), tolerance=1e-6, band=(0.0, 0.05))
    assert rom.certificate.error_estimate >= 1e-11
    assert reduce(chain(20, dashpot=0.3), order=20, band=(0.0, 0.05)).certificate.error_estimate \
        == pytest.approx(1e-11, rel=1)  # fmt: skip


def test_an_order_of_a_definite_model_is_certified_by_two_blocks_more():
    """Rayleigh damping; the estimate is near the error of a direct solution."""
    n, order, band = 60, 12, (0.0, 0.03)
    model = chain(n)
    rom = reduce(model, order=order, band=band)
    assert rom.certificate.method.startswith(f"difference to {order + 2 * 2} states")
    s = 2j * np.pi * np.linspace(0, 0.03, 301)[:, None, None]

    def response(found):
        P = s * s * found.M + s * found.E + found.K
        return found.C @ np.linalg.solve(P, found.B.astype(complex)[None])

    exact = response(model)
    size = np.maximum(abs(exact), 1e-6 * abs(exact).max(axis=0))
    error = (abs(response(rom) - exact) / size).max()
    assert error <= rom.certificate.error_estimate <= 2 * error
    assert error > 1e-8


# --------------------------------------------------------------------------------- directions


@pytest.mark.parametrize("degree", [1, 2])
def test_the_energy_is_the_plain_square(degree):
    """That of the stiffness at rest; of a model that is free to move, that at a frequency."""
    n, omega = 5, 3.0
    K, M, free = definite(n) + np.eye(n), definite(n) + np.eye(n), definite(n, n - 1)
    M[0, 1] += 0.1  # the energy is that of the symmetric part
    rest = lambda P: 0.5 * (P + P.T)  # noqa: E731

    def basis(stiffness, static):
        parts = (stiffness, M) if degree == 1 else (stiffness, 0 * M, M)
        pencil = Pencil(parts, np.eye(n), np.eye(n), np.zeros((n, n)))
        return module._energy_basis(pencil, omega, static=static)

    for stiffness, static, energy in (
        (K, True, K),
        (K, False, K + omega**degree * M),
        (free, False, free + omega**degree * M),
        (free, True, free + omega**degree * M),  # rounding may let a factor of it pass
        (-0.01 * K, True, -0.01 * K + omega**degree * M),
    ):
        V = basis(stiffness, static)
        np.testing.assert_allclose(V.T @ rest(energy) @ V, np.eye(n), atol=1e-9)
    np.testing.assert_array_equal(basis(-1e3 * K, True), np.eye(n))


@pytest.mark.parametrize(
    ("tolerance", "share"), [(None, 4e-3), (1e-10, 4e-3), (1e-8, 1.2e-2), (1e-2, 5e-2)]
)
def test_samples_above_the_band_weigh_less_and_less(tolerance, share):
    response, band = Response(chain(3).pencil), (0.0, 0.01)
    plain = module._snapshots(response, band, True, False, tolerance)
    assert (plain[1] == 1).all()
    assert plain[0][0] == 0.0
    assert plain[0].max() == band[1]
    frequency, weight = module._snapshots(response, band, True, True, tolerance)
    np.testing.assert_array_equal(frequency[: plain[0].size], plain[0])
    tail, far = frequency[plain[0].size :], weight[plain[0].size :]
    assert (tail[0], tail[-1]) == (band[1], 8 * band[1])
    # as much as the band's linear grid of 101 points, whatever their number; fourth power
    np.testing.assert_allclose(far, share * np.sqrt(101 / tail.size) * (band[1] / tail) ** 4)


def test_states_weigh_by_the_energy_of_their_port():
    """Two resonators, one a thousand times as stiff: at rest both count alike."""
    K = np.diag([1.0, 1e6])
    parts = K, 0 * K, np.eye(2)
    B, D = np.eye(2), np.diag([3.0, 0.0])
    columns = module._weighted(Response(Pencil(parts, B, B.T, D)), np.zeros(1), np.array([0.5]))
    np.testing.assert_allclose(columns[:, :2], 0.5 * np.diag([1 / np.sqrt(1 + 3), 1e-3]))
    assert not columns[:, 2:].any()
    other = module._weighted(Response(Pencil(parts, B, 2 * B, D)), np.zeros(1), np.array([0.5]))
    np.testing.assert_allclose(other[:, :2], 0.5 * np.eye(2))


def test_a_notch_of_a_ports_own_response_weighs_no_more_than_a_thousand():
    K = np.diag([1.0, 9.0])
    response = Response(
        Pencil((K, 0 * K, np.eye(2)), np.ones((2, 1)), np.ones((1, 2)), np.zeros((1, 1)))
    )
    frequency = np.array([0.0, np.sqrt(5.0) / (2 * np.pi)])  # 1/(1 - w^2) + 1/(9 - w^2) = 0
    columns = module._weighted(response, frequency, np.ones(2))
    peak = 1 + 1 / 9
    np.testing.assert_allclose(columns[:, 0], np.array([1, 1 / 9]) / np.sqrt(peak))
    np.testing.assert_allclose(columns[:, 1], np.array([-0.25, 0.25]) / np.sqrt(1e-6 * peak))


def test_rigid_motions_are_those_without_energy():
    n = 4
    rest = np.diag([1.0, 1e-13, 0.0, -1e-13])
    pencil = Pencil((rest, np.eye(n)), np.eye(n), np.eye(n), np.zeros((n, n)))
    found = module._rigid(pencil, 1.005e-15)
    np.testing.assert_allclose(found @ found.T, np.diag([0.0, 1, 1, 1]), atol=1e-12)
    assert module._rigid(pencil, 0.995e-15).shape == (n, 1)
    skew = Pencil((rest + np.eye(n, k=1) * 1e-9, np.eye(n)), np.eye(n), np.eye(n), np.zeros((n, n)))
    assert module._rigid(skew, 1.1e-15).shape == (n, 0)


@pytest.mark.parametrize("columns", [3, 5, 10, 30])
def test_directions_are_the_static_ones_then_the_principal_ones(columns):
    n = 5
    data = RNG.standard_normal((n, columns)) * np.array([[1e3], [1e2], [10.0], [1.0], [0.1]])
    U, size = module._principal(data)
    expected = np.linalg.svd(data, full_matrices=False)
    np.testing.assert_allclose(size, expected[1], rtol=1e-10)
    np.testing.assert_allclose(abs(np.sum(U * expected[0], axis=0)), 1.0)
    first = np.eye(n)[:, [4]]
    found = module._directions(data, first)
    np.testing.assert_allclose(found.T @ found, np.eye(found.shape[1]), atol=1e-12)
    np.testing.assert_allclose(abs(found[:, 0]), first[:, 0], atol=1e-12)
    assert abs(found[0, 1]) > 0.9


def test_the_range_ends_at_rounding():
    data = np.diag([1.0, 1e-12, 1e-14])
    assert module._range(data).shape == (3, 2)
    assert module._range(0 * data).shape == (3, 0)


# -------------------------------------------------------------------------- models that move


def test_a_free_model_keeps_its_motion_without_force():
    """Three masses on two springs and a dashpot to the ground beside the motion: none."""
    n = 3
    K = np.array([[1.0, -1, 0], [-1, 2, -1], [0, -1, 1]])
    E = 0.1 * K
    E[:2, :2] += 0.3 * np.array([[1, -1], [-1, 1]])
    model = LinearModel(M=np.eye(n), E=E, K=K, B=np.eye(n)[:, [0]],
                        ports=(Port("tip", "mechanical"),))  # fmt: skip
    rom = reduce(model, order=2, band=(0.0, 0.05))
    frequency = 1e-6  # x = -F / (3 m w^2)
    found = rom.transfer(np.array([frequency]))[0, 0, 0]
    assert found * 3 * (2 * np.pi * frequency) ** 2 == pytest.approx(-1.0, rel=1e-9)
    assert not rom.K[0].any()
    assert not rom.K[:, 0].any()
    assert rom.certificate.method.endswith("free to move at zero frequency")
    assert "free to move" not in reduce(chain(9, 0.3), order=2, band=(0.0, 0.05)).certificate.method


@pytest.mark.parametrize(("kind", "least"), [("mechanical", 2), ("input", 1)])
def test_static_answers_of_mechanical_ports_are_exact(kind, least):
    """Above zero frequency too, for contact presses on them; signals need them from zero on."""
    kinds = ("mechanical",) * 2 if kind == "mechanical" else ("input",) * 2 + ("output",) * 2
    ports = tuple(Port(f"p{k}", each) for k, each in enumerate(kinds))
    model = chain(20, dashpot=0.3, ports=ports)
    rom = reduce(model, tolerance=0.9, band=(0.005, 0.01))
    assert rom.order >= least
    static, exact = (each.transfer(np.zeros(1))[0].real for each in (rom, model))
    error = (abs(static - exact) / abs(exact)).max()
    assert error < 1e-9 if kind == "mechanical" else error > 1e-6
    low = reduce(model, order=2, band=(0.0, 0.01)).transfer(np.zeros(1))[0].real
    np.testing.assert_allclose(low, exact, rtol=1e-9)


# ---------------------------------------------------------------------------------- structure


def test_what_the_form_proves():
    band, n = (0.0, 1.0), 3
    one, zero, skew = np.eye(n), np.zeros((n, n)), np.eye(n, k=1) - np.eye(n, k=-1)
    stand = {"B": one, "C": one, "D": zero}

    def of(*parts, **more):
        found = structure(Pencil(parts, **(stand | more)), band)
        return found.stable, found.passive, found.proof

    proven, poles = (True, True, "definite matrices"), "poles"
    assert of(one, zero, one) == proven
    assert of(one, skew, one) == proven
    assert of(one, one) == proven
    assert of(one + skew, one) == proven
    assert of(one, one, one, C=2 * one) == (True, False, "definite matrices")
    assert of(one, one, one, D=-one) == (True, False, "definite matrices")
    assert of(one, one, one, D=one + skew) == proven
    assert of(one, -one, one) == (False, False, poles)
    assert of(-one, one, one) == (False, False, poles)
    assert of(one + 0.1 * skew, one, one) == (True, False, poles)
    assert of(-one, one) == (False, False, poles)
    # growth by e in more than a hundred million radians is rounding of a pole on the axis
    for growth, stable in ((1.5e-8, True), (2.5e-8, False)):
        slow = np.diag([-1e6 * growth, 1.0, 1.0])
        assert of(1e12 * one, slow, one)[0] is stable
        assert of(np.diag([1.0, -2 * np.pi * growth / 2, 1.0]), one)[0] is stable


@pytest.mark.parametrize(
    ("matrix", "yes"),
    [
        (np.zeros((0, 0)), True), (np.zeros((2, 2)), True), (np.diag([1.0, -0.9e-12]), True),
        (np.diag([1.0, 1e-3, -0.9e-12]), True), (np.diag([1.0, -1.1e-12]), False),
        (np.diag([0.0, -1e-300]), False), (np.diag([-1.0, -1.0]), False),
        (np.array([[1.0, 0.9e-12], [0.0, 1.0]]), True),
        (np.array([[1.0, 1.1e-12], [0.0, 1.0]]), False),
    ],
)  # fmt: skip
def test_semidefinite_but_for_rounding(matrix, yes):
    for unit in (1.0, 1e3, 1e-3):
        assert semidefinite(unit * matrix) is yes


# ----------------------------------------------------------------------------------- subspaces


def test_new_directions_are_orthonormal_and_without_what_is_there():
    basis = np.linalg.qr(RNG.standard_normal((6, 2)))[0]
    new = RNG.standard_normal((6, 4))
    new[:, 1] = basis @ [1.0, 2.0] + 1e-12 * new[:, 1]  # but for rounding in the basis
    new[:, 2] = 3 * new[:, 0] - basis[:, 0]
    found = np.column_stack(list(_independent(basis, new)))
    assert found.shape == (6, 2)
    np.testing.assert_allclose(basis.T @ found, 0.0, atol=1e-14)
    np.testing.assert_allclose(found.T @ found, np.eye(2), atol=1e-14)
    both = np.column_stack([basis, found])
    np.testing.assert_allclose(both @ (both.T @ new), new, atol=1e-11)
    assert len(list(_independent(np.empty((3, 0)), RNG.standard_normal((3, 5))))) == 3


@pytest.mark.parametrize("unit", [1.0, 1e6, 1e-6])
@pytest.mark.parametrize(("left", "kept"), [(0.9e-10, 1), (1.1e-10, 2)])
def test_a_direction_that_keeps_rounding_alone_is_none(left, kept, unit):
    """What is left of the second one outside of the first, as a share of its length."""
    new = unit * np.array([[1.0, 3.0, 0], [0, 3.0 * left, 0], [0, 0, 0]])
    assert len(list(_independent(np.empty((3, 0)), new))) == kept
    assert len(list(_independent(np.eye(3)[:, :1], new))) == kept - 1
    stiff = 16 * np.eye(3)  # of which lengths are four times as large
    columns, images = extend(np.empty((3, 0)), np.empty((3, 0)), new, lambda v: stiff @ v)
    assert columns.shape == images.shape == (3, kept)
    np.testing.assert_allclose(images, stiff @ columns)


def test_the_floor_is_a_margin_on_the_largest_of_some_roundings(monkeypatch):
    """Zeros of the response are not counted; without a resonance in the band there is no floor."""
    pencil = LinearModel(M=np.eye(2), K=np.diag([1.0, 4.0]), E=0.01 * np.eye(2), B=np.eye(2)).pencil
    space = Subspace(pencil, 1e-9, True, "told")
    sizes = iter([1e-9, 5e-9, 2e-9, 1e-9] * 2)

    def moved(difference, reference):
        size = np.full(reference.shape, next(sizes))
        size[:, 0, 1] = 1.0  # no input moves the other mode
        return size

    monkeypatch.setattr("kc2spice.rom.subspace.relative_size", moved)
    found = _with_rounding(pencil, np.eye(2), (0.0, 1.0), space)
    assert 2.5 * 5e-9 <= found.floor <= 3.5 * 5e-9
    assert found.proof.startswith("told, which rounding moves by ")
    assert (found.error, found.pencil) == (1e-9, pencil)
    assert _with_rounding(pencil, np.eye(2), (0.0, 0.1), space) is space


def test_what_is_left_of_a_nearly_known_direction_is_orthogonal_to_rounding():
    """One subtraction leaves the rounding of a vector a hundred million times as long."""
    rng = np.random.default_rng(5)
    basis = np.linalg.qr(rng.standard_normal((20, 3)))[0]
    new = basis @ rng.standard_normal((3, 2)) + 1e-8 * rng.standard_normal((20, 2))
    near = np.column_stack([new[:, 0], new[:, 0] + 1e-8 * rng.standard_normal(20)])
    K = definite(20) + np.eye(20)
    for columns in (new, near):
        found = np.column_stack([basis, *_independent(basis, columns)])
        np.testing.assert_allclose(found.T @ found, np.eye(5), atol=1e-14)
        first = extend(np.empty((20, 0)), np.empty((20, 0)), basis, lambda v: K @ v)
        more = extend(*first, columns, lambda v: K @ v)
        V, images = (np.hstack(both) for both in zip(first, more, strict=True))
        np.testing.assert_allclose(V.T @ K @ V, np.eye(5), atol=1e-11)
        np.testing.assert_allclose(images, K @ V, atol=1e-10)


def test_a_sketch_measures_residuals_relative_to_the_load():
    """Of ``P(s) x = b`` exactly: zero at the solution, one for nothing, linear in between."""
    n = 40
    parts = tuple(RNG.standard_normal((3, n, n)))
    b = RNG.standard_normal((n, 2)) * [1.0, 1e3]
    sketch = _Sketch(RNG.standard_normal((32, n)), parts, b)
    V = np.eye(n)
    sketch.extend(V[:, :10])
    sketch.extend(V[:, 10:])
    s = np.array([0.5j, 2.0 + 1j])
    P = sum(s[:, None, None] ** k * each for k, each in enumerate(parts))
    x = np.linalg.solve(P, b.astype(complex)[None])
    np.testing.assert_allclose(sketch.residual(s, x), 0.0, atol=1e-10)
    np.testing.assert_allclose(sketch.residual(s, 0 * x), 1.0)
    x[1, :, 0] *= 0.75
    np.testing.assert_allclose(sketch.residual(s, x), [0.0, 0.25], atol=1e-10)


@pytest.mark.parametrize("sparse_parts", [False, True])
def test_a_whole_small_model_knows_whether_it_is_held(sparse_parts):
    make = sparse.csc_array if sparse_parts else np.asarray
    for K, static in (([[2.0, -1], [-1, 2]], True), ([[1.0, -1], [-1, 1]], False)):
        model = LinearModel(M=make(np.eye(2)), K=make(np.array(K)), B=np.eye(2))
        space = subspace(model.pencil, (0.0, 1.0), 1e-8, 1e-3, "scipy")
        assert isinstance(space, Subspace)
        assert space.static is static
        assert space.pencil.size == 2
        assert space.error < 1e-12
        rounding = np.finfo(float).eps * np.linalg.norm(space.pencil.coefficients[0], 2)
        assert static or rounding <= space.rounding <= 10 * rounding


def test_a_small_model_is_taken_as_a_whole_where_its_response_is_cheap(monkeypatch):
    """Of any size where damping decouples; else up to a limit, a lower one without eigenvectors."""
    monkeypatch.setattr("kc2spice.rom.subspace.WHOLE", 15)
    for n, model in ((15, chain(15, dashpot=0.3)), (16, chain(16))):
        whole = _whole(model.pencil.dense(), (0.0, 0.1), 1e-6)
        assert whole.pencil.size == n
        assert whole.proof.startswith("being all of the full model, solved to ")
    assert _whole(chain(16, dashpot=0.3).pencil.dense(), (0.0, 0.1), 1e-6) is None
    monkeypatch.setattr("kc2spice.rom.subspace.WHOLE", 300)
    for n, whole in ((150, True), (151, False)):
        lags = LinearModel(A=np.eye(n, k=1) - np.eye(n), B=np.eye(n)[:, [3]], C=np.eye(n)[[0]])
        assert (_whole(lags.pencil.dense(), (0.0, 0.1), 1e-6) is not None) is whole


def test_unknowns_are_scaled_for_the_end_of_the_band(monkeypatch):
    """By powers of two, which round nothing, to where the energy of each is about one; of the whole
    and of what is sampled."""
    seen = []
    for name in ("_whole", "_rational"):
        monkeypatch.setattr(f"kc2spice.rom.subspace.{name}", lambda p, *_: seen.append(p.dense()))
    M, E, K = np.diag([1.0, 100.0]), np.diag([0.1, 7.0]), np.diag([4.0, 9.0])
    subspace(LinearModel(M=M, E=E, K=K, B=np.eye(2)).pencil, (1.0, 3.0), 1e-8, 1e-3, "scipy")
    assert len(seen) == 2
    for found in seen:
        energy = sum((6 * np.pi) ** k * P for k, P in enumerate(found.coefficients))
        assert (np.diag(energy) >= 0.5).all()
        assert (np.diag(energy) <= 2.0).all()
        assert all((np.frexp(np.diag(P) / np.diag(Q))[0] == 0.5).all()
                   for P, Q in zip(found.coefficients, (K, E, M), strict=True))  # fmt: skip


def exact_response(model, frequency):
    s = 2j * np.pi * np.asarray(frequency)[:, None, None]
    parts = model.pencil.dense().coefficients
    P = sum(s**k * each for k, each in enumerate(parts))
    return model.C @ np.linalg.solve(P, model.B.astype(complex)[None]) + model.D


def one_way(n):
    """A chain of lags that is neither symmetric nor collocated."""
    A = -np.diag(np.linspace(1, 3, n)) + 0.8 * np.eye(n, k=-1) + 0.3 * np.eye(n, k=1)
    return LinearModel(A=A, B=np.eye(n)[:, [0]], C=np.eye(n)[[n // 2, 3]])


def loose(n):
    """A chain without walls with a dashpot inside."""
    links = np.eye(n - 1, n) - np.eye(n - 1, n, k=1)
    dash = np.outer(links[n // 2], links[n // 2])
    return LinearModel(M=np.eye(n), E=0.3 * dash, K=links.T @ links, B=np.eye(n)[:, [0]])


@pytest.fixture
def sampled(monkeypatch):
    """No model is small enough to be taken as a whole."""
    for name in ("WHOLE", "WHOLE_DECOUPLED"):
        monkeypatch.setattr(f"kc2spice.rom.subspace.{name}", -1)


@pytest.mark.usefixtures("sampled")
@pytest.mark.parametrize(
    ("model", "band", "static"),
    [(chain(60, dashpot=0.3), (0.0, 0.05), True), (chain(60, dashpot=0.3), (0.02, 0.05), True),
     (one_way(60), (0.0, 0.5), True), (loose(60), (0.0, 0.04), False)],
)  # fmt: skip
def test_sampled_directions_reach_the_target(model, band, static):
    """The last two checks were within it, at frequencies that the basis did not know."""
    target = 1e-6
    space = subspace(model.pencil, band, target, 1e-3, "scipy")
    assert space.proof.startswith("checked against the full model at ")
    assert space.static is static
    assert space.error <= target
    assert 10 < space.pencil.size < 58
    frequency = np.linspace(max(band[0], 0.1 * band[1]), band[1], 97)
    exact = exact_response(model, frequency)
    size = np.maximum(abs(exact), FLOOR * abs(exact).max(axis=0))
    error = abs(space.pencil.transfer(2j * np.pi * frequency) - exact) / size
    assert error.max() < 20 * target
    eps = np.finfo(float).eps
    assert (space.rounding > 0.1 * eps) is not static
    assert space.rounding < 1e4 * eps
    assert space.floor < 1e-7


@pytest.mark.parametrize("held", [False, True])
def test_static_answers_are_those_of_a_model_that_is_held(held):
    """The last mass of a chain is held or has no spring at all."""
    model = chain(20, dashpot=0.3)
    K = model.pencil.dense().coefficients[0].copy()
    if not held:
        K[-1] = K[:, -1] = 0.0
    free = LinearModel(M=model.M, E=model.E, K=sparse.csc_array(K), B=model.B)
    search = _Search(free.pencil, (0.0, 0.1), "scipy")
    assert search.static is held
    assert (search.basis.shape[1] > 0) is held


@pytest.mark.parametrize(
    ("checks", "taken", "error"),
    [
        # error, change and growth of each check; the target is 1e-6
        ([(1e-2, 1.0, 1), (1e-7, 1e-8, 1), (3e-7, 1e-8, 1), (1e-9, 1e-9, 1)], 3, 3e-7),
        ([(1e-7, 1.0, 1), (1e-7, 1e-8, 1), (1e-8, 1e-8, 1)], 3, 1e-7),
        ([(1e-7, 1e-8, 1), (1e-2, 1e-8, 1), (1e-7, 1e-8, 1), (2e-7, 1e-8, 1)], 4, 2e-7),
        # without growth the last errors are those of the same projection
        ([(1e-2, 1.0, 1), (1e-4, 1.0, 0), (1e-5, 1.0, 0), (1e-9, 1e-9, 1)], 3, 1e-4),
        ([(1e-4, 1.0, 0), (1e-2, 1.0, 1), (1e-5, 1.0, 0), (1e-6, 1.0, 0)], 4, 1e-5),
        ([(1e-2, 1.0, 1)] * 7 + [(1e-4, 1.0, 1), (3e-5, 1.0, 1)], 9, 1e-4),  # no more points
    ],
)
def test_sampling_ends_where_two_checks_in_a_row_say_so(checks, taken, error, monkeypatch):
    asked = []

    class Scripted:
        basis, static, response, modal = np.eye(2), True, None, None

        def __init__(self, pencil, band, solver):
            self.points, self.response = 1, Response(pencil)

        def add(self, s):
            asked.append(s)
            self.points += 1

        def next_point(self):
            self.change = checks[len(asked) - 1][1]
            return 1j * len(asked)

        def check(self, s):
            asked.append(s)
            self.points += 1
            error, _, grown = checks[len(asked) - 2]
            return error, bool(grown)

    monkeypatch.setattr("kc2spice.rom.subspace._Search", Scripted)
    monkeypatch.setattr("kc2spice.rom.subspace.MAX_POINTS", 11)
    monkeypatch.setattr(
        "kc2spice.rom.subspace._with_rounding", lambda pencil, V, band, found: found
    )

    def run(limit):
        asked.clear()
        return _rational(chain(2).pencil, (0.0, 3.0), 1e-6, limit, "scipy")

    found = run(error)
    assert (found.error, len(asked) - 1) == (error, taken)
    assert asked[0] == 6j * np.pi  # the end of the band
    assert found.proof == f"checked against the full model at {taken + 2} frequencies"
    with pytest.raises(SimulationError):
        run(0.99 * error)


@pytest.mark.usefixtures("sampled")
def test_a_basis_of_all_directions_is_checked_twice():
    """Static answers and those of the band's end are all that two unknowns have."""
    model = LinearModel(M=np.eye(2), K=np.diag([1.0, 4.0]), E=np.array([[0.1, 0.05], [0.05, 0.1]]),
                        B=np.ones((2, 1)))  # fmt: skip
    space = subspace(model.pencil, (0.0, 0.5), 1e-20, 1e-9, "scipy")
    assert space.proof.startswith("checked against the full model at 4 frequencies")
    assert space.pencil.size == 2
    assert space.error < 1e-12


@pytest.mark.usefixtures("sampled")
def test_directions_that_do_not_settle_are_refused(monkeypatch):
    monkeypatch.setattr("kc2spice.rom.subspace.MAX_POINTS", 4)
    model, band = chain(60, dashpot=0.3), (0.0, 0.15)
    with pytest.raises(SimulationError, match="does not settle") as caught:
        subspace(model.pencil, band, 1e-12, 1e-9, "scipy")
    assert caught.value.expected == "at most 1.0e-09"
    assert "the band holds at least " in caught.value.got
    assert subspace(model.pencil, band, 1e-12, np.inf, "scipy").error > 1e-9
    monkeypatch.setattr("kc2spice.rom.subspace.STATES", 8)
    with pytest.raises(SimulationError, match="does not settle"):
        subspace(chain(60, rayleighed=True).pencil, band, 1e-12, 1e-9, "scipy")


@pytest.mark.usefixtures("sampled")
@pytest.mark.parametrize(("costly", "warned"), [(60, True), (61, False)])
def test_many_factorisations_need_a_word(costly, warned, monkeypatch):
    monkeypatch.setattr("kc2spice.rom.subspace.MANY", 4)
    monkeypatch.setattr("kc2spice.rom.subspace.COSTLY", costly)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        subspace(chain(60, dashpot=0.3).pencil, (0.0, 0.1), 1e-9, np.inf, "scipy")
    assert ["more than 4 factorisations" in str(each.message) for each in said] == [True] * warned


@pytest.mark.usefixtures("sampled")
@pytest.mark.parametrize("top", [0.01, 0.1, 0.25])
def test_krylov_blocks_settle_at_zero_or_at_more_points(top):
    """With one resonance in the band, with many, and with nearly all."""
    model, band = chain(60, rayleighed=True), (0.0, top)
    space = subspace(model.pencil, band, 1e-7, 1e-3, "scipy")
    assert space.proof.startswith("settled to ")
    assert space.static
    assert space.error <= 1e-7
    assert space.pencil.size <= 60
    frequency = np.linspace(0.0, top, 97)
    exact = exact_response(model, frequency)
    size = np.maximum(abs(exact), FLOOR * abs(exact).max(axis=0))
    error = abs(space.pencil.transfer(2j * np.pi * frequency) - exact) / size
    assert error.max() < 2e-7


@pytest.mark.usefixtures("sampled")
@pytest.mark.parametrize(("top", "target"), [(0.25, 1e-7), (0.12, 1e-9), (0.2, 1e-5)])
def test_blocks_go_on_at_a_point_while_they_pay(top, target, monkeypatch):
    """Some before that is judged, then while each changes a third of what the last one did; two
    changes in a row within the target are the end."""
    points: list[list[float]] = []  # changes by the blocks at each point
    shifts = []
    put = monkeypatch.setattr

    def extending(*words):
        points[-1].append(np.inf)
        return extend(*words)

    def sized(difference, reference):
        size = relative_size(difference, reference)
        points[-1][-1] = size.max()
        return size

    def solving(pencil, square, solver="scipy"):
        if square or not points:
            points.append([])
            shifts.append(np.sqrt(square) / (2 * np.pi))
        return solve(pencil, square, solver)

    solve = Pencil.pencil_solver
    put("kc2spice.rom.subspace.extend", extending)
    put("kc2spice.rom.subspace.relative_size", sized)
    put("kc2spice.rom.subspace._with_rounding", lambda pencil, V, band, found: found)
    put(Pencil, "pencil_solver", solving)
    subspace(chain(60, rayleighed=True).pencil, (0.0, top), target, 1e-3, "scipy")
    assert shifts[0] == 0.0
    assert len(shifts) > 1
    assert max(shifts) <= top
    assert np.diff(np.sort(shifts)).min() > 1e-3 * top
    changes = [change for each in points for change in each]
    assert max(changes[-2:]) <= target < min(map(max, changes[:-2], changes[1:-1]))
    for k, each in enumerate(points[:-1]):
        least = 3 if k else 4
        assert len(each) >= least
        before = [np.inf, *each]
        judged = [change <= last / 3 for last, change in zip(before, each, strict=False)]
        assert all(judged[least : len(each) - 1])
        assert not judged[-1]


def test_definite_is_what_krylov_vectors_need():
    K, M, B = definite(4) + np.eye(4), definite(4) + np.eye(4), RNG.standard_normal((4, 1))

    def of(undamped_too=False, **parts):
        parts = {"K": K, "M": M, "B": B} | parts
        return is_definite(LinearModel(**parts).pencil, "scipy", undamped_too=undamped_too)

    assert of(rayleigh=(0.1, 0.0))
    assert not of()
    assert of(undamped_too=True)
    assert not of(rayleigh=(0.1, 0.0), C=2 * B.T)
    assert not of(rayleigh=(0.1, 0.0), M=M + 0.1 * np.eye(4, k=1))
    assert not of(rayleigh=(0.1, 0.0), K=-K)
    assert not of(E=K, undamped_too=True)
    assert not is_definite(LinearModel(A=-K, B=B).pencil, "scipy", undamped_too=True)


def test_solutions_in_two_orders_show_what_rounding_does():
    """Of a Hilbert matrix, whose condition is 1e10."""
    n = 8
    K = 1 / (np.arange(n)[:, None] + np.arange(n) + 1.0)
    model = LinearModel(M=1e-9 * np.eye(n), K=K, E=1e-10 * K, B=np.eye(n)[:, [n // 2]])
    band = (0.0, 1e-3)
    P = (2j * np.pi * 1e-3) ** 2 * model.M + 2j * np.pi * 1e-3 * model.E + K
    one, other = (np.linalg.solve(each, np.ones(n) + 0j) for each in (P, P[::-1, ::-1]))
    apart = abs(one.sum() / other.sum() - 1)
    summed = LinearModel(M=model.M, E=model.E, K=K, B=np.ones((n, 1)))
    found = _solution_error(Response(summed.pencil), band)
    assert apart <= found * (1 + 1e-6)
    assert 1e-15 < found < 1e-2
    with pytest.raises(SimulationError, match="not that accurate") as caught:
        subspace(summed.pencil, band, 1e-20, 1e-17, "scipy")
    assert caught.value.expected == "at most 1.0e-17"
    good = LinearModel(M=np.eye(2), K=np.diag([1.0, 2.0]), B=np.eye(2))
    assert _solution_error(Response(good.pencil), (0.0, 1.0)) < 1e-11


@pytest.mark.parametrize(("ratio", "beside"), [(0.01, 1.0), (2e-4, 1.0), (1e-9, 1 + 1e-4)])
def test_solutions_are_compared_at_the_end_of_the_band_and_its_sharpest_resonance(
    ratio, beside, monkeypatch
):
    """One at 20 Hz, sharper than that at 12 Hz; that at 200 Hz is beyond the band."""
    hertz, ratios = np.array([12.0, 20.0, 200.0]), np.array([0.02, ratio, ratio / 10])
    w = 2 * np.pi * hertz
    asked = []
    pencil = Pencil((np.diag(w**2), np.diag(2 * ratios * w), np.eye(3)), np.ones((3, 1)),
                    np.ones((1, 3)), np.zeros((1, 1)))  # fmt: skip
    solve = Pencil.transfer
    monkeypatch.setattr(Pencil, "transfer", lambda p, s: asked.append(s) or solve(p, s))
    assert _solution_error(Response(pencil), (10.0, 50.0)) < 1e-9
    for s in asked:  # both orders of elimination
        frequency = s.imag / (2 * np.pi)
        assert frequency[0] == pytest.approx(50.0)
        assert 10 < frequency[1] < 50
        assert frequency[2:] == pytest.approx(20 * np.sqrt(1 - ratio**2) * beside, rel=1e-9)
    assert len(asked) == 2
    assert _solution_error(Response(pencil), (30.0, 50.0)) < 1e-9
    assert [s.size for s in asked[2:]] == [2, 2]


def test_a_quick_look_sees_the_grid_and_the_flanks_of_resonances():
    w = 2 * np.pi * np.array([10.0, 200.0])
    pencil = Pencil((np.diag(w**2), np.diag(0.02 * w), np.eye(2)), np.ones((2, 1)), np.ones((1, 2)),
                    np.zeros((1, 1)))  # fmt: skip
    found = _telling_quickly(Response(pencil), (5.0, 50.0), True)
    pole = 10 * np.sqrt(1 - 1e-4)
    expected = np.union1d(
        grid((5.0, 50.0), 200, True), pole * (1 + 0.01 * np.array([-4, -1, 0, 1, 4]))
    )
    np.testing.assert_allclose(found, expected)


def test_modes_of_a_projection_make_both_matrices_diagonal():
    K, M = definite(4) + np.eye(4), definite(4) + np.eye(4)
    one, zero = np.eye(4), np.zeros((4, 4))
    T = _modes(Pencil((K, zero, M), one, one, zero))
    np.testing.assert_allclose(T.T @ M @ T, one, atol=1e-12)
    stiff = T.T @ K @ T
    np.testing.assert_allclose(stiff, np.diag(np.diag(stiff)), atol=1e-10)
    for parts in ((K, M), (K + np.eye(4, k=1), zero, M), (K, zero, -M)):
        np.testing.assert_array_equal(_modes(Pencil(parts, one, one, zero)), one)


@pytest.mark.parametrize("model", [chain(40, dashpot=0.3), one_way(40)])
def test_a_check_is_the_error_before_its_answers_join(model):
    band = (0.0, 0.1)
    search = _Search(model.pencil, band, "scipy")
    assert search.static
    assert (search.points, search.change) == (1, np.inf)
    before, s = search.response, 2j * np.pi * 0.07
    frequency = search._candidates()
    assert (frequency[0], frequency[-1]) == (0.0, 0.1)
    peak = abs(before.transfer(2j * np.pi * frequency)).max(axis=0)
    exact = exact_response(model, [0.07])[0]
    apart = abs(before.transfer(np.array([s]))[0] - exact) / np.maximum(abs(exact), FLOOR * peak)
    error, grown = search.check(s)
    assert error == pytest.approx(apart.max(), rel=1e-6)
    assert grown
    assert search.points == 2
    V = search.basis  # the answers, their slopes, and those of the dual
    np.testing.assert_allclose(V.T @ V, np.eye(V.shape[1]), atol=1e-12)
    for P, b in ((model.pencil.at(s), model.B), (model.pencil.at(s).T, model.C.T)):
        answer = np.linalg.solve(P, b.astype(complex))
        for each in (answer.real, answer.imag):
            if model.first_order or b is model.B:
                np.testing.assert_allclose(V @ (V.T @ each), each, atol=1e-10)
    again, grown = search.check(s)
    assert again < 1e-6
    assert not grown
    fresh = search.next_point()
    assert abs(fresh - s) > 1e-6
    assert search.change == 0.0  # the last point added nothing


@pytest.mark.parametrize("order", [1, 5, 6, 7, 30])
def test_krylov_vectors_are_nested_and_orthonormal_in_energy(order):
    """Their span is that of ``K^-1 B``, ``K^-1 M K^-1 B``, …, until it is exhausted."""
    n = 12
    K, M, B = definite(n) + np.eye(n), definite(n) + np.eye(n), RNG.standard_normal((n, 3))
    B[:, 2] = B[:, 0] - 2 * B[:, 1]  # a load that others make up
    V = block_arnoldi(lambda v: K @ v, lambda v: np.linalg.solve(K, v), lambda v: M @ v, B, order)
    q = min(order, n)
    assert V.shape == (n, q)
    np.testing.assert_allclose(V.T @ K @ V, np.eye(q), atol=1e-8)
    blocks = [np.linalg.solve(K, B[:, :2])]
    while len(blocks) < 6:
        blocks.append(np.linalg.solve(K, M @ blocks[-1]))
    span = np.hstack(blocks)[:, :q]
    inside = V @ (V.T @ K @ span)
    np.testing.assert_allclose(inside, span, atol=1e-7 * abs(span).max())


def test_a_bands_end_counts_what_moves_alone():
    """Of masses that nothing holds and of poles at zero no band is made."""
    K = np.diag([0.0, 4.0, 9.0])
    one = np.eye(3)
    free = LinearModel(M=one, K=K, B=one).pencil
    assert natural_band(free) == (0.0, pytest.approx(1.1 * 3.0 / (2 * np.pi)))
    lags = LinearModel(A=-K, B=one).pencil
    assert natural_band(lags) == (0.0, pytest.approx(1.1 * 9.0 / (2 * np.pi)))
    for share, fifth in ((0.9e-12, 5.0), (1.1e-12, 4.0)):  # the lowest is rounding of the highest
        K7 = 1e-4 * np.diag([100 * share, 1, 4, 9, 16, 25, 100])
        wide = LinearModel(M=1e-4 * np.eye(7), K=K7, B=np.eye(7)).pencil
        assert natural_band(wide)[1] == pytest.approx(1.1 * fifth / (2 * np.pi))
    for parts in ({"M": 0 * one, "K": K}, {"M": one, "K": 0 * K}):
        with pytest.raises(UsageError, match="no natural frequency"):
            natural_band(LinearModel(**parts, B=one).pencil)


@pytest.mark.parametrize("n", [200, 201])
def test_a_natural_band_ends_above_the_fifth_frequency_whatever_the_size(n):
    """Of springs apart: of a body that is held, of one with a negative stiffness, of heat."""
    omega = 3.0 + np.arange(n)
    one = sparse.eye_array(n, format="csc")
    B = np.ones((n, 1))
    end = 1.1 * omega[4] / (2 * np.pi)
    for signs in (np.ones(n), np.r_[1, 1, -1, np.ones(n - 3)]):
        K = sparse.diags_array(signs * omega**2, format="csc")
        assert natural_band(LinearModel(M=one, K=K, B=B).pencil) == (
            0.0,
            pytest.approx(end, rel=1e-4),
        )
    heat = LinearModel(E=one, A=-sparse.diags_array(omega, format="csc"), B=B)
    assert natural_band(heat.pencil) == (0.0, pytest.approx(end, rel=1e-4))
    loose = LinearModel(M=one, K=sparse.diags_array(np.r_[0.0, omega[1:] ** 2], format="csc"), B=B)
    if n > 200:
        with pytest.raises(UsageError, match="no natural frequency"):
            natural_band(loose.pencil)


def test_memory_is_asked_for_by_the_band_of_the_best_order(monkeypatch):
    """A chain in any order has a bandwidth of 2; the estimate is 24 bytes x 34 n sqrt(2)."""
    n = 50
    order = RNG.permutation(n)
    links = sparse.csc_array(
        (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))[np.ix_(order, order)]
    )
    pencil = LinearModel(M=sparse.eye_array(n, format="csc"), K=links, B=np.eye(n)[:, [0]]).pencil
    estimate = 24 * 34 * n * np.sqrt(2)
    assert factor_bytes(pencil) == pytest.approx(estimate)
    full = LinearModel(M=np.eye(n), K=np.ones((n, n)) + n * np.eye(n), B=np.eye(n)[:, [0]]).pencil
    assert factor_bytes(full) == pytest.approx(24 * 34 * n * np.sqrt(n))
    for free, fits in ((3 * estimate, True), (0.5 * estimate, False)):
        monkeypatch.setattr("kc2spice.linalg.memory.available_bytes", lambda free=free: free)
        if fits:
            require_memory(pencil, "scipy")
        else:
            with pytest.raises(UsageError, match="too large") as caught:
                require_memory(pencil, "scipy")
            assert "50 factorised equations" in str(caught.value)
            require_memory(pencil, "pardiso")


def test_a_surrogate_is_measured_against_direct_solutions():
    model, asked = chain(40, rayleighed=True), []
    band = (0.01, 0.03)

    class Watched(LinearModel):
        def transfer(self, frequency):
            asked.append(np.asarray(frequency))
            return super().transfer(frequency)

    watched = Watched(**{name: getattr(model, name) for name in ("M", "K", "B", "rayleigh")})
    found = surrogate(watched, band, blocks=8, checks=5)
    (frequency,) = asked
    assert found.solved == frequency.size == 5
    assert (np.diff(frequency) > 0.1 * (band[1] - band[0]) / 5).all()
    assert band[0] < frequency[0] < frequency[-1] < band[1]
    assert found.model.order == 16
    error = abs(found.model.transfer(frequency) / exact_response(model, frequency) - 1).max()
    assert found.error == pytest.approx(error, rel=0.5, abs=1e-14)
    assert found.error < 1e-10
    assert 0 < found.seconds < 1
    with pytest.raises(SimulationError, match="cannot replace") as caught:
        surrogate(model, band, blocks=3, checks=5)
    assert "with 6 states" in caught.value.got
