"""Contact between chip and sphere: one unilateral spring per ring (paper eq. 10)."""

from __future__ import annotations

import numpy as np

from kc2spice.spice.circuit import Param, Pin, Subcircuit
from kc2spice.spice.header import Header, parameter_list, part_header
from kc2spice.spice.render import render


def contact_subcircuit(
    header: Header,
    rings: tuple[str, ...],
    gaps: np.ndarray,
    eps: float,
    *,
    name: str = "contact",
) -> Subcircuit:
    """Force ``eps max(0, u - bottom - gap)`` between ring pins and sphere (``v``, ``bottom``).

    ``eps`` [N/m] is the stiffness of a whole ring, ``gaps`` [m] one per ring.
    """
    pins = (
        *(Pin(ring, "um", "N") for ring in rings),
        Pin("v", "m/s", "N"),
        Pin("bottom", "um", "-"),
        Pin("base", "um", "N"),
    )
    params = (
        Param("eps", eps, "N/m", "contact penalty of a whole ring"),
        *(
            Param(f"gap_{ring}", float(gap), "m", f"gap at {ring} when the sphere touches")
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
    )
    return Subcircuit(name, pins, params, text)
