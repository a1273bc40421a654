"""Reader of scene files, and search for the line of a file that sets a key."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

from kc2spice.core.errors import UsageError, did_you_mean, list_candidates
from kc2spice.core.files import find_similar_name
from kc2spice.core.schemas import join_path
from kc2spice.core.toml_errors import parse_toml_file
from kc2spice.core.untrusted_files import (
    MAX_TEXT_BYTES,
    decode_text,
    make_encoding_error,
    read_bounded,
    split_lines,
)
from kc2spice.scene.catalogue import find_part, read_catalogue

INCLUDE = "include"  # key of a scene for netlist files that its parts use
# Keys whose value is the name of a file, in the tables of all part types.
_FILE_KEYS = frozenset({"file", "mesh", "sidecar", INCLUDE})
MAX_HEAD_LENGTH = 1000  # number of characters of a netlist within which its scene is named
_EXPORTED_FROM = re.compile(r"(?m)^\* scene: (\S+) hash=")
_ANALYSIS_CARD = re.compile(r"(?im)^\.(tran|ac|dc|op|noise)\b")


def list_gallery() -> dict[str, Traversable]:
    """Return the files of the built-in scenes, keyed by scene name."""
    files = (resources.files("kc2spice") / "scenes").iterdir()
    result = {file.name[:-5]: file for file in files if file.name.endswith(".toml")}
    return dict(sorted(result.items()))


@dataclass(frozen=True)
class SceneFile:
    """Text of a scene file, overrides of its keys, and methods that locate keys.

    If an override sets a scene key to a file name, ``override_folders`` contains the folder to
    which the file name is relative. In ``override_folders``, a scene key such as ``body.file`` is
    the tuple ``("body", "file")``.
    """

    label: str
    stem: str
    text: str
    folder: Path
    overrides: dict[tuple[str, ...], str] = field(default_factory=dict)
    override_folders: dict[tuple[str, ...], Path] = field(default_factory=dict)

    def parse_tables(self) -> dict[str, Any]:
        """Parse the text of the file, and return its tables."""
        return parse_toml_file(self.text, self.label)

    @property
    def base_folder(self) -> Path:
        """Base folder of file names in overrides; for built-in scenes, the current folder."""
        return Path.cwd() if self.folder == _find_gallery() else self.folder

    def overrides_key(self, key: str) -> bool:
        """Return whether an override sets the key."""
        return tuple(key.split(".")) in self.overrides

    def set_override(
        self, path: tuple[str, ...], value: object, origin: str, folder: Path | None
    ) -> None:
        """Record an override, and the folder to which its relative file names refer.

        ``folder`` is the folder of the override file, or None for an override without a file.
        """
        self.overrides[path] = origin
        if folder is None and self.base_folder != self.folder:
            folder = self.base_folder
        for key in _list_paths(path, value):
            self.override_folders.pop(key, None)
            if folder is not None and key[-1] in _FILE_KEYS:
                self.override_folders[key] = folder

    def find_override_folder(self, table: tuple[str, ...]) -> Path | None:
        """Return the folder to which file names in overrides of a part are relative.

        ``table`` is the path of the part's table. The result is None if file names are relative to
        the folder of the scene.
        """
        for path, folder in self.override_folders.items():
            if path[: len(table)] == table or path == (INCLUDE,):
                return folder
        return None

    def find_override(self, key: str) -> str | None:
        """Return the origin of the override that changes a key, or None without override."""
        names = tuple(key.split("."))
        for path, override in self.overrides.items():
            if path[: len(names)] == names or names[: len(path)] == path:
                return override
        return None

    def locate_key(self, key: str) -> str:
        """Return the override, or the line of the file, that sets a key.

        An example of a key is ``disc.layers.0.diameter``. For an empty key, return ``label``: the
        name of a built-in scene, a part number, or the path of a scene file.
        """
        if not key:
            return self.label
        if (override := self.find_override(key)) is not None:
            return override
        names = tuple(key.split("."))
        line = _find_line(self.text, names)
        place = self.label if line is None else f"{self.label}, line {line}"
        steps = tuple(int(name) if name.isdigit() else name for name in names)
        return f"{place}, key {join_path(steps)}"


def open_scene(name_or_path: str | Path) -> SceneFile:
    """Open a built-in scene, the scene of a catalogue part number, or a TOML file.

    Raises
    ------
    UsageError : the scene or the file does not exist, the file is not text, or the file is an
        exported deck.
    """
    scenes, name = list_gallery(), str(name_or_path)
    if not name:
        raise UsageError(
            "the name of the scene is empty",
            where="SCENE",
            got="''",
            expected="the name of a scene, or the path of a TOML file",
            hint="kc2spice scenes lists the built-in scenes",
        )
    if name in scenes:
        text = scenes[name].read_text(encoding="utf-8")
        return SceneFile(f"scene {name}", name, text, Path(str(scenes[name])).parent)
    path, part = Path(name_or_path), find_part(name)
    if part is not None and not path.exists():
        return (
            open_scene(part.scene)
            if part.scene
            else SceneFile(f"part {part.number}", part.scene_name, part.text, Path.cwd())
        )
    try:
        data = read_bounded(path, MAX_TEXT_BYTES)
        text = decode_text(data)
    except UnicodeDecodeError:
        raise make_encoding_error(data, name) from None
    except (FileNotFoundError, IsADirectoryError):
        raise _make_missing_file_error(name, path, scenes) from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise UsageError(
            f"this file cannot be read: {reason}",
            where=name,
            hint=f"check the permissions and the size of {name}",
        ) from None
    _reject_deck(text, path, scenes)
    # Path() means that the path of the file contains no folder
    folder = Path.cwd() if path.parent == Path() else path.parent
    return SceneFile(name, path.stem, text, folder)


def _reject_deck(text: str, path: Path, scenes: Collection[str]) -> None:
    """Reject a deck that kc2spice has exported, and propose to run it with its scene.

    Raises
    ------
    UsageError : the file is an exported deck. The libraries of parts contain no analysis.
    """
    match = _EXPORTED_FROM.search(text[:MAX_HEAD_LENGTH]) if text.startswith("* ") else None
    if match is None or not _ANALYSIS_CARD.search(text):
        return
    name = match[1]
    numbers = {part.scene_name: part.number for part in read_catalogue().values()}
    files = [
        file for file in (Path(f"{name}.toml"), path.with_name(f"{name}.toml")) if file.is_file()
    ]
    known = [name] if name in scenes else [numbers[name]] if name in numbers else files
    scene = known[0] if known else "SCENE"
    hint = f"kc2spice run {scene} --deck {path}  runs the scene with this deck"
    if not known:
        hint += f"; SCENE is the TOML file of the scene {name}"
    raise UsageError(
        f"this file is the exported deck of the scene {name}, not a scene",
        where=str(path),
        expected="a TOML file with a table for each part",
        hint=hint,
    )


def _make_missing_file_error(name: str, path: Path, scenes: Collection[str]) -> UsageError:
    """Return the error about a missing file or an unknown built-in scene."""
    listing = "kc2spice scenes lists the built-in scenes"
    if path.suffix != ".toml" and len(path.parts) == 1:
        expected = (
            f"a TOML file, or a built-in scene: {list_candidates(name, scenes, 'kc2spice scenes')}"
        )
        near = did_you_mean(name, scenes) or did_you_mean(name, read_catalogue())
        # The operating system may reject a file name, for example because it is too long.
        with contextlib.suppress(OSError, ValueError):
            if Path(f"{path.stem}.toml").is_file():
                near = f"did you mean '{path.stem}.toml'?"
        hint = near or f"{listing}; kc2spice parts lists the part numbers"
        return UsageError("this scene does not exist", got=repr(name), expected=expected, hint=hint)
    with contextlib.suppress(OSError):
        files = sorted(file.name for file in path.parent.glob("*.toml"))
        if similar := find_similar_name(path, files):
            listing = f"did you mean '{path.with_name(similar)}'?"
        if path.stem in scenes and len(path.parts) == 1:
            listing = f"write {path.stem} for the built-in scene"
    message = "this path is a directory" if path.is_dir() else "this file does not exist"
    return UsageError(message, where=name, expected="the path of a TOML file", hint=listing)


def _find_gallery() -> Path:
    """Return the folder of the built-in scenes."""
    return Path(str(resources.files("kc2spice") / "scenes"))


def _list_paths(path: tuple[str, ...], value: object) -> Iterator[tuple[str, ...]]:
    """Yield the path of a value and, if it is a table, the paths of all its keys."""
    yield path
    if isinstance(value, Mapping):
        for key, item in value.items():
            yield from _list_paths((*path, key), item)


def _add_entry_numbers(
    table: tuple[str, ...], counts: Mapping[tuple[str, ...], int]
) -> tuple[str, ...]:
    """Return the path of a table, with an entry number after each array of tables."""
    result: list[str] = []
    for end in range(1, len(table) + 1):
        result.append(table[end - 1])
        if table[:end] in counts:
            result.append(str(counts[table[:end]]))
    return tuple(result)


def _find_line(text: str, path: tuple[str, ...]) -> int | None:
    """Return the number of the line that sets the key with this ``path``.

    If no line sets the key, return the line that sets the longest leading part of ``path``, such as
    a table header.
    """
    table: tuple[str, ...] = ()
    counts: dict[tuple[str, ...], int] = {}  # number of the latest entry of each array of tables
    best: tuple[int, int | None] = (0, None)
    for number, line in enumerate(split_lines(text), start=1):
        line = line.strip()
        key = re.match(r"([\w.]+)\s*=", line)
        if line.startswith("["):
            header = line.partition("]")[0].lstrip("[")
            table = tuple(map(str.strip, header.split(".")))
            if line.startswith("[["):
                counts[table] = counts.get(table, -1) + 1
            table = names = _add_entry_numbers(table, counts)
        elif key:
            names = table + tuple(key[1].split("."))
        else:
            continue
        if names == path[: len(names)] and len(names) > best[0]:
            best = (len(names), number)
    return best[1]
