"""Keys of a body that ``rom.parameters`` lists as parameters of its netlist.

The module also contains functions that return a part with other values of such keys.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product
from typing import Any

from pydantic import BaseModel

from kc2spice.core.errors import UsageError, did_you_mean, list_candidates, wrong
from kc2spice.core.key_errors import validate_table
from kc2spice.core.schemas import find_unit, join_path, list_keys
from kc2spice.fem.materials import MaterialTable
from kc2spice.netlist.circuit import Param
from kc2spice.parts.bodies._linear_body_keys import LinearKeysT
from kc2spice.rom.parametric_models import MAX_PARAMETERS, ParameterAxis
from kc2spice.scene.scene_classes import GovernedScene, Part

RANGES_KEY = "rom.parameters"
MIN_RELATIVE_WIDTH = 1e-3  # smallest relative width of a range


@dataclass(frozen=True)
class VariedKey:
    """Numeric key of a part that varies over a range, such as ``layers[1].thickness``.

    Some part types permit a range that begins at zero.
    """

    key: str
    unit: str
    value: float
    low: float
    high: float

    @property
    def parameter_axis(self) -> ParameterAxis:
        """Parameter of the model reduction that represents the key and its range."""
        return ParameterAxis(self.key, self.low, self.high, from_zero=self.low == 0)

    @property
    def netlist_parameter(self) -> Param:
        """Parameter of the netlist that represents the key."""
        name = re.sub(r"\W+", "_", self.key).strip("_")
        unit = self.unit.replace(" ", "*") or "-"  # a header needs a unit without blanks
        return Param(name, self.value, unit, self.key, self.low, self.high)


def list_varied_keys(part: Part[LinearKeysT]) -> tuple[VariedKey, ...]:
    """Return the keys in ``rom.parameters`` of the part, with their ranges.

    Raises
    ------
    UsageError : there are too many keys, the part has no such numeric key, a range is empty or does
        not contain the value of the part, or a value is invalid.
    """
    ranges = part.parameter_ranges
    where = f"{part.name}.{RANGES_KEY}"
    if len(ranges) > MAX_PARAMETERS:
        raise wrong(
            where,
            "rom.parameters contains too many parameters",
            got=f"{len(ranges)}",
            expected=f"at most {MAX_PARAMETERS}",
            hint=f"delete {len(ranges) - MAX_PARAMETERS} of its entries",
        )
    result = []
    for key, ends in ranges.items():
        value, unit = read_number_key(part, key, where)
        low, high = (read_number_key(with_values(part, {key: end}), key, where)[0] for end in ends)
        zero = part.type.ranges_from_zero  # type: ignore[attr-defined]
        result.append(make_varied_key(key, unit, value, (low, high), f"{where}.{key}", zero))
    return tuple(result)


def read_key_values(keys: Iterable[VariedKey]) -> dict[str, float]:
    """Return the part's value of each varied key, keyed by the name of the key."""
    return {item.key: item.value for item in keys}


def get_middle_values(keys: Iterable[VariedKey]) -> dict[str, float]:
    """Return the middle of each varied key's range, keyed by the name of the key."""
    return {item.key: item.parameter_axis.middle_value for item in keys}


def make_varied_key(
    key: str,
    unit: str,
    value: float,
    ends: tuple[float, float],
    where: str | None = None,
    from_zero: bool = False,
    example: str = "[{:g}, {:g}]",
) -> VariedKey:
    """Return a varied key with its range, whose ``ends`` may have any order.

    With ``from_zero``, the range may begin at zero. ``example`` is the format string with which an
    error message writes a valid range.

    Raises
    ------
    UsageError : the range is empty, or does not contain ``value``.
    """
    low, high = min(ends), max(ends)
    signed = low * high > 0 or (from_zero and low == 0)
    if not signed or high - low < MIN_RELATIVE_WIDTH * abs(high) or not low <= value <= high:
        around = sorted((0.9 * value, 1.1 * value))
        hint = f"write for example  {example.format(*around)}" if value else "vary another key"
        raise wrong(
            where or key,
            "this entry is not a valid range of a parameter",
            got=f"{low:g} to {high:g}",
            expected=(
                "two different numbers of the same sign; the value of the part, "
                f"{value:g}, must be within the range"
            ),
            hint=hint,
        )
    return VariedKey(key, unit, value, low, high)


def check_parameter_ranges(part: Part[LinearKeysT], scene: GovernedScene) -> Iterator[UsageError]:
    """Check parameter ranges at all combinations of end values; yield the first error.

    The check does not build a full model.
    """
    try:
        keys = list_varied_keys(part)
        ranges = {item.key: (item.low, item.high) for item in keys}
        for ends in product(*ranges.values()) if ranges else ():
            corner = with_values(part, dict(zip(ranges, ends, strict=True)))
            corner.type.ports(corner, scene)  # type: ignore[attr-defined]
    except UsageError as error:
        yield error


def with_values(part: Part[LinearKeysT], values: Mapping[str, Any]) -> Part[LinearKeysT]:
    """Return a copy of the part in which some of its keys have other values.

    Raises
    ------
    UsageError : the part cannot have these values.
    """
    table = part.keys.model_dump(exclude_unset=True)
    table.pop("rom", None)
    for key, value in values.items():
        steps = split_key(key)
        holder: Any = table
        try:
            for step, after in pairwise(steps):
                inner = holder.get(step, {}) if isinstance(holder, dict) else holder[step]
                holder[step] = list(inner) if isinstance(after, int) else dict(inner)
                holder = holder[step]
            holder[steps[-1]] = value
        except (KeyError, IndexError, TypeError, ValueError):
            raise _make_non_numeric_key_error(part, key, f"{part.name}.{RANGES_KEY}") from None
    try:
        keys = validate_table(type(part.keys), table, part.name)
        return replace(part, keys=keys.model_copy(update={"rom": part.keys.rom}))
    except UsageError as error:
        got = error.message if error.got is None else f"{error.message}: {error.got}"
        hint = error.hint or f"narrow the ranges in {part.name}.{RANGES_KEY}"
        raise wrong(
            error.where,
            "the ranges of the parameters contain values that the part cannot have",
            got=got,
            expected="ranges in rom.parameters in which every value is valid for the part",
            hint=hint,
        ) from None


def split_key(key: str) -> list[str | int]:
    """Split a dotted key, such as ``layers[1].thickness``, into names and indices."""
    words = re.findall(r"(?<=\[)-?\d+(?=\])|\w+", key)
    return [int(word) if word.lstrip("-").isdigit() else word for word in words]


def _make_non_numeric_key_error(part: Part, key: str, where: str) -> UsageError:
    """Return the error for a ``key`` that is not a numeric key of the part."""
    known = {join_path(path): field for path, field in list_keys(type(part.keys))}
    plain = re.sub(r"\[-?\d+\]", "", key)
    numeric = list(_list_numeric_keys(part.keys.model_copy(update={"rom": None})))
    expected = f"one of {list_candidates(key, numeric)}" if numeric else "a part with numeric keys"
    # a key without the index of a list entry, such as layers.thickness
    entries = [item for item in numeric if item != key and re.sub(r"\[\d+\]", "", item) == key]
    near = f"did you mean {entries[0]!r}?" if entries else did_you_mean(key, numeric)
    advice = near or ("vary one of these keys" if numeric else "fit another part")
    if (entry := _find_missing_entry(part.keys, key)) is not None:
        name, count = entry
        return wrong(
            where,
            f"the list {name} of {part.name} has {count} {'entry' if count == 1 else 'entries'}",
            got=key,
            expected=f"{name}[0] … {name}[{count - 1}]" if count else "a key of another list",
            hint=advice,
        )
    if _has_named_material(part.keys, key):
        return wrong(
            where,
            "a material given only by its name has no constants that can be varied",
            got=key,
            expected=expected,
            hint=(
                'write the material as a table, such as { like = "PZT-5A" }, and vary its constants'
            ),
        )
    if plain in known:
        return wrong(
            where,
            f"this key of {part.name} is not a number",
            got=key,
            expected=expected,
            hint=advice
            if find_unit(known[plain]) is None or entries
            else f"write a number for {key} into the scene first, or vary another key",
        )
    return wrong(
        where,
        f"{part.name} has no numeric key of this name",
        got=key,
        expected=expected,
        hint=advice,
    )


def _list_numeric_keys(value: Any, name: str = "") -> Iterator[str]:
    """Yield the dotted names of all numbers in a table called ``name``."""
    if isinstance(value, float):
        yield name
    elif isinstance(value, BaseModel):
        yield from _list_numeric_keys(dict(value), name)
    elif isinstance(value, Mapping):
        for key, item in value.items():
            yield from _list_numeric_keys(item, f"{name}.{key}".removeprefix("."))
    elif isinstance(value, list | tuple):
        for k, item in enumerate(value):
            yield from _list_numeric_keys(item, f"{name}[{k}]")


def find_value(keys: Any, path: Sequence[str | int]) -> Any:
    """Return the value at a path of names and indices, or None if the path does not exist."""
    for step in path:
        if isinstance(step, str):
            keys = dict(keys).get(step) if isinstance(keys, BaseModel | Mapping) else None
        elif isinstance(keys, list | tuple) and -len(keys) <= step < len(keys):
            keys = keys[step]
        else:
            return None
    return keys


def _has_named_material(keys: Any, key: str) -> bool:
    """Return whether ``key`` lies below a material that the part states only by its name."""
    path = split_key(key)
    if "material" not in path:
        return False
    return isinstance(find_value(keys, path[: path.index("material") + 1]), str)


def _find_missing_entry(keys: Any, key: str) -> tuple[str, int] | None:
    """Return the name and the length of the list that lacks the entry in ``key``.

    The result is None if no index in ``key`` exceeds the length of its list.
    """
    path = split_key(key)
    for depth, step in enumerate(path):
        if isinstance(step, int):
            entries = find_value(keys, path[:depth])
            if not isinstance(entries, list | tuple):
                return None
            if not -len(entries) <= step < len(entries):
                return join_path(tuple(path[:depth])), len(entries)
    return None


def _read_material(part: Part, table: Mapping[str, Any], key: str) -> BaseModel:
    """Return the material that a table states, validated for the type of the part."""
    schema = getattr(part.type, "material_table", MaterialTable)  # a sphere is not a body
    return validate_table(schema, table, f"{part.name}.{key}")


def read_number_key(part: Part, key: str, where: str) -> tuple[float, str]:
    """Return the value of a numeric key of the part, and its SI unit.

    Raises
    ------
    UsageError : the key does not exist, or is not a number that can vary.
    """
    result: Any = part.keys
    unit = ""
    for step in split_key(key):
        if isinstance(result, BaseModel) and step in type(result).model_fields:
            unit = find_unit(type(result).model_fields[str(step)]) or ""
            result = getattr(result, str(step))
            if step == "material" and isinstance(result, Mapping):
                result = _read_material(part, result, key)
        elif isinstance(result, Mapping) and step in result:
            group = result is getattr(part.keys, "materials", None)
            result = result[str(step)]
            if group and isinstance(result, Mapping):
                result = _read_material(part, result, key)
        elif (
            isinstance(result, list | tuple)
            and isinstance(step, int)
            and -len(result) <= step < len(result)
        ):
            result = result[step]
        else:
            raise _make_non_numeric_key_error(part, key, where)
    if isinstance(result, bool | int) or not isinstance(result, float):
        raise _make_non_numeric_key_error(part, key, where)
    return result, unit
