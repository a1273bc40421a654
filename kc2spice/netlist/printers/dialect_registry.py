"""Registry of netlist dialects from kc2spice and from other packages.

Each module in the package :mod:`kc2spice.netlist.printers.dialects` has the name of its dialect.
Other packages declare their dialects as entry points of the group :data:`ENTRY_POINT_GROUP`.
"""

from __future__ import annotations

import pkgutil
from collections.abc import Iterable
from functools import cache
from importlib import import_module
from operator import attrgetter

from kc2spice.core.errors import UsageError, unknown
from kc2spice.core.plugins import list_entry_points, load_plugin, make_built_in_name_error
from kc2spice.netlist.printers.dialect import Dialect

ENTRY_POINT_GROUP = "kc2spice.dialects"
DIALECT_PACKAGE = "kc2spice.netlist.printers.dialects"
# Name of the dialect that all other dialects derive from, and name of the output that is not a
# netlist.
NGSPICE = "ngspice"
VERILOG_A = "verilog-a"
_dialects: dict[str, type[Dialect]] = {}


def register_dialect(dialect: type[Dialect]) -> type[Dialect]:
    """Register a simulator's dialect for ``--dialect`` and for exports.

    A later dialect of the same name replaces the earlier one, except a built-in dialect.

    Parameters
    ----------
    dialect : type of Dialect
        Subclass of :class:`kc2spice.Dialect`; its attribute ``dialect`` is the name.

    Returns
    -------
    type of Dialect
        The same class, so that this function can be a decorator.

    Raises
    ------
    UsageError : the class is not a subclass of Dialect, lacks a method or a title, or has the name
        of a built-in dialect.

    Examples
    --------
    >>> import kc2spice as kc
    >>> @kc.register_dialect
    ... class Example(kc.Dialect):
    ...     dialect, title, command = "example", "Example", "example -batch"
    ...     def format_derived_measure(self, kind, name, expression):
    ...         return f".meas {kind} {name} PARAM {expression}"
    ...     def format_magnitude(self, vector):
    ...         return f"mag({vector})"
    ...     def format_real_part(self, vector):
    ...         return f"re({vector})"
    ...     def switch(self, name, values):
    ...         return f".model {name} SW({' '.join(f'{k}={v}' for k, v in values.items())})"
    >>> lamp = {
    ...     "name": "lamp",
    ...     "drive": {"part": "source", "dc": "12 V"},
    ...     "lamp": {"part": "resistor", "resistance": "6 Ohm", "pins": {"a": "drive.out"}},
    ...     "analysis": {"type": "op"},
    ... }
    >>> [path.name for path in kc.export(lamp, "for_example", dialect="example")]
    ['lamp.cir']
    """
    _dialects[dialect.dialect] = _require_dialect(dialect, "register_dialect")
    return dialect


def _require_dialect(value: object, where: str) -> type[Dialect]:
    """Return a dialect class; raise an error if the class cannot be used."""
    got, hint = repr(value), "derive a class from kc.Dialect and register the class"
    if isinstance(value, type) and issubclass(value, Dialect):
        missing = ", ".join(sorted(getattr(value, "__abstractmethods__", ())))
        # without its own title, a class inherits the title of ngspice
        titled = value.title != Dialect.title
        named = bool(value.dialect) and value.dialect not in (NGSPICE, VERILOG_A)
        # the name of a built-in dialect is also the name of its module
        built_in = value.__module__ == f"{DIALECT_PACKAGE}.{value.dialect}"
        if value.dialect in _list_builtin_dialects() and not built_in:
            hint = f"write  dialect = 'my_{value.dialect}'  in the class {value.__name__}"
            raise make_built_in_name_error("dialect", value.dialect, where, hint)
        if not missing and named and titled:
            return value
        got = f"{value.__name__} with the name {value.dialect!r} and the title {value.title!r}"
        attribute = "title = 'NAME OF THE SIMULATOR'" if named else "dialect = 'NAME'"
        hint = f"define {missing}" if missing else f"set {attribute} in {value.__name__}"
    raise UsageError(
        "this object is not a netlist dialect",
        where=where,
        got=got,
        expected="a subclass of kc.Dialect with a name, a title and all methods",
        hint=hint,
    )


@cache
def _list_builtin_dialects() -> tuple[str, ...]:
    """Return the names of the built-in dialects, which are also module names."""
    modules = pkgutil.iter_modules(import_module(DIALECT_PACKAGE).__path__)
    return tuple(map(attrgetter("name"), modules))


def list_deck_dialects() -> tuple[str, ...]:
    """Return the names of all dialects for decks, ngspice first."""
    foreign = list_entry_points(ENTRY_POINT_GROUP)
    return tuple(dict.fromkeys((NGSPICE, *_list_builtin_dialects(), *foreign, *_dialects)))


def list_dialect_names() -> tuple[str, ...]:
    """Return the names of all dialects for an export, including Verilog-A."""
    return (*list_deck_dialects(), VERILOG_A)


# Simulators without a dialect of their own, each with the dialect whose files it reads.
_COMPATIBLE_DIALECTS = {
    "pspice": "ltspice",
    "orcad": "ltspice",
    "tina": "ltspice",
    "simetrix": "ltspice",
    "hspice": "xyce",
    "spectre": "verilog-a",
    "ads": "verilog-a",
    "veriloga": "verilog-a",
    "va": "verilog-a",
    "kicad": "ngspice",
    "spice3": "ngspice",
    "spice": "ngspice",
}


def make_unknown_dialect_error(name: object, known: Iterable[str]) -> UsageError:
    """Make the error for an unknown dialect, with the most similar known name."""
    error = unknown("this dialect does not exist", name, known, "--dialect")
    if not isinstance(name, str):
        error.hint = f"write the name of a dialect as a string, such as '{NGSPICE}'"
    elif (similar := _COMPATIBLE_DIALECTS.get(name.lower())) is not None:
        error.hint = f"try {similar}, the dialect that is most similar to {name}"
    return error


def find_dialect(name: str) -> type[Dialect]:
    """Return the printer class of a dialect; import its module if necessary.

    Raises
    ------
    UsageError : no dialect with a printer has the name, or the package of the dialect cannot be
        imported.
    """
    if name not in _dialects and name in _list_builtin_dialects():
        import_module(f"{DIALECT_PACKAGE}.{name}")
    if name not in _dialects and name in list_entry_points(ENTRY_POINT_GROUP):
        dialect = load_plugin(ENTRY_POINT_GROUP, name)
        _dialects[name] = _require_dialect(dialect, f"entry point {name} of {ENTRY_POINT_GROUP}")
    if name not in _dialects:
        raise make_unknown_dialect_error(name, list_dialect_names())
    return _dialects[name]
