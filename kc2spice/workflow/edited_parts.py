"""Parts of a scene with values from an edited netlist.

If the cards of a part were changed so that its keys no longer describe the part, the part has no
checks.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import replace
from pathlib import Path

from kc2spice.netlist.edited_deck import DeckEdits
from kc2spice.scene.model import BuiltScene, Part
from kc2spice.workflow.models import replace_parts


def with_edited_parameters(build: BuiltScene, edits: DeckEdits, path: Path) -> BuiltScene:
    """Return the build with the parameter values of an edited deck.

    A part is not checked if its keys cannot express its cards in the edited deck. One warning lists
    the unchecked parts, and a second warning lists accuracy options that differ from the scene.
    """
    _warn_about_options(edits, path)
    parts = dict(build.scene.parts)
    reasons = {name: why for name, why in edits.cards.items() if name in parts}
    for name, part in build.scene.parts.items():
        instance = edits.instances.get(f"x{name}".lower())
        if instance is None or name in reasons:
            continue
        if instance.has_other_cards:
            reasons[name] = f"its subcircuit {instance.subcircuit} has other cards"
        for key, old, new in instance.parameters:
            other = replace_key_value(parts[name], key, old, new)
            if other is None:
                reasons[name] = f"none of its keys is the parameter {key} of {instance.subcircuit}"
            parts[name] = other or part
    if reasons:
        lines = "; ".join(map(": ".join, reasons.items()))
        warnings.warn(
            f"{path}: these parts have no checks and no energy balance: {lines}", stacklevel=2
        )
    return replace_parts(build, parts, {*edits.cards, *reasons})


def _warn_about_options(edits: DeckEdits, path: Path) -> None:
    """Warn about accuracy options that differ from the exported deck."""
    different = []
    for key, (old, new) in edits.options.items():
        different.append(f"{key} = {new or 'default'} ({old or 'default'})")
    if different:
        options = ", ".join(different)
        problem = "options of the deck differ from the values of the scene (in brackets)"
        warnings.warn(f"{path}: {problem}: {options}", stacklevel=2)


def replace_key_value(part: Part, name: str, old: float, new: float) -> Part | None:
    """Return the part with a new value of a key, whose name may be in any letter case.

    The result is None if the part has no key ``name`` with the ``old`` value.
    """
    fields = type(part.keys).model_fields
    key = next((field for field in fields if field.lower() == name.lower()), None)
    known = getattr(part.keys, key) if key is not None else None
    if key is None or not isinstance(known, float) or not math.isclose(known, old):
        return None
    return replace(part, keys=part.keys.model_copy(update={key: new}))
