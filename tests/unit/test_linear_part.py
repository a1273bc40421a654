"""Linear bodies as parts: small matrices whose answers are known, waves made by hand."""

from types import SimpleNamespace

import numpy as np
import pytest

import kc2spice as kc
from kc2spice.core.waveforms import Waveforms
from kc2spice.parts import matrices
from kc2spice.parts._linear_body import depoling_voltage, file_stamp, impedance, modal_form
from kc2spice.scene.load import load_scene
from kc2spice.scene.parttype import Build
from kc2spice.workflow.verify.circuit import solve

TIP, FOOT = kc.Port("tip", "mechanical"), kc.Port("foot", "mechanical")
IN, OUT = (kc.Port(*of, across="m/s2") for of in (("drive", "input"), ("seen", "output")))


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


# --- what a run says ------------------------------------------------------------------------------


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


# --- figures --------------------------------------------------------------------------------------
