"""Libraries read back: pins, units, parameters with their ranges."""

import pytest
from support import (
    ContactForce,
    Deck,
    Header,
    PidKeys,
    UsageError,
    declare_contact,
    declare_sphere,
    make_pid_subcircuit,
    read_lib,
    with_parameters,
)
from support import make_declared_subcircuit as declared

HEADER = Header("test", "0")
CONTACT = declare_contact(
    ("ring0", "ring1"), (0.0, 5e-5), ContactForce(4e8), under=(1e-3, (0.0, 5e-5))
)


@pytest.mark.parametrize(
    "part",
    [
        make_pid_subcircuit(HEADER, PidKeys()),
        declared(HEADER, "sphere", declare_sphere(1e-5, 1e-3, 9.81), {}),
        declared(HEADER, "contact", CONTACT, {}),
    ],
    ids=lambda part: part.name,
)
def test_written_libraries_are_read_without_loss(part, tmp_path):
    (tmp_path / part.filename).write_text(part.text)
    (found,) = read_lib(tmp_path / part.filename)
    assert (found.name, found.pins, found.params) == (part.name, part.pins, part.params)
    assert found.text == part.text


def test_libraries_of_other_authors_are_read_from_their_cards(tmp_path):
    text = "* theirs\n.subckt amp in out PARAMS: gain=1k\nXi in out inner\n.ends\n"
    (tmp_path / "amp.lib").write_text(text + ".subckt inner a b\nR1 a b 1\n.ends\n")
    (found,) = read_lib(tmp_path / "amp.lib")
    assert [(p.name, p.unit, p.flow) for p in found.pins] == [("in", "V", "A"), ("out", "V", "A")]
    assert [(p.name, p.default) for p in found.params] == [("gain", 1e3)]


def test_a_library_without_parts_is_refused(tmp_path):
    (tmp_path / "a.lib").write_text("R1 a 0 1\n")
    with pytest.raises(UsageError, match="this library contains no subcircuit"):
        read_lib(tmp_path / "a.lib")


@pytest.mark.parametrize("pins", ["a b", "0"])
def test_a_head_that_does_not_fit_is_refused(pins, tmp_path):
    text = f"* @pin 1 a unit=V flow=A\n.subckt x {pins}\nR1 a b 1\n.ends\n"
    (tmp_path / "a.lib").write_text(text)
    with pytest.raises(UsageError, match="header does not list") as caught:
        read_lib(tmp_path / "a.lib")
    assert caught.value.expected == pins
    with pytest.raises(UsageError, match="this file does not exist"):
        read_lib(tmp_path / "none.lib")


def test_parameters_outside_their_range_are_refused():
    """A sphere without mass would leave at 6.7e8 m/s, and nothing else tells."""
    part = declared(HEADER, "sphere", declare_sphere(3e-5, 1e-3, 9.81), {})
    deck = Deck(name="d", parts=(part,))
    assert "mass=20.00u" in with_parameters(deck, [("sphere.mass", 2e-5)]).files["sphere.lib"]
    for name in ("mass", "radius"):
        for value in (0.0, -1.0):
            with pytest.raises(UsageError, match="outside of the range"):
                with_parameters(deck, [(f"sphere.{name}", value)])
    assert with_parameters(deck, [("sphere.gravity", -9.81)]) != deck  # any sign


@pytest.mark.parametrize("separator", ["\x0b", "\x0c", "\x1c", "\x85", "\u2028", "\u2029"])
def test_comments_end_as_in_simulators(separator, tmp_path):
    """``str.splitlines`` breaks lines at these characters; ngspice does not."""
    path = tmp_path / "own.lib"
    text = f".subckt own a b\n* from a data sheet{separator}R2 broken\nR1 a b 1k\n.ends\n"
    path.write_text(text, encoding="utf-8")
    (part,) = read_lib(path)
    assert [pin.name for pin in part.pins] == ["a", "b"]
