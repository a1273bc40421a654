"""Reduced models as files with their certificate: one ``.npz``, and a Matrix Market family."""

from __future__ import annotations

import json
from dataclasses import asdict
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from scipy import io

from kc2spice.core.errors import UsageError
from kc2spice.core.foreign import read_archive, read_bounded, text_of
from kc2spice.rom.linear import Certificate, LinearModel, Port
from kc2spice.rom.matrix_market import read_market

MAX_BYTES = 1_000_000_000
MAX_ENTRIES = 50_000_000  # of one matrix
MAX_TEXT = 64  # characters of a name or unit
_RECORD = "record"  # the JSON text beside the arrays


def write_rom(model: LinearModel, directory: Path, name: str) -> list[str]:
    """Write ``name.npz``, ``name.M`` ... (Matrix Market, 17 digits) and ``name.json``.

    ``name.json`` holds ports and certificate for readers of the Matrix Market files. Returns the
    file names, the ``.npz`` first.
    """
    if model.certificate is None:
        raise UsageError("is not a reduced model", where=model.name, expected="one of 'reduce'")
    letters = _letters(model.first_order)
    matrices = {letter: getattr(model, letter) for letter in letters}
    record = json.dumps(
        {"ports": [asdict(p) for p in model.ports], "certificate": asdict(model.certificate)},
        indent=2,
    )
    arrays = {**matrices, _RECORD: np.array(record)}
    np.savez(directory / f"{name}.npz", **arrays)
    (directory / f"{name}.json").write_text(record + "\n", encoding="utf-8")
    for letter, matrix in matrices.items():
        with (directory / f"{name}.{letter}").open("wb") as stream:
            io.mmwrite(stream, matrix, precision=17, symmetry="general")
    return [f"{name}.npz", f"{name}.json", *(f"{name}.{letter}" for letter in letters)]


def read_rom(path: Path | str) -> LinearModel:
    """Read back what :func:`write_rom` wrote: the ``.npz``, or the ``.json`` or any matrix file of
    the Matrix Market family.

    Raises
    ------
    UsageError : no such file, damaged, not a reduced model, or not finite.
    """
    path = Path(path)
    if not path.is_file():
        raise UsageError("no such file", where=str(path), expected="a reduced model")
    try:
        matrices, record = _read_npz(path) if path.suffix == ".npz" else _read_family(path)
        return _model(matrices, json.loads(record))
    except Exception as error:  # damaged bytes make the parsers raise nearly anything
        raise UsageError(
            "is not a reduced model",
            where=str(path),
            got=" ".join(str(error).split())[:120] or type(error).__name__,
            expected="a file that 'kc2spice reduce' wrote",
        ) from None


def _read_npz(path: Path) -> tuple[dict[str, np.ndarray], str]:
    known = {_RECORD, *"MEKABCD"}
    arrays = read_archive(path, known.__contains__, entries=lambda _: MAX_ENTRIES, total=MAX_BYTES)
    record = arrays.pop(_RECORD)
    return arrays, str(record.item())


def _read_family(path: Path) -> tuple[dict[str, np.ndarray], str]:
    base = path.with_suffix("")
    record = Path(f"{base}.json")
    matrices = {}
    for letter in "MEKABCD":
        file = Path(f"{base}.{letter}")
        if file.is_file():
            matrices[letter] = read_market(read_bounded(file, MAX_BYTES), _bounded)
    return matrices, text_of(read_bounded(record, MAX_BYTES))


def _bounded(shape: tuple[int, int], entries: int) -> None:
    if max(shape[0] * shape[1], entries) > MAX_ENTRIES:
        raise ValueError(f"a matrix of {shape[0]} x {shape[1]}, {entries} entries")


def _plain(text: str, longest: int) -> str:
    """Text that can stand in a netlist's header, where a line break begins a card."""
    if not text.isprintable() or len(text) > longest:
        raise ValueError(f"not plain text: {text[:40]!r}")
    return text


def _model(matrices: dict[str, Any], record: dict[str, Any]) -> LinearModel:
    from pydantic import TypeAdapter  # late: a run reads no such file

    ports = TypeAdapter(tuple[Port, ...]).validate_python(record["ports"])
    words = ((p["name"], p["across"], p["flow"], *p.get("pins", ())) for p in record["ports"])
    for text in chain.from_iterable(words):
        if len(_plain(text, MAX_TEXT).split()) != 1:
            raise ValueError(f"not one word: {text!r}")
    certificate = TypeAdapter(Certificate).validate_python(record["certificate"])
    _plain(certificate.method, 1000)
    low, high = certificate.band_hz
    if not 0 <= low <= high < np.inf:
        raise ValueError(f"band {low} … {high} Hz")
    letters = _letters("A" in matrices)
    arrays: dict[str, Any] = {letter: np.asarray(matrices[letter]) for letter in letters}
    if any(array.dtype.kind != "f" for array in arrays.values()):
        raise ValueError("a matrix that is not of real numbers")
    if not np.isfinite([certificate.error_estimate, *chain(*certificate.above)]).all():
        raise ValueError("the certificate is not finite")
    return LinearModel(ports=ports, certificate=certificate, **arrays)


def _letters(first_order: bool) -> str:
    return "EABCD" if first_order else "MEKBCD"
