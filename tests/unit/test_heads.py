"""Heads of libraries and decks: signs, units, ranges, bounds, what is left out."""

import math

import pytest

from kc2spice.netlist.circuit import Param, Pin, positive
from kc2spice.rom.linear import Certificate
from kc2spice.spice.header import Header, parameter_list, part_header, rom_line


@pytest.mark.parametrize(
    ("error", "written"),
    [(1.2345e-4, "0.000124"), (1.23e-4, "0.000123"), (9.994e-3, "0.01"), (9.999e-3, "0.01"),
     (1e-6, "1e-06"), (1.001e-6, "1.01e-06")],
)  # fmt: skip
def test_a_bound_is_rounded_upwards(error, written):
    certificate = Certificate((0.0, 5e5), error, "residual", True, True)
    line = rom_line(7, certificate)
    assert line.startswith(
        f"* rom: order=7 band=0.0..500000.0 Hz norm=pointwise error={written} (residual); above"
    )
    assert line.endswith("above the band not certified; a contact or a steep edge excites it\n")


def test_the_head_of_a_library():
    pins = (Pin("a", "um", "N"), Pin("ref", "V", "A"))
    params = (Param("k", 2.0, "N/m", "stiffness\n.control"), positive("c", 1e-9, "F", "size"),
              Param("x", 0.0, "-", "share", high=1.0))  # fmt: skip
    text = part_header(Header("my\nscene", "0"), "part: title", pins, params, rating="none")
    lines = text.splitlines()
    assert lines[0] == "* part: title"
    assert lines[2] == "* scene: my scene hash=0"
    assert lines[4].startswith("* sign: um, m/s and N count upwards")
    assert lines[7:] == [
        "* @pin 1 a unit=um flow=N",
        "* @pin 2 ref unit=V flow=A",
        "* @param k=2.0 unit=N/m stiffness .control",
        "* @param c=1e-09 unit=F range=1e-30..inf size",
        "* @param x=0.0 unit=- range=-inf..1 share",
    ]
    electrical = part_header(Header("s", "0"), "part", pins[1:], rating="none")
    assert "* sign: 1 V counts from the reference, 1 A into the pin\n" in electrical
    thermal = part_header(Header("s", "0"), "part", (Pin("t", "K", "W"),), rating="none")
    assert "* sign: 1 V counts from the reference, 1 A into the pin\n" in thermal
    assert parameter_list(params) == "k=2.0 c=1e-09 x=0.0"
    assert (params[0].low, params[0].high) == (-math.inf, math.inf)
