"""Mistakes in declarations are named in the words of their author, with one thing to do; and the
tables of the reference page on declarations agree with the code."""

import re
from pathlib import Path

import pytest
from pydantic import TypeAdapter
from support import COORDINATES, Declaration, branch, displacement, quantities

import kc2spice as kc

PAGE = Path(__file__).parents[2] / "docs/reference/declarations.md"


class Keys(kc.Section):
    g: float


HEAT, MOTION = (branch("temperature"),), (displacement("x", "a", "b"),)
FLUID = (branch("volume_velocity"),)
MISTAKES = {
    "an unknown key": (HEAT, "coenergy", "0.5*h*temperature^2", "unknown name", "add the key h"),
    "energy of a temperature": (HEAT, "energy", "g*temperature^2", "must not depend on temperature",
                                "in coenergy, and losses in content"),
    "loss in the coenergy": (MOTION, "coenergy", "g*x_rate^2", "must not depend on x_rate",
                             "in content"),
    "a broken power": (HEAT, "content", "g*temperature^2.5", "content of part: the exponent",
                       "exp(2.5*ln(temperature))"),
    "an absolute value": (HEAT, "content", "g*abs(temperature)", "declarations.md", "max(0, -x)"),
    "a logarithm": (HEAT, "content", "g*log(temperature)", "not support this function",
                    "write ln(x)"),
    "pow": (HEAT, "content", "pow(temperature, 2)", "do not support this function", "write x^2"),
    "the name of the quantity": (FLUID, "content", "g*volume_velocity^2", "unknown name",
                                 "coordinate of 'volume_velocity' is flow"),
    "a loss of a position": (MOTION, "content", "g*x^2", "no effect", "x_rate"),
}  # fmt: skip


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_in_a_declaration_names_its_remedy(name):
    branches, field, text, problem, remedy = MISTAKES[name]
    with pytest.raises(kc.errors.UsageError) as caught:
        Declaration("part", "a part", Keys, branches, **{field: text})
    assert problem in str(caught.value)
    assert remedy in caught.value.hint


def test_a_negative_power_is_a_quotient():
    declaration = Declaration("part", "a part", Keys, HEAT, content="g*temperature^(-2)")
    slope = declaration.direct_flow(HEAT[0])
    assert slope == Declaration(
        "part", "a part", Keys, HEAT, content="g/temperature^2"
    ).direct_flow(HEAT[0])


def test_an_unknown_part_type_states_how_to_add_types():
    with pytest.raises(kc.errors.UsageError) as caught:
        kc.load_scene({"name": "s", "c": {"part": "zzz"}})
    assert "register_part" in caught.value.hint
    assert "kc2spice.parts" in caught.value.hint


def test_the_page_lists_every_coordinate_with_its_names():
    text = PAGE.read_text()
    for kind in COORDINATES:
        default = branch(kind)
        assert f"| `{kind}` | `{default.name}` | `{default.through}` |" in text


def test_the_page_states_the_units_of_key_types():
    table = re.findall(r"\| `(\w+)` \| ([^|]+?) (?=\|)", PAGE.read_text().partition("## Keys")[2])
    units = [(name, unit) for name, unit in table if hasattr(quantities, name)]
    assert len(units) == 18
    for name, unit in units:
        number = TypeAdapter(getattr(quantities, name)).validate_python
        assert number(f"3 {unit}" if unit != "1" else "3") == 3.0
