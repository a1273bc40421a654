"""The scene: every number of a study in SI, checked, frozen (paper sections 2.1, 2.2, 2.4, A).

Keys, units, defaults and the bounds of single keys are here; conditions that tie several keys
together are in :mod:`kc2spice.scene.checks`. The comment or ``description`` of a key is what
``kc2spice scenes --keys`` prints.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ModelWrapValidatorHandler, PrivateAttr, model_validator
from pydantic_core import PydanticCustomError

from kc2spice.core.quantities import (
    Acceleration,
    Charge,
    Count,
    Current,
    Density,
    FluxDensity,
    Frequency,
    Length,
    Polarisation,
    Pressure,
    Rate,
    Ratio,
    Resistivity,
    Rings,
    Section,
    Stiffness,
    Time,
    Velocity,
    Voltage,
    si,
)
from kc2spice.scene.budget import fill
from kc2spice.scene.drivers import CatchDriver, KickDriver
from kc2spice.scene.limits import Checks, Gates

_ONE_LINE = r"[^\x00-\x1f\x7f-\x9f\u2028\u2029]"  # such text ends up in a netlist
FileName = Annotated[str, Field(pattern=rf"^{_ONE_LINE}+$", max_length=255)]
Experiment = Literal["loop", "impact", "imprint", "harmonic", "em_force"]


class Material(Section):
    """Piezoelectric ceramic in Voigt order xx yy zz yz xz xy, poled along +z (paper A.2)."""

    density: Density = Field(7700.0, gt=0)
    stiffness: tuple[Pressure, Pressure, Pressure, Pressure, Pressure, Pressure] = Field(
        (158.9e9, 113.0e9, 117.1e9, 144.2e9, 14.08e9, 22.94e9),
        description="C11 C12 C13 C33 C44 C66",
    )
    coupling: tuple[Polarisation, Polarisation, Polarisation] = Field(
        (-3.914, 27.50, 13.38), description="e31 e33 e15"
    )
    permittivity: tuple[Ratio, Ratio] = Field(
        (3370.0, 3300.0), description="relative, 11 and 33, at constant permittivity_at"
    )
    permittivity_at: Literal["stress", "strain"] = "stress"


class KickMesh(Section):
    """In-plane polar mesh; ``refine`` splits every cell edge, layers included, into that many."""

    refine: Count = Field(1, ge=1, le=6)
    order: Literal[1, 2] = 1
    sectors: Count = Field(10, ge=2, le=180, description="of the quarter circle")
    rings: Count = Field(5, ge=1, le=100, description="contact rings around the centre node")
    ring_spacing: Length = Field(50e-6, gt=0)
    outer_rings: Count = Field(11, ge=1, le=200, description="graded, out to the edge")


class Damping(Section):
    """Rayleigh damping: ``alpha`` on the mass, and a ratio met at one frequency by stiffness."""

    ratio: Ratio = Field(0.01, ge=0)
    at: Frequency = Field(250e3, gt=0)
    alpha: Rate = Field(0.0, ge=0)

    @property
    def beta(self) -> float:
        """Stiffness coefficient [s]: ``ratio = beta omega / 2`` at ``omega = 2 pi at``."""
        return self.ratio / (math.pi * self.at)


class Drive(Section):
    """Kick pulse: rises from ``start`` within ``edge``; ``width`` is measured at half height."""

    voltage: Voltage = 100.0
    width: Time = Field(25e-6, gt=0)
    edge: Time = Field(0.1e-6, gt=0)
    start: Time = Field(0.5e-3, ge=0)


class Kick(Section):
    """Piezoelectric chip actuator (paper 2.1, 2.2.2)."""

    side: Length = Field(3e-3, gt=0)
    height: Length = Field(2e-3, gt=0)
    layers: Count = Field(33, ge=1, le=400)
    electrical: Literal["open", "short", "driven"] = "driven"
    material: Material = Material()
    mesh: KickMesh = KickMesh()
    damping: Damping = Damping()
    drive: Drive = Drive()
    driver: KickDriver | None = None


class Contact(Section):
    """Penalty contact, one spring per ring (paper eq. 10); ``penalty`` is of the quarter model."""

    penalty: Stiffness = Field(1e8, gt=0)
    rings: Rings = Field("needed", description="needed, all, or how many from the centre on")


class Sphere(Section):
    """Rigid sphere, vertical motion only."""

    radius: Length = Field(1e-3, gt=0)
    density: Density = Field(7850.0, gt=0)

    @property
    def mass(self) -> float:
        """Mass of the whole sphere [kg]."""
        return 4 / 3 * math.pi * self.radius**3 * self.density


class Part(Section):
    """A body of revolution with rectangular section; ``y`` is its centre (paper table 1)."""

    height: Length = Field(gt=0)
    outer: Length = Field(gt=0)
    inner: Length = Field(ge=0)
    y: Length


class Catch(Section):
    """Electromagnetic catch actuator (paper tables 1 and A1)."""

    polarity: Literal["parallel", "antiparallel"] = "parallel"
    remanence: FluxDensity = Field(0.2, ge=0)
    mu_r: Ratio = Field(1.0611, ge=1)
    ring: Part = Part(height=1e-3, outer=5e-3, inner=4e-3, y=2.5e-3)
    lower: Part = Part(height=2e-3, outer=2.3e-3, inner=1.3e-3, y=1e-3)
    upper: Part = Part(height=2e-3, outer=2.3e-3, inner=1.3e-3, y=4e-3)
    turns: Count = Field(4074, ge=1)
    wire_diameter: Length = Field(25e-6, gt=0)
    resistivity: Resistivity = Field(1.7e-8, gt=0)
    air_radius: Length = Field(10e-3, gt=0)
    air_height: Length = Field(30e-3, gt=0)
    y_min: Length = -2.5e-3
    y_max: Length = 7.5e-3
    shift: Length = Field(
        0.0, gt=-1e-3, lt=1e-3, description="of ring, coils and table upwards: mounting error"
    )
    positions: Count = Field(41, ge=4, le=2001)
    points: Count = Field(201, ge=21, le=2001, description="of the force lookup in the netlist")
    refine: Count = Field(1, ge=1, le=8)
    driver: CatchDriver | None = None


class Control(Section):
    """PID with clamped output: same current in both coils, the lower one negated (paper 2.4)."""

    setpoint: Length = 2.5e-3
    kp: Annotated[float, si("A/m")] = 5e4
    ki: Annotated[float, si("A/(m s)")] = 10.0
    kd: Annotated[float, si("A s/m")] = 20.0
    rolloff: Time = Field(100e-9, gt=0, description="time constant of the differentiator's pole")
    current_limit: Current = Field(0.1, gt=0)
    enable_at: Time = Field(0.5e-3, ge=0)


class Rom(Section):
    """Reduction: a fixed order (30 unless told), or a tolerance over a band."""

    order: Count | None = Field(None, ge=1, le=2000)
    tolerance: Ratio | None = Field(None, gt=0, lt=1)
    band: tuple[Frequency, Frequency] = (0.0, 500e3)

    @model_validator(mode="before")
    @classmethod
    def _one_target(cls, data: Any) -> Any:
        if not isinstance(data, dict):
            return data
        if "order" in data and "tolerance" in data:
            context = {"reason": "order and tolerance are both set", "expected": "one of the two"}
            raise PydanticCustomError("quantity", "{reason}", context)
        return data if "tolerance" in data else {"order": 30, **data}


class Solver(Section):
    """ngspice settings that are written into the deck."""

    reltol: Ratio = Field(1e-4, gt=0, lt=1)
    chgtol: Charge = Field(1e-8, gt=0, description="1 uC of a fast state is 1 um of displacement")
    method: Literal["trap", "gear"] = "trap"
    max_step: Time = Field(10e-6, gt=0)
    stop: Time = Field(5e-3, gt=0)
    retries: Count = Field(3, ge=0, le=4, description="with other settings, after a failure")


class Impact(Section):
    """Free sphere onto the chip (paper 2.2.2, Fig. 9)."""

    velocity: Velocity = -1.0
    gap: Length = Field(1e-6, ge=0)


class Imprint(Section):
    """Quasi-static push of the sphere into the chip (Fig. 8)."""

    depth: Length = Field(50e-6, gt=0)
    steps: Count = Field(250, ge=1, le=100_000)


class Harmonic(Section):
    """Frequency sweep of all ports (Figs 7 and A1)."""

    start: Frequency = Field(0.0, ge=0)
    stop: Frequency = Field(500e3, gt=0)
    steps: Count = Field(200, ge=2, le=100_000)


class EmForce(Section):
    """Force on the sphere over its travel for every pair of coil currents (Fig. 6)."""

    currents: tuple[Current, ...] = Field((-0.1, 0.0, 0.1), min_length=1, max_length=1000)


class Bench(Section):
    """What ``bench`` judges settings by."""

    metric: tuple[str, ...] = Field(
        (), max_length=64, description="metrics that the scene is run for; empty: all numbers"
    )


class Scene(Section):
    """One study. A part that a scene does not name is not modelled."""

    name: str = Field(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,63}$")
    title: str = Field("", max_length=200, pattern=rf"^{_ONE_LINE}*$")
    experiment: Experiment = "loop"
    gravity: Acceleration = 9.81
    kick: Kick | None = None
    contact: Contact | None = None
    sphere: Sphere | None = None
    catch: Catch | None = None
    control: Control | None = None
    impact: Impact | None = None
    imprint: Imprint | None = None
    harmonic: Harmonic | None = None
    em_force: EmForce | None = None
    error_budget: Ratio | None = Field(
        None, gt=0, lt=1, description="relative; sets what the scene leaves open, see explain"
    )
    rom: Rom = Rom()
    solver: Solver = Solver()
    checks: Checks = Checks()
    gates: Gates = Gates()
    bench: Bench = Bench()
    include: tuple[FileName, ...] = Field(
        (), max_length=16, description="netlists beside the scene"
    )
    _home: Path | None = PrivateAttr(None)
    _budgeted: frozenset[str] = PrivateAttr(frozenset())

    @model_validator(mode="wrap")
    @classmethod
    def _divide(cls, data: Any, validate: ModelWrapValidatorHandler[Scene]) -> Scene:
        if not isinstance(data, dict) or data.get("error_budget") is None:
            return validate(data)
        filled, names = fill(data)
        scene = validate(filled)
        scene._budgeted = frozenset(names)
        return scene

    @property
    def budgeted(self) -> frozenset[str]:
        """The keys that ``error_budget`` has set."""
        return self._budgeted

    @property
    def netlists(self) -> tuple[Path, ...]:
        """The files of ``include``, which stand beside the scene's own file."""
        return tuple((self._home or Path()) / name for name in self.include)
