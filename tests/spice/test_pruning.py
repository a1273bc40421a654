"""What a scene leaves out, against the unpruned model: rings, parts, and the error budget."""

import json
import re

import pytest
from typer.testing import CliRunner

from kc2spice.cli.main import app
from kc2spice.core.progress import Clock
from kc2spice.scene.load import load_scene
from kc2spice.workflow.decks import make_deck
from kc2spice.workflow.models import build_models


@pytest.mark.parametrize(
    ("scene", "key", "kept"),
    [("impact", "solver.stop=10 us", 1), ("imprint", "imprint.steps=20", 4)],
)  # fmt: skip
def test_a_run_that_needed_more_rings_fails_and_says_so(scene, key, kept, tmp_path):
    out = tmp_path / "out"
    arguments = ["run", scene, "--set", f"contact.rings={kept}", "--set", key, "-o", str(out)]
    result = CliRunner().invoke(app, [*arguments, "--quiet"])
    assert result.exit_code == 5
    assert "ring_left_out" in result.output
    assert f"set contact.rings to more than {kept}, or to 'all'" in result.output
    assert not out.exists()


@pytest.mark.parametrize(
    ("lacking", "words"),
    [
        (("control", "catch"), ("pid", "opamp", "catch", "coil", "drive", "bc0")),
        (("kick", "contact"), ("kick", "contact", "ring0", "anode", "chip", "ring")),
    ],
)
def test_a_netlist_has_no_trace_of_what_the_scene_lacks(lacking, words):
    sections = ("kick", "contact", "sphere", "catch", "control")
    tables = {name: {} for name in sections if name not in lacking}
    deck = make_deck(build_models(load_scene({"name": "bare", **tables}), Clock()))
    for name, text in deck.files.items():
        cards = "\n".join(line for line in text.splitlines() if not line.startswith("*"))
        text = f"{name}\n{cards}".lower()
        if "kick" not in lacking:  # the source of the kick itself
            text = text.replace("kick_drive", "kick")
        found = set(re.findall(r"[a-z]+[a-z0-9]*", text))
        assert not found & set(words), name
    assert not [vector for vector in deck.vectors if vector.split(".")[0] in (*lacking, *words)]


def ran(tmp_path, text):
    (tmp_path / "own.toml").write_text(text)
    out = tmp_path / "out"
    result = CliRunner().invoke(app, ["run", str(tmp_path / "own.toml"), "-o", str(out), "--quiet"])
    assert result.exit_code == 0, result.output
    return json.loads((out / "result.json").read_text())


def test_a_chip_alone_is_an_electrical_load(tmp_path):
    """No ring port is left; slowly charged it holds the free capacitance's 143.19 nF."""
    slow = "[kick]\n[kick.drive]\nwidth = 3e-4\nedge = 2.9e-4\n[solver]\nstop = 1.2e-3\n"
    result = ran(tmp_path, slow)
    assert result["rom"]["ports"] == ["anode"]
    assert set(result["metrics"]) == {
        "kick_voltage_peak_v", "kick_current_peak_a", "kick_charge_peak_c",
    }  # fmt: skip
    # 2 %: an edge of 290 us still makes the chip ring a little, at 270 kHz.
    charge = 100 * result["model"]["kick"]["capacitance_free_f"]
    assert charge == pytest.approx(100 * 143.19e-9, rel=1e-3)
    assert result["metrics"]["kick_charge_peak_c"] == pytest.approx(charge, rel=0.02)


def test_a_sphere_alone_falls(tmp_path):
    result = ran(tmp_path, "[sphere]\n[solver]\nstop = 2e-3\n")
    assert "rom" not in result
    told = CliRunner().invoke(app, ["explain", str(tmp_path / "own.toml"), "--json"])
    assert json.loads(told.stdout).items() >= result["plan"].items()  # one record, shown twice
    fallen = 1e-3 - 9.81 * 2e-3**2 / 2
    assert result["metrics"]["final_position_m"] == pytest.approx(fallen, rel=1e-5)
