"""Catalogue of commercial parts, with data-sheet values, sources and dates.

``catalogue.toml`` contains one table for each part number. A part number is accepted instead of the
name of a scene. The scene of a part number contains the part in a test circuit.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib import resources
from typing import Any

from kc2spice.core.errors import UsageError, did_you_mean
from kc2spice.core.untrusted_files import make_identifier


@dataclass(frozen=True)
class CataloguePart:
    """Commercial part, with the TOML text of a scene that contains the part.

    ``keys`` are the lines of the part's table in the scene. ``band`` contains the first and the
    last frequency of the scene's analysis. For analyses other than ``ac``, ``band`` is empty.
    ``redundant`` contains data-sheet values that the model does not use, for comparison.
    ``assumed`` describes values that the data sheet does not contain. If a part has no ``keys``,
    ``scene`` is the name of a built-in scene.
    """

    number: str
    kind: str
    maker: str
    device: str
    source: str
    date: str
    keys: str = ""
    band: Sequence[str] = ()
    scale: str = "log"
    assumed: str = ""
    scene: str = ""
    redundant: Mapping[str, float] = field(default_factory=dict)

    @property
    def title(self) -> str:
        """Title of the part: manufacturer, part number and device."""
        return f"{self.maker} {self.number}: {self.device}"

    @property
    def searched_text(self) -> str:
        """Text for searches: number, manufacturer, device and kind in lower case."""
        return f"{self.number} {self.maker} {self.device} {self.kind}".casefold()

    @property
    def scene_name(self) -> str:
        """Name of the scene that contains the part."""
        return make_identifier(self.number, "part")

    @property
    def rated_voltage(self) -> str:
        """Value of the key ``voltage`` as text, or "" if the part states no voltage."""
        lines = (line.split('"')[1] for line in self.keys.splitlines() if "voltage =" in line)
        return next(lines, "")

    @property
    def text(self) -> str:
        """TOML text of a scene with the part in its test circuit."""
        circuit = _read_tables()["circuits"][self.kind]
        lines = [f"# {self.source}, {self.date}"]
        lines += [f"# assumed: {self.assumed}"] if self.assumed else []
        lines += [f'title = "{self.title}"', "", "[device]", f'part = "{self.kind}"']
        lines += [f'number = "{self.number}"', self.keys.strip(), f"pins = {circuit['pins']}", ""]
        lines.append(circuit["text"].strip().replace("%RATED%", self.rated_voltage))
        if self.band:
            low, high = self.band
            lines += ["", "[analysis]", 'type = "ac"', f'start = "{low}"', f'stop = "{high}"']
            lines += [f'scale = "{self.scale}"', "points = 300"]
        return "\n".join((*lines, ""))


@cache
def _read_tables() -> dict[str, Any]:
    """Read the tables of the catalogue file, ``catalogue.toml``."""
    text = (resources.files("kc2spice") / "scene" / "catalogue.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)


@cache
def read_catalogue() -> Mapping[str, CataloguePart]:
    """Return all catalogue parts, keyed by part number.

    Examples
    --------
    >>> read_catalogue()["7BB-20-6"].maker
    'Murata'
    """
    tables = _read_tables()["parts"]
    result: dict[str, CataloguePart] = {}
    for number, table in sorted(tables.items()):
        result[number] = CataloguePart(number, **table)
    return result


def find_part(name: str) -> CataloguePart | None:
    """Return the part with a part number (any letter case), or None."""
    parts = read_catalogue()
    numbers = {number.casefold(): number for number in parts}
    number = numbers.get(name.casefold())
    return None if number is None else parts[number]


def search_parts(words: str = "") -> list[CataloguePart]:
    """Return the catalogue parts that match all search ``words``.

    The words may occur in the part number, manufacturer, device or kind.

    Raises
    ------
    UsageError : no part matches the words.

    Examples
    --------
    >>> [part.number for part in search_parts("murata 20")]
    ['7BB-20-3', '7BB-20-6']
    """
    parts, searched = read_catalogue(), words.casefold().split()
    result = [
        part for part in parts.values() if all(map(part.searched_text.__contains__, searched))
    ]
    if not result:
        makers = sorted({part.maker for part in parts.values()})
        raise UsageError(
            "no part matches these words",
            where="parts",
            got=repr(words),
            expected=f"a part number, a manufacturer or a device, such as {', '.join(makers[:5])}",
            hint=did_you_mean(words, " ".join(makers).split())
            or "run kc2spice parts, which lists all parts",
        )
    return result
