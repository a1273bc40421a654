"""Matrices of other tools: any of their files to a linear model with ports."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from kc2spice.bodies.readers import sidecar as _sidecar
from kc2spice.bodies.readers.assemble import Rows, assemble
from kc2spice.bodies.readers.mesh import read_mesh
from kc2spice.bodies.readers.source import described, open_source
from kc2spice.rom.linear import LinearModel

FORMATS = """\
NAME of Matrix Market or Harwell-Boeing files NAME.M .E .K .B .C (first order .A .B .C .D .E; heat
.E .K), also NAME.K.mtx, NAME_K.mtx, NAME_K.matrix; a .npz or .mat file with such matrices or one
mphmatrix struct (COMSOL); JOB_STIF1.mtx (Abaqus); JOB.sti (CalculiX); a punch file with DMIG cards
or .op4 (Nastran); .full (Ansys); or a TOML file that names the files"""

SIDECAR_KEYS = _sidecar.__doc__ or ""  # every key of NAME.toml, for --help and the docs


def read_model(path: Path | str, sidecar: Path | str | None = None) -> LinearModel:
    """Read the model at ``path`` with the ports that ``sidecar`` (``NAME.toml`` beside it) names.

    Second order ``M x'' + E x' + K x = B u``, ``y = C x + D u``; first order ``E x' = A x + B u``;
    heat ``E x' + K x = B u`` (E and K without M and A). Missing E is zero (second order) or one
    (first order), a missing C is ``B'``, a missing D zero. ``path`` may be any file of the model,
    or a TOML file with ``files``; formats are listed in :data:`FORMATS`, the keys of the TOML file
    in :mod:`kc2spice.bodies.readers.sidecar`.

    Raises
    ------
    UsageError : no such model; a file that is damaged, too large, half stored, or not real and
        finite; matrices or ports that do not fit together. The message names the file, the key,
        what was found and what was expected.
    MissingToolError : the format needs a package that is not installed; the message says which.
    """
    name, said, raw = open_source(Path(path), None if sidecar is None else Path(sidecar))
    return assemble(Rows(name, str(path), said, raw, raw.matrices))


def extent(path: Path, sidecar: Path | None) -> np.ndarray | None:
    """Size (3,) [m] of the mesh that the TOML file names; None where it names none.

    Raises
    ------
    UsageError : a sidecar or a mesh that is wrong.
    """
    _, said = described(path, sidecar)
    if said.mesh is None:
        return None
    return np.asarray(_sidecar.LENGTHS[said.length] * np.ptp(read_mesh(said.mesh).at, axis=0))
