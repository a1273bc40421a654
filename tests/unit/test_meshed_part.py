"""Bodies whose fields a run recovers: what they tell, judge, draw and write, on meshes by hand."""

from types import SimpleNamespace

import numpy as np
import pytest
from skfem import MeshHex, MeshQuad

from kc2spice.bodies import vtu
from kc2spice.core.errors import UsageError
from kc2spice.core.waveforms import Waveforms
from kc2spice.parts import _meshed as meshed
from kc2spice.parts._meshed import Recovered
from kc2spice.scene.load import load_scene
from kc2spice.scene.parttype import Build

LAYERS = [{"material": "PZT-5A", "thickness": "0.3 mm"}] * 2
BEAM = {
    "name": "beam", "solver": {"stop": 1e-3},
    "beam": {"part": "bimorph", "length": "30 mm", "width": "5 mm", "layers": LAYERS,
             "fields": [2e-4, 5e-4], "pins": {"anode": "cell.out"}},
    "cell": {"part": "source", "dc": 1.0},
}  # fmt: skip


def extreme(quantity, material, value, limit, unit="Pa", **more):
    told = {"material": material, "value": value, "limit": limit, "unit": unit, "instant": 3e-4}
    return SimpleNamespace(quantity=quantity, **told, **more)


EXTREMES = (
    extreme("principal_stress", "PZT-5A (soft)", 4e6, 5e6),
    extreme("principal_stress", "steel", 9e6, None),
    extreme("electric_field", "PZT-5A (soft)", 2e5, 1e6, "V/m"),
    extreme("opposing_field", "PZT-5A (soft)", 8e5, 7e5, "V/m"),
)


def beam_of(monkeypatch, *extremes, motion=None, scene=BEAM, keys=()):
    loaded = load_scene(scene, list(keys))
    part = loaded.parts["beam"]
    found = Recovered(motion, extremes)
    monkeypatch.setattr(
        type(part.type), "recovered", lambda *_: found if part.keys.fields else None
    )
    model = SimpleNamespace(certificate=None, facts={})
    return part, part.type, Build(loaded, {"beam": model})


WAVES = Waveforms({"time": np.arange(2.0)}, {})


def test_extremes_are_told_with_their_limits(monkeypatch):
    part, kind, build = beam_of(monkeypatch, *EXTREMES)
    assert kind.metrics(part, build, WAVES) == {
        "stress_pzt_5a_soft_pa": 4e6, "stress_limit_pzt_5a_soft_pa": 5e6, "stress_steel_pa": 9e6,
        "field_pzt_5a_soft_v_m": 2e5, "field_limit_pzt_5a_soft_v_m": 1e6,
        "opposing_field_pzt_5a_soft_v_m": 8e5, "opposing_field_limit_pzt_5a_soft_v_m": 7e5,
        "worst_stress_time_s": 3e-4,
    }  # fmt: skip
    none, kind, build = beam_of(monkeypatch, *EXTREMES, keys=["beam.fields=false"])
    assert kind.metrics(none, build, WAVES) == {}
    assert not list(kind.checks(none, build, WAVES))
    assert not list(kind.write(none, build, WAVES, None))


def test_what_has_a_limit_is_checked_and_warned_of(monkeypatch):
    part, kind, build = beam_of(monkeypatch, *EXTREMES)
    checks = {c.name: c for c in kind.checks(part, build, WAVES)}
    assert list(checks) == [
        "principal stress in PZT-5A (soft) of beam", "electric field in PZT-5A (soft) of beam",
        "opposing field in PZT-5A (soft) of beam",
    ]  # fmt: skip
    assert [(c.value, c.limit) for c in checks.values()] == [(4e6, 5e6), (2e5, 1e6), (8e5, 7e5)]
    assert {c.action for c in checks.values()} == {"warn"}
    advice = [c.advice for c in checks.values()]
    assert [word in text for word, text in zip(("crack", "break down", "depolarise"), advice,
                                               strict=True)] == [True] * 3  # fmt: skip


def test_the_worst_instant_and_the_chosen_ones_are_written(monkeypatch, tmp_path):
    written = []
    monkeypatch.setattr(vtu, "write_vtu", lambda path, *state: written.append((path.name, *state)))
    motion = SimpleNamespace(device="device", at=lambda instant: (instant, "volts"))
    part, kind, build = beam_of(monkeypatch, *EXTREMES, motion=motion)
    names = list(kind.write(part, build, WAVES, tmp_path))
    assert names == ["beam_fields.vtu", "beam_fields_1.vtu", "beam_fields_2.vtu"]
    instants = (3e-4, 2e-4, 5e-4)
    assert written == [(n, "device", t, "volts") for n, t in zip(names, instants, strict=True)]


def test_fields_are_recovered_once_a_run(monkeypatch):
    from kc2spice.bodies import fields, recover

    asked = []
    monkeypatch.setattr(recover, "recover", lambda device, t, loads: asked.append(set(loads)) or t)
    monkeypatch.setattr(fields, "extremes", lambda motion: [motion])
    scene = load_scene(BEAM)
    part, build = scene.parts["beam"], Build(scene, {})
    monkeypatch.setattr(type(part.type), "device", lambda *_: "device")
    one = Waveforms({"time": np.arange(3.0)}, {})
    found = part.type.recovered(part, build, one)
    assert part.type.recovered(part, build, one) is found
    assert asked == [{"anode"}]
    again = Waveforms(one.data, {})
    assert part.type.recovered(part, build, again) is not found
    assert len(asked) == 2
    assert part.type.recovered(part, build, Waveforms({}, {})) is None
    quiet = load_scene(BEAM, ["beam.fields=false"])
    assert part.type.recovered(quiet.parts["beam"], Build(quiet, {}), one) is None


def test_every_load_of_a_body_is_taken_from_the_run():
    """What nobody joins rests; a force that nobody records is an error."""
    scene = load_scene({
        **BEAM, "push": {"part": "source", "kind": "force", "dc": 1.0, "pins": {"out": "beam.tip"}},
        "shake": {"part": "source", "kind": "acceleration", "pins": {"out": "beam.base"}},
    })  # fmt: skip
    part, build = scene.parts["beam"], Build(scene, {})
    one, two, three = np.arange(9.0).reshape(3, 3) + 1
    data = {"time": np.arange(3.0), "beam.voltage": one, "push.force": two, "beam.a.base": three}
    found = part.type.loads(part, build, Waveforms(data, {}))
    assert {name: values.tolist() for name, values in found.items()} == {
        "anode": [1, 2, 3], "tip": [4, 5, 6], "base": [7, 8, 9],
    }  # fmt: skip
    quiet = {k: data[k] for k in ("time", "push.force")}
    found = part.type.loads(part, build, Waveforms(quiet, {}))
    assert (found["anode"].tolist(), found["base"].tolist()) == ([0, 0, 0], [0, 0, 0])
    data.pop("push.force")
    with pytest.raises(UsageError, match="every load") as raised:
        part.type.loads(part, build, Waveforms(data, {}))
    assert "a force on tip" in raised.value.got


def test_the_voltage_of_a_stack_is_that_of_its_only_electrodes():
    """Whose ports come after its rings."""
    push = {"part": "source", "kind": "force", "dc": 1.0, "pins": {"out": "kick.ring0"}}
    scene = load_scene({"name": "s", "kick": {"fields": True}, "push": push})
    kick = scene.parts["kick"]
    data = {"time": np.arange(2.0), "kick.voltage": np.array([5.0, 6.0]),
            "push.force": np.array([1.0, 2.0])}  # fmt: skip
    found = kick.type.loads(kick, Build(scene, {}), Waveforms(data, {}))
    assert {name: v.tolist() for name, v in found.items()} == {"ring0": [1, 2], "anode": [5, 6]}


# --- figures --------------------------------------------------------------------------------------


def test_stress_and_field_are_drawn_over_time_with_limits_that_are_near():
    """From a fifth of a limit on; a field against the poling where it is one."""
    t = np.array([0.0, 1e-3])

    def row(quantity, material, value, limit):
        return extreme(quantity, material, value, limit, time=t, curve=np.array([0.0, value]))

    near, far = row("principal_stress", "a", 1.1e6, 5e6), row("principal_stress", "b", 0.9e6, 5e6)
    field = row("electric_field", "a", 3e6, None)
    figure = meshed._over_time("beam", Recovered(None, (near, far, field)))
    stress, volts = figure.panels
    assert stress.levels == ((5.0, "limit"),)
    assert volts.levels == ()
    assert [c.label for c in stress.curves] == ["a", "b"]
    np.testing.assert_allclose(stress.curves[0].x, [0.0, 1.0])
    np.testing.assert_allclose(stress.curves[0].y, [0.0, 1.1])
    np.testing.assert_allclose(volts.curves[0].y, [0.0, 3.0])
    figure = meshed._over_time("beam", Recovered(None, (far,)))
    assert figure.panels[0].levels == ()
    given = {"a": (2e6, 1e6), "b": (-1e6, 1e6), "c": (1e6, None), "d": (0.0, 1e6)}
    against = [row("opposing_field", name, *of) for name, of in given.items()]
    (panel,) = meshed._over_time("beam", Recovered(None, tuple(against))).panels
    assert [c.label for c in panel.curves] == ["a"]


def test_a_deformed_body_is_enlarged_to_a_tenth_of_its_size():
    """Three corners of a plate of 2 m move up by 4, 2 and 1 mm: 0.2 m over 4 mm are 50 times."""
    mesh = MeshQuad.init_tensor(np.array([0.0, 2.0]), np.array([0.0, 1.0]))
    up = np.array([0.0, 4e-3, 2e-3, 1e-3])
    solid = SimpleNamespace(
        mesh=mesh, components=2, basis=lambda _: SimpleNamespace(nodal_dofs=np.arange(4)[None])
    )
    device = SimpleNamespace(solid=solid, displacement=np.eye(8))
    asked = []

    def at(instant, sizes=(1.0,)):
        asked.append(instant)
        return np.column_stack([0 * up, sizes[0] * up]).ravel(), None

    motion = SimpleNamespace(device=device, at=at)
    figure = meshed._deformed("beam", "deformed_1", Recovered(motion, ()), 2e-3, "as chosen")
    assert set(asked) == {2e-3}
    rest, moved = figure.panels[0].curves
    assert moved.label == "displacement x 50"
    assert figure.caption == "At 2 ms, as chosen."
    np.testing.assert_array_equal(moved.x, rest.x)
    lifted = {(x, y): v - y for x, y, v in zip(rest.x, rest.y, moved.y, strict=True) if x == x}
    wanted = {tuple(1e3 * p): 50e3 * u for p, u in zip(mesh.p.T, up, strict=True)}
    assert lifted == pytest.approx(wanted)
    motion.at = lambda _: (np.zeros(8), None)
    figure = meshed._deformed("beam", "deformed", Recovered(motion, ()), 0.0, "x")
    assert figure.panels[0].curves[1].label == "displacement x 1"


def box(a, b, c):
    return MeshHex.init_tensor(*(np.linspace(0.0, float(n), n + 1) for n in (a, b, c)))


def test_edges_of_a_plane_mesh_are_its_boundary():
    mesh = MeshQuad.init_tensor(np.arange(4.0), np.arange(3.0))
    assert meshed._edges(mesh).shape == (2, 10)


def test_a_fine_surface_is_drawn_by_its_edges_alone():
    """From a thousand faces on: 4 (a + b + c) of a box, all 4 (ab + bc + ca) of a coarser one."""
    assert meshed._edges(box(10, 10, 20)).shape == (2, 160)
    assert meshed._edges(box(10, 10, 19)).shape == (2, 4 * (100 + 190 + 190))


@pytest.mark.parametrize(("angle", "seen"), [(24.0, False), (27.0, True)])
def test_a_bend_of_25_degrees_makes_an_edge(angle, seen):
    """``tan(angle / 2)^2`` above a twentieth, of a roof over the whole width."""
    mesh = box(10, 10, 20)
    slope = np.tan(np.radians(angle / 2))
    lifted = mesh.p.copy()
    lifted[2] -= slope * np.abs(lifted[0] - 5.0) * lifted[2] / 20.0
    found = meshed._edges(type(mesh)(lifted, mesh.t))
    middle = np.all(np.isclose(lifted[0][found], 5.0) & np.isclose(lifted[2][found], 20.0), axis=0)
    assert middle.sum() == (10 if seen else 0)


def test_wires_are_drawn_in_oblique_projection_with_gaps():
    points = np.array([[0.0, 1.0, 2.0], [0.0, 2.0, 4.0], [0.0, 3.0, 5.0]])
    curve = meshed._wires("w", points, np.array([[0, 1], [1, 2]]), "--")
    x, z = 1e3 * (points[0] + 0.35 * points[1]), 1e3 * (points[2] + 0.35 * points[1])
    nan = np.nan
    np.testing.assert_allclose(curve.x, [x[0], x[1], nan, x[1], x[2], nan])
    np.testing.assert_allclose(curve.y, [z[0], z[1], nan, z[1], z[2], nan])
    assert (curve.label, curve.style) == ("w", "--")
    flat = meshed._wires("w", points[:2], np.array([[0], [2]]), "-")
    np.testing.assert_allclose(flat.y, [0.0, 4e3, nan])


# --- ports and ratings by keys --------------------------------------------------------------------


def alone(kind, **keys):
    scene = load_scene({"name": "one", "it": {"part": kind, **keys}})
    part = scene.parts["it"]
    return part, part.type, scene


PLATE = {"length": "30 mm", "width": "5 mm"}
STEEL = [{"material": "steel", "thickness": "1 mm"}]


@pytest.mark.parametrize(
    ("keys", "names"),
    [
        ({"layers": LAYERS}, ["anode", "tip", "base"]),
        ({"layers": LAYERS, "support": "clamped", "points": {"middle": "15 mm"}},
         ["anode", "middle", "base"]),
        ({"layers": LAYERS, "support": "simply_supported"}, ["anode", "tip", "base"]),
        ({"layers": LAYERS, "support": "free"}, ["anode", "tip"]),
        ({"layers": STEEL}, ["tip", "base"]),
    ],
)  # fmt: skip
def test_a_beam_has_the_ports_that_its_support_leaves(keys, names):
    part, kind, scene = alone("bimorph", **PLATE, **keys)
    assert [port.name for port in kind.ports(part, scene)] == names


def test_a_beam_is_rated_by_its_layers_and_their_wiring():
    """PZT-5A of 0.7 kV/mm: 0.3 mm each, one after the other or side by side."""
    part, kind, scene = alone("bimorph", **PLATE, layers=LAYERS, wiring="parallel")
    assert kind.rated(part) == pytest.approx(210.0)
    shapes = list(kind.outline(part, scene))
    assert [(s.y, s.width, s.height) for s in shapes] == [
        pytest.approx((-0.15e-3, 30e-3, 0.3e-3)), pytest.approx((-0.45e-3, 30e-3, 0.3e-3)),
    ]  # fmt: skip
    assert [s.kind for s in shapes] == ["ceramic", "ceramic"]
    for wiring in ({"wiring": "series"}, {}):
        part, kind, _ = alone("bimorph", **PLATE, layers=LAYERS, **wiring)
        assert kind.rated(part) == pytest.approx(420.0)


def test_a_disc_shows_its_layers_from_the_bottom_up():
    layers = [{"material": "brass", "diameter": "20 mm", "thickness": "0.2 mm"},
              {"material": "PZT-5A", "diameter": "15 mm", "thickness": "0.3 mm"}]  # fmt: skip
    part, kind, scene = alone("disc", layers=layers)
    assert [p.name for p in kind.ports(part, scene)] == ["anode", "centre"]
    assert kind.rated(part) == pytest.approx(210.0)
    shapes = list(kind.outline(part, scene))
    assert [(s.x, s.y, s.width, s.height, s.kind) for s in shapes] == [
        (0.0, pytest.approx(-0.15e-3), 15e-3, 0.3e-3, "ceramic"),
        (0.0, pytest.approx(-0.4e-3), 20e-3, 0.2e-3, "metal"),
    ]
    assert shapes[0].label == "it: PZT-5A, 15 mm by 0.3 mm"
    for wiring, volts in (("parallel", 210.0), ("series", 420.0)):
        part, kind, _ = alone("disc", layers=[layers[1], layers[1]], wiring=wiring)
        assert kind.rated(part) == pytest.approx(volts)
    told = {"feedback": {"inner": "8 mm", "outer": "10 mm"}}
    part, kind, scene = alone("disc", layers=[layers[0], layers[1] | told])
    pins = {p.name: p.terminals for p in kind.ports(part, scene)}
    assert pins == {"anode": ("anode", "cathode"), "feedback": ("feedback", "cathode"),
                    "centre": ("centre",)}  # fmt: skip


def test_a_sandwich_is_rated_by_one_ring_and_has_its_free_faces():
    keys = {
        "front": [{"material": "aluminium", "diameter": "20 mm", "length": "30 mm"}],
        "back": [{"material": "steel", "diameter": "20 mm", "length": "20 mm"}],
        "rings": {"material": "PZT-5A", "outer": "20 mm", "inner": "8 mm", "thickness": "3 mm"},
        "bolt": {"material": "steel", "diameter": "6 mm"},
    }  # fmt: skip
    part, kind, scene = alone("langevin", **keys)
    assert kind.rated(part) == pytest.approx(2100.0)
    assert [p.name for p in kind.ports(part, scene)] == ["anode", "front", "back"]
    part, kind, scene = alone("langevin", **keys, support="back")
    assert [p.name for p in kind.ports(part, scene)] == ["anode", "front"]
