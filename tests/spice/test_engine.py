"""The engine's distrust: raw files, logs, early ends, time limits, a missing simulator."""

import struct

import numpy as np
import pytest
from support import Deck, MissingToolError, SimulationError, ngspice, read_raw, run_deck


def raw_text(points, flags="real", names=("time", "v(a)")):
    lines = [
        "Title: t", "Date: d", "Plotname: Transient Analysis", f"Flags: {flags}",
        f"No. Variables: {len(names)}", f"No. Points: {points}   ", "Variables:",
        *(f"\t{i}\t{n}\tvoltage" for i, n in enumerate(names)), "Binary:", "",
    ]  # fmt: skip
    return "\n".join(lines).encode()


def deck(cards, vectors=None, stop=None):
    vectors = {"b": ("v(b)", 1.0)} if vectors is None else vectors
    return Deck(name="d", text=f"* d\n{cards}\n.end\n", vectors=vectors, stop=stop)


RC = "V1 a 0 PULSE(0 1 0 1n)\nR1 a b 1k\nC1 b 0 1u\n.options acct\n.tran 1u {}"


# ---------------------------------------------------------------------------------- raw files


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"Title: t\nBinary:\n",
        raw_text(2)[:60],
        raw_text(2) + struct.pack("<3d", 0.0, 1.0, 0.5),
        raw_text(1) + struct.pack("<4d", 0.0, 1.0, 0.5, 2.0),
        raw_text(0),
        raw_text(1) + struct.pack("<2d", 0.0, float("nan")),
        raw_text("many"),
        raw_text(1).replace(b"No. Variables: 2", b"No. Variables: 9"),
        raw_text(1).replace(b"No. Variables: 2", b"No. Variables: -1"),
    ],
)
def test_incomplete_files_are_refused(content, tmp_path):
    path = tmp_path / "a.raw"
    path.write_bytes(content)
    with pytest.raises(SimulationError, match="the raw file is damaged"):
        read_raw(path)


def test_equal_time_points_are_read_once(tmp_path):
    """A derivative by time would otherwise divide by zero."""
    path = tmp_path / "a.raw"
    path.write_bytes(raw_text(4) + struct.pack("<8d", 0.0, 1.0, 0.5, 2.0, 0.5, 3.0, 1.0, 4.0))
    vectors = read_raw(path)
    assert vectors["time"].tolist() == [0.0, 0.5, 1.0]
    assert vectors["v(a)"].tolist() == [1.0, 3.0, 4.0]


# ------------------------------------------------------------------------------------- engine


def test_a_good_run(tmp_path):
    waves = run_deck(deck(RC.format("1m"), stop=1e-3), tmp_path)
    exact = 1 - np.exp(-waves["time"] / 1e-3)
    assert np.abs(waves["b"] - exact).max() < 1e-3
    assert waves.stats["accepted"] == waves["time"].size


@pytest.mark.parametrize(
    ("cards", "message"),
    [
        ("R1 a 0 1\nX1 a b nosub\n.tran 1u 1m", "unknown subckt"),
        ("V1 b 0 1\nV2 b 0 2\n.tran 1u 1m", "ngspice failed|stopped"),
        ("B1 0 b I=(v(b)>0.5) ? -1e6 : 1e6\nC1 b 0 1e-15\nR1 b 0 1k\n.tran 1u 1m", "too small"),
        ("V1 b 0 1\nR1 b 0 {nothing}\n.tran 1u 1m", "ngspice failed"),
    ],
)
def test_a_failed_run_is_an_error_and_leaves_no_raw_file(cards, message, tmp_path):
    (tmp_path / "d.raw").write_bytes(b"the result of another day")
    with pytest.raises(SimulationError, match=message) as caught:
        run_deck(deck(cards, stop=1e-3), tmp_path)
    assert str(tmp_path) in str(caught.value)
    assert not list(tmp_path.glob("*.raw*"))
    assert (tmp_path / "d.log").is_file()


def test_an_early_end_is_noticed(tmp_path):
    with pytest.raises(SimulationError, match="before the end"):
        run_deck(deck(RC.format("1m"), stop=2e-3), tmp_path)


def test_time_limit(tmp_path):
    with pytest.raises(SimulationError, match="did not finish"):
        run_deck(deck(RC.format("1000").replace("1u 1000", "1u 1000 0 1u"), stop=1e3), tmp_path,
                 timeout=0.3)  # fmt: skip
    assert not list(tmp_path.glob("*.raw*"))


def test_users_start_up_file_is_ignored(tmp_path, monkeypatch):
    (tmp_path / ".spiceinit").write_text("quit 3\n")
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("SPICE_ASCIIRAWFILE", "1")
    assert run_deck(deck(RC.format("1m"), stop=1e-3), tmp_path)["time"].size > 50


def test_missing_simulator_is_named_with_its_cure(tmp_path, monkeypatch):
    ngspice.find_ngspice.cache_clear()
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(MissingToolError, match="apt-get install ngspice") as caught:
        run_deck(deck(RC.format("1m"), stop=1e-3), tmp_path / "out")
    assert caught.value.exit_code == 3
    assert not (tmp_path / "out").exists()
    ngspice.find_ngspice.cache_clear()
