"""Contact between chip and sphere: one unilateral spring per ring (paper eq. 10)."""

from __future__ import annotations

import numpy as np

from kc2spice.spice.circuit import Param, Pin, Subcircuit
from kc2spice.spice.header import Header, parameter_list, part_header
from kc2spice.spice.render import render


def contact_force(
    displacement: np.ndarray, bottom: np.ndarray, gaps: np.ndarray, eps: float
) -> np.ndarray:
    """Force [N] of every ring on the sphere, ``eps max(0, u - bottom - gap)``, rings last.

    ``displacement`` (..., rings) and ``bottom`` (...) in m, ``eps`` in N/m of the whole ring.
    """
    return eps * np.maximum(0.0, displacement - np.asarray(bottom)[..., None] - gaps)


def contact_subcircuit(
    header: Header,
    rings: tuple[str, ...],
    gaps: np.ndarray,
    eps: float,
    *,
    name: str = "contact",
    under: tuple[float, np.ndarray] | None = None,
) -> Subcircuit:
    """The law of :func:`contact_force` between ring pins, the sphere's ``v`` and its ``bottom``.

    ``eps`` [N/m] is the stiffness of a whole ring, ``gaps`` [m] one per ring. Given the radius of
    the sphere that the rings are ``under`` and their own [m], the gaps follow from the parameter
    ``radius`` as ``r^2 / (R + sqrt(R^2 - r^2))``, and those of the subcircuit are added to them.
    """
    pins = (
        *(Pin(ring, "um", "N") for ring in rings),
        Pin("v", "m/s", "N"),
        Pin("bottom", "um", "-"),
        Pin("base", "um", "N"),
    )
    radii = () if under is None else under[1][: len(rings)]
    sphere = [] if under is None else [
        Param("radius", under[0], "m", "radius of the sphere", float(max(radii)))
    ]  # fmt: skip
    doc = "gap at {} when the sphere touches" if under is None else "added to the gap at {}"
    params = (
        Param("eps", eps, "N/m", "contact penalty of a whole ring", 0.0),
        *sphere,
        *(
            Param(f"gap_{ring}", 0.0 if under else float(gap), "m", doc.format(ring))
            for ring, gap in zip(rings, gaps, strict=True)
        ),
    )
    text = render(
        "contact.j2",
        header=part_header(header, f"{name}: penalty contact of sphere and chip", pins, params),
        name=name,
        pins=[pin.name for pin in pins],
        parameters=parameter_list(params),
        rings=rings,
        squares=[float(r) ** 2 for r in radii],
    )
    return Subcircuit(name, pins, params, text)
