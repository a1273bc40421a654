"""Files of a result: waveforms as arrays and as text, the field table, the record of the run."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from kc2spice.core.waveforms import Waveforms

SCALES = {"time": "s", "frequency": "Hz"}  # units


def write_waveforms(waves: Waveforms, units: Mapping[str, str], directory: Path) -> list[str]:
    """``waveforms.npz`` with every digit and ``waveforms.csv`` with units in its head."""
    save_arrays(waves, directory / "waveforms.npz")
    columns = {
        head: values
        for name in waves.data
        for head, values in _columns(name, waves[name], units.get(name) or SCALES.get(name, ""))
    }
    head, table = ",".join(columns), np.column_stack(list(columns.values()))
    np.savetxt(directory / "waveforms.csv", table, "%.10g", ",", header=head, comments="")
    return ["waveforms.npz", "waveforms.csv"]


def save_arrays(waves: Waveforms, path: Path) -> None:
    """All arrays of ``waves`` in one npz file."""
    np.savez_compressed(path, **waves.data)  # type: ignore[arg-type]


def _columns(name: str, values: np.ndarray, unit: str) -> Iterator[tuple[str, np.ndarray]]:
    """Heads and columns of one array; real and imaginary part of a complex one."""
    if np.iscomplexobj(values):
        yield f"{name} real", values.real
        yield f"{name} imag", values.imag
    else:
        yield (f"{name} [{unit}]" if unit else name), values


def write_record(record: Mapping[str, Any], directory: Path, name: str = "result.json") -> None:
    """One JSON file; a number that is not finite would not be JSON, so it becomes null."""
    text = json.dumps(plain(record), indent=2)
    (directory / name).write_text(text + "\n", encoding="utf-8")


def plain(value: Any) -> Any:
    """``value`` in types that JSON has; what is not finite becomes None."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    return value
