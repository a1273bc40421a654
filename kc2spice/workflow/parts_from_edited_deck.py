"""Parts of a scene with values from an edited netlist.

If the cards of a part were changed so that its keys no longer describe the part, the part has no
checks.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from kc2spice.core.errors import join_first
from kc2spice.core.user_warnings import warn_user
from kc2spice.netlist.edited_deck import DeckEdits
from kc2spice.scene.scene_classes import BuiltScene, Part
from kc2spice.workflow.part_models import replace_parts


def with_edited_parameters(build: BuiltScene, edits: DeckEdits, path: Path) -> BuiltScene:
    """Return the built scene with the parameter values of an edited deck.

    The run omits the checks of a part if no key of the scene can express the edited cards of the
    part. One warning lists the unchecked parts. Further warnings list accuracy options that differ
    from the scene, and overrides of keys whose values the deck determines.
    """
    if edits.missing_state is not None:
        warn_user(
            f"{path}: this run ignores initial positions, velocities or voltages of the scene, "
            f"because the deck lacks {edits.missing_state}: add the missing text to the deck"
        )
    _warn_about_options(edits, path)
    _warn_about_overrides(build, edits, path)
    parts = dict(build.scene.parts)
    reasons = {name: why for name, why in edits.cards.items() if name in parts}
    for name, part in build.scene.parts.items():
        instance = edits.instances.get(f"x{name}".lower())
        if instance is None or name in reasons:
            continue
        if instance.has_other_cards:
            reasons[name] = (
                f"cards of its subcircuit {instance.subcircuit} differ from the exported deck"
            )
        for key, old, new in instance.parameters:
            other = replace_key_value(parts[name], key, old, new)
            if other is None:
                reasons[name] = (
                    f"none of its keys sets the parameter {key} of {instance.subcircuit}"
                )
            parts[name] = other or part
    if reasons:
        lines = "; ".join(map(": ".join, reasons.items()))
        warn_user(
            f"{path}: no key of the scene can express some edits of the deck; the run omits the "
            f"checks and energy balances of these edited parts: {lines}"
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
        warn_user(f"{path}: {problem}: {options}")


def _warn_about_overrides(build: BuiltScene, edits: DeckEdits, path: Path) -> None:
    """Warn about overrides of keys for which the edited deck has other values."""
    source = build.scene.source
    for key, origin in source.overrides.items() if source is not None else ():
        values = list(dict.fromkeys(_list_conflicting_deck_values(build, edits, key)))
        if values:
            warn_user(
                f"{path}: the run uses the values of the deck, which differ from {origin}: "
                f"{join_first(values, '; ')}; leave out {origin}, or export a new deck with "
                f"{origin} and edit the new deck"
            )


def _list_conflicting_deck_values(
    build: BuiltScene, edits: DeckEdits, key: tuple[str, ...]
) -> Iterator[str]:
    """List values of an edited deck that conflict with the override of a key.

    ``key`` is the path of the overridden key in the scene.
    """
    scene = build.scene
    if key[0] in ("analysis", "solver") and edits.analysis is not None:
        yield edits.analysis
    for name, part in scene.parts.items():
        record = scene.records.get(name)
        if key[: len(part.at)] != part.at:
            continue
        for user in (name, *(record.governed_parts if record else ())):
            if user in edits.cards:
                yield edits.cards[user]
            instance = edits.instances.get(f"x{user}".lower())
            if instance is None:
                continue
            if instance.has_other_cards:
                yield f"cards of the subcircuit {instance.subcircuit} differ from the exported deck"
            # If an edited parameter has the name of another key of the part, the overridden key
            # does not determine the parameter.
            others = {field.lower() for field in type(part.keys).model_fields} - {key[-1].lower()}
            for edited, _, new in instance.parameters:
                if edited.lower() not in others:
                    yield f"{edited} = {new:g} of {user}"


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
