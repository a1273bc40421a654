"""Libraries read back: pins, units, parameters with their ranges."""

import numpy as np
import pytest

from kc2spice.core.errors import UsageError
from kc2spice.parts.contact import Normal, contact_subcircuit
from kc2spice.parts.pid import Control, pid_subcircuit
from kc2spice.parts.sphere import sphere_subcircuit
from kc2spice.spice import read_lib
from kc2spice.spice.header import Header

HEADER = Header("test", "0")
RADII = np.array([0.0, 5e-5])


@pytest.mark.parametrize(
    "part",
    [
        pid_subcircuit(HEADER, Control()),
        sphere_subcircuit(HEADER, 1e-5, 1e-3, 9.81),
        contact_subcircuit(HEADER, ("ring0", "ring1"), RADII, Normal(4e8), under=(1e-3, RADII)),
    ],
    ids=lambda part: part.name,
)
def test_what_is_written_is_read(part, tmp_path):
    (tmp_path / part.filename).write_text(part.text)
    (found,) = read_lib(tmp_path / part.filename)
    assert (found.name, found.pins, found.params) == (part.name, part.pins, part.params)
    assert found.text == part.text


def test_heads_state_sign_validity_and_range():
    rings = ("ring0", "ring1")
    text = contact_subcircuit(HEADER, rings, RADII, Normal(4e8), under=(1e-3, RADII)).text
    for line in ("* sign: um, m/s and N count upwards", "* validity: ", "* rating: ",
                 "* @param radius=0.001 unit=m range=5e-05..inf radius of the sphere"):  # fmt: skip
        assert f"\n{line}" in text


def test_libraries_of_others_have_what_their_cards_say(tmp_path):
    text = "* theirs\n.subckt amp in out PARAMS: gain=1k\nXi in out inner\n.ends\n"
    (tmp_path / "amp.lib").write_text(text + ".subckt inner a b\nR1 a b 1\n.ends\n")
    (found,) = read_lib(tmp_path / "amp.lib")
    assert [(p.name, p.unit, p.flow) for p in found.pins] == [("in", "V", "A"), ("out", "V", "A")]
    assert [(p.name, p.default) for p in found.params] == [("gain", 1e3)]


def test_a_head_that_does_not_fit_is_refused(tmp_path):
    (tmp_path / "a.lib").write_text("* @pin 1 a unit=V flow=A\n.subckt x a b\nR1 a b 1\n.ends\n")
    with pytest.raises(UsageError, match="head does not list") as caught:
        read_lib(tmp_path / "a.lib")
    assert caught.value.expected == "a b"
    with pytest.raises(UsageError, match="cannot read"):
        read_lib(tmp_path / "none.lib")


@pytest.mark.parametrize(
    ("power", "unit", "says"), [(1.0, "N/m", "penalty"), (1.5, "N/m^1.5", "Hertz")]
)
def test_the_head_of_a_contact_names_its_law(power, unit, says):
    text = contact_subcircuit(HEADER, ("tip",), np.zeros(1), Normal(4e8, power)).text
    (line,) = (line for line in text.splitlines() if line.startswith("* @param eps="))
    assert f"unit={unit} " in line
    assert says in line
