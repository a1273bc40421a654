"""Errors about attributes that an object does not have, with the function to call instead."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

# Names under which users look for the method that writes an object to files.
WRITING_METHODS = (
    "write", "save", "export", "to_file", "to_spice", "to_netlist", "to_lib", "netlist", "to_csv",
)  # fmt: skip


def make_index_error(value: object, advice: str) -> TypeError:
    """Make the error about an index of an object without items, with advice."""
    return TypeError(f"{type(value).__name__!r} object is not subscriptable; {advice}")


class AdvisesOnAttributes:
    """Base of public classes whose errors about unknown attributes contain advice.

    ``_attribute_advice`` contains advice, keyed by the name of an attribute that does not exist.
    """

    _attribute_advice: ClassVar[Mapping[str, str]] = {}

    if not TYPE_CHECKING:  # otherwise mypy would accept every attribute

        def __getattr__(self, name: str) -> Any:
            """Raise the error about an unknown attribute, with advice if there is any."""
            if hasattr(type(self), name):  # the code of a property has raised an AttributeError
                return object.__getattribute__(self, name)
            advice = self._attribute_advice.get(name)
            message = f"{type(self).__name__!r} object has no attribute {name!r}"
            message += f"; {advice}" if advice else ""
            raise AttributeError(message, name=name, obj=self)
