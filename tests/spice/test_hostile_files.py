"""Files of strangers through every command: none acts, each ends in a result or in exit code 2."""

import json
import os

import pytest
from hostile import meshes, readers
from support import api, find_material

READING = readers.COMMANDS | {
    "bench": ("bench", "hostile.toml", "-o", "out"),
    "reduce": ("reduce", "hostile.toml:bar", "-o", "out", "--order", "4"),
    "sweep": ("sweep", "hostile.toml", "--set", "push.ac=1,2", "--workers", "1", "-o", "out"),
}
ALL = ("run", "explain", "export", "verify", "bench", "reduce", "sweep")


@pytest.fixture
def home(tmp_path, monkeypatch):
    """A folder of a scene with its cache, beside what nobody may touch."""
    monkeypatch.setenv("KC2SPICE_CACHE", str(tmp_path))  # where it is put back to from
    folder = tmp_path / "home"
    (folder / "cache").mkdir(parents=True)
    monkeypatch.chdir(folder)
    return folder


def ask(command, home):
    """Exit code and what was said; a traceback fails at once."""
    code, said = readers.ask(READING[command], home)
    assert "internal error" not in said
    assert "Traceback" not in said
    return code, said


def mesh_scene(home, mesh, more=""):
    name = json.dumps(mesh)[1:-1]
    (home / "hostile.toml").write_text(meshes.SCENE.format(mesh=name, more=more))


# one file a hole: a script as a mesh, as CAD, behind a good head, compressed, under another suffix
DECISIVE = ("comment.msh", "behind the header.msh", "a.step", "a.geo", "gz a.msh", "refers.step")


def unrun(name, home, *commands):
    """Every command refuses the file, runs nothing of it and writes nothing."""
    victim = home.parent / "pwned"
    (home / name).write_bytes(meshes.scripts(victim)[name])
    (home / "other.geo").write_text(f'SystemCall "touch {victim}";\n')
    mesh_scene(home, name)
    before = sorted(home.iterdir())
    for command in commands:
        code, said = ask(command, home)
        if name == "behind a mesh.msh" and code == 0:
            continue  # a good mesh, and what follows it is no part of it
        assert code == 2, (name, command, said)
        assert not victim.exists()
        assert sorted(home.iterdir()) == before
    (home / name).unlink()


@pytest.mark.parametrize("name", DECISIVE)
def test_no_mesh_is_run_as_a_program(name, home):
    unrun(name, home, *(ALL if name == "comment.msh" else ("explain",)))


@pytest.mark.slow
def test_no_mesh_of_all_is_run_as_a_program(home):
    for name in sorted(meshes.scripts("x")):
        unrun(name, home, "explain", "reduce")


def test_a_mesh_lies_beside_its_scene(home):
    outside = home.parent / "outside" / "bar.msh"
    outside.parent.mkdir()
    outside.write_bytes(meshes.mesh())
    (home / "folder").mkdir()
    (home / "folder.msh").mkdir()
    (home / "link.msh").symlink_to(outside)
    (home / "linked").symlink_to(outside.parent)
    (home / "circle.msh").symlink_to("circle.msh")
    os.mkfifo(home / "pipe.msh")
    for name in meshes.names(outside):
        mesh_scene(home, name)
        code, said = ask("explain", home)
        assert code == 2, (name, said)
        assert any(word in said for word in ("hostile.toml", "bar", "mesh", ".msh"))


@pytest.mark.parametrize("table", [
    'part = "source"\nfile = "{}"\npins = {{ out = "load.a" }}',
    'part = "matrices"\nfile = "{}"',
    'part = "matrices"\nfile = "model.npz"\nsidecar = "{}"',
])  # fmt: skip
@pytest.mark.parametrize("name", ["../x", "link"])
def test_every_other_file_lies_beside_its_scene(table, name, home):
    (home.parent / "x").write_text("0, 0\n1, 1\n")
    (home / "link").symlink_to("../x")
    load = '[load]\npart = "resistor"\nresistance = 1.0\n'
    text = table.format(name.format(home=home))
    (home / "hostile.toml").write_text(f'name = "hostile"\n{load}[bar]\n{text}\n')
    code, said = ask("explain", home)
    assert code == 2, said
    assert "outside of the scene's folder" in said


@pytest.mark.parametrize("name", sorted(meshes.good()))
def test_an_honest_mesh_is_read_in_every_format(name, home):
    """The mass is that of 12 x 3 x 2 mm of steel."""
    data, more = meshes.good()[name]
    (home / name).write_bytes(data)
    mesh_scene(home, name, more)
    model = api.build(str(home / "hostile.toml"))["bar"]
    expected = meshes.VOLUME * find_material("steel").density
    assert model.facts["mass_kg"] == pytest.approx(expected, rel=1e-9)
