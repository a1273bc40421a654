"""PySpice and InSpice: parts of ours as subcircuits of theirs.

PySpice has not been kept up since 2021, InSpice is its live fork (Python 3.12 and later). Both are
clients here: decks of ours run without them.
"""

from __future__ import annotations

import logging
from typing import Any, Literal

from kc2spice.core.extras import import_optional
from kc2spice.netlist.library import Subcircuit

Package = Literal["PySpice", "InSpice"]


def subcircuit(part: Subcircuit, package: Package = "PySpice") -> Any:
    """``part`` for ``circuit.subcircuit(...)`` and ``circuit.X(name, part.name, *nodes)``.

    Raises
    ------
    MissingToolError : the package is not installed.
    """
    logging.getLogger(package).setLevel(logging.CRITICAL)  # what it says is in its output, too
    parent = import_optional(f"{package}.Spice.Netlist", "pyspice.subcircuit").SubCircuit

    class Part(parent):  # type: ignore[misc,valid-type]
        """A part of kc2spice, with the text of its library file."""

        def __str__(self) -> str:
            return part.text.rstrip("\n") + "\n"

    return Part(
        part.name, *(pin.name for pin in part.pins), **{p.name: p.default for p in part.params}
    )
