"""Reader of scene files, and search for the line of a file that sets a key."""

from __future__ import annotations

import contextlib
import difflib
import re
import shlex
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

from kc2spice.core.errors import (
    MAX_CANDIDATES,
    MIN_FRAGMENT_LENGTH,
    MIN_WORD_LENGTH,
    TYPING_ERROR_RATIO,
    UsageError,
    did_you_mean,
    join_first,
    list_candidates,
)
from kc2spice.core.files import find_similar_name
from kc2spice.core.other_file_formats import identify_binary_format, make_other_format_error
from kc2spice.core.schemas import find_unit, join_path, list_keys
from kc2spice.core.toml_errors import EXPECTED_SCENE_FILE, parse_toml_file
from kc2spice.core.untrusted_files import (
    MAX_TEXT_BYTES,
    decode_text,
    make_encoding_error,
    read_bounded,
    split_lines,
)
from kc2spice.scene.catalogue import find_part, read_catalogue, search_parts
from kc2spice.scene.override_origin import OverrideOrigin

INCLUDE = "include"  # key of a scene for netlist files that its parts use
# Keys whose value is the name of a file, in the tables of all part types.
_FILE_KEYS = frozenset({"file", "mesh", "sidecar", INCLUDE})
MAX_HEAD_LENGTH = 1000  # number of characters of a netlist within which its scene is named
_EXPORTED_FROM = re.compile(r"(?m)^\* scene: (\S+) hash=")
_ANALYSIS_CARD = re.compile(r"(?im)^\.(tran|ac|dc|op|noise)\b")


def _find_unit_of_key(lines: Sequence[str], number: int, key: str) -> str | None:
    """Find the SI unit of a key in a text that is not valid TOML, from the part type.

    The line ``part = "TYPE"`` of the same table states the part type. The result is None if the
    table has no such line, or if keys of the part with this name have several units.
    """
    # imported here, because only errors need the part types
    from kc2spice.scene.parttype import find_part_type

    header = re.compile(r"\s*\[")
    begin = next((k for k in range(number - 1, -1, -1) if header.match(lines[k])), 0)
    after = (k for k in range(number, len(lines)) if header.match(lines[k]))
    table = "\n".join(lines[begin : next(after, len(lines))])
    stated = re.search(r"(?m)^\s*part\s*=\s*[\"'](\w+)[\"']", table)
    kind = find_part_type(stated[1]) if stated else None
    if kind is None:
        return None
    units = {find_unit(field) for path, field in list_keys(kind.schema) if path[-1] == key}
    return units.pop() if len(units) == 1 else None


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
    overrides: dict[tuple[str, ...], OverrideOrigin] = field(default_factory=dict)
    override_folders: dict[tuple[str, ...], Path] = field(default_factory=dict)

    def parse_tables(self) -> dict[str, Any]:
        """Parse the text of the file, and return its tables."""
        return parse_toml_file(self.text, self.label, find_unit=_find_unit_of_key)

    @property
    def base_folder(self) -> Path:
        """Base folder of file names in overrides; for built-in scenes, the current folder."""
        return Path.cwd() if self.folder == _find_gallery() else self.folder

    def overrides_key(self, key: str) -> bool:
        """Return whether an override sets the key."""
        return tuple(key.split(".")) in self.overrides

    def set_override(
        self, path: tuple[str, ...], value: object, origin: OverrideOrigin, folder: Path | None
    ) -> None:
        """Record an override, and the folder to which its relative file names refer.

        ``folder`` is the folder of the override file, or None for an override without a file.
        """
        self.overrides[path] = origin
        if folder is None and self.base_folder != self.folder:
            folder = self.base_folder
        for key in list_paths(path, value):
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

    def find_override(self, key: str) -> OverrideOrigin | None:
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
            return str(override)
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
        if (file_format := identify_binary_format(data, path.suffix)) is not None:
            raise make_other_format_error(path, file_format, "scene", EXPECTED_SCENE_FILE)
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
        expected=EXPECTED_SCENE_FILE,
        hint=hint,
    )


def _make_missing_file_error(name: str, path: Path, scenes: Collection[str]) -> UsageError:
    """Return the error about a missing file or an unknown built-in scene."""
    listing = "kc2spice scenes lists the built-in scenes"
    if path.suffix != ".toml" and len(path.parts) == 1:
        matches = _list_scenes_with_word(name, scenes)
        listed = list_candidates(name, scenes, "kc2spice scenes")
        expected = f"a TOML file, or a built-in scene: {listed}"
        near = f"did you mean {matches[0]!r}?" if matches else did_you_mean(name, scenes)
        if len(matches) > 1:
            expected = f"a TOML file, or a built-in scene, such as {join_first(matches)}"
            near = "write one of these names"
            near += f"; {listing}" if len(matches) > MAX_CANDIDATES else ""
        with contextlib.suppress(UsageError):
            if near is None and search_parts(name):
                words = shlex.quote(name)
                near = f"write one of the part numbers that  kc2spice parts {words}  lists"
        near = near or did_you_mean(name, read_catalogue())
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


def _list_scenes_with_word(word: str, scenes: Collection[str]) -> list[str]:
    """List the scenes whose names contain a word; names that begin with the word come first.

    The word may contain a typing error. If the word is the complete name of a scene, apart from a
    typing error, the list contains only this scene.
    """
    lower = word.lower().replace("-", "_").strip("_")
    if similar := difflib.get_close_matches(lower, scenes, n=1, cutoff=TYPING_ERROR_RATIO):
        return similar
    if len(lower) < MIN_WORD_LENGTH:
        return []
    words = "_".join(scenes).split("_")
    lower = next(iter(difflib.get_close_matches(lower, words, 1, TYPING_ERROR_RATIO)), lower)
    first = [name for name in scenes if name.startswith(lower)]
    long = len(lower) >= MIN_FRAGMENT_LENGTH
    inside = [name for name in scenes if f"_{lower}_" in f"_{name}_" or (long and lower in name)]
    return list(dict.fromkeys((*first, *inside)))


def _find_gallery() -> Path:
    """Return the folder of the built-in scenes."""
    return Path(str(resources.files("kc2spice") / "scenes"))


def list_paths(path: tuple[str, ...], value: object) -> Iterator[tuple[str, ...]]:
    """Yield the path of a value and, if it is a table, the paths of all its keys."""
    yield path
    if isinstance(value, Mapping):
        for key, item in value.items():
            yield from list_paths((*path, key), item)


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
