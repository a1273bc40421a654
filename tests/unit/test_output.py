"""Staged output: all files at the end, or the directory as it was."""

import json
import os
import signal
import threading
from pathlib import Path

import numpy as np
import pytest
from small_scenes import LAMP
from support import UsageError, export_rom, export_scene, load_scene, reduce_file, stage_directory

import kc2spice as kc


def write(work, **files):
    for name, text in files.items():
        (work / f"{name}.json").write_text(text)


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def fail(error, out, **files):
    """Write some files, then break off."""

    def attempt():
        with stage_directory(out) as work:
            write(work, **files)
            raise error

    with pytest.raises(error):
        attempt()


def test_files_appear_at_the_end(tmp_path):
    out = tmp_path / "deep" / "out"
    with stage_directory(out) as work:
        write(work, result="1", other="2")
        (work / "plots").mkdir()
        (work / "plots" / "a.png").write_text("png")
        assert not out.exists()
    assert names(out) == ["other.json", "plots", "result.json"]
    assert (out / "plots" / "a.png").read_text() == "png"
    assert names(tmp_path) == ["deep"]


def test_a_failure_leaves_nothing(tmp_path):
    fail(ZeroDivisionError, tmp_path / "deep" / "out", result="1")
    assert names(tmp_path) == []


def test_a_failure_spares_earlier_results(tmp_path):
    out = tmp_path / "out"
    with stage_directory(out) as work:
        write(work, result="old")
    fail(KeyboardInterrupt, out, result="new", more="x")
    assert names(out) == ["result.json"]
    assert (out / "result.json").read_text() == "old"
    assert names(tmp_path) == ["out"]


def test_a_second_run_replaces_and_keeps_foreign_files(tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "notes.txt").write_text("mine")
    for text in ("1", "2"):
        with stage_directory(out) as work:
            write(work, result=text)
    assert (out / "result.json").read_text() == "2"
    assert (out / "notes.txt").read_text() == "mine"


def test_concurrent_runs_do_not_mix(tmp_path):
    """Whoever finishes last owns all files: no mixture of two runs ever stays."""
    out, failures = tmp_path / "out", []
    files = [f"f{number}" for number in range(20)]

    def run(label):
        try:
            for _ in range(10):
                with stage_directory(out) as work:
                    write(work, **dict.fromkeys([*files, "result"], label))
        except Exception as error:
            failures.append(error)

    threads = [threading.Thread(target=run, args=(label,)) for label in "abc"]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not failures
    assert len({path.read_text() for path in out.iterdir()}) == 1


FILES = ("a.lib", "b.lib", "bench.cir", "waves.npz", "result.json")


def in_a_child(work):
    """Exit status of a forked process that does ``work``, negative for a signal."""
    child = os.fork()
    if child == 0:
        try:
            work()
        finally:
            os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def publish(out, label):
    with stage_directory(out) as work:
        for name in FILES:
            (work / name).write_text(label)


@pytest.mark.filterwarnings("ignore:replaced .* which was edited or has an unknown origin")
@pytest.mark.parametrize("kill_at", range(len(FILES) + 3))  # three netlists become copies first
def test_a_kill_between_two_renames_never_leaves_a_mixture(kill_at, tmp_path, monkeypatch):
    """The record and the deck go first and come last, so what they stand for is whole."""
    out = tmp_path / "out"
    publish(out, "old")

    def die():
        moved, replace = [], os.replace

        def counted(source, target):
            if len(moved) == kill_at:
                os.kill(os.getpid(), signal.SIGKILL)
            moved.append(target)
            replace(source, target)

        monkeypatch.setattr(os, "replace", counted)
        publish(out, "new")

    assert in_a_child(die) == -signal.SIGKILL
    found = {path.name: path.read_text() for path in out.iterdir()}
    assert "result.json" not in found
    if "bench.cir" in found:
        # before the first rename, all files are those of the earlier run
        assert {found[name] for name in FILES[:-1]} == {"new" if kill_at else "old"}
    publish(out, "third")
    assert {path.read_text() for path in out.iterdir() if ".bak" not in path.name} == {"third"}


def test_only_work_directories_of_ended_runs_are_deleted(tmp_path):
    out = tmp_path / "out"

    def die():
        with stage_directory(out):
            os.kill(os.getpid(), signal.SIGKILL)

    assert in_a_child(die) == -signal.SIGKILL
    (dead,) = tmp_path.rglob(".kc2spice.out.*.part")
    os.utime(dead, (0, 0))
    with stage_directory(out) as living:
        os.utime(living, (0, 0))
        assert not dead.exists()
        publish(out, "x")
        assert living.exists()


def test_directories_of_the_user_are_not_deleted(tmp_path):
    """Hidden directories of the user, also under a name that is a pattern."""
    theirs = tmp_path / ".mine.part"
    theirs.mkdir()
    os.utime(theirs, (0, 0))
    with stage_directory(tmp_path / "*") as work:
        write(work, result="1")
    assert names(tmp_path) == ["*", ".mine.part"]


def record(work, *files):
    (work / "result.json").write_text(json.dumps({"scene": "s", "files": files}))
    for name in files:
        (work / name).touch()


def test_a_manipulated_record_deletes_no_other_files(tmp_path):
    out, precious = tmp_path / "out", tmp_path / "precious"
    precious.touch()
    out.mkdir()
    (out / ".hidden").touch()
    (out / "link").symlink_to(precious)
    files = ["../precious", str(precious), ".hidden", "link", 7, None]
    (out / "result.json").write_text(json.dumps({"scene": "s", "files": files}))
    with stage_directory(out) as work:
        record(work, "a.cir")
    assert precious.exists()
    assert names(out) == [".hidden", "a.cir", "link", "result.json"]


def test_a_later_run_deletes_only_unchanged_files_of_the_earlier_one(tmp_path):
    """Neither files that somebody else's record lists nor files that the user edited."""
    with stage_directory(tmp_path) as work:
        record(work, "old.lib", "edited.lib")
    (tmp_path / "edited.lib").write_text("* my own values\n")
    with stage_directory(tmp_path) as work:
        record(work, "new.lib")
    assert names(tmp_path) == ["edited.lib", "new.lib", "result.json"]


def test_files_that_a_foreign_record_lists_stay(tmp_path):
    (tmp_path / "thesis.txt").write_text("four years of work")
    (tmp_path / "result.json").write_text(json.dumps({"scene": "s", "files": ["thesis.txt"]}))
    with stage_directory(tmp_path) as work:
        record(work, "a.cir")
    assert (tmp_path / "thesis.txt").read_text() == "four years of work"


def test_an_export_does_not_overwrite_files_of_another_deck(tmp_path):
    """An export overwrites its earlier deck, but no library of another scene's deck."""

    def exported(name, radius):
        scene = load_scene({"name": name, "sphere": {"radius": radius}, "solver": {"stop": 1e-3}})
        return export_scene(scene, tmp_path, "ngspice")

    exported("fall", 1e-3)
    exported("drop", 1e-3)  # the same design: both decks run
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    with pytest.raises(UsageError, match=r"includes another version of sphere\.lib"):
        exported("fall", 2e-3)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before
    (tmp_path / "drop.cir").unlink()
    exported("fall", 2e-3)


def test_runs_saved_results_and_reduced_models_protect_other_decks(tmp_path):
    fall = {"name": "fall", "sphere": {"radius": 1e-3}, "solver": {"stop": 1e-3}}
    own = tmp_path / "own.cir"
    own.write_text("mine\n.inc 'sphere.lib'\n.include lump.lib\n.end\n")
    (tmp_path / "gone.cir").mkdir()  # no deck
    kc.run(fall, tmp_path)  # nothing of that name was there
    np.savez(tmp_path / "m.npz", K=np.eye(2), M=np.diag([1.0, 2.0]), B=np.eye(2))
    rom = Path(reduce_file(tmp_path / "m.npz", tmp_path / "rom", order=2, band=(0.0, 1.0))["rom"])
    lump = rom.rename(rom.with_name("lump.npz"))
    (tmp_path / "lump.lib").write_text("* another\nR1 a 0 1\n")
    other = kc.run(fall | {"name": "drop", "sphere": {"radius": 2e-3}})
    before = {path.name: path.read_bytes() for path in tmp_path.glob("*.*") if path.is_file()}
    for write, library in (
        (lambda: kc.run(fall, tmp_path, overrides={"sphere.radius": 2e-3}), "sphere"),
        (lambda: other.save(tmp_path), "sphere"),
        (lambda: export_rom(lump, tmp_path), "lump"),
    ):
        with pytest.raises(UsageError, match=rf"includes another version of {library}\.lib") as e:
            write()
        assert str(own) in str(e.value)
    assert {p.name: p.read_bytes() for p in tmp_path.glob("*.*") if p.is_file()} == before
    own.unlink()
    kc.run(fall, tmp_path, overrides={"sphere.radius": 2e-3})
    other.save(tmp_path)  # in place of the deck of the run before
    assert not (tmp_path / "fall.cir").exists()


def add_line(path, line="* mine\n"):
    path.write_text(path.read_text() + line)
    return path.read_text()


@pytest.mark.parametrize("write", [kc.export, kc.run])
def test_an_edited_deck_is_kept_as_a_copy(tmp_path, write):
    out, deck = tmp_path / "out", tmp_path / "out" / "lamp.cir"
    write(LAMP, out)
    written = deck.read_text()
    write({**LAMP, "drive": {"part": "source", "dc": "6 V"}}, out)  # an unedited deck has no copy
    write(LAMP, out)
    assert not list(out.glob("*.bak*"))
    texts = [add_line(deck)]
    with pytest.warns(UserWarning, match=r"replaced .*out/lamp\.cir, which was edited.*cir\.bak$"):
        write(LAMP, out)
    assert deck.read_text() == written
    texts.append(add_line(deck, "* second\n"))
    with pytest.warns(UserWarning, match=r"lamp\.cir\.bak2$"):
        write(LAMP, out)
    write(LAMP, out)
    assert sorted(path.name for path in out.glob("*.bak*")) == ["lamp.cir.bak", "lamp.cir.bak2"]
    assert [(out / name).read_text() for name in ("lamp.cir.bak", "lamp.cir.bak2")] == texts
    metrics = kc.run(LAMP, deck=out / "lamp.cir.bak").metrics
    assert metrics["current_a"] == pytest.approx(2.0)


def test_a_netlist_of_unknown_origin_is_kept_as_a_copy(tmp_path):
    deck = tmp_path / "lamp.cir"
    deck.write_text("* drawn by another program\n")
    with pytest.warns(UserWarning, match="unknown origin"):
        kc.export(LAMP, tmp_path)
    assert (tmp_path / "lamp.cir.bak").read_text() == "* drawn by another program\n"


def test_runs_and_exports_into_one_directory_make_no_copies(tmp_path):
    for write in (kc.export, kc.run, kc.export, kc.run):
        for volts in ("12 V", "6 V"):
            write({**LAMP, "drive": {"part": "source", "dc": volts}}, tmp_path)
    kc.export(LAMP, tmp_path, dialect="ltspice")
    kc.export(LAMP, tmp_path)
    kc.run(LAMP, tmp_path, deck=tmp_path / "lamp.cir")
    assert not list(tmp_path.glob("*.bak*"))


@pytest.mark.parametrize("record", ["", "[]", '{"sha256": 3}', '{"sha256": {"lamp.cir": [1]}}'])
def test_a_damaged_record_of_hashes_counts_as_none(tmp_path, record):
    kc.export(LAMP, tmp_path)
    (tmp_path / ".kc2spice.json").write_text(record)
    kc.export(LAMP, tmp_path)
    assert not list(tmp_path.glob("*.bak*"))
    add_line(tmp_path / "lamp.cir")
    (tmp_path / ".kc2spice.json").write_text(record)
    with pytest.warns(UserWarning, match="unknown origin"):
        kc.export(LAMP, tmp_path)
