"""Recognition of files of other programs by their first bytes and file extensions.

No reader of kc2spice accepts these files. The readers use the names of formats in error messages.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Literal

from kc2spice.core.errors import UsageError

SPREADSHEET = "a spreadsheet"
IMAGE = "an image"
PACKED = "an archive"
NETLIST = "a SPICE netlist"
LTSPICE_SCHEMATIC = "a schematic of LTspice"
KICAD_SCHEMATIC = "a schematic of KiCad"
PDF = "a PDF document"
WEB_PAGE = "a web page"
WAVEFORMS = "a waveform file of a simulator"
VERILOG = "a Verilog-A module"
ARRAYS = "an archive of arrays"
MESH = "a mesh"
SURFACE = "a surface without a volume"
CAD = "a CAD file"
# First bytes of binary files, each with the name of the file format. Spreadsheets in .xlsx and .ods
# files are zip archives, so the format of an archive also depends on its content and extension.
_BINARY_FORMATS = {
    b"%PDF": PDF,
    b"\x89PNG": IMAGE,
    b"\xff\xd8\xff": IMAGE,
    b"GIF8": IMAGE,
    b"\x1f\x8b": PACKED,
    b"BZh": PACKED,
    b"\xfd7zXZ": PACKED,
    b"7z\xbc\xaf": PACKED,
    b"PK\x03\x04": PACKED,
    b"\xd0\xcf\x11\xe0": SPREADSHEET,
}
# First characters of text files, in lower case, each with the name of the file format.
_TEXT_FORMATS = {
    b"version 4": LTSPICE_SCHEMATIC,
    b"(kicad_sch": KICAD_SCHEMATIC,
    b"<!doctype": WEB_PAGE,
    b"<html": WEB_PAGE,
    b"title:": WAVEFORMS,
}
# Patterns of the first characters of mesh and CAD files, each with the name of the file format. The
# patterns are in lower case.
_MESH_PATTERNS = (
    (re.compile(rb"\s*\$meshformat"), MESH),
    (re.compile(rb"\s*(# vtk datafile|(<\?xml[^>]*>\s*)?<vtkfile)"), MESH),
    (re.compile(rb"(.*\n)*?\*node\b.*\n\s*\d+\s*,"), MESH),  # Abaqus
    (re.compile(rb"(.*\n)*?(grid\*?( {3,}|,)\s*\d+|begin bulk)"), MESH),  # Nastran
    (re.compile(rb"\s*-1[ \t\r]*\n[ ]*(151|164|2411|2412|781|15)[ \t\r]*\n"), MESH),  # .unv
    (re.compile(rb"\s*solid\b.*\n\s*facet\b"), SURFACE),  # .stl as text
    (re.compile(rb"\s*(iso-10303-21;|dbrep_drawableshape)"), CAD),
    (re.compile(rb".{72}s {6}1\b"), CAD),  # IGES
)
SURFACE_SUFFIXES = (".stl", ".obj", ".ply", ".off", ".3mf")  # formats that contain surfaces only
# Formats of meshes and shapes. A part of type body reads some of these formats.
_MESH_FORMATS_BY_SUFFIX = {
    **dict.fromkeys((".msh", ".inp", ".bdf", ".nas", ".unv", ".vtu", ".med", ".exo", ".e"), MESH),
    **dict.fromkeys((".vtk", ".cdb", ".mesh", ".cgns"), MESH),
    **dict.fromkeys(SURFACE_SUFFIXES, SURFACE),
    **dict.fromkeys((".step", ".stp", ".brep", ".igs", ".iges"), CAD),
}
# Formats of meshes and shapes that no part reads.
_UNREADABLE_MESHES = (".vtk", ".cdb", ".mesh", ".cgns", ".igs", ".iges")
_HDF5_START = b"\x89HDF"  # first bytes of .med and .exo
_SPREADSHEET_SUFFIXES = (".xlsx", ".xlsm", ".xls", ".ods")
NETLIST_SUFFIXES = (".lib", ".cir", ".net", ".sub", ".mod", ".sp")
_FORMATS_BY_SUFFIX = {
    **dict.fromkeys(_SPREADSHEET_SUFFIXES, SPREADSHEET),
    **dict.fromkeys(NETLIST_SUFFIXES, NETLIST),
    ".va": VERILOG,
    **_MESH_FORMATS_BY_SUFFIX,
}
_SPREADSHEET_MARKS = (b"[Content_Types].xml", b"opendocument.spreadsheet")  # names in the archive
HEAD_BYTES = 2000  # number of bytes at the beginning of a file that determine its format
# Kinds of files that kc2spice reads. Errors about other files depend on the expected kind.
Reader = Literal["scene", "measurement", "matrices"]


def identify_binary_format(head: bytes, suffix: str) -> str | None:
    """Return the format of a binary file of another program, or None.

    ``head`` contains the first bytes of the file.

    >>> identify_binary_format(b"%PDF-1.7", ".pdf"), identify_binary_format(b"1 2 3", ".pdf")
    ('a PDF document', None)
    """
    name = next((name for start, name in _BINARY_FORMATS.items() if head.startswith(start)), None)
    if head.startswith(_HDF5_START):
        return _MESH_FORMATS_BY_SUFFIX.get(suffix.lower())
    marked = any(mark in head[:HEAD_BYTES] for mark in _SPREADSHEET_MARKS)
    if name == PACKED and (marked or suffix.lower() in _SPREADSHEET_SUFFIXES):
        return SPREADSHEET
    return ARRAYS if name == PACKED and suffix.lower() == ".npz" else name


def identify_text_format(head: bytes) -> str | None:
    """Return the format of a text file of another program, or None.

    ``head`` contains the first bytes of the file.
    """
    text = head[:HEAD_BYTES].lstrip().lower()
    name = next((name for start, name in _TEXT_FORMATS.items() if text.startswith(start)), None)
    return name or identify_mesh(head)


def identify_mesh(head: bytes) -> str | None:
    """Return the format of a text file with a mesh or a CAD model, or None.

    ``head`` contains the first bytes of the file.

    >>> identify_mesh(b"$MeshFormat"), identify_mesh(b"1000 1 2")
    ('a mesh', None)
    """
    text = head[:HEAD_BYTES].lower()
    return next((name for pattern, name in _MESH_PATTERNS if pattern.match(text)), None)


def identify_format(head: bytes, suffix: str) -> str | None:
    """Return the format of a file of another program by content or extension, or None."""
    return (
        identify_binary_format(head, suffix)
        or identify_text_format(head)
        or _FORMATS_BY_SUFFIX.get(suffix.lower())
    )


def read_head(path: Path) -> bytes:
    """Return the first bytes of an existing file, which determine its format."""
    with path.open("rb") as stream:
        return stream.read(HEAD_BYTES)


def advise_netlist_part(file: str) -> str:
    """Return the advice to include a netlist in a scene."""
    return (
        f'write a scene that contains the netlist as  part = "netlist"  and  file = "{file}"; the '
        "built-in scene bring_your_own is an example"
    )


def _advise_body_part(file: str, name: str) -> str:
    """Return the advice to include a mesh or a shape in a scene, or to save another format."""
    if name == SURFACE:
        return (
            f"save the volume of {file} as .step in the CAD program, and write a scene with the "
            'part  part = "body"'
        )
    suffix = Path(file).suffix.lower()
    if _MESH_FORMATS_BY_SUFFIX.get(suffix) != name or suffix in _UNREADABLE_MESHES:
        mesh = f"{Path(file).stem}.msh"
        return (
            f"save a volume mesh as {mesh}, for example with gmsh, and write a scene that contains "
            f'it as  part = "body"  and  mesh = "{mesh}"'
        )
    return (
        f'write a scene that contains this file as  part = "body"  and  mesh = "{file}"; '
        "kc2spice scenes --part body  lists its other keys"
    )


def make_other_format_error(path: Path, name: str, reader: Reader, expected: str) -> UsageError:
    """Make the error for a file of another program, with the name of its format.

    ``reader`` is the kind of file that the caller reads: "scene", "measurement" or "matrices".
    ``expected`` describes the accepted files, for the line ``expected`` of the error.
    """
    file, table = str(path), f"{path.stem}.csv"
    remark = {
        "scene": "not a scene",
        "measurement": "not a table of measured values",
        "matrices": "which kc2spice cannot reduce",
    }[reader]
    if name in (NETLIST, VERILOG) and reader == "matrices":
        remark = "which needs no reduction"
    if name in (MESH, SURFACE, CAD) and reader == "matrices":
        remark = "not matrices or measured values"
    hint = {
        "scene": f"write the path of a TOML file in place of {file}",
        "measurement": f"write the path of the measured values in place of {file}",
        "matrices": f"write the path of matrices or of measured values in place of {file}",
    }[reader]
    if name in (MESH, SURFACE, CAD):
        hint = _advise_body_part(file, name)
    elif name == SPREADSHEET and reader != "scene":
        hint = f"save the sheet with the measurement as {table}"
    elif name in (PDF, IMAGE, WEB_PAGE, WAVEFORMS) and reader != "scene":
        hint = f"save the measured values as a text table, such as {table}"
    elif name == PACKED:
        hint = f"unpack {file}, and write the path of the unpacked file"
    elif name == ARRAYS and reader == "scene":
        hint = f"kc2spice reduce {file}  reads the matrices of a model"
    elif name == NETLIST and reader != "measurement":
        hint = advise_netlist_part(file)
    return UsageError(f"this file is {name}, {remark}", where=file, expected=expected, hint=hint)
