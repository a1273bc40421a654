"""Reductions: what may be asked for, what is proven, and how far a certificate reaches."""

import numpy as np
import pytest
from mor_families import damped_chain
from support import LinearModel, Pencil, Port, UsageError, prove_stability, reduce_model


def chain(n, dashpot, **more):
    return LinearModel(**damped_chain(n, dashpot), **more)


# --------------------------------------------------------------------------- what is asked for


@pytest.mark.parametrize(
    ("asked", "says"),
    [
        ({}, "either a tolerance or an order"),
        ({"tolerance": 1e-3, "order": 3}, "either a tolerance or an order"),
        ({"tolerance": 0.9e-10}, "out of range"),
        ({"tolerance": 1.0}, "out of range"),
        ({"order": 0}, "not a positive whole number"),
        ({"order": 3, "band": (0.0, 0.0)}, "not a frequency band"),
        ({"order": 3, "band": (0.2, 0.1)}, "not a frequency band"),
        ({"order": 3, "band": (-0.1, 0.1)}, "not a frequency band"),
        ({"order": 3, "band": (0.0, np.inf)}, "not a frequency band"),
        ({"order": 3, "band": (0.0, 1e300)}, "not a frequency band"),
    ],
)
def test_invalid_arguments_of_a_reduction_are_rejected(asked, says):
    with pytest.raises(UsageError, match=says):
        reduce_model(chain(20, dashpot=0.3), **asked)


def test_the_band_is_the_requested_band_or_that_of_the_model():
    model = chain(20, dashpot=0.3, band=(0.0, 0.02))
    assert reduce_model(model, order=4).certificate.band_hz == (0.0, 0.02)
    assert reduce_model(model, order=4, band=(0.0, 0.03)).certificate.band_hz == (0.0, 0.03)
    assert reduce_model(model, order=4).band == (0.0, 0.02)


# -------------------------------------------------------------------------- models that move


def test_a_free_model_keeps_its_motion_without_force():
    """Three masses on two springs and a dashpot to the ground beside the motion: none."""
    n = 3
    K = np.array([[1.0, -1, 0], [-1, 2, -1], [0, -1, 1]])
    E = 0.1 * K
    E[:2, :2] += 0.3 * np.array([[1, -1], [-1, 1]])
    model = LinearModel(M=np.eye(n), E=E, K=K, B=np.eye(n)[:, [0]],
                        ports=(Port("tip", "mechanical"),))  # fmt: skip
    rom = reduce_model(model, order=2, band=(0.0, 0.05))
    frequency = 1e-6  # x = -F / (3 m w^2)
    found = rom.transfer(np.array([frequency]))[0, 0, 0]
    assert found * 3 * (2 * np.pi * frequency) ** 2 == pytest.approx(-1.0, rel=1e-9)
    assert not rom.K[0].any()
    assert not rom.K[:, 0].any()
    assert rom.certificate.method.count("free to move at zero frequency") == 1
    assert (
        "free to move"
        not in reduce_model(chain(9, 0.3), order=2, band=(0.0, 0.05)).certificate.method
    )


@pytest.mark.parametrize(("kind", "least"), [("mechanical", 2), ("input", 1)])
def test_static_answers_of_mechanical_ports_are_exact(kind, least):
    """Above zero frequency too, for contact presses on them; signals need them from zero on."""
    kinds = ("mechanical",) * 2 if kind == "mechanical" else ("input",) * 2 + ("output",) * 2
    ports = tuple(Port(f"p{k}", each) for k, each in enumerate(kinds))
    model = chain(20, dashpot=0.3, ports=ports)
    rom = reduce_model(model, tolerance=0.9, band=(0.005, 0.01))
    assert rom.order >= least
    static, exact = (each.transfer(np.zeros(1))[0].real for each in (rom, model))
    error = (abs(static - exact) / abs(exact)).max()
    assert error < 1e-9 if kind == "mechanical" else error > 1e-6
    low = reduce_model(model, order=2, band=(0.0, 0.01)).transfer(np.zeros(1))[0].real
    np.testing.assert_allclose(low, exact, rtol=1e-9)


# ---------------------------------------------------------------------------------- structure


def test_the_form_of_matrices_proves_stability_and_passivity():
    band, n = (0.0, 1.0), 3
    one, zero, skew = np.eye(n), np.zeros((n, n)), np.eye(n, k=1) - np.eye(n, k=-1)
    stand = {"B": one, "C": one, "D": zero}

    def of(*parts, **more):
        found = prove_stability(Pencil(parts, **(stand | more)), band)
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
