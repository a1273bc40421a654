"""Discovery of part types, dialects and reductors in other installed packages.

Other packages declare part types, dialects and reductors as entry points of a group (Python
Packaging User Guide, "Entry points specification"). The name of an entry point is the name of the
part type, dialect or reductor.
"""

from __future__ import annotations

from functools import cache
from importlib.metadata import EntryPoint, entry_points
from operator import attrgetter

from kc2spice.core.errors import UsageError


@cache
def _list_entry_points(group: str) -> tuple[EntryPoint, ...]:
    """Return the entry points of a group, which installed packages declare."""
    return tuple(entry_points(group=group))


def list_entry_points(group: str) -> tuple[str, ...]:
    """Return the names of a group's entry points, without importing any module.

    Examples
    --------
    >>> list_entry_points("kc2spice.no_such_group")
    ()
    """
    return tuple(map(attrgetter("name"), _list_entry_points(group)))


def load_plugin(group: str, name: str) -> object:
    """Import the plugin of an entry point; return None if the entry point is missing.

    Raises
    ------
    UsageError : the import fails.

    Examples
    --------
    >>> load_plugin("kc2spice.no_such_group", "varistor") is None
    True
    """
    entry = next((item for item in _list_entry_points(group) if item.name == name), None)
    if entry is None:
        return None
    try:
        return entry.load()
    except Exception as error:  # importing another package may raise any error
        package = "the package" if entry.dist is None else entry.dist.name
        raise UsageError(
            "an installed package cannot be imported",
            where=f"entry point {name} of {group}",
            got=f"{type(error).__name__}: {error}",
            expected=f"{entry.value} in {package}",
            hint=f"correct {package}, or remove it with  pip uninstall {package}",
        ) from error


def make_built_in_name_error(kind: str, name: str, where: str, hint: str) -> UsageError:
    """Make the error for a plugin with the name of a built-in one.

    ``kind`` is what the plugin is, such as ``part type`` or ``dialect``.
    """
    return UsageError(
        f"a built-in {kind} has this name",
        where=where,
        got=name,
        expected=f"a name that no built-in {kind} has",
        hint=hint,
    )
