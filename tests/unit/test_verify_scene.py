"""What ``verify`` looks at in a scene and in each body, on solutions made by hand."""

import numpy as np
import pytest

from kc2spice.core.progress import Clock, silent
from kc2spice.core.waveforms import Waveforms
from kc2spice.rom.linear import Certificate, LinearModel, Port
from kc2spice.scene.load import load_scene
from kc2spice.workflow.models import build_models
from kc2spice.workflow.verify import circuit

# -------------------------------------------------------------------------------------- bodies

KINDS = {"tip": "mechanical", "turn": "rotational", "anode": "electrical", "base": "acceleration",
         "u1": "input", "y1": "output"}  # fmt: skip
# kinds as files spell them: equal words, not the same objects
PORTS = {name: Port(name, "".join(list(kind))) for name, kind in KINDS.items()}
CERTIFICATE = Certificate((0.0, 200.0), 1e-5, "told", True, True)


def body(names, hertz=(10.0, 100.0), **more):
    """Resonators with these ports, damped by 1 %; electrodes have 2 nF of their own."""
    omega = 2 * np.pi * np.array(hertz)
    rng = np.random.default_rng(4)
    inputs = [n for n in names if KINDS[n] != "output"]
    outputs = [n for n in names if KINDS[n] != "input"]
    B = rng.uniform(1, 2, (omega.size, len(inputs)))
    C = rng.uniform(1, 2, (len(outputs), omega.size)) if "y1" in names else B.T
    D = np.zeros((len(C), B.shape[1]))
    if "anode" in names:
        D[outputs.index("anode"), inputs.index("anode")] = 2e-9
    return LinearModel(
        M=np.eye(omega.size), E=np.diag(0.02 * omega), K=np.diag(omega**2), B=B, C=C, D=D,
        ports=tuple(PORTS[n] for n in names), certificate=CERTIFICATE, name="b", **more,
    )  # fmt: skip


# ----------------------------------------------------------------------------- circuits of laws

LADDER = {
    "name": "ladder",
    "amp": {"part": "source", "dc": 6.0, "ac": 2.0, "pins": {"out": "top.a"}},
    "top": {"part": "resistor", "resistance": 100.0},
    "low": {"part": "resistor", "resistance": 200.0, "pins": {"a": "top.b"}},
    "store": {"part": "capacitor", "capacitance": 1e-6, "pins": {"a": "top.b"}},
    "own": {"part": "source", "dc": 3.0, "pins": {"out": "load.a"}},
    "load": {"part": "resistor", "resistance": 10.0},
}


def built(**more):
    return build_models(load_scene(LADDER | more), Clock(silent))


def test_an_operating_point_is_kirchhoffs():
    build = built(analysis={"type": "op"})
    found = circuit.solve(build, Waveforms({"sweep": np.zeros(1)}, {}))
    assert found.imbalance is None
    results = found.results
    np.testing.assert_allclose(results["store.v"], 4.0)
    np.testing.assert_allclose(results["load.v"], 3.0)
    assert next(iter(results.data)) == "sweep"


def test_small_signals_are_those_of_the_divider():
    build = built(analysis={"type": "ac", "start": 10.0, "stop": 1e5, "points": 3})
    frequency = np.array([10.0, 1e3, 1e5])
    found = circuit.solve(build, Waveforms({"frequency": frequency + 0j}, {})).results
    parallel = 1 / (1 / 200 + 2j * np.pi * frequency * 1e-6)
    np.testing.assert_allclose(found["store.v"], 2 * parallel / (100 + parallel), rtol=1e-9)
    np.testing.assert_allclose(found["load.v"], 0.0, atol=1e-15)  # no constant part


def test_a_sweep_moves_its_own_circuit_alone():
    build = built(analysis={"type": "dc", "sweep": "amp.dc", "from": 0.0, "to": 9.0, "points": 4})
    found = circuit.solve(build, Waveforms({"sweep": np.arange(4.0)}, {})).results
    np.testing.assert_allclose(found["store.v"], [0.0, 2.0, 4.0, 6.0], atol=1e-12)
    np.testing.assert_allclose(found["load.v"], 3.0)


def test_a_transient_is_read_at_its_own_points_up_to_the_end():
    """A divider that charges: ``v = 4 (1 - exp(-t / T))``, T = 1 uF x 66.7 Ohm."""
    amp = {"part": "source", "pwl": [[0, 0], [1e-12, 6], [1, 6]], "pins": {"out": "top.a"}}
    build = built(amp=amp, solver={"stop": "0.2 ms"})
    times = np.array([0.0, 1e-4, 5e-5, 1e-4, 2e-4 + 1e-12])
    found = circuit.solve(build, Waveforms({"time": times}, {}))
    t = found.results["time"]
    assert (np.diff(t) > 0).all()
    assert t[-1] == 2e-4
    assert {5e-5, 1e-4} <= set(t)
    exact = 4 * (1 - np.exp(-t / (1e-6 * 200 / 3)))
    np.testing.assert_allclose(found.results["store.v"], exact, atol=1e-6)
    assert 0 <= found.imbalance < 1e-6


# ------------------------------------------------------------------- parts that have no law

FILTER = "* a filter of somebody's\n.subckt rc in out\nR1 in out 1k\nC1 out 0 1n\n.ends\n"
FILTERED = {
    "name": "filtered",
    "amp": {"part": "source", "pwl": [[0, 0], [1e-4, 6]], "pins": {"out": "rc.in"}},
    "rc": {"part": "netlist", "file": "rc.lib", "subckt": "rc"},
    "r": {"part": "resistor", "resistance": 100.0, "pins": {"a": "rc.out"}},
    "c": {"part": "capacitor", "capacitance": 1e-7, "pins": {"a": "r.b"}},
    "solver": {"stop": 1e-4},
}


@pytest.fixture
def filtered(tmp_path, monkeypatch):
    """A scene with a subcircuit of the user's own between a source and a load."""
    (tmp_path / "rc.lib").write_text(FILTER)
    monkeypatch.chdir(tmp_path)

    def make(**more):
        tables = {k: v for k, v in (FILTERED | more).items() if v is not None}
        return build_models(load_scene(tables), Clock(silent))

    return make
