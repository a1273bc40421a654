"""A small bar in every format that gmsh reads, and what pretends to be one."""

import bz2
import gzip
from functools import cache

SIZE = (12.0, 3.0, 2.0)  # mm
VOLUME = 12e-3 * 3e-3 * 2e-3

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


@cache
def drawn(suffix, version=4.1, binary=False):
    """The bar by gmsh: its mesh with the groups of the scene, or the solid."""
    import tempfile
    from pathlib import Path

    import gmsh

    with tempfile.TemporaryDirectory() as place:
        file = Path(place) / f"bar{suffix}"
        gmsh.initialize([], readConfigFiles=False, interruptible=False)
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.model.occ.addBox(0, 0, 0, *SIZE)
        gmsh.model.occ.synchronize()
        if suffix == ".msh":
            for name, x in (("root", 0.0), ("end", SIZE[0])):
                faces = gmsh.model.getEntitiesInBoundingBox(x - 0.1, -1, -1, x + 0.1, 4, 3, 2)
                gmsh.model.addPhysicalGroup(2, [tag for _, tag in faces], name=name)
            gmsh.model.addPhysicalGroup(3, [1], name="bar")
            gmsh.option.setNumber("Mesh.MeshSizeMin", 3.0)
            gmsh.option.setNumber("Mesh.MshFileVersion", version)
            gmsh.option.setNumber("Mesh.Binary", binary)
            gmsh.model.mesh.generate(3)
        gmsh.write(str(file))
        gmsh.finalize()
        return file.read_bytes()


def mesh(version=4.1, binary=False):
    return drawn(".msh", version, binary)


def good():
    """Name, content and further keys of what must work."""
    msh = {
        "text2.msh": mesh(2.2), "binary2.msh": mesh(2.2, True), "binary4.msh": mesh(4.1, True),
        "CAPITALS.MSH": mesh(), "lines.msh": mesh(2.2).replace(b"\n", b"\r\n"),
    }  # fmt: skip
    found = {name: (data, "") for name, data in msh.items()}
    for name in ("A.STEP", "a.brep"):
        found[name] = (drawn(".brep" if "brep" in name else ".step"), GROUPS)
    return found


def scripts(victim):
    """Name and content of files that make gmsh start a program if it reads them as a script."""
    act = f'SystemCall "touch {victim}";\n'.encode()
    head = b"$MeshFormat\n4.1 0 8\n$EndMeshFormat\n"
    bodies = {
        "comment": b"// $MeshFormat\n" + act, "blank": b" $MeshFormat\n4.1 0 8\n" + act,
        "mark": b"\xef\xbb\xbf" + head + act, "small letters": head.lower() + act,
        "longer word": b"$MeshFormats\n4.1 0 8\n" + act, "zero byte": b"\0" + head + act,
        "plain": act, "on the line": b"$MeshFormat " + act,
        "version 5": b"$MeshFormat\n5 0 8\n$EndMeshFormat\n" + act,
        "no number": b"$MeshFormat\nnan 0 8\n$EndMeshFormat\n" + act,
        "said binary": b"$MeshFormat\n4.1 1 8\n" + act,
        "carriage returns": (head + act).replace(b"\n", b"\r"), "behind the header": head + act,
        "in a section": head + b"$Script\n" + act + b"$EndScript\n",
        "in a name": head + b'$PhysicalNames\n1\n3 1 "' + act.strip() + b'"\n$EndPhysicalNames\n',
        "behind a mesh": mesh() + act, "merge": head + b'Merge "other.geo";\n',
        "post": b"$PostFormat\n1.4 0 8\n" + act, "view": b'View "$MeshFormat" {\n};\n' + act,
    }  # fmt: skip
    found = {f"{what}.msh": data for what, data in bodies.items()}
    whole = b"// $MeshFormat ISO-10303-21; DBRep_DrawableShape\n" + act
    for name in ("a.step", "A.STEP", "a.brep", "A.MSH"):
        found[name] = whole
    for name in ("a.geo", "A.GEO", "a.stl", "a.pos", "a.opt", "a.py", "a", ".msh", "a.msh.geo",
                 "a.geo_unrolled", "a.inp", "a.unv"):  # fmt: skip
        found[name] = act
    for name in ("a.msh", "a.msh.gz", "a.step"):
        found[f"gz {name}"] = gzip.compress(whole)
        found[f"bz {name}"] = bz2.compress(whole)
    found |= {
        "mark.step": b"\xef\xbb\xbf" + drawn(".step"), "other.step": drawn(".brep"),
        "mesh.step": mesh(), "refers.step": drawn(".step").replace(
            b"ENDSEC;\nEND-ISO", b"#999 = DOCUMENT_FILE('x','','',$,'','');\nENDSEC;\nEND-ISO"),
    }  # fmt: skip
    return found


def names(outside):
    """Mesh names that a scene must not contain; most lead out of its folder, to a good mesh."""
    return (
        str(outside), "../outside/bar.msh", "folder/../../outside/bar.msh", "link.msh",
        "linked/bar.msh", "~/bar.msh", "/dev/zero", "/dev/stdin", "pipe.msh", "folder.msh",
        "circle.msh", "", ".", "..", "x" * 5000 + ".msh",
    )  # fmt: skip
