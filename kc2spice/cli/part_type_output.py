"""Terminal output about part types: pins, keys, example and results."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any

from kc2spice.cli.terminal_output import PIPED_COLUMNS, print_table
from kc2spice.core.domains import ACCELERATION, SIGNAL
from kc2spice.core.si_prefix_format import format_quantity, show_unit
from kc2spice.core.toml_text import format_toml

if TYPE_CHECKING:
    from kc2spice.scene.keys import KeyDescription
    from kc2spice.scene.part_type_descriptions import PartTypeReference
    from kc2spice.scene.scene_classes import Terminal

PINS_NOTE = (
    'The key `pins` of a part connects each pin to a pin "PART.PIN" of another part, or to "gnd". '
    "In the netlist, 1 V represents 1 unit of the column `across`, and 1 A represents 1 unit of "
    "the column `through`."
)
INDENT = 4 * " "  # indentation of the description of a key
DEFAULT_DIGITS = 12  # significant digits of a default value


def print_part_type(doc: PartTypeReference) -> None:
    """Print pins, keys, example and results of a part type."""
    summary = _unify_quotes(f"{doc.name}: {doc.title}. {doc.doc}")
    print(textwrap.fill(summary, PIPED_COLUMNS) + "\n")
    pins = [(pin.name, *_describe_quantities(pin), _describe_default_net(pin)) for pin in doc.pins]
    if pins:
        title = "Pins of the example" if doc.origin_of_pins else "Pins"
        print_table(title, pins, ("pin", "across", "through", "if not connected"), names=0)
    if doc.optional_pins:
        optional = list(doc.optional_pins.items())
        print_table("Further pins", optional, ("pin", "added by the key"), names=0)
    if doc.origin_of_pins:
        print(textwrap.fill(doc.origin_of_pins, PIPED_COLUMNS))
    if pins or doc.optional_pins:
        print(textwrap.fill(PINS_NOTE, PIPED_COLUMNS) + "\n")
    print_keys("Keys", doc.keys)
    if doc.example:
        print(f"\nExample\n{doc.example}")
    if doc.results:
        names = ", ".join(f"PART.{name}" for name in doc.results)
        text = f"Results of the example, for a part with the name PART: {names}"
        print("\n" + textwrap.fill(text, PIPED_COLUMNS, break_on_hyphens=False))


def print_keys(title: str, keys: Iterable[KeyDescription]) -> None:
    """Print name, unit, default and description of each key, at full width."""
    print(title)
    for key in keys:
        heading = _write_heading(key)
        print(textwrap.fill(heading, PIPED_COLUMNS, subsequent_indent=2 * INDENT))
        if key.doc:
            doc = INDENT + _unify_quotes(key.doc)
            print(textwrap.fill(doc, PIPED_COLUMNS, subsequent_indent=INDENT))


def _write_heading(key: KeyDescription) -> str:
    """Return the first line about a key: name, unit or choices, and default.

    Examples
    --------
    >>> from kc2spice.scene.keys import KeyDescription
    >>> _write_heading(KeyDescription("gap", "m", 5e-4, (), "Width of the gap"))
    'gap [m], default "500 µm"'
    >>> _write_heading(KeyDescription("wiring", None, "series", ("series", "parallel"), ""))
    'wiring = "series" | "parallel", default "series"'
    """
    text = key.name
    if key.choices:
        text += f" = {' | '.join(map(format_toml, key.choices))}"
    elif key.unit:
        text += f" [{show_unit(key.unit)}]"
    if key.required:
        table = key.name.rpartition(".")[0]
        return f"{text}, required{f' in {table}' if table else ''}"
    # A description of the default in words is more precise than the value.
    if key.default is None or "default" in key.doc.lower():
        return f"{text}, optional"
    return f"{text}, default {_write_default(key.default, key.unit)}"


def _write_default(value: Any, unit: str | None) -> str:
    """Return a default value as TOML text, with a unit if the key has one."""
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(_write_default(item, unit) for item in value)}]"
    if unit and isinstance(value, (int, float)) and value:
        quantity = format_quantity(value, unit, DEFAULT_DIGITS).replace("\u2212", "-")
        return f'"{quantity}"'
    if isinstance(value, float):
        return f"{value:.{DEFAULT_DIGITS}g}"
    return format_toml(value)


def _describe_quantities(pin: Terminal) -> Iterator[str]:
    """Yield the across and the through quantity of a pin, each with its unit."""
    quantity, domain = pin.across, pin.domain
    yield _describe_quantity("signal" if quantity is None else quantity.name, pin.unit)
    if pin.flow == SIGNAL:
        yield ""
    else:
        through = None if domain is None else domain.through
        yield _describe_quantity("flow" if through is None else through.name, pin.flow)


def _describe_quantity(name: str, unit: str) -> str:
    """Return the name of a quantity and its unit, such as ``force [N]``."""
    return name.replace("_", " ") + (f" [{show_unit(unit)}]" if unit else "")


def _describe_default_net(pin: Terminal) -> str:
    """Describe what a scene connects to a pin that it does not mention."""
    if pin.required:
        return "error"
    if pin.domain is not None and pin.domain.name == ACCELERATION.name:
        return pin.default or "at rest"
    return pin.default or "open"


def _unify_quotes(text: str) -> str:
    """Return a docstring with single backticks around names of keys and values."""
    return text.replace("``", "`")
