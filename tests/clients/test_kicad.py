"""KiCad checks, draws and exports every sheet; the exported netlist gives the deck's results."""

import re
import sys
import xml.etree.ElementTree as ElementTree
import zipfile
from pathlib import Path

import numpy as np
import pytest
from support import list_gallery, load_scene, read_raw, write_files, write_symbol_files

# KiCad writes instances in an order of its own, in which sums are rounded otherwise: so may another
# processor. These scenes have many switching instants that follow from their state; what rounding
# changes there, a step, stays below the second number with the first as reltol. The anode of
# buzzer_self peaks where its transistor switches: 4e-5 below the limit of fine steps at 1e-6, still
# 7e-6 at 1e-7, and no smaller max_step helps, steps being ten times shorter anyway. alarm_3v has
# the same transistor. The bridge of loudspeaker_vented has edges of 0.5 us: only shorter steps give
# its overshoot there, and 5 ms of them are enough for a comparison.
SETTLED = {
    "pwm_coil": (1e-7, 1e-6), "buzzer_self": (1e-6, 4e-5), "harvester_bridge": (1e-6, 1e-6),
    "alarm_3v": (1e-6, 4e-5), "loudspeaker_vented": (1e-5, 1e-3),
}  # fmt: skip
SHORT = {"loudspeaker_vented": {"stop": 5e-3, "max_step": 0.2e-6}}
QUICK = "kick_and_catch"
SCENES = [
    pytest.param(name, marks=() if name == QUICK else pytest.mark.slow)
    for name in sorted(list_gallery())
]


@pytest.fixture(scope="module")
def kicad(program):
    return program("kicad-cli")


def project(deck, folder):
    write_files(deck.files | write_symbol_files(deck), folder)
    return f"{deck.name}.kicad_sch"


@pytest.mark.parametrize("name", SCENES)
def test_sheets_are_clean_and_are_the_deck(name, deck_of, kicad, run, tmp_path):
    reltol, near = SETTLED.get(name, (None, 1e-6))
    solver = SHORT.get(name, {}) | ({} if reltol is None else {"reltol": reltol})
    if "kick_drive" in load_scene(name).parts:
        solver["stop"] = 0.52e-3  # the kick is at 0.5 ms
    deck = deck_of(name, **solver)
    sheet = project(deck, tmp_path)
    run([kicad, "sch", "erc", "--severity-all", "--exit-code-violations", sheet], tmp_path)
    run([kicad, "sch", "export", "netlist", "--format", "spice", "-o", "sheet.cir", sheet],
        tmp_path)  # fmt: skip
    nodes = sorted({v for e, _ in deck.vectors.values() for v in re.findall(r"v\(\w+\)", e)})
    saved = "\n".join(f".save {node}" for node in nodes)
    exported = (tmp_path / "sheet.cir").read_text()
    (tmp_path / "sheet.cir").write_text(exported.replace(".end\n", f"{saved}\n.end\n"))
    for file in ("sheet.cir", deck.main_file_name):
        run(["ngspice", "-b", "-n", "-r", f"{file}.raw", file], tmp_path)
    theirs, ours = (
        read_raw(tmp_path / f"{file}.raw") for file in ("sheet.cir", deck.main_file_name)
    )
    for node in [n for n in nodes if "ring0" in n] or nodes:  # the stroke, where there is one
        assert peak(theirs, node) == pytest.approx(peak(ours, node), rel=near), node


def peak(waves, node):
    """Largest magnitude, by a parabola through the largest sample and its neighbours, which are not
    equally far from it: the peak lies between the points."""
    scale, size = np.real(next(iter(waves.values()))), np.abs(waves[node])
    k = int(np.clip(np.argmax(size), 1, len(size) - 2))
    x, y = scale[k - 1 : k + 2] - scale[k], size[k - 1 : k + 2]
    (before, after), (left, right) = np.diff(x), np.diff(y) / np.diff(x)
    bend = (right - left) / (before + after)
    slope = left + bend * before
    if not bend < 0 or not x[0] <= -slope / (2 * bend) <= x[2]:  # a straight line bends by rounding
        return y.max()
    return max(y.max(), y[1] - slope**2 / (4 * bend))


def test_a_wrong_sheet_is_detected(deck_of, kicad, run, tmp_path):
    sheet = project(deck_of("impact"), tmp_path)
    text = (tmp_path / sheet).read_text()
    first_wire = re.search(r"\n  \(wire [^\n]*", text)[0]
    (tmp_path / sheet).write_text(text.replace(first_wire, "", 1))
    with pytest.raises(AssertionError):
        run([kicad, "sch", "erc", "--severity-all", "--exit-code-violations", sheet], tmp_path)


@pytest.mark.slow
def test_symbols_and_sheets_are_drawn(deck_of, kicad, run, tmp_path):
    sheet = project(deck_of("charge_kick"), tmp_path)
    run([kicad, "sch", "export", "svg", "-o", "drawn", sheet], tmp_path)
    run([kicad, "sym", "export", "svg", "-o", "drawn", "kc2spice.kicad_sym"], tmp_path)
    pictures = {path.name: ElementTree.parse(path) for path in (tmp_path / "drawn").glob("*.svg")}
    assert "charge_kick.svg" in pictures
    assert len(pictures) >= 15


def test_the_merged_library_finds_its_models(deck_of, kicad, run, tmp_path, monkeypatch):
    """Each symbol of the release package, placed on a sheet, includes a file of the package."""
    root = Path(__file__).parents[2]
    package = tmp_path / "package.zip"
    run([sys.executable, str(root / "tools" / "netlists.py"), str(package)], tmp_path)
    with zipfile.ZipFile(package) as archive:
        archive.extractall(tmp_path)
    text = (tmp_path / "symbols" / "kc2spice.kicad_sym").read_text()
    named = re.findall(r'"Sim.Library" "\$\{KC2SPICE_NETLISTS\}/([^"]+)"', text)
    assert len(named) > 40
    assert all((tmp_path / "libraries" / name).is_file() for name in named)
    names = re.findall(r'(?m)^\t\(symbol "(\w+)"', text)
    assert len(set(names)) == len(names)
    sheet = project(deck_of("impact"), tmp_path / "sheet")
    drawn = (tmp_path / "sheet" / sheet).read_text()
    drawn = drawn.replace('"Sim.Library" "', '"Sim.Library" "${KC2SPICE_NETLISTS}/')
    (tmp_path / "sheet" / sheet).write_text(drawn)
    (tmp_path / "elsewhere").mkdir()
    for name in ("impact_kick.lib", "contact.lib", "sphere.lib"):
        (tmp_path / "sheet" / name).rename(tmp_path / "elsewhere" / name)
    monkeypatch.setenv("KC2SPICE_NETLISTS", str(tmp_path / "elsewhere"))
    export = [kicad, "sch", "export", "netlist", "--format", "spice", "-o", "sheet.cir", sheet]
    run(export, tmp_path / "sheet")
    text = (tmp_path / "sheet" / "sheet.cir").read_text()
    assert f'.include "{tmp_path}/elsewhere/impact_kick.lib"' in text
