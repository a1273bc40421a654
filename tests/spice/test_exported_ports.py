"""An export keeps every port that the author of a body declares; a run has those that it needs."""

import re
import subprocess

import numpy as np
import pytest
from commands import run_command

NODES = 4
K = 1e4 * (2 * np.eye(NODES) - np.eye(NODES, k=1) - np.eye(NODES, k=-1))  # N/m
PORTS = ("left", "middle", "right")
SCENE = """
name = "pushed"
analysis = { type = "transient", stop = "5 ms" }
[chain]
part = "matrices"
file = "chain.npz"
[push]
part = "source"
kind = "force"
sine = { amplitude = "1 N", frequency = "300 Hz" }
pins = { out = "chain.left" }
"""
FORCE = 2.0  # N


@pytest.fixture
def chain(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    B = np.eye(NODES)[:, : len(PORTS)]
    np.savez(tmp_path / "chain.npz", K=K, M=1e-3 * np.eye(NODES), E=1e-6 * K, B=B)
    tables = [f'[[ports]]\nname = "{p}"\nkind = "mechanical"\ncolumn = {k}\n'
              for k, p in enumerate(PORTS, 1)]  # fmt: skip
    (tmp_path / "chain.toml").write_text("band = [0, 2e3]\n" + "".join(tables))
    (tmp_path / "pushed.toml").write_text(SCENE)

    return lambda *words: " ".join(run_command(*words).split())


def pins(library):
    return re.search(r"(?im)^\.subckt pushed_chain (.*) base", library.read_text())[1].split()


def test_ports_that_nothing_joins_are_in_the_export_and_work(chain, tmp_path):
    chain("export", "pushed.toml", "-o", "out", "-q")
    assert pins(tmp_path / "out" / "pushed_chain.lib") == list(PORTS)
    (tmp_path / "out" / "own.cir").write_text(
        "force on the port that the scene joins nothing to\n.include pushed_chain.lib\n"
        f"Xchain left middle right 0 pushed_chain\nIpush 0 right DC {FORCE}\n"
        ".op\n.print op v(left) v(middle) v(right)\n.end\n"
    )
    done = subprocess.run(
        ["ngspice", "-b", "own.cir"], cwd=tmp_path / "out", capture_output=True, text=True,
        check=True,
    )  # fmt: skip
    # 1 V = 1 um; the reduction's static answers are exact, ngspice prints seven digits
    expected = 1e6 * np.linalg.solve(K, FORCE * np.eye(NODES)[2])[: len(PORTS)]
    row = re.search(r"(?m)^0\s+(\S+)\s+(\S+)\s+(\S+)\s*$", done.stdout)
    assert np.array(row.groups(), dtype=float) == pytest.approx(expected, rel=1e-5)


def test_a_run_omits_unused_ports_and_explain_lists_them(chain, tmp_path):
    chain("run", "pushed.toml", "-o", "out", "-q")
    assert pins(tmp_path / "out" / "pushed_chain.lib") == ["left"]
    said = chain("explain", "pushed.toml")
    assert "chain: ports middle, right" in said
    assert "export includes them" in said


def test_the_exported_deck_runs_as_an_edited_one(chain, tmp_path):
    chain("export", "pushed.toml", "-o", "deck", "-q")
    chain("run", "pushed.toml", "--deck", "deck/pushed.cir", "-o", "out", "-q")
    assert pins(tmp_path / "deck" / "pushed_chain.lib") == list(PORTS)


def test_the_exported_deck_is_verified_with_its_ports(chain, tmp_path):
    path = tmp_path / "pushed.toml"
    ac = 'analysis = { type = "ac", start = 100, stop = 2e3, points = 9 }'
    path.write_text(re.sub("analysis = .*", ac, SCENE).replace("sine", "ac = 1.0\nsine"))
    chain("export", "pushed.toml", "-o", "out", "-q")
    chain("verify", "pushed.toml", "--deck", "out/pushed.cir", "-o", "verified", "-q")
    deck, library = tmp_path / "out" / "pushed.cir", tmp_path / "out" / "pushed_chain.lib"
    deck.write_text(deck.read_text().replace(".include pushed_chain.lib", library.read_text()))
    said = run_command("verify", "pushed.toml", "--deck", str(deck), "-o", "inline", "-q", code=2)
    # the library file beside the deck is not used, because the deck does not include it
    assert "no library with the subcircuit of this part" in said


def test_a_scene_with_only_a_chip_exports_all_rings(tmp_path):
    mesh = "mesh = { sectors = 4, rings = 2, ring_spacing = 3e-4, outer_rings = 2 }"
    path = tmp_path / "alone.toml"
    path.write_text(f'[kick]\nlayers = 3\nelectrical = "open"\n{mesh}\n')
    run_command("export", path, "-o", tmp_path / "out", "-q")
    head = re.findall(r"(?m)^\* @pin \d+ (\S+)", (tmp_path / "out" / "alone_kick.lib").read_text())
    assert head == ["anode", "cathode", "ring0", "ring1", "ring2", "base"]
    assert "3 rings as ports" in run_command("explain", path)
