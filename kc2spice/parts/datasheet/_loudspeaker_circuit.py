"""Circuit of a loudspeaker driver.

The circuit consists of voice coil, eddy currents, suspension, creep and cone. B l is the force
factor, v the velocity of the cone, u the voltage and i the current of the coil::

    u = re i + leb di/dt + Z_semi i + B l v
    B l i = mass dv/dt + (r0 + 1 / (s c(s))) v + sd (p_front - p_rear)
    Z_semi = 1 / (1/(s le) + 1/(ke sqrt(s)) + 1/rss)
    c(s) = c0 (1 + creep ln(1 + 2 pi fs / s))

Sources: semi-inductance K. Thorborg, C. Futtrup, J. Audio Eng. Soc. 59 (2011) 612; creep M. H.
Knudsen, J. G. Jensen, J. Audio Eng. Soc. 41 (1993) 3, in the form of J. Candy, C. Futtrup, which is
passive at all frequencies. The ladders of :mod:`._ladders` approximate ``sqrt(s)`` and ``ln(1 + 2
pi fs / s)`` by circuit elements.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

from kc2spice.core.quantities import AIR_DENSITY, Section
from kc2spice.fem.thermal_materials import find_resistance_coefficient
from kc2spice.netlist.circuit import Param, make_positive_parameter
from kc2spice.netlist.number_and_name_spelling import round_to_digits
from kc2spice.parts.datasheet._ladders import (
    RelaxationLadder,
    fit_creep_ladder,
    make_semi_inductance_ladder,
)
from kc2spice.parts.datasheet._resonator import TWO_PI
from kc2spice.physics import Declaration, current, displacement
from kc2spice.physics.declaration import Branch, branch

FRONT, REAR = "front", "rear"
SEMI_INDUCTANCE_KEYS = ("leb", "ke", "rss")
SIGN_NOTE = (
    "um and N are positive in the direction in which a positive coil current drives the cone; "
    "1 A into a pin is a force of 1 N in this direction"
)
SOUND_SIGN_NOTE = (
    "; a cone that moves in this direction pushes air out of the pin front and draws air in at the "
    "pin rear"
)
AIR_NOTE = "mass of the air load in mms, subtracted because radiation parts model the air load"
_AMBIENT = "ambient"
COIL = "coil"  # name of the voice coil's current, which flows from ``plus`` to the node ``eddy``
_EDDY, _CREEP = "eddy", "creep"  # inner nodes behind the voice coil, and in the suspension
# Value of ln(1 + 2 pi fs / s) at s = 2 pi fs j.
_CREEP_AT_FS = complex(0.5 * math.log(2), -math.pi / 4)


def compute_baffle_air_mass(area: float) -> float:
    """Return the mass [kg] of air that moves with one side of a piston in a baffle.

    The mass at low frequencies is ``8/3 rho a^3`` with the radius a and the density rho (L. E.
    Kinsler et al., Fundamentals of Acoustics, 2000, section 7.5).
    """
    return 8 / 3 * AIR_DENSITY * (area / math.pi) ** 1.5


class SemiInductance(NamedTuple):
    """Elements of a voice coil with eddy currents; missing elements are 0.

    The elements are the inductances ``leb`` and ``le`` [H], the semi-inductance ``ke`` [H s^-1/2]
    and the resistance ``rss`` [Ohm] of shorted turns.
    """

    leb: float
    le: float
    ke: float
    rss: float


@dataclass(frozen=True)
class SpeakerParameters:
    """Parameters of a loudspeaker driver in SI units.

    ``mmd`` is the moving mass without air, or None if the area of the cone is not known.
    """

    fs: float
    re: float
    qms: float
    qes: float
    mms: float
    le: float
    sd: float | None = None
    mmd: float | None = None
    creep: float = 0.0
    semi: SemiInductance | None = None

    @property
    def qts(self) -> float:
        """Total Q factor Qts of the driver at the resonance frequency."""
        return self.qms * self.qes / (self.qms + self.qes)

    @property
    def rms(self) -> float:
        """Mechanical resistance Rms [N s/m] of the suspension at the resonance frequency."""
        return TWO_PI * self.fs * self.mms / self.qms

    @property
    def creep_resistance(self) -> float:
        """Mechanical resistance [N s/m] of the creep at the resonance frequency fs.

        The resistance is ``-Im(z) / (2 pi * fs * cms * Re(z))`` with ``z = 1 + creep ln(1 - j)``.
        In this formula, the suspension ``1/(s c(s))`` has the reactance of the compliance ``cms``
        at fs.
        """
        relative_compliance = 1 + self.creep * _CREEP_AT_FS
        ratio = relative_compliance.imag / relative_compliance.real
        return -ratio * TWO_PI * self.fs * self.mms


@dataclass
class _DeclarationTerms:
    """Terms that optional effects add to the declaration of a loudspeaker driver."""

    branches: list[Branch] = field(default_factory=list)
    energy: list[str] = field(default_factory=list)
    coenergy: list[str] = field(default_factory=list)
    content: list[str] = field(default_factory=list)
    constants: dict[str, str] = field(default_factory=dict)
    params: list[Param] = field(default_factory=list)
    inner: list[str] = field(default_factory=list)

    def add_path(self, name: str, inductance: str, resistance: str) -> None:
        """Add a current path through R, L or both, in series with the voice coil.

        The path has a resistance, an inductance, or both in series.
        """
        self.branches.append(current(name, _EDDY, "minus"))
        if inductance:
            self.coenergy.append(f"0.5*{inductance}*{name}^2")
        if resistance:
            self.content.append(f"0.5*{resistance}*{name}^2")


def _join_terms(*terms: str) -> str:
    """Join terms of an expression with plus signs."""
    return " + ".join(terms)


def _add_semi_inductance(
    terms: _DeclarationTerms, semi: SemiInductance, ladder: RelaxationLadder
) -> None:
    """Add the branches for eddy currents to the declaration of a driver.

    The branches are ``le``, ``rss``, and a ladder for ``1/(ke sqrt(s))``.
    """
    terms.inner.append(_EDDY)
    values = {"leb": "H", "le": "H", "ke": "H/sqrt(s)", "rss": "Ohm"}
    notes = {
        "leb": "inductance outside the pole piece",
        "le": "inductance in parallel with the semi-inductance",
        "ke": "semi-inductance of the pole piece",
        "rss": "resistance of shorted turns in parallel with the semi-inductance",
    }
    for name, unit in values.items():
        value = getattr(semi, name)
        if value:
            terms.params.append(make_positive_parameter(name, value, unit, notes[name]))
    if semi.leb:
        terms.coenergy.append(f"0.5*leb*{COIL}^2")
    # Parallel inductors are combined into a single inductor.
    # With two inductors, the distribution of a constant current would be undetermined.
    conductances = [f"{ladder.constant!r}/ke"] * bool(semi.ke) + ["1/rss"] * bool(semi.rss)
    inverses = [f"{ladder.integral!r}/ke"] * bool(semi.ke) + ["1/le"] * bool(semi.le)
    terms.constants["r_fast"] = f"1/({_join_terms(*conductances)})"
    terms.constants["l_slow"] = f"1/({_join_terms(*inverses)})"
    terms.add_path("i_fast", "", "r_fast")
    terms.add_path("i_slow", "l_slow", "")
    if not semi.ke:
        return
    for k, (corner, weight) in enumerate(zip(ladder.corners, ladder.weights, strict=True), 1):
        # A resistance R in series with an inductance L represents the admittance term
        # ``weight * corner / (ke * (s + corner))``.
        # The resistance is R = ke / weight, and the inductance is L = R / corner.
        terms.constants[f"r_eddy{k}"] = f"ke/{weight!r}"
        terms.constants[f"l_eddy{k}"] = f"r_eddy{k}/{corner!r}"
        terms.add_path(f"i_eddy{k}", f"l_eddy{k}", f"r_eddy{k}")


def _add_creep(terms: _DeclarationTerms, creep: float, ladder: RelaxationLadder) -> None:
    """Add a suspension with creep to the declaration of a driver.

    The compliance c0 is in series with the creep elements. Each creep element is a spring in
    parallel with a damper. The displacement of each inner node is the elongation of one creep
    element.
    """
    terms.params.append(
        make_positive_parameter(
            "creep", creep, "-", "creep of the suspension, c0 ln(1 + 2 pi fs/s)"
        )
    )
    real, imaginary = _CREEP_AT_FS.real, _CREEP_AT_FS.imag
    terms.constants |= {
        "creep_re": f"1 + {real!r}*creep",
        "creep_im": f"{imaginary!r}*creep",
        "c0": "cms*creep_re/(creep_re*creep_re + creep_im*creep_im)",
        "r0": "rms + creep_im/(creep_re*omega*cms)",
    }
    nodes = [f"{_CREEP}{k}" for k in range(1, len(ladder.corners) + 1)]
    terms.inner += nodes
    stretches = [f"x{k}" for k in range(1, len(nodes) + 1)]
    terms.energy.append(f"0.5*({' - '.join(['x', *stretches])})^2/c0")
    for k, (corner, weight) in enumerate(zip(ladder.corners, ladder.weights, strict=True), 1):
        # Each creep element adds the compliance ``c0*creep*weight*corner/(s + corner)``.
        # Here, the complex frequency s is relative to 2 pi fs.
        terms.constants[f"c_creep{k}"] = f"c0*creep*{weight!r}"
        terms.constants[f"r_creep{k}"] = f"1/({corner!r}*omega*c_creep{k})"
        terms.branches.append(displacement(f"x{k}", nodes[k - 1], "frame", f"force_x{k}"))
        terms.energy.append(f"0.5*x{k}^2/c_creep{k}")
        terms.content.append(f"0.5*r_creep{k}*x{k}_rate^2")


def _add_sound(terms: _DeclarationTerms, sides: tuple[str, ...], area: float) -> None:
    """Add acoustic pins, which an ideal transformer couples to the cone.

    The ratio of the transformer is the area ``sd``. The pressure p behind the cone contributes the
    coenergy ``sd * x * p``, where x is the outward displacement of the cone. The pressure p in
    front of the cone contributes the coenergy ``-sd * x * p``, because a pressure in front opposes
    an outward displacement x.
    """
    terms.params.append(
        make_positive_parameter("sd", round_to_digits(area), "m2", "effective area of the cone")
    )
    for side, sign in ((FRONT, "-"), (REAR, "")):
        if side in sides:
            pressure = f"p_{side}"
            terms.branches.append(branch("pressure", pressure, side, _AMBIENT, f"flow_{side}"))
            terms.coenergy.append(f"{sign}sd*x*{pressure}")


def declare_massless_driver(
    params: tuple[Param, ...], driver: SpeakerParameters, sides: tuple[str, ...] = ()
) -> Declaration:
    """Return the declaration of a loudspeaker driver without its moving mass."""
    more, semi, creeps = _DeclarationTerms(), driver.semi, driver.creep > 0
    if semi:
        _add_semi_inductance(more, semi, make_semi_inductance_ladder())
    if creeps:
        _add_creep(more, driver.creep, fit_creep_ladder())
    if sides and driver.sd:
        _add_sound(more, sides, driver.sd)
    coil = current(COIL, "plus", _EDDY) if semi else current("i", "plus", "minus")
    i = coil.name
    energy = [] if creeps else ["0.5*x^2/cms"]
    coenergy = [f"{i}*bl*x"] if semi else ["i*bl*x", "0.5*le*i^2"]
    content = [f"0.5*re*{i}^2", "0.5*r0*x_rate^2" if creeps else "0.5*rms*x_rate^2"]
    cone = displacement("x", "cone", "frame")
    electrical = [b for b in more.branches if b.is_flow]
    others = [b for b in more.branches if not b.is_flow]
    return Declaration(
        "loudspeaker",
        "loudspeaker from its Thiele-Small parameters",
        Section,
        (coil, *electrical, cone, *others),
        energy=_join_terms(*energy, *more.energy),
        coenergy=_join_terms(*coenergy, *more.coenergy),
        content=_join_terms(*content, *more.content),
        given=(*params, *more.params),
        constants={
            "omega": f"{TWO_PI!r}*fs",
            "bl": "sqrt(omega*mms*re/qes)",
            "cms": "1/(omega*omega*mms)",
            "rms": "omega*mms/qms",
            **more.constants,
        },
        conductors=(i,),
        temperature_coefficient=find_resistance_coefficient("copper"),
        rating="not known; the power i^2 * re heats the coil, and xmax limits the excursion",
        sign=SIGN_NOTE + SOUND_SIGN_NOTE * bool(sides),
        inner=tuple(more.inner),
        # The sound pressure is computed from the velocity of the cone.
        # A second differentiation of the displacement would be inaccurate.
        velocities={"x": "speed_m"} if sides else {},
    )


def declare_moving_mass(mass: float, air: float = 0.0, added: float = 0.0) -> Declaration:
    """Return the declaration of the moving mass of a loudspeaker driver.

    In the netlist, separate cards between the pins ``cone`` and ``frame`` represent the moving
    mass. ``air`` [kg] is the part of ``mass`` that connected parts of type ``radiation`` already
    model. ``added`` [kg] is an additional mass on the cone.
    """
    moving, params = "mms", [make_positive_parameter("mms", mass, "kg", "moving mass")]
    if air:
        moving += " - air"
        params.append(make_positive_parameter("air", round_to_digits(air), "kg", AIR_NOTE))
    if added:
        moving += " + added_mass"
        params.append(make_positive_parameter("added_mass", added, "kg", "mass fixed to the cone"))
    return Declaration(
        "cone",
        "moving mass",
        Section,
        (displacement("m", "cone", "frame"),),
        kinetic=f"0.5*{f'({moving})' if len(params) > 1 else moving}*m_rate^2",
        starts={"m": ("0", "0")},
        given=tuple(params),
    )
