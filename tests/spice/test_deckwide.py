"""Commands for the whole deck that a user's netlist must not contain, and those that it may."""

import pytest
from device import built
from support import (
    UsageError,
    load_scene,
    make_deck,
    read_edited_deck,
    require_valid_wiring,
    run_deck,
)

FOLLOWER = ".subckt half in out ref\nRa in out 1k\nRb out ref 1k\n.ends half\n"


def scene(folder, *texts):
    """1 V into one divider after another; ``texts`` follow their subcircuits."""
    tables = {
        "name": "divided", "analysis": {"stop": 1e-4}, "solver": {"max_step": 1e-5},
        "supply": {"part": "source", "dc": 1.0},
        "load": {"part": "resistor", "resistance": 1e6, "pins": {"a": "box0.out"}},
    }  # fmt: skip
    for k, text in enumerate(texts):
        name = f"half{k}"
        (folder / f"{name}.lib").write_text(FOLLOWER.replace("half", name) + text)
        tables[f"box{k}"] = {
            "part": "netlist", "file": f"{name}.lib", "subckt": name,
            "pins": {"in": "supply.out", **({"out": "box0.out"} if k else {})},
        }  # fmt: skip
    return tables


REFUSED = {
    ".func max(a,b) {a}": "built-in name",
    ".FUNC Min (a,b) {a}": "built-in name",
    ".param max(a,b)={a}": "built-in name",
    ".param time=3": "built-in name",
    ".options reltol=0.5": "option reltol",
    ".options\n+ reltol=0.5": "option reltol",
    ".opt trtol=70": "option trtol",
    ".options interp": "option interp",
    ".options rshunt=1e6": "option rshunt",
    ".temp 125": "temperature",
    ".options temp=125": "option temp",
    ".tran 1u 1m": "analysis",
    ".op": "analysis",
    ".noise v(out) V1 dec 10 1 1k": "analysis",
    ".print tran v(out)": "output",
    ".global supply_out": "global",
    ".ic v(supply_out)=3": "outside of all subcircuits",
    "R1 supply_out 0 1": "outside of all subcircuits",
}


def test_cards_that_act_on_the_whole_deck_are_rejected(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for text, said in REFUSED.items():
        with pytest.raises(UsageError, match=said) as caught:
            load_scene(scene(tmp_path, f"* after it\n{text}\n"))
        assert "half0.lib:6" in str(caught.value)


OWN = {
    "function of its own": ".func sq(x) {x*x}\n.param four={sq(2)}\n",
    "model": ".model DX D(IS=1e-14)\n",
    "printing": ".options acct post\n",
    "built-in name in its own scope": (
        ".subckt other a\n.func max(x,y) {x}\n.param time=2\n.ic v(a)=0\nB1 a 0 V={max(1,2)}\n"
        "R1 a 0 1\n.ends\n"
    ),
}


@pytest.mark.parametrize("text", OWN.values(), ids=OWN)
def test_harmless_statements_in_netlists_are_accepted(text, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    deck = make_deck(built(load_scene(scene(tmp_path, text))))
    require_valid_wiring(deck)
    waves = run_deck(deck, tmp_path)
    assert waves["load.v"][-1] == pytest.approx(0.5, rel=1e-3)  # 500 Ohm into 1 MOhm


@pytest.mark.parametrize(
    ("one", "other", "said"),
    [
        (".param gain=2", ".param gain=3", "parameter gain"),
        (".func f(x) {x}", ".FUNC F(x) {2*x}", "function f"),
        (".model DX D(IS=1e-14)", ".model dx D(IS=1e-9)", "model dx"),
    ],
)
def test_two_files_that_define_one_name_are_refused(one, other, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UsageError, match=said) as caught:
        require_valid_wiring(
            make_deck(built(load_scene(scene(tmp_path, one + "\n", other + "\n"))))
        )
    assert "half0.lib:5" in str(caught.value)
    assert "half1.lib:5" in str(caught.value)
    require_valid_wiring(make_deck(built(load_scene(scene(tmp_path, one + "\n", one + "\n")))))


def edit(deck, folder, change):
    folder.mkdir(exist_ok=True)
    for name, text in deck.files.items():
        (folder / name).write_text(change(text))


def test_an_edited_deck_that_changes_the_meaning_of_parts_is_rejected(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    build = built(load_scene(scene(tmp_path, "")))
    deck = make_deck(build)
    for line, said in ((".func max(a,b) {a}", "built-in name"), (".options interp", "interp"),
                       (".noise v(load_a) Vsupply dec 10 1 1k", "analysis")):  # fmt: skip
        edit(
            deck,
            tmp_path / "edited",
            lambda text, line=line: text.replace(".tran", f"{line}\n.tran"),
        )
        with pytest.raises(UsageError, match=said):
            read_edited_deck(make_deck(build), tmp_path / "edited" / deck.main_file_name)
