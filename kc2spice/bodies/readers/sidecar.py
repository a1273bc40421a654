"""``NAME.toml`` beside the matrices: what the tool's files do not say.

::

    band = [0, 2e4]               # Hz: what 'reduce' certifies unless told otherwise
    length = "mm"                 # unit of the tool's displacements (m, mm, um, in); default m
    force = "N"                   # and of its forces (N, lbf)
    symmetric = true              # 'general' matrices of which one triangle is stored are halves
                                  # (false: they really are triangular)
    files = { K = "a.mtx", M = "b.mtx" }      # names that do not follow NAME.K, NAME_K.mtx
    matrices = { K = "KAAX", M = "MAAX" }     # names inside an OP4 or punch file
    mesh = "job.inp"              # coordinates and node sets: .inp, .bdf, .cdb or node,x,y,z .csv
    dofs = "rows.csv"             # node,dof of each row, where the matrices do not name them
    damping = { alpha = 0, beta = 1e-9 }      # E = alpha M + beta K on top of the file's own
    damping = { ratio = 0.01, at = 250e3 }    # or beta from a ratio at a frequency [Hz]

    [[fixed]]                     # freedoms held at zero
    nodeset = "ROOT"              # or node = 7, nodes = [7, 8], at = [x, y, z]
    dof = ["ux", "uy", "uz"]      # one or several; all of the node unless given

    [[ports]]
    name = "tip"
    kind = "mechanical"           # electrical, mechanical, rotational, acceleration, input, output
    node = 12                     # or nodes = [...], nodeset = "TIP", at = [x, y, z] (unit length)
    within = 0.1                  # how far from 'at' the node may be (unit length)
    dof = "uz"                    # ux uy uz rx ry rz volt temp, or 1 to 6
    axis = "z"                    # or a direction [0, 0.6, 0.8] instead of 'dof'
    unit = "um"                   # 1 V on the pin of a signal port ...
    scale = 1e-6                  # ... in the model's unit (inputs and outputs only)
    pins = ["anode", "cathode"]   # names of the netlist pins

    [[ports]]
    name = "force"
    kind = "input"
    column = 1                    # a column of B, counted from 1; 'row' is a row of C

A mechanical port at several nodes is their mean displacement; its force is spread evenly over
them. A port of kind ``acceleration`` moves the frame that the fixed freedoms stand on: it needs
only ``axis``. An ``electrical`` port at nodes ties their ``volt`` freedoms to one electrode. Ports
with ``column`` of a conservative kind take the same row of C; without ``[[ports]]`` the columns of
B and rows of C are signals ``u1`` ..., ``y1`` ....

``[[port]]`` with ``direction = "in"``, ``"out"`` or ``"both"`` instead of ``kind``, ``column`` and
``row`` takes the columns of B and the rows of C in order.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, get_args

import numpy as np

from kc2spice.bodies.readers.limits import LETTERS, existing, present
from kc2spice.bodies.readers.raw import CODES, DOFS
from kc2spice.core.errors import UsageError
from kc2spice.rom.linear import CONSERVATIVE, PortKind

MAX_BYTES = 1_000_000
LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254, "ft": 0.3048}
FORCES = {"N": 1.0, "mN": 1e-3, "uN": 1e-6, "kN": 1e3, "lbf": 4.4482216152605}
_KINDS: tuple[PortKind, ...] = get_args(PortKind)
_PLACE = {"node", "nodes", "nodeset", "at", "within"}
_FIXED = _PLACE | {"dof"}
_PORT = _PLACE | {"name", "kind", "dof", "axis", "column", "row", "unit", "scale", "pins"}
_TOP = {
    "band", "length", "force", "symmetric", "files", "matrices", "mesh", "dofs", "damping", "fixed",
    "ports",
}  # fmt: skip
_AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


@dataclass(frozen=True)
class Place:
    """Nodes: by number, by set, or by coordinate."""

    nodes: tuple[int, ...] = ()
    nodeset: str | None = None
    at: tuple[float, float, float] | None = None
    within: float | None = None

    def __bool__(self) -> bool:
        return bool(self.nodes) or self.nodeset is not None or self.at is not None


@dataclass(frozen=True)
class Fixed:
    """Freedoms held at zero; ``dofs`` empty for all of the nodes."""

    place: Place
    dofs: tuple[int, ...]
    where: str


@dataclass(frozen=True)
class PortEntry:
    """One ``[[ports]]`` table, checked by itself."""

    name: str
    kind: PortKind
    where: str
    place: Place = Place()
    dof: int | None = None
    axis: tuple[float, float, float] | None = None
    column: int | None = None
    row: int | None = None
    unit: str = ""
    scale: float = 1.0
    pins: tuple[str, ...] = ()


@dataclass(frozen=True)
class Sidecar:
    """Everything that ``NAME.toml`` says; the defaults are those of a model without one."""

    where: str = ""
    ports: tuple[PortEntry, ...] = ()
    fixed: tuple[Fixed, ...] = ()
    band: tuple[float, float] | None = None
    symmetric: bool | None = None
    files: Mapping[str, Path] = field(default_factory=dict)
    matrices: Mapping[str, str] = field(default_factory=dict)
    mesh: Path | None = None
    dofs: Path | None = None
    length: float = 1.0
    force: float = 1.0
    alpha: float = 0.0
    beta: float = 0.0


def read_sidecar(path: Path) -> Sidecar:
    """The sidecar at ``path``.

    Raises
    ------
    UsageError : missing, not TOML, too long, an unknown key, a value of the wrong type, a name
        twice; the message names the file and the key.
    """
    if not present(path):
        where = str(path).replace("\0", "\\0")
        raise UsageError("no such file", where=where, expected="a TOML file")
    where = str(path)
    if path.stat().st_size > MAX_BYTES:
        raise UsageError("too long", where=where, expected=f"at most {MAX_BYTES} bytes")
    try:
        data = tomllib.loads(existing(path).read_text(encoding="utf-8-sig"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise UsageError("is not TOML", where=where, got=str(error)[:200]) from None
    if "port" in data and "ports" not in data:
        data["ports"] = _in_order(_tables(data, "port", where), where)
        del data["port"]
    _known(data, _TOP, where)
    ports = tuple(
        _port(item, f"{where}: ports {i}")
        for i, item in enumerate(_tables(data, "ports", where), 1)
    )
    names = [port.name.lower() for port in ports]
    if len(set(names)) < len(names):
        raise UsageError("two ports have one name", where=where, got=", ".join(names))
    fixed = tuple(
        _fixed(item, f"{where}: fixed {i}")
        for i, item in enumerate(_tables(data, "fixed", where), 1)
    )
    alpha, beta = _damping(data.get("damping", {}), f"{where}: damping")
    return Sidecar(
        where=where, ports=ports, fixed=fixed, band=_band(data.get("band"), f"{where}: band"),
        symmetric=_one_of(data, "symmetric", (None, True, False), where),
        files={k: _file(v, path, f"{where}: files.{k}")
               for k, v in _letters(data, "files", where).items()},
        matrices={k: _text(v, f"{where}: matrices.{k}")
                  for k, v in _letters(data, "matrices", where).items()},
        mesh=_file(data["mesh"], path, f"{where}: mesh") if "mesh" in data else None,
        dofs=_file(data["dofs"], path, f"{where}: dofs") if "dofs" in data else None,
        length=LENGTHS[_one_of(data, "length", tuple(LENGTHS), where)],
        force=FORCES[_one_of(data, "force", tuple(FORCES), where)],
        alpha=alpha, beta=beta,
    )  # fmt: skip


def _known(table: Any, keys: set[str], where: str) -> None:
    if not isinstance(table, dict):
        raise UsageError("is no table", where=where, got=table, expected=", ".join(sorted(keys)))
    unknown = sorted(set(table) - keys)
    if unknown:
        got, expected = ", ".join(unknown), ", ".join(sorted(keys))
        raise UsageError("unknown keys", where=where, got=got, expected=expected)


def _tables(data: dict[str, Any], key: str, where: str) -> list[Any]:
    value = data.get(key, [])
    if not isinstance(value, list):
        raise UsageError("is no list of tables", where=f"{where}: {key}", expected=f"[[{key}]]")
    return value


def _in_order(items: list[Any], where: str) -> list[dict[str, Any]]:
    """``[[port]]`` tables with a direction as ``[[ports]]`` tables with columns and rows."""
    found, columns, rows = [], 0, 0
    for number, item in enumerate(items, 1):
        at = f"{where}: port {number}"
        _known(item, {"name", "direction", "unit", "scale", "kind", "pins"}, at)
        direction = item.get("direction")
        if direction not in ("in", "out", "both"):
            expected = "in, out or both"
            raise UsageError("no such direction", where=at, got=direction, expected=expected)
        rest = {key: value for key, value in item.items() if key != "direction"}
        columns += direction != "out"
        rows += direction != "in"
        if direction == "both":
            rest["column"] = columns
        else:
            rest["kind"] = "input" if direction == "in" else "output"
            rest |= {"column": columns} if direction == "in" else {"row": rows}
        found.append(rest)
    return found


def _letters(data: dict[str, Any], key: str, where: str) -> dict[str, Any]:
    table = data.get(key, {})
    _known(table, set(LETTERS), f"{where}: {key}")
    return dict(table)


def _one_of(data: dict[str, Any], key: str, choices: tuple[Any, ...], where: str) -> Any:
    value = data.get(key, choices[0])
    if not any(value is c or (isinstance(c, str) and value == c) for c in choices):
        expected = ", ".join(
            str(c).lower() if isinstance(c, bool) else str(c) for c in choices if c is not None
        )
        raise UsageError("unknown value", where=f"{where}: {key}", got=value, expected=expected)
    return value


def _text(value: Any, where: str) -> str:
    if not isinstance(value, str) or not value.isprintable() or not 0 < len(value) <= 200:
        raise UsageError("is no name", where=where, got=repr(value)[:200], expected="a text")
    return value


def _file(value: Any, sidecar: Path, where: str) -> Path:
    """A file beside the sidecar or below: never elsewhere, so that a stranger's sidecar cannot
    look around.
    """
    name = Path(_text(value, where))
    if name.is_absolute() or ".." in name.parts:
        raise UsageError(
            "is not beside the TOML file", where=where, got=str(name), expected="a relative path"
        )
    return sidecar.parent / name


def _plain(value: Any) -> bool:
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return number and bool(np.isfinite(value))


def _numbers(value: Any, count: int) -> bool:
    return isinstance(value, list) and len(value) == count and all(_plain(x) for x in value)


def _place(item: dict[str, Any], where: str) -> Place:
    given = sorted(_PLACE & set(item) - {"within"})
    if len(given) > 1:
        raise UsageError("nodes are given twice", where=where, got=", ".join(given))
    nodes = item.get("nodes", [item["node"]] if "node" in item else [])
    if not isinstance(nodes, list) or not all(type(n) is int and abs(n) < 2**40 for n in nodes):
        raise UsageError("is no node", where=where, got=nodes, expected="whole numbers")
    if "nodes" in item and not nodes:
        raise UsageError("is an empty list", where=f"{where}: nodes", expected="node numbers")
    at = item.get("at")
    if at is not None and not _numbers(at, 3):
        raise UsageError("is no point", where=f"{where}: at", got=at, expected="[x, y, z]")
    within = item.get("within")
    if within is not None and not (_plain(within) and within >= 0 and at is not None):
        expected = "a distance, with 'at'"
        raise UsageError("is no distance", where=f"{where}: within", got=within, expected=expected)
    nodeset = _text(item["nodeset"], f"{where}: nodeset") if "nodeset" in item else None
    return Place(tuple(nodes), nodeset, tuple(at) if at else None, within)


def _dof(value: Any, where: str) -> int:
    if isinstance(value, str) and value.lower() in CODES:
        return CODES[value.lower()]
    if type(value) is int and value in DOFS:
        return value
    expected = ", ".join(CODES)
    raise UsageError(
        "no such degree of freedom", where=f"{where}: dof", got=value, expected=expected
    )


def _axis(value: Any, where: str) -> tuple[float, float, float] | None:
    if value is None:
        return None
    if isinstance(value, str) and value in _AXES:
        return _AXES[value]
    if _numbers(value, 3) and any(value):
        x, y, z = np.asarray(value, dtype=float) / np.linalg.norm(value)
        return float(x), float(y), float(z)
    expected = "'x', 'y', 'z' or a direction [x, y, z]"
    raise UsageError("is no axis", where=f"{where}: axis", got=value, expected=expected)


def _fixed(item: Any, where: str) -> Fixed:
    _known(item, _FIXED, where)
    place = _place(item, where)
    if not place:
        expected = "node, nodes, nodeset or at"
        raise UsageError("says nothing of where", where=where, got=item, expected=expected)
    dofs = item.get("dof", [])
    dofs = dofs if isinstance(dofs, list) else [dofs]
    return Fixed(place, tuple(_dof(d, where) for d in dofs), where)


def _port(item: Any, where: str) -> PortEntry:
    _known(item, _PORT, where)
    name = _text(item.get("name"), f"{where}: name")
    where = f"{where} ({name})"
    kind = item.get("kind")
    if kind not in _KINDS:
        expected = ", ".join(_KINDS)
        raise UsageError("no such kind", where=f"{where}: kind", got=kind, expected=expected)
    place, dof = _place(item, where), item.get("dof")
    axis = _axis(item.get("axis"), where)
    column, row = (_position(item.get(key), f"{where}: {key}") for key in ("column", "row"))
    entry = PortEntry(
        name, kind, where, place, None if dof is None else _dof(dof, where), axis, column, row,
        _unit(item.get("unit"), where), _scale(item.get("scale", 1.0), kind, where),
        _pins(item.get("pins", []), where),
    )  # fmt: skip
    _consistent(entry)
    return entry


def _consistent(entry: PortEntry) -> None:
    """One way of saying where the port acts, and one direction."""

    def refuse(got: str, expected: str) -> None:
        raise UsageError("is not one port", where=entry.where, got=got, expected=expected)

    counted = entry.column is not None or entry.row is not None
    if counted and (entry.place or entry.dof is not None or entry.axis is not None):
        refuse("column or row beside nodes", "either of them")
    if entry.row is not None and entry.kind != "output":
        refuse("row", "'row' for an output; 'column' for every other port")
    if entry.column is not None and entry.kind == "output":
        refuse("column", "'row' for an output")
    if counted:
        return
    if entry.kind == "acceleration":
        if entry.axis is None or entry.place or entry.dof is not None:
            refuse("no axis" if entry.axis is None else "a node", "'axis' and nothing else")
        return
    if not entry.place:
        refuse("no place", "node, nodes, nodeset, at, column or row")
    if entry.kind == "electrical":
        if entry.axis is not None or entry.dof not in (None, CODES["volt"]):
            refuse("a direction", "nodes only, their freedom is 'volt'")
    elif (entry.dof is None) == (entry.axis is None):
        refuse("dof and axis" if entry.axis else "neither dof nor axis", "'dof' or 'axis'")


def _position(value: Any, where: str) -> int | None:
    if value is None:
        return None
    if type(value) is not int or value < 1:
        raise UsageError("is no position", where=where, got=value, expected="1, 2, ...")
    return int(value)


def _unit(value: Any, where: str) -> str:
    """A unit goes into the header of a netlist, so it is one printable word."""
    if value is None:
        return ""
    text = _text(value, f"{where}: unit")
    if len(text.split()) != 1 or len(text) > 32:
        raise UsageError("is no unit", where=f"{where}: unit", got=text, expected="one word")
    return text


def _scale(value: Any, kind: str, where: str) -> float:
    if not _plain(value) or value <= 0 or (kind in CONSERVATIVE and value != 1):
        expected = "a positive number; none for a conservative port"
        raise UsageError("is no scale", where=f"{where}: scale", got=value, expected=expected)
    return float(value)


def _pins(value: Any, where: str) -> tuple[str, ...]:
    if not isinstance(value, list) or len(value) > 2:
        raise UsageError(
            "are no pins", where=f"{where}: pins", got=value, expected="one or two names"
        )
    return tuple(_text(pin, f"{where}: pins") for pin in value)


def _band(value: Any, where: str) -> tuple[float, float] | None:
    if value is None:
        return None
    if _numbers(value, 2) and 0 <= value[0] < value[1]:
        return float(value[0]), float(value[1])
    expected = "[f0, f1] with 0 <= f0 < f1, Hz"
    raise UsageError("is no band", where=where, got=value, expected=expected)


def _damping(value: Any, where: str) -> tuple[float, float]:
    _known(value, {"alpha", "beta", "ratio", "at"}, where)
    if any(not _plain(x) or x < 0 for x in value.values()):
        raise UsageError("is no damping", where=where, got=value, expected="numbers from 0 on")
    if set(value) <= {"alpha", "beta"}:
        return float(value.get("alpha", 0.0)), float(value.get("beta", 0.0))
    if set(value) != {"ratio", "at"} or not value["at"]:
        raise UsageError("is no damping", where=where, got=value,
                         expected="alpha and beta, or ratio and at [Hz]")  # fmt: skip
    return 0.0, 2 * float(value["ratio"]) / (2 * np.pi * float(value["at"]))
