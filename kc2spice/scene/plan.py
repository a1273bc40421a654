"""What a scene needs and what it leaves out: parts, ports, models, each omission with its size.

Estimates of what is left out are closed-form, made from the scene's own numbers, so that they
follow when those change.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from kc2spice.scene.division import Share, division
from kc2spice.scene.rings import kept_rings, mesh_rings, reach, ring_gaps
from kc2spice.scene.schema import Catch, Control, Kick, Scene, Sphere

AIR_DENSITY = 1.204  # kg/m^3, 20 degC
AIR_VISCOSITY = 1.825e-5  # Pa s
MU_0 = 4e-7 * math.pi  # H/m
MAGNET_CONDUCTIVITY = 150e3  # S/m, paper table A1


@dataclass(frozen=True)
class Modelled:
    """A part of the deck: where it comes from and how large its model is."""

    part: str
    source: str
    detail: str


@dataclass(frozen=True)
class LeftOut:
    """An effect without a model, why, and what its absence changes at most."""

    effect: str
    why: str
    error: str


@dataclass(frozen=True)
class Plan:
    """What runs for a scene. ``ports`` are those that the reduced model of the chip keeps.

    ``error_budget`` is what the scene asks for, ``errors`` its division over the stages.
    """

    parts: tuple[Modelled, ...]
    ports: tuple[str, ...]
    left_out: tuple[LeftOut, ...]
    error_budget: float | None
    errors: tuple[Share, ...]


def plan(scene: Scene) -> Plan:
    """Parts, ports and omissions of a checked scene."""
    return Plan(
        parts=tuple(_parts(scene)),
        ports=_ports(scene),
        left_out=tuple(_left_out(scene)),
        error_budget=scene.error_budget,
        errors=division(scene),
    )


def _ports(scene: Scene) -> tuple[str, ...]:
    if scene.kick is None:
        return ()
    rings = tuple(f"R{number}" for number in range(kept_rings(scene)))
    return (*rings, "anode")


def _parts(scene: Scene) -> list[Modelled]:
    found = []
    if scene.kick:
        found += [_kick(scene, scene.kick)]
    if scene.contact and scene.kick:
        springs = kept_rings(scene)
        detail = f"{springs} unilateral springs, {4 * scene.contact.penalty:g} N/m per whole ring"
        found += [Modelled("contact", "closed form", detail)]
    if scene.sphere:
        detail = (
            f"{scene.sphere.mass * 1e6:.4g} mg, vertical motion, gravity {scene.gravity:g} m/s2"
        )
        found += [Modelled("sphere", "closed form", detail)]
    if scene.catch:
        detail = f"{scene.catch.positions} heights, force quadratic in both coil currents (exact)"
        if scene.catch.driver:
            detail += "; coils with R, L(y), M(y) and back-EMF"
        found += [Modelled("catch", "FE (magnetostatic, axisymmetric)", detail)]
    if scene.control:
        limit = scene.control.current_limit
        real = scene.catch is not None and scene.catch.driver is not None
        coils = "real coils" if real else "current-driven coils"
        detail = f"op-amp PID, output clamped at {limit:g} A, {coils}"
        found += [Modelled("pid", "circuit", detail)]
    found += _drivers(scene)
    return found


def _drivers(scene: Scene) -> list[Modelled]:
    kick = scene.kick.driver if scene.kick else None
    catch = scene.catch.driver if scene.catch else None
    found = []
    for load, driver in (("chip", kick), ("coils", catch)):
        for kind, section in driver or ():
            if section is not None:
                values = ", ".join(f"{key} {value:g}" for key, value in section if key != "subckt")
                found.append(Modelled(f"{kind} driver of the {load}", "circuit", values or "yours"))
    return found


def _kick(scene: Scene, kick: Kick) -> Modelled:
    target = (
        f"order {scene.rom.order}"
        if scene.rom.order is not None
        else f"as many states as keep the error below {scene.rom.tolerance:g}"
    )
    low, high = scene.rom.band
    detail = (
        f"quarter chip, {kick.layers} layers, reduced to {target}, band {low:g} … {high:g} Hz, "
        f"anode {kick.electrical}"
    )
    return Modelled("kick", "FE (piezoelectric, linear)", detail)


def _left_out(scene: Scene) -> list[LeftOut]:
    found = []
    if scene.kick:
        found += [*_of_kick(), *_rings(scene, scene.kick)]
    if scene.contact and scene.kick and scene.sphere:
        found += [
            _between_rings(scene.kick),
            _elsewhere("friction, adhesion and plastic flow in the contact"),
            _rigid_sphere(),
        ]
    if scene.experiment in ("loop", "impact") and scene.sphere:
        found += [_air_drag(scene.sphere), _elsewhere("rotation and sideways motion of the sphere")]
    if scene.catch and scene.sphere:
        found += _of_catch(scene.catch, scene.sphere)
    if scene.control and scene.catch and not scene.catch.driver:
        found += [_coil_dynamics(scene.control)]
    return found


def _elsewhere(effect: str) -> LeftOut:
    return LeftOut(effect, "symmetric set-up of the paper, section 2.1", "no estimate")


def _of_kick() -> list[LeftOut]:
    return [
        LeftOut("electrodes, coating and glue", "thin and compliant (paper 2.2.2)", "no estimate"),
        LeftOut("hysteresis and depolarisation", "linear material law", "no estimate"),
    ]


def _between_rings(kick: Kick) -> LeftOut:
    return LeftOut(
        "pressure between the rings",
        f"one force per ring stands for it; mesh of {kick.mesh.ring_spacing:g} m, "
        f"refine {kick.mesh.refine}",
        "run again with kick.mesh.refine raised by one to see it",
    )


def _rings(scene: Scene, kick: Kick) -> list[LeftOut]:
    kept, every = kept_rings(scene), kick.mesh.rings + 1
    if kept == every:
        return []
    effect = f"contact at R{kept}" + (f" to R{every - 1}" if kept + 1 < every else "")
    if kept == 0 or scene.sphere is None:
        return [LeftOut(effect, "no part presses on the chip: no ring is a port", "none")]
    gap, estimate = float(ring_gaps(mesh_rings(kick)[kept], scene.sphere.radius)), reach(scene)
    why = f"open up to {gap:.3g} m; {estimate.why}: {estimate.depth:.3g} m"
    if scene.contact and scene.contact.rings != "needed":
        why = f"contact.rings = {scene.contact.rings}"
    return [LeftOut(effect, why, "none while they stay open, checked after the run")]


def _rigid_sphere() -> LeftOut:
    return LeftOut("elasticity of the sphere", "rigid in the paper (2.2.2)", "no estimate")


def _air_drag(sphere: Sphere) -> LeftOut:
    """Schiller-Naumann drag on a sphere at 1 m/s, against its weight."""
    speed = 1.0
    reynolds = AIR_DENSITY * speed * 2 * sphere.radius / AIR_VISCOSITY
    coefficient = 24 / reynolds * (1 + 0.15 * reynolds**0.687)
    area = math.pi * sphere.radius**2
    drag = 0.5 * AIR_DENSITY * speed**2 * area * coefficient
    share = drag / (sphere.mass * 9.81)
    return LeftOut("drag of the air", "small", f"{share:.2g} of the weight at 1 m/s")


def _of_catch(catch: Catch, sphere: Sphere) -> list[LeftOut]:
    """Eddy currents die away with the diffusion time ``mu sigma R^2 / pi^2`` of a sphere."""
    diffusion = MU_0 * catch.mu_r * MAGNET_CONDUCTIVITY * (sphere.radius / math.pi) ** 2
    return [
        LeftOut(
            "eddy currents in the sphere",
            "poor conductor (paper table A1)",
            f"force lags by about {diffusion:.2g} s",
        ),
        LeftOut(
            "the field beyond the air box",
            f"A = 0 at radius {catch.air_radius:g} m, as in the paper",
            "compare with catch.air_radius and catch.air_height doubled",
        ),
    ]


def _coil_dynamics(control: Control) -> LeftOut:
    return LeftOut(
        "coil voltage, inductance and self-heating",
        "coils are fed by ideal current sources, as in the paper",
        f"real coils must slew {control.current_limit:g} A against L di/dt; L and R are in the "
        "result under model.catch",
    )
