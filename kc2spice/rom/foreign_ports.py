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
``kind = "mechanical"`` (N in, m out) or ``"electrical"`` (V in, C out) in SI, and all ports of
such a model are of that sort.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from kc2spice.core.errors import UsageError
from kc2spice.core.foreign import read_bounded, text_of
from kc2spice.core.toml import MAX_BYTES, parse_toml
from kc2spice.fem.piezo.system import Port
from kc2spice.rom.pencil import Pencil

_KEYS = {"name", "direction", "unit", "scale", "kind"}
_KINDS = {"mechanical": ("um", "N"), "electrical": ("V", "A")}
_DIRECTIONS = ("in", "out", "both")


@dataclass(frozen=True)
class _Entry:
    name: str
    direction: str
    unit: str
    scale: float
    kind: str


@dataclass(frozen=True)
class PortTable:
    """The port entries of one file, in order; without any, ports are ``u1``... and ``y1``..."""

    entries: tuple[_Entry, ...] = ()
    band: tuple[float, float] | None = None
    where: str = ""

    def apply(self, pencil: Pencil) -> tuple[Pencil, tuple[Port, ...]]:
        """The pencil in the units of its pins, and its ports: inputs, then outputs.

        Raises
        ------
        UsageError : the number of entries does not fit B and C, or a conservative port has
            different shapes in both.
        """
        m, p = pencil.B.shape[1], pencil.C.shape[0]
        if not self.entries:
            names = [f"u{i + 1}" for i in range(m)] + [f"y{i + 1}" for i in range(p)]
            return pencil, tuple(Port(name, "signal", "-", "-") for name in names)
        if any(entry.direction == "both" for entry in self.entries):
            return pencil, self._conservative(pencil)
        inputs = [entry for entry in self.entries if entry.direction == "in"]
        outputs = [entry for entry in self.entries if entry.direction == "out"]
        if (len(inputs), len(outputs)) != (m, p):
            raise self._unfit(f"{len(inputs)} inputs and {len(outputs)} outputs", m, p)
        into = np.array([entry.scale for entry in inputs])
        out = np.array([entry.scale for entry in outputs])
        B, C = pencil.B * into, pencil.C / out[:, None]
        D = pencil.D * into / out[:, None]
        ports = tuple(Port(e.name, "signal", e.unit, "-") for e in (*inputs, *outputs))
        return Pencil(pencil.coefficients, B, C, D), ports

    def _conservative(self, pencil: Pencil) -> tuple[Port, ...]:
        ports = [entry for entry in self.entries if entry.direction == "both"]
        if len(ports) < len(self.entries) or not pencil.collocated:
            raise UsageError(
                "conservative ports cannot be mixed with signals, and need C = B'",
                where=self.where,
                expected="direction 'both' for all ports or for none",
            )
        if len(ports) != pencil.B.shape[1]:
            raise self._unfit(f"{len(ports)} ports", pencil.B.shape[1], pencil.C.shape[0])
        return tuple(Port(e.name, e.kind, *_KINDS[e.kind]) for e in ports)  # type: ignore[arg-type]

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
    try:
        data = parse_toml(text_of(read_bounded(path, MAX_BYTES)))
    except (OSError, ValueError) as error:
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
    kinds = tuple(_KINDS) if direction == "both" else ("signal",)
    text = [item.get("name"), item.get("unit", "-")]
    if (
        direction not in _DIRECTIONS
        or kind not in kinds
        or not all(isinstance(t, str) for t in text)
    ):
        raise UsageError(
            "not a port",
            where=where,
            got=item,
            expected="name = TEXT, direction = 'in', 'out', or 'both' with kind = 'mechanical' or "
            "'electrical'",
        )
    scale = item.get("scale", 1.0)
    plain = isinstance(scale, (int, float)) and not isinstance(scale, bool)
    if not plain or not 0 < scale < np.inf or (direction == "both" and scale != 1):
        raise UsageError(
            "not a scale", where=where, got=scale, expected="a positive number; none for 'both'"
        )
    return _Entry(_word(text[0], where, "name"), direction, _word(text[1], where, "unit"),
                  float(scale), kind)  # fmt: skip


def _word(text: str, where: str, what: str) -> str:
    """Names and units go into the header of a netlist, so they are one printable word each."""
    if not text.isprintable() or len(text.split()) != 1 or len(text) > 32:
        expected = "one word, e.g. 'm/s'"
        raise UsageError(f"not a {what}", where=where, got=repr(text[:80]), expected=expected)
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
