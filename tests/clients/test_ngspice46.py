"""A newer ngspice than the system's gives the same kick."""

import pytest
from support import read_raw, write_files


def test_newer_ngspice_agrees(deck_of, program, run, tmp_path):
    newer = program("ngspice", own=True)
    deck = deck_of("kick_and_catch", stop=1e-3)
    write_files(deck.files, tmp_path)
    results = []
    for k, simulator in enumerate(("ngspice", newer)):
        run([simulator, "-b", "-n", "-r", f"{k}.raw", deck.main_file_name], tmp_path)
        results.append(read_raw(tmp_path / f"{k}.raw"))
    older, newer = results
    assert older["time"][-1] == pytest.approx(newer["time"][-1])
    assert newer["v(contact_v)"][-1] == pytest.approx(older["v(contact_v)"][-1], rel=5e-6)
    assert newer["v(kick_ring0)"].max() == pytest.approx(older["v(kick_ring0)"].max(), rel=5e-6)
