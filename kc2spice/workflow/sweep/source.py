"""A scene with all that belongs to it, in a form that can be sent to another machine."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from kc2spice.scene.load import gallery, load_scene
from kc2spice.scene.schema import Scene
from kc2spice.sim.ngspice import write_files
from kc2spice.spice.included import included_netlists


@dataclass(frozen=True)
class SceneText:
    """A gallery name, or a name, its TOML and ``(file name, text)`` of the netlists beside it."""

    name: str
    text: str | None
    netlists: tuple[tuple[str, str], ...] = ()

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
    netlists = included_netlists(load_scene(path))
    return SceneText(path.stem, path.read_text(encoding="utf-8"), tuple(netlists.items()))
