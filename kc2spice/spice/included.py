"""The user's own netlists that a scene includes."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from kc2spice.core.errors import UsageError
from kc2spice.core.foreign import name_threat
from kc2spice.scene.schema import Scene
from kc2spice.spice.scan import third_party


def included_netlists(scene: Scene, *, trust: bool = False) -> dict[str, str]:
    """The files of ``scene.include``, each one text with all that it includes, as
    ``{file name in the deck: text}``.

    Raises
    ------
    UsageError : a file that is not there, that could act on the machine (unless ``trust``), or two
        files with one name.
    """
    files: dict[str, str] = {}
    for _, found in _read(scene, trust):
        for name, text in found.items():
            if files.setdefault(name, text) != text:
                raise UsageError("two different included files have one name", where=name)
    return files


def included_sources(scene: Scene) -> dict[str, str]:
    """The same texts as ``{name in scene.include: text}``, to be put beside a copy of the scene.

    Raises
    ------
    UsageError : as :func:`included_netlists`.
    """
    return {name: next(iter(found.values())) for name, found in _read(scene, False)}


def _read(scene: Scene, trust: bool) -> Iterator[tuple[str, dict[str, str]]]:
    for name, path in zip(scene.include, scene.netlists, strict=True):
        reason = None if trust else name_threat(name)
        if reason:
            raise UsageError(
                f"includes {reason}",
                where="include",
                got=repr(name[:120]),
                expected="names of files beside the scene: letters, digits, blanks and _ . + -",
                hint="copy the netlist beside the scene, or repeat with --trust",
            )
        yield name, third_party(path, trust=trust, home=path.parent if trust else _home(path, name))


def _home(path: Path, name: str) -> Path:
    """The scene's directory, ``path`` without the parts of ``name``."""
    parts = len(Path(name).parts)
    return path.parents[parts - 1]
