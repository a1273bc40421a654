"""Files of other programs as input: each command names the format, and its advice works."""

import io
import re
import zipfile
from pathlib import Path

import numpy as np
import pytest
from messages import rows_of_error
from support import app
from typer.testing import CliRunner

RESISTOR = "* part\n.subckt part a b\nR1 a b 1k\n.ends\n"
F = np.linspace(1e3, 5e4, 40)
Z = 20 + 1 / (2j * np.pi * F * 1e-8)
ROWS = [f"{f!r},{z.real!r},{z.imag!r}" for f, z in zip(F.tolist(), Z.tolist(), strict=True)]
TABLE = "\n".join(["frequency_hz,real_ohm,imag_ohm", *ROWS, ""])


def make_archive(*names):
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name in names:
            archive.writestr(name, "x")
    return stream.getvalue()


FILES = {  # content of each file, and the name of its format
    "part.lib": (RESISTOR.encode(), "a SPICE netlist"),
    "part.cir": (RESISTOR.encode(), "a SPICE netlist"),
    "part.sp": (RESISTOR.encode(), "a SPICE netlist"),
    "part.net": (RESISTOR.encode(), "a SPICE netlist"),
    "part.va": (b'`include "disciplines.vams"\n', "a Verilog-A module"),
    "part.asc": (b"Version 4\nSHEET 1 880 680\n", "a schematic of LTspice"),
    "part.raw": (b"Title: part\nDate: today\n", "a waveform file of a simulator"),
    "scan.xlsx": (make_archive("[Content_Types].xml", "xl/workbook.xml"), "a spreadsheet"),
    "scan.ods": (make_archive("mimetype"), "a spreadsheet"),
    "scan.csv": (make_archive("[Content_Types].xml"), "a spreadsheet"),  # with a wrong name
    "scan.xls": (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", "a spreadsheet"),
    "scan.pdf": (b"%PDF-1.7\n%\xe2\xe3\n", "a PDF document"),
    "scan.png": (b"\x89PNG\r\n\x1a\n\0\0", "an image"),
    "scan.csv.gz": (b"\x1f\x8b\x08\0\0", "an archive"),
    "scan.zip": (make_archive("scan.csv"), "an archive"),
}


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("command", ["reduce", "fit buzzer_7bb_20_6:disc", "run", "export"])
def test_a_file_of_another_program_is_named(cli, command, name):
    content, kind = FILES[name]
    Path(name).write_bytes(content)
    done = cli(*command.split(), name)
    found = rows_of_error(done.stderr)
    assert done.exit_code == 2
    assert f"{name}: this file is {kind}, " in found["head"]
    assert found["expected"]
    assert name in found["next"] or Path(name).stem in found["next"]
    assert [path.name for path in Path().iterdir()] == [name]


def test_the_advice_about_a_spreadsheet_works(cli):
    Path("scan.xlsx").write_bytes(FILES["scan.xlsx"][0])
    advice = rows_of_error(cli("reduce", "scan.xlsx").stderr)["next"]
    table = re.fullmatch(r"save the sheet with the measurement as (\S+)", advice)[1]
    Path(table).write_text(TABLE)
    assert cli("reduce", table).exit_code == 0


def test_the_advice_about_a_netlist_works(cli):
    Path("part.lib").write_text(RESISTOR)
    found = rows_of_error(cli("reduce", "part.lib").stderr)
    assert found["head"].endswith("this file is a SPICE netlist, which needs no reduction")
    keys = re.search(r'(part = "netlist")  and  (file = "part.lib")', found["next"]).groups()
    own = ["[own]", *keys, 'subckt = "part"', 'pins = { a = "drive.out", b = "gnd" }']
    drive = ["[drive]", 'part = "source"', 'dc = "1 V"', "[analysis]", 'type = "op"']
    Path("own.toml").write_text("\n".join([*own, *drive]))
    assert cli("run", "own.toml").exit_code == 0


def test_a_table_with_an_unusual_name_is_read_or_renamed(cli):
    """Instruments name text tables .xls or .asc; the name alone rejects no table."""
    for name in ("scan.xls", "scan.asc"):
        Path(name).write_text(TABLE)
    found = rows_of_error(cli("fit", "buzzer_7bb_20_6:disc", "scan.xls").stderr)
    assert "--vary" in found["head"] + found["next"]
    found = rows_of_error(cli("reduce", "scan.asc").stderr)
    name = re.fullmatch(r"if this table contains measured values, rename it to (\S+)",
                        found["next"])[1]  # fmt: skip
    Path("scan.asc").rename(name)
    assert cli("reduce", name).exit_code == 0


def test_a_matlab_file_without_a_frequency_has_an_advice_about_vectors(cli, tmp_path):
    from scipy.io import savemat

    savemat("scan.mat", {"a": F, "b": Z})
    command = ("fit", "buzzer_7bb_20_6:disc", "scan.mat", "--vary", "damping.quality")
    found = rows_of_error(cli(*command).stderr)
    assert found["head"].endswith("no variable is the frequency; the file contains a, b")
    names = re.search(r"names such as  (.*)", found["next"])[1].split(", ")
    savemat("scan.mat", dict(zip(names, (F, Z.real, Z.imag), strict=True)))
    assert CliRunner().invoke(app, ["reduce", "scan.mat"]).exit_code == 0
