"""Heads of libraries: the error estimate, an instance to copy, and the length of lines."""

import pytest

from kc2spice.netlist.circuit import Pin
from kc2spice.netlist.library import Reduction
from kc2spice.rom.linear import Certificate
from kc2spice.spice.header import Header, part_header, rom_lines


@pytest.mark.parametrize(
    ("error", "written"),
    [(1.2345e-4, "0.000124"), (1.23e-4, "0.000123"), (9.994e-3, "0.01"), (9.999e-3, "0.01"),
     (1e-6, "1e-06"), (1.001e-6, "1.01e-06")],
)  # fmt: skip
def test_a_bound_is_rounded_upwards(error, written):
    certificate = Certificate((0.0, 5e5), error, "residual", True, True)
    reduction = Reduction(7, (0.0, 5e5), "pointwise", error, 1e-12, 3.0)
    first, second, *_ = lines = rom_lines(reduction, certificate)
    assert first == f"* rom: order=7 band=0.0..500000.0 Hz norm=pointwise error={written}"
    assert second.startswith("*   (residual; emitted circuit")
    told = "\n".join(lines).replace("\n*   ", " ")
    assert told.endswith("no error estimate above the band: a contact or a steep edge excites it")


def test_a_head_has_an_instance_to_copy_and_lines_of_100_characters():
    pins = (Pin("plus", "V", "A"), Pin("base", "um", "N"))
    long = "a body of " + "many words, " * 30
    lines = part_header(Header("scene", "0"), "part: title", pins, rating=long, validity=long)
    head = "\n".join(lines)
    assert "\n* use: X1 plus base part\n" in head
    assert max(map(len, head.splitlines())) <= 100
    assert long.strip() in head.replace("\n*   ", " ")
