"""Keys that can be computed but hardly exist are refused with the physical reason."""

import warnings

import pytest
from support import (
    Cap,
    PulseKeys,
    StackKeys,
    UsageError,
    bimorph,
    get_plausible_range,
    load_scene,
    mass,
)


def test_implausible_values_run_if_the_check_is_off():
    override = "catch.wire_diameter=0.2 mm"
    with pytest.warns(UserWarning, match="do not fit"):
        load_scene("kick_and_catch", [override, "checks.plausible=warn"])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load_scene("kick_and_catch", [override, "checks.plausible=off"])


def slips(brass="20 mm", ceramic="14 mm", thickness="0.22 mm", drive="10 V", **disc):
    layers = [{"material": "brass", "diameter": brass, "thickness": "0.2 mm"},
              {"material": "PZT-5A", "diameter": ceramic, "thickness": thickness}]  # fmt: skip
    return {
        "name": "slips", "disc": {"part": "disc", "layers": layers, **disc},
        "drive": {"part": "source", "dc": drive, "pins": {"out": "disc.anode"}},
    }  # fmt: skip


BODIES = [
    (slips(thickness=0.22), "disc.layers[1].thickness", "220 mm", 'mean "220 um"'),
    (slips(brass=20.0, ceramic=14.0), "disc.layers[0].diameter", "20 m", 'mean "20 mm"'),
    (slips(ceramic="22 mm"), "disc.layers[1].diameter", "22 mm", "wider than its plate"),
    (slips(ceramic="20 um"), "disc.layers[1].thickness", "220 µm", "10 times as thick"),
    (slips(drive="80 kV"), "drive", "8e+04 V at disc", "depolarises"),
    (slips(drive="8 kV", rated_voltage="0.5 kV"), "drive", "stands 500 V", "depolarises"),
    ({"name": "heavy", "box": {"part": "mass", "mass": 5.68e6, "pins": {"a": "hold.a"}},
      "hold": {"part": "spring", "stiffness": 1.0}}, "box.mass", "5.68e+06 kg", "above a tonne"),
    ({"name": "long", "beam": {"part": "bimorph", "length": 30.0, "width": "5 mm", "layers": [
        {"material": "PZT-5A", "thickness": "0.3 mm"}] * 2}}, "beam.length", "30 m", '"30 mm"'),
]  # fmt: skip


@pytest.mark.parametrize(("tables", "key", "got", "why"), BODIES)
def test_every_body_is_compared_with_an_independent_result(tables, key, got, why):
    """The key, the number as it was read and, where a unit slipped, the one that was meant."""
    with pytest.raises(UsageError) as refused:
        load_scene(tables)
    error = refused.value
    assert f"key {key}" in str(error)
    assert got in error.got
    assert why in f"{error.message} {error.hint}"
    assert "checks.plausible" in error.hint
    load_scene({**tables, "checks": {"plausible": "off"}})
    with pytest.warns(UserWarning, match=error.message.split(":")[0]):
        load_scene({**tables, "checks": {"plausible": "warn"}})


@pytest.mark.parametrize(
    ("drive", "rated", "word"), [("8 kV", "7.5 kV", "may depolarise"), ("80 mV", "1 kV", "80 V")]
)
def test_an_unusual_drive_prints_a_warning_before_the_run(drive, rated, word):
    with pytest.warns(UserWarning, match=word):
        load_scene(slips(drive=drive, rated_voltage=rated))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load_scene(slips(drive="0.5 kV", rated_voltage=rated))


def test_a_time_is_no_width():
    """Ranges follow from the role that a key declares: a pulse has a width, too."""
    scene = load_scene("kick_and_catch", {"kick.drive.width": "0.4 us"})
    assert scene.parts["kick"].keys.drive.width == pytest.approx(0.4e-6)


ROLES = (
    (StackKeys, {"side": 0.5, "depth": 0.5, "diameter": 0.5, "height": 1.0}),
    (Cap, {"thickness": 0.03}),
    (bimorph.BimorphKeys, {"length": 1.0, "width": 0.5, "tip_mass": 1e3}),
    (bimorph.BimorphLayer, {"thickness": 0.03}),
    (mass.MassKeys, {"mass": 1e3}),
    (PulseKeys, {}),
)


@pytest.mark.parametrize(("schema", "largest"), ROLES)
def test_keys_declare_their_roles(schema, largest):
    """The largest plausible value of each key that has a role; a pulse's width has none."""
    roles = {name: get_plausible_range(field) for name, field in schema.model_fields.items()}
    assert {name: role.high for name, role in roles.items() if role is not None} == largest


WRONG_DIMENSIONS = (
    ({"analysis": {"type": "transient", "stop": "50 Hz"}}, "analysis.stop", "a number in s"),
    ({"analysis": {"type": "ac", "start": "1 Hz", "stop": "50 ms"}}, "analysis.stop", "Hz"),
    ({"analysis": {"type": "transient", "stop": "1 ms"},
      "probes": {"v": {"of": "load.v", "at": "5 mV"}}}, "probes.v.at", "a value in s"),
    ({"analysis": {"type": "ac", "start": "1 Hz", "stop": "1 kHz"},
      "probes": {"v": {"of": "load.v", "at": "2 ms"}}}, "probes.v.at", "a value in Hz"),
    ({"analysis": {"type": "dc", "sweep": "drive.dc", "to": "5 V"},
      "probes": {"v": {"of": "load.v", "at": "2 ms"}}}, "probes.v.at", "a value in V"),
    ({"analysis": {"type": "dc", "sweep": "drive.dc", "to": "5 A"}}, "analysis.to", "V"),
    ({"analysis": {"type": "transient", "stop": "1 ms"},
      "probes": {"v": {"of": "load.v", "take": "rms", "from": "5 Hz"}}}, "probes.v.from", "in s"),
)  # fmt: skip


@pytest.mark.parametrize(("tables", "key", "expected"), WRONG_DIMENSIONS)
def test_wrong_dimensions_are_refused(tables, key, expected):
    circuit = {
        "name": "circuit",
        "drive": {"part": "source", "dc": "1 V", "ac": "1 V"},
        "load": {"part": "resistor", "resistance": 50.0, "pins": {"a": "drive.out"}},
    }
    with pytest.raises(UsageError) as refused:
        load_scene({**circuit, **tables})
    assert f"key {key}" in str(refused.value)
    assert expected in refused.value.expected


def test_places_without_a_unit_are_those_of_the_scale():
    circuit = {
        "name": "circuit",
        "drive": {"part": "source", "dc": "1 V"},
        "load": {"part": "resistor", "resistance": 50.0, "pins": {"a": "drive.out"}},
        "analysis": {"type": "transient", "stop": "1 ms"},
        "probes": {"v": {"of": "load.v", "at": 5e-4}, "w": {"of": "load.v", "at": "0.5 ms"}},
    }
    probes = load_scene(circuit).probes
    assert probes["v"].at == probes["w"].at == 5e-4
