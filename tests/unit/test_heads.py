"""Heads of libraries: the certified bound."""

import pytest

from kc2spice.rom.linear import Certificate
from kc2spice.spice.header import rom_line


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
