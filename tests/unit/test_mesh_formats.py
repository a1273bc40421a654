"""Meshes of other programs against the same mesh in gmsh's format."""

import sys

import gmsh
import meshio
import numpy as np
import pytest
from support import MissingToolError, UsageError, measure_extent, read_mesh

SUFFIXES = (".unv", ".inp", ".bdf", ".vtu", ".med", ".exo")
LIBRARIES = {".med": "h5py", ".exo": "netCDF4"}


def write_box(path):
    """Write a box of eight hexahedra; its face at x = 0 is a group."""
    gmsh.initialize([], readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Verbosity", 0)
    point = gmsh.model.geo.addPoint(0, 0, 0)
    line = gmsh.model.geo.extrude([(0, point)], 0, 2, 0, [2], recombine=True)[1]
    face = gmsh.model.geo.extrude([line], 0, 0, 1, [2], recombine=True)[1]
    solid = gmsh.model.geo.extrude([face], 3, 0, 0, [2], recombine=True)[1]
    gmsh.model.geo.synchronize()
    gmsh.model.addPhysicalGroup(3, [solid[1]], 7, name="box")
    gmsh.model.addPhysicalGroup(2, [face[1]], 9, name="clamp")
    gmsh.model.mesh.generate(3)
    gmsh.write(str(path))
    gmsh.finalize()


def write_format(source, path):
    """Write the mesh of a file in another format, and return the names of its two groups."""
    if path.suffix == ".unv":
        gmsh.initialize([], readConfigFiles=False, interruptible=False)
        gmsh.option.setNumber("General.Verbosity", 0)
        gmsh.open(str(source))
        gmsh.option.setNumber("Mesh.SaveGroupsOfElements", 1)
        gmsh.write(str(path))
        gmsh.finalize()
        return "box", "clamp"
    mesh = meshio.read(source)
    hexahedra = mesh.cells_dict["hexahedron"]
    quadrilaterals = mesh.cells_dict["quad"]
    cells = [("hexahedron", hexahedra), ("quad", quadrilaterals)]
    tags = [np.full(8, 7), np.full(4, 9)]
    nodes = np.unique(quadrilaterals)
    if path.suffix == ".inp":
        meshio.Mesh(mesh.points, cells[:1], cell_sets={"box": [np.arange(8)]},
                    point_sets={"clamp": nodes}).write(path)  # fmt: skip
        return "box", "clamp"
    if path.suffix == ".exo":
        meshio.Mesh(mesh.points, cells[:1], point_sets={"clamp": nodes}).write(path)
        return "0", "clamp"
    key = {".bdf": "nastran:ref", ".vtu": "part", ".med": "cell_tags"}[path.suffix]
    result = meshio.Mesh(mesh.points, cells, cell_data={key: tags})
    if path.suffix == ".med":
        result.cell_data["cell_tags"] = [-np.full(8, 7), -np.full(4, 9)]
        result.cell_tags, result.point_tags = {-7: ["box"], -9: ["clamp"]}, {}
        result.write(path)
        return "box", "clamp"
    result.write(path)
    return "7", "9"


@pytest.mark.slow
@pytest.mark.parametrize("splits", [0, 1])
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_formats_give_the_mesh_and_groups_of_gmsh(tmp_path, suffix, splits):
    if suffix in LIBRARIES:
        pytest.importorskip(LIBRARIES[suffix], reason="pip install 'kc2spice[meshes]'")
    write_box(tmp_path / "box.msh")
    path = tmp_path / f"box{suffix}"
    solid, face = write_format(tmp_path / "box.msh", path)
    expected = read_mesh(tmp_path / "box.msh", unit=1e-3, splits=splits)
    result = read_mesh(path, unit=1e-3, splits=splits)
    assert set(result.groups) >= {solid, face}
    assert type(result.mesh) is type(expected.mesh)
    for name, other, codimension in ((solid, "box", 0), (face, "clamp", 1)):
        places = []
        for mesh, key in ((result, name), (expected, other)):
            group = mesh.get_group(key, "x", codimension)
            corners = mesh.mesh.facets if codimension else mesh.mesh.t
            middles = mesh.mesh.p[:, corners[:, group.members]].mean(axis=1)
            places.append(np.sort(np.round(1e6 * middles.T) @ [1e8, 1e4, 1]))
        np.testing.assert_array_equal(*places)
    np.testing.assert_allclose(measure_extent(path), [3, 2, 1])
    if suffix != ".unv":  # no element has a number that a table of poling could contain
        assert (result.numbers == -1).all()


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("share", [0.0, 0.3, 0.7])
def test_a_damaged_file_is_an_error_with_its_name(tmp_path, suffix, share):
    if suffix in LIBRARIES:
        pytest.importorskip(LIBRARIES[suffix], reason="pip install 'kc2spice[meshes]'")
    write_box(tmp_path / "box.msh")
    path = tmp_path / f"box{suffix}"
    write_format(tmp_path / "box.msh", path)
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    with pytest.raises(UsageError) as caught:
        read_mesh(path, unit=1e-3)
    assert f"box{suffix}" in str(caught.value) or "node" in str(caught.value)


@pytest.mark.parametrize(
    ("suffix", "text"),
    [(".inp", "*INCLUDE, INPUT=other.inp\n"), (".bdf", "INCLUDE 'other.bdf'\n"),
     (".vtu", "<!DOCTYPE x>\n")],
)  # fmt: skip
def test_references_to_other_files_are_errors(tmp_path, suffix, text):
    (tmp_path / f"a{suffix}").write_text(text, encoding="utf-8")
    with pytest.raises(UsageError, match="refers to other files"):
        read_mesh(tmp_path / f"a{suffix}", unit=1e-3)


def test_elements_inside_and_outside_of_abaqus_sets_are_an_error(tmp_path):
    text = "*NODE\n1,0,0,0\n*ELEMENT, TYPE=C3D4\n*ELEMENT, TYPE=C3D4, ELSET=a\n"
    (tmp_path / "a.inp").write_text(text, encoding="utf-8")
    with pytest.raises(UsageError, match=r"some \*ELEMENT lines have no ELSET"):
        read_mesh(tmp_path / "a.inp", unit=1e-3)


@pytest.mark.parametrize("suffix", LIBRARIES)
def test_a_missing_library_states_its_command(tmp_path, suffix, monkeypatch):
    monkeypatch.setitem(sys.modules, LIBRARIES[suffix], None)
    (tmp_path / f"a{suffix}").write_bytes(b"\x89HDF")
    with pytest.raises(MissingToolError) as caught:
        read_mesh(tmp_path / f"a{suffix}", unit=1e-3)
    assert caught.value.hint == "pip install 'kc2spice[meshes]'"
