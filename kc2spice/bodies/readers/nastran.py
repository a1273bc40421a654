"""Nastran's matrices: DMIG cards of a punch file, and OUTPUT4 files through pyyeti.

``K...`` is the stiffness, ``M...`` the mass, ``B...`` the viscous damping, unless the sidecar's
``matrices`` names others. DMIG: MSC Nastran Quick Reference Guide; large, small and free fields.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
from scipy import sparse

from kc2spice.bodies.readers.archive import packed
from kc2spice.bodies.readers.raw import (
    Raw,
    Triple,
    bounded,
    keyed,
    labelled,
    parsed,
    refused,
    whole,
)
from kc2spice.core.errors import needed

_FIRST = {"K": "K", "M": "M", "B": "E"}
_SHORT_EXPONENT = re.compile(r"(?<=[0-9.])([+-]\d+)$")  # 1.5+7 is 1.5e+7
_SQUARE, _SYMMETRIC = 1, 6


def choose(names: list[str], wanted: Mapping[str, str], path: Path) -> dict[str, str]:
    """Which of the file's matrices stands for which letter.

    Raises
    ------
    UsageError : a name that is not there, or two that may stand for one letter.
    """
    known = {name.upper(): name for name in names}
    chosen = {}
    for letter, name in wanted.items():
        if name.upper() not in known:
            raise refused(path, f"no matrix {name}", f"one of {', '.join(names)}")
        chosen[letter] = known[name.upper()]
    for first, letter in _FIRST.items():
        fits = [n for u, n in known.items() if u.startswith(first) and not u.startswith("K4")]
        if letter in chosen or not fits or wanted:
            continue
        if len(fits) > 1:
            raise refused(
                path,
                f"matrices {', '.join(fits)}",
                f"one that is {letter}",
                hint=f'matrices = {{ {letter} = "{fits[0]}" }} in the TOML file',
            )
        chosen[letter] = fits[0]
    if not chosen:
        raise refused(path, f"matrices {', '.join(names)}", "K..., M... and as needed B...")
    return chosen


def read_dmig(path: Path, wanted: Mapping[str, str]) -> Raw:
    """Matrices of the DMIG cards in ``path``, rows named by grid and component.

    Raises
    ------
    UsageError : no such cards, complex or rectangular ones, or damage.
    """
    expected = "real, square DMIG cards"
    forms, entries = parsed(path, expected, _dmig)
    chosen = choose([n for n, f in forms.items() if f in (_SQUARE, _SYMMETRIC)], wanted, path)
    matrices, dofs = labelled({letter: entries[name] for letter, name in chosen.items()})
    symmetric = {k for k, name in chosen.items() if forms[name] == _SYMMETRIC}
    return Raw({k: whole(m) if k in symmetric else m for k, m in matrices.items()}, dofs)


def _dmig(data: bytes) -> tuple[dict[str, int], dict[str, Triple]]:
    """Form of each matrix by name, and its keys of rows and columns and values."""
    forms: dict[str, int] = {}
    entries: dict[str, list[tuple[float, ...]]] = {}
    if data and not data.endswith(b"\n"):
        raise ValueError("the last line has no end: is it cut off?")
    for cells in cards(data, "DMIG"):
        name = cells[0].strip().upper()
        if cells[1].strip() == "0":
            forms[name], entries[name] = int(cells[2]), []
            if int(cells[3]) not in (1, 2):
                raise ValueError(f"matrix {name} is complex")
            continue
        if name not in forms:
            raise ValueError(f"matrix {name} has no header card")
        column = (int(cells[1]), _component(cells[2]))
        for at in range(4, len(cells), 4):
            grid, component, value = [*cells[at : at + 3], "", ""][:3]
            if grid.strip():
                entries[name].append((int(grid), _component(component), *column, real(value)))
    if not forms:
        raise ValueError("no DMIG card")
    return forms, {name: keyed(np.array(e).reshape(-1, 5)) for name, e in entries.items()}


def cards(data: bytes, name: str) -> Iterator[list[str]]:
    """The fields of each card of this name behind it, continuation lines joined; bulk data in
    small, large and free fields."""
    cells: list[str] = []
    for line in data.decode("ascii", "replace").splitlines():
        line = line.split("$", 1)[0].rstrip()
        begins = line[: len(name)].upper() == name
        continues = line[:1] in ("*", "+", ",") or (line and not line[:8].strip())
        if cells and line and not (continues and not begins):
            yield cells
            cells = []
        if begins or (cells and continues):
            cells += _fields(line)
    if cells:
        yield cells


def _fields(line: str) -> list[str]:
    if "," in line:
        cells = line.split(",")[1:9]
        return cells + [""] * (8 - len(cells))
    width, count = (16, 4) if "*" in line[:8] else (8, 8)
    return [line[8 + k * width : 8 + (k + 1) * width] for k in range(count)]


def _component(text: str) -> int:
    value = int(text.strip() or 0)
    if not 0 <= value <= 6:
        raise ValueError(f"component {value}")
    return value


def real(text: str) -> float:
    """A number as Fortran writes it: 1.5D+7, or 1.5+7."""
    return float(_SHORT_EXPONENT.sub(r"E\1", text.strip().upper().replace("D", "E")))


def unpack_op4(path: str, wanted: Mapping[str, str]) -> dict[str, np.ndarray]:
    """The matrices of an OUTPUT4 file, text or binary, of either byte order, as arrays of an
    archive.

    Raises
    ------
    UsageError : too large, or no stiffness in it.
    MissingToolError : pyyeti is not installed.
    """
    op4 = needed("pyyeti.nastran.op4", "pyyeti", path, "nastran")
    names, sizes, _, _ = op4.dir(path, verbose=False)
    chosen = choose(list(names), wanted, Path(path))
    for letter, name in chosen.items():
        bounded(Path(path), letter, sizes[names.index(name)], None)
    loaded = op4.load(path, list(chosen.values()), sparse=True)
    found: dict[str, np.ndarray] = {}
    for letter, name in chosen.items():
        matrix, form = sparse.csc_array(loaded[name][0]), loaded[name][1]
        found |= packed(letter, whole(matrix) if form == _SYMMETRIC else matrix)
    return found
