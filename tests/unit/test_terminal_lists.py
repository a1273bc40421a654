"""Output of the commands ``explain``, ``scenes --part`` and ``doctor``, and of ``--help``."""

import re

import pytest
from support import (
    InstallationFinding,
    KeyDescription,
    NeglectedEffect,
    describe_analysis,
    format_model_summary,
    format_summary,
    list_part_keys,
    load_part_types,
    load_scene,
    print_findings,
    print_keys,
)

import kc2spice as kc

SETTINGS = [
    {"key": "solver.max_step", "value": 5e-6, "error": None, "error_of": None, "unit": "s"},
    {"key": "solver.chgtol", "value": 1e-8, "error": None, "error_of": None, "unit": "C"},
    {"key": "rom.tolerance", "value": 1e-4, "error": 2e-6, "error_of": "model", "unit": ""},
    {"key": "disc.mesh.refine", "value": 2, "error": 0.0096, "error_of": "stroke", "unit": None},
]


def neglected(effect, error, size=None, summarised=False):
    return {"effect": effect, "why": "", "error": error, "size": size, "summarised": summarised}


def summary(**changes):
    planned = {"settings": SETTINGS, "parts": [], "left_out": [], "error_budget": None} | changes
    return {section.title: section for section in format_model_summary(planned)}


def test_settings_have_units_and_errors_are_in_percent():
    section = summary()["Numerical settings"]
    assert section.rows == [
        ("solver.max_step", "5 µs", "not estimated", ""),
        ("solver.chgtol", "10 nC", "not estimated", ""),
        ("rom.tolerance", "0.01 %", "< 0.001 %", "model"),
        ("disc.mesh.refine", "2", "0.96 %", "stroke"),
    ]
    assert "write error_budget = 0.01 at the top of the scene file" in section.note
    step = {"s": 1e-6, "why": "1/125 of a period of drive"}
    note = summary(largest_step=step)["Numerical settings"].note
    assert note.startswith("solver.max_step follows from: 1/125 of a period of drive. Errors are")
    step["why"] = "set by solver.max_step"
    assert summary(largest_step=step)["Numerical settings"].note == section.note
    stated = summary(error_budget=0.02)["Numerical settings"].note
    assert "error_budget = 0.02" in stated
    assert "at most 2 %" in stated


def test_neglected_effects_are_sorted_by_size():
    rows = [
        neglected("a", "not estimated"),
        neglected("b", "checked after the run"),
        neglected("c", "1 % lower", 0.01),
        neglected("d", "not estimated; compare with a finer mesh"),
        neglected("e", "16 % lower", 0.16),
        neglected("f", "-6 dB", summarised=True),
    ]
    section = summary(left_out=rows)["Neglected effects"]
    assert [row[0] for row in section.rows] == ["f", "e", "c", "b", "a", "d"]
    assert [row[2] for row in section.rows if row[0] in "ad"] == [
        "not estimated", "not estimated; compare with a finer mesh",
    ]  # fmt: skip


def test_each_fact_about_a_part_has_a_row_and_sources_are_first():
    parts = [
        {"part": "disc", "source": "FE", "detail": "order 3; ports a, b"},
        {"part": "drive", "source": "ideal source", "detail": "voltage, ac 1 V"},
    ]
    assert summary(parts=parts)["Parts"].rows == [
        ("drive", "ideal source: voltage, ac 1 V"),
        ("disc", "FE: order 3"),
        ("", "ports a, b"),
    ]


@pytest.mark.parametrize(
    ("scene", "part", "words"),
    [
        ("harvester", "shaker", "acceleration, ac 9.81 m/s²"),
        ("gap_biased", "drive", "voltage, dc 200 V"),
        ("comb_resonator", "drive", "voltage sine, amplitude 8 V, 1.125 kHz"),
        ("plate_pull_in", "drive", "voltage, 3 points, 0 V to 12 V, until 10 ms"),
        ("coil_self_heating", "housing", "temperature, constant 60 K"),
        (
            "buzzer_square", "gate",
            "voltage pulse, 0 V to 5 V, width 76.9 µs, edges 100 ns, period 153.8 µs, 60 pulses",
        ),
        (
            "thermostat", "mains",
            "voltage pulse, 0 V to 24 V, width 1 ks, edges 1 ms, from t = 1 s",
        ),
    ],
)  # fmt: skip
def test_a_source_states_amplitude_and_timing(scene, part, words):
    loaded = load_scene(scene)
    source = loaded.parts[part]
    assert list(source.type.notes(source, loaded)) == [words]


def test_a_swept_source_states_its_range():
    scene = load_scene({
        "name": "s",
        "drive": {"part": "source", "dc": "1 V", "pins": {"out": "load.a"}},
        "load": {"part": "resistor", "resistance": 50.0, "pins": {"b": "gnd"}},
        "analysis": {"type": "dc", "sweep": "drive.dc", "from": "-2 V", "to": "3 V"},
    })  # fmt: skip
    drive = scene.parts["drive"]
    assert list(drive.type.notes(drive, scene)) == ["voltage, swept from −2 V to 3 V"]
    assert describe_analysis(scene) == "dc, sweep of drive.dc"


def test_the_analysis_states_its_range():
    assert describe_analysis(load_scene("impact")) == "transient, 0 s to 15 µs"
    assert describe_analysis(load_scene("buzzer_noise")).startswith("noise, ")


@pytest.mark.parametrize(
    ("keys", "default"),
    [
        ({}, True),
        ({"analysis": {"type": "transient"}}, True),
        ({"analysis": {"type": "transient", "stop": "2 ms"}}, False),
        ({"solver": {"stop": "2 ms"}}, False),
        ({"analysis": {"type": "op"}}, False),
    ],
)
def test_a_run_states_an_end_time_that_no_key_sets(keys, default):
    result = kc.run({
        "drive": {"part": "source", "dc": "1 V", "pins": {"out": "load.a"}},
        "load": {"part": "resistor", "resistance": 50.0, "pins": {"b": "gnd"}},
        "probes": {"current": {"of": "load.i"}},
        **keys,
    })  # fmt: skip
    found = dict(format_summary(result.record).rows).get("analysis")
    assert found == ("stop = 5 ms (default of the key analysis.stop)" if default else None)


def test_neglected_effects_state_their_size():
    scene = load_scene("kick_and_catch")
    sizes = {}
    for part in scene.parts.values():
        for note in part.type.notes(part, scene):
            if isinstance(note, NeglectedEffect) and note.size is not None:
                sizes[note.effect] = note
    assert sizes["mounting of kick"].size == 0.16
    drag = sizes["drag of the air"]
    assert drag.error == f"{100 * drag.size:.2g} % of the weight at 1 m/s"
    elasticity = sizes["elasticity of the sphere"]
    assert elasticity.error == f"contact compliance {100 * elasticity.size:.0f} % higher if elastic"


@pytest.mark.parametrize("name", list(load_part_types()))
def test_required_keys_are_first_and_general_keys_last(name):
    schema = load_part_types()[name].schema
    keys = list_part_keys(schema)
    required = {field.alias or key for key, field in schema.model_fields.items()
                if field.is_required()}  # fmt: skip
    needed = [key.name.partition(".")[0] in required for key in keys]
    assert needed == sorted(needed, reverse=True)
    general = [key.name.startswith(("rom.", "mesh.")) for key in keys]
    assert general == sorted(general)


def test_the_support_of_a_disc_lists_its_words(cli):
    shown = cli("scenes", "--part", "disc").stdout
    assert 'support = "free" | "clamped" | "simply_supported", default "free"' in shown
    assert "\nlayers, required\n" in shown
    assert "\nlayers.thickness [m], required in layers\n" in shown
    assert "\nrom.band [Hz], optional\n" in shown
    assert "``" not in shown
    assert max(map(len, shown.splitlines())) <= 80


def test_defaults_are_toml_values_with_units(capsys):
    print_keys("Keys", [
        KeyDescription("gap", "m", 5e-4, (), "Width of the gap"),
        KeyDescription("range", "Hz", (0.0, 5e5), (), "Frequency range of the model"),
        KeyDescription("open", None, False, (), "Whether the rim is open"),
        KeyDescription("offset", "V", -0.25, (), "Offset voltage of the sensor"),
        KeyDescription("count", None, 3, (), "Number of turns"),
        KeyDescription("end", "s", 1.0, (), "End time; by default the end of the run"),
    ])  # fmt: skip
    assert [line for line in capsys.readouterr().out.splitlines() if line[0] != " "] == [
        "Keys",
        'gap [m], default "500 µm"',
        'range [Hz], default [0, "500 kHz"]',
        "open, default false",
        'offset [V], default "-250 mV"',
        "count, default 3",
        "end [s], optional",
    ]


def test_doctor_prints_fixes_only_for_faults(capsys):
    good = InstallationFinding("ngspice", True, "39")
    package = InstallationFinding("numpy", True, "2.0", package=True)
    print_findings("kc2spice 1.0", [good, package])
    shown = capsys.readouterr().out
    assert shown.startswith("kc2spice 1.0\n")
    assert "fix" not in shown
    assert "numpy 2.0" in shown
    assert shown.endswith("\nAll 2 checks passed.\n")
    print_findings("kc2spice 1.0", [InstallationFinding("gmsh", False, "not found", "pip"), good])
    shown = capsys.readouterr().out
    assert re.search(r"MISSING +gmsh +not found +pip", shown)
    assert shown.endswith("\n1 of 2 checks failed: kc2spice cannot run.\n")
    print_findings("kc2spice 1.0", [InstallationFinding("cache", False, "no", "set", needed=False)])
    assert (
        "kc2spice runs, because the failed checks concern optional items."
        in capsys.readouterr().out
    )


def test_the_help_explains_its_words(cli):
    shown = cli("--help").stdout
    commands = re.findall(r"(?m)^  ([a-z]+) {2,}[A-Z]", shown)
    assert commands[:4] == ["scenes", "parts", "explain", "run"]
    assert commands[-1] == "doctor"
    assert "SCENE is a TOML file" in shown
    assert "..." not in shown.partition("Commands:")[2]  # no sentence is cut
