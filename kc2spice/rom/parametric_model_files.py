"""Files of parametric models: ``.npz`` archives of the polynomial coefficients.

A parametric model is a reduced model that is valid over ranges of parameters.
"""

from __future__ import annotations

import zipfile
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from kc2spice.rom.io import make_damage_error, read_arrays, write_archive
from kc2spice.rom.parametric_heat_model_files import read_heat_over_ranges, write_heat_over_ranges
from kc2spice.rom.parametric_heat_models import HeatOverRanges
from kc2spice.rom.parametric_models import DampingParameter
from kc2spice.rom.parametric_records import (
    make_range_record,
    parse_range_record,
    require_finite_arrays,
)
from kc2spice.rom.range_reduction import ModelOverRanges
from kc2spice.rom.resonators_over_ranges import ResonatorsOverRanges

_ARRAY_NAMES = ("exponents", "diagonal", "below", "gain", "capacitance", "shared", "rayleigh")
_HEAT_MARK = "powers.npy"
# an archive of a parametric model contains one of these files
_MARKS = {"exponents.npy", _HEAT_MARK}
_MAX_DEGREE = 30  # largest accepted degree of a polynomial in a file; reductions use lower degrees


def write_parametric_model(model: ModelOverRanges, directory: Path, name: str) -> list[str]:
    """Write a parametric model to the files ``name.npz`` and ``name.json``.

    The ``.json`` file contains the ports, parameters and certificate. Return the file names, with
    the ``.npz`` file first.
    """
    if isinstance(model, HeatOverRanges):
        return write_heat_over_ranges(model, directory, name)
    # A model over ranges is of class HeatOverRanges or ResonatorsOverRanges; no third class exists.
    assert isinstance(model, ResonatorsOverRanges)
    content = make_range_record(model) | {
        "losses": list(map(asdict, model.losses)),
        "blocks": model.blocks,
        "damped": model.damped,
    }
    arrays = {key: getattr(model, key) for key in _ARRAY_NAMES}
    return write_archive(directory, name, arrays, content)


def is_parametric_model(path: Path) -> bool:
    """Return whether a file is an archive that :func:`write_parametric_model` wrote."""
    try:
        with zipfile.ZipFile(path) as archive:
            return not _MARKS.isdisjoint(archive.namelist())
    except (OSError, zipfile.BadZipFile):
        return False


def _contains_heat(path: Path) -> bool:
    """Return whether a file contains a parametric heat model."""
    try:
        with zipfile.ZipFile(path) as archive:
            return _HEAT_MARK in archive.namelist()
    except (OSError, zipfile.BadZipFile):
        return False


def read_parametric_model(path: Path | str) -> ModelOverRanges:
    """Read a parametric model from a ``.npz`` file.

    The function :func:`write_parametric_model` writes such files.

    Raises
    ------
    UsageError : the file is damaged, or contains another kind of model.
    """
    path = Path(path)
    if _contains_heat(path):
        return read_heat_over_ranges(path)
    try:
        return _build_resonators(*read_arrays(path, _ARRAY_NAMES), path.stem)
    except Exception as error:  # parsers of a damaged file can raise any exception
        raise make_damage_error(path, error) from None


def _build_resonators(
    arrays: dict[str, np.ndarray], record: dict[str, Any], name: str
) -> ResonatorsOverRanges:
    """Build the resonators of a parametric model from a file's arrays and metadata.

    The arrays and the JSON record are checked.
    """
    from pydantic import TypeAdapter  # imported late: few commands read parametric models

    common = parse_range_record(record)
    ports, axes = common["ports"], common["axes"]
    losses = TypeAdapter(tuple[DampingParameter, ...]).validate_python(record["losses"])
    blocks = TypeAdapter(tuple[int, ...]).validate_python(record["blocks"])
    terms, states = np.shape(arrays["diagonal"])
    electrical = sum(port.electrical for port in ports)
    shapes = {
        "exponents": (terms, len(axes)),
        "diagonal": (terms, states),
        "below": (terms, states, states),
        "gain": (terms, states, len(ports)),
        "capacitance": (terms, electrical),
        "shared": (terms, electrical, electrical),
        "rayleigh": (terms, 2),
    }
    require_finite_arrays(arrays, shapes)
    exponents = arrays["exponents"]
    if exponents.dtype.kind != "i" or (exponents.size and not exponents.min() >= 0):
        raise ValueError("an exponent is not a whole number of at least 0")
    if exponents.max(initial=0) > _MAX_DEGREE or sum(blocks) != states or min(blocks) < 1:
        raise ValueError("an exponent or block number is out of range")
    return ResonatorsOverRanges(
        losses=losses,
        blocks=blocks,
        damped=TypeAdapter(tuple[bool, bool]).validate_python(record["damped"]),
        facts={},
        name=name,
        **(common | arrays),
    )
