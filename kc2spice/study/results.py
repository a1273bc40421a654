"""Files of a result: waveforms as arrays and as text, the field table, the record of the run."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from kc2spice.sim.waveforms import Waveforms

_UNITS = {
    "time": "s", "frequency": "Hz", "sphere.y": "m", "sphere.v": "m/s", "contact.force": "N",
    "kick.u": "m", "kick.voltage": "V", "kick.current": "A", "coil.lower.current": "A",
    "coil.upper.current": "A", "control.error": "m",
}  # fmt: skip


def write_waveforms(waves: Waveforms, directory: Path) -> list[str]:
    """``waveforms.npz`` with every digit and ``waveforms.csv`` with units in its head."""
    np.savez_compressed(directory / "waveforms.npz", **waves.data)  # type: ignore[arg-type]
    names = list(waves.data)
    head = ",".join(f"{name} [{unit}]" if (unit := _unit(name)) else name for name in names)
    columns = np.column_stack([waves[name] for name in names])
    np.savetxt(directory / "waveforms.csv", columns, "%.10g", ",", header=head, comments="")
    return ["waveforms.npz", "waveforms.csv"]


def _unit(name: str) -> str:
    return _UNITS.get(name) or _UNITS.get(name.rpartition(".")[0], "")


def write_record(record: Mapping[str, Any], directory: Path, name: str = "result.json") -> None:
    """One JSON file; a number that is not finite would not be JSON, so it becomes null."""
    text = json.dumps(_finite(record), indent=2)
    (directory / name).write_text(text + "\n", encoding="utf-8")


def _finite(value: Any) -> Any:
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    return value
