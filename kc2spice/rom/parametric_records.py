"""JSON records of parametric models: ports, certificate and parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from kc2spice.rom.io import parse_certificate, parse_ports, require_certificate, require_single_line
from kc2spice.rom.parametric_models import ParameterAxis
from kc2spice.rom.range_reduction import ModelOverRanges

MAX_LABEL_LENGTH = 200  # largest number of characters in a unit or a description


def make_range_record(model: ModelOverRanges) -> dict[str, Any]:
    """Return the ports, certificate and parameter ranges of a model as JSON record."""
    return {
        "ports": list(map(asdict, model.ports)),
        "certificate": asdict(require_certificate(model.certificate, model.name)),
        "axes": list(map(asdict, model.parameter_axes.values())),
        "defaults": dict(model.defaults),
        "units": dict(model.units),
        "descriptions": dict(model.descriptions),
    }


def parse_range_record(record: Mapping[str, Any]) -> dict[str, Any]:
    """Parse the ports, certificate and parameter ranges in the JSON record of a file.

    Raises
    ------
    ValueError : the record is damaged, or a string contains a line break, which would begin a new
    statement in a netlist.
    """
    from pydantic import TypeAdapter  # imported here, because few commands read parametric models

    texts = TypeAdapter(dict[str, str])
    units, words = map(texts.validate_python, (record["units"], record["descriptions"]))
    for text in (*units, *units.values(), *words, *words.values()):
        require_single_line(text, MAX_LABEL_LENGTH)
    return {
        "ports": parse_ports(record["ports"]),
        "certificate": parse_certificate(record["certificate"]),
        "axes": TypeAdapter(tuple[ParameterAxis, ...]).validate_python(record["axes"]),
        "defaults": TypeAdapter(dict[str, float]).validate_python(record["defaults"]),
        "units": units,
        "descriptions": words,
    }


def require_finite_arrays(
    arrays: Mapping[str, np.ndarray], shapes: Mapping[str, tuple[int, ...]]
) -> None:
    """Check that the arrays have the given ``shapes`` and contain only finite numbers.

    Raises
    ------
    ValueError : an array has another shape, or contains a number that is not finite.
    """
    for key, shape in shapes.items():
        array = arrays[key]
        if array.shape != shape or array.dtype.kind not in "if" or not np.isfinite(array).all():
            raise ValueError(
                f"the array {key} must contain finite real numbers and have the shape {shape}; "
                f"its shape is {array.shape}"
            )
