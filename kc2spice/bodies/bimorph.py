"""``part = "bimorph"``: a layered rectangular beam or plate that bends.

Unimorphs, series and parallel bimorphs, and beams of metal alone (then without electrical pins)::

    [harvester]
    part = "bimorph"
    length = "50.8 mm"
    width = "31.8 mm"
    layers = [{ material = "PZT-5A", thickness = "0.26 mm" }, …]   # from the bottom up
    wiring = "series"
    tip_mass = "12 g"

x runs along the length from the clamp, y along the width, z up. Every layer is a solid of
quadratic hexahedra, so plate action, the clamp's hindrance of lateral contraction and the field
inside the layers are there without a theory of beams. Both faces of a piezoelectric layer are
electrodes all over; faces across a conductor, and between two piezoelectric layers, are one. A
positive voltage at the anode bends the tip up: layers above the middle are poled to contract,
those below to stretch.

* *series*: anode on top, cathode at the bottom, all between floating;
* *parallel*: the levels of electrodes are anode and cathode by turns, the top one anode.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Annotated, Any, Literal, TypeAlias

import numpy as np
from pydantic import Field, StringConstraints, model_validator
from skfem.mesh import MeshHex

from kc2spice.bodies.device import Device, Setup, Shape, make_device, node_shares, spread
from kc2spice.core.errors import UsageError
from kc2spice.core.quantities import Length, Section, si, validated
from kc2spice.fem.keys import Damping, Mesh
from kc2spice.fem.materials import Material, material
from kc2spice.fem.solid import Solid
from kc2spice.rom.linear import Port

Mass: TypeAlias = Annotated[float, si("kg")]
LENGTHWISE, ACROSS = 20, 4  # elements at refine = 1
GRADING = 1.6
UP = np.array([0.0, 0.0, 1.0])


class Layer(Section):
    """One layer, over the whole beam."""

    material: str | dict[str, Any] = Field(description="name or table")
    thickness: Length = Field(gt=0, description="of the layer")


class Bimorph(Section):
    """Keys of ``part = "bimorph"``; see the module.

    ``support``: *cantilever* (clamped at x = 0), *clamped* (at both ends), *simply_supported* (on
    knife edges under both ends) or *free*. ``tip_mass`` is spread over the end face. ``points`` are
    further ports on the centre line of the top, by distance from the clamp.
    """

    length: Length = Field(gt=0, description="along the beam, free part")
    width: Length = Field(gt=0, description="across")
    layers: tuple[Layer, ...] = Field(min_length=1)
    wiring: Literal["series", "parallel"] | None = Field(None, description="of two ceramic layers")
    tip_mass: Mass = Field(0.0, ge=0, description="spread over the end face")
    support: Literal["cantilever", "clamped", "simply_supported", "free"] = Field(
        "cantilever", description="what holds it"
    )
    points: dict[
        Annotated[str, StringConstraints(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,30}$")], Length
    ] = Field(
        default_factory=dict, description="further ports on the top by distance from the clamp"
    )
    damping: Damping = Damping()
    mesh: Mesh = Mesh()

    @model_validator(mode="after")
    def _consistent(self) -> Bimorph:
        for name, x in self.points.items():
            if name in ("tip", "base", "anode", "cathode"):
                raise ValueError(f"points: {name} is a port already")
            if not 0 <= x <= self.length:
                raise ValueError(f"points.{name} is not on the beam")
        return self


@dataclass(frozen=True)
class _Wires:
    """Electrode levels, bottom up: heights that belong to one conductor, and what it is."""

    levels: list[list[float]]
    anode: list[int]
    cathode: list[int]
    poling: dict[int, float]  # of each piezoelectric layer, +1 is up


def device(keys: Bimorph | Mapping[str, Any], *, refine: int = 1, where: str = "bimorph") -> Device:
    """Mesh the layers and assemble; ``refine`` divides edges in the plane once more than
    ``keys.mesh``, and every second one through the thickness, where a quadratic element holds all
    that plates do.

    Raises
    ------
    UsageError : a material that does not exist, wiring without a piezoelectric layer.
    """
    keys = validated(Bimorph, keys, where)
    refine *= keys.mesh.refine
    materials = [
        material(layer.material, f"{where}.layers[{number}].material")
        for number, layer in enumerate(keys.layers)
    ]
    heights = np.concatenate([[0.0], np.cumsum([layer.thickness for layer in keys.layers])])
    wires = _wires(keys, materials, heights)
    poled = [
        replace(m.poled((0, 0, wires.poling.get(k, 1.0))), name=f"layers[{k}] ({m.name})")
        for k, m in enumerate(materials)
    ]
    cuts = [np.linspace(*pair, (refine + 1) // 2 + 1)[:-1] for pair in pairwise(heights)]
    z = np.append(np.concatenate(cuts), heights[-1])
    x = np.union1d(_lengthwise(keys, refine), list(keys.points.values()))
    mesh = MeshHex.init_tensor(x, np.linspace(0, keys.width, ACROSS * refine + 1), z)
    middle = mesh.p[2, mesh.t].mean(axis=0)
    solid = Solid(mesh, tuple(poled), np.searchsorted(heights, middle) - 1)
    return make_device(solid, _setup(keys, solid, wires))


def _lengthwise(keys: Bimorph, refine: int) -> np.ndarray:
    """Cuts along the beam, finer towards clamps."""
    s = np.linspace(0, 1, LENGTHWISE * refine + 1)
    if keys.support == "cantilever":
        s = s**GRADING
    elif keys.support == "clamped":
        s = 0.5 + 0.5 * np.sign(s - 0.5) * (1 - (1 - np.abs(2 * s - 1)) ** GRADING)
    return np.asarray(keys.length * s)


def _wires(keys: Bimorph, materials: Sequence[Material], heights: np.ndarray) -> _Wires:
    active = [k for k, m in enumerate(materials) if m.piezoelectric]
    if not active:
        if keys.wiring is not None:
            raise UsageError(
                "wiring without a piezoelectric layer", where="wiring", got=keys.wiring
            )
        return _Wires([], [], [], {})
    tops = [heights[k + 1] for k in active]
    bottoms = [heights[k] for k in active]
    levels = [
        [bottoms[0]],
        *([a, b] for a, b in zip(tops[:-1], bottoms[1:], strict=True)),
        [tops[-1]],
    ]
    last = len(active)
    series = keys.wiring != "parallel"
    anode = [last] if series else list(range(last, -1, -2))
    cathode = [0] if series else list(range(last - 1, -1, -2))
    poling = {}
    for number, k in enumerate(active):
        above = (heights[k] + heights[k + 1]) / 2 >= heights[-1] / 2 * (1 - 1e-9)
        down = series or number + 1 in anode  # the field of a positive voltage
        poling[k] = -1.0 if down == above else 1.0
    return _Wires(levels, anode, cathode, poling)


def _setup(keys: Bimorph, solid: Solid, wires: _Wires) -> Setup:
    x, y, z = solid.places
    near = 1e-9 * keys.length
    fixed = np.zeros((x.size, 3), bool)
    if keys.support == "simply_supported":
        edges = (z < near) & ((x < near) | (x > keys.length - near))
        fixed[edges, 2] = True
        fixed[edges & (x < near), 0] = True
        fixed[edges & (y < near), 1] = True  # one corner of each edge: the width may change
    elif keys.support != "free":
        fixed[x < near] = True
    if keys.support == "clamped":
        fixed[x > keys.length - near] = True

    def level(numbers: Sequence[int]) -> np.ndarray:
        planes = [h for n in numbers for h in wires.levels[n]]
        return np.flatnonzero(np.isclose(z[:, None], planes, rtol=0, atol=near).any(axis=1))

    ends = [n for n in range(len(wires.levels)) if n not in wires.anode + wires.cathode]
    face = solid.mesh.facets_satisfying(lambda p: p[0] > keys.length - near)
    end = node_shares(solid, facets=face)
    shapes = [] if keys.support == "clamped" else [_port("tip", end, solid)]
    for name, place in keys.points.items():
        distance = np.hypot(x - place, y - keys.width / 2) + np.abs(z - z.max())
        shares = np.zeros(x.size)
        shares[np.argmin(distance)] = 1.0
        shapes.append(_port(name, shares, solid))
    return Setup(
        fixed=fixed.ravel(),
        electrodes={"anode": level(wires.anode), "cathode": level(wires.cathode)}
        if wires.levels
        else {},
        reference="cathode",
        floating=[level([n]) for n in ends],
        shapes=shapes,
        base=[(Port("base", "acceleration"), UP)] if keys.support != "free" else [],
        lumped=keys.tip_mass * end,
        damping=keys.damping,
    )


def _port(name: str, shares: np.ndarray, solid: Solid) -> Shape:
    return Shape(Port(name, "mechanical"), spread(shares, UP, solid))
