"""MATLAB files, read in a process of their own: scipy's reader may crash on a corrupt one.

The child writes the wanted variables as an ``.npz`` archive in the parts that
:mod:`kc2spice.rom.foreign_files` knows, or says on stderr what is wrong.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
from scipy import io, sparse

_OTHER = ("cell", "struct", "object", "char", "function", "opaque")


def unpack(path: Path, archive: Path, letters: tuple[str, ...], limit: int) -> None:
    """Write the variables ``letters`` of ``path`` into ``archive``, none of more than ``limit``
    entries, from a child process.

    Raises
    ------
    ValueError : the file is damaged or holds something else than numbers, with the reason.
    NotImplementedError : version 7.3.
    """
    command = [sys.executable, "-m", __name__, str(path), str(archive), str(limit), *letters]
    root = Path(__file__).parents[2]  # the child must find this package, installed or not
    ran = subprocess.run(command, capture_output=True, text=True, check=False, cwd=root)
    if ran.returncode == 0:
        return
    said = ran.stderr.strip().splitlines()
    reason = said[-1] if said and ran.returncode > 0 else "it makes the reader crash"
    raise (NotImplementedError if "HDF" in reason else ValueError)(reason)


def _main(path: str, archive: str, limit: str, *letters: str) -> None:
    wanted = []
    for name, shape, kind in io.whosmat(path):
        if name in letters:
            if kind in _OTHER:
                raise ValueError(f"variable {name} is a {kind}")
            if kind != "sparse" and np.prod(shape, dtype=float) > int(limit):
                raise ValueError(f"variable {name} of {shape} is too large")
            wanted.append(name)
    loaded = io.loadmat(path, variable_names=wanted) if wanted else {}
    parts = {}
    for name in wanted:
        matrix = loaded[name]
        if not sparse.issparse(matrix):
            parts[name] = matrix
            continue
        csc = matrix.asformat("csc") if matrix.format != "csc" else matrix
        parts |= {f"{name}.{key}": getattr(csc, key) for key in ("data", "indices", "indptr")}
        parts |= {f"{name}.shape": np.array(csc.shape), f"{name}.format": np.array("csc")}
    np.savez(archive, **parts)


if __name__ == "__main__":
    try:
        _main(*sys.argv[1:])
    except Exception as error:  # a damaged file makes the parser raise nearly anything
        sys.exit(" ".join(str(error).split())[:200] or type(error).__name__)
