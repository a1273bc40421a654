"""Changes of scene keys that errors propose, as data.

An error contains an action, such as ``SetKey``, in place of the text of a hint. The text of an
action is worded for a user who edits a TOML file. Other methods write the same action as an option
``--set`` of the command line, or as an entry of a Python mapping. The errors are in
:mod:`kc2spice.core.errors`.
"""

from __future__ import annotations

import re
import shlex
import tomllib
from dataclasses import dataclass
from typing import Literal, TypeAlias

_QUOTED = re.compile(r'"[^"\\]*"')  # pattern of a TOML string that needs no quotes in an override

Direction: TypeAlias = Literal["raise", "lower"]
Preposition: TypeAlias = Literal["to", "above", "below"]

_SWEEP_ADVICE = "write one value; to run all values:"  # text before a command or a call


@dataclass(frozen=True)
class SetKey:
    """Proposal to set a key of a table to a value.

    Parameters
    ----------
    table : name of the table, such as ``analysis`` or ``disc.layers[0]``.
    key : name of the key.
    value : TOML text of the value, such as ``"1 ms"`` with its quotes.
    verb : ``add`` if the table lacks the key, otherwise ``write``.
    place : name of the table in the text for a TOML file, by default the header ``[table]``; an
        empty text if the place is obvious.
    begin, end : texts before and after the proposal.

    Examples
    --------
    >>> print(SetKey("analysis", "stop", '"1 ms"', verb="add"))
    add  stop = "1 ms"  to [analysis]
    >>> print(SetKey("rom", "tolerance", "0.05", begin="for 5 %, "))
    for 5 %, write  tolerance = 0.05  in [rom]
    """

    table: str
    key: str
    value: str
    verb: Literal["add", "write"] = "write"
    place: str | None = None
    begin: str = ""
    end: str = ""

    def __str__(self) -> str:
        place = f"[{self.table}]" if self.place is None else self.place
        inside = f"  {'to' if self.verb == 'add' else 'in'} {place}" if place else ""
        return f"{self.begin}{self.verb}  {self.key} = {self.value}{inside}{self.end}"

    @property
    def path(self) -> str:
        """Dotted key that the action sets, such as ``analysis.stop``."""
        return f"{self.table}.{self.key}" if self.table else self.key

    def write_as_option(self, verb: str, end: str = "") -> str:
        """Write the action as an option ``--set`` of the command line.

        >>> SetKey("analysis", "stop", '"1 ms"').write_as_option("add")
        "add  --set 'analysis.stop=1 ms'"
        """
        value = self.value[1:-1] if _QUOTED.fullmatch(self.value) else self.value
        text = shlex.quote(f"{self.path}={value}")
        return f"{self.begin}{verb}  --set {text}{self.end}{end}"

    def write_as_override(self, verb: str, end: str = "") -> str:
        """Write the action as an entry of the Python mapping ``overrides``.

        >>> SetKey("analysis", "stop", '"1 ms"').write_as_override("add")
        'add  \\'analysis.stop\\': "1 ms"  in the overrides'
        """
        return f"{self.begin}{verb}  '{self.path}': {self.value}  in the overrides{self.end}{end}"

    def write_as_dict_entry(self) -> str:
        """Write the action as an entry of a Python dict with the keys of the table.

        If ``value`` is not valid TOML, such as a placeholder, the result is the text for a TOML
        file.

        >>> SetKey("load", "wait", "true", verb="add").write_as_dict_entry()
        "add  'wait': True  to the dict load"
        """
        try:
            value = tomllib.loads(f"value = {self.value}")["value"]
        except ValueError:
            return str(self)
        holder = f"the dict {self.table}" if self.table else "the outermost dict"
        entry = f"{self.key!r}: {value!r}  {'to' if self.verb == 'add' else 'in'} {holder}"
        return f"{self.begin}{self.verb}  {entry}{self.end}"


@dataclass(frozen=True)
class DeleteKey:
    """Proposal to delete a key.

    ``place`` is the place of the key in the text for a TOML file, such as ``[solver]``. ``end`` is
    a text after the proposal.

    Examples
    --------
    >>> print(DeleteKey("max_step", place="[solver]"))
    delete the key `max_step` of [solver]
    """

    key: str
    place: str = ""
    end: str = ""

    def __str__(self) -> str:
        return f"delete the key `{self.key}`{self.place and f' of {self.place}'}{self.end}"

    def write_as_option(self, option: str) -> str:
        """Write the action as the removal of an option ``--set`` of the command line.

        >>> DeleteKey("max_step").write_as_option("--set 'solver.max_step=1 s'")
        "leave out --set 'solver.max_step=1 s'"
        """
        return f"leave out {option}{self.end}"

    def write_as_override(self, override: str) -> str:
        """Write the action as the removal of an entry of the Python mapping ``overrides``.

        >>> DeleteKey("max_step").write_as_override("'solver.max_step=1 s'")
        "remove 'solver.max_step=1 s' from the overrides"
        """
        return f"remove {override} from the overrides{self.end}"


@dataclass(frozen=True)
class ChangeKey:
    """Proposal to raise or lower the numeric value of a key to a limit.

    Parameters
    ----------
    verb, preposition : direction of the change.
    key : name of the key in the table that the error is about, or the full dotted name of the key.
    limit : number with its unit.

    Examples
    --------
    >>> print(ChangeKey("raise", "pulse.period", "to", "1 ms"))
    raise pulse.period to 1 ms
    """

    verb: Direction
    key: str
    preposition: Preposition
    limit: str

    def __str__(self) -> str:
        return f"{self.verb} {self.key} {self.preposition} {self.limit}"


@dataclass(frozen=True)
class SweepKey:
    """Proposal to run a scene at each of several values of a key.

    ``path`` is the dotted key. ``values`` are numbers, or texts with units. ``scene`` is the name
    or path of the scene.

    Examples
    --------
    >>> print(SweepKey("load.resistance", ("1 Ohm", "2 Ohm")))
    write one value; to run all values:  kc2spice sweep SCENE --set 'load.resistance=1 Ohm,2 Ohm'
    """

    path: str
    values: tuple[str | float, ...]
    scene: str = "SCENE"

    def __str__(self) -> str:
        text = shlex.quote(f"{self.path}={','.join(map(str, self.values))}")
        scene = self.scene if self.scene == "SCENE" else shlex.quote(self.scene)
        return f"{_SWEEP_ADVICE}  kc2spice sweep {scene} --set {text}"

    def write_as_call(self) -> str:
        """Write the action as a call of a Python function.

        >>> print(SweepKey("load.resistance", (1, 2), scene="divider.toml").write_as_call())
        write one value; to run all values:  kc.sweep('divider.toml', {'load.resistance': [1, 2]})
        """
        scene = self.scene if self.scene == "SCENE" else repr(self.scene)
        return f"{_SWEEP_ADVICE}  kc.sweep({scene}, {{{self.path!r}: {list(self.values)!r}}})"


KeyAction: TypeAlias = SetKey | DeleteKey | ChangeKey | SweepKey
Hint: TypeAlias = str | KeyAction  # next action of an error: a text, or data
