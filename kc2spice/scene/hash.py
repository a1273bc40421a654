"""A short name for what a scene says, independent of how and where it was written."""

from __future__ import annotations

import hashlib
import json

from kc2spice.scene.model import Scene


def scene_hash(scene: Scene) -> str:
    """First 16 hex digits of the SHA-256 of all numbers and choices that a netlist depends on.

    Names and titles are free, and so are gates and what is done about a run that fails; keys that
    are not given do not count, so that a new one changes no old scene. Floats enter with all their
    digits, so equal hashes mean bit-equal netlists.
    """
    without = {"name", "title", "checks", "gates", "bench"}
    content = scene.frame.model_dump(mode="json", exclude=without, exclude_none=True)
    del content["solver"]["retries"]
    content["parts"] = {
        part.name: [
            part.type.name,
            part.keys.model_dump(mode="json", exclude_none=True),
            dict(part.pins),
        ]
        for part in scene.parts.values()
    }
    whole = [part.name for part in scene.parts.values() if part.type.declares]
    if (
        scene.ports == "declared" and whole and len(scene.parts) > 1
    ):  # a single part keeps all in any case
        content["every_port"] = whole
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:16]
