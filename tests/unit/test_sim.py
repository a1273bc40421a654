"""Interpretation of a simulator's output, files and failures, with a program in its place."""

import os

import pytest
from support import Deck, MissingToolError, SimulationError, find_failure, ngspice

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
    report = find_failure(text.replace("\n", "\r\n"))
    assert (report.node, report.time, report.kind) == (node, at, kind)


# --------------------------------------------------------------------------------------- engine


@pytest.fixture
def fake(tmp_path, monkeypatch):
    """A program in place of ngspice, which does as told."""

    def install(text):
        path = tmp_path / "ngspice"
        path.write_text(f"#!/bin/sh\n{text}\n")
        path.chmod(0o755)
        monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
        ngspice.find_ngspice.cache_clear()

    yield install
    ngspice.find_ngspice.cache_clear()


@pytest.mark.parametrize(
    ("text", "words", "got"),
    [("echo hello", "does not print its version", "hello"),
     ("exec sleep 30", "does not start", "no answer")],
)  # fmt: skip
def test_a_program_that_is_no_ngspice_is_refused(text, words, got, fake, monkeypatch):
    fake(text)
    monkeypatch.setattr(ngspice, "VERSION_TIMEOUT", 0.2)
    with pytest.raises(MissingToolError, match=words) as caught:
        ngspice.find_ngspice()
    assert got in caught.value.got


def test_a_simulator_that_does_nothing_is_ended(fake, tmp_path, monkeypatch):
    fake('case "$*" in *--version*) echo "** ngspice-99.5";; *) exec sleep 30;; esac')
    monkeypatch.setattr(ngspice, "STALL_TIME", 0.2)
    with pytest.raises(SimulationError, match="hangs"):
        ngspice.run_deck(Deck(name="d", text="* d\n.end\n"), tmp_path / "out")
