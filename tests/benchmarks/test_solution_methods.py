"""Lower bound and peers against the event-driven reference, forms in .ac."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kc2spice import reference
from kc2spice.reference.law import law
from kc2spice.report.metrics import compare
from kc2spice.scene.schema import Impact
from kc2spice.sim.ngspice import run_deck
from kc2spice.spice.circuit import Deck
from kc2spice.spice.header import Header
from kc2spice.spice.realize import realize
from laboratory.forms import FORMS, state_space, with_form
from laboratory.lower_bound import LowerBound
from laboratory.peers import integrate
from laboratory.points import Point, Timing, fastest, pareto


@pytest.fixture(scope="module")
def exact(model, scene, table):
    return reference.kick_and_catch(model, scene, table, rtol=1e-9).waves


def impact_scene(scene):
    kick = scene.kick.model_copy(update={"electrical": "open"})
    solver = scene.solver.model_copy(update={"stop": 15e-6})
    changes = {"kick": kick, "impact": Impact(), "catch": None, "control": None, "gravity": 0.0}
    return scene.model_copy(update={**changes, "solver": solver})


def test_lower_bound_flies_the_loop_exactly(model, scene, table, exact):
    error = compare(LowerBound(law(model, scene, table)).run(scene), exact)
    # The magnets' pull is linearised for 2 us at a time during contact; all else is exact.
    assert error["velocity_relative"] < 1e-5
    assert error["separation_time_s"] < 1e-11
    assert error["trajectory_m"] < 2e-8


def test_lower_bound_without_located_events_is_worse(model, scene, table, exact, monkeypatch):
    """Rings that toggle at samples only: the test above can fail."""

    def unlocated(self, values, times, first, wrong, closed):
        return float(times[first]), wrong

    monkeypatch.setattr(LowerBound, "_locate", unlocated)
    error = compare(LowerBound(law(model, scene, table)).run(scene), exact)
    assert error["velocity_relative"] > 1e-5


def test_lower_bound_bounces_exactly_on_an_open_anode(model, scene):
    scene = impact_scene(scene)
    waves = LowerBound(law(model, scene, None)).run(scene)
    error = compare(waves, reference.impact(model, scene, rtol=1e-10).waves)
    assert error["velocity_relative"] < 1e-6
    assert error["trajectory_m"] < 1e-11


def test_peers_converge_to_the_reference(model, scene, table, exact):
    equations = law(model, scene, table)
    coarse, fine = (compare(integrate(equations, scene, "Radau", r), exact) for r in (1e-3, 1e-5))
    assert fine["velocity_relative"] < 1e-4
    assert fine["trajectory_m"] < coarse["trajectory_m"]


def test_peer_jacobian_is_the_derivative(model, scene, table):
    from laboratory.peers import Peer, _linear
    from laboratory.segments import Segment

    equations = law(model, scene, table)
    x = np.zeros(2 * model.order + 4)
    x[2 * model.order] = -1e-8  # the centre ring is closed
    # as in flight near the set point: the current is not at its limit
    for p, closed in ((-1e-8, True), (1.5e-3 - 1e-8, False)):
        x[2 * model.order] = p
        peer = Peer(equations, Segment(0.0, 1.0, 10.0, 3.0, not closed), _linear(equations))
        J = peer.jacobian(0.0, x)
        for k, step in ((0, 1e-12), (2 * model.order, 1e-12), (2 * model.order + 2, 1e-9)):
            h = np.zeros_like(x)
            h[k] = step
            slope = (peer.rhs(0.0, x + h) - peer.rhs(0.0, x - h)) / (2 * step)
            # central differences of nearly linear rates: rounding of the difference remains
            assert np.allclose(J[:, k], slope, rtol=1e-5, atol=1e-6 * np.abs(slope).max())


def ac_deck(model):
    part = realize(model, Header("forms", "0"))
    rings = [pin.name for pin in part.pins if pin.flow == "N" and pin.name != "base"]
    main = "\n".join(
        ["* forms", f".include {part.filename}", "V1 anode 0 DC 0 AC 1",
         f"Xkick anode 0 {' '.join(rings)} 0 {part.name}",
         *(f"I{ring} 0 {ring} AC {0.1 * (k + 1)}" for k, ring in enumerate(rings)),
         ".ac lin 21 20k 1meg", *(f".save v({ring})" for ring in rings), ".save i(v1)", ".end", ""]
    )  # fmt: skip
    vectors = {ring: (f"v({ring.lower()})", 1.0) for ring in rings} | {"i": ("i(v1)", 1.0)}
    files = {"forms.cir": main, part.filename: part.text}
    return Deck("forms", "forms.cir", files, vectors, None, (part,))


@pytest.mark.parametrize(
    ("form", "behavioural", "limit"),
    [*((form, False, 1e-9) for form in FORMS), ("resonators", True, 1e-7)],
)
def test_every_form_is_the_same_device(model, form, behavioural, limit, tmp_path):
    """Numbers in B sources keep 11 digits, which the resonances magnify; in G sources all."""
    deck = ac_deck(model)
    ours = run_deck(deck, tmp_path / "ours")
    other = run_deck(with_form(deck, model, form, behavioural=behavioural), tmp_path / "other")
    for name in deck.vectors:
        assert np.abs(other[name] - ours[name]).max() <= limit * np.abs(ours[name]).max()


def test_dense_forms_are_dense(model):
    q = model.order
    assert np.count_nonzero(state_space(model, "resonators").A) == 3 * q
    assert np.count_nonzero(state_space(model, "second order").A) == 2 * q * q + q
    assert np.count_nonzero(state_space(model, "first order").A) == 4 * q * q


def test_pareto_front_and_fastest():
    def point(error, time, same=True):
        return Point("f", "l", error, Timing(time, time, time, 1), {"e": error}, same_model=same)

    points = [point(1e-3, 1.0), point(1e-4, 2.0), point(1e-4, 3.0), point(1e-5, 2.5)]
    assert pareto(points) == (True, True, False, True)
    assert fastest(points, {"e": 1e-4}) == points[1]
    assert fastest(points, {"e": 1e-6}) is None
    assert fastest([replace(points[0], same_model=False)], {"e": 1.0}) is None
