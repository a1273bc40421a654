"""The user's own netlists that a scene includes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from kc2spice.core.errors import UsageError
from kc2spice.core.foreign import name_threat, plain_name
from kc2spice.netlist.deckwide import refuse_in_part
from kc2spice.netlist.flat import flatten
from kc2spice.netlist.scan import cards, checked_lines, text_of_lines


def included_netlists(names: Sequence[str], home: Path, *, trust: bool = False) -> dict[str, str]:
    """The files ``names`` beside a scene in ``home``, each one text with all that it includes, as
    ``{file name in the deck: text}``.

    Raises
    ------
    UsageError : a file that is not there, that could act on the machine (unless ``trust``), that
        acts on the deck beyond its own subcircuits, or two files with one name.
    """
    files: dict[str, str] = {}
    for _, found in _read(names, home, trust):
        for name, text in found.items():
            if files.setdefault(name, text) != text:
                raise UsageError("two different included files have one name", where=name)
    return files


def looked_at(name: str, home: Path) -> dict[str, str]:
    """The file ``name`` as it stands, with what it includes from ``home`` or below: its pins and
    nodes can be known before anybody trusts it to be run.

    Raises
    ------
    UsageError : as :func:`included_netlists`, but for what could act on the machine.
    """
    path = home / name
    lines = flatten(path, path.parent if home == Path() else home, trust=True, inside=True)
    refuse_in_part(cards(lines))
    return {plain_name(path.name): text_of_lines(lines)}


def included_sources(names: Sequence[str], home: Path) -> dict[str, str]:
    """The same texts as ``{name: text}``, to be put beside a copy of the scene.

    Raises
    ------
    UsageError : as :func:`included_netlists`.
    """
    return {name: next(iter(found.values())) for name, found in _read(names, home, False)}


def _read(names: Sequence[str], home: Path, trust: bool) -> Iterator[tuple[str, dict[str, str]]]:
    for name in names:
        path = home / name
        reason = None if trust else name_threat(name)
        if reason:
            raise UsageError(
                f"includes {reason}",
                where="include",
                got=repr(name[:120]),
                expected="names of files beside the scene: letters, digits, blanks and _ . + -",
                hint="copy the netlist beside the scene, or repeat with --trust",
            )
        lines = checked_lines(path, trust=trust, home=home)
        refuse_in_part(cards(lines))
        yield name, {plain_name(path.name): text_of_lines(lines)}
