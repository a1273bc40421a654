"""A scene with all that belongs to it, in a form that can be sent to another machine."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from kc2spice.core.errors import UsageError
from kc2spice.core.foreign import name_threat, read_bounded, text_of
from kc2spice.core.toml import MAX_BYTES
from kc2spice.scene.load import gallery, load_scene
from kc2spice.scene.schema import Scene
from kc2spice.sim.ngspice import write_files
from kc2spice.spice.included import included_sources


@dataclass(frozen=True)
class SceneText:
    """A gallery name, or a name, its TOML and ``(file name, text)`` of the netlists beside it.

    It may come from anybody: its names are those of files in one directory, or it is not made.

    Raises
    ------
    UsageError : a name that could lead elsewhere, or something else than text.
    """

    name: str
    text: str | None
    netlists: tuple[tuple[str, str], ...] = ()

    def __post_init__(self) -> None:
        for text in (self.name, self.text or "", *(t for pair in self.netlists for t in pair)):
            if not isinstance(text, str):
                raise UsageError("is no text", where="scene", got=repr(text)[:80])
        for name in (self.name, *(name for name, _ in self.netlists)):
            if reason := name_threat(name):
                raise UsageError(
                    f"is {reason}", where="name of a scene's file", got=repr(name[:120])
                )
        if "/" in self.name:
            raise UsageError("is no plain name", where="scene", got=repr(self.name[:120]))

    def load(self, overrides: Sequence[str]) -> Scene:
        """The scene with ``overrides`` on top of it; raises as :func:`load_scene` does."""
        if self.text is None:
            return load_scene(self.name, overrides)
        return load_scene(Path(_unpacked(self).name) / f"{self.name}.toml", overrides)


@lru_cache(maxsize=8)
def _unpacked(scene: SceneText) -> tempfile.TemporaryDirectory[str]:
    """A directory that holds the files of ``scene`` until this process ends."""
    directory = tempfile.TemporaryDirectory(prefix="kc2spice-scene-")
    write_files({f"{scene.name}.toml": scene.text or "", **dict(scene.netlists)},
                Path(directory.name))  # fmt: skip
    return directory


def scene_text(name_or_path: str) -> SceneText:
    """The scene as it stands now.

    Raises
    ------
    UsageError : no such scene, or a netlist that it includes is not there or not allowed.
    """
    if name_or_path in gallery():
        return SceneText(name_or_path, None)
    path = Path(name_or_path)
    scene = load_scene(path)
    text = text_of(read_bounded(path, MAX_BYTES))
    return SceneText(scene.name, text, tuple(included_sources(scene).items()))
