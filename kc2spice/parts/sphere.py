"""The rigid sphere: one vertical degree of freedom, ``m y'' = sum of forces - m g``."""

from __future__ import annotations

from kc2spice.spice.circuit import Param, Pin, Subcircuit
from kc2spice.spice.header import Header, parameter_list, part_header
from kc2spice.spice.render import render


def sphere_subcircuit(
    header: Header,
    mass: float,
    radius: float,
    gravity: float,
    *,
    velocity: float = 0.0,
    height: float = 0.0,
    name: str = "sphere",
) -> Subcircuit:
    """Mass on the node ``v``, heights of the lowest point (``bottom``) and the centre (``y``).

    ``velocity`` [m/s] and ``height`` [m, of the lowest point] are the state at t = 0 of a
    transient with ``uic``; without it ngspice starts from the operating point.
    """
    pins = (
        Pin("v", "m/s", "N"),
        Pin("bottom", "um", "-"),
        Pin("y", "um", "-"),
        Pin("base", "um", "N"),
    )
    params = (
        Param("mass", mass, "kg", "mass of the sphere"),
        Param("radius", radius, "m", "radius of the sphere"),
        Param("gravity", gravity, "m/s2", "gravity, downwards"),
        Param("velocity", velocity, "m/s", "initial velocity, used with uic"),
        Param("height", height, "m", "initial height of the lowest point, used with uic"),
    )
    text = render(
        "sphere.j2",
        header=part_header(header, f"{name}: rigid sphere, vertical motion", pins, params),
        name=name,
        pins=[pin.name for pin in pins],
        parameters=parameter_list(params),
    )
    return Subcircuit(name, pins, params, text)
