"""Studies: sweeps in a TOML file, built in or your own."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

from kc2spice.core.errors import UsageError
from kc2spice.core.foreign import read_bounded, text_of
from kc2spice.core.toml import MAX_BYTES, parse_toml
from kc2spice.workflow.sweep.source import scene_text
from kc2spice.workflow.sweep.study import Request

_KEYS: dict[str, type | tuple[type, ...]] = {
    "title": str, "scene": str, "set": dict, "zip": bool, "latin": bool, "seed": int,
    "metrics": list,
}  # fmt: skip


def studies() -> dict[str, Traversable]:
    """Built-in studies by name."""
    folder = resources.files("kc2spice") / "studies"
    found = {item.name.removesuffix(".toml"): item for item in folder.iterdir()}
    return {name: found[name] for name in sorted(found) if found[name].name.endswith(".toml")}


def request_of(
    name: str,
    sets: tuple[str, ...],
    zipped: bool,
    latin: bool,
    seed: int,
    metrics: tuple[str, ...],
    timeout: float | None,
    table_format: str,
) -> Request:
    """The request for a scene, or for a study with the command line on top of it.

    ``--set`` replaces the study's range of the same key.

    Raises
    ------
    UsageError : neither a scene nor a study, or a study with a mistake in it.
    """
    study = _definition(name)
    if study is None:
        return Request(scene_text(name), sets, zipped, latin, seed, metrics, timeout, table_format)
    ranges = {key: f"{key}={_text(value)}" for key, value in study.get("set", {}).items()}
    ranges |= {text.partition("=")[0].strip(): text for text in sets}
    return Request(
        scene_text(study["scene"]),
        tuple(ranges.values()),
        zipped or study.get("zip", False),
        latin or study.get("latin", False),
        seed or study.get("seed", 0),
        metrics or tuple(study.get("metrics", ())),
        timeout,
        table_format,
    )


def _definition(name: str) -> Mapping[str, Any] | None:
    """Content of the study ``name``, built in or a file with a key ``scene``; None for a scene."""
    builtin = studies()
    try:
        if name in builtin:
            text = builtin[name].read_text(encoding="utf-8")
        else:
            text = text_of(read_bounded(Path(name), MAX_BYTES))
        content = parse_toml(text)
    except (OSError, ValueError):
        return None  # whoever loads it as a scene says what is wrong with it
    if "scene" not in content:
        return None
    for key, value in content.items():
        kind = _KEYS.get(key)
        if kind is None or not isinstance(value, kind):
            raise UsageError("not a key of a study" if kind is None else "of the wrong type",
                             where=f"{name}, key {key}", got=repr(value),
                             expected=", ".join(_KEYS))  # fmt: skip
    return content


def _text(value: Any) -> str:
    return value if isinstance(value, str) else repr(value)
