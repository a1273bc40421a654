"""Ansys' binary ``.full`` file through ansys-mapdl-reader, which the makers of Ansys keep."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from scipy import sparse

from kc2spice.bodies.readers.limits import checked, existing, guarded
from kc2spice.bodies.readers.raw import CODES, Dofs, Raw
from kc2spice.core.errors import MissingToolError
from kc2spice.rom.matrix_market import mirrored

# Ansys counts freedoms from 0 in this file: UX UY UZ ROTX ROTY ROTZ AX AY AZ VX VY VZ ... TEMP VOLT
_KINDS = dict(enumerate(("ux", "uy", "uz", "rx", "ry", "rz", "ax", "ay", "az", "vx", "vy", "vz")))
_KINDS |= {15: "warp", 16: "conc", 17: "hdsp", 18: "pres", 19: "temp", 20: "volt", 21: "mag",
           22: "enke", 23: "ends", 24: "emf", 25: "curr"}  # fmt: skip


def read_full(path: Path) -> Raw:
    """Stiffness and mass of a ``.full`` file; freedoms that Ansys constrains are marked as held.

    Raises
    ------
    UsageError : damaged, or without a symmetric stiffness.
    MissingToolError : ansys-mapdl-reader is not installed.
    """
    try:
        from ansys.mapdl.reader.full import FullFile
    except ImportError:
        raise MissingToolError(
            "ansys-mapdl-reader is not installed", where=str(path),
            expected="it to read .full files", hint="pip install 'kc2spice[ansys]'",
        ) from None  # fmt: skip
    existing(path)

    def load() -> Raw:
        file = FullFile(str(path))
        place, stiffness, mass = file.load_km()
        place = np.asarray(place, dtype=np.int64)
        kind = np.array([CODES[_KINDS[int(k)]] for k in place[:, 1]])
        matrices = {"K": stiffness, "M": mass}
        # the upper triangle is stored
        found = {k: checked(mirrored(sparse.csc_array(m)), k, path) for k, m in matrices.items()}
        return Raw(found, Dofs(place[:, 0], kind), _held(file, place))

    return guarded(path, "a symmetric .full file of Ansys", load)


def _held(file: Any, place: np.ndarray) -> np.ndarray:
    """Rows of constrained freedoms, which the reader leaves empty."""
    const = np.asarray(file.const, dtype=np.int64).reshape(-1, 2)
    keys = place[:, 0] * 64 + place[:, 1]
    return np.flatnonzero(np.isin(keys, const[:, 0] * 64 + const[:, 1]))
