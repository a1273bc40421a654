"""Ansys' binary ``.full`` file through ansys-mapdl-reader, which the makers of Ansys keep."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from scipy import sparse

from kc2spice.bodies.readers.archive import packed, read_in_child
from kc2spice.bodies.readers.raw import CODES, Raw
from kc2spice.core.errors import MissingToolError
from kc2spice.rom.matrix_market import mirrored

# Ansys counts freedoms from 0 in this file: UX UY UZ ROTX ROTY ROTZ AX AY AZ VX VY VZ ... TEMP VOLT
_KINDS = dict(enumerate(("ux", "uy", "uz", "rx", "ry", "rz", "ax", "ay", "az", "vx", "vy", "vz")))
_KINDS |= {
    15: "warp",
    16: "conc",
    17: "hdsp",
    18: "pres",
    19: "temp",
    20: "volt",
    21: "mag",
    22: "enke",
    23: "ends",
    24: "emf",
    25: "curr",
}


def read_full(path: Path) -> Raw:
    """Stiffness and mass of a ``.full`` file; freedoms that Ansys constrains are marked as held.

    Raises
    ------
    UsageError : damaged, or without a symmetric stiffness.
    MissingToolError : ansys-mapdl-reader is not installed.
    """
    return read_in_child(path, "a symmetric .full file of Ansys", f"{__name__}:unpack")


def unpack(path: str) -> dict[str, np.ndarray]:
    """The matrices of a ``.full`` file as arrays of an archive.

    Raises
    ------
    MissingToolError : ansys-mapdl-reader is not installed.
    """
    try:
        from ansys.mapdl.reader.full import FullFile
    except ImportError:
        raise MissingToolError(
            "ansys-mapdl-reader is not installed",
            where=path,
            expected="it to read .full files",
            hint="pip install 'kc2spice[ansys]'",
        ) from None
    file = FullFile(path)
    place, stiffness, mass = file.load_km()
    place = np.asarray(place, dtype=np.int64)
    kind = np.array([CODES[_KINDS[int(k)]] for k in place[:, 1]])
    found = {"nodes": place[:, 0], "dofs": kind, "held": _held(file, place)}
    for letter, matrix in (("K", stiffness), ("M", mass)):  # the upper triangle is stored
        found |= packed(letter, mirrored(sparse.csc_array(matrix)))
    return found


def _held(file: Any, place: np.ndarray) -> np.ndarray:
    """Rows of constrained freedoms, which the reader leaves empty."""
    const = np.asarray(file.const, dtype=np.int64).reshape(-1, 2)
    keys = place[:, 0] * 64 + place[:, 1]
    return np.flatnonzero(np.isin(keys, const[:, 0] * 64 + const[:, 1]))
