"""Files of others, class by class: refused with exit code 2 in bounded time, nothing written."""

import itertools
import json
import os
import time
import zipfile

import numpy as np
import pytest
from support import (
    MAX_TEXT_BYTES,
    Certificate,
    Header,
    LinearModel,
    Param,
    Pin,
    Port,
    UsageError,
    app,
    explain_unsafe_name,
    load_scene,
    make_plain_name,
    make_positive_parameter,
    parse_toml,
    read_bounded,
    read_model,
    read_rom,
    write_files,
    write_part_header,
    write_rom,
)
from typer.testing import CliRunner

SOON = 5.0  # s
CRAFTED = {
    "dotted key": "a" + ".a" * 450_000 + " = 1",
    "dotted key with blanks": "a" + " . a" * 200_000 + " = 1",
    "dotted key of strings": '"".' * 300_000 + "a = 1",
    "dotted header": "[" + "a." * 400_000 + "a]",
    "many deep headers": "\n".join("[" + "a." * 31 + f"x{i}]" for i in range(12_000)),
    "brackets": "a = " + "[" * 900_000,
    "inline tables": "a = " + "{a = " * 150_000,
    "long string": 'a = "' + "x" * 900_000,
    "long string as a value": 'title = "' + "x" * 900_000 + '"',
    "quantity of blanks": '[sphere]\nradius = "1' + " " * 900_000 + 'x"',
    "quotes": '"' * 900_000,
    "triple quotes": "a = " + '"""' * 300_000,
    "escapes": 'a = "' + "\\u0041" * 150_000 + '"',
    "backslashes": 'a = "' + "\\" * 900_000,
    "header of blanks": "[" + " " * 900_000,
    "line of blanks": "a" + " " * 900_000 + "b",
    "header of blanks in a scene that is wrong": "sphere = 1\n" + "#[" + " " * 9_000 + "\n" * 90,
    "string that looks like a header": "sphere = 1\ntitle = '''\n[" + " " * 400_000 + "\n'''",
    "long key": "a" * 900_000 + " = 1",
    "long key in quotes": '"' + "a" * 900_000 + '" = 1',
    "digits": "gravity = " + "9" * 900_000,
    "hexadecimal digits": "gravity = 0x" + "f" * 900_000,
    "hexadecimal digits as a name": "title = 0x" + "f" * 900_000,
    "too long": "#" * (MAX_TEXT_BYTES + 1),
    "zero byte": "a\0 = 1",
    "zero byte in an include": 'include = ["a\\u0000b"]\n[kick.driver.user]\nsubckt = "x"',
    "not text": "\udcff",
}  # fmt: skip


SWEPT = ("dotted key", "escapes", "zero byte in an include")


@pytest.mark.parametrize(
    ("name", "command"), [*((n, "explain") for n in CRAFTED), *((n, "sweep") for n in SWEPT)]
)
def test_crafted_scenes_are_refused_soon(name, command, tmp_path):
    path = tmp_path / "crafted.toml"
    path.write_bytes(CRAFTED[name].encode(errors="surrogateescape"))
    options = ["--set", "sphere.radius=1,2"] if command == "sweep" else []
    begin = time.process_time()
    result = CliRunner().invoke(app, [command, str(path), *options])
    assert result.exit_code == 2, result.output[-500:]
    assert len(result.output) < 10_000
    assert time.process_time() - begin < SOON


@pytest.mark.parametrize("command", ["run", "explain", "sweep", "verify"])
def test_a_pipe_is_no_scene(command, tmp_path):
    path = tmp_path / "pipe.toml"
    os.mkfifo(path)
    result = CliRunner().invoke(app, [command, str(path)])
    assert result.exit_code == 2
    assert "not a regular file" in result.output


@pytest.mark.parametrize(
    "text",
    [
        "a.b.c = 1", '"a.b" = "x.y.z"', "a = [[1, 2], [3.5, 4.5]]", "# " + "." * 5_000,
        'a = """\n' + "." * 5_000 + '\n"""', "a = [" + "1.5, " * 2_000 + "]",
        "a = '" + "[" * 500 + "'",
    ],
)  # fmt: skip
def test_honest_toml_is_read(text):
    assert parse_toml(text) is not None


def test_deep_overrides_are_refused():
    for text in ("a." * 10_000 + "a=1", "title=" + "{a." * 10_000 + "a=1", "a" * 100_000 + "=1"):
        with pytest.raises(UsageError):
            load_scene("impact", [text])


def test_names_cannot_leave_their_directory(tmp_path):
    for good in ("a.lib", "models/amp-2.lib", "two words.lib", "µF.lib", "./a.lib", "v1.0+x"):
        assert explain_unsafe_name(good) is None
    for bad in ("../a", "/a", "a/../../b", "a\nb", "a\0", "", "~/a", "c:a", "a\\..\\b", " a", "-a"):
        assert explain_unsafe_name(bad)
        with pytest.raises(UsageError):
            write_files({bad: "x"}, tmp_path / "out")
    assert not list(tmp_path.iterdir())
    assert make_plain_name("/a b/ü.lib") == "_.lib"


def test_reading_is_bounded(tmp_path):
    path = tmp_path / "file"
    path.write_bytes(b"x" * 10)
    assert read_bounded(path, 10) == b"x" * 10
    with pytest.raises(OSError, match="more than 9 bytes"):
        read_bounded(path, 9)


def small_rom():
    one = np.eye(2)
    ports = Port("u1", "input", "m/s", "-"), Port("y1", "output", "V", "-")
    return LinearModel(
        M=one, E=one, K=one, B=one[:, :1], C=one[:1], ports=ports,
        certificate=Certificate((0.0, 1e3), 1e-5, "POD", True, True),
    )  # fmt: skip


EVIL = "x\n.control\nshell touch pwned\n.endc"


WORDS = [("ports", 0, key) for key in ("name", "kind", "across", "flow")]
FACTS = [("certificate", key) for key in ("method", "band_hz", "error_estimate", "above")]


@pytest.mark.parametrize(
    ("place", "evil"),
    [
        *itertools.product(WORDS, [EVIL, "two words", "", 3, [EVIL], "x" * 2_000]),
        *itertools.product(FACTS, [EVIL, [EVIL], "x" * 2_000, [0.0, float("inf")]]),
        (("certificate", "method"), 3),
        (("certificate", "band_hz"), [float("nan"), 1.0]),
        (("certificate", "above"), [[1e6, float("nan")]]),
    ],
    ids=str,
)
def test_every_text_of_a_record_is_checked(place, evil, tmp_path):
    write_rom(small_rom(), tmp_path, "rom")
    with np.load(tmp_path / "rom.npz") as archive:
        arrays = dict(archive)
    record = json.loads(str(arrays.pop("record")))
    *way, last = place
    table = record
    for key in way:
        table = table[key]
    table[last] = evil
    np.savez(tmp_path / "rom.npz", record=np.array(json.dumps(record)), **arrays)
    before = sorted(tmp_path.iterdir())
    result = CliRunner().invoke(
        app, ["export", "--rom", str(tmp_path / "rom.npz"), "-o", str(tmp_path / "out")]
    )
    assert result.exit_code == 2, result.output
    assert sorted(tmp_path.iterdir()) == before


def test_headers_reject_line_breaks():
    with pytest.raises(UsageError, match="this unit contains a blank or a line break"):
        write_part_header(Header("s", "h"), "t", (Pin("a", EVIL, "A"),), rating="none")
    params = (Param("k", 2.0, "N/m", EVIL), make_positive_parameter("c", 1e-9, "F", "size"))
    lines = write_part_header(Header(EVIL, "h"), "t", (Pin("a", "V", "A"),), params, rating="none")
    text = "\n".join(lines)
    assert all(line.startswith("* ") for line in text.splitlines())
    assert "* @param c=1e-09 unit=F range=1e-30..inf size" in lines


@pytest.mark.parametrize(
    ("letter", "read"),
    [("K", read_rom), ("record", read_rom), ("K", read_model), ("M.data", read_model)],
)
def test_an_archive_is_refused_by_what_it_declares(letter, read, tmp_path):
    """Seven gigabytes of zeros in seven megabytes; never unpacked."""
    path = tmp_path / "bomb.npz"
    head = b"{'descr': '<f8', 'fortran_order': False, 'shape': (30000, 30000), }"
    head = head.ljust(117) + b"\n"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        with archive.open(f"{letter}.npy", "w", force_zip64=True) as stream:
            stream.write(b"\x93NUMPY\x01\x00" + len(head).to_bytes(2, "little") + head)
            stream.write(bytes(1_000_000))
        archive.filelist[0].file_size = 128 + 8 * 30000**2  # so says the archive's directory
    begin = time.process_time()
    with pytest.raises(UsageError) as caught:
        read(path)
    declared = ("900000000 entries, more than", "7.2e+09 unpacked bytes")
    assert any(words in str(caught.value) for words in declared)
    assert time.process_time() - begin < 1.0
