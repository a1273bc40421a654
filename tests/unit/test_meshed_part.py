"""Results of bodies whose fields a run recovers, and the ratings of layered bodies."""

from types import SimpleNamespace

import numpy as np
import pytest

from kc2spice.bodies import vtu
from kc2spice.core.errors import UsageError
from kc2spice.core.waveforms import Waveforms
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
    model = SimpleNamespace(certificate=None, facts={}, ports=())
    return part, part.type, Build(loaded, {"beam": model})


WAVES = Waveforms({"time": np.arange(2.0)}, {})


def test_the_worst_instant_and_the_chosen_ones_are_written(monkeypatch, tmp_path):
    written = []
    monkeypatch.setattr(vtu, "write_vtu", lambda path, *state: written.append((path.name, *state)))
    motion = SimpleNamespace(device="device", at=lambda instant: (instant, "volts"))
    part, kind, build = beam_of(monkeypatch, *EXTREMES, motion=motion)
    names = list(kind.write(part, build, WAVES, tmp_path))
    assert names == ["beam_fields.vtu", "beam_fields_1.vtu", "beam_fields_2.vtu"]
    instants = (3e-4, 2e-4, 5e-4)
    assert written == [(n, "device", t, "volts") for n, t in zip(names, instants, strict=True)]


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


# --- figures --------------------------------------------------------------------------------------


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
