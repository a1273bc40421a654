"""Refusal of meaningless input before a run, by name."""

import pytest
from support import SimulationError, UsageError, app, convert_quantity, ngspice
from typer.testing import CliRunner

import kc2spice as kc

RC = {
    "name": "rc", "analysis": {"stop": 1e-3}, "solver": {"max_step": 1e-5},
    "drive": {"part": "source", "pulse": {"high": 1.0, "width": 1e-3}},
    "r": {"part": "resistor", "resistance": 1e3, "pins": {"a": "drive.out", "b": "c.a"}},
    "c": {"part": "capacitor", "capacitance": 1e-8},
}  # fmt: skip


def changed(**parts):
    return {k: v for k, v in (RC | parts).items() if v is not None}


ENDS = [
    {"r2": {"part": "resistor", "resistance": 1.0, "pins": {"a": "c.a", "b": "r.b"}}},
    {"r2": {"part": "capacitor", "capacitance": 1.0, "pins": {"a": "gnd"}}},
    {"r2": {"part": "diode", "pins": {"anode": "c.a", "cathode": "c.a"}}},
    {"r2": {"part": "source", "dc": 1.0, "pins": {"out": "gnd"}}},
    {"r2": {"part": "source", "kind": "current", "dc": 1.0, "pins": {"out": "gnd"}}},
    {"m": {"part": "mass", "mass": 1e-3},
     "r2": {"part": "spring", "stiffness": 1.0, "pins": {"a": "m.a", "b": "m.a"}}},
]  # fmt: skip


@pytest.mark.parametrize("parts", ENDS)
def test_a_part_of_two_ends_lies_between_two_nets(parts):
    with pytest.raises(UsageError, match="connected to the same net") as caught:
        kc.load_scene(changed(**parts))
    assert "r2" in str(caught.value)


@pytest.mark.parametrize("kind", ["transient", "ac", "op"])
def test_only_dc_analyses_accept_a_sweep(kind):
    analysis = {"type": kind, "sweep": "drive.dc"} | {
        "transient": {"stop": 1e-3}, "ac": {"start": 1.0, "stop": 2.0}, "op": {},
    }[kind]  # fmt: skip
    with pytest.raises(UsageError, match=r"analysis\.sweep needs a dc"):
        kc.load_scene(changed(analysis=analysis))


@pytest.mark.parametrize("text", ["1 1 mm", "2 1 1 mm", "1 mm 1", "3 1 V"])
def test_a_number_in_a_unit_is_not_a_unit(text):
    with pytest.raises(UsageError):
        convert_quantity(text, "V" if "V" in text else "m")
    assert convert_quantity("5 1/s", "Hz") == 5.0


@pytest.mark.parametrize(
    "keys",
    [
        {"analysis": {"stop": 1e30}},
        {"analysis": None, "solver": {"max_step": 1e-5, "stop": 1e30}},
        {"solver": {"max_step": 1e-30}},
        {"solver": {"max_step": 0.9e-10}},
    ],
)
def test_more_than_ten_million_points_print_a_warning_before_the_run(keys):
    with pytest.raises(UsageError, match="too many time points") as caught:
        kc.load_scene(changed(**keys))
    assert "1e+07" in str(caught.value)
    assert kc.load_scene(changed(solver={"max_step": 1.1e-10}))


def test_a_raw_file_that_grows_beyond_its_limit_ends_the_run(monkeypatch, tmp_path):
    """Steps shorter than the largest one make the file larger than expected."""
    monkeypatch.setattr(ngspice, "MAX_RAW_BYTES", 400_000.0)
    drive = {"part": "source", "pulse": {"high": 1.0, "width": 5e-7, "edge": 1e-8, "period": 1e-6}}
    with pytest.raises(SimulationError, match="grows beyond its limit"):
        kc.run(changed(drive=drive, analysis={"stop": 20e-3}, solver={"max_step": 2e-5}))


@pytest.mark.parametrize("command", ["run", "export", "sweep", "bench", "reduce"])
def test_a_directory_without_a_name_is_bad_usage(command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(app, [command, "harvester", "-o", ""])
    assert done.exit_code == 2
    assert "the name of the directory is empty" in done.output
    assert not list(tmp_path.iterdir())
