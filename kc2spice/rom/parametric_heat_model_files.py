"""Files of heat models that are valid over ranges of parameters.

An ``.npz`` archive contains the terms of the matrices E and K.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from kc2spice.rom.io import make_damage_error, read_arrays, write_archive
from kc2spice.rom.parametric_heat_matrix_terms import MatrixTerms
from kc2spice.rom.parametric_heat_models import HeatOverRanges
from kc2spice.rom.parametric_records import (
    make_range_record,
    parse_range_record,
    require_finite_arrays,
)

ARRAY_NAMES = ("powers", "scales", "E", "K", "B")


def write_heat_over_ranges(model: HeatOverRanges, directory: Path, name: str) -> list[str]:
    """Write a heat model over ranges of parameters to ``name.npz`` and ``name.json``.

    ``name.json`` contains the ports, parameters and certificate. Return the file names, the
    ``.npz`` file first.
    """
    terms = model.terms
    arrays = {"powers": terms.powers, "scales": terms.scales, "B": model.B}
    arrays |= {"E": np.array(terms.E), "K": np.array(terms.K)}
    return write_archive(directory, name, arrays, make_range_record(model))


def read_heat_over_ranges(path: Path | str) -> HeatOverRanges:
    """Read a heat model over ranges of parameters from a ``.npz`` file.

    The function :func:`write_heat_over_ranges` writes such files.

    Raises
    ------
    UsageError : the file is damaged, or contains another kind of model.
    """
    path = Path(path)
    try:
        return _build_model(*read_arrays(path, ARRAY_NAMES), path.stem)
    except Exception as error:  # parsers of a damaged file can raise any exception
        raise make_damage_error(path, error) from None


def _build_model(
    arrays: dict[str, np.ndarray], record: dict[str, Any], name: str
) -> HeatOverRanges:
    """Build a heat model from the arrays and the record of a file, and check both."""
    common = parse_range_record(record)
    ports, axes = common["ports"], common.pop("axes")
    terms, states = np.shape(arrays["powers"])[0], np.shape(arrays["B"])[0]
    shapes = {
        "powers": (terms, len(axes)),
        "scales": (len(axes),),
        "E": (terms, states, states),
        "K": (terms, states, states),
        "B": (states, len(ports)),
    }
    require_finite_arrays(arrays, shapes)
    powers = arrays["powers"]
    if powers.dtype.kind != "i" or np.abs(powers).max(initial=0) > 1:
        raise ValueError("an exponent of a parameter is not -1, 0 or 1")
    if not arrays["scales"].min(initial=1.0) > 0:
        raise ValueError("the scale of a parameter is not positive")
    matrices = {letter: tuple(arrays[letter]) for letter in "EK"}
    return HeatOverRanges(
        terms=MatrixTerms(axes, arrays["scales"], powers, **matrices),
        B=arrays["B"],
        exponents=np.zeros((1, len(axes)), int),
        name=name,
        **common,
    )
