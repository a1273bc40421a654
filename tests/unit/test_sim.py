"""What is made of a simulator's words, files and failures, without running one."""

import _ctypes
import ctypes
import os
import struct
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from kc2spice.core.errors import MissingToolError, SimulationError, UsageError
from kc2spice.core.waveforms import Waveforms
from kc2spice.netlist.circuit import Pin, Subcircuit
from kc2spice.netlist.deck import Command, Deck, Option
from kc2spice.scene.judge import Check, Verdict
from kc2spice.scene.parttype import Sampled
from kc2spice.sim import loop, ngspice, shared
from kc2spice.sim.failure import FailedRunError, Failure, belongs_to, diagnose
from kc2spice.sim.log import classify, statistics
from kc2spice.sim.ngspice import run_deck
from kc2spice.sim.rawfile import last_scale_value, read_header, read_partial, read_raw
from kc2spice.sim.retries import RetriesFailedError, run_with_retries
from kc2spice.sim.settings import RETRIES, Settings, next_setting, own_reltol, with_settings

# ----------------------------------------------------------------------------------------- log


@pytest.mark.parametrize(
    "line",
    [
        "doAnalyses: TRAN:  Timestep too small", "Error: no such file", "ERROR in line 3",
        "doAnalyses: iteration limit reached", "run simulation(s) aborted",
        "simulation interrupted", "there aren't any circuits loaded", "no such vector v(q)",
        "Fatal error", "unknown subckt: x",
        "can't find model d1", "unknown parameter (q)", "Undefined parameter [a]",
        "Undefined number [b]", "Cannot find x", "cannot open y", "cannot compute z",
        "Cannot evaluate", "Could not find include file", "not enough memory", "Out of memory",
        "No space left on device", "  syntax error at 3",
    ],
)  # fmt: skip
def test_lines_that_tell_of_a_failure(line):
    report = classify(f"Circuit: x\n{line}\n")
    assert report.errors == (line.strip(),)
    assert report.cause == line.strip()


@pytest.mark.parametrize(
    ("line", "kind"),
    [
        ("Warning: singular matrix: check node a", "struggles"),
        ("Note: Starting gmin stepping", "struggles"),
        ("Starting source stepping", "struggles"), ("Supplies reduced to 0.1 %", "struggles"),
        ("Transient op started", "struggles"), ("Trying gmin = 1e-3", "struggles"),
        ("gmin increment", "struggles"), ("nodeset off", "struggles"),
        ("Warning: v1: no DC value", "warnings"), ("No error here", ""), ("terror of warnings", ""),
        ("Reference value : 1", ""),
    ],
)  # fmt: skip
def test_lines_that_do_not(line, kind):
    report = classify(line)
    found = {name: getattr(report, name) for name in ("errors", "struggles", "warnings")}
    assert [name for name, lines in found.items() if lines] == ([kind] if kind else [])


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


def test_the_cause_is_the_line_that_names_a_node():
    said = "Error: 1\nfatal: 2\ntimestep too small: trouble with node a\nfatal: check node b\n"
    report = classify(said)
    assert report.cause == "timestep too small: trouble with node a"
    assert classify("Error: 1\nfatal: 2\n").cause == "Error: 1"


def test_all_statistics_are_read():
    said = "Total analysis time (seconds) = 1.5e-2\nRejected timepoints = 3\n"
    assert statistics(said) == {"cpu_s": 0.015, "rejected": 3.0}


# ------------------------------------------------------------------------------------ raw files


def raw(points, values, names=("time", "v(a)"), *, flags="real", more=""):
    lines = [
        "Title: t", "Plotname:  Transient Analysis ", f"Flags: {flags}",
        f"No. Variables: {len(names)}",
        f"No. Points: {points}", more + "Variables:",
        *(f"\t{i}\t{n}\tvoltage" for i, n in enumerate(names)), "Binary:", "",
    ]  # fmt: skip
    return "\n".join(lines).encode() + struct.pack(f"<{len(values)}d", *values)


def test_a_header_says_what_follows(tmp_path):
    path = tmp_path / "a.raw"
    path.write_bytes(
        raw(3, [], ("time", "V(A)", "i(B)"), flags="complex", more="Command: a: b\nno colon\n")
    )
    header = read_header(path)
    assert header.plot == "Transient Analysis"
    assert header.names == ("time", "v(a)", "i(b)")
    assert (header.is_complex, header.points, header.record) == (True, 3, 48)
    assert header.offset == path.stat().st_size
    path.write_bytes(raw(3, []))
    assert (read_header(path).is_complex, read_header(path).record) == (False, 16)
    path.write_bytes(b"x" * 100)
    assert read_header(path) is None
    path.write_bytes(b" " * (1 << 20) + raw(1, [0.0, 1.0]))  # no header so far in
    assert read_header(path) is None


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


@pytest.mark.parametrize(
    ("at", "good"), [(None, True), (1, True), (0, False), (2, False), (3, False)]
)
def test_numbers_are_finite_but_for_the_imaginary_part_of_the_scale(at, good, tmp_path):
    values = [1.0, 0.0, 2.0, 3.0]  # two complex numbers
    if at is not None:
        values[at] = np.nan
    path = tmp_path / "a.raw"
    path.write_bytes(raw(1, values, ("frequency", "v(a)"), flags="complex"))
    if good:
        found = read_raw(path)
        assert (found["frequency"][0], found["v(a)"][0]) == (1.0, 2 + 3j)
    else:
        with pytest.raises(SimulationError, match="not finite"):
            read_raw(path)


def test_what_is_no_raw_file_has_no_points(tmp_path):
    path = tmp_path / "a.raw"
    assert read_partial(path) is None
    for content in (b"Title: t\n", b"Title: t\nBinary:\n"):
        path.write_bytes(content)
        assert read_partial(path) is None
    path.write_bytes(b"Title: t\n")
    assert last_scale_value(path) is None
    path.write_bytes(raw(0, [1.0]))
    assert last_scale_value(path) is None
    path.write_bytes(raw(0, [1.0, 2.0]))
    assert last_scale_value(path) == 1.0


def test_a_file_of_one_vector_is_read(tmp_path):
    path = tmp_path / "a.raw"
    path.write_bytes(raw(2, [1.0, 2.0], ("time",)))
    assert read_raw(path)["time"].tolist() == [1.0, 2.0]
    path.write_bytes(raw(1, [], ()))
    with pytest.raises(SimulationError, match="promises 0 vectors"):
        read_raw(path)


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


def test_the_simulator_tells_its_version(fake, tmp_path):
    fake("exit 0")
    found = ngspice.find_ngspice()
    assert (found.name, found.version) == ("ngspice", "99.5")
    assert found.path == str(tmp_path / "ngspice")


def test_a_version_counts_whatever_the_exit_code(fake, tmp_path):
    fake("")
    script(tmp_path / "ngspice", 'echo "** ngspice-7+ : Circuit"; exit 1')
    assert ngspice.find_ngspice().version == "7+"


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


def test_results_are_in_si_over_their_scale(fake, tmp_path):
    vectors = {"b": ("v(a)-i(l1)", 1e-6), "s": ("@q[i]", 2.0)}
    names = ("time", "v(a)", "i(l1)", "i(@q[i])")
    values = [0, 5, 2, 1, 1e-3, 7, 1, 4]
    waves = ran(
        fake,
        tmp_path,
        raw(2, values, names),
        vectors=vectors,
        options=(Option("reltol", "1e-4", ""),),
    )
    np.testing.assert_allclose(waves["time"], [0, 1e-3])
    np.testing.assert_allclose(waves["b"], [3e-6, 6e-6])
    np.testing.assert_allclose(waves["s"], [2.0, 8.0])
    assert waves.stats["reltol"] == 1e-4
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["d.cir", "d.log", "d.raw"]
    for scale, name in (("frequency", "frequency"), ("v(sweep)", "sweep")):
        made = raw(1, [3.0, 1.0], (scale, "v(b)"))
        assert ran(fake, tmp_path, made, stop=None)[name].tolist() == [3.0]


@pytest.mark.parametrize(
    ("last", "good"), [(1e-3, True), (1e-3 * (1 - 5e-10), True), (1e-3 * (1 + 5e-10), True),
                       (1e-3 * (1 - 2e-9), False), (1e-3 * (1 + 2e-9), False)],
)  # fmt: skip
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


def test_progress_is_the_share_that_is_done(fake, tmp_path, monkeypatch):
    monkeypatch.setattr(ngspice, "POLL", 0.01)
    (tmp_path / "part").write_bytes(raw(0, [0, 1, 2.5e-4, 2], ("time", "v(b)")))
    (tmp_path / "made").write_bytes(raw(2, [0, 1, 1e-3, 2], ("time", "v(b)")))
    fake(RAW + f'sleep 0.1; cat {tmp_path}/part > "$raw"; sleep 0.3; cat {tmp_path}/made > "$raw"')
    shares = []
    run_deck(deck(), tmp_path / "out", shares.append)
    assert set(shares) <= {0.0, 0.25, 1.0}
    assert {0.0, 0.25} <= set(shares)


def test_a_run_may_take_so_long_and_no_longer(fake, tmp_path, monkeypatch):
    monkeypatch.setattr(ngspice, "POLL", 0.01)
    fake("exec sleep 30")
    started = time.monotonic()
    with pytest.raises(SimulationError, match=r"did not finish within 0\.2 s") as caught:
        run_deck(deck(), tmp_path / "out", timeout=0.2)
    assert 0.2 <= time.monotonic() - started < 10
    assert caught.value.got == "time point None s of 0.001 s"


def test_a_simulator_that_does_nothing_hangs(fake, tmp_path, monkeypatch):
    monkeypatch.setattr(ngspice, "POLL", 0.01)
    monkeypatch.setattr(ngspice, "STALLED", 0.3)
    fake("exec sleep 30")
    started = time.monotonic()
    with pytest.raises(SimulationError, match="hangs"):
        run_deck(deck(), tmp_path / "out")
    assert 0.3 <= time.monotonic() - started < 10
    now = time.monotonic()
    assert (
        ngspice._still_alive(0, (now - 99, 5), tmp_path)[0] >= now
    )  # no such process: nothing to say


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


# ------------------------------------------------------------------------------------- failures

INNER = "* An inner part\n.subckt inner a b\nR1 a fring0 1\nB2 fring1 0 V=1\n.ends\n"
PINS = (Pin("ring0", "um", "N"), Pin("g0", "1", "-"))
NESTED = Deck(
    name="d",
    text="* d\n.include inner.lib\nV1 q 0 1\nR9 q 0 1\nX1 q 0 inner\nX2 r 0 absent\n.end\n",
    parts=(Subcircuit("INNER", PINS, (), INNER, "inner.lib"),),
)


@pytest.mark.parametrize(
    ("node", "words"),
    [
        ("q", "node of v1, r9, x1 (inner) pin a"),
        ("r", "node of x2"),
        ("V1#branch", "v1 in d.cir"),
        ("x1.fring0", "part x1 (An inner part) at its pin ring0 (1 V = 1 um, 1 A = 1 N)"),
        ("r.x1.r1", "part x1 (An inner part), inside at r1"),
        ("x1.ring0", "part x1 (An inner part) at its pin ring0 (1 V = 1 um, 1 A = 1 N)"),
        ("x1.bg0", "part x1 (An inner part) at its pin g0 (1 V = 1 1)"),
        ("x2.a", None),
        ("x3.a", None),
        ("xx.x1.a", None),
        ("nothing", None),
    ],
)
def test_a_node_belongs_to_what_is_wired_to_it(node, words):
    assert belongs_to(NESTED, node) == words


def test_a_deck_that_cannot_be_read_has_no_parts():
    assert belongs_to(Deck(name="d", text=".include nowhere.lib\n.end\n"), "q") is None


def test_a_log_without_a_cause_has_what_the_engine_says():
    found = diagnose(NESTED, classify("nothing"), "exit code 1", None)
    assert found == Failure("exit code 1", None)
    told = diagnose(NESTED, classify("fatal: trouble with node q"), "exit code 1", None)
    assert (told.cause, told.node) == ("fatal: trouble with node q", "q")
    assert told.part.startswith("node of v1")


# -------------------------------------------------------------------------------------- retries

WAVES = Waveforms({"time": np.arange(7.0)}, {})


def failing(*outcomes):
    """An engine: each run fails as told (a kind and a time), or returns its waves."""
    ahead, decks = list(outcomes), []

    def run(tried):
        decks.append(tried)
        told = ahead.pop(0)
        if isinstance(told, Waveforms):
            return told
        error = FailedRunError("it failed", hint="a hint")
        error.failure = Failure(f"cause {len(decks)}", told[0], "n", told[1], "part p")
        raise error

    return run, decks


PLAIN = Deck(name="d", options=(Option("reltol", "1e-4", ""), Option("chgtol", "1e-10", "")),
             command=Command("tran", ("1e-06", "0.001", "0", "1e-05")))  # fmt: skip


@pytest.mark.filterwarnings("ignore:.*trying")
def test_each_cause_picks_its_setting_and_earlier_ones_stay(tmp_path):
    run, decks = failing(("timestep", 1.0), ("timestep", 3.0), ("timestep", 2.0), WAVES)
    (tmp_path / "d.log").write_text("first")
    done = run_with_retries(PLAIN, tmp_path, retries=3, engine=run)
    assert [a.setting for a in done.attempts] == [
        "the scene's own settings", "firmer pivots", "gear", "tighter tolerances",
    ]  # fmt: skip
    assert [a.cause for a in done.attempts] == ["cause 1", "cause 2", "cause 3", None]
    assert [a.time for a in done.attempts] == [1.0, 3.0, 2.0, None]
    assert [a.points for a in done.attempts] == [None, None, None, 7]
    assert {(a.node, a.part) for a in done.attempts[:3]} == {("n", "part p")}
    assert done.attempts[0].settings == "unchanged"
    last = "pivrel=0.1, method=gear, reltol, chgtol and largest step times 0.1"
    assert done.attempts[3].settings == last
    assert decks[0] is PLAIN
    assert done.deck is decks[3]
    options = [{o.key: o.value for o in each.options} for each in decks]
    assert options[2] == {"reltol": "1e-4", "chgtol": "1e-10", "pivrel": "0.1", "method": "gear"}
    assert float(options[3]["reltol"]) == pytest.approx(1e-5)
    assert float(options[3]["chgtol"]) == pytest.approx(1e-11)
    assert float(decks[3].command.words[3]) == pytest.approx(1e-6)
    assert decks[2].command.words[3] == "1e-05"
    assert (tmp_path / "d.1.log").read_text() == "first"
    assert done.attempts[3].record()["setting"] == "tighter tolerances"
    assert all(0 <= a.wall_s < 10 for a in done.attempts)


@pytest.mark.filterwarnings("ignore:.*trying")
@pytest.mark.parametrize("most", [0, 1, 2])
def test_no_more_retries_than_asked_for(most, tmp_path):
    run, decks = failing(*[("timestep", t) for t in (1.0, 3.0, 2.0)])
    with pytest.raises(RetriesFailedError) as caught:
        run_with_retries(PLAIN, tmp_path, retries=most, engine=run)
    assert len(decks) == len(caught.value.attempts) == most + 1
    left = ("firmer pivots", "gear", "tighter tolerances")[most]
    hint = caught.value.hint
    assert f"a larger solver.retries goes on with {left}" in hint
    assert "try a larger kick.damping.ratio" in hint
    assert hint.endswith("; a hint")
    assert ("tried in vain" in hint) is (most > 0)
    if most:
        assert hint.startswith("tried in vain: firmer pivots (pivrel=0.1)")
    assert caught.value.failure.time == (1.0 if most == 0 else 3.0)  # the farthest
    assert caught.value.mends == {}


def test_what_no_setting_cures_is_tried_once(tmp_path):
    run, decks = failing((None, 1.0))
    with pytest.raises(RetriesFailedError) as caught:
        run_with_retries(PLAIN, tmp_path, retries=9, engine=run)
    assert (len(decks), caught.value.hint) == (1, "a hint")


def check(name, value, **more):
    return Check(name, value, 1.0, "J", "advice", **more)


@pytest.mark.filterwarnings("ignore:.*trying")
def test_violated_balances_are_runs_of_too_coarse_steps(tmp_path):
    run, decks = failing(WAVES, WAVES, WAVES)
    ahead = [2.5, 1.5, 0.5]

    def judge(waves):
        assert waves is WAVES
        warned = check("told", 9.0, action="warn")
        return Verdict((check("good", 0.1), warned, check("energy", ahead.pop(0), coarse=True)))

    done = run_with_retries(PLAIN, tmp_path, retries=3, engine=run, judge=judge)
    assert [a.cause for a in done.attempts] == ["energy: 2.5 J", "energy: 1.5 J", None]
    assert [a.points for a in done.attempts] == [7, 7, 7]
    assert [float(d.option("reltol")) for d in decks] == pytest.approx([1e-4, 1e-5, 1e-6])
    assert [each.name for each in done.verdict.checks] == ["good", "told", "energy"]


def test_one_check_that_no_tolerance_cures_ends_it(tmp_path):
    checks = (
        check("energy", 2.0, coarse=True, mend=("a.b", 1)),
        check("left", 2.0, mend=("c.d", 2)),
    )
    for each, count in ((checks, 1), (checks[1:], 1)):
        run, decks = failing(WAVES)
        with pytest.raises(RetriesFailedError) as caught:
            run_with_retries(
                PLAIN, tmp_path, retries=3, engine=run, judge=lambda _, e=each: Verdict(e)
            )
        assert len(decks) == count
        assert caught.value.mends == dict(c.mend for c in each)
        assert caught.value.failure is None
    some = (checks[1], check("other", 3.0))
    run, _ = failing(WAVES)
    with pytest.raises(RetriesFailedError) as caught:
        run_with_retries(PLAIN, tmp_path, retries=3, engine=run, judge=lambda _: Verdict(some))
    assert caught.value.mends == {}
    assert caught.value.attempts[0].cause == "left: 2 J"  # the first of two


def test_a_retry_is_announced(tmp_path):
    run, _ = failing(("singular", None), Waveforms({"frequency": np.ones(2)}, {}))
    with pytest.warns(UserWarning, match="own settings: cause 1; trying firmer pivots: the pivots"):
        done = run_with_retries(PLAIN, tmp_path, retries=1, engine=run)
    assert done.attempts[-1].points is None
    assert done.verdict == Verdict()


def test_settings_without_words_of_the_deck_begin_at_ngspices_own():
    bare = Deck(name="d", command=Command("tran", ("1e-06", "0.001")))
    changed = with_settings(bare, RETRIES[2], Settings(factor=0.5))
    assert own_reltol(bare) == 1e-3
    assert (float(changed.option("reltol")), float(changed.option("chgtol"))) == (5e-4, 5e-15)
    assert changed.command == bare.command
    reason = "retry with tighter tolerances: the steps are too coarse for the contact"
    assert {o.reason for o in changed.options} == {reason}
    assert with_settings(bare, RETRIES[0], Settings((("pivrel", "0.1"),))).option("reltol") is None
    both = Settings((("a", "1"), ("b", "2")), 0.5).plus(Settings((("b", "3"),), 0.1))
    assert both == Settings((("a", "1"), ("b", "3")), 0.05)
    assert str(both) == "a=1, b=3, reltol, chgtol and largest step times 0.05"


@pytest.mark.parametrize(
    ("cause", "names"),
    [
        ("timestep", ["firmer pivots", "gear", "tighter tolerances"]),
        ("singular", ["firmer pivots"]),
        ("coarse", ["tighter tolerances", "much tighter tolerances"]), ("operating point", []),
        (None, []),
    ],
)  # fmt: skip
def test_settings_for_each_cause(cause, names):
    tried = []
    while found := next_setting(cause, tuple(tried)):
        tried.append(found.name)
    assert tried == names


# ------------------------------------------------------------------------- functions in the loop


def test_functions_are_asked_at_their_instants_and_held_after_the_delay():
    seen = []
    quick = Sampled("vq", 1.0, 0.25, lambda time, values: seen.append((time, values)) or 10 + time)
    slow = Sampled("vs", 2.0, 0.0, lambda time, values: -time)
    sampler = loop._Sampler([quick, slow], 4.0, None)
    assert sampler.source(0.0, "vq") == 0.0
    for at in (0.0, 0.5, 1 - 1e-13, 1.5, 3.2):
        sampler.point(at, lambda at=at: {"v": at})
    assert seen == [(0.0, {"v": 0.0}), (1.0, {"v": 1 - 1e-13}), (2.0, {"v": 3.2})]
    assert sampler.source(2.25, "vq") == 0.0  # the step that ends at the instant
    assert sampler.source(2.26, "vq") == 12.0
    assert sampler.source(2.0, "vq") == 12.0
    assert sampler.source(2.1, "vs") == -2.0
    assert sampler.source(9.0, "other") == 0.0


@pytest.mark.parametrize(
    ("time", "step"), [(0.0, 0.25), (0.25, 0.45), (0.2, 0.05), (0.8, 0.15), (1.8, 0.2), (2.8, 0.25)]
)
def test_a_step_ends_at_the_next_instant(time, step):
    one = Sampled("vq", 0.7, 0.25, lambda *_: 0.0)
    other = Sampled("vs", 2.0, 0.0, lambda *_: 0.0)
    assert loop._Sampler([one, other], 4.0, None).limit(time, 9.0) == pytest.approx(step)


def test_without_functions_steps_are_the_simulators():
    assert loop._Sampler([], 4.0, None).limit(1.0, 9.0) == 9.0


def test_progress_is_told_in_thousandths_up_to_the_end():
    shares = []
    sampler = loop._Sampler([], 2.0, shares.append)
    for at in (0.0, 0.001, 0.0021, 0.0039, 0.1, 1.9999999999, 2.0, 2.1):
        sampler.point(at, dict)
    assert shares == pytest.approx([0.00105, 0.05, 1.0, 1.0, 1.0])


def test_includes_stand_in_their_places():
    files = {"a.lib": "A\n.INC 'b.lib'\nC\n", "b.lib": "B\n"}
    text = '* main\n.include "a.lib"\n.includes x\nD\n'
    whole = loop.flattened(Deck(name="d", text=text, more=files))
    assert whole.splitlines() == ["* main", "A", "B", "C", ".includes x", "D"]


class Said:
    """A library that has run, with its results."""

    dead, broken, said = False, None, "one\ntwo\nthree\nfour\n"

    def __init__(self, found, loads=True):
        self.found, self.loads, self.cleared, self.asked = found, loads, 0, None

    def load(self, text):
        return self.loads

    def run(self, *callbacks):
        self.asked = callbacks
        if callbacks[0] is not None:
            callbacks[0](0.25e-3, dict)
        return True

    def vectors(self):
        return self.found

    def clear(self):
        self.cleared += 1


def test_results_of_the_library_are_in_si(monkeypatch):
    found = {
        "time": np.array([0.0, 1e-3]),
        "a": np.array([5.0, 7.0]),
        "v1#branch": np.array([2.0, 1.0]),
    }
    library = Said(found)
    monkeypatch.setattr(loop, "_library", library)
    waves = loop.run_shared(deck(vectors={"b": ("v(a)-i(v1)", 1e-6)}))
    np.testing.assert_allclose(waves["b"], [3e-6, 6e-6])
    assert waves.stats == {"accepted": 2.0}
    assert (library.cleared, library.asked) == (1, (None, None, None))
    shares = []
    loop.run_shared(deck(vectors={}), progress=shares.append)
    assert shares == [0.25]
    assert [each is not None for each in library.asked] == [True, False, False]
    loop.run_shared(deck(vectors={}), [Sampled("v", 1.0, 0.0, lambda *_: 0.0)])
    assert all(library.asked)


@pytest.mark.parametrize("last", [1e-3 * (1 - 5e-10), 1e-3 * (1 + 5e-10)])
def test_a_library_may_stop_within_rounding(last, monkeypatch):
    monkeypatch.setattr(loop, "_library", Said({"time": np.array([0.0, last])}))
    assert loop.run_shared(deck(vectors={}))["time"][-1] == last


@pytest.mark.parametrize("last", [1e-3 * (1 - 2e-9), 1e-3 * (1 + 2e-9)])
def test_a_library_that_stops_elsewhere_has_failed(last, monkeypatch):
    monkeypatch.setattr(loop, "_library", Said({"time": np.array([0.0, last])}))
    with pytest.raises(SimulationError, match="before the end") as caught:
        loop.run_shared(deck())
    assert (caught.value.got, caught.value.expected) == ("last time point 0.001 s", "0.001 s")


def test_a_library_runs_transients_alone(monkeypatch):
    monkeypatch.setattr(loop, "_library", library := Said({}))
    with pytest.raises(UsageError, match="no transient") as caught:
        loop.run_shared(deck(stop=None))
    assert caught.value.where == "d"
    assert library.asked is None


def test_a_library_that_gave_nothing_or_an_error_has_failed(monkeypatch):
    monkeypatch.setattr(loop, "_library", library := Said({}, loads=False))
    with pytest.raises(SimulationError) as caught:
        loop.run_shared(deck())
    assert caught.value.got == "two | three | four | "
    assert library.cleared == 1
    bad = Said({"time": np.array([0.0, 1e-3])})
    bad.said = "Error: bad\n"
    monkeypatch.setattr(loop, "_library", bad)
    with pytest.raises(SimulationError, match="Error: bad"):
        loop.run_shared(deck())
    dead = Said({})
    dead.dead = True
    monkeypatch.setattr(loop, "_library", dead)
    monkeypatch.setattr(loop, "Library", lambda: "anew")
    assert loop._fresh() == "anew"


# ----------------------------------------------------------------------- what the library calls


@pytest.fixture
def called():
    """The callbacks of a library that is not there."""
    library = object.__new__(shared.Library)
    library._lines, library.dead = [], False
    library._forget()
    return library


def test_words_of_both_streams_are_kept_in_order(called):
    for line in (b"stdout one", b"stderr two", b"three stdout", b"\xff"):
        assert called._on_text(line, 0, None) == 0
    assert called.said == "one\ntwo\nthree stdout\n\ufffd\n"
    assert called._on_exit(0, False, False, 0, None) == 0
    assert called.dead
    assert not called.command("echo")


def test_a_source_gets_its_volts_by_its_name_in_lower_case(called):
    value = (ctypes.c_double * 1)(7.0)
    assert called._on_source(value, 1.5, b"VExt", 0, None) == 0
    assert value[0] == 7.0
    called._source = lambda time, name: {"vext": 2 * time}[name]
    called._on_source(value, 1.5, b"VExt", 0, None)
    assert value[0] == 3.0
    called._on_source(value, 1.5, b"other", 0, None)
    assert isinstance(called.broken, KeyError)
    called._on_source(value, 9.0, b"vext", 0, None)  # after a failure nothing is asked
    assert value[0] == 3.0


def test_a_step_is_never_longer_than_the_limit(called):
    step = (ctypes.c_double * 1)(4.0)

    def on_step(time):
        assert called._on_step(time, step, 0.0, 0, 0, 0, None) == 0
        return step[0]

    assert on_step(0.0) == 4.0
    called._limit = lambda time, step: time
    assert [on_step(5.0), on_step(3.0), on_step(3.5)] == [4.0, 3.0, 3.0]
    called._limit = lambda time, step: {}[time]
    assert on_step(1.0) == 3.0
    assert isinstance(called.broken, KeyError)
    called._limit = lambda time, step: 1.0
    assert on_step(1.0) == 3.0


def test_a_point_has_its_time_and_its_values(called):
    def entry(name, value, is_scale=False):
        return SimpleNamespace(contents=SimpleNamespace(name=name, real=value, is_scale=is_scale))

    vectors = [entry(b"V(A)", 2.0), entry(b"time", 0.5, True), entry(b"beyond", 9.0)]
    data = SimpleNamespace(contents=SimpleNamespace(vectors=vectors, count=2))
    assert called._on_point(data, 2, 0, None) == 0
    seen = []
    called._sampler = lambda time, values: seen.append((time, values()))
    assert called._on_point(data, 2, 0, None) == 0
    data.contents.vectors = vectors[:1] + vectors[2:]
    called._on_point(data, 2, 0, None)
    assert seen == [(0.5, {"v(a)": 2.0, "time": 0.5}), (0.0, {"v(a)": 2.0, "beyond": 9.0})]
    called._sampler = lambda time, values: 1 / 0
    called._on_point(data, 2, 0, None)
    assert isinstance(called.broken, ZeroDivisionError)
    called._sampler = lambda time, values: seen.append("more")
    called._on_point(data, 2, 0, None)
    assert len(seen) == 2


def test_real_and_complex_vectors_are_copied():
    real = (ctypes.c_double * 3)(1.0, 2.0, 3.0)
    vector = shared._Vector(real=ctypes.cast(real, ctypes.POINTER(ctypes.c_double)), length=2)
    found = shared._copied(vector)
    real[0] = 9.0
    assert found.tolist() == [1.0, 2.0]
    both = (shared._Complex * 2)((1.0, -2.0), (3.0, 4.0))
    vector = shared._Vector(complex=ctypes.cast(both, ctypes.POINTER(shared._Complex)), length=2)
    assert shared._copied(vector).tolist() == [1 - 2j, 3 + 4j]


def test_start_up_files_and_surroundings_of_the_user_come_back(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("SPICE_SCRIPTS", "mine")
    monkeypatch.delenv("SPICE_USERINIT_DIR", raising=False)
    asked = []
    library = SimpleNamespace(ngSpice_nospiceinit=lambda: asked.append("no files"))
    with shared._no_start_up_files(library):
        folder = os.getcwd()
        names = ("HOME", "SPICE_SCRIPTS", "SPICE_USERINIT_DIR")
        assert {os.environ[name] for name in names} == {folder}
        assert sorted(os.listdir(folder)) == [".spiceinit", "spinit"]
    assert asked == ["no files"]
    assert os.getcwd() == str(tmp_path)
    assert os.environ["SPICE_SCRIPTS"] == "mine"
    assert "SPICE_USERINIT_DIR" not in os.environ
    assert not os.path.exists(folder)


@pytest.mark.parametrize("placed", [True, False])
def test_the_library_is_a_copy_unless_its_file_is_unknown(placed, monkeypatch):
    """Of any library of Python's own."""
    path = Path(_ctypes.__file__)
    monkeypatch.setattr(shared.ctypes.util, "find_library", lambda _: str(path))
    monkeypatch.setattr(shared, "_file_of", lambda _: path if placed else None)
    found = Path(shared._private_copy()._name)
    assert (found == path) is not placed
    assert found.name == path.name
    assert found.parent.exists() is not placed  # mapped: the copy may go


def test_a_library_that_cannot_be_loaded_is_named(monkeypatch, tmp_path):
    (tmp_path / "libngspice.so").write_bytes(b"no library")
    name = str(tmp_path / "libngspice.so")
    monkeypatch.setattr(shared.ctypes.util, "find_library", lambda _: name)
    with pytest.raises(MissingToolError, match="cannot be loaded") as caught:
        shared.Library()
    assert caught.value.where == name
