"""Linear bodies as parts: small matrices whose answers are known, waves made by hand."""

import re
from types import SimpleNamespace

import numpy as np
import pytest

import kc2spice as kc
from kc2spice.bodies.convergence import MeshError
from kc2spice.core.errors import UsageError
from kc2spice.core.progress import Clock
from kc2spice.core.waveforms import Waveforms
from kc2spice.fem.materials import material
from kc2spice.parts import _linear_body as linear
from kc2spice.parts import matrices
from kc2spice.parts._chipbook import balance, port_forces
from kc2spice.parts._linear_body import busy, depoling_voltage, file_stamp, impedance, modal_form
from kc2spice.rom.linear import Certificate
from kc2spice.rom.march import chip_response
from kc2spice.scene.load import load_scene
from kc2spice.scene.parttype import Build
from kc2spice.spice.realize import COARSE, FOLLOWED
from kc2spice.workflow.verify.circuit import solve

TIP, FOOT = kc.Port("tip", "mechanical"), kc.Port("foot", "mechanical")
ANODE = kc.Port("anode", "electrical", pins=("anode", "cathode"))
IN, OUT = (kc.Port(*of, across="m/s2") for of in (("drive", "input"), ("seen", "output")))


def spring_mass(ports, **more):
    """Two masses of 1 and 2 kg on springs of 3 and 5 N/m, 0.1 of it as damping."""
    K = np.array([[8.0, -5.0], [-5.0, 5.0]])
    n = len(ports)
    B = np.eye(2)[:, :n] if n <= 2 else np.column_stack([np.eye(2), [0.5, 0.25]])
    return kc.LinearModel(M=np.diag([1.0, 2.0]), E=0.1 * K, K=K, B=B, C=B.T, ports=ports, **more)


@pytest.fixture
def body(monkeypatch):
    """A scene with a part ``beam`` whose matrices are a given model."""

    def made(model, *keys, **tables):
        monkeypatch.setattr(matrices, "_read", lambda *_: model)
        monkeypatch.setattr(matrices.Matrices, "files", lambda *_: ("beam.mtx",))
        scene = load_scene({"name": "made", "beam": {"part": "matrices", "file": "beam.mtx"},
                            **tables}, list(keys))  # fmt: skip
        beam = scene.parts["beam"]
        return beam, beam.type, Build(scene, {"beam": model})

    return made


def push(at="tip", **more):
    return {"part": "source", "kind": "force", "dc": 2.0, "pins": {"out": f"beam.{at}"}, **more}


# --- ports and reductions -------------------------------------------------------------------------


def test_only_ports_that_something_needs_are_kept(body):
    beam, kind, build = body(spring_mass((TIP, FOOT)), push=push())
    assert [p.name for p in kind.kept(beam, build.scene)] == ["tip"]
    pins = [(p.name, p.default) for p in kind.pins(beam, build.scene)]
    assert pins == [("tip", None), ("base", "gnd")]
    assert [p.name for p in kind.every_pin(beam, build.scene)] == ["tip", "foot", "base"]
    beam, kind, build = body(spring_mass((TIP, FOOT)))  # alone: it is exported
    assert [p.name for p in kind.kept(beam, build.scene)] == ["tip", "foot"]
    probe = {"probes": {"low": {"of": "beam.u.foot"}}}
    beam, kind, build = body(spring_mass((TIP, FOOT)), push=push(), **probe)
    assert [p.name for p in kind.kept(beam, build.scene)] == ["tip", "foot"]
    with pytest.raises(UsageError, match="no such port"):
        body(spring_mass((TIP, FOOT)), push=push("side"))


def test_a_body_is_touched_at_its_first_mechanical_port(body):
    beam, kind, build = body(spring_mass((ANODE, TIP, FOOT)), push=push())
    assert kind.surface(beam, build.scene).ports == ("tip",)
    surface = kind.surface(beam, build.scene, ("foot", "tip"))
    assert (surface.ports, surface.distance) == (("foot", "tip"), (0.0, 0.0))
    with pytest.raises(UsageError, match="no such mechanical port"):
        kind.surface(beam, build.scene, ("anode",))
    assert kind.indentation_modulus(beam) is None
    layers = {"part": "bimorph", "length": 1e-2, "width": 1e-3,
              "layers": [{"material": "PZT-5A", "thickness": 1e-4},
                         {"material": "steel", "thickness": 1e-4}]}  # fmt: skip
    plate = load_scene({"name": "p", "plate": layers}).parts["plate"]
    assert plate.type.indentation_modulus(plate) == material("steel").indentation_modulus


def test_nothing_said_reduces_over_what_the_analysis_sees(body):
    sweep = {"analysis": {"type": "ac", "start": 1e3, "stop": 5e3}}
    beam, kind, build = body(spring_mass((TIP, FOOT)), push=push(), **sweep)
    rom = kind.reduction(beam, build.scene)
    assert (rom.tolerance, rom.order) == (1e-3, None)
    assert rom.band == pytest.approx((800.0, 6000.0))
    beam, kind, build = body(spring_mass((TIP, FOOT)), "solver.max_step=20 us", push=push())
    rom = kind.reduction(beam, build.scene)
    assert (rom.tolerance, rom.band) == (1e-4, pytest.approx((0.0, 5e3)))
    assert kind.modelled(beam, build.scene).detail == (
        "reduced to as many states as keep the error below 0.0001, band 0 … 5000 Hz; ports tip"
    )
    beam, kind, build = body(spring_mass((TIP, FOOT)), "rom.order=5", push=push())
    assert kind.reduction(beam, build.scene).order == 5
    beam, kind, build = body(spring_mass((TIP, FOOT)), "rom.order=5", "beam.rom.order=2",
                             push=push())  # fmt: skip
    assert kind.reduction(beam, build.scene).order == 2
    assert "reduced to order 2" in kind.modelled(beam, build.scene).detail


def test_ringing_may_be_let_go(body):
    for keys, watch in (([], FOLLOWED), (["solver.ringing=coarse"], COARSE)):
        beam, kind, build = body(spring_mass((TIP, FOOT)), *keys, push=push())
        assert kind.watch(beam, build.scene) == watch
        assert len(list(kind.unfollowed(beam, build.scene))) == bool(keys)


def test_the_model_of_a_body_is_no_larger_than_it(body, monkeypatch):
    """An order above its states is all of them; its facts and band stay."""
    monkeypatch.setattr(linear, "cached", lambda _name, _key, make, **_: (make(), 0))
    full = spring_mass((TIP, FOOT), facts={"mass_kg": 3.0}, band=(0.0, 7.0))
    beam, kind, build = body(full, "beam.rom.order=9", "beam.rom.band=[0, 1]", push=push())
    found = kind.build(beam, build.scene, Clock())
    assert (found.order, found.inputs, found.facts) == (2, ("tip",), {"mass_kg": 3.0})
    f = np.array([0.1, 0.3])
    exact = full.transfer(f)[:, :1, :1]
    np.testing.assert_allclose(found.transfer(f), exact, rtol=1e-6)


def test_matrices_have_no_mesh(body):
    beam, kind, build = body(spring_mass((TIP, FOOT)), push=push())
    assert not list(kind.estimates(beam, build.scene))
    assert kind.full(beam, build.scene, Clock()).order == 2
    with pytest.raises(UsageError, match="cannot be refined"):
        kind.full(beam, build.scene, Clock(), 2)


@pytest.mark.parametrize(
    ("error", "why"), [(0.01, "against cells of half the size"), (None, "takes about 42 s")]
)
def test_the_error_of_a_mesh_is_a_row_of_the_budget(body, monkeypatch, error, why):
    beam, kind, build = body(spring_mass((TIP, FOOT)), push=push())
    told = MeshError("static_compliance_si", error, 42.3)
    monkeypatch.setattr(matrices.Matrices, "mesh_error", lambda *_: told)
    (row,) = kind.estimates(beam, build.scene)
    assert (row.stage, row.expected, row.settings) == ("mesh of beam", error, "static compliance")
    assert why in row.why


# --- laws -----------------------------------------------------------------------------------------


def test_signals_in_and_out_are_a_law_of_first_order(body):
    """Its response is that of the matrices; an acceleration drives it."""
    full = kc.LinearModel(
        M=np.diag([1.0, 2.0]), E=np.array([[0.5, 0.1], [-0.2, 0.4]]),
        K=np.array([[8.0, -5.0], [-4.0, 5.0]]), B=np.array([[1.0], [3.0]]),
        C=np.array([[2.0, -1.0]]), D=np.array([[0.25]]), ports=(IN, OUT),
    )  # fmt: skip
    source = {"part": "source", "kind": "acceleration", "ac": 1.0, "pins": {"out": "beam.drive"}}
    load = {"part": "resistor", "resistance": 1.0, "pins": {"a": "more.out"}}
    sweep = {"analysis": {"type": "ac", "start": 0.1, "stop": 1.0}}
    _, _, build = body(full, source=source, load=load, **sweep,
                       more={"part": "source", "dc": 0.0})  # fmt: skip
    f = np.array([0.15, 0.4, 0.9])
    found = solve(build, Waveforms({"frequency": f}, {})).results
    for k, each in enumerate(f):
        s = 2j * np.pi * each
        exact = full.C @ np.linalg.solve(s**2 * full.M + s * full.E + full.K, full.B) + full.D
        assert found["beam.seen"][k] == pytest.approx(exact[0, 0], rel=1e-9)
    first = kc.LinearModel(E=2 * np.eye(1), A=-3 * np.eye(1), B=np.ones((1, 1)), C=np.eye(1),
                           ports=(IN, OUT))  # fmt: skip
    _, _, build = body(first, source=source, load=load, **sweep,
                       more={"part": "source", "dc": 0.0})  # fmt: skip
    found = solve(build, Waveforms({"frequency": f}, {})).results["beam.seen"]
    np.testing.assert_allclose(found, 1 / (2j * np.pi * f * 2 + 3), rtol=1e-9)


def test_a_voltage_that_only_signals_listen_to_is_a_signal(body):
    """What draws a current too keeps it electrical."""
    ports = (kc.Port("drive", "input", across="V"), kc.Port("seen", "output", across="V"))
    first = kc.LinearModel(E=2 * np.eye(1), A=-3 * np.eye(1), B=np.ones((1, 1)), C=np.eye(1),
                           ports=ports)  # fmt: skip
    source = {"part": "source", "ac": 2.0, "pins": {"out": "beam.drive"}}
    sweep = {"analysis": {"type": "ac", "start": 0.1, "stop": 1.0}}
    _, _, build = body(first, source=source, **sweep)
    f = np.array([0.2, 0.5])
    found = solve(build, Waveforms({"frequency": f}, {})).results
    np.testing.assert_allclose(found["beam.seen"], 2 / (2j * np.pi * f * 2 + 3), rtol=1e-9)
    np.testing.assert_allclose(found["source.v"], 2.0)
    load = {"part": "resistor", "resistance": 5.0, "pins": {"a": "source.out"}}
    for more in ({"load": load}, {"cell": {"part": "source", "dc": 1.0,
                                           "pins": {"out": "source.ret"}}}):  # fmt: skip
        _, _, build = body(first, source=source, **sweep, **more)
        (law,) = build.scene.parts["source"].type.law(build.scene.parts["source"], build).laws
        assert law.kind == "voltage"


def test_damping_that_couples_the_modes_is_a_law_of_the_matrices(body):
    full = kc.LinearModel(
        M=np.diag([1.0, 2.0]), E=np.array([[0.9, -0.2], [-0.2, 0.3]]),
        K=np.array([[8.0, -5.0], [-5.0, 5.0]]), B=np.eye(2)[:, :1], ports=(TIP,),
    )  # fmt: skip
    assert modal_form(full) is None
    sweep = {"analysis": {"type": "ac", "start": 0.1, "stop": 1.0}}
    _, _, build = body(full, push=push(ac=1.0), **sweep)
    f = np.array([0.2, 0.5])
    found = solve(build, Waveforms({"frequency": f}, {})).results["beam.u.tip"]
    np.testing.assert_allclose(found, full.transfer(f)[:, 0, 0], rtol=1e-9)


def test_a_body_on_a_moving_base_has_no_law_of_its_own(body):
    model = spring_mass((TIP, FOOT)).select(["tip"])
    table = {"part": "mass", "mass": 1.0, "pins": {"a": "beam.base"}}
    hold = {"part": "spring", "stiffness": 1.0, "pins": {"a": "beam.base"}}
    beam, kind, build = body(model, push=push(), table=table, hold=hold)
    assert kind.law(beam, build) is None
    beam, kind, build = body(model, push=push())
    assert kind.law(beam, build) is not None


# --- what a run says ------------------------------------------------------------------------------


def test_rating_and_head_follow_what_is_known(body):
    model = spring_mass((ANODE, TIP))
    cell = {"part": "source", "dc": 1.0, "pins": {"out": "beam.anode"}}
    for keys, facts, limit in (([], {}, None), (["beam.rated_voltage=7"], {}, 7.0),
                               ([], {"depoling_voltage_v": 9.0}, 9.0)):  # fmt: skip
        told = spring_mass((ANODE, TIP), facts=facts)
        beam, kind, build = body(told, *keys, cell=cell, push=push())
        assert kind.limit(beam, build) == limit
        waves = Waveforms({"time": np.arange(2.0), "beam.voltage": np.array([1.0, -8.0])}, {})
        checks = list(kind.checks(beam, build, waves))
        assert [(c.value, c.limit, c.action) for c in checks] == (
            [] if limit is None else [(8.0, limit, "warn")]
        )
        library = Build(build.scene, build.models, {"beam": "beam"})
        (part,) = kind.subcircuits(beam, library, kc.spice.header.Header("t", "0"))
        words = " ".join(part.text.replace("*", " ").split())
        assert ("key rated_voltage states" in words) == (limit is None)
        assert (f"{limit:g} V between electrodes" in words) if limit else True
    assert model.order == 2


def test_a_sweep_may_end_at_the_bands_rounded_end(body):
    certificate = Certificate((0.0, 100.0), 1e-3, "made up", True, True)
    model = spring_mass((TIP, FOOT), certificate=certificate)
    beam, kind, build = body(model, push=push())
    for top, passed in ((100.0, True), (100.0 * (1 + 5e-10), True), (100.0001, False)):
        waves = Waveforms({"frequency": np.array([1.0, top])}, {})
        (check,) = kind.checks(beam, build, waves)
        assert check.passed is passed


@pytest.mark.parametrize(("real", "known"), [(1.0, True), (-9e-4, True), (-1.1e-3, False)])
def test_an_impedance_is_its_own_where_nothing_feeds_back(real, known):
    """A lossless body rounds; one that feeds the circuit does not show its impedance."""
    z = np.array([1.0 + 0j, real + 1j])
    waves = {"frequency": np.array([1.0, 2.0]), "beam.voltage": 3 * z, "beam.current": z * 0 + 3}
    part = SimpleNamespace(name="beam")
    found = impedance(part, Waveforms(waves, {}))
    assert (found is not None) is known
    if known:
        np.testing.assert_allclose(found, z)
    still = Waveforms(waves | {"beam.current": np.array([0.0, 1.0])}, {})
    assert impedance(part, still) is None
    for name in waves:
        less = Waveforms({k: v for k, v in waves.items() if k != name}, {})
        assert impedance(part, less) is None


def test_what_moves_most_is_shown_with_a_tenth_on_either_side():
    t = np.linspace(0.0, 10.0, 1001)
    size = np.where((t > 3.999) & (t < 6.001), 1.0, 0.019)
    inside = t[busy(t, size)]
    assert (inside[0], inside[-1]) == pytest.approx((3.8, 6.2), abs=0.02)
    assert busy(t, 0 * t).all()


def test_the_depoling_voltage_is_that_of_the_weakest_layer():
    """PZT-5A 0.7 kV/mm, PZT-5H 0.4: side by side the thinner, in series one field for all."""

    def layers(*given):
        return [SimpleNamespace(material=name, thickness=1e-3 * mm) for name, mm in given]

    both = layers(("PZT-5A", 0.2), ("PZT-5H", 0.5), ("steel", 9.0))
    assert depoling_voltage(both, "x", series=False) == pytest.approx(140.0)
    assert depoling_voltage(both, "x", series=True) == pytest.approx(0.4e6 * 0.7e-3)
    assert depoling_voltage(layers(("steel", 1.0)), "x", series=True) is None


def test_files_are_known_by_what_they_hold(tmp_path):
    one, two = tmp_path / "a", tmp_path / "b"
    one.write_bytes(b"x")
    two.write_bytes(b"x")
    assert file_stamp(one) == file_stamp(two) != file_stamp(tmp_path / "c") == "absent"


def test_forces_on_a_body_are_those_of_all_its_neighbours(body):
    spring = {"part": "spring", "stiffness": 1.0, "pins": {"a": "beam.tip"}}
    beam, _, build = body(spring_mass((TIP, FOOT)), push=push(), spring=spring)
    waves = {"time": np.arange(2.0), "push.force": np.array([2.0, 3.0]),
             "spring.force": np.array([0.0, 0.5])}  # fmt: skip
    found = port_forces(beam, build, Waveforms(waves, {}))
    np.testing.assert_allclose(found["tip"], [2.0, 2.5])
    waves.pop("spring.force")
    assert port_forces(beam, build, Waveforms(waves, {})) is None
    assert beam.type.energy(beam, build, Waveforms({}, {})) == {}


def test_only_a_body_at_rest_of_resonators_has_an_energy_balance(body):
    """With every voltage and force known: not with modes that damping couples, nor turned, nor
    shaken."""
    waves = {"time": np.arange(3.0), "push.force": np.zeros(3), "beam.u.tip": np.zeros(3)}
    known = Waveforms(waves, {})
    plain = spring_mass((TIP, FOOT)).select(["tip"])
    beam, kind, build = body(plain, push=push())
    assert set(kind.energy(beam, build, known)) == {"beam"}
    assert (
        kind.energy(beam, build, Waveforms({k: waves[k] for k in ("time", "beam.u.tip")}, {})) == {}
    )
    coupled = kc.LinearModel(
        M=plain.M, E=np.array([[0.9, -0.2], [-0.2, 0.3]]), K=plain.K, B=plain.B, ports=(TIP,)
    )
    beam, kind, build = body(coupled, push=push())
    assert kind.energy(beam, build, known) == {}
    turned = spring_mass((TIP, kc.Port("turn", "rotational")))
    beam, kind, build = body(turned, "beam.pins={turn='gnd'}", push=push())
    assert "turn" in [port.name for port in kind.kept(beam, build.scene)]
    assert kind.energy(beam, build, known) == {}
    cell = {"part": "source", "dc": 1.0, "pins": {"out": "beam.anode"}}
    beam, kind, build = body(spring_mass((ANODE, TIP)), push=push(), cell=cell)
    assert kind.energy(beam, build, known) == {}
    voltage = Waveforms(waves | {"beam.voltage": np.zeros(3)}, {})
    assert set(kind.energy(beam, build, voltage)) == {"beam"}
    shake = {"part": "source", "kind": "acceleration", "pins": {"out": "beam.frame"}}
    shaken = spring_mass((TIP, kc.Port("frame", "acceleration")))
    beam, kind, build = body(shaken, push=push(), shake=shake)
    assert kind.energy(beam, build, known) == {}


def test_the_balance_of_a_pressed_body_ends_with_its_load():
    """A resonator under a force that ends: what its displacement misses later does not count."""
    model = modal_form(spring_mass((TIP, FOOT)).select(["tip"]))
    t = np.linspace(0.0, 2.0, 2001)
    force = np.where(t < 1.0, np.sin(np.pi * t), 0.0)
    exact = chip_response(model, t, force[:, None])
    moved = exact.output[:, 0]
    late = np.where(t > 1.2, moved + 0.01, moved)
    early = np.where((t > 0.4) & (t < 0.9), moved + 0.01, moved)
    for wave, pressed, misses in ((moved, False, False), (late, True, False), (early, True, True)):
        waves = Waveforms({"time": t, "beam.u.tip": wave}, {})
        found = balance("beam", model, waves, {"tip": force}, pressed=pressed)
        assert (found.missing > 1e-4) is misses
        assert found.scale == pytest.approx(np.ptp(exact.stored))
        if wave is moved:
            taken = float(np.sum((force[1:] + force[:-1]) / 2 * np.diff(moved)))
            assert found.entries["work of the contact"] == pytest.approx(taken, rel=1e-9)
            stored, damped = found.entries["stored"], found.entries["damped"]
            assert stored + damped == pytest.approx(taken, rel=1e-6)
            assert damped > 0


def test_results_have_the_names_and_units_of_the_ports(body):
    """The first electrical port speaks for the body; acceleration and rotation are SI."""
    ports = (ANODE, kc.Port("sense", "electrical", pins=("sense", "cathode")), TIP,
             kc.Port("turn", "rotational"), kc.Port("frame", "acceleration"))  # fmt: skip
    B = np.array([[1.0, 0.5, 0.3, 0.2, 0.1], [0.1, 0.4, 0.2, 0.3, 0.6]])
    model = kc.LinearModel(M=np.eye(2), E=0.1 * np.eye(2), K=2 * np.eye(2), B=B, C=B.T, ports=ports)
    beam, kind, build = body(
        model, cell={"part": "source", "dc": 1.0, "pins": {"out": "beam.anode"}}, push=push(),
        load={"part": "resistor", "resistance": 1e3, "pins": {"a": "beam.sense"}},
        shake={"part": "source", "kind": "acceleration", "pins": {"out": "beam.frame"}},
    )  # fmt: skip
    found = kind.vectors(beam, build)
    units = {name: (v.factor, v.unit) for name, v in found.items()}
    assert units["beam.u.tip"] == (1e-6, "m")
    assert units["beam.a.frame"] == (1.0, "m/s2")
    assert units["beam.voltage"] == units["beam.sense.voltage"] == (1.0, "V")
    assert "beam.current" in found
    assert found["beam.sense.current"].factor == -1e-3  # v over 1 kOhm leaves it
    rows = kind.static_compliance(beam, build, ("tip",))
    assert rows[0, 0] == pytest.approx((0.3**2 + 0.2**2) / 2)
    told = kind.rom(beam, build)
    assert (told["order"], told["massless"], told["ports"][2]) == (2, 0, "tip")
    assert kind.energy(beam, build, Waveforms({"time": np.arange(2.0)}, {})) == {}


def test_voltages_are_read_between_the_nodes_that_are_not_ground(body):
    """A current where exactly one part feeds the electrode and tells it."""
    sense = kc.Port("sense", "electrical", pins=("sense", "cathode"))
    B = np.array([[1.0, 0.5], [0.1, 0.4]])
    model = kc.LinearModel(M=np.eye(2), E=np.eye(2), K=np.eye(2), B=B, C=B.T, ports=(ANODE, sense))
    cell = {"part": "source", "dc": 1.0, "pins": {"out": "beam.anode"}}
    load = {"part": "resistor", "resistance": 1e3, "pins": {"a": "beam.cathode"}}
    aside = {"part": "resistor", "resistance": 1e3, "pins": {"a": "beam.anode"}}
    for tables, keys, anode, sensed, metered in (
        ({"cell": cell}, [], "v(anode)", "v(sense)", True),
        ({"cell": cell, "load": load}, [], "v(anode)-v(cathode)", "v(sense)-v(cathode)", True),
        ({"cell": cell, "aside": aside}, [], "v(anode)", "v(sense)", False),
        ({"load": load}, ["beam.pins={anode='gnd'}"], "-v(cathode)", "v(sense)-v(cathode)", False),
        ({}, ["beam.pins={anode='gnd'}"], None, "v(sense)", False),
    ):  # fmt: skip
        beam, kind, build = body(model, *keys, **tables)
        found = kind.vectors(beam, build)
        names = {build.net(beam, pin): pin for pin in ("anode", "sense", "cathode")}

        def read(name, found=found, names=names):
            if name not in found:
                return None
            return re.sub(r"v\((\w+)\)", lambda m: f"v({names[m[1]]})", found[name].expression)

        assert (read("beam.voltage"), read("beam.sense.voltage")) == (anode, sensed)
        assert ("beam.current" in found) is metered
    beam, kind, build = body(model, "beam.rated_voltage=5", cell=cell)
    waves = {"time": np.arange(2.0), "beam.voltage": np.array([1.0, -4.0]),
             "beam.sense.voltage": np.array([6.0, 3.0])}  # fmt: skip
    checks = list(kind.checks(beam, build, Waveforms(waves, {})))
    assert [(c.name, c.value) for c in checks] == [
        ("rating of beam", 4.0), ("rating of beam.sense", 6.0)
    ]  # fmt: skip
    waves.pop("beam.voltage")
    (check,) = kind.checks(beam, build, Waveforms(waves, {}))
    assert check.name == "rating of beam.sense"


def test_ports_on_ground_have_no_result(body):
    one, two = np.eye(2), np.eye(2)[:, :1]
    tip = kc.LinearModel(M=one, E=one, K=one, B=one, C=one, ports=(TIP, FOOT))
    beam, kind, build = body(tip, "beam.pins={tip='gnd'}", push=push("foot"))
    assert set(kind.vectors(beam, build)) == {"beam.u.foot"}
    source = {"part": "source", "kind": "acceleration", "pins": {"out": "beam.drive"}}
    signal = kc.LinearModel(M=one, E=one, K=one, B=two, C=two.T, ports=(IN, OUT))
    beam, kind, build = body(signal, source=source)
    found = kind.vectors(beam, build)
    assert {n: (v.factor, v.unit) for n, v in found.items()} == {
        "beam.drive": (1.0, "m/s2"), "beam.seen": (1.0, "m/s2"),
    }  # fmt: skip
    beam, kind, build = body(signal, "beam.pins={drive='gnd'}")
    assert set(kind.vectors(beam, build)) == {"beam.seen"}


def test_electrodes_share_a_cathode_that_is_grounded_unless_something_joins_it(body):
    sense = kc.Port("sense", "electrical", pins=("sense", "cathode"))
    B = np.eye(3)
    model = kc.LinearModel(M=B, E=B, K=B, B=B, C=B, ports=(ANODE, sense, TIP))
    cell = {"part": "source", "dc": 1.0, "pins": {"out": "beam.anode"}}
    beam, kind, build = body(model, cell=cell, push=push())
    pins = {pin.name: pin.default for pin in kind.pins(beam, build.scene)}
    assert pins == {"anode": None, "cathode": "gnd", "sense": None, "tip": None, "base": "gnd"}
    load = {"part": "resistor", "resistance": 1e3, "pins": {"a": "beam.cathode"}}
    beam, kind, build = body(model, cell=cell, load=load, push=push())
    pins = {pin.name: pin.default for pin in kind.pins(beam, build.scene)}
    assert pins["cathode"] is None
    B = B[:, :1]
    signals = kc.LinearModel(M=np.eye(3), E=np.eye(3), K=np.eye(3), B=B, C=B.T, ports=(IN, OUT))
    beam, kind, build = body(signals)
    pins = {pin.name: (pin.flow, pin.signal_out) for pin in kind.pins(beam, build.scene)}
    assert pins == {"drive": ("-", False), "seen": ("-", True), "ref": ("A", False)}


def test_a_body_is_touched_with_the_modulus_of_its_top_layer():
    layers = [{"material": "PZT-5A", "thickness": "0.3 mm"},
              {"material": "steel", "thickness": "0.3 mm"}]  # fmt: skip
    scene = load_scene({"name": "b", "beam": {"part": "bimorph", "length": "30 mm",
                                             "width": "5 mm", "layers": layers}})  # fmt: skip
    beam = scene.parts["beam"]
    assert beam.type.indentation_modulus(beam) == material("steel").indentation_modulus


def test_massless_states_are_counted(body):
    model = kc.LinearModel(M=np.diag([1.0, 0.0]), E=np.zeros((2, 2)), K=np.eye(2),
                           B=np.eye(2)[:, :1], ports=(TIP,))  # fmt: skip
    beam, kind, build = body(model, push=push())
    assert kind.rom(beam, build)["massless"] == 1
    first = kc.LinearModel(E=np.eye(2), K=np.eye(2), B=np.eye(2)[:, :1], ports=(TIP,))
    beam, kind, build = body(first, push=push())
    assert kind.rom(beam, build)["massless"] == 0


# --- figures --------------------------------------------------------------------------------------


def resonator(**more):
    """A capacitance of 2 F with an arm of 1 kg on 1e6 N/m, 0.5 N/V, damped by 1 N s/m."""
    return kc.LinearModel(
        M=np.eye(1), E=np.eye(1), K=1e6 * np.eye(1), B=np.array([[0.5]]), C=np.array([[0.5]]),
        D=np.array([[2.0]]), ports=(ANODE,), **more,
    )  # fmt: skip


def own_figures(low, high, model=None):
    certificate = Certificate((low, high), 1e-3, "made up", True, True)
    part = SimpleNamespace(name="beam")
    return list(linear._own_impedances(part, model or resonator(certificate=certificate)))


def test_an_impedance_is_drawn_over_its_band_and_around_its_resonances():
    """Two per cent on either side in steps of a thousandth; from a 300th of the top on."""
    (figure,) = own_figures(0.0, 1500.0)
    size, phase = (panel.curves[0] for panel in figure.panels)
    f = size.x
    assert (f[0], f[-1]) == (pytest.approx(5.0), 1500.0)
    pole = 1e3 / (2 * np.pi)
    near = f[np.abs(f / pole - 1) < 0.0301]
    wanted = pole * (1 + 1e-3 * np.arange(-20, 21))
    assert np.isclose(near[:, None], wanted, rtol=1e-12).any(axis=0).all()
    assert not np.isclose(near[:, None], pole * np.array([0.979, 1.021]), rtol=1e-12).any()
    w = 2 * np.pi * f
    charge = 2.0 + 0.25 / (1e6 - w**2 + 1j * w)
    z = 1 / (1j * w * charge)
    np.testing.assert_allclose(size.y, np.abs(z), rtol=1e-9)
    np.testing.assert_allclose(phase.y, np.angle(z, deg=True), rtol=1e-9)
    assert figure.name == "beam_impedance"
    (figure,) = own_figures(100.0, 1500.0)
    assert figure.panels[0].curves[0].x[0] == 100.0
    (figure,) = own_figures(0.0, 160.0)  # its resonance lies at 159.2 Hz
    assert figure.panels[0].curves[0].x[-1] == 160.0
    (figure,) = own_figures(159.0, 1500.0)
    assert figure.panels[0].curves[0].x[0] == 159.0
    bare = resonator()
    assert not own_figures(0.0, 1.0, bare)
    certificate = Certificate((5.0, 1500.0), 1e-3, "made up", True, True)
    first = kc.LinearModel(E=np.eye(1), K=np.eye(1), B=np.eye(1), D=np.eye(1), ports=(ANODE,),
                           certificate=certificate)  # fmt: skip
    (figure,) = own_figures(5.0, 1500.0, first)  # without resonances
    np.testing.assert_allclose(figure.panels[0].curves[0].x, np.geomspace(5.0, 1500.0, 600))
    assert not list(linear._own_impedances(SimpleNamespace(name="beam"), None))


@pytest.mark.parametrize(
    ("first", "last", "log", "label", "scale"),
    [(1.0, 20.0, False, "Hz", 1.0), (1.0, 20.1, True, "Hz", 1.0), (0.0, 100.0, False, "Hz", 1.0),
     (4e3, 5e3, False, "Hz", 1.0), (4e3, 5001.0, False, "kHz", 1e3),
     (10.0, 6e3, True, "kHz", 1e3)],
)  # fmt: skip
def test_axes_of_an_impedance_follow_its_range(first, last, log, label, scale):
    f, z = np.array([first, last]), np.array([3 + 4j, -2j])
    figure = linear.impedance_figure("beam", f, z, "as measured")
    size, phase = figure.panels
    assert (size.log_x, phase.log_x, size.log_y, phase.log_y) == (log, log, True, False)
    assert phase.x == f"frequency in {label}"
    for panel, y in ((size, [5.0, 2.0]), (phase, [np.degrees(np.arctan2(4, 3)), -90.0])):
        np.testing.assert_allclose(panel.curves[0].x, f / scale)
        np.testing.assert_allclose(panel.curves[0].y, y)


def test_a_response_shows_displacements_above_voltages():
    part = SimpleNamespace(name="beam")
    data = {"beam.u.tip": np.array([3e-6 + 4e-6j, 1e-6]), "beam.voltage": np.array([2.0, -5.0]),
            "beam.sense.voltage": np.array([1j, 0.0]), "other.voltage": np.ones(2)}  # fmt: skip
    for last, log in ((20.0, False), (21.0, True)):
        waves = Waveforms({"frequency": np.array([1.0, last]), **data}, {})
        (figure,) = linear.response_figures(part, waves)
        moved, volts = figure.panels
        assert (moved.y, volts.y) == ("displacement in µm", "voltage in V")
        assert (moved.x, volts.x) == ("", "frequency in Hz")
        assert (moved.log_x, volts.log_x, moved.log_y, volts.log_y) == (log, log, True, True)
        curves = {c.label: c.y.tolist() for c in (*moved.curves, *volts.curves)}
        assert curves == {"tip": pytest.approx([5.0, 1.0], rel=1e-9), "voltage": [2.0, 5.0],
                          "sense.voltage": [1.0, 0.0]}  # fmt: skip
    rest = Waveforms({"frequency": np.array([0.0, 21.0]), "beam.voltage": np.ones(2)}, {})
    (figure,) = linear.response_figures(part, rest)
    (panel,) = figure.panels
    assert (panel.log_x, panel.y) == (False, "voltage in V")
    nothing = Waveforms({"frequency": np.arange(2.0), "other.voltage": np.ones(2)}, {})
    assert not list(linear.response_figures(part, nothing))


def test_ports_are_shown_while_they_move_with_voltage_and_current_below():
    part, t = SimpleNamespace(name="beam"), np.linspace(0.0, 1.0, 1001)
    moving = (t > 0.3995) & (t < 0.6005)
    data = {"time": t, "beam.u.tip": np.where(moving, 3e-6, 0.0),
            "beam.u.foot": np.where(moving, -3e-6, 0.0)}  # fmt: skip
    more = {"beam.voltage": 2 * t, "beam.current": 3 * t}
    for extra, labels in (({}, ["displacement in µm"]), ({"beam.voltage"}, ["voltage in V"]),
                          (set(more), ["voltage in V", "current in A"])):  # fmt: skip
        waves = Waveforms(data | {name: more[name] for name in extra}, {})
        (figure,) = linear.port_figures(part, waves)
        assert [panel.y for panel in figure.panels][-len(labels) :] == labels
        assert [panel.x for panel in figure.panels] == [*[""] * len(extra), "time in ms"]
        tip, foot = figure.panels[0].curves
        assert (tip.label, foot.label) == ("tip", "foot")
        assert (tip.x[0], tip.x[-1]) == pytest.approx((380.0, 620.0), abs=2.0)
        assert (tip.y.max(), foot.y.min()) == pytest.approx((3.0, -3.0), rel=1e-9)
        if extra:
            np.testing.assert_allclose(figure.panels[1].curves[0].y, 2e-3 * tip.x)
    assert not list(linear.port_figures(part, Waveforms({"time": t}, {})))
    still = {k: v for k, v in data.items() if k != "time"}
    assert not list(linear.port_figures(part, Waveforms(still, {})))
