"""Finite-element models of actuators as SPICE subcircuits, and their simulation.

``import kc2spice as kc`` provides functions with the names of commands, such as ``kc.run`` for
the command ``kc2spice run``.
Each name in ``__all__`` is loaded at its first use, so that the import is fast.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from kc2spice.core import __version__ as __version__

if TYPE_CHECKING:
    from kc2spice.api import (
        Result,
        Table,
        build,
        deck,
        export,
        register_part,
        run,
        simulate,
        sweep,
        verify,
    )
    from kc2spice.bodies.readers import read_affine_model, read_model
    from kc2spice.core import errors
    from kc2spice.core.domains import Domain
    from kc2spice.core.quantities import Section
    from kc2spice.netlist.circuit import Param, Pin
    from kc2spice.netlist.deck import Deck
    from kc2spice.netlist.printers.dialect import Dialect
    from kc2spice.netlist.printers.dialect_registry import register_dialect
    from kc2spice.netlist.subcircuit_library import Subcircuit, read_lib
    from kc2spice.rom.affine import AffineModel, ModelParameter
    from kc2spice.rom.linear_model import Certificate, LinearModel, Port
    from kc2spice.rom.reduction import Reduction, reduce
    from kc2spice.rom.reductors.base import Reductor
    from kc2spice.rom.reductors.rational_krylov import RationalKrylov
    from kc2spice.rom.reductors.registry import register_reductor
    from kc2spice.scene.load import load_scene
    from kc2spice.scene.scene_classes import PartType, Scene, Terminal
    from kc2spice.synthesis.model_to_subcircuit import subcircuit
    from kc2spice.synthesis.parametric_resonators import parametric_subcircuit
    from kc2spice.workflow.fit import fit

__all__ = [
    "AffineModel",
    "Certificate",
    "Deck",
    "Dialect",
    "Domain",
    "LinearModel",
    "ModelParameter",
    "Param",
    "PartType",
    "Pin",
    "Port",
    "RationalKrylov",
    "Reduction",
    "Reductor",
    "Result",
    "Scene",
    "Section",
    "Subcircuit",
    "Table",
    "Terminal",
    "build",
    "deck",
    "errors",
    "export",
    "fit",
    "load_scene",
    "parametric_subcircuit",
    "read_affine_model",
    "read_lib",
    "read_model",
    "reduce",
    "register_dialect",
    "register_part",
    "register_reductor",
    "run",
    "simulate",
    "subcircuit",
    "sweep",
    "verify",
]
_HOME_MODULES = {
    **dict.fromkeys(("LinearModel", "Port", "Certificate"), "rom.linear_model"),
    **dict.fromkeys(("AffineModel", "ModelParameter"), "rom.affine"),
    **dict.fromkeys(("Pin", "Param"), "netlist.circuit"),
    **dict.fromkeys(("PartType", "Scene", "Terminal"), "scene.scene_classes"),
    "Deck": "netlist.deck",
    "Dialect": "netlist.printers.dialect",
    "Domain": "core.domains",
    "Section": "core.quantities",
    "fit": "workflow.fit",
    "load_scene": "scene.load",
    **dict.fromkeys(("Subcircuit", "read_lib"), "netlist.subcircuit_library"),
    **dict.fromkeys(("read_affine_model", "read_model"), "bodies.readers"),
    "RationalKrylov": "rom.reductors.rational_krylov",
    **dict.fromkeys(("Reduction", "reduce"), "rom.reduction"),
    "Reductor": "rom.reductors.base",
    "register_dialect": "netlist.printers.dialect_registry",
    "register_reductor": "rom.reductors.registry",
    "parametric_subcircuit": "synthesis.parametric_resonators",
    "subcircuit": "synthesis.model_to_subcircuit",
}  # module that defines the name, relative to the package; ``api`` defines all other names


def __getattr__(name: str) -> Any:
    if name == "errors":
        return import_module("kc2spice.core.errors")
    if name not in __all__:
        from kc2spice.core.errors import did_you_mean

        suggestion = did_you_mean(name, __all__) or "dir(kc2spice) lists all names"
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}: {suggestion}")
    return getattr(import_module(f"kc2spice.{_HOME_MODULES.get(name, 'api')}"), name)


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
