"""kc2spice: finite-element actuator models as SPICE subcircuits, run with their electronics.

``import kc2spice as kc`` does what the command line does, in the same words. Everything named in
``__all__`` is loaded when it is used first, so that the import itself costs nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from kc2spice.core.version import __version__ as __version__

if TYPE_CHECKING:
    from kc2spice.api import (
        Result,
        Table,
        build,
        deck,
        load_scene,
        read_lib,
        read_model,
        reduce,
        register_part,
        run,
        simulate,
        subcircuit,
        sweep,
    )
    from kc2spice.core import errors
    from kc2spice.core.quantities import Section
    from kc2spice.netlist.circuit import Param, Pin, Subcircuit
    from kc2spice.netlist.deck import Deck
    from kc2spice.rom.linear import Certificate, LinearModel, Port
    from kc2spice.scene.model import Scene, Terminal
    from kc2spice.scene.parttype import PartType

_API = (
    "load_scene", "run", "build", "read_model", "reduce", "subcircuit", "read_lib", "deck",
    "simulate", "sweep", "register_part", "Result", "Table",
)  # fmt: skip
_HOMES = {
    **dict.fromkeys(_API, "kc2spice.api"),
    **dict.fromkeys(("LinearModel", "Port", "Certificate"), "kc2spice.rom.linear"),
    **dict.fromkeys(("Subcircuit", "Pin", "Param"), "kc2spice.netlist.circuit"),
    **dict.fromkeys(("Scene", "Terminal"), "kc2spice.scene.model"),
    "Deck": "kc2spice.netlist.deck",
    "PartType": "kc2spice.scene.parttype",
    "Section": "kc2spice.core.quantities",
}

__all__ = [
    "Certificate",
    "Deck",
    "LinearModel",
    "Param",
    "PartType",
    "Pin",
    "Port",
    "Result",
    "Scene",
    "Section",
    "Subcircuit",
    "Table",
    "Terminal",
    "build",
    "deck",
    "errors",
    "load_scene",
    "read_lib",
    "read_model",
    "reduce",
    "register_part",
    "run",
    "simulate",
    "subcircuit",
    "sweep",
]


def __getattr__(name: str) -> Any:
    if name == "errors":
        return import_module("kc2spice.core.errors")
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
