"""Conversion of kc2spice parts to subcircuits of PySpice and InSpice.

PySpice has not been maintained since 2021; InSpice is a maintained fork (Python 3.12 and later).
kc2spice itself does not use these packages to run decks.
"""

from __future__ import annotations

import logging
from typing import Any, Literal

from kc2spice.core.optional_libraries import import_optional
from kc2spice.netlist.subcircuit_library import Subcircuit

Package = Literal["PySpice", "InSpice"]


def pyspice_subcircuit(part: Subcircuit, package: Package = "PySpice") -> Any:
    """Return a part as a subcircuit of PySpice or InSpice.

    Add the result to a circuit with ``circuit.subcircuit(...)``, and instantiate it with
    ``circuit.X(name, part.name, *nodes)``.

    Parameters
    ----------
    part : Subcircuit
        Subcircuit to convert, for example from :func:`kc2spice.read_lib` or
        :func:`kc2spice.subcircuit`.
    package : "PySpice" or "InSpice", default "PySpice"
        Package whose subcircuit is returned.

    Returns
    -------
    SubCircuit
        Object of the class ``Spice.Netlist.SubCircuit`` of the package.

    Raises
    ------
    MissingToolError : the package is not installed.

    Examples
    --------
    >>> from pathlib import Path
    >>> import kc2spice as kc
    >>> from kc2spice.pyspice import pyspice_subcircuit
    >>> cards = ["* lamp", ".subckt lamp plus minus", "R1 plus minus 6", ".ends lamp"]
    >>> _ = Path("lamp.lib").write_text("\\n".join(cards))
    >>> lamp = pyspice_subcircuit(kc.read_lib("lamp.lib")[0])
    >>> lamp.name, lamp.external_nodes
    ('lamp', ('plus', 'minus'))
    """
    # hide log messages, which only repeat the text that the package prints
    logging.getLogger(package).setLevel(logging.CRITICAL)
    parent = import_optional(f"{package}.Spice.Netlist", "pyspice_subcircuit").SubCircuit

    class Part(parent):  # type: ignore[misc,valid-type]
        """Subcircuit of PySpice whose text is the library file of a part."""

        def __str__(self) -> str:
            return part.text.rstrip("\n") + "\n"

    return Part(
        part.name, *(pin.name for pin in part.pins), **{p.name: p.default for p in part.params}
    )
