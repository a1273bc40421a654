"""Registry of part types, and results that depend on several parts of a scene.

Each module in ``kc2spice.parts`` has the name of a part type. The module of a part type defines a
subclass of :class:`kc2spice.scene.scene_classes.PartType` and passes an instance to
:func:`register_part_type`. A module named ``*_types`` registers several part types. Modules outside
of ``kc2spice.parts`` do not depend on particular part types. The module of a part type is imported
only when a scene needs the part type. Other Python packages add part types by entry points in the
group ``kc2spice.parts``.
"""

from __future__ import annotations

import math
import pkgutil
from collections.abc import Mapping
from functools import cache
from importlib import import_module

import numpy as np

from kc2spice.core.errors import UsageError
from kc2spice.core.plugins import list_entry_points, load_plugin, make_built_in_name_error
from kc2spice.core.waveforms import Waveforms
from kc2spice.netlist.expression import join_terms
from kc2spice.netlist.number_and_name_spelling import require_name
from kc2spice.scene.part_records import PartResult
from kc2spice.scene.scene_classes import BuiltScene, Part, PartType, find_flows

PARTS_PACKAGE = "kc2spice.parts"
SHARED_MODULE_SUFFIX = "_types"  # suffix of the names of modules that define several part types


def find_current_into(part: Part, pin: str, build: BuiltScene) -> PartResult | None:
    """Return the current into a pin if a single other part reports it, otherwise None.

    Return None if several other parts are joined to the pin, because the current is the sum of the
    currents of these parts.
    """
    others = build.scene.list_joined_pins(part.name, pin)
    # the current of a body is computed from the other parts at the pin, not from the body
    if len(others) != 1 or build.scene.parts[others[0][0]].is_body:
        return None
    ((name, end),) = others
    rows = list(find_flows(build.records[name].vectors, end).values())
    if len(rows) != 1:
        return None
    ((row, sign),) = rows
    return PartResult(row.expression, sign * row.factor, row.unit)


def find_flow_into(part: Part, pin: str, build: BuiltScene) -> PartResult | None:
    """Return the flow into a pin: the total flow out of all other parts on its net.

    Return None if one of the other parts is a body, or has no result for the flow at the pin.
    """
    others = build.scene.list_joined_pins(part.name, pin)
    if len(others) == 1:
        return find_current_into(part, pin, build)
    terms: list[tuple[float, str]] = []
    scales: dict[tuple[float, str], None] = {}
    for name, end in others:
        rows = list(find_flows(build.records[name].vectors, end).values())
        if build.scene.parts[name].is_body or len(rows) != 1:
            return None
        ((row, sign),) = rows
        scales[abs(row.factor), row.unit] = None
        sign = math.copysign(sign, sign * row.factor)
        terms += [(sign * share, text) for share, text in row.terms]
    if len(scales) != 1:
        return None
    ((factor, unit),) = scales
    return PartResult(join_terms(terms), factor, unit)


def compute_pin_forces(build: BuiltScene, waves: Waveforms) -> Mapping[tuple[str, str], np.ndarray]:
    """Return the waveforms of the forces [N] that parts exert at their pins.

    The forces are keyed by part and pin. All forces are computed once for each run.
    """

    def compute_all_forces() -> tuple[BuiltScene, Waveforms, dict[tuple[str, str], np.ndarray]]:
        """Compute all forces [N] of parts at pins; return ``build``, ``waves`` and forces."""
        result = {}
        for name, part in build.scene.parts.items():
            for pin, force in part.type.forces(part, build, waves).items():
                result[name, pin] = force
        # The cache key contains the Python ids of the objects ``build`` and ``waves``.
        # Python may reuse the ids of deleted objects, so the cached tuple keeps both objects alive.
        return build, waves, result

    return build.workspace.get_or_compute("forces", (id(build), id(waves)), compute_all_forces)[2]


# Present name of each method that was renamed after version 0.2.0, keyed by the old name.
# A part type that defines a method under its old name is rejected, because the method would never
# be called.
_RENAMED_METHODS = {
    "directions": "pin_directions",
    "discretisation": "describe_discretisation",
    "expand": "generate_tables",
    "force_on": "forces",
    "highest_frequency": "make_frequency_estimator",
    "inertial": "pins_with_mass",
    "reduction": "choose_reduction",
    "settable": "settable_quantities",
}
_types: dict[str, PartType] = {}
_own_names: set[str] = set()  # names of the part types that users registered


def register_part(part_type: PartType) -> PartType:
    """Register a custom part type under its name, so that scenes can have such parts.

    A new part type replaces an earlier part type of the same name, except a built-in part type.

    Parameters
    ----------
    part_type : PartType
        Part type with the attributes ``name`` and ``schema``.

    Returns
    -------
    PartType
        The argument ``part_type``.

    Raises
    ------
    UsageError : the argument is not a part type with a schema, has the name of a built-in part
        type, or has a name that is not valid in netlists.

    Examples
    --------
    A hardening spring has the force 100 x + 1e10 x^3 (x in m, force in N). At 200 um, the force is
    0.1 N.

    >>> import kc2spice as kc
    >>> from kc2spice.physics import Declaration, DeclaredPart, displacement
    >>> class HardSpringKeys(kc.Section):
    ...     k: float
    ...     h: float
    >>> branches = (displacement("x", "a", "b"),)
    >>> energy = "k*x^2/2 + h*x^4/4"
    >>> spring = Declaration("hard_spring", "hard spring", HardSpringKeys, branches, energy=energy)
    >>> kc.register_part(DeclaredPart(spring)).name
    'hard_spring'
    >>> pull = {"part": "source", "kind": "displacement", "dc": "200 um"}
    >>> plate = {"part": "hard_spring", "k": 100.0, "h": 1e10, "pins": {"a": "pull.out"}}
    >>> result = kc.run({"pull": pull, "plate": plate, "analysis": {"type": "op"}})
    >>> print(f"{result.waves['plate.force'][0]:.4f} {result.units['plate.force']}")
    0.1000 N
    """
    if isinstance(part_type, PartType) and getattr(part_type, "name", "") in _list_built_in_names():
        hint = f"write another name, such as my_{part_type.name}"
        raise make_built_in_name_error("part type", part_type.name, "register_part", hint)
    register_part_type(part_type)
    _own_names.add(part_type.name)
    return part_type


def _list_built_in_names() -> frozenset[str]:
    """Return the names of the part types that belong to kc2spice."""
    others = {*_own_names, *list_entry_points(PARTS_PACKAGE)}
    return frozenset(list_type_names()) - others


def register_part_type(part_type: PartType) -> PartType:
    """Register a part type of ``kc2spice.parts`` or of an entry point under its name.

    Raises
    ------
    UsageError : the argument is not a part type with a schema, or has a name that is not valid in
        netlists.
    """
    name = getattr(part_type, "name", "")
    if not isinstance(part_type, PartType) or not name or not hasattr(part_type, "schema"):
        raise UsageError(
            "this object is not a part type",
            where="register_part",
            got=repr(part_type)[:120],
            expected="an instance of a part type with a name and a schema",
            hint="register DeclaredPart(declaration) as in docs/how-to/own_part.md",
        )
    for old, new in _RENAMED_METHODS.items():
        if hasattr(part_type, old):
            raise UsageError(
                f"the method {old} of part types is now called {new}",
                where="register_part",
                got=f"{type(part_type).__name__}.{old}",
                expected=f"the method {new}",
                hint=f"rename {type(part_type).__name__}.{old} to {new}",
            )
    _types[require_name(name, where="register_part")] = part_type
    return part_type


def list_type_names() -> tuple[str, ...]:
    """Return the sorted names of all part types.

    Only modules that define several part types are imported.

    ``kc2spice.parts`` contains a folder for each family of parts. A module in the folder has the
    name of its part type. A module with several part types has a name that ends with ``_types``.
    Modules whose name begins with ``_`` contain shared code.
    """
    modules = _list_modules()
    for name, module in modules.items():
        if name.endswith(SHARED_MODULE_SUFFIX):
            import_module(module)
    built_in = (name for name in modules if not name.endswith(SHARED_MODULE_SUFFIX))
    return tuple(sorted({*_types, *list_entry_points(PARTS_PACKAGE), *built_in}))


@cache
def _list_modules() -> Mapping[str, str]:
    """Return the import path of each part-type module, keyed by short module name."""
    result: dict[str, str] = {}
    for family in pkgutil.iter_modules(import_module(PARTS_PACKAGE).__path__, f"{PARTS_PACKAGE}."):
        modules = pkgutil.iter_modules(import_module(family.name).__path__)
        public = (item.name for item in modules if not item.name.startswith("_"))
        result |= {name: f"{family.name}.{name}" for name in public}
    return result


def find_part_type(name: str) -> PartType | None:
    """Return the part type of a given name, or None if the name is unknown.

    The module of the part type is imported if necessary. Modules with several part types, and other
    packages, are searched only if no module has the name of the part type.
    """
    if name not in _types and name in _list_modules():
        import_module(_list_modules()[name])
    if name not in _types and name in list_type_names():
        result = load_plugin(PARTS_PACKAGE, name)
        if result is not None and not isinstance(result, PartType):
            raise UsageError(
                "this object is not a part type",
                where=f"entry point {name} of {PARTS_PACKAGE}",
                got=repr(result),
                expected="an instance of kc.DeclaredPart or kc.PartType",
                hint="correct the entry point as in docs/how-to/own_part.md",
            )
        if result is not None:
            register_part_type(result)
    return _types.get(name)


def load_part_types() -> Mapping[str, PartType]:
    """Load all part types, and return all part types keyed by name."""
    return {
        name: result for name in list_type_names() if (result := find_part_type(name)) is not None
    }
