"""Files with many arrays: ``.npz`` archives, of which nothing is unpickled, and MATLAB files.

An archive has dense arrays of the names ``M``, ``E``, ``K``, ``A``, ``B``, ``C``, ``D``, or the
parts of a sparse matrix as ``scipy.sparse.save_npz`` names them behind the letter and a dot
(``K.format``, ``K.shape``, ``K.data``, ``K.indices``, ``K.indptr``; coo has ``K.row``, ``K.col``).
``nodes`` (n,) and ``dofs`` (n,), integers, may name the rows. Readers in a process of their own, as
that of MATLAB files is, since scipy's may crash on a corrupt one, hand over the same form.

A MATLAB file has variables of these names, or one struct as COMSOL's ``mphmatrix`` and ``mphstate``
return it. It writes ``E u'' + D u' + K u = L``, so its ``E`` is our mass, its ``D`` our damping,
its ``L`` our ``B``; the eliminated ``Ec``, ``Dc``, ``Kc``, ``Lc`` are taken where they exist.
``mphstate`` gives ``Mc x' = MA x + MB u`` (or ``A``, ``B``) and ``y = C x + D u``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy import io, sparse

from kc2spice.bodies.readers.raw import (
    LETTERS,
    MAX_DENSE,
    MAX_ENTRIES,
    Dofs,
    Raw,
    bounded,
    unpacked,
)
from kc2spice.core import foreign
from kc2spice.core.child import in_child

_NAMES = ("nodes", "dofs")
_SECONDS = 8, 1_000_000  # of the processor for a small file; bytes a second of a large one
_MEMORY = 1_300_000_000  # bytes, libraries included, beside what the file may come to
_OTHER = ("cell", "object", "char", "function", "opaque")
# Fields of the structs by letter, the first that is there.
_STATE = {"E": ("Mc",), "A": ("MA", "A"), "B": ("MB", "B"), "C": ("C",), "D": ("D",)}
_SECOND = {"M": ("Ec", "E"), "E": ("Dc", "D"), "K": ("Kc", "K"), "B": ("Lc", "L")}


def read_archive(path: Path, _: object) -> Raw:
    """Matrices of the archive at ``path``.

    Raises
    ------
    UsageError, ValueError : missing, damaged, too large, with Python objects, or parts that make
        no matrix.
    """

    def wanted(name: str) -> bool:
        return name.split(".")[0] in (*LETTERS, *_NAMES)

    def largest(name: str) -> int:
        return MAX_DENSE if name in LETTERS else MAX_ENTRIES

    total = unpacked(path)
    return _raw(foreign.read_archive(path, wanted, entries=largest, total=total), path)


def in_own_process(function: Callable[..., object]) -> Callable[[Path, Mapping[str, str]], Raw]:
    """A reader of what ``function(path, wanted)`` packs in a process of its own, whose memory and
    time are bounded by the size of the file.

    It raises UsageError or ValueError of a file that is missing or too large and of anything else
    that goes wrong there, MissingToolError where the function needs a package that is not there.
    """

    def read(path: Path, wanted: Mapping[str, str]) -> Raw:
        memory = _MEMORY + 2 * unpacked(path)
        seconds = _SECONDS[0] + path.stat().st_size // _SECONDS[1]
        request = {"path": str(path.absolute()), "wanted": dict(wanted)}
        name = f"{function.__module__}:{function.__name__}"
        return _raw(in_child(name, request, memory=memory, seconds=seconds), path)

    return read


def packed(name: str, matrix: Any) -> dict[str, np.ndarray]:
    """A matrix, or the numbers of rows, as the arrays of an archive."""
    if not sparse.issparse(matrix):
        return {name: np.asarray(matrix)}
    csc = matrix.tocsc()
    parts = {f"{name}.{key}": getattr(csc, key) for key in ("data", "indices", "indptr")}
    return {**parts, f"{name}.shape": np.array(csc.shape), f"{name}.format": np.array("csc")}


def _raw(arrays: Mapping[str, np.ndarray], path: Path) -> Raw:
    found = {}
    for letter in LETTERS:
        parts = {k.partition(".")[2]: a for k, a in arrays.items() if k.split(".")[0] == letter}
        if parts:
            found[letter] = parts[""] if "" in parts else _sparse(path, letter, parts)
    return Raw(found, _dofs(arrays), arrays.get("held", np.empty(0, dtype=np.int64)))


def _sparse(path: Path, letter: str, parts: dict[str, np.ndarray]) -> sparse.csc_array:
    kind = str(parts["format"].item()) if "format" in parts else "coo"
    kind = kind.removeprefix("b'").removesuffix("'")
    rows, columns = (int(k) for k in parts["shape"])
    bounded(path, letter, (rows, columns), parts["data"].size)
    if kind == "coo":
        inner = (parts["data"], (parts["row"], parts["col"]))
        return sparse.csc_array(sparse.coo_array(inner, shape=(rows, columns)))
    maker = {"csc": sparse.csc_array, "csr": sparse.csr_array}[kind]
    matrix = maker((parts["data"], parts["indices"], parts["indptr"]), shape=(rows, columns))
    matrix.check_format(full_check=True)
    return sparse.csc_array(matrix)


def _dofs(arrays: Mapping[str, np.ndarray]) -> Dofs | None:
    given = [np.asarray(arrays[name]).ravel() for name in _NAMES if name in arrays]
    if not given:
        return None
    if len(given) == 1 or any(array.dtype.kind not in "iu" for array in given):
        raise ValueError("nodes and dofs are not integers, one of each for every row")
    return Dofs(*given)


# --- MATLAB ---------------------------------------------------------------------------------------


def unpack_matlab(path: str, wanted: dict[str, str]) -> dict[str, np.ndarray]:
    """The matrices of a MATLAB file as arrays of an archive; other variables are not looked at, and
    ``wanted`` means nothing here.

    Raises
    ------
    ValueError, NotImplementedError : nearly anything that is wrong with it.
    """
    names = (*LETTERS, *_NAMES)
    kinds = {name: (shape, kind) for name, shape, kind in io.whosmat(path, appendmat=False)}
    plain = [name for name in names if name in kinds]
    structs = [name for name, (_, kind) in kinds.items() if kind == "struct"]
    if not set(plain) & set(LETTERS) and len(structs) == 1:
        found = _struct(
            io.loadmat(path, appendmat=False, variable_names=structs)[structs[0]], structs[0]
        )
    else:
        for name in plain:
            shape, kind = kinds[name]
            if kind in (*_OTHER, "struct"):
                raise ValueError(f"variable {name} is a {kind}")
            if kind != "sparse" and 8 * np.prod(shape, dtype=float) > unpacked(Path(path)):
                raise ValueError(f"variable {name} of {shape} is too large")
        found = io.loadmat(path, appendmat=False, variable_names=plain) if plain else {}
    parts: dict[str, np.ndarray] = {}
    for name in names:
        if name in found:
            parts |= packed(name, _plain(name, found[name]))
    return parts


def vectors(path: str) -> dict[str, np.ndarray]:
    """Numeric arrays of a MATLAB file with a measured response, all that is not sparse; none of a
    file that has the matrices of a model.

    Raises
    ------
    ValueError, NotImplementedError : nearly anything that is wrong with it.
    """
    kinds = {name: (shape, kind) for name, shape, kind in io.whosmat(path, appendmat=False)}
    numbers = ("double", "single", "int8", "int16", "int32", "uint8", "uint16", "uint32")
    plain = [name for name, (_, kind) in kinds.items() if kind in numbers]
    if {"M", "K", "A"} & set(kinds):
        return {}
    size = sum(8 * np.prod(kinds[name][0], dtype=float) for name in plain)
    if size > unpacked(Path(path)):
        raise ValueError(f"its variables of {size:g} bytes are too large")
    found = io.loadmat(path, appendmat=False, variable_names=plain) if plain else {}
    return {name: np.asarray(found[name]) for name in plain if found[name].size}


def _plain(name: str, matrix: Any) -> Any:
    if sparse.issparse(matrix):
        return _real(matrix.tocsc())
    matrix = _real(np.asarray(matrix))
    if name in _NAMES:  # MATLAB's numbers are doubles
        if not (matrix == np.floor(matrix)).all():
            raise ValueError(f"variable {name} holds fractions")
        return matrix.astype(np.int64)
    return matrix


def _real(matrix: Any) -> Any:
    """COMSOL marks real matrices as complex where a solver was complex."""
    data = matrix.data if sparse.issparse(matrix) else matrix
    return matrix.real if np.iscomplexobj(data) and not data.imag.any() else matrix


def _struct(value: Any, name: str) -> dict[str, Any]:
    if value.shape != (1, 1) or value.dtype.names is None:
        raise ValueError(f"struct {name} is an array of structs")
    fields = {key: value[0, 0][key] for key in value.dtype.names}

    def pick(table: Mapping[str, tuple[str, ...]]) -> dict[str, Any]:
        there = {letter: [k for k in keys if k in fields] for letter, keys in table.items()}
        return {letter: fields[keys[0]] for letter, keys in there.items() if keys}

    if "MA" in fields or ("A" in fields and "K" not in fields):
        return pick(_STATE)
    if not {"K", "Kc"} & set(fields):
        raise ValueError(f"struct {name} has fields {', '.join(fields)}; K or Kc is needed")
    found = pick(_SECOND)
    if "Kc" not in fields and "N" in fields and _entries(fields["N"]):
        raise ValueError(f"struct {name} has constraints N that are not eliminated: ask for Kc, Ec")
    if "Kc" in fields and "uscale" in fields and (np.asarray(fields["uscale"]) != 1).any():
        raise ValueError(f"struct {name} is in unknowns over uscale: scale by None in the solver")
    # Without a mass the problem is of first order and keeps its E; without a load the ports come
    # from the TOML file.
    absent = {letter for letter in "MEB" if letter in found and not _entries(found[letter])}
    if "M" not in found or "M" in absent:
        absent -= {"E"}
    return {letter: matrix for letter, matrix in found.items() if letter not in absent}


def _entries(matrix: Any) -> int:
    return int(matrix.count_nonzero() if sparse.issparse(matrix) else np.count_nonzero(matrix))
