"""The command file beside a deck runs it in ngspice and finds every curve that it plots."""

import re
import subprocess

import pytest
from device import deck_of
from support import format_plot_script, load_scene, write_files


@pytest.mark.parametrize("name", ["impact", "harmonic"])
def test_every_curve_of_the_command_file_is_drawn(name, model, table, tmp_path):
    deck = deck_of(load_scene(name), model, table)
    ((file, text),) = format_plot_script(deck).items()
    assert f"ngspice {file}" in deck.files[deck.main_file_name]
    plots = re.findall(r"(?m)^plot (.*)$", text)
    assert plots
    for k, words in enumerate(plots):  # without a screen: as a picture
        text = text.replace(f"plot {words}", f"hardcopy {k}.svg {words}")
    commands = text.replace("source ", "set hcopydevtype=svg\nsource ") + "quit 0\n"
    write_files(deck.files | {file: commands}, tmp_path)
    done = subprocess.run(
        ["ngspice", file], cwd=tmp_path, capture_output=True, text=True, input="", check=False
    )
    assert "no such" not in (done.stdout + done.stderr).lower()
    for k, words in enumerate(plots):
        curves = [w for w in words.partition(" ylabel")[0].split() if "(" in w or "[" in w]
        picture = (tmp_path / f"{k}.svg").read_text()
        assert picture.count("<path") + picture.count("<polyline") >= len(curves)
