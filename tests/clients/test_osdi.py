"""Verilog-A modules, compiled by OpenVAF and run by ngspice, against their netlists."""

import pytest

from kc2spice.sim.ngspice import write_files
from kc2spice.sim.rawfile import read_raw
from kc2spice.spice.dialect import dialect_files

pytestmark = pytest.mark.slow  # minutes: other programs, every scene


@pytest.mark.parametrize("name", ["impact", "half_bridge_kick"])
def test_compiled_modules_do_what_the_netlists_do(name, deck_of, program, run, tmp_path):
    compiler, simulator = program("openvaf-r"), program("ngspice", own=True)
    deck = deck_of(name) if name == "impact" else deck_of(name, stop=0.505e-3)
    files = dialect_files(deck, deck.parts, "verilog-a")
    write_files(files, tmp_path / "modules")
    write_files(deck.files, tmp_path / "netlists")
    modules = [file for file in files if file.endswith(".va")]
    # transistors are no module: this part runs as the library that it is
    assert len(modules) == len(deck.parts) - (name == "half_bridge_kick")
    for file in modules:
        run([compiler, file], tmp_path / "modules")
    run([simulator, "-b", "-n", "-r", "a.raw", f"{name}_osdi.cir"], tmp_path / "modules")
    run([simulator, "-b", "-n", "-r", "b.raw", deck.main], tmp_path / "netlists")
    ours, theirs = read_raw(tmp_path / "netlists/b.raw"), read_raw(tmp_path / "modules/a.raw")
    assert theirs["time"][-1] == pytest.approx(ours["time"][-1])
    assert theirs["v(kick_r0)"].max() == pytest.approx(ours["v(kick_r0)"].max(), rel=1e-3)
    if name == "impact":
        assert theirs["v(contact_v)"][0] == pytest.approx(-1.0)
        assert theirs["v(contact_v)"][-1] == pytest.approx(ours["v(contact_v)"][-1], rel=1e-5)
        assert theirs["v(sphere_y)"].min() == pytest.approx(ours["v(sphere_y)"].min(), abs=1e-3)
