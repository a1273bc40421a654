"""Names in a deck are unique, whatever parts and pins are called: its nets are the scene's."""

import re

import numpy as np
import pytest
from device import built
from support import UsageError, export_scene, load_scene, make_deck, read_lib, run_deck

import kc2spice as kc


def test_nets_with_similar_names_stay_separate(tmp_path, monkeypatch):
    """Both pins would be ``n_c_a``: 1 V and 2 V would be one net."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "one.lib").write_text(".subckt one c_a ref\nV1 c_a ref 1\nR1 c_a ref 1k\n.ends\n")
    (tmp_path / "two.lib").write_text(".subckt two a ref\nR0 s a 1\nV2 s ref 2\n.ends\n")
    scene = load_scene({
        "name": "alike", "analysis": {"stop": 1e-5}, "solver": {"max_step": 1e-6},
        "n": {"part": "netlist", "file": "one.lib", "subckt": "one"},
        "n_c": {"part": "netlist", "file": "two.lib", "subckt": "two"},
        "r1": {"part": "resistor", "resistance": 1e6, "pins": {"a": "n.c_a"}},
        "r2": {"part": "resistor", "resistance": 1e6, "pins": {"a": "n_c.a"}},
    })  # fmt: skip
    waves = run_deck(make_deck(built(scene)), tmp_path)
    np.testing.assert_allclose(waves["r1.v"], 1.0, rtol=1e-9)
    np.testing.assert_allclose(waves["r2.v"], 2.0, rtol=2e-6)  # 1 Ohm against 1 MOhm


def test_pins_that_differ_in_case_only_are_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "one.lib").write_text(".subckt one A a\nR1 A a 1k\n.ends\n")
    with pytest.raises(UsageError, match="differ in letter case only"):
        load_scene({"name": "one", "n": {"part": "netlist", "file": "one.lib", "subckt": "one",
                    "pins": {"A": "gnd"}}})  # fmt: skip


MATRICES = """
[{part}]
part = "matrices"
file = "m.npz"
{number}
pins = {{ plate = "v.out" }}
[v]
part = "source"
ac = "1 V"
[analysis]
type = "ac"
start = "10 Hz"
stop = "8 kHz"
points = 20
"""


@pytest.mark.parametrize(
    ("scene", "part", "number", "name"),
    [
        ("first", "body", "", "first_body"),
        ("first", "body", 'number = "7BB-20-6"', "body_7BB_20_6"),
        ("first", "body", 'number = "FT-39T-2.5B1"', "FT_39T_2_5B1"),
        ("a" * 60, "body", "", "a" * 43 + "_body"),
    ],
)
def test_a_library_carries_the_part_number_or_scene_and_part(scene, part, number, name, tmp_path):
    K = np.diag((2 * np.pi * np.array([1e3, 3e3])) ** 2)
    np.savez(tmp_path / "m.npz", M=np.eye(2), E=1e-6 * K, K=K, B=[[1e-3], [2e-3]], D=[[1e-9]])
    ports = '[[ports]]\nname = "plate"\nkind = "electrical"\ncolumn = 1\n'
    (tmp_path / "m.toml").write_text(ports)
    path = tmp_path / f"{scene}.toml"
    path.write_text(MATRICES.format(part=part, number=number))
    files = {file.name for file in export_scene(load_scene(path), tmp_path / "out")}
    assert f"{name}.lib" in files
    (library,) = read_lib(tmp_path / "out" / f"{name}.lib")
    assert library.name == name
    (deck,) = (tmp_path / "out").glob("*.cir")
    assert re.search(rf"(?m)^X{part} .* {name}$", deck.read_text())


TWO = """
[a]
part = "matrices"
file = "m.npz"
number = "FT-1"
pins = {{ plate = "v.out" }}
[b]
part = "matrices"
file = "{second}.npz"
number = "FT-1"
pins = {{ plate = "v.out" }}
[c]
part = "matrices"
file = "{second}.npz"
number = "FT-1"
pins = {{ plate = "v.out" }}
[v]
part = "source"
ac = "1 V"
[analysis]
type = "ac"
start = "10 Hz"
stop = "8 kHz"
points = 3
"""


@pytest.mark.parametrize("second", ["m", "n"])
def test_equal_bodies_of_one_part_number_share_a_library(second, tmp_path):
    """Far below all resonances the current is that of ``D + B' K^-1 B``."""
    w2 = (2 * np.pi * np.array([100e3, 300e3])) ** 2
    farad = {}
    for name, share in (("m", 1.0), ("n", 3.0)):
        B, D = share * np.array([[1.0], [2.0]]), np.array([[1e-9]])
        farad[name] = float((D + B.T @ (B / w2[:, None]))[0, 0])
        matrices = {"M": np.eye(2), "E": 1e-9 * np.diag(w2), "K": np.diag(w2), "B": B, "D": D}
        np.savez(tmp_path / f"{name}.npz", **matrices)
        ports = '[[ports]]\nname = "plate"\nkind = "electrical"\ncolumn = 1\n'
        (tmp_path / f"{name}.toml").write_text(ports)
    path = tmp_path / "pair.toml"
    path.write_text(TWO.format(second=second))
    deck = kc.deck(load_scene(path))
    used = {card.name[1]: card.model for card in deck.items if card.name in ("Xa", "Xb", "Xc")}
    assert used == dict.fromkeys("abc", "FT_1") | (
        {} if second == "m" else dict.fromkeys("bc", "pair_b")
    )
    waves = run_deck(deck, tmp_path / "out")
    f = waves["frequency"].real[0]
    current = abs(waves["v.i"][0])
    assert current == pytest.approx(2 * np.pi * f * (farad["m"] + 2 * farad[second]), rel=1e-4)


def test_one_name_of_two_libraries_is_refused_with_both_parts(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, ohm in (("one", 1), ("two", 2)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "r.lib").write_text(f".subckt r a ref\nR1 a ref {ohm}k\n.ends\n")
    scene = load_scene({"name": "pair", "analysis": {"stop": 1e-5},
        "n": {"part": "netlist", "file": "one/r.lib", "subckt": "r"},
        "m": {"part": "netlist", "file": "two/r.lib", "subckt": "r", "pins": {"a": "n.a"}},
    })  # fmt: skip
    with pytest.raises(UsageError, match="n and m have different libraries with the same") as told:
        make_deck(built(scene))
    assert "rename the file and the subcircuit of m" in told.value.hint
