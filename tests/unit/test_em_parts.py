"""Parts of the electromagnetic scenes on a force in closed form, cubic in the height: the splines
through a few heights are exact, and so must be what the parts make of them."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from kc2spice.core.errors import UsageError
from kc2spice.core.progress import Clock
from kc2spice.core.waveforms import Waveforms
from kc2spice.fem.magnetics import field
from kc2spice.fem.magnetics.table import EMTable, inductances
from kc2spice.parts import current_cases, ring_magnet_coils
from kc2spice.parts.ring_magnet_coils import (
    beyond,
    catch_subcircuit,
    coil_subcircuit,
    interpolation_error,
    mounted,
)
from kc2spice.scene.load import load_scene
from kc2spice.scene.parttype import Build
from kc2spice.spice.header import Header
from kc2spice.workflow.verify.circuit import solve

EM = {"name": "em", "em_force": {"currents": (-0.1, 0.3)}, "catch": {}, "sphere": {}}
KEYS = ["catch.positions=5", "catch.remanence=0.1", "catch.shift=0.3 mm", "catch.y_min=-1 mm"]


def terms(y, remanence):
    """Coefficients (..., 6) of the force at heights of an actuator that is not shifted."""
    u = y / 1e-3
    c0, c1, c2 = 2 * u**3 - u + 3, u**2 - 7 * u, 5 - u**3
    one = np.ones_like(u)
    return np.stack(
        [remanence**2 * c0, remanence * c1, remanence * c2, u, 0.5 * u**2, -2 * one], -1
    )


def pull(y, lower, upper, remanence=0.1, shift=0.3e-3):
    """The force of magnets and coils [N]."""
    i = np.array([1.0, lower, upper, lower**2, lower * upper, upper**2])
    return terms(np.asarray(y) - shift, remanence) @ i


def catch_table(catch, radius, progress=None):
    """In place of the field solution: what it would give for the closed form."""
    y = field.positions(catch)
    assert radius == 1e-3
    if progress:
        progress(1, 4)
    n = y.size
    flux, L = np.tile([0.25, 0.5], (n, 1)), np.tile([[4.0, 1.0], [1.0, 3.0]], (n, 1, 1))
    return EMTable(y, *terms(y, catch.remanence).T, flux, L, np.array([5.0, 7.0]), 77)


def scene_of(*keys, scene=None):
    loaded = load_scene(scene or EM, [*KEYS, *keys])
    coils = loaded.parts["catch"]
    return loaded, coils, Build(loaded, {"catch": mounted(catch_table(
        ring_magnet_coils.field_keys(coils), 1e-3), 1.0, 0.3e-3)}, {"catch": "catch"})  # fmt: skip


def test_the_table_is_solved_once_for_a_unit_of_remanence_and_mounted(monkeypatch):
    """Whatever remanence and mounting: one field, the force of the closed form."""
    asked = []

    def noted(catch, radius, progress):
        asked.append((catch.remanence, catch.shift))
        return catch_table(catch, radius, progress)

    monkeypatch.setattr(field, "catch_table", noted)
    monkeypatch.setattr(ring_magnet_coils, "cached", lambda _name, _key, make, **_: (make(), 0))
    scene, coils, _ = scene_of()
    said = []
    found = coils.type.build(coils, scene, Clock(lambda stage, done, text: said.append(done)))
    assert asked == [(1.0, 0.0)]
    assert said == [None, 0.25]
    np.testing.assert_allclose(found.y, np.linspace(-0.7e-3, 7.8e-3, 5), rtol=1e-12)
    got, exact = [found.c0, found.c1, found.c2, found.c11], terms(found.y - 0.3e-3, 0.1)[:, :4]
    np.testing.assert_allclose(np.stack(got, -1), exact, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found.flux0[0], [0.025, 0.05])


def test_the_full_solution_is_the_field_of_every_pair_and_height(monkeypatch):
    """The lower coil's current changes slowest; errors are relative to the largest force."""
    counts, said, now = [], [], [0.0]

    def noted(catch, radius, progress):
        counts.append(catch.positions)
        now[0] += 1.0
        return catch_table(catch, radius, progress)

    def brute_force(catch, radius, pairs, progress):
        now[0] += 30.0
        progress(2, 4)
        y = field.positions(catch)
        forces = np.array([pull(y, *pair, shift=0.0) for pair in pairs])
        forces[2, 3] += 1e-3 * np.abs(forces).max()
        return forces

    monkeypatch.setattr(field, "catch_table", noted)
    monkeypatch.setattr(field, "brute_force", brute_force)
    clock = SimpleNamespace(perf_counter=lambda: now[0])
    monkeypatch.setattr(current_cases, "time", clock)
    scene, _, build = scene_of()
    part = scene.parts["em_force"]
    clock = Clock(lambda stage, done, text: said.append((stage, done, text)))
    found = part.type.full_solution(part, build, clock, False)
    assert counts == [5, 17]
    y = found.waves["sphere.y"]
    np.testing.assert_allclose(y, np.linspace(-0.7e-3, 7.8e-3, 2001), rtol=1e-9, atol=1e-12)
    pairs = [(-0.1, -0.1), (-0.1, 0.3), (0.3, -0.1), (0.3, 0.3)]
    for k, pair in enumerate(pairs):
        force = found.waves[f"catch.force.{k}"]
        np.testing.assert_allclose(force, pull(y, *pair), atol=1e-9 * np.abs(force).max())
    (check,) = found.checks
    assert check.value == pytest.approx(1e-3, rel=1e-6)
    assert check.limit == scene.gates.superposition
    assert found.baselines == {"low_rank": 1.0, "refactor": 30.0}
    assert found.wall_s == 30.0
    assert {("brute force", 0.5, "20 cases"), ("dense sweep", 0.25, "17 heights"),
            ("superposition", 0.25, "four fields per height")} < set(said)  # fmt: skip


def test_laws_and_metrics_of_the_pairs_are_the_closed_form(monkeypatch):
    monkeypatch.setattr(current_cases, "HEIGHTS", 11)
    scene, _, build = scene_of()
    part = scene.parts["em_force"]
    assert part.type.sweep_range(part, scene) == pytest.approx((-0.7e-3, 7.8e-3))
    assert part.type.coil_currents(part, scene) == 0.3
    y = np.linspace(-0.7e-3, 7.8e-3, 11)
    found = solve(build, Waveforms({"sphere.y": y}, {})).results
    pairs = [[-0.1, -0.1], [-0.1, 0.3], [0.3, -0.1], [0.3, 0.3]]
    forces = {f"catch.force.{k}": pull(y, *pair) for k, pair in enumerate(pairs)}
    largest = max(np.abs(f).max() for f in forces.values())
    np.testing.assert_allclose(found["sphere.y"], y, rtol=1e-9, atol=1e-12)
    for name, exact in forces.items():
        np.testing.assert_allclose(found[name], exact, atol=1e-9 * largest)
    told = part.type.metrics(part, build, Waveforms({"sphere.y": y, **forces}, {}))
    assert told["force_max_n"] == largest
    assert told["current_pairs_a"] == pairs
    assert told["force_n"][1] == forces["catch.force.1"].tolist()
    assert part.type.modelled(part, scene).detail == "4 pairs of currents"


def test_a_jump_of_the_lookups_slope_is_told_of_the_largest_slope():
    """Slopes 1, 1, 1.5, 1.5 of one force, a smaller jump of the other: a third."""
    scene, _, build = scene_of()
    part, y = scene.parts["em_force"], np.linspace(0.0, 4.0, 5)
    data = {"sphere.y": y, "catch.force.0": -np.array([0.0, 1.0, 2.0, 3.5, 5.0])}
    data |= {f"catch.force.{k}": 0.2 * (y + y**2 / 20) for k in (1, 2, 3)}
    (check,) = part.type.checks(part, build, Waveforms(data, {}))
    assert check.value == pytest.approx(0.5 / 1.5)
    assert (check.limit, check.action) == (scene.gates.lookup_slope, "warn")


# --- the actuator ---------------------------------------------------------------------------------


def test_facts_arrays_and_head_of_the_actuator_are_those_of_its_table():
    _, coils, build = scene_of()
    facts = coils.type.facts(coils, build)
    y = build.models["catch"].y
    pairs = [(a, b) for a in (-0.1, 0.0, 0.1) for b in (-0.1, 0.0, 0.1)]
    largest = max(np.abs(pull(y, *pair)).max() for pair in pairs)
    told = {"unknowns": 77, "force_max_n": largest, "coil_resistance_ohm": 5.0,
            "coil_inductance_h": 4.0, "coil_mutual_h": 1.0}  # fmt: skip
    assert facts == pytest.approx(told)
    assert set(coils.type.arrays(coils, build)) == {"em_table.npz"}
    (part,) = coils.type.subcircuits(coils, build, Header("t", "0"))
    assert "centre from -700 to 7800 um" in part.text
    assert {p.name: p.default for p in part.params} == {
        "resistance_lower": 5.0, "resistance_upper": 7.0,
    }  # fmt: skip
    other = {"name": "two", "a": {"part": "ring_magnet_coils"}, "sphere": {},
             "b": {"part": "ring_magnet_coils"}}  # fmt: skip
    two = load_scene(other)
    table = build.models["catch"]
    found = two.parts["b"].type.arrays(two.parts["b"], Build(two, {"b": table}))
    assert set(found) == {"b_table.npz"}


def test_currents_and_voltage_of_coils_are_told_at_their_largest():
    scene = load_scene("kick_and_catch")
    coils = scene.parts["catch"]
    build = Build(scene, {})
    waves = {"coil.upper.current": np.array([0.1, -0.3, 0.2])}
    assert coils.type.metrics(coils, build, Waveforms(waves, {})) == {}
    waves["coil.voltage"] = np.array([3.0, -5.0, 4.0])
    found = coils.type.metrics(coils, build, Waveforms(waves, {}))
    assert found == {"coil_voltage_peak_v": 5.0, "coil_current_peak_a": 0.3}


@pytest.mark.parametrize(
    ("low", "high", "left"),
    [(0.0, 1.0, 0.0), (-1.25, 1.0, 0.25), (0.0, 1.5, 0.5), (-2.0, 1.5, 1.0)],
)
def test_how_far_a_sphere_left_the_table(low, high, left):
    table = mounted(catch_table(ring_magnet_coils.Catch(y_min=-1.0, y_max=1.0), 1e-3), 1.0, 0.0)
    assert beyond(table, np.array([low, 0.0, high])) == left


def test_the_error_between_heights_is_of_the_force_at_the_largest_current():
    """A term that only a current brings counts with that current, its square twice."""
    y = np.linspace(-1.0, 1.0, 9)
    zero, rough = np.zeros(9), np.cos(8 * y)
    base = dict.fromkeys(("c0", "c1", "c2", "c11", "c12", "c22"), zero)
    rest = {"y": y, "flux0": np.zeros((9, 2)), "inductance": np.tile(np.eye(2), (9, 1, 1)),
            "resistance": np.ones(2), "unknowns": 0}  # fmt: skip

    def error(current, **named):
        return interpolation_error(EMTable(**{**base, **named}, **rest), current)

    # every second height is zero, and so is the spline through those: an eighth of what it misses
    comb = np.where(np.arange(9) % 2, 1.0, 0.0)
    assert error(0.0, c0=comb) == pytest.approx(1 / 8)
    alone = error(0.0, c0=rough)
    assert alone > 0.01
    for name in ("c1", "c2", "c11", "c12", "c22"):
        assert error(0.7, **{name: rough}) == pytest.approx(alone, rel=1e-9), name
    steady = np.ones(9)
    half = error(0.5, c0=steady, c2=rough) / error(1.0, c0=steady, c2=rough)
    quarter = error(0.5, c0=steady, c22=rough) / error(1.0, c0=steady, c22=rough)
    peak = np.abs(rough).max()
    assert (half, quarter) == pytest.approx((0.5 * max(1, peak), 0.25), rel=1e-9)
    # one current through both coils, the lower one reversed: equal pulls cancel
    assert error(0.5, c0=steady, c1=rough, c2=rough) < 1e-12


def test_the_heights_are_judged_at_the_controllers_limit():
    scene = load_scene("kick_and_catch", ["control.current_limit=0.3"])
    y = np.linspace(-2.5e-3, 7.5e-3, 9)
    rough, one = np.cos(3e3 * y), np.ones(9)
    table = EMTable(y, one, 0 * y, rough, 0 * y, 0 * y, 0 * y, np.zeros((9, 2)),
                    np.tile(np.eye(2), (9, 1, 1)), np.ones(2), 0)  # fmt: skip
    coils = scene.parts["catch"]
    waves = Waveforms({"time": np.arange(2.0), "sphere.y": np.full(2, 1e-3)}, {})
    field_, left = coils.type.checks(coils, Build(scene, {"catch": table}), waves)
    assert field_.value == interpolation_error(table, 0.3) > 1.2 * interpolation_error(table, 0.1)
    assert (field_.limit, left.value, left.limit) == (1e-2, 0.0, 0.0)


@pytest.mark.parametrize(
    ("fits", "refused", "word"),
    [
        ("catch.turns=4110", "catch.turns=4120", "do not fit"),
        ("catch.remanence=1.6", "catch.remanence=1.61", "permanent magnet"),
        ("catch.air_radius=1 m", "catch.air_radius=1.01 m", "fourth power"),
        ("catch.lower.inner=1.001 mm", "catch.lower.inner=1 mm", "does not fit through"),
        ("catch.ring.inner=4.999 mm", "catch.ring.inner=5 mm", "no material left"),
        ("catch.air_height=8.6 mm", "catch.ring.height=30 mm", "beyond the modelled air"),
        ("catch.ring.outer=9.99 mm", "catch.ring.outer=10 mm", "beyond the modelled air"),
        ("catch.upper.y=3 mm", "catch.upper.y=2.99 mm", "overlaps catch.lower"),
        ("catch.y_max=-2.4999 mm", "catch.y_max=-2.5 mm", "empty range"),
    ],
)
def test_where_an_actuator_begins_to_be_refused(fits, refused, word):
    """Coils of 2 mm at 1 and 3 mm touch; wire of 25 um fills a section of 2 mm2 4074 times."""
    load_scene({**EM, "catch": {}}, [fits])
    with pytest.raises(UsageError, match=word) as raised:
        load_scene({**EM, "catch": {}}, [refused])
    if word == "empty range":
        assert raised.value.got == "-0.0025 … -0.0025 m"
    if word == "do not fit":
        assert "4120 turns of 2.5e-05 m wire" in str(raised.value)


def test_side_by_side_bodies_may_share_heights():
    load_scene(EM, ["catch.ring.y=1 mm"])  # beyond the lower coil
    load_scene(EM, ["catch.ring.y=1 mm", "catch.ring.inner=2.3 mm"])  # they touch
    with pytest.raises(UsageError, match="overlaps"):
        load_scene(EM, ["catch.ring.y=1 mm", "catch.ring.inner=2.29 mm"])


def test_a_resting_sphere_lies_within_the_table():
    loop = {"name": "loop", "kick": {}, "contact": {}, "sphere": {}, "catch": {}}
    load_scene(loop, ["catch.y_min=0.99 mm"])
    with pytest.raises(UsageError, match="rest height"):
        load_scene(loop, ["catch.y_min=1 mm"])
    load_scene(loop, ["catch.y_max=1.01 mm"])
    with pytest.raises(UsageError, match="rest height"):
        load_scene(loop, ["catch.y_max=1 mm"])


def test_the_outline_shows_each_body_on_both_sides_where_it_is_mounted():
    scene, coils, _ = scene_of()
    shapes = list(coils.type.outline(coils, scene))
    assert [(s.x, s.y, s.width, s.height) for s in shapes] == [
        pytest.approx((side * x, y + 0.3e-3, width, height))
        for x, y, width, height in ((4.5e-3, 2.5e-3, 1e-3, 1e-3), (1.8e-3, 1e-3, 1e-3, 2e-3),
                                    (1.8e-3, 4e-3, 1e-3, 2e-3))
        for side in (-1, 1)
    ]  # fmt: skip
    assert [bool(s.label) for s in shapes] == [False, True] * 3


def test_a_fall_from_the_top_of_the_table_is_reached():
    scene = load_scene("kick_and_catch")
    coils = scene.parts["catch"]
    chip = scene.parts["kick"]
    (reach,) = coils.type.reach(coils, scene)
    # m g h = 8/15 E* sqrt(R) d^(5/2), and a quarter more
    energy = scene.parts["sphere"].keys.mass * 9.81 * 6.5e-3
    modulus = chip.type.indentation_modulus(chip)
    exact = 1.25 * (15 * energy / (8 * modulus * np.sqrt(1e-3))) ** 0.4
    assert reach.depth == pytest.approx(exact, rel=1e-9)


def test_the_law_of_driven_coils_takes_the_current_once_with_each_sign():
    """The loop's coils by the controller's law; coils of a circuit's own with R, L and back-EMF."""
    scene = load_scene("kick_and_catch")
    coils = scene.parts["catch"]
    table = catch_table(ring_magnet_coils.field_keys(coils), 1e-3)
    found = coils.type.law(coils, Build(scene, {"catch": table}))
    (law,) = found.laws
    assert (law.gains, law.offset) == ((-1.0, 1.0), 1e-3)
    assert {a for a, _ in found.pins} == {"y", "drive"}
    rails = load_scene("coil_rails")
    coils = rails.parts["catch"]
    grown = np.linspace(1.0, 2.0, table.y.size)[:, None, None] * table.inductance
    found = coils.type.law(coils, Build(rails, {"catch": replace(table, inductance=grown)}))
    (law,) = found.laws
    np.testing.assert_array_equal(law.inductance, [[4.0, 1.0], [1.0, 3.0]])  # at the first height
    np.testing.assert_array_equal(law.resistance, [5.0, 7.0])
    assert law.offset == 1e-3
    assert sorted(pin for pin, _ in found.pins) == ["ln", "lp", "un", "up", "y"]
    assert {"coil.lower.current", "coil.upper.current", "coil.voltage"} == set(found.results)
    detail = coils.type.modelled(coils, rails).detail
    assert detail.startswith("41 heights")
    assert detail.endswith("back-EMF")


def test_the_force_map_is_the_force_of_nine_pairs_of_currents():
    """Over the whole table, up to the largest current; 0.1 A where no controller tells any."""
    scene, coils, build = scene_of()
    figure = ring_magnet_coils.force_map(coils, build)
    (panel,) = figure.panels
    y = panel.curves[0].x / 1e3
    np.testing.assert_allclose(y, np.linspace(-0.7e-3, 7.8e-3, 401), rtol=1e-9, atol=1e-12)
    pairs = [(a, b) for a in (-0.1, 0.0, 0.1) for b in (-0.1, 0.0, 0.1)]
    assert [c.label for c in panel.curves] == [f"{1e3 * a:+.3g} / {1e3 * b:+.3g}" for a, b in pairs]
    for curve, pair in zip(panel.curves, pairs, strict=True):
        np.testing.assert_allclose(curve.y, 1e3 * pull(y, *pair), atol=1e-6)
    assert scene.name == "em"
    _, coils, build = scene_of("control.current_limit=0.25", scene="kick_and_catch")
    labels = [c.label for c in ring_magnet_coils.force_map(coils, build).panels[0].curves]
    assert (labels[0], labels[4], labels[-1]) == ("-250 / -250", "+0 / +0", "+250 / +250")


def test_the_impedance_of_coils_is_that_in_the_middle_of_their_field():
    """Each alone, and both as one current with two signs sees them: ``L1 + L2 - 2 M``."""
    _, coils, build = scene_of()
    table = build.models["catch"]
    figure = ring_magnet_coils.coil_impedance(coils, build)
    f = np.geomspace(10.0, 1e5, 201)
    L = inductances(table, 3.55e-3)
    own = {"lower": (5.0, L[0, 0]), "upper": (7.0, L[1, 1]),
           "both": (12.0, L[0, 0] + L[1, 1] - 2 * L[0, 1])}  # fmt: skip
    size, phase = figure.panels
    assert {c.label for c in size.curves} == set(own)
    for a, b in zip(size.curves, phase.curves, strict=True):
        z = own[a.label][0] + 2j * np.pi * f * own[a.label][1]
        np.testing.assert_allclose(1e3 * a.x, f)
        np.testing.assert_allclose(1e3 * b.x, f)
        np.testing.assert_allclose(a.y, np.abs(z), rtol=1e-9)
        np.testing.assert_allclose(b.y, np.angle(z, deg=True), rtol=1e-9)


def test_what_heats_a_wire_by_its_rated_rise_is_known_by_its_section_alone():
    """``rise c A^2 / rho`` of copper of 3.45 MJ/(m3 K), whatever its number of turns."""
    keys = ring_magnet_coils.Coils(wire_diameter=50e-6, resistivity=2e-8, rated_rise=80.0)
    section = np.pi / 4 * 50e-6**2
    exact = 80.0 * 3.45e6 * section**2 / 2e-8
    assert ring_magnet_coils.rated_heating(keys) == pytest.approx(exact, rel=1e-9)
    told = ring_magnet_coils._rating(keys)
    assert told.startswith(f"{exact:.3g} A^2 s in each coil")
    assert "by 80 K without cooling" in told


def test_coils_are_judged_by_the_hotter_of_both():
    """2 A for 1 s in the lower coil, 3 A for half as long in the upper."""
    scene = load_scene("kick_and_catch")
    coils = scene.parts["catch"]
    table = catch_table(ring_magnet_coils.field_keys(coils), 1e-3)
    t = np.array([0.0, 0.5, 0.5, 1.0])
    waves = {"time": t, "sphere.y": np.full(4, 1e-3), "coil.lower.current": np.full(4, -2.0),
             "coil.upper.current": np.array([3.0, 3.0, 0.0, 0.0])}  # fmt: skip
    heat, *_ = coils.type.checks(coils, Build(scene, {"catch": table}), Waveforms(waves, {}))
    assert heat.value == pytest.approx(4.5)
    assert (heat.limit, heat.action) == (ring_magnet_coils.rated_heating(coils.keys), "warn")
    waves["coil.lower.current"] = np.full(4, 2.5)
    heat, *_ = coils.type.checks(coils, Build(scene, {"catch": table}), Waveforms(waves, {}))
    assert heat.value == pytest.approx(6.25)
    none = {name: waves[name] for name in ("time", "sphere.y")}
    checks = list(coils.type.checks(coils, Build(scene, {"catch": table}), Waveforms(none, {})))
    assert len(checks) == 2
    assert not list(coils.type.checks(coils, Build(scene, {"catch": table}), Waveforms({}, {})))


def test_magnets_pull_only_where_their_table_knows_the_force():
    scene = load_scene("kick_and_catch")
    coils = scene.parts["catch"]
    table = catch_table(ring_magnet_coils.field_keys(coils), 1e-3)
    build = Build(scene, {"catch": table})
    y = np.array([1e-3, 2e-3])
    waves = {"sphere.y": y, "coil.lower.current": np.array([0.1, -0.2]),
             "coil.upper.current": np.array([0.3, 0.4])}  # fmt: skip
    remanence = coils.keys.remanence
    found = coils.type.force_on(coils, "v", build, Waveforms(waves, {}))
    exact = [pull(a, b, c, remanence, 0.0) for a, b, c in zip(*waves.values(), strict=True)]
    np.testing.assert_allclose(found, exact, rtol=1e-6)
    alone = coils.type.force_on(coils, "v", build, Waveforms({"sphere.y": y}, {}))
    np.testing.assert_allclose(alone, pull(y, 0.0, 0.0, remanence, 0.0), rtol=1e-6)
    assert coils.type.force_on(coils, "y", build, Waveforms(waves, {})) is None
    assert coils.type.force_on(coils, "v", build, Waveforms({}, {})) is None
    waves["sphere.y"] = np.array([1e-3, 7.6e-3])
    assert coils.type.force_on(coils, "v", build, Waveforms(waves, {})) is None


def test_currents_are_read_with_one_sign_each():
    """One current in the loop; in real coils each its own, with the voltage over both."""
    series, real = ("v(xcatch.i)", -1.0), ("v(xcatch.i1)", 1.0)
    for name, lower in (("kick_and_catch", series), ("coil_rails", real)):
        scene = load_scene(name)
        coils = scene.parts["catch"]
        found = coils.type.vectors(coils, Build(scene, {}))
        vector = found["coil.lower.current"]
        assert (vector.expression, vector.factor) == lower
        assert found["coil.upper.current"].factor == 1.0
        assert ("coil.voltage" in found) is (name == "coil_rails")
    free, coils, build = scene_of()
    assert coils.type.vectors(coils, build) == {}
    assert ring_magnet_coils.largest_current(coils, free) == 0.0


def test_a_current_that_nobody_limits_counts_as_one_ampere():
    scene = load_scene({
        "name": "hand", "sphere": {}, "catch": {"pins": {"y": "gnd", "drive": "cell.out"}},
        "cell": {"part": "source", "dc": 1.0},
    })  # fmt: skip
    assert ring_magnet_coils.largest_current(scene.parts["catch"], scene) == 1.0
    for driver in ("amplifier", "half_bridge", "charge"):  # whose own limits are others
        keys = ["control.current_limit=0.3", f"kick.driver.{driver}.current_limit=9"]
        driven = load_scene("kick_and_catch", keys)
        assert ring_magnet_coils.largest_current(driven.parts["catch"], driven) == 0.3


@pytest.mark.parametrize("feed", [{"part": "source", "dc": 1.0}, {"part": "inductor",
                                  "inductance": 1.0, "pins": {"b": "gnd"}}])  # fmt: skip
def test_only_a_controllers_current_is_a_law_of_driven_coils(feed):
    pin = "out" if feed["part"] == "source" else "a"
    scene = load_scene({
        "name": "hand", "sphere": {}, "catch": {"pins": {"y": "gnd", "drive": f"feed.{pin}"}},
        "feed": feed,
    })  # fmt: skip
    coils = scene.parts["catch"]
    table = catch_table(ring_magnet_coils.field_keys(coils), 1e-3)
    assert coils.type.law(coils, Build(scene, {"catch": table})) is None


def test_the_error_of_the_field_is_known_of_the_papers_actuator():
    for keys, known in (([], True), (["catch.remanence=0.3"], False), (["catch.refine=2"], False),
                        (["sphere.radius=0.9 mm"], False)):  # fmt: skip
        scene = load_scene("kick_and_catch", keys)
        coils = scene.parts["catch"]
        (row,) = coils.type.errors(coils, scene)
        assert row.expected == (4e-4 if known else None)
        assert row.share is None


@pytest.mark.parametrize("make", [catch_subcircuit, coil_subcircuit])
def test_lookups_count_cells_from_the_lowest_height(make):
    """Heights in micrometres, equally spaced over the table."""
    _, _, build = scene_of()
    more = {"current": 0.1} if make is catch_subcircuit else {}
    text = make(Header("t", "0"), build.models["catch"], points=18, **more).text
    per_um = float(re.search(r"(?m)^Gs base s y base (\S+)$", text)[1])
    first = float(re.search(r"(?m)^Is base s (\S+)$", text)[1])
    assert per_um == pytest.approx(1 / 500.0, rel=1e-9)  # 8.5 mm in 17 cells
    assert first == pytest.approx(700 / 500.0, rel=1e-9)
    assert "resampled" in text
    assert "18 heights" in text


def test_coils_know_the_inverse_of_their_inductance():
    """In a mean inductance of both, by its mean over the heights and lookups of what is left."""
    _, _, build = scene_of()
    table = build.models["catch"]
    text = coil_subcircuit(Header("t", "0"), table, points=41).text
    inverse = 3.5 * np.linalg.inv(inductances(table, np.linspace(table.y[0], table.y[-1], 41)))
    cards = dict(re.findall(r"(?m)^(Cj1|Cj2|Gi1|Gi2|Gm1|Gm2) .*?(\S+)$", text))
    mean = inverse.mean(axis=0)
    assert {name: float(value) for name, value in cards.items()} == pytest.approx({
        "Cj1": 3.5, "Cj2": 3.5, "Gi1": mean[0, 0], "Gi2": mean[1, 1], "Gm1": mean[0, 1],
        "Gm2": mean[0, 1],
    }, rel=1e-9)  # fmt: skip


def test_real_coils_are_those_whose_terminals_a_circuit_drives():
    """Their pins, library and names of results; ``coil`` is the paper's catch alone."""
    cell = {"part": "source", "dc": 1.0}
    for name in ("arm", "catch", "door"):
        for pins, far, is_real in (
            ({"up": "cell.out", "lp": "gnd"}, {}, True), ({"drive": "cell.out"}, {}, False),
            ({"y": "gnd"}, {"out": f"{name}.up", "ret": f"{name}.lp"}, True),
        ):  # fmt: skip
            scene = load_scene({"name": "one", "sphere": {}, "cell": cell | {"pins": far},
                                name: {"part": "ring_magnet_coils", "pins": pins}})  # fmt: skip
            coils = scene.parts[name]
            assert ring_magnet_coils.real(coils, scene) is is_real
            own = coils.type.library(coils, scene)
            assert own == ("coil" if is_real and name == "catch" else name)
            ends = [pin.name for pin in coils.type.pins(coils, scene)]
            assert ends[:-3] == (["lp", "ln", "up", "un"] if is_real else ["drive", "ret"])
            found = coils.type.vectors(coils, Build(scene, {}))
            prefix = "coil" if name == "catch" else name
            assert f"{prefix}.upper.current" in found
            assert (f"{prefix}.voltage" in found) is is_real
    scene, coils, _ = scene_of()
    pins = {pin.name: pin.default for pin in coils.type.pins(coils, scene)}
    assert (pins["drive"], pins["ret"], pins["base"]) == ("gnd", "gnd", "gnd")


def test_terms_of_the_force_are_coefficients_and_their_sums_in_series():
    """One current i, -i in the lower coil: c2 - c1 and c11 - c12 + c22."""
    values = np.arange(12.0).reshape(2, 6) ** 2
    own = {term.name: term.of(values) for term in ring_magnet_coils.SEPARATE}
    np.testing.assert_array_equal(np.column_stack(list(own.values())), values)
    assert list(own) == ["c0", "c1", "c2", "c11", "c12", "c22"]
    told = [(t.name, t.currents, t.of(values).tolist()) for t in ring_magnet_coils.SERIES]
    c0, c1, c2, c11, c12, c22 = values.T
    assert told == [("c0", (), c0.tolist()), ("d1", ("i",), (c2 - c1).tolist()),
                    ("d2", ("i", "i"), (c11 - c12 + c22).tolist())]  # fmt: skip


@pytest.mark.parametrize(("share", "kept"), [(0.95e-6, ["c0"]), (1.05e-6, ["c0", "c2", "c22"])])
def test_a_coefficient_counts_with_its_currents_from_a_millionth_on(share, kept):
    """At half an ampere: once, and squared."""
    _, _, build = scene_of()
    one = np.ones(build.models["catch"].y.size)
    few = replace(build.models["catch"], c0=-one, c1=0 * one, c2=-one * 2 * share, c11=0 * one,
                  c12=0 * one, c22=one * 4 * share)  # fmt: skip
    found = ring_magnet_coils.significant(few, 0.5, ring_magnet_coils.SEPARATE)
    assert [term.name for term in found] == kept


def test_eddy_currents_in_the_sphere_are_told_by_its_diffusion_time():
    """``mu sigma R^2 / pi^2`` of 150 kS/m."""
    for keys in ([], ["sphere.radius=0.5 mm"], ["catch.mu_r=1.3"]):
        scene, coils, _ = scene_of(*keys)
        radius, mu = scene.parts["sphere"].keys.radius, 4e-7 * np.pi * coils.keys.mu_r
        eddy, *_ = coils.type.left_out(coils, scene)
        assert eddy.why == "a poor conductor, 150000 S/m"
        assert eddy.error == f"force lags by about {mu * 150e3 * (radius / np.pi) ** 2:.2g} s"


def test_forces_of_current_pairs_have_gates_of_field_and_of_lookup():
    scene = load_scene("em_force", {"gates.field": 0.03, "gates.lookup": 0.002})
    (part,) = (p for p in scene.parts.values() if isinstance(p.type, current_cases.CurrentCases))
    (gate,) = part.type.gates(part, Build(scene, {}))
    assert gate.limits == {"rom_vs_fom": 0.03, "ngspice_vs_rom": 0.002, "ngspice_vs_fom": 0.03}
