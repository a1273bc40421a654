"""Names, units and directions of a foreign model's ports, from the TOML file beside it.

::

    band = [0, 2e4]                 # Hz, optional: what 'reduce' certifies unless told otherwise

    [[port]]
    name = "force"
    direction = "in"                # a column of B, in their order
    unit = "N"

    [[port]]
    name = "tip"
    direction = "out"               # a row of C
    unit = "um"                     # 1 V on the pin
    scale = 1e-6                    # of the model's own unit; 1 unless given

A port with ``direction = "both"`` is conservative: one column of B and the same row of C. It is
``kind = "mechanical"`` (N in, m out), ``"rotational"`` (N m in, rad out), ``"electrical"`` (V in,
C out) or ``"acceleration"`` (m/s^2 of the frame in, B = -M r) in SI, and all ports of such a model
are of that sort. ``pins`` names its netlist pins (two of an electrical port).
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from kc2spice.core.errors import UsageError
from kc2spice.rom.linear import CONSERVATIVE, LinearModel, Port

MAX_BYTES = 1_000_000
_KEYS = {"name", "direction", "unit", "scale", "kind", "pins"}
_DIRECTIONS = ("in", "out", "both")


@dataclass(frozen=True)
class _Entry:
    name: str
    direction: str
    unit: str
    scale: float
    kind: str
    pins: tuple[str, ...] = ()


@dataclass(frozen=True)
class PortTable:
    """The port entries of one file, in order; without any, ports are ``u1``... and ``y1``..."""

    entries: tuple[_Entry, ...] = ()
    band: tuple[float, float] | None = None
    where: str = ""

    def apply(self, model: LinearModel) -> LinearModel:
        """The model in the units of its pins, with its ports: inputs, then outputs; each once where
        they are conservative.

        Raises
        ------
        UsageError : the number of entries does not fit B and C, or a conservative port has
            different shapes in both.
        """
        model = replace(model, band=self.band)
        m, p = model.B.shape[1], model.C.shape[0]
        if not self.entries:
            return replace(model, ports=())
        if any(entry.direction == "both" for entry in self.entries):
            return self._conservative(model)
        inputs = [entry for entry in self.entries if entry.direction == "in"]
        outputs = [entry for entry in self.entries if entry.direction == "out"]
        if (len(inputs), len(outputs)) != (m, p):
            raise self._unfit(f"{len(inputs)} inputs and {len(outputs)} outputs", m, p)
        into = np.array([entry.scale for entry in inputs])
        out = np.array([entry.scale for entry in outputs])
        ports = [Port(e.name, "input", e.unit, "-") for e in inputs]
        ports += [Port(e.name, "output", e.unit, "-") for e in outputs]
        return replace(
            model, B=model.B * into, C=model.C / out[:, None], D=model.D * into / out[:, None],
            ports=tuple(ports),
        )  # fmt: skip

    def _conservative(self, model: LinearModel) -> LinearModel:
        entries = [entry for entry in self.entries if entry.direction == "both"]
        if len(entries) < len(self.entries) or not model.pencil.collocated:
            raise UsageError(
                "conservative ports cannot be mixed with signals, and need C = B'",
                where=self.where,
                expected="direction 'both' for all ports or for none",
            )
        if model.first_order:
            raise UsageError(
                "conservative ports need a second-order model", where=self.where,
                expected="direction 'in' and 'out' for a first-order model",
            )  # fmt: skip
        if len(entries) != model.B.shape[1]:
            raise self._unfit(f"{len(entries)} ports", model.B.shape[1], model.C.shape[0])
        return replace(
            model,
            ports=tuple(Port(e.name, e.kind, pins=e.pins) for e in entries),  # type: ignore[arg-type]
        )

    def _unfit(self, got: str, m: int, p: int) -> UsageError:
        expected = f"{m} inputs (columns of B), {p} outputs (rows of C)"
        return UsageError("ports do not fit", where=self.where, got=got, expected=expected)


def read_ports(path: Path) -> PortTable | None:
    """The table in ``path``; None if there is no such file.

    Raises
    ------
    UsageError : not TOML, too long, an unknown key, a value of the wrong type, a name twice.
    """
    if not path.is_file():
        return None
    where = str(path)
    if path.stat().st_size > MAX_BYTES:
        raise UsageError("too long", where=where, expected=f"at most {MAX_BYTES} bytes")
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise UsageError("is not TOML", where=where, got=str(error)) from None
    unknown = sorted(set(data) - {"port", "band"})
    ports = data.get("port", [])
    if unknown or not isinstance(ports, list):
        raise UsageError(
            "unknown keys", where=where, got=", ".join(unknown), expected="band, [[port]]"
        )
    entries = tuple(_entry(item, f"{where}: port {i}") for i, item in enumerate(ports, 1))
    names = [entry.name.lower() for entry in entries]
    if len(set(names)) < len(names):
        raise UsageError("two ports have one name", where=where, got=", ".join(names))
    return PortTable(entries, _band(data.get("band"), where), where)


def _entry(item: Any, where: str) -> _Entry:
    if not isinstance(item, dict) or set(item) - _KEYS:
        got = sorted(set(item) - _KEYS) if isinstance(item, dict) else item
        raise UsageError("unknown keys", where=where, got=got, expected=", ".join(sorted(_KEYS)))
    direction, kind = item.get("direction"), item.get("kind", "signal")
    kinds = CONSERVATIVE if direction == "both" else ("signal",)
    pins = item.get("pins", [])
    text = [item.get("name"), item.get("unit", "-"), *(pins if isinstance(pins, list) else [pins])]
    if (
        direction not in _DIRECTIONS
        or kind not in kinds
        or not isinstance(pins, list)
        or not all(isinstance(t, str) for t in text)
        or (pins and len(pins) != (2 if kind == "electrical" else 1))
    ):
        raise UsageError(
            "not a port",
            where=where,
            got=item,
            expected="name = TEXT, direction = 'in', 'out', or 'both' with kind = "
            + " or ".join(f"'{k}'" for k in CONSERVATIVE),
        )
    scale = item.get("scale", 1.0)
    plain = isinstance(scale, (int, float)) and not isinstance(scale, bool)
    if not plain or not 0 < scale < np.inf or (direction == "both" and scale != 1):
        raise UsageError(
            "not a scale", where=where, got=scale, expected="a positive number; none for 'both'"
        )
    return _Entry(text[0], direction, _unit(text[1], where), float(scale), kind, tuple(pins))


def _unit(text: str, where: str) -> str:
    """A unit goes into the header of a netlist, so it is one printable word."""
    if not text.isprintable() or len(text.split()) != 1 or len(text) > 32:
        raise UsageError("not a unit", where=where, got=repr(text), expected="one word, e.g. 'm/s'")
    return text


def _band(value: Any, where: str) -> tuple[float, float] | None:
    if value is None:
        return None
    if (
        isinstance(value, list)
        and len(value) == 2
        and all(isinstance(f, (int, float)) and not isinstance(f, bool) for f in value)
        and 0 <= value[0] < value[1] < np.inf
    ):
        return float(value[0]), float(value[1])
    raise UsageError(
        "not a band", where=where, got=value, expected="[f0, f1] with 0 <= f0 < f1, Hz"
    )
