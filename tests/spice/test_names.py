"""Names in a deck are unique, whatever parts and pins are called: its nets are the scene's."""

import random

import numpy as np
import pytest
from device import built

from kc2spice.core.errors import UsageError
from kc2spice.netlist.lint import lint
from kc2spice.parts.contact import Normal, contact_subcircuit
from kc2spice.scene.load import load_scene
from kc2spice.sim.ngspice import run_deck
from kc2spice.spice.header import Header
from kc2spice.workflow.decks import make_deck

WORDS = ("n", "c", "a", "b", "held", "metered", "meter", "out", "ret", "V", "N")


def adversarial(draw, folder):
    """Tables of a scene, and the joins that it means: sets of ``(part, pin)``.

    Parts are the beginnings of one line of words and most pins their ends: ``n`` has the pin
    ``c_a``, ``n_c`` the pin ``a``.
    """
    line = [draw.choice(WORDS) for _ in range(10)]
    ends = {"_".join(line[:k]): "_".join(line[k:]) for k in range(1, 10)}
    parts = draw.sample(list(ends), 9)
    boxes, plain = parts[:4], parts[4:]
    tables = {"name": "names", "solver": {"stop": 1e-4, "max_step": 1e-5}}
    pins, joins = [], []
    for k, box in enumerate(boxes):
        own = [f"{ends[box]}_{k}" if k else ends[box] for k in draw.sample(range(5), 4)]
        pins += [(box, pin) for pin in own]
        cards = "".join(f"R{i} {pin} ref 1k\n" for i, pin in enumerate(own))
        (folder / f"box{k}.lib").write_text(f".subckt s{k} {' '.join(own)} ref\n{cards}.ends\n")
        tables[box] = {"part": "netlist", "file": f"box{k}.lib", "subckt": f"s{k}", "pins": {}}
    free = list(pins)
    draw.shuffle(free)
    kinds = ("capacitor", "capacitor", "controller", "controller", "source")
    for part, kind in zip(plain, kinds, strict=True):
        a = free.pop()
        keys = {
            "capacitor": {"capacitance": 1e-9, "pins": {"a": ".".join(a)}},
            "controller": {"inputs": ["held"], "output": "current", "units": {"held": "V"},
                           "pins": {"out": ".".join(a), "held": ".".join(draw.choice(pins))}},
            "source": {"dc": 1.0, "pins": {"out": ".".join(a)}},
        }[kind]  # fmt: skip
        tables[part] = {"part": kind} | keys
        joins += [{(part, pin), tuple(goal.split("."))} for pin, goal in keys["pins"].items()]
    while free:
        one = free.pop()
        two = free.pop() if free else draw.choice([pin for pin in pins if pin != one])
        tables[one[0]]["pins"][one[1]] = ".".join(two)
        joins.append({one, two})
    return tables, pins, joins


def partition(pins, joins):
    groups = [{pin} for pin in pins]
    for join in joins:
        met = [group for group in groups if group & join]
        groups = [group for group in groups if not group & join] + [set().union(join, *met)]
    return {frozenset(group) for group in groups}


@pytest.mark.parametrize("seed", range(15))
def test_nets_of_a_deck_are_those_of_its_scene(seed, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    draw = random.Random(seed)
    tables, pins, joins = adversarial(draw, tmp_path)
    scene = load_scene(tables)
    deck = make_deck(built(scene))
    lint(deck)
    at, cards = {}, {}
    for block in deck.blocks:
        part = block.title.partition(":")[0]
        for card in block.cards:
            words = card.lower().split()
            assert words[0] not in cards, f"two cards are called {words[0]}"
            cards[words[0]] = part
            if words[0] == f"x{part.lower()}":
                names = [pin for box, pin in pins if box == part]
                at |= {(part, pin): node for pin, node in zip(names, words[1:-2], strict=True)}
        if tables[part]["part"] == "capacitor":
            (_, plus, inner, _), (_, again, _, _) = (c.lower().split() for c in block.cards)
            at[part, "a"] = plus
            assert inner == again
            at[part, "within"] = inner
        elif tables[part]["part"] == "controller":
            held, given = (c.lower().split() for c in block.cards)
            at[part, "out"], at[part, "within"] = given[2], held[1]
            assert given[3] == held[1]
            at[part, "held"] = scene.net(part, "held")
        elif tables[part]["part"] == "source":
            at[part, "out"] = block.cards[0].lower().split()[1]
    nodes = {}
    for pin, node in at.items():
        nodes.setdefault(node, set()).add(pin)
    assert {frozenset(group) for group in nodes.values()} == partition(at, joins)


def test_two_parts_whose_pins_read_alike_keep_their_voltages(tmp_path, monkeypatch):
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
    with pytest.raises(UsageError, match="differ in case only"):
        load_scene({"name": "one", "n": {"part": "netlist", "file": "one.lib", "subckt": "one",
                    "pins": {"A": "gnd"}}})  # fmt: skip


def test_a_port_that_is_called_like_an_inner_node_of_a_contact_is_refused():
    with pytest.raises(UsageError, match="taken in the subcircuit"):
        contact_subcircuit(Header("s", "0"), ("tip", "FTIP"), np.zeros(2), Normal(1e6))
