"""What Ansys writes: the binary ``.full`` file, read through its makers' ansys-mapdl-reader, and
``HBMAT``'s Harwell-Boeing files, symmetric ones too, with the mapping beside them.

scipy's ``hb_read`` refuses symmetric matrices. Fields have a fixed width and may touch, so they are
cut by the widths that the header states.
Format: Duff, Grimes, Lewis, Users' Guide for the Harwell-Boeing Sparse Matrix Collection (1992).
"""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
from scipy import sparse

from kc2spice.bodies.readers.archive import packed
from kc2spice.bodies.readers.raw import CODES, Dofs
from kc2spice.core.errors import needed
from kc2spice.rom.matrix_market import indices, mirrored

# Ansys counts freedoms in this file from 0.
_KINDS = dict(enumerate((
    "ux", "uy", "uz", "rx", "ry", "rz", "ax", "ay", "az", "vx", "vy", "vz", "", "", "", "warp",
    "conc", "hdsp", "pres", "temp", "volt", "mag", "enke", "ends", "emf", "curr",
)))  # fmt: skip
EXPECTED = "an assembled, real Harwell-Boeing file: type RSA, RUA, RZA or RRA, in ASCII"
_FORMAT = re.compile(rb"\(?\s*(?:\d*P,?)?\s*(\d*)\s*[IFEDG](\d+)", re.IGNORECASE)
_TYPE = re.compile(rb"\s*([RCPrcp][SUHZRsuhzr][AEae])\s")
_LONGEST = 10_000  # characters of a line
_ANSYS = {"ROTX": "rx", "ROTY": "ry", "ROTZ": "rz"}


def unpack_full(path: str, wanted: dict[str, str]) -> dict[str, np.ndarray]:
    """Stiffness and mass of a ``.full`` file as arrays of an archive, with the freedoms that Ansys
    constrains as ``held``; ``wanted`` means nothing here.

    Raises
    ------
    MissingToolError : ansys-mapdl-reader is not installed.
    """
    file = needed("ansys.mapdl.reader.full", "ansys-mapdl-reader", path, "ansys").FullFile(path)
    place, stiffness, mass = file.load_km()
    place = np.asarray(place, dtype=np.int64)
    kind = np.array([CODES[_KINDS[int(k)]] for k in place[:, 1]])
    const = np.asarray(file.const, dtype=np.int64).reshape(-1, 2)  # whose rows are left empty
    keys, constrained = (each[:, 0] * 64 + each[:, 1] for each in (place, const))
    held = np.flatnonzero(np.isin(keys, constrained))
    found = {"nodes": place[:, 0], "dofs": kind, "held": held}
    for letter, matrix in (("K", stiffness), ("M", mass)):  # the upper triangle is stored
        found |= packed(letter, mirrored(sparse.csc_array(matrix)))
    return found


def is_harwell_boeing(head: bytes) -> bool:
    """Whether the first lines of a file are a Harwell-Boeing header."""
    lines = head.split(b"\n", 4)
    return len(lines) > 3 and _TYPE.match(lines[2] + b" ") is not None


def read_harwell_boeing(
    data: bytes, allowed: Callable[[tuple[int, int], int], None]
) -> sparse.csc_array:
    """The matrix of a file's content, whole: the stored triangle of RSA is mirrored.

    ``allowed(shape, entries)`` raises where the declared size is too large, before memory is taken.

    Raises
    ------
    ValueError : binary, elemental, complex, a pattern or damaged.
    """
    lines = data.splitlines()
    if len(lines) < 5:
        raise ValueError("the header is cut off")
    match = _TYPE.match(lines[2] + b" ")
    if match is None:
        raise ValueError(f"the third line is {lines[2][:40]!r}")
    kind = match[1].decode().upper()
    if kind not in ("RSA", "RUA", "RZA", "RRA"):
        raise ValueError(f"type {kind}")
    counts = [int(word) for word in lines[1].split()[:4]]
    rows, columns, entries = (int(word) for word in lines[2].split()[1:4])
    allowed((rows, columns), entries)
    if min(counts) < 0 or (kind in ("RSA", "RZA") and rows != columns):
        raise ValueError("the header is damaged")
    formats = _FORMAT.findall(lines[3])
    if len(formats) < 3:
        raise ValueError("the line of formats is damaged")
    start = 5 if len(counts) > 3 and _right_hand_sides(lines[1]) else 4
    parts = []
    for (repeat, width), length, number in zip(
        formats, counts[1:], (columns + 1, entries, entries), strict=False
    ):
        section = lines[start : start + length]
        parts.append(_fields(section, int(repeat or 1), int(width), number))
        start += length
    pointer, row = parts[0], indices(parts[1], rows)
    sound = pointer[0] == 1 and pointer[-1] == entries + 1 and (np.diff(pointer) >= 0).all()
    if not sound:
        raise ValueError("column pointers do not rise from 1 to the number of entries")
    inner = (parts[2], row, pointer.astype(np.int64) - 1)
    matrix = sparse.csc_array(inner, shape=(rows, columns))
    if kind in ("RUA", "RRA"):
        return matrix
    triangle = sparse.coo_array(matrix)
    if (triangle.row < triangle.col).any() and (triangle.row > triangle.col).any():
        raise ValueError(f"type {kind} with entries on both sides, not one triangle")
    return mirrored(matrix, 1 if kind == "RSA" else -1)


def _right_hand_sides(counts: bytes) -> bool:
    words = counts.split()
    return len(words) > 4 and int(words[4]) > 0


def _fields(lines: list[bytes], repeat: int, width: int, number: int) -> np.ndarray:
    """``number`` values of ``width`` characters, ``repeat`` of them on each line."""
    if len(lines) * repeat < number:
        raise ValueError(f"{len(lines)} lines for {number} numbers: is it cut off?")
    if not 0 < repeat * width <= _LONGEST:
        raise ValueError(f"lines of {repeat} fields of {width} characters")
    text = b"".join(line[: repeat * width].ljust(repeat * width) for line in lines)
    text = text.translate(bytes.maketrans(b"Dd", b"EE"))
    values = np.frombuffer(text, dtype=f"S{width}")[:number]
    return np.char.strip(values).astype(float)


def mapping(data: bytes, size: int) -> Dofs:
    """Node and freedom of each of ``size`` equations from Ansys' ``NAME.mapping``.

    Raises
    ------
    ValueError : damaged, an equation missing or twice, a freedom that is not known.
    """
    rows = [line.split() for line in data.decode("ascii", "replace").splitlines()]
    rows = [row for row in rows if row and row[0].isdigit()]
    if len(rows) != size or any(len(row) != 3 for row in rows):
        raise ValueError(f"{len(rows)} equations")
    names = [_ANSYS.get(row[2].upper(), row[2].lower()) for row in rows]
    unknown = sorted(set(names) - set(CODES))
    if unknown:
        raise ValueError(f"freedom {unknown[0]}")
    place = indices(np.array([float(row[0]) for row in rows]), size)
    if len(np.unique(place)) < size:
        raise ValueError("an equation stands there twice")
    node, kind = np.empty(size, dtype=np.int64), np.empty(size, dtype=np.int64)
    node[place] = [int(row[1]) for row in rows]
    kind[place] = [CODES[name] for name in names]
    return Dofs(node, kind)
