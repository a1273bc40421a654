"""The user's own netlists that a scene includes."""

from __future__ import annotations

from kc2spice.core.errors import UsageError
from kc2spice.scene.schema import Scene
from kc2spice.spice.scan import third_party


def included_netlists(scene: Scene, *, trust: bool = False) -> dict[str, str]:
    """The files of ``scene.include`` and what they include in turn, as ``{file name: text}``.

    Raises
    ------
    UsageError : a file that is not there, that could act on the machine (unless ``trust``), or two
        files with one name.
    """
    files: dict[str, str] = {}
    for path in scene.netlists:
        for name, text in third_party(path, trust=trust).items():
            if files.setdefault(name, text) != text:
                raise UsageError("two different included files have one name", where=name)
    return files
