"""An ac scene that nothing drives: 1 V on its body, or a reason, and never an empty plot."""

import json
import warnings

import numpy as np
import pytest
from support import UsageError

import kc2spice as kc

BODY = {
    "name": "own",
    "analysis": {"type": "ac", "start": 1e3, "stop": 10e3, "points": 40},
    "beam": {
        "part": "bimorph", "length": 30e-3, "width": 5e-3, "wiring": "parallel",
        "layers": [{"material": "PZT-5A", "thickness": 0.3e-3}] * 2,
        "damping": {"quality": 50, "at": 314.0},
    },
}  # fmt: skip
LOAD = {"part": "resistor", "resistance": 1e3, "pins": {"a": "beam.anode"}}
DRIVE = {"part": "source", "ac": 1.0, "pins": {"out": "beam.anode"}}
STILL = {"part": "source", "dc": 1.0, "pins": {"out": "beam.anode"}}


def test_its_impedance_is_that_of_the_same_scene_with_a_source(tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # the first resonance is below the band, which starts at 1 kHz
        warnings.filterwarnings("ignore", message=".*metrics of its resonance are missing")
        bare = kc.run(BODY, tmp_path / "bare")
    given = kc.run(BODY | {"drive": DRIVE}, tmp_path / "given")
    assert bare.metrics.keys() >= given.metrics.keys()
    assert bare.metrics == given.metrics
    assert len(bare.metrics["impedance_ohm"]) == len(bare.metrics["frequency_hz"]) >= 41
    np.testing.assert_array_equal(bare.waves["beam_drive.i"], given.waves["drive.i"])
    record = json.loads((tmp_path / "bare" / "result.json").read_text())
    assert list(record["curves"]) == ["frequency_hz", "impedance_ohm"]
    assert not record["metrics"].keys() & record["curves"].keys()


def test_a_cathode_that_is_grounded_by_name_and_a_part_of_the_drives_name():
    tables = BODY | {"beam": BODY["beam"] | {"pins": {"cathode": "gnd"}}}
    tables |= {"beam_drive": {"part": "mass", "mass": 1e-6, "pins": {"a": "beam.tip"}}}
    deck = kc.deck(tables)
    assert " AC 1\n" in deck.files[deck.main_file_name]


@pytest.mark.parametrize(
    "parts",
    [
        {"load": LOAD},
        {"drive": STILL},
        {"beam": BODY["beam"] | {"pins": {"anode": "gnd"}}},
        {"other": BODY["beam"]},
        {"beam": {"part": "mass", "mass": 1e-3},
         "s": {"part": "spring", "stiffness": 1.0, "pins": {"a": "beam.a"}}},
    ],
    ids=["something is joined", "a source without ac", "grounded", "two bodies", "no body"],
)  # fmt: skip
def test_an_ac_analysis_without_a_source_is_rejected_before_a_run(parts):
    with pytest.raises(UsageError, match="the ac analysis has no source") as caught:
        kc.deck(BODY | parts)
    assert "analysis" in str(caught.value)
    assert 'ac = "1 V"' in str(caught.value)


def test_a_source_in_a_user_netlist_drives_the_scene(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for text, driven in (("V1 out ref DC 0 AC 1", True), ("V1 out ref 1", False)):
        (tmp_path / "own.lib").write_text(f".subckt own out ref\n{text}\n.ends\n")
        own = {"part": "netlist", "file": "own.lib", "subckt": "own"}
        tables = BODY | {"own": own | {"pins": {"out": "beam.anode"}}}
        if driven:
            assert "Xown beam_anode" in kc.deck(tables).files["own.cir"]
        else:
            with pytest.raises(UsageError, match="the ac analysis has no source"):
                kc.deck(tables)
        (tmp_path / "own.lib").unlink()
