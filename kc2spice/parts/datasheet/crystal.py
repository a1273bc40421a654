"""The part ``crystal``: a quartz crystal or tuning fork from its data sheet."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from pydantic import Field

from kc2spice.core.quantities import (
    Capacitance,
    Frequency,
    Inductance,
    Ratio,
    Resistance,
    UnlimitedQFactor,
)
from kc2spice.netlist.circuit import make_positive_parameter
from kc2spice.netlist.number_and_name_spelling import round_to_digits
from kc2spice.parts.datasheet._resonator import (
    TWO_PI,
    RatedKeys,
    Resonator,
    ResonatorNetlist,
    ResonatorPart,
    make_unknowns_relation,
    write_tolerance_note,
)
from kc2spice.parts.datasheet._stated_values import Relation, StatedValues
from kc2spice.scene.parttype import register_part_type
from kc2spice.scene.scene_classes import Part

# Relative rounding error of a stated frequency: a tenth of the usual frequency tolerance.
FREQUENCY_ROUNDING = 1e-6
# Start values of the fit: ratio c1 / c0 and Q factor of usual crystals.
START_RATIO = 1 / 300
START_QUALITY = 5e4
SHUNT_CAPACITANCE = 3e-12  # F, typical shunt capacitance of a crystal


class CrystalKeys(RatedKeys):
    """Keys of a crystal with the frequency ``f = fs sqrt(1 + c1 / (c0 + cl))``.

    ``cl`` is the load capacitance, and ``fs`` is the series resonance. If both ``c1`` and ``l1``
    are stated, the two values must agree. If both ``r1`` and ``q`` are stated, these two values
    must also agree.
    """

    f: Frequency = Field(
        gt=0,
        description=(
            "Nominal frequency of the crystal: the series resonance, or the resonance "
            "with the load capacitance `cl` if this key is stated"
        ),
    )
    cl: Capacitance | None = Field(
        None,
        gt=0,
        description=(
            "Load capacitance with which the crystal resonates at the frequency `f`; by "
            "default `f` is the series resonance"
        ),
    )
    c0: Capacitance = Field(
        gt=0, description="Shunt capacitance of the electrodes and the holder of the crystal"
    )
    c1: Capacitance | None = Field(
        None, gt=0, description="Motional capacitance of the crystal, also called C1"
    )
    l1: Inductance | None = Field(
        None, gt=0, description="Motional inductance of the crystal, also called L1"
    )
    r1: Resistance | None = Field(
        None, gt=0, description="Motional resistance of the crystal, also called ESR"
    )
    q: UnlimitedQFactor | None = Field(
        None, gt=0, description="Q factor of the motional branch of the crystal"
    )
    f_tolerance: Ratio | None = Field(
        None,
        gt=0,
        lt=1,
        examples=["20e-6"],
        description="Relative tolerance of the crystal's frequency `f`, such as 20e-6",
    )


CRYSTAL_UNITS = {"f": "Hz", "c0": "F", "c1": "F", "l1": "H", "r1": "Ohm", "q": ""}


class Crystal(ResonatorPart[CrystalKeys]):
    """Part type ``crystal``: quartz crystal or tuning fork from its data sheet."""

    name = "crystal"
    title = "quartz crystal or tuning fork from its data sheet"
    schema = CrystalKeys
    ends = ("a", "b")
    rating = "not known; compare the power i^2 * r1 with the drive level in the data sheet"
    example = """
[crystal]
part = "crystal"
f = "32.768 kHz"
cl = "12.5 pF"
c0 = "1.2 pF"
c1 = "3 fF"
r1 = "35 kOhm"
pins = { a = "drive.out" }

[drive]
part = "source"
ac = "1 V"

[analysis]
type = "ac"
start = "32.76 kHz"
stop = "32.78 kHz"
scale = "linear"
"""

    def resonator(self, part: Part[CrystalKeys]) -> Resonator:
        """Return the circuit elements of the crystal from its data sheet."""
        keys = part.keys
        stated = {key: v for key in CRYSTAL_UNITS if (v := getattr(keys, key)) is not None}
        c1 = keys.c1 or START_RATIO * keys.c0
        if keys.l1 and not keys.c1:
            c1 = 1 / ((TWO_PI * keys.f) ** 2 * keys.l1)
        r1 = keys.r1 or 1 / (TWO_PI * keys.f * c1 * (keys.q or START_QUALITY))
        relations = _list_relations(keys.cl)
        rounding = {"f": FREQUENCY_ROUNDING}
        start = np.array([keys.c0, keys.f, c1, r1])
        suspects = part.overridden_keys
        values = StatedValues(
            part.name, stated, relations, start, CRYSTAL_UNITS, {}, rounding, suspects
        )
        return Resonator.from_unknowns(values.solve())

    def make_resonator_netlist(
        self, part: Part[CrystalKeys], circuit: Resonator
    ) -> ResonatorNetlist:
        """Return the netlist parameters, and the equations of the circuit elements."""
        keys = part.keys
        loaded = "" if keys.cl is None else "(c0+cl)"
        words = "frequency with the load capacitance cl" if loaded else "series resonance"
        f = round_to_digits(_compute_loaded_frequency(circuit, keys.cl))
        params = [
            make_positive_parameter(
                "f", f, "Hz", words + write_tolerance_note(f, keys.f_tolerance)
            ),
            make_positive_parameter("c0", round_to_digits(circuit.c0), "F", "shunt capacitance"),
        ]
        if keys.cl is not None:
            params.append(
                make_positive_parameter("cl", keys.cl, "F", "load capacitance at which f is stated")
            )
        motion = "c1" if keys.c1 or not keys.l1 else "l1"
        value = circuit.cm[0] if motion == "c1" else circuit.lm[0]
        words = "motional capacitance" if motion == "c1" else "motional inductance"
        params.append(
            make_positive_parameter(motion, round_to_digits(value), CRYSTAL_UNITS[motion], words)
        )
        loss = "r1" if keys.r1 else "q"
        value = circuit.rm[0] if loss == "r1" else circuit.compute_q_factor(0)
        words = "motional resistance" if loss == "r1" else "Q factor"
        params.append(
            make_positive_parameter(loss, round_to_digits(value), CRYSTAL_UNITS[loss] or "-", words)
        )
        inverse = f"{TWO_PI**2!r}*f*f*l1" + f"-1/{loaded}" * bool(loaded)
        cm = "c1" if motion == "c1" else f"1/({inverse})"
        equations = {
            "cm": cm,
            "fs": f"f/sqrt(1+cm/{loaded})" if loaded else "f",
            "lm": f"1/({TWO_PI**2!r}*fs*fs*cm)",
            "rm": "r1" if loss == "r1" else f"1/({TWO_PI!r}*fs*cm*q)",
        }
        is_bounded = motion == "l1" and bool(loaded)
        conditions = {"l1_is_too_small_for_f_c0_and_cl": f"ln({inverse})"} if is_bounded else {}
        return ResonatorNetlist(tuple(params), equations, ("",), conditions)


def _compute_loaded_frequency(circuit: Resonator, load: float | None) -> float:
    """Return the resonance frequency [Hz] of the crystal with a load capacitance [F].

    The load capacitance is in series with the crystal.
    """
    shift = 0.0 if load is None else circuit.cm[0] / (circuit.c0 + load)
    return circuit.fs[0] * math.sqrt(1 + shift)


def _list_relations(load: float | None) -> dict[str, Relation]:
    """Return all possible data-sheet values as functions of the unknowns."""
    values: dict[str, Callable[[Resonator], float]] = {
        "f": lambda circuit: _compute_loaded_frequency(circuit, load),
        "c0": lambda circuit: circuit.c0,
        "c1": lambda circuit: circuit.cm[0],
        "l1": lambda circuit: circuit.lm[0],
        "r1": lambda circuit: circuit.rm[0],
        "q": lambda circuit: circuit.compute_q_factor(0),
    }
    return {key: make_unknowns_relation(value) for key, value in values.items()}


register_part_type(Crystal())
