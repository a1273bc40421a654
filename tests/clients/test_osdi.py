"""Verilog-A modules, compiled by OpenVAF and run by ngspice, against their netlists."""

import re

import numpy as np
import pytest
from support import list_gallery, load_scene, read_raw, write_dialect_files, write_files

QUICK = ("buzzer_7bb_20_6", "sphere_on_beam")
SCENES = [
    pytest.param(name, marks=() if name in QUICK else pytest.mark.slow)
    for name in sorted(list_gallery())
]
# ms; the kick is at 0.5 ms, modules take 15 times the time of a netlist
STOP = {
    "buzzer_self": 3.0, "harvester_bridge": 100.0, "buzzer_square": 3.0, "sphere_on_beam": 0.5,
    "thermostat": 2e3, "mosfet_sink": 2e3,
    # Later, ngspice does not converge. The current of the meter at the heat capacity C is C dT/h in
    # short time steps h: rounding errors of T = 60 K in it exceed abstol. With an abstol of 1e-5,
    # without the meter, or with a housing at 0 K the same modules converge beyond the kick.
    "coil_self_heating": 0.501,
}  # fmt: skip
# Their sound is a derivative, which steps at the default reltol give to some 0.1 % only.
FINE = {"alarm_3v", "loudspeaker_vented"}


def shortened(name):
    scene = load_scene(name)
    if scene.analysis.type != "transient" or name == "impact":
        return {}
    fine = {"reltol": 1e-6} if name in FINE else {}
    return {"stop": 1e-3 * STOP.get(name, 0.505)} | fine


@pytest.mark.parametrize("name", SCENES)
def test_compiled_modules_have_the_results_of_the_netlists(name, deck_of, program, run, tmp_path):
    compiler, simulator = program("openvaf-r"), program("ngspice", own=True)
    deck = deck_of(name, **shortened(name))
    if deck.command.kind == "noise":
        pytest.skip("sources of noise are ngspice's alone")
    files = write_dialect_files(deck, "verilog-a")
    write_files(files, tmp_path / "modules")
    write_files(deck.files, tmp_path / "netlists")
    modules = [file for file in files if file.endswith(".va")]
    # transistors, diodes and waveforms are no module: such a part runs as the library that it is
    assert bool(files.get("verilog-a.txt")) == (len(modules) < len(deck.parts))
    for file in modules:
        run([compiler, file], tmp_path / "modules")
    run([simulator, "-b", "-n", "-r", "a.raw", f"{name}_osdi.cir"], tmp_path / "modules")
    run([simulator, "-b", "-n", "-r", "b.raw", deck.main_file_name], tmp_path / "netlists")
    ours, theirs = read_raw(tmp_path / "netlists/b.raw"), read_raw(tmp_path / "modules/a.raw")
    nodes = [n for n in theirs if re.fullmatch(r"v\(\w+\)", n) and n in ours]
    assert nodes
    if deck.stop is None:  # linear, or a sweep: the same points and the same equations
        # a resonance of quality 1600, softened by an operating point that iterations leave at 1e-9
        same = 1e-5 if name == "gap_biased" else 1e-9
        for node in [*nodes, *(n for n in theirs if n.startswith("i("))]:
            scale = np.abs(ours[node]).max()
            np.testing.assert_allclose(theirs[node], ours[node], rtol=same, atol=same * scale)
        return
    assert theirs["time"][-1] == pytest.approx(ours["time"][-1])
    strokes = [n for n in nodes if re.search(r"_(ring0|centre|middle|tip|p1)\)", n)]
    # rigid spheres alone, or a mass
    strokes = strokes or [n for n in nodes if n.endswith(("_y)", "_a)"))] or nodes
    for node in strokes:
        assert np.abs(theirs[node]).max() == pytest.approx(np.abs(ours[node]).max(), rel=1e-3)
    if name == "impact":
        assert theirs["v(contact_v)"][0] == pytest.approx(-1.0)
        assert theirs["v(contact_v)"][-1] == pytest.approx(ours["v(contact_v)"][-1], rel=1e-5)
        assert theirs["v(sphere_y)"].min() == pytest.approx(ours["v(sphere_y)"].min(), abs=1e-3)
