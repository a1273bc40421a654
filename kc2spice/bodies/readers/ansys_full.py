"""Ansys' binary ``.full`` file through ansys-mapdl-reader, which the makers of Ansys keep."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from kc2spice.bodies.readers.archive import packed
from kc2spice.bodies.readers.raw import CODES
from kc2spice.core.errors import needed
from kc2spice.rom.matrix_market import mirrored

# Ansys counts freedoms in this file from 0.
_KINDS = dict(enumerate((
    "ux", "uy", "uz", "rx", "ry", "rz", "ax", "ay", "az", "vx", "vy", "vz", "", "", "", "warp",
    "conc", "hdsp", "pres", "temp", "volt", "mag", "enke", "ends", "emf", "curr",
)))  # fmt: skip


def unpack(path: str, wanted: dict[str, str]) -> dict[str, np.ndarray]:
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
    found = {"nodes": place[:, 0], "dofs": kind, "held": _held(file, place)}
    for letter, matrix in (("K", stiffness), ("M", mass)):  # the upper triangle is stored
        found |= packed(letter, mirrored(sparse.csc_array(matrix)))
    return found


def _held(file: Any, place: np.ndarray) -> np.ndarray:
    """Rows of constrained freedoms, which the reader leaves empty."""
    const = np.asarray(file.const, dtype=np.int64).reshape(-1, 2)
    keys = place[:, 0] * 64 + place[:, 1]
    return np.flatnonzero(np.isin(keys, const[:, 0] * 64 + const[:, 1]))
