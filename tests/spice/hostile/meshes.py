"""A small mesh in every format that gmsh reads, written here, and what pretends to be one."""

import bz2
import gzip
import struct
from functools import cache
from itertools import permutations

import numpy as np

# Twelve millimetres long, two boxes of six tetrahedra each; the groups are those of the scene.
CORNERS = np.array([(x, y, z) for x in (0.0, 6.0, 12.0) for y in (0.0, 3.0) for z in (0.0, 2.0)])
VOLUME = 12e-3 * 3e-3 * 2e-3
NAMES = {(2, 1): "root", (2, 2): "end", (3, 3): "bar"}

SCENE = """name = "hostile"
[bar]
part = "body"
mesh = "{mesh}"
unit = "mm"
{more}
materials = {{ bar = "steel" }}
fixed = ["root"]
ports = [{{ name = "tip", group = "end", axis = "z" }}]
[push]
part = "source"
kind = "force"
dc = 1.0
ac = 1.0
pins = {{ out = "bar.tip" }}
[analysis]
type = "ac"
start = 10
stop = 1000
points = 5
[probes]
swing = {{ of = "bar.u.tip", take = "max" }}
"""
GROUPS = """size = "3 mm"
groups.bar = { solids = [["6 mm", "1 mm", "1 mm"]] }
groups.root = { faces = [[0, "1 mm", "1 mm"]] }
groups.end = { faces = [["12 mm", "1 mm", "1 mm"]] }
"""


def elements():
    """(dimension, group, corners counted from 1) of every triangle and tetrahedron."""
    found = []
    for x, group in ((0, 1), (2, 2)):
        a, b, c, d = (4 * x + k + 1 for k in range(4))
        found += [(2, group, (a, b, d)), (2, group, (a, c, d))]
    for x in (0, 1):
        for order in permutations((4, 2, 1)):  # steps along x, y, z: Kuhn's six tetrahedra
            path = np.cumsum((4 * x + 1, *order))
            sides = np.diff(CORNERS[path - 1], axis=0)
            path = path if np.linalg.det(sides) > 0 else path[[0, 2, 1, 3]]
            found.append((3, 3, tuple(int(k) for k in path)))
    return found


def _names():
    rows = [f'{d} {tag} "{name}"' for (d, tag), name in NAMES.items()]
    return "\n".join(["$PhysicalNames", str(len(rows)), *rows, "$EndPhysicalNames\n"]).encode()


def msh2(binary=False):
    """Version 2.2: Gmsh's manual, "MSH file format version 2"."""
    kinds = {2: 2, 3: 4}  # triangle, tetrahedron
    nodes, cells = b"", b""
    for k, point in enumerate(CORNERS, 1):
        nodes += struct.pack("<i3d", k, *point) if binary else f"{k} {_words(point)}\n".encode()
    for k, (d, group, corners) in enumerate(elements(), 1):
        if binary:
            row = (kinds[d], 1, 2, k, group, group, *corners)
            cells += struct.pack(f"<{len(row)}i", *row)
        else:
            cells += f"{k} {kinds[d]} 2 {group} {group} {_words(corners)}\n".encode()
    end = b"\n" if binary else b""
    head = b"$MeshFormat\n2.2 1 8\n\1\0\0\0\n" if binary else b"$MeshFormat\n2.2 0 8\n"
    return b"".join([
        head, b"$EndMeshFormat\n", _names(),
        b"$Nodes\n%d\n" % len(CORNERS), nodes, end, b"$EndNodes\n",
        b"$Elements\n%d\n" % len(elements()), cells, end, b"$EndElements\n",
    ])  # fmt: skip


def msh4(binary=False):
    """Version 4.1: Gmsh's manual, "MSH file format"."""
    low, high = CORNERS.min(axis=0), CORNERS.max(axis=0)

    def put(form, *values):  # i int, n size, d double
        if binary:
            return struct.pack("<" + form.replace("n", "Q"), *values)
        return (_words(values) + "\n").encode()

    entities = put("4n", 0, 0, 2, 1)
    for tag in (1, 2):
        entities += put("i6d2n", tag, *low, *high, 0, 0)[: None if binary else -5]
        entities = entities if binary else entities.rstrip() + b" 1 %d 0\n" % tag
        if binary:
            entities = entities[:-16] + struct.pack("<QiQ", 1, tag, 0)
    box = struct.pack("<i6dQiQ", 3, *low, *high, 1, 3, 0)
    entities += box if binary else f"3 {_words((*low, *high))} 1 3 0\n".encode()
    n = len(CORNERS)
    nodes = put("4n", 1, n, 1, n) + put("3in", 3, 3, 0, n)
    nodes += b"".join(put("n", k) for k in range(1, n + 1))
    nodes += b"".join(put("3d", *point) for point in CORNERS)
    every = elements()
    cells = put("4n", 3, len(every), 1, len(every))
    number = 0
    for d, group, kind in ((2, 1, 2), (2, 2, 2), (3, 3, 4)):
        rows = [corners for dim, g, corners in every if (dim, g) == (d, group)]
        cells += put("3in", d, group, kind, len(rows))
        for row in rows:
            number += 1
            cells += put(f"{len(row) + 1}n", number, *row)
    end = b"\n" if binary else b""
    head = b"$MeshFormat\n4.1 1 8\n\1\0\0\0\n" if binary else b"$MeshFormat\n4.1 0 8\n"
    return b"".join([
        head, b"$EndMeshFormat\n", _names(), b"$Entities\n", entities, end, b"$EndEntities\n",
        b"$Nodes\n", nodes, end, b"$EndNodes\n", b"$Elements\n", cells, end, b"$EndElements\n",
    ])  # fmt: skip


def _words(values):
    return " ".join(f"{v:.17g}" for v in values)


@cache
def cad(suffix):
    """The same bar as a solid, drawn by gmsh."""
    import tempfile
    from pathlib import Path

    import gmsh

    with tempfile.TemporaryDirectory() as place:
        file = Path(place) / f"bar{suffix}"
        gmsh.initialize([], readConfigFiles=False, interruptible=False)
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.model.occ.addBox(0, 0, 0, *CORNERS.max(axis=0))
        gmsh.model.occ.synchronize()
        gmsh.write(str(file))
        gmsh.finalize()
        return file.read_bytes()


def good():
    """Name, content and further keys of what must work."""
    msh = {
        "text2.msh": msh2(), "binary2.msh": msh2(True), "text4.msh": msh4(),
        "binary4.msh": msh4(True), "CAPITALS.MSH": msh4(), "lines.msh": crlf(msh2()),
    }  # fmt: skip
    found = {name: (data, "") for name, data in msh.items()}
    for name in ("a.step", "a.stp", "A.STEP", "a.brep"):
        found[name] = (cad(".brep" if "brep" in name else ".step"), GROUPS)
    return found


def crlf(data):
    return data.replace(b"\n", b"\r\n")


def scripts(victim):
    """Name and content of files that make gmsh start a program if it reads them as a script."""
    act = f'SystemCall "touch {victim}";\n'.encode()
    head = b"$MeshFormat\n4.1 0 8\n$EndMeshFormat\n"
    bodies = {
        "comment": b"// $MeshFormat\n" + act, "block comment": b"/* $MeshFormat */" + act,
        "blank": b" $MeshFormat\n4.1 0 8\n" + act, "tab": b"\t$MeshFormat\n4.1 0 8\n" + act,
        "empty line": b"\n" + head + act, "mark": b"\xef\xbb\xbf" + head + act,
        "small letters": head.lower() + act, "longer word": b"$MeshFormats\n4.1 0 8\n" + act,
        "zero byte": b"\0" + head + act, "plain": act, "string": b'"$MeshFormat";' + act,
        "variable": b"a = 1; // $MeshFormat 4.1 0 8\n" + act,
        "on the line": b"$MeshFormat " + act, "second line": b"$MeshFormat\n" + act,
        "third line": b"$MeshFormat\n4.1 0 8\n" + act, "version 1": b"$NOD\n0\n$ENDNOD\n" + act,
        "version 3": b"$MeshFormat\n3 0 8\n$EndMeshFormat\n" + act,
        "version 5": b"$MeshFormat\n5 0 8\n$EndMeshFormat\n" + act,
        "no number": b"$MeshFormat\nnan 0 8\n$EndMeshFormat\n" + act,
        "said binary": b"$MeshFormat\n4.1 1 8\n" + act,
        "narrow": b"$MeshFormat\n4.1 0 4\n$EndMeshFormat\n" + act,
        "carriage returns": (head + act).replace(b"\n", b"\r"),
        "behind the header": head + act,
        "in a section": head + b"$Script\n" + act + b"$EndScript\n",
        "in options": head + b"$Options\n" + act + b"$EndOptions\n",
        "in a comment": head + b"$Comments\n" + act + b"$EndComments\n",
        "in a name": head + b'$PhysicalNames\n1\n3 1 "' + act.strip() + b'"\n$EndPhysicalNames\n',
        "behind a mesh": msh4() + act, "merge": head + b'Merge "other.geo";\n',
        "include": head + b'Include "other.geo";\n', "post": b"$PostFormat\n1.4 0 8\n" + act,
        "view": b'View "$MeshFormat" {\n};\n' + act, "comments first": b"$Comments\n" + act,
    }  # fmt: skip
    found = {f"{what}.msh": data for what, data in bodies.items()}
    whole = b"// $MeshFormat ISO-10303-21; DBRep_DrawableShape\n" + act
    for name in ("a.step", "a.stp", "A.STEP", "a.brep", "A.BREP", "A.MSH", "a.Msh"):
        found[name] = whole
    for name in ("a.geo", "A.GEO", "a.stl", "a.pos", "a.opt", "a.pro", "a.py", "a", ".msh",
                 "a.msh.geo", "a.msh.", "a.step.GEO", "a.geo_unrolled", "a.inp", "a.unv",
                 "a.med", "a.cgns", "a.xao", "a.rmed", "a.stdin"):  # fmt: skip
        found[name] = act
    for name in ("a.msh", "a.msh.gz", "a.step.gz", "a.brep", "a.step"):
        found[f"gz {name}"] = gzip.compress(whole)
        found[f"bz {name}"] = bz2.compress(whole)
    marked = b"\xef\xbb\xbf"
    found |= {
        "mark.step": marked + cad(".step"), "mark.brep": marked + cad(".brep"),
        "blank.step": b" " + cad(".step"), "newline.brep": b"\n" + cad(".brep"),
        "other.step": cad(".brep"), "other.brep": cad(".step"), "other.msh": cad(".step"),
        "mesh.step": msh4(), "refers.step": cad(".step").replace(
            b"ENDSEC;\nEND-ISO", b"#999 = DOCUMENT_FILE('x','','',$,'','');\nENDSEC;\nEND-ISO"),
    }  # fmt: skip
    return found


def names(outside):
    """What a scene may call its mesh without it lying beside the scene; a good mesh is there."""
    return (
        str(outside), "../outside/bar.msh", "folder/../../outside/bar.msh", "link.msh",
        "linked/bar.msh", "~/bar.msh", "/dev/zero", "/dev/stdin", "pipe.msh", "folder.msh",
        "circle.msh", "", ".", "..", "x" * 5000 + ".msh",
    )  # fmt: skip
