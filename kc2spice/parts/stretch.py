"""Stretching of a beam that both ends hold: bending lengthens it, and its tension stiffens it.

Of a beam of length l whose ends stay where they are, ``e = int w'^2 dx / 2`` is how much longer it
is when bent, and ``stiffness e^2 / 2 + tension e`` the energy of that: stiffness = E A / l (S. D.
Senturia, Microsystem Design, 2001, chapter 10). The deflection is known by the means w_k of a row
of equal strips of width d, from clamp to clamp; between two of them ``w' = (15 (w_k+1 - w_k) -
(w_k+2 - w_k-1)) / (12 d)``, exact for cubics, and beyond a clamp w is its mirror image.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Annotated

from pydantic import Field

from kc2spice.core.quantities import Length, Section, Stiffness, si
from kc2spice.parts.gap import Patched, patches
from kc2spice.physics import Declaration, displacement
from kc2spice.scene.model import Part, Scene
from kc2spice.scene.parttype import register


class StretchKeys(Section):
    """``a`` is a beam with a row of patches, clamped at both ends, or at least three ports."""

    a: str | tuple[str, ...] = Field(description="body with patches, or its ports")
    length: Length = Field(gt=0, description="of the beam, that of all patches")
    stiffness: Stiffness = Field(gt=0, description="along the beam, E A / length")
    tension: Annotated[float, si("N")] = Field(
        0.0, description="at rest, besides a residual_stress of the body"
    )


class Stretch(Patched):
    """The part type; how many branches it has is up to its keys."""

    def declared(self, part: Part, scene: Scene) -> Declaration:
        return _declared(len(patches(part, scene)))


@lru_cache(maxsize=32)
def _declared(count: int) -> Declaration:
    """The physics of a row of so many patches."""
    strips = range(1, count + 1)

    def w(k: int) -> str:
        return f"x{1 - k if k < 1 else 2 * count + 1 - k if k > count else k}"

    slopes = [f"(15*({w(k + 1)} - {w(k)}) - ({w(k + 2)} - {w(k - 1)}))" for k in strips[:-1]]
    longer = f"{count}/length/288*({' + '.join(f'{slope}^2' for slope in slopes)})"
    return Declaration(
        "stretch",
        "stretching of a beam that both ends hold",
        StretchKeys,
        tuple(displacement(f"x{k}", f"p{k}", "b", f"force{k}") for k in strips),
        energy=f"0.5*stiffness*({longer})^2 + tension*{longer}",
        neglected=(
            ("inertia along the beam", "its tension is the same everywhere", "not estimated"),
            ("supports that give way", "both ends stay where they are", "not estimated"),
        ),
        example=EXAMPLE,
    )


EXAMPLE = """
[stretch]
part = "stretch"
a = ["left.a", "middle.a", "right.a"]
length = "0.1 mm"
stiffness = "1e4 N/m"

[left]
part = "spring"
stiffness = "1 N/m"

[middle]
part = "spring"
stiffness = "1 N/m"

[right]
part = "spring"
stiffness = "1 N/m"

[push]
part = "source"
kind = "force"
dc = "1 uN"
pins = { out = "middle.a" }
"""
register(Stretch(_declared(3)))
