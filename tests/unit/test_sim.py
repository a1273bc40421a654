"""What is made of a simulator's words, files and failures, with a program in its place."""

import os
import struct

import pytest

from kc2spice.core.errors import MissingToolError
from kc2spice.netlist.deck import Deck
from kc2spice.sim import ngspice
from kc2spice.sim.log import classify
from kc2spice.sim.ngspice import run_deck

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
