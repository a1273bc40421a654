"""Library files with the subcircuits of parts, their pins, units and parameters."""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from operator import attrgetter, itemgetter
from pathlib import Path
from typing import Any, ClassVar

from kc2spice.core import __version__
from kc2spice.core.argument_and_option_names import check_arguments
from kc2spice.core.attribute_advice import WRITING_METHODS, AdvisesOnAttributes
from kc2spice.core.errors import UsageError
from kc2spice.core.files import create_parent_folders, suggest_file
from kc2spice.core.untrusted_files import decode_text, read_bounded, reject_toml_file
from kc2spice.netlist.card_parser import read_cards
from kc2spice.netlist.circuit import (
    Circuit,
    Element,
    Param,
    Pin,
    make_electrical_pins,
    select_items,
)
from kc2spice.netlist.expression import parse_literal
from kc2spice.netlist.number_and_name_spelling import format_comment, format_number, require_word
from kc2spice.netlist.number_and_name_spelling import require_name as checked_name
from kc2spice.netlist.printers.ngspice import Printer, locate_cards
from kc2spice.netlist.scale_factors import format_with_prefix

MAX_LIBRARY_BYTES = 100_000_000  # largest permitted size of a library file in bytes
_PIN_LINE = re.compile(r"\* @pin \d+ (\w+) unit=(\S+) flow=(\S+)")
_PARAMETER_LINE = re.compile(r"\* @param (\w+)=(\S+) unit=(\S+)(?: range=(\S+)\.\.(\S+))? ?(.*)")


@dataclass(frozen=True)
class Header:
    """Data for the header of a netlist: name of the scene and hash of the input data."""

    scene: str
    scene_hash: str

    def origin(self) -> tuple[str, ...]:
        """Return tool version, scene and licence as comment lines."""
        return (
            f"* tool: kc2spice {__version__}",
            f"* scene: {format_comment(self.scene)} hash={format_comment(self.scene_hash)}",
            "* licence: GPL-3.0-or-later",
        )


def write_model_comments(plan: Mapping[str, Any], without: Collection[str] = ()) -> tuple[str, ...]:
    """Return comments about the models, neglected effects and settings of a deck."""
    error = "not estimated" if plan["error_budget"] is None else f"budget {plan['error_budget']:g}"
    settings = []
    for item in plan["settings"]:
        if item["key"] not in without:
            settings.append(f"{item['key']} {item['value']:g}")
    facts = {
        "modelled": ", ".join(map(itemgetter("part"), plan["parts"])),
        f"numerical settings (error {error})": ", ".join(settings),
        "neglected effects (for their sizes: kc2spice explain)": "; ".join(
            map(itemgetter("effect"), plan["left_out"])
        ),
    }
    lines = list[str]()
    for head, text in facts.items():
        if text:
            lines += textwrap.wrap(format_comment(f"{head}: {text}"), 96, subsequent_indent="  ")
    return tuple(map("* {}".format, lines))


@dataclass(frozen=True)
class ReductionSummary:
    """Number of states, band and accuracy of the reduced model of a part.

    ``error_estimate`` is the relative error of the response in the ``norm``. ``error_estimate``
    includes ``circuit_error``: the difference between circuit and model, which is largest at the
    frequency ``worst_hz``.
    """

    order: int
    band_hz: tuple[float, float]
    norm: str
    error_estimate: float
    circuit_error: float = 0.0
    worst_hz: float = 0.0

    @property
    def summary(self) -> str:
        """Number of states, band and rounded-up error estimate, as a line of text."""
        low, high = map(format_number, self.band_hz)
        error = format_number(_round_up(self.error_estimate))
        return f"order={self.order} band={low}..{high} Hz norm={self.norm} error={error}"


def _round_up(value: float) -> float:
    """Round a number up to three significant digits, as required for an error bound."""
    mantissa, _, exponent = f"{value:.2e}".partition("e")
    rounded = float(f"{mantissa}e{exponent}")
    return rounded if rounded >= value else float(f"{float(mantissa) + 0.01:.2f}e{exponent}")


@dataclass(frozen=True, repr=False)
class Subcircuit(AdvisesOnAttributes):
    """Subcircuit of a part, with its pins and parameters, in a library file.

    ``circuit`` is the tree of the library file that contains the ``.subckt`` with this ``name``.
    ``title`` is ``NAME: description``. ``file`` is the name of the library file if it differs from
    ``NAME.lib``. ``no_module`` is the reason why the part cannot be a Verilog-A module; it is empty
    if a module is possible. ``reduction`` is None if the part has no reduced model. ``source`` is
    the text of a library by another author, which is written unchanged. If ``source`` is empty, the
    text of the library is printed from ``circuit``. The first ``header_lines`` comments above the
    ``.subckt`` are the header.
    """

    _attribute_advice: ClassVar[Mapping[str, str]] = dict.fromkeys(
        WRITING_METHODS,
        'write("NAME.lib") writes the library; the attribute `text` contains its text',
    )

    name: str
    pins: tuple[Pin, ...]
    params: tuple[Param, ...]
    circuit: Circuit
    title: str = ""
    file: str = ""
    no_module: str = ""
    reduction: ReductionSummary | None = None
    source: str = ""
    header_lines: int = 0

    @property
    def filename(self) -> str:
        """Name of the library file that contains this part."""
        return self.file or f"{self.name}.lib"

    @cached_property
    def text(self) -> str:
        """Text of the library file in the syntax of ngspice."""
        return self.source or Printer().format_file(self.circuit)

    @cached_property
    def located_tree(self) -> Circuit:
        """Syntax tree in which each card stores its text and its position in the library file."""
        return self.circuit if self.source else locate_cards(self.circuit, self.filename)

    def with_circuit(self, circuit: Circuit) -> Subcircuit:
        """Return a copy of the subcircuit with ``circuit`` as its syntax tree.

        The text of the copy is written from this syntax tree.
        """
        return replace(self, circuit=circuit, source="")

    def write(self, path: str | Path) -> Path:
        """Write the library file to a path, or to a directory with the default name.

        Missing folders of the path are created.

        Raises
        ------
        UsageError : the file cannot be written.
        """
        with create_parent_folders(path) as file:
            if file.is_dir():
                file = file / self.filename
            file.write_text(self.text, encoding="utf-8")
        return file

    def __repr__(self) -> str:
        """Return a short description of the part."""
        pins = " ".join(f"{pin.name}[{pin.unit}/{pin.flow}]" for pin in self.pins)
        params = " ".join(f"{param.name}={param.default:g}" for param in self.params)
        return f"<Subcircuit {self.name}: pins {pins}{'; ' + params if params else ''}>"


@check_arguments
def read_lib(path: str | Path) -> list[Subcircuit]:
    """Read the parts of a library file.

    The header of a subcircuit declares pins, units and parameters. A subcircuit without a header is
    also a part if no other subcircuit in the file instantiates it. Without a header, all pins are
    electrical, and the parameters have no units.

    Parameters
    ----------
    path : str or Path
        Path of the library file.

    Returns
    -------
    list[Subcircuit]
        Parts in the order of the file.

    Raises
    ------
    UsageError : the file is missing, is not text or contains no subcircuit, or a header contradicts
        the ``.subckt`` card.

    Examples
    --------
    >>> from pathlib import Path
    >>> import kc2spice as kc
    >>> cards = [".subckt divider top mid low total=1k", "R1 top mid {0.5*total}"]
    >>> cards += ["R2 mid low {0.5*total}", ".ends divider"]
    >>> _ = Path("divider.lib").write_text("\\n".join(["* divider", *cards]))
    >>> kc.read_lib("divider.lib")
    [<Subcircuit divider: pins top[V/A] mid[V/A] low[V/A]; total=1000>]
    """
    path = Path(path)
    reject_toml_file(path, "a netlist with at least one .subckt")
    try:
        text = decode_text(read_bounded(path, MAX_LIBRARY_BYTES))
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        message = "this library cannot be read"
        hint = f"check the permissions and the encoding of {path}"
        if isinstance(error, FileNotFoundError):
            hint = suggest_file(path) or f"copy {path.name} to {path.parent.absolute()}"
            message = "this file does not exist"
        raise UsageError(
            message,
            where=str(path),
            got=None if message.endswith("exist") else reason,
            expected="a netlist with at least one .subckt",
            hint=hint,
        ) from None
    parts = parse_subcircuits(text, path.name)
    if not parts:
        raise UsageError(
            "this library contains no subcircuit",
            where=str(path),
            expected="a netlist with at least one .subckt",
            hint="put the elements between  .subckt NAME PIN1 PIN2  and  .ends NAME",
        )
    return parts


def write_instance_comment(name: str, pins: Iterable[str], defaults: Mapping[str, str]) -> str:
    """Return an example ``X`` line as a comment; its nodes have the names of the pins.

    Examples
    --------
    >>> write_instance_comment("contact", ("ring", "v", "base"), {"eps": "400000000.0"})
    '* use: X1 ring v base contact eps=400meg'
    """
    settings = (f"{key}={format_with_prefix(value)}" for key, value in defaults.items())
    return " ".join(("* use: X1", *pins, name, *settings))


def write_parameter_line(param: Param) -> str:
    """Return the comment with default, unit, range and meaning of a parameter."""
    bounded = math.isfinite(param.low) or math.isfinite(param.high)
    bounds = f" range={param.low:g}..{param.high:g}" if bounded else ""
    value = f"{checked_name(param.name)}={format_number(param.default)}"
    head = f"* @param {value} unit={require_word(param.unit)}"
    return f"{head}{bounds} {format_comment(param.doc)}"


def parse_subcircuits(text: str, file: str) -> list[Subcircuit]:
    """Return the subcircuits of parts that the text of a library file defines."""
    library = read_cards(text, file)
    parts = list(filter(parse_declared_pins, library.subcircuits))
    if not parts:
        inner = set(chain.from_iterable(map(_list_instantiated_names, library.subcircuits)))
        parts = [item for item in library.subcircuits if item.name.lower() not in inner]
    return [_make_part(item, library, text, file) for item in parts]


def _list_instantiated_names(circuit: Circuit) -> Iterator[str]:
    """Yield the lower-case names of the subcircuits that a circuit instantiates."""
    for item in select_items(circuit.items, Element):
        if item.kind == "x":
            yield item.model.lower()
    for inner in circuit.subcircuits:
        yield from _list_instantiated_names(inner)


def join_comments(notes: Iterable[str]) -> list[str]:
    """Join comments with their continuation lines.

    A continuation line begins with at least three blanks.
    """
    return "\n".join(notes).replace("\n*   ", " ").split("\n")


def parse_declared_pins(circuit: Circuit) -> list[Pin]:
    """Return the pins that the header of a subcircuit declares."""
    return [Pin(*match.groups()) for match in map(_PIN_LINE.match, circuit.notes) if match]


def _make_part(circuit: Circuit, library: Circuit, text: str, file: str) -> Subcircuit:
    """Return a subcircuit of a library file as a part with pins and parameters.

    Raises
    ------
    UsageError : the header and the ``.subckt`` card have different pins.
    """
    pins = parse_declared_pins(circuit)
    if pins and list(map(attrgetter("key"), pins)) != list(map(str.lower, circuit.pins)):
        listed = " ".join(map(attrgetter("name"), pins))
        message = "the header does not list the pins of the subcircuit"
        raise circuit.make_error(message, listed, " ".join(circuit.pins))
    heads = {m[1].lower(): m for m in map(_PARAMETER_LINE.match, join_comments(circuit.notes)) if m}
    params = []
    for name, default in circuit.defaults.items():
        value, head = parse_literal(default, where=circuit.where), heads.get(name.lower())
        labels = (
            (head[3], head[6], float(head[4] or "-inf"), float(head[5] or "inf")) if head else ()
        )
        params.append(Param(name, math.nan if value is None else value, *(labels or ("-", ""))))
    ends = tuple(pins) or make_electrical_pins(circuit.pins)
    title = join_comments(text.split("\n"))[0].lstrip("* ")
    return Subcircuit(
        circuit.name, ends, tuple(params), library, title=title, file=file, source=text
    )
