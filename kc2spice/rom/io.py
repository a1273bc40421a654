"""Reduced models as files with their certificate: one ``.npz``, and a Matrix Market family."""

from __future__ import annotations

import json
import zipfile
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from scipy import io

from kc2spice.core.errors import UsageError
from kc2spice.rom.linear import Certificate, LinearModel, Port
from kc2spice.rom.matrix_market import read_body, read_header

MAX_BYTES = 1_000_000_000
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
    except UsageError:
        raise
    except Exception as error:  # damaged bytes make the parsers raise nearly anything
        raise UsageError(
            "is not a reduced model",
            where=str(path),
            got=" ".join(str(error).split())[:120] or type(error).__name__,
            expected="a file that 'kc2spice reduce' wrote",
        ) from None


def _read_npz(path: Path) -> tuple[dict[str, np.ndarray], str]:
    with zipfile.ZipFile(path) as archive:
        if sum(item.file_size for item in archive.infolist()) > MAX_BYTES:
            raise UsageError("too large", where=str(path), expected=f"at most {MAX_BYTES} bytes")
    with np.load(path, allow_pickle=False) as archive:
        arrays = {key: archive[key] for key in archive.files}
    record = arrays.pop(_RECORD)
    return arrays, str(record.item())


def _read_family(path: Path) -> tuple[dict[str, np.ndarray], str]:
    base = path.with_suffix("")
    record = Path(f"{base}.json")
    matrices = {}
    for letter in "MEKABCD":
        file = Path(f"{base}.{letter}")
        if file.is_file():
            if file.stat().st_size > MAX_BYTES:
                raise UsageError("too large", where=str(file), expected=f"{MAX_BYTES} bytes")
            matrices[letter] = read_body(file, read_header(file))
    return matrices, record.read_text(encoding="utf-8")


def _model(matrices: dict[str, Any], record: dict[str, Any]) -> LinearModel:
    ports = tuple(Port(**port) for port in record["ports"])
    facts = record["certificate"]
    certificate = Certificate(
        (float(facts["band_hz"][0]), float(facts["band_hz"][1])),
        float(facts["error_estimate"]),
        str(facts["method"]),
        bool(facts["stable"]),
        bool(facts["passive"]),
    )
    letters = _letters("A" in matrices)
    arrays = {letter: np.asarray(matrices[letter]) for letter in letters}
    q, m = arrays["B"].shape
    p = arrays["C"].shape[0]
    shapes = {"B": (q, m), "C": (p, q), "D": (p, m)}
    for letter, array in arrays.items():
        if array.dtype.kind != "f" or array.shape != shapes.get(letter, (q, q)):
            raise ValueError(f"matrix {letter} is {array.dtype} {array.shape}")
        if not np.isfinite(array).all():
            raise ValueError(f"matrix {letter} is not finite")
    if not all(np.isfinite([*certificate.band_hz, certificate.error_estimate])):
        raise ValueError("the certificate is not finite")
    return LinearModel(**arrays, ports=ports, certificate=certificate)


def _letters(first_order: bool) -> str:
    return "EABCD" if first_order else "MEKBCD"
