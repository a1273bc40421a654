"""Contacts between bodies: penalty, Hertz or pressure law, damping and friction."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np

from kc2spice.core.quantities import Section
from kc2spice.netlist.circuit import Param, make_positive_parameter
from kc2spice.netlist.expression import ExpressionWriter, Name, Tree, substitute_names
from kc2spice.physics.declaration import RATE, Declaration, displacement
from kc2spice.physics.symbolic_algebra import (
    add_trees,
    differentiate_tree,
    divide_trees,
    evaluate_tree,
    multiply_trees,
    parse_simplified,
    subtract_trees,
)

CONTACT_RATING = "not known; compare the force with the strength of both surfaces (Hertz)"
# SPACING_NOTE is printed in place of an error estimate for the mesh of a pressure law.
# The mesh error of a pressure law is the error of the fitted compliances.
SPACING_NOTE = "error not estimated; to see it, run again with half the value of the key `spacing`"
# Reason for FRICTION_NOTE: in a test, a block in compiled Verilog-A slid 35 mm instead of 0.2 mm.
# The simulator printed no error message about the wrong sliding distance of the block.
FRICTION_NOTE = (
    "compiled Verilog-A modules are not precise enough for friction at sliding speeds below the "
    "parameter `creep`"
)
SIGN_NOTE = (
    "um, m/s and N are positive upwards; 1 A into a pin is an upward force of 1 N on the part"
)


@dataclass(frozen=True)
class ContactForce:
    """Law of the normal force and of the friction force in a contact.

    For an overlap x above zero, the normal force is ``F = f(x) * max(0, 1 + damping * x')`` (Hunt
    and Crossley 1975) with ``f(x) = stiffness * x^power * (curve_0 + curve_1 * s + ...)`` and ``s =
    sqrt(x / depth)``.

    ``stiffness`` has the unit N/m^power, and ``power`` is 1 or 1.5. ``curve`` contains the
    coefficients ``curve_0`` = 1, ``curve_1``, …. A law with several coefficients is a pressure law,
    which is valid for overlaps up to ``depth`` [m] under a sphere of ``radius`` [m]. ``pace`` [s]
    is the response time of the surfaces to the force: the law contains ``x + pace * x'`` in place
    of x. The force is never attractive: it is zero if the surfaces separate faster than ``1 /
    damping`` [m/s].

    ``friction`` is Coulomb's friction coefficient: at the sliding speed v, the friction force is
    ``friction * F * clip(v / creep, -1, 1)``. Below the speed ``creep`` [m/s], the friction is
    viscous, so that the surfaces do not stick.
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
    def law_constants(self) -> dict[str, float]:
        """Constants of the contact law: stiffness and power-series coefficients, by name."""
        result = {f"c{k}": c / self.depth ** (k / 2) for k, c in enumerate(self.curve) if k}
        return {"eps": self.stiffness} | result

    @property
    def _law_expressions(self) -> tuple[Tree, Tree, Tree]:
        """Expressions of the stored energy, the elastic force and the damped force."""
        return _make_contact_laws(self.power, len(self.curve), bool(self.damping))

    def energy(self, x: np.ndarray) -> np.ndarray:
        """Return the stored energy ``int f dx`` [J] at the overlaps ``x`` [m].

        The energy is 0 for x < 0.
        """
        return np.asarray(evaluate_tree(self._law_expressions[0], self.law_constants | {"x": x}))

    def force(self, x: np.ndarray) -> np.ndarray:
        """Return the elastic force ``f(x)`` [N] at the overlaps ``x`` [m].

        The force is 0 for x < 0.
        """
        return np.asarray(evaluate_tree(self._law_expressions[1], self.law_constants | {"x": x}))


@cache
def _make_contact_laws(power: float, count: int, damped: bool) -> tuple[Tree, Tree, Tree]:
    """Return expressions of stored energy, elastic force, and force with damping.

    The stored energy is the integral of the elastic force. The variables are the overlap ``x`` and
    its rate ``x_rate``. ``count`` is the number of coefficients ``curve_0``, ``curve_1``, … of the
    contact law (:class:`ContactForce`).
    """
    terms = []
    # With the arguments in the order (0, x), the derivative of max(0, x) is 1 at x = 0.
    # The derivative must not be 0 at x = 0, because Newton's method starts at x = 0.
    for k in range(count):
        order = power + 1 + k / 2
        closed = f"{f'c{k}*' if k else ''}max(0, x)^{int(order)}"
        terms.append(f"eps*{closed}{'*sqrt(max(0, x))' if order % 1 else ''}/{order:g}")
    energy = parse_simplified("+".join(terms))
    elastic = differentiate_tree(energy, "x")
    force = (
        multiply_trees(elastic, parse_simplified("max(0, 1 + damping*x_rate)"))
        if damped
        else elastic
    )
    return energy, elastic, force


@cache
def declare_contact(
    ports: tuple[str, ...],
    gaps: tuple[float, ...],
    law: ContactForce,
    *,
    rigid: tuple[bool, bool] = (False, True),
    under: tuple[float, tuple[float, ...]] | None = None,
    carried: str = "",
    groove: float | None = None,
) -> Declaration:
    """Return the declaration of a contact between two bodies.

    Each of the ``ports`` is a contact ring. The overlap at a ring is the displacement of the port,
    minus the displacement of the lower side, minus the gap. ``law`` is the force law of one ring,
    and ``gaps`` [m] contains the initial gaps of the rings. ``under`` contains the radius R [m] of
    a sphere above the rings, and the radii r [m] of the rings. With ``under``, the gap ``r^2 / (R +
    sqrt(R^2 - r^2))`` below the sphere is added to ``gaps``, and R becomes the parameter
    ``radius``.

    ``rigid`` contains two flags, which state whether the first side and the second side are rigid.
    A rigid first side has the pins ``va`` (velocity) and ``a``, and a rigid second side has the
    pins ``v`` and ``bottom``. An elastic first side has its ports as pins, and an elastic second
    side has the pin ``b``. ``carried`` is the name of an additional pin, for example of the pin
    whose displacement is the indentation of an elastic sphere. The displacement of the pin
    ``carried`` is added to the displacement of the lower side. A contact with friction has the pins
    ``slide`` and ``rail``, whose relative velocity is the sliding speed. ``groove`` is the opening
    angle of a groove in degrees.

    A pressure law is fitted for one radius of the sphere. For a sphere whose radius differs from
    the fitted radius, the overlap is multiplied by ``share = radius / fitted radius``.
    """
    high, low = ("a",) if rigid[0] else ports, "bottom" if rigid[1] else "b"
    constants = {name: repr(value) for name, value in law.law_constants.items() if name != "eps"}
    share = "1"
    if law.radius:
        share, constants["share"] = "share", f"radius/{law.radius!r}"
    branches, energies, pressed, forces = [], [], [], {}
    for k, (port, pin) in enumerate(zip(ports, high, strict=True)):
        x, gap = f"x_{port}", f"gap_{port}"
        if under is not None and not law.radius and under[1][k]:
            square, gap = repr(under[1][k] ** 2), f"rest_{port}"
            constants[gap] = f"{square}/(radius + sqrt(radius*radius - {square})) + gap_{port}"
        rate = Name(x + RATE)
        moved = {"x": parse_simplified(f"{share}*({x} - {gap})"), "x_rate": rate}
        late = moved
        if law.pace:
            late = {
                "x": parse_simplified(f"{share}*({x} + pace*{x}{RATE} - {gap})"),
                "x_rate": rate,
            }
        energy, elastic, force = law._law_expressions
        energies.append(
            divide_trees(substitute_names(energy, moved), parse_simplified(f"{share}^2"))
        )
        pressed.append(divide_trees(substitute_names(force, late), parse_simplified(share)))
        damping = subtract_trees(
            pressed[-1], divide_trees(substitute_names(elastic, moved), parse_simplified(share))
        )
        branches.append(displacement(x, pin, low, f"force.{port}", carried))
        forces[x] = ExpressionWriter().write_tree(damping)
    sides = ("a", "va", rigid[0]), ("bottom", "v", rigid[1])
    lags = dict.fromkeys(forces, "pace") if law.pace else {}
    kind, along, absent = "elastic normal force", "", "friction, "
    if law.damping:
        kind = "damped elastic normal force"
    if law.friction:
        along, absent = " and Coulomb friction", ""
        branches.append(displacement("slide", "slide", "rail", "friction"))
        rubbed = multiply_trees(
            parse_simplified(f"friction*clip(slide{RATE}/creep)"), add_trees(*pressed)
        )
        forces["slide"] = ExpressionWriter().write_tree(rubbed)
    return Declaration(
        "contact",
        "penalty contact",
        Section,
        tuple(branches),
        energy=ExpressionWriter().write_tree(add_trees(*energies)),
        forces=forces,
        given=tuple(_list_parameters(ports, gaps, law, under, groove)),
        constants=constants,
        rating=CONTACT_RATING,
        validity=f"{kind}{along}, at any temperature; no {absent}adhesion or plastic flow",
        sign=SIGN_NOTE,
        speeds={pin: speed for pin, speed, is_rigid in sides if is_rigid},
        lags=lags,
        base="base",
        metered=False,
        no_module=FRICTION_NOTE if law.friction else "",
        mesh=SPACING_NOTE if law.radius else "",
    )


def _list_parameters(
    ports: tuple[str, ...],
    gaps: tuple[float, ...],
    law: ContactForce,
    under: tuple[float, tuple[float, ...]] | None,
    groove: float | None,
) -> Iterator[Param]:
    """Yield the parameters that an instance of the subcircuit can set."""
    linear = law.power == 1
    stiffness_text = (
        "contact penalty stiffness of a whole ring"
        if linear
        else "stiffness of the Hertz contact, 4/3 E* sqrt(R)"
    )
    damping, friction = "Hunt-Crossley damping coefficient", "friction coefficient"
    if groove is not None:
        sine = f"sin({groove:g}/2 deg)"
        stiffness_text = (
            f"stiffness of the groove, 2 {sine}^{1 + law.power:g} times the stiffness of one flank"
        )
        damping = f"damping coefficient of the groove, {sine} times that of one flank"
        friction = f"friction coefficient of the groove, 1/{sine} times that of one flank"
    yield make_positive_parameter(
        "eps", law.stiffness, "N/m" if linear else "N/m^1.5", stiffness_text
    )
    if law.radius:
        yield Param("radius", law.radius, "m", "radius of the sphere", law.depth)
        yield Param("pace", law.pace, "s", "time constant of the surface deformation")
    elif under is not None:
        yield Param("radius", under[0], "m", "radius of the sphere", max(under[1][: len(ports)]))
    doc = (
        "gap at {} when both sides are at rest"
        if under is None
        else "distance added to the gap at {}"
    )
    for port, gap in zip(ports, gaps, strict=True):
        yield Param(f"gap_{port}", gap, "m", doc.format(port))
    if law.damping:
        yield make_positive_parameter("damping", law.damping, "s/m", damping)
    if law.friction:
        yield make_positive_parameter("friction", law.friction, "1", friction)
        words = "sliding speed above which friction is fully developed"
        yield make_positive_parameter("creep", law.creep, "m/s", words)
