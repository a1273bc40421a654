"""The table of physical domains: its units, the power on its pins, and who reads it."""

import pytest
from support import (
    CONSERVATIVE,
    PORTS,
    QUANTITIES,
    TABLE,
    convert_quantity,
    find_across_quantity,
    find_domain,
    parse_unit,
)

WATT = parse_unit("W")


def dimension(unit):
    """Exponents of kg, m, s, A and K, and the power of ten in front."""
    return parse_unit(unit.replace("rad", "1").replace("Nm", "N m"))


def product(*units):
    return tuple(map(sum, zip(*map(dimension, units), strict=True)))


@pytest.mark.parametrize("domain", CONSERVATIVE, ids=lambda domain: domain.name)
def test_pin_units_are_si_units_times_their_factors(domain):
    for item, _ in domain.quantities:
        ten, *rest = dimension(item.pin_unit)
        si_ten, *si_rest = dimension(item.unit)
        assert rest == si_rest
        assert item.factor == pytest.approx(10.0 ** (ten - si_ten), rel=1e-15)
        assert item.factor * item.pin_value_per_si_unit == pytest.approx(1.0, rel=1e-15)
        assert len(item.pin_unit.split()) == 1  # a word of a netlist's header


@pytest.mark.parametrize("domain", CONSERVATIVE, ids=lambda domain: domain.name)
def test_the_power_on_a_pin_is_in_watts(domain):
    across, through = domain.across.unit, domain.through.unit
    match domain.power:
        case "across * through":
            assert product(across, through) == WATT
        case "d(across)/dt * through":
            assert product(across, through, "1/s") == WATT
        case "through":
            assert dimension(through) == WATT
        case "frame velocity * force":
            assert product("m/s", through) == WATT
            assert product(across, "s") == dimension("m/s")
        case other:
            pytest.fail(f"a conservative domain without power: {other}")


@pytest.mark.parametrize("domain", PORTS.values(), ids=lambda domain: domain.name)
def test_units_of_responses_follow_from_the_inputs_of_ports(domain):
    driven = domain.get_quantity(domain.input_side).unit
    assert product(domain.compliance, driven) == dimension(domain.output_unit)
    if domain.has_potential and domain.power == "across * through":  # the answer's rate flows
        assert product(domain.output_unit, "1/s") == dimension(domain.through.unit)
    elif domain.input_side == "through":
        assert domain.output_unit == domain.across.unit


def test_names_and_pairs_of_units_identify_domains():
    for names in ([d.name for d in TABLE], [d.units for d in TABLE], list(PORTS)):
        assert len(set(names)) == len(names)
    for domain in CONSERVATIVE:
        assert find_domain(*domain.units) is domain
        assert find_across_quantity(domain.across.pin_unit) is domain.across
    assert find_domain("m/s", "N").name == "translation"
    assert find_domain("V", "-") is None
    assert {d.name for d, _ in QUANTITIES.values()} == {d.name for d in CONSERVATIVE}
    assert QUANTITIES["force"][0].name == "translation"


def test_quantities_read_numbers_in_the_units_of_the_table():
    for name, (domain, side) in QUANTITIES.items():
        unit = domain.get_quantity(side).unit
        if "rad" not in unit:
            assert convert_quantity(f"2 {unit}", unit) == 2.0, name
