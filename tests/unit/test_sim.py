"""What is made of a simulator's words, files and failures, with a program in its place."""

import os
import struct
import time
from types import SimpleNamespace

import numpy as np
import pytest

from kc2spice.core.errors import MissingToolError, SimulationError, UsageError
from kc2spice.netlist.deck import Deck
from kc2spice.sim import ngspice
from kc2spice.sim.failure import FailedRunError
from kc2spice.sim.log import classify
from kc2spice.sim.ngspice import run_deck
from kc2spice.sim.rawfile import read_partial

# ----------------------------------------------------------------------------------------- log


@pytest.mark.parametrize(
    ("text", "node", "at", "kind"),
    [
        ('Error: Timestep too small; time = 1e-3: trouble with node "x1.q"\n', "x1.q", 1e-3,
         "timestep"),
        ("a fatal error\nTimestep too small; time = 2.5E-06: trouble with b-instance b.x1.b2\n",
         "b.x1.b2", 2.5e-6, "timestep"),
        ("Timestep too small; initial timepoint: trouble with node q: x\n", "q", None,
         "operating point"),
        ("Warning: singular matrix:  check node v1#branch\nrun simulation(s) aborted\n"
         "DC solution failed -\n", "v1#branch", None, "singular"),
        ("Transient op failed, timestep too small\n", None, None, "operating point"),
        ("DC solution failed -\n", None, None, None),
        ("unknown subckt: x\n", None, None, None),
        ("Warning: check node a\n", None, None, None),
    ],
)  # fmt: skip
def test_a_failure_has_its_place_and_its_kind(text, node, at, kind):
    report = classify(text.replace("\n", "\r\n"))
    assert (report.node, report.time, report.kind) == (node, at, kind)


# ------------------------------------------------------------------------------------ raw files


def raw(points, values, names=("time", "v(a)"), *, flags="real", more=""):
    lines = [
        "Title: t", "Plotname:  Transient Analysis ", f"Flags: {flags}",
        f"No. Variables: {len(names)}",
        f"No. Points: {points}", more + "Variables:",
        *(f"\t{i}\t{n}\tvoltage" for i, n in enumerate(names)), "Binary:", "",
    ]  # fmt: skip
    return "\n".join(lines).encode() + struct.pack(f"<{len(values)}d", *values)


@pytest.mark.parametrize(
    ("values", "kept"),
    [
        ([0, 1, 2, 3, 4, 5], 3), ([0, 1, 2, 3, 4], 2), ([0, 1, 2, np.nan, 4, 5], None),
        ([0, 1, 2, 3, np.inf, 5], 2), ([0, 1, 2], None), ([], None),
    ],
)  # fmt: skip
def test_whole_finite_points_of_an_aborted_run_are_kept(values, kept, tmp_path):
    path = tmp_path / "a.raw"
    path.write_bytes(raw(0, values) + b"123")
    found = read_partial(path)
    if kept is None:
        assert found is None
    else:
        np.testing.assert_array_equal(found["time"], values[0 : 2 * kept : 2])
        np.testing.assert_array_equal(found["v(a)"], values[1 : 2 * kept : 2])


# --------------------------------------------------------------------------------------- engine


def deck(text="* d\n.tran 1u 1m\n.end\n", **more):
    return Deck(**{"name": "d", "text": text, "stop": 1e-3, "vectors": {"b": ("v(b)", 1.0)}} | more)


def script(path, text):
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)
    return path


@pytest.fixture
def fake(tmp_path, monkeypatch):
    """A program in place of ngspice, which says its version and then does as told."""

    def install(text):
        known = 'case "$*" in *--version*) echo "** ngspice-99.5 : Circuit"; exit 0;; esac\n'
        script(tmp_path / "ngspice", known + text)
        monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
        ngspice.find_ngspice.cache_clear()

    yield install
    ngspice.find_ngspice.cache_clear()


@pytest.mark.parametrize(
    ("text", "words", "got"),
    [("echo hello", "does not tell its version", "hello"),
     ("exec sleep 30", "does not run", "no answer")],
)  # fmt: skip
def test_a_program_that_is_no_ngspice_is_refused(text, words, got, fake, tmp_path, monkeypatch):
    fake("")
    script(tmp_path / "ngspice", text)
    monkeypatch.setattr(ngspice, "ANSWERS", 0.2)
    with pytest.raises(MissingToolError, match=words) as caught:
        ngspice.find_ngspice()
    assert got in caught.value.got


RAW = 'for last; do :; done; raw=$(echo "$*" | sed "s/.*-r \\\\([^ ]*\\\\).*/\\\\1/")\n'


def ran(fake, tmp_path, made, then="", **more):
    """The waves of a run whose simulator writes ``made`` as its raw file and does ``then``."""
    (tmp_path / "made").write_bytes(made)
    fake(RAW + f'cat {tmp_path}/made > "$raw"\n{then}')
    return run_deck(deck(**more), tmp_path / "out")


@pytest.mark.parametrize(("last", "good"), [(1e-3 * (1 - 5e-10), True), (1e-3 * (1 - 2e-9), False)])
def test_a_transient_ends_where_it_was_asked_to(last, good, fake, tmp_path):
    made = raw(2, [0, 1, last, 2], ("time", "v(b)"))
    if good:
        assert ran(fake, tmp_path, made)["b"][-1] == 2
        return
    with pytest.raises(FailedRunError, match="before the end") as caught:
        ran(fake, tmp_path, made, "echo trouble with node b")
    assert caught.value.expected == "0.001 s"
    assert caught.value.failure.partial["time"][-1] == last
    assert not list((tmp_path / "out").glob("*.raw*"))


def test_the_words_of_a_failed_run_are_told(fake, tmp_path):
    made = raw(2, [0, 1, 1e-4, 2], ("time", "v(b)"))
    said = "\n".join([f"echo line {k}" for k in range(5)] + ["exit 3"])
    with pytest.raises(FailedRunError, match="exit code 3") as caught:
        ran(fake, tmp_path, made, said)
    assert caught.value.got == "line 2 | line 3 | line 4"
    assert caught.value.failure.partial["b"].tolist() == [1, 2]
    said = 'echo "timestep too small; time = 2e-4: trouble with node b"'
    text = "* d\nR1 b 0 1\n.tran 1u 1m\n.end\n"
    with pytest.raises(FailedRunError, match="timestep too small") as caught:
        ran(fake, tmp_path, made, said, text=text)
    assert caught.value.got == "node b, node of r1, t = 0.0002 s"
    with pytest.raises(FailedRunError) as caught:
        ran(fake, tmp_path, raw(2, [0, 1, 1e-4, 2]), "exit 3")  # not all that was asked for
    assert caught.value.failure.partial is None


def test_the_user_s_surroundings_are_kept_out(fake, tmp_path, monkeypatch):
    monkeypatch.setenv("SPICE_SCRIPTS", "/nowhere")
    made = raw(2, [0, 1, 1e-3, 2], ("time", "v(b)"))
    ran(fake, tmp_path, made, 'echo "$HOME $SPICE_SCRIPTS $PWD $* $(cat | wc -c)"')
    out = tmp_path / "out"
    assert (out / "d.log").read_text().split() == [
        str(out),
        str(out),
        "-b",
        "-n",
        "-r",
        "d.raw.part",
        "d.cir",
        "0",
    ]


def test_a_run_may_take_so_long_and_no_longer(fake, tmp_path, monkeypatch):
    monkeypatch.setattr(ngspice, "POLL", 0.01)
    fake("exec sleep 30")
    started = time.monotonic()
    with pytest.raises(SimulationError, match=r"did not finish within 0\.2 s") as caught:
        run_deck(deck(), tmp_path / "out", timeout=0.2)
    assert 0.2 <= time.monotonic() - started < 10
    assert caught.value.got == "time point None s of 0.001 s"


def test_a_full_disk_is_told_as_such(fake, tmp_path, monkeypatch):
    for free, words in ((999_999, "the disk is full"), (1_000_000, "exit code 3")):
        disk = SimpleNamespace(free=free)
        monkeypatch.setattr(ngspice.shutil, "disk_usage", lambda _, disk=disk: disk)
        with pytest.raises(SimulationError, match=words):
            ran(fake, tmp_path, b"", "exit 3")


def test_files_may_have_folders_and_stay_inside(tmp_path):
    ngspice.write_files({"a/b/c.lib": "1", "a/b/d.lib": "2"}, tmp_path / "new" / "out")
    ngspice.write_files({"a/b/c.lib": "3"}, tmp_path / "new" / "out")
    assert (tmp_path / "new/out/a/b/c.lib").read_text() == "3"
    with pytest.raises(UsageError, match="file name"):
        ngspice.write_files({"good.lib": "", "../bad.lib": ""}, tmp_path / "new" / "out")
    assert not (tmp_path / "new/out/good.lib").exists()
