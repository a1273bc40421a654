"""libngspice inside the process: same results as the batch engine, Python in the loop."""

import sys

import numpy as np
import pytest
from device import deck_of
from support import (
    Deck,
    SampledSource,
    SimulationError,
    declare_sphere,
    make_opamp_subcircuit,
    pyspice_subcircuit,
    run_deck,
    run_in_libngspice,
)
from support import make_declared_subcircuit as declared


def test_shared_engine_gives_the_batch_engines_points(varied, model, table, tmp_path):
    deck = deck_of(varied(**{"solver.stop": 0.6e-3}), model, table)
    shares = []
    shared, batch = run_in_libngspice(deck, progress=shares.append), run_deck(deck, tmp_path)
    assert set(shared.data) == set(batch.data)
    np.testing.assert_allclose(shared["time"], batch["time"], rtol=1e-12, atol=1e-18)
    for name in ("sphere.y", "contact.force", "kick.current"):
        np.testing.assert_allclose(shared[name], batch[name], rtol=1e-9, atol=1e-12)
    assert shares == sorted(shares)
    assert shares[-1] == pytest.approx(1.0)


RC = """* rc
Vexternal a 0 EXTERNAL
Vsample sample 0 PULSE(0 1 4e-06 1e-09 1e-09 5.999e-06 1e-05)
R1 a b 1000
C1 b 0 1e-09
.tran 1e-07 1e-04
.save v(a) v(b)
.end
"""


def rc(text=RC):
    vectors = {"a": ("v(a)", 1.0), "b": ("v(b)", 1.0)}
    return Deck(name="rc", text=text, vectors=vectors, stop=1e-4)


def sampled(call):
    return [SampledSource("vexternal", 10e-6, 4e-6, call)]


def test_failing_function_is_reported():
    def broken(time, values):
        raise ZeroDivisionError("no answer")

    with pytest.raises(SimulationError, match="the Python function of the controller failed"):
        run_in_libngspice(rc(), sampled(broken))


def test_failing_circuit_is_reported_and_leaves_the_engine_usable():
    with pytest.raises(SimulationError):
        run_in_libngspice(rc(RC.replace("R1 a b 1000", "Xr a b nothing_of_this_name")))
    assert run_in_libngspice(rc())["time"][-1] == pytest.approx(1e-4)


def test_parts_are_pyspice_subcircuits(header):
    sys.modules.get("PySpice") or pytest.importorskip("PySpice")
    from PySpice.Spice.Netlist import Circuit

    part = declared(header, "sphere", declare_sphere(1e-5, 1e-3, 9.81), {})
    circuit = Circuit("a sphere in Python")
    circuit.subcircuit(pyspice_subcircuit(part))
    circuit.subcircuit(pyspice_subcircuit(make_opamp_subcircuit(header)))
    circuit.X("ball", "sphere", "v", "bottom", "y", circuit.gnd, mass=2e-5)
    circuit.I("push", circuit.gnd, "v", 2e-5 * 9.81 + 2e-5)
    text = str(circuit)
    assert text.count(".subckt sphere v bottom y base") == 1
    text += ".tran 1e-06 1e-03 uic\n.save v(v)\n.end\n"
    deck = Deck(name="ball", text=text, vectors={"v": ("v(v)", 1.0)}, stop=1e-3)
    assert run_in_libngspice(deck)["v"][-1] == pytest.approx(1e-3, rel=1e-6)  # 1 m/s^2 for 1 ms
