"""Dialects of users: what register_dialect and an export reject."""

import pytest
from support import Deck, UsageError, dialect_registry, translate_deck

import kc2spice as kc

LAMP = {
    "name": "lamp",
    "drive": {"part": "source", "dc": "12 V"},
    "lamp": {"part": "resistor", "resistance": "6 Ohm", "pins": {"a": "drive.out"}},
    "analysis": {"type": "op"},
}


def define_dialect(**members):
    """Return a dialect class with further or other members."""
    methods = {name: lambda self, *words: " ".join(words)
               for name in ("switch", "format_derived_measure", "format_magnitude",
                            "format_real_part")}  # fmt: skip
    return type("Own", (kc.Dialect,), {"dialect": "own", "title": "Own", **methods, **members})


@pytest.fixture(autouse=True)
def registered(monkeypatch):
    """A built-in dialect registers itself only once, so it must not do so in the copy."""
    for name in dialect_registry._list_builtin_dialects():
        dialect_registry.find_dialect(name)
    monkeypatch.setattr(dialect_registry, "_dialects", dict(dialect_registry._dialects))


def test_an_element_may_add_a_parameter(tmp_path):
    def element(self, card):
        text = kc.Dialect.format_element(self, card)
        return f"{text} NOISE=0" if card.kind == "r" else text

    kc.register_dialect(define_dialect(format_element=element))
    deck = kc.export(LAMP, tmp_path, dialect="own")[0].read_text()
    assert "\nRlamp drive_out 0 6.0 NOISE=0\n" in deck
    assert "\nVdrive drive_out 0 DC 12.0\n" in deck


@pytest.mark.parametrize("returned", [None, "", 3])
def test_an_element_without_text_is_an_error_at_its_card(returned, tmp_path):
    kc.register_dialect(define_dialect(format_element=lambda self, card: returned))
    with pytest.raises(UsageError, match="writes no text for this card") as caught:
        kc.export(LAMP, tmp_path / "out", dialect="own")
    assert caught.value.where.startswith("lamp.cir:")
    assert "format_element() returned" in caught.value.got
    assert "Vdrive" in caught.value.got
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("members", "action"),
    [
        ({"title": kc.Dialect.title}, "set title = 'NAME OF THE SIMULATOR' in Own"),
        ({"dialect": ""}, "set dialect = 'NAME' in Own"),
        ({"dialect": "ngspice"}, "set dialect = 'NAME' in Own"),
        ({"format_magnitude": kc.Dialect.format_magnitude}, "define format_magnitude"),
    ],
)
def test_a_dialect_without_a_name_title_or_method_is_an_error(members, action):
    with pytest.raises(UsageError, match="not a netlist dialect") as caught:
        kc.register_dialect(define_dialect(**members))
    assert caught.value.hint == action


def test_a_temperature_in_an_expression_needs_its_name():
    deck = Deck(name="one", text="* title\nB1 x 0 V=temper*2\nR1 x 0 1\n.op\n.end\n")
    kc.register_dialect(define_dialect())
    with pytest.raises(UsageError, match="Own has no equivalent of the word temper"):
        translate_deck(deck, "own")
    kc.register_dialect(define_dialect(temperature="tcelsius"))
    assert "V=tcelsius*2" in translate_deck(deck, "own").files["one.cir"]


@pytest.mark.parametrize("name", ["ltspice", "xyce"])
def test_a_name_of_a_built_in_dialect_is_not_replaced(name):
    """The proposed name works, and may be registered again."""
    with pytest.raises(UsageError, match="a built-in dialect has this name") as caught:
        kc.register_dialect(define_dialect(dialect=name))
    proposed = caught.value.hint.split("'")[1]
    for _ in range(2):
        assert kc.register_dialect(define_dialect(dialect=proposed)).dialect == f"my_{name}"
    built_in = dialect_registry.find_dialect(name)
    assert kc.register_dialect(built_in) is built_in
