"""Runs fail where ngspice prints that it simulated another circuit than the netlist states."""

import numpy as np
import pytest
from support import SimulationError, list_changed_cards

import kc2spice as kc

BRIDGE = """* bridge drawn in LTspice with its piecewise linear diodes
.subckt rect p n plus minus
D1 p plus IDEAL
D2 n plus IDEAL
D3 minus p IDEAL
D4 minus n IDEAL
C1 plus minus 47n
{model}
.ends rect
"""
PIECEWISE = ".model IDEAL D(Ron=0.5 Roff=100Meg Vfwd=0.25 Vrev=60)"
TOML = """
[rect]
part = "netlist"
file = "bridge.lib"
subckt = "rect"
pins = { p = "g.out", n = "g.ret", plus = "load.a", minus = "gnd" }
[load]
part = "resistor"
resistance = "10 kOhm"
[g]
part = "source"
sine = { amplitude = "3 V", frequency = "10 kHz" }
[analysis]
type = "transient"
stop = "0.2 ms"
[probes]
out = { of = "load.v", take = "final" }
"""


def scene(folder, model):
    (folder / "bridge.lib").write_text(BRIDGE.format(model=model))
    path = folder / "br.toml"
    path.write_text(TOML)
    return path


def test_unknown_model_parameters_fail_a_run(tmp_path):
    path = scene(tmp_path, PIECEWISE)
    with pytest.raises(SimulationError, match="ignored or replaced") as caught:
        kc.run(path)
    words = ("ideal", "ron", "roff", "vfwd", "vrev")
    assert all(word in caught.value.got for word in words)
    assert "--trust" in caught.value.hint


def test_trusted_runs_warn(tmp_path):
    path = scene(tmp_path, PIECEWISE)
    with pytest.warns(UserWarning, match="- ignored") as told:
        result = kc.run(path, trust=True)
    warned = " ".join(str(row.message) for row in told)
    assert all(f"({word})" in warned for word in ("ron", "roff", "vfwd", "vrev"))
    assert np.isfinite(result.metrics["out"])


def test_a_deck_without_a_scene_also_fails(tmp_path):
    with pytest.raises(SimulationError, match="ignored or replaced"):
        kc.simulate(kc.deck(scene(tmp_path, PIECEWISE)))


def test_ratings_for_display_only_warn(tmp_path):
    rated = ".model IDEAL D(IS=1e-9 N=1.2 Iave=200m Vpk=40)"
    with pytest.warns(UserWarning, match="iave"):
        result = kc.run(scene(tmp_path, rated))
    assert 1.0 < result.metrics["out"] < 3.0


# Lines of ngspice 39, by the netlists that make it print them.
ALTERED = (
    "Warning: redefinition of .subckt sub, ignored",
    "Warning: BJT model qq, parameter fc limited to 0.9999",
    "Warning : Nodeset on non-existent node - qq, ignored",
    "r2: Instance temperature specified, dtemp ignored",
    "MIF: unrecognized parameter (foo) - ignored",
    "r0: resistance to low, set to 1 mOhm",
    "illegal (too high) argument to level parameter - level=1 assumed",
    "Level must be < 99 (Setting Level to 1)",
)
UNALTERED = (
    "Circuit: * what if damping is ignored",
    ".print line ignored since rawfile was produced.",
    "Note: v1: has no value, DC 0 assumed",
    "Note: v2: dc value used for op instead of transient time=0 value.",
    "Note: No compatibility mode selected!",
    "set_to                                  1.25",
)


@pytest.mark.parametrize("line", ALTERED)
def test_alterations_are_read(line):
    assert list_changed_cards(f"Doing analysis\n{line}\r\n{line}\n") == (line,)


def test_other_notes_are_no_alterations():
    assert list_changed_cards("\n".join(UNALTERED)) == ()


def test_an_alteration_names_its_model():
    log = (
        "Warning: Model issue on line 5 :\n  .model sw sw(ron=1 vser=2) ...\n"
        "unrecognized parameter (vser) - ignored\n"
    )
    assert list_changed_cards(log) == (
        ".model sw sw(ron=1 vser=2): unrecognized parameter (vser) - ignored",
    )
