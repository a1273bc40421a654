"""Stretching force of beams and plates with fixed edges.

The stretching force stiffens a beam or plate in large bending.

Bending with the deflection w(x) elongates a beam of length l with fixed ends by ``e = int w'^2 dx /
2``. The elongation e stores the energy ``stiffness e^2 / 2 + tension e`` with stiffness = E A / l
(S. D. Senturia, Microsystem Design, 2001, chapter 10). The model uses the mean deflections w_k of
equal strips of width d, which lie in a row between the clamps. The slope between the strips k and
k+1 is ``w' = (15 (w_k+1 - w_k) - (w_k+2 - w_k-1)) / (12 d)``, which is exact for cubics. Beyond a
clamp, the model continues the deflection w as its mirror image about the clamp.

The energy of a plate that is clamped along all edges has the same expression; its face is divided
into rows of patches. For the plate, ``e = int |grad w|^2 dA / (2 * width)`` and ``stiffness = E * h
* width / (length * (1 - nu^2))``. H. M. Berger, J. Appl. Mech. 22 (1955) 465, derives this
expression by neglecting the second invariant of the in-plane strains. If the slope differs by D
between adjacent rows, the mean of the squared slope exceeds the square of the mean slope by D^2 /
12. The elongation e includes the term D^2 / 12. At a mirror plane, as at a clamp, w continues as
its mirror image. A model of a quarter of a plate therefore uses length, width and stiffness of the
quarter.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from itertools import product
from typing import Annotated

from pydantic import Field

from kc2spice.core.errors import UsageError
from kc2spice.core.quantities import Count, Length, Section, Stiffness, si
from kc2spice.parts.electrostatics.gap import PatchedPart, list_patch_ports
from kc2spice.physics import Declaration, displacement
from kc2spice.scene.parttype import register_part_type
from kc2spice.scene.scene_classes import GovernedScene, Part


class StretchKeys(Section):
    """Keys of the stretching force of a beam or plate.

    The key ``a`` contains the name of a beam that is clamped at both ends and has a row of patches.
    Instead of a name, ``a`` can be a list of at least three ports. ``a`` can also be the name of a
    plate that is clamped along all edges. On a plate, there are ``rows`` rows of patches, numbered
    row by row.
    """

    a: str | tuple[str, ...] = Field(
        examples=['"BODY"'],
        description="Name of the beam or plate with surface patches, or a list of its ports",
    )
    length: Length = Field(
        gt=0,
        description=(
            "Length of the beam or plate, equal to the total length of the patches in one row"
        ),
    )
    stiffness: Stiffness = Field(
        gt=0,
        description=(
            "Axial stiffness E A / length of the beam; for a plate, E A / (length (1 - nu^2))"
        ),
    )
    tension: Annotated[float, si("N")] = Field(
        0.0,
        description=(
            "Axial tensile force in the beam or plate at rest, in addition to the force from "
            "the `residual_stress` of its material"
        ),
    )
    rows: Count = Field(
        1, ge=1, description="Number of equal rows of surface patches across the plate"
    )
    width: Length = Field(
        0.0,
        ge=0,
        description="Width of the plate, equal to the total width of all rows of patches",
    )


class Stretch(PatchedPart[StretchKeys]):
    """Part type ``stretch``: stretching force of a beam or plate with fixed edges."""

    def make_declaration(self, part: Part[StretchKeys], scene: GovernedScene) -> Declaration:
        """Return the declaration of the part for the values of its keys."""
        return _declare_stretching(len(list_patch_ports(part, scene)), part.keys.rows)

    def problems(self, part: Part[StretchKeys], scene: GovernedScene) -> Iterator[UsageError]:
        """Yield an error for each invalid key of the part."""
        keys, count = part.keys, len(list_patch_ports(part, scene))
        if count % keys.rows:
            divisors = [n for n in range(1, count + 1) if count % n == 0]
            nearest = min(divisors, key=lambda n: abs(n - keys.rows))
            yield part.wrong(
                "rows",
                "the number of patches is not a multiple of the number of rows",
                got=f"{count} patches, {keys.rows} rows",
                expected="an equal number of patches in each row",
                hint=f"write  rows = {nearest}",
            )
        if (keys.rows > 1) != (keys.width > 0):
            yield part.wrong(
                "width",
                "rows and width must be used together",
                got=f"rows = {keys.rows}, width = {keys.width:g} m",
                expected="both keys for a plate, or neither for a beam",
                hint="add  width  with the width of the plate" if keys.rows > 1 else "delete width",
            )


@lru_cache(maxsize=32)
def _declare_stretching(count: int, rows: int) -> Declaration:
    """Declare the stretching of a beam or plate of ``count`` patches."""
    along, across = range(1, count // rows + 1), range(1, rows + 1)

    def mirror_index(k: int, count: int) -> int:
        """Return a patch index, mirrored at the clamp if it lies beyond the clamp."""
        if k < 1:
            return 1 - k
        return 2 * count + 1 - k if k > count else k

    def get_deflection_symbol(i: int, j: int) -> str:
        """Return the deflection symbol of a patch; indices beyond a clamp are mirrored."""
        i, j = mirror_index(i, len(along)), mirror_index(j, rows)
        return f"x{(j - 1) * len(along) + i}"

    def write_squared_slope(i: int, j: int, di: int, dj: int) -> str:
        """Write the squared slope between two neighbouring patches as an expression.

        The slope is multiplied by ``12 d``, where d is the distance of the patches.
        """
        before, low, high, after = (
            get_deflection_symbol(i + k * di, j + k * dj) for k in (-1, 0, 1, 2)
        )
        return f"(15*({high} - {low}) - ({after} - {before}))^2"

    lengthwise = [write_squared_slope(i, j, 1, 0) for i, j in product(along[:-1], across)]
    longer = f"{len(along)}/length/{288 * rows}*({' + '.join(lengthwise)})"
    if rows > 1:
        crosswise = [write_squared_slope(i, j, 0, 1) for i, j in product(along, across[:-1])]
        twists = []
        for i, j in product(along[:-1], across[:-1]):
            twists.append(
                f"({get_deflection_symbol(i + 1, j + 1)} - {get_deflection_symbol(i, j + 1)}"
                f" - {get_deflection_symbol(i + 1, j)} + {get_deflection_symbol(i, j)})^2"
            )
        cx, cy = f"{len(along)}/length/{rows}", f"{rows}*length/width^2/{len(along)}"
        longer += f" + {cy}/288*({' + '.join(crosswise)})"
        longer = f"({longer} + ({cx} + {cy})/24*({' + '.join(twists)}))"
    return Declaration(
        "stretch",
        "mid-plane stretching of a beam clamped at both ends, or of a plate clamped all round",
        StretchKeys,
        tuple(displacement(f"x{k}", f"p{k}", "b", f"force{k}") for k in range(1, count + 1)),
        energy=f"0.5*stiffness*({longer})^2 + tension*{longer}",
        neglected=(
            ("inertia along the beam", "the tension is uniform along the beam", "not estimated"),
            ("compliance of the supports", "the clamped edges do not move", "not estimated"),
            ("in-plane shear of a plate", "Berger's energy", "up to 12 % of the stretching force"),
        ),
        example=EXAMPLE_SCENE,
    )


EXAMPLE_SCENE = """
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
register_part_type(Stretch(_declare_stretching(3, 1)))
