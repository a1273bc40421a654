"""The normal law of a contact and its friction, stated by energy and lost forces."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from kc2spice.core.quantities import Section
from kc2spice.netlist.expression import Name, Tree, Writer, parse, replaced
from kc2spice.physics.declaration import RATE, Declaration, displacement
from kc2spice.physics.expression import (
    derivative,
    evaluated,
    expression,
    minus,
    plus,
    text,
    times,
)
from kc2spice.physics.law import DeclaredLaw


@dataclass(frozen=True)
class Normal:
    """``F = f(x) max(0, 1 + damping x')`` along the axis (Hunt and Crossley 1975), with friction
    beside it; ``f(x) = stiffness x^power (curve_0 + curve_1 s + ...)``, ``s = sqrt(x / depth)``,
    where the overlap ``x`` is above zero.

    ``stiffness`` in N/m^power; ``power`` is 1 or 1.5. The law with more than one ``curve``, whose
    first is 1, holds up to ``depth`` [m], under a sphere of ``radius`` [m]; the surfaces follow its
    force within ``pace`` [s]: all of it is said of ``x + pace x'`` instead of ``x``. Surfaces that
    part faster than ``1 / damping`` do not pull: the dent is left behind.

    ``friction`` is Coulomb's coefficient: ``F friction clip(v / creep)`` acts against sliding at
    the speed v; below the speed ``creep`` [m/s] it is viscous, which stands for sticking.
    """

    stiffness: float
    power: float = 1.0
    damping: float = 0.0
    friction: float = 0.0
    creep: float = 1e-4
    curve: tuple[float, ...] = (1.0,)
    depth: float = math.inf
    pace: float = 0.0
    radius: float = 0.0

    @property
    def numbers(self) -> dict[str, float]:
        """Parameters of the law by name, in SI."""
        found = {"eps": self.stiffness, "damping": self.damping}
        found |= {f"c{k}": c / self.depth ** (k / 2) for k, c in enumerate(self.curve) if k}
        return found | {"pace": self.pace, "friction": self.friction, "creep": self.creep}

    @property
    def _laws(self) -> tuple[Tree, Tree, Tree]:
        return _laws(self.power, len(self.curve), bool(self.damping))

    def energy(self, x: np.ndarray) -> np.ndarray:
        """``int f dx`` [J], 0 where nothing touches."""
        return np.asarray(evaluated(self._laws[0], self.numbers | {"x": x}))

    def force(self, x: np.ndarray) -> np.ndarray:
        """``f(x)`` [N], 0 where nothing touches."""
        return np.asarray(evaluated(self._laws[1], self.numbers | {"x": x}))

    def text(self, x: str, closing: str, scale: str) -> str:
        """``F`` on a card, of the overlap ``x`` and the speed ``closing``, as they stand there."""
        values: Mapping[str, Tree] = {"x": parse(x), "eps": Name(scale)}
        return text(replaced(self._laws[2], {**values, "x_rate": parse(closing)}))

    def rubbed(self, pressed: Sequence[str], speed: str) -> str:
        """The friction on a card, of the forces that press and the ``speed`` of sliding."""
        return text(replaced(_rubbed(map(parse, pressed)), {"slide_rate": parse(speed)}))


@cache
def _laws(power: float, count: int, damped: bool) -> tuple[Tree, Tree, Tree]:
    """Energy, which is what is stated, elastic force and force, of ``x`` and ``x_rate``."""
    terms = []
    for k in range(count):
        order = power + 1 + k / 2
        closed = f"{f'c{k}*' if k else ''}max(0, x)^{int(order)}"
        terms.append(f"eps*{closed}{'*sqrt(max(0, x))' if order % 1 else ''}/{order:g}")
    energy = expression("+".join(terms))
    elastic = derivative(energy, "x")
    force = times(elastic, expression("max(0, 1 + damping*x_rate)")) if damped else elastic
    return energy, elastic, force


def _rubbed(pressed: Iterable[Tree]) -> Tree:
    return times(expression("friction*clip(slide_rate/creep)"), plus(*pressed))


def contact_law(
    name: str, ports: Sequence[str], normal: Normal, gaps: np.ndarray, carried: str = ""
) -> DeclaredLaw:
    """The law of a contact from the pins ``ports`` to the pin ``b``, ``gaps`` (n,) [m] apart at
    rest; with friction of the pin ``slide`` over ``rail`` besides. The surface of ``b`` may carry
    another pin, whose displacement adds to its own and on which the forces act as well."""
    energies, pressed, forces = [], [], {}
    for k in range(len(ports)):
        overlap = expression(f"x{k} - gap{k}")
        moved = {"x": overlap, "x_rate": Name(f"x{k}{RATE}")}
        energy, elastic, force = (replaced(law, moved) for law in normal._laws)
        if normal.pace:
            followed = {"x": expression(f"x{k} + pace*x{k}{RATE} - gap{k}")}
            force = replaced(normal._laws[2], {**moved, **followed})
        energies.append(energy)
        pressed.append(force)
        forces[f"x{k}"] = Writer().write(minus(force, elastic))
    branches = [displacement(f"x{k}", port, "b", less=carried) for k, port in enumerate(ports)]
    if normal.friction:
        branches.append(displacement("slide", "slide", "rail"))
        forces["slide"] = Writer().write(_rubbed(pressed))
    numbers = normal.numbers | {f"gap{k}": float(gap) for k, gap in enumerate(gaps)}
    declared = Declaration(
        "contact",
        "contact",
        Section,
        tuple(branches),
        energy=Writer().write(plus(*energies)),
        forces=forces,
        constants={key: repr(value) for key, value in numbers.items()},
    )
    return DeclaredLaw(name, declared, tuple(numbers.values()))
