"""From a path to the files of one model and their raw contents."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kc2spice.bodies.readers import abaqus
from kc2spice.bodies.readers.ansys_full import read_full
from kc2spice.bodies.readers.archive import read_archive
from kc2spice.bodies.readers.calculix import SUFFIXES, read_calculix
from kc2spice.bodies.readers.harwell_boeing import (
    is_harwell_boeing,
    read_harwell_boeing,
    read_mapping,
)
from kc2spice.bodies.readers.limits import (
    LETTERS,
    bounded,
    checked,
    content,
    existing,
    guarded,
    present,
    refused,
)
from kc2spice.bodies.readers.matfile import read_mat
from kc2spice.bodies.readers.nastran import read_dmig, read_op4
from kc2spice.bodies.readers.raw import DOFS, Dofs, Raw
from kc2spice.bodies.readers.sidecar import Sidecar, read_sidecar
from kc2spice.core.errors import UsageError
from kc2spice.rom.matrix_market import BANNER, numbers, read_market
from kc2spice.rom.operators import Matrix

# What may stand behind NAME.K or NAME_K.
_TAILS = ("", ".mtx", ".mm", ".txt", ".matrix", ".hb", ".rsa", ".rua")
_MEMBER = re.compile(r"(.+)([._])([MEKABCD])(\.(?:mtx|mm|txt|matrix|hb|rsa|rua))?")
# One file with all matrices, by its suffix.
READERS: Mapping[str, Callable[[Path, Sidecar], Raw]] = {
    ".npz": lambda path, said: read_archive(path),
    ".mat": lambda path, said: read_mat(path),
    ".full": lambda path, said: read_full(path),
    ".op4": lambda path, said: read_op4(path, said.matrices),
    **{suffix: lambda path, said: read_calculix(path) for suffix in SUFFIXES},
    **{
        suffix: lambda path, said: read_dmig(path, said.matrices)
        for suffix in (".pch", ".pch1", ".bdf", ".dat", ".nas", ".dmig")
    },
}


@dataclass(frozen=True)
class Source:
    """One model on disk: its name, the path to quote, its sidecar and what its files hold."""

    name: str
    where: str
    sidecar: Sidecar
    raw: Raw


def open_source(path: Path, sidecar: Path | None) -> Source:
    """Read the files of the model at ``path``.

    Raises
    ------
    UsageError : no such model, or a file that is damaged or too large.
    MissingToolError : a package that the format needs is not installed.
    """
    if "\0" in str(path):
        where = str(path).replace("\0", "\\0")
        raise UsageError("no such file", where=where, expected="a name without NUL")
    if not path.name:
        expected = "the name of a model, such as FOLDER/NAME"
        raise UsageError("is a folder, not a model", where=str(path), expected=expected)
    base, files = _family(path)
    _, said = described(path, sidecar)
    raw = _read(path, {**files, **said.files}, said)
    if said.dofs is not None:
        raw = Raw(raw.matrices, _rows(said.dofs), raw.held)
    return Source(base.name, str(path), said, raw)


def source_files(path: Path, sidecar: Path | None) -> tuple[Path, ...]:
    """Existing files of the model at ``path``: all of its name, and those that its sidecar names.

    Raises
    ------
    UsageError : a sidecar that is wrong.
    """
    base, files = _family(path)
    chosen, said = described(path, sidecar)
    named = [path, chosen, *files.values(), *said.files.values(), said.mesh, said.dofs]
    named += [*base.parent.glob(f"{base.name}.*"), *base.parent.glob(f"{base.name}_*")]
    return tuple(sorted({item for item in named if item is not None and item.is_file()}))


def described(path: Path, sidecar: Path | None) -> tuple[Path, Sidecar]:
    """The TOML file of the model at ``path``, which need not exist unless given, and what it says.

    Raises
    ------
    UsageError : a sidecar that is wrong.
    """
    base, _ = _family(path)
    beside = path if path.suffix == ".toml" else base.with_name(f"{base.name}.toml")
    chosen, given = sidecar or beside, sidecar is not None or path.suffix == ".toml"
    return chosen, read_sidecar(chosen) if given or present(beside) else Sidecar()


def _family(path: Path) -> tuple[Path, dict[str, Path]]:
    """The model's name with its directory, and the files that hold one matrix each."""
    job = abaqus.siblings(path)
    if job:
        match = abaqus.NAME.fullmatch(path.name)
        assert match is not None  # siblings() matched it
        return path.with_name(match[1]), job
    if path.suffix == ".toml":
        return path.with_suffix(""), {}
    match = _member(path)
    base = path.with_name(match[1]) if match else path
    separators = (match[2],) if match else (".", "_")
    found: dict[str, Path] = {}
    for letter in LETTERS:
        fits = [
            other
            for separator in separators
            for tail in _TAILS
            if (tail or separator == ".")
            and present(other := base.with_name(f"{base.name}{separator}{letter}{tail}"))
        ]
        if len(fits) > 1:
            got = ", ".join(other.name for other in fits)
            raise UsageError(
                f"two files for matrix {letter}", where=str(base), got=got, expected="one of them"
            )
        if fits:
            found[letter] = fits[0]
    if found:
        return base, found
    return (path.with_suffix("") if present(path) else path), {}


def _member(path: Path) -> re.Match[str] | None:
    """Parts of the name of a file of one matrix; ``NAME.K`` may stand for ``NAME.K.mtx``."""
    match = _MEMBER.fullmatch(path.name)
    if match is None or present(path):
        return match
    tails = () if match[4] else _TAILS[1:]
    return match if any(present(path.with_name(path.name + tail)) for tail in tails) else None


def _read(path: Path, files: dict[str, Path], said: Sidecar) -> Raw:
    suffix = path.suffix.lower()
    if files:
        return _matrices(files)
    if not present(path) or suffix == ".toml":
        raise UsageError(
            "no such model",
            where=str(path),
            expected=f"{path.name}.M .E .K .B .C (or .A), .mtx, .matrix, .mat, .npz, .op4, .pch, "
            ".sti or .full; or a TOML file with 'files'",
        )
    if suffix in READERS:
        return READERS[suffix](path, said)
    raise refused(
        path,
        "one file that is not called after its matrix",
        "NAME.K, NAME_K.mtx, JOB_STIF1.mtx",
        hint='or name the files in NAME.toml: files = { K = "...", M = "..." }',
    )


def _matrices(files: dict[str, Path]) -> Raw:
    """One file a matrix; Matrix Market and Harwell-Boeing may stand side by side."""
    heads = {letter: _head(path) for letter, path in files.items()}
    market = {k for k, head in heads.items() if head[: len(BANNER)].lower() == BANNER}
    boeing = {k for k, head in heads.items() if k not in market and is_harwell_boeing(head)}
    other = {k: path for k, path in files.items() if k not in market | boeing}
    raw = abaqus.read_abaqus(_tables(other)) if other else Raw({})
    found: dict[str, Matrix] = dict(raw.matrices)
    for letter, path in files.items():
        if letter in market:
            found[letter] = _market(path, letter)
        elif letter in boeing:
            found[letter] = read_harwell_boeing(path, letter)
    dofs = raw.dofs
    if boeing and dofs is None:
        dofs = _mapping([files[k] for k in sorted(boeing, key="KMEABCD".index)], found)
    return Raw(found, dofs, raw.held)


def _market(path: Path, letter: str) -> Matrix:
    def read() -> Matrix:
        return read_market(content(path), lambda shape, n: bounded(path, letter, shape, n))

    expected = "a Matrix Market file, 'coordinate' or 'array', 'real' or 'integer'"
    return checked(guarded(path, expected, read), letter, path)


def _tables(files: dict[str, Path]) -> dict[str, Path]:
    """Text that has neither a banner nor a header must be Abaqus' square matrices."""
    for letter, path in files.items():
        if letter not in "MEK" or path.suffix.lower() != ".mtx":
            raise refused(
                path,
                f"matrix {letter} in an unknown format",
                "Matrix Market, Harwell-Boeing, or an .mtx file of Abaqus",
            )
    return files


def _head(path: Path) -> bytes:
    existing(path)
    with path.open("rb") as stream:
        return stream.read(2000).removeprefix(b"\xef\xbb\xbf")


def _mapping(files: list[Path], found: dict[str, Matrix]) -> Dofs | None:
    size = next(m.shape[0] for k, m in found.items() if k in "MEKA")
    for path in files:
        for suffix in (".mapping", ".MAPPING"):
            if present(path.with_suffix(suffix)):
                return read_mapping(path.with_suffix(suffix), size)
    return None


def _rows(path: Path) -> Dofs:
    """``node,dof`` of each row in order, dofs by number."""

    def read() -> Dofs:
        values = numbers(content(path))
        if values.size == 0 or values.size % 2 or (values != np.floor(values)).any():
            raise ValueError(f"{values.size} numbers in two columns")
        node, kind = values.reshape(-1, 2).T.astype(np.int64)
        if not np.isin(kind, list(DOFS)).all():
            raise ValueError(f"degree of freedom {kind[~np.isin(kind, list(DOFS))][0]}")
        return Dofs(node, kind)

    return guarded(path, "lines 'node,dof', one for each row", read)
