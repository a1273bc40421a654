"""Mistakes in declarations are named in the words of their author, with one thing to do; and the
tables of the reference page on declarations agree with the code."""

import re
from pathlib import Path

import pytest
from pydantic import TypeAdapter
from support import (
    COORDINATES,
    Declaration,
    DeclaredPart,
    branch,
    displacement,
    parttype,
    quantities,
)

import kc2spice as kc

PAGE = Path(__file__).parents[2] / "docs/reference/declarations.md"


class Keys(kc.Section):
    g: float


HEAT, MOTION = (branch("temperature"),), (displacement("x", "a", "b"),)
FLUID = (branch("volume_velocity"),)
MISTAKES = {
    "an unknown key": (HEAT, "coenergy", "0.5*h*temperature^2", "unknown name", "add the key `h`"),
    "energy of a temperature": (HEAT, "energy", "g*temperature^2", "must not depend on temperature",
                                "`coenergy`, and losses into `content`"),
    "loss in the coenergy": (MOTION, "coenergy", "g*x_rate^2", "must not depend on x_rate",
                             "into `content`"),
    "a broken power": (HEAT, "content", "g*temperature^2.5", "content of part: the exponent",
                       "exp(2.5*ln(temperature))"),
    "an absolute value": (HEAT, "content", "g*abs(temperature)", "declarations.md", "max(0, -x)"),
    "a logarithm": (HEAT, "content", "g*log(temperature)", "not support this function",
                    "write ln(x)"),
    "pow": (HEAT, "content", "pow(temperature, 2)", "do not support this function", "write x^2"),
    "the name of the quantity": (FLUID, "content", "g*volume_velocity^2", "unknown name",
                                 "coordinate of 'volume_velocity' is flow"),
    "a loss of a position": (MOTION, "content", "g*x^2", "no rate, voltage or current", "x_rate"),
}  # fmt: skip


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_in_a_declaration_names_its_remedy(name):
    branches, field, text, problem, remedy = MISTAKES[name]
    with pytest.raises(kc.errors.UsageError) as caught:
        Declaration("part", "a part", Keys, branches, **{field: text})
    assert problem in str(caught.value)
    assert remedy in caught.value.hint


def test_energy_of_a_velocity_belongs_to_a_mass():
    with pytest.raises(kc.errors.UsageError, match="must not depend on x_rate") as caught:
        Declaration("part", "a part", Keys, MOTION, energy="g*x_rate^2")
    assert "mass into `kinetic`" in caught.value.hint


@pytest.mark.parametrize("branches", [branch("angle"), ("angle",), "x", [MOTION], None])
def test_branches_that_are_no_tuple_are_an_error(branches):
    with pytest.raises(kc.errors.UsageError, match="not a tuple of Branch objects") as caught:
        Declaration("part", "a part", Keys, branches, content="g")
    assert "comma" in caught.value.hint


@pytest.mark.parametrize("name", ["my part", "my-part", "9part", "part.a", "x" * 65])
def test_a_part_type_has_a_name_that_netlists_can_contain(name):
    declaration = Declaration(name, "a part", Keys, MOTION, content="g*x_rate^2")
    with pytest.raises(kc.errors.UsageError, match="not a valid name") as caught:
        kc.register_part(DeclaredPart(declaration))
    assert caught.value.got == repr(name)


def test_only_an_instance_of_a_part_type_is_registered():
    declaration = Declaration("part", "a part", Keys, MOTION, content="g*x_rate^2")
    for value in (declaration, DeclaredPart, 3):
        with pytest.raises(kc.errors.UsageError, match="not a part type") as caught:
            kc.register_part(value)
        assert "DeclaredPart(declaration)" in caught.value.hint


def test_a_method_with_a_name_of_version_0_2_is_an_error():
    """The method would have no effect under its old name."""

    class Swept(DeclaredPart):
        def settable(self, part, scene):
            return {}

    declaration = Declaration("swept", "a part", Keys, MOTION, content="g*x_rate^2")
    with pytest.raises(
        kc.errors.UsageError, match="settable of part types is now called"
    ) as caught:
        kc.register_part(Swept(declaration))
    assert caught.value.hint == "rename Swept.settable to settable_quantities"


@pytest.mark.parametrize(
    ("fields", "error", "problem", "got"),
    [
        ({"energy": "g*ln(x)"}, "UsageError", "division by zero at rest", "a denominator"),
        ({"content": "g*x_rate^2/x"}, "SimulationError", "no value: float division",
         "x = 0, x_rate = 0"),
    ],
)  # fmt: skip
def test_equations_without_a_value_at_rest_are_an_error(fields, error, problem, got, monkeypatch):
    declaration = Declaration("singular", "a part", Keys, MOTION, **fields)
    monkeypatch.setitem(parttype._types, "singular", DeclaredPart(declaration))
    with pytest.raises(getattr(kc.errors, error), match=problem) as caught:
        kc.verify({
            "name": "pulled",
            "part": {"part": "singular", "g": 1.0, "pins": {"a": "spring.a"}},
            "spring": {"part": "spring", "stiffness": 1.0},
            "analysis": {"type": "op"},
        })  # fmt: skip
    assert caught.value.got.startswith(got)


@pytest.mark.parametrize("unit", ["banana", "N/", "kg^-1", "N s**2"])
def test_a_text_that_is_no_unit_is_an_error_of_the_declaration(unit):
    with pytest.raises(kc.errors.UsageError, match="not a unit"):
        quantities.si(unit)


def test_a_negative_power_is_a_quotient():
    declaration = Declaration("part", "a part", Keys, HEAT, content="g*temperature^(-2)")
    slope = declaration.derive_direct_flow(HEAT[0])
    assert slope == Declaration(
        "part", "a part", Keys, HEAT, content="g/temperature^2"
    ).derive_direct_flow(HEAT[0])


def test_an_unknown_part_type_states_how_to_add_types():
    with pytest.raises(kc.errors.UsageError) as caught:
        kc.load_scene({"name": "s", "c": {"part": "zzz"}})
    assert "docs/how-to/own_part.md" in caught.value.hint


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


@pytest.mark.parametrize("name", ["spring", "disc", "relay"])
def test_a_name_of_a_built_in_part_type_is_not_replaced(name, monkeypatch):
    """The proposed name works, and may be registered again."""
    monkeypatch.setattr(parttype, "_types", dict(parttype._types))
    monkeypatch.setattr(parttype, "_own_names", set(parttype._own_names))
    declaration = Declaration(name, "a part", Keys, MOTION, content="g*x_rate^2")
    with pytest.raises(kc.errors.UsageError, match="a built-in part type has this name") as caught:
        kc.register_part(DeclaredPart(declaration))
    proposed = caught.value.hint.split()[-1]
    assert proposed == f"my_{name}"
    for _ in range(2):
        part = DeclaredPart(Declaration(proposed, "a part", Keys, MOTION, content="g*x_rate^2"))
        assert kc.register_part(part) is part
