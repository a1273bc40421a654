"""Keys of a loudspeaker, and relations between the values of its data sheet."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated

from pydantic import Field

from kc2spice.core.quantities import (
    AIR_DENSITY,
    SOUND_SPEED,
    CoilInductance,
    Frequency,
    Length,
    Mass,
    MechanicalDamping,
    Ratio,
    Resistance,
    UnlimitedQFactor,
    UsualRange,
    si,
)
from kc2spice.parts.datasheet._loudspeaker_circuit import compute_baffle_air_mass
from kc2spice.parts.datasheet._resonator import TWO_PI, PartNumberKeys
from kc2spice.parts.datasheet._stated_values import Relation
from kc2spice.physics.conductors import ConductorKeys

AIR_STIFFNESS = AIR_DENSITY * SOUND_SPEED**2  # bulk modulus rho c^2 of air [Pa]
AREA_KEYS = ("sd", "vas", "mmd")  # keys whose relations contain the area of the cone
# Start values of the unknowns for the fit, in SI units: a common woofer of 17 cm.
EXAMPLE_WOOFER = {"re": 6.0, "bl": 6.0, "mms": 15e-3, "cms": 1e-3, "rms": 1.0, "sd": 13e-3}
# Usual values of loudspeaker drivers, from tweeters to the largest woofers.
USUAL_QTS = UsualRange("", 0.05, 5.0, "loudspeakers usually have a Qts of 0.05 to 5")
LARGEST_DRIVER = "beyond the largest loudspeakers, which are half a metre wide"
Area = Annotated[float, si("m2"), UsualRange("m2", 0.0, 1.0, LARGEST_DRIVER)]
AirVolume = Annotated[float, si("m3"), UsualRange("m3", 0.0, 10.0, LARGEST_DRIVER)]
Compliance = Annotated[float, si("m/N"), UsualRange("m/N", 0.0, 0.1, LARGEST_DRIVER)]
Excursion = Annotated[Length, UsualRange("m", 0.0, 0.2, LARGEST_DRIVER)]


class LoudspeakerKeys(ConductorKeys, PartNumberKeys):
    """Data-sheet values that determine a loudspeaker; redundant values must agree.

    The relations between these values are ``Bl^2 = 2 pi * fs * mms * re / qes``, ``qms = 2 pi * fs
    * mms / rms`` and ``vas = rho * c^2 * sd^2 * cms`` (R. H. Small, J. Audio Eng. Soc. 20 (1972)
    383).
    """

    fs: Frequency | None = Field(
        None, gt=0, description="Resonance frequency of the loudspeaker driver in free air"
    )
    re: Resistance | None = Field(None, gt=0, description="DC resistance of the voice coil")
    le: CoilInductance | None = Field(
        None,
        gt=0,
        description=(
            "Inductance of the voice coil, in parallel with `ke` and `rss`. Default: `re` "
            "times 1 us, or no inductance if `ke` or `rss` is stated"
        ),
    )
    leb: CoilInductance | None = Field(
        None,
        gt=0,
        description=(
            "Series inductance of the voice coil in the semi-inductance model, in series with the "
            "parallel circuit that `ke`, `rss` and `le` form"
        ),
    )
    ke: Ratio | None = Field(
        None,
        gt=0,
        description=(
            "Semi-inductance of the voice coil in Ohm s^(1/2), with the impedance ke sqrt(2 "
            "pi f j); by default the coil has a constant inductance"
        ),
    )
    rss: Resistance | None = Field(
        None,
        gt=0,
        description=(
            "Resistance of the shorted turns, in parallel with the semi-inductance `ke` and "
            "the inductance `le`"
        ),
    )
    qms: UnlimitedQFactor | None = Field(
        None,
        gt=0,
        description=(
            "Mechanical Q factor of the loudspeaker driver at the resonance frequency `fs`"
        ),
    )
    qes: UnlimitedQFactor | None = Field(
        None,
        gt=0,
        description=(
            "Electrical Q factor of the loudspeaker driver at the resonance frequency `fs`"
        ),
    )
    qts: UnlimitedQFactor | None = Field(
        None,
        gt=0,
        description=(
            "Total Q factor of the loudspeaker driver at the frequency `fs`, qms * qes / "
            "(qms + qes)"
        ),
    )
    bl: Annotated[float, si("N/A")] | None = Field(
        None, gt=0, description="Force factor B l of the voice coil, in N/A or T m"
    )
    mms: Mass | None = Field(
        None, gt=0, description="Moving mass of the loudspeaker driver, including the air load"
    )
    mmd: Mass | None = Field(
        None,
        gt=0,
        description=(
            "Moving mass of the loudspeaker driver without the air load: mms - 16/3 rho a^3, "
            "with sd = pi a^2"
        ),
    )
    cms: Compliance | None = Field(
        None, gt=0, description="Mechanical compliance of the loudspeaker driver's suspension"
    )
    rms: MechanicalDamping | None = Field(
        None,
        gt=0,
        description=(
            "Mechanical resistance (viscous damping) of the loudspeaker driver's suspension"
        ),
    )
    sd: Area | None = Field(
        None, gt=0, description="Effective area of the loudspeaker driver's cone"
    )
    vas: AirVolume | None = Field(
        None,
        gt=0,
        description=(
            "Volume of air with the same compliance as the loudspeaker driver's suspension"
        ),
    )
    added_mass: Mass | None = Field(
        None,
        ge=0,
        description=(
            "Mass fixed to the loudspeaker's cone in addition to the moving mass `mms`; by "
            "default none"
        ),
    )
    zmax: Resistance | None = Field(
        None,
        gt=0,
        description=(
            "Impedance of the loudspeaker driver at the resonance frequency `fs`, re (1 + qms/qes)"
        ),
    )
    creep: Ratio | None = Field(
        None,
        gt=0,
        lt=1,
        description=(
            "Relative increase of the suspension's compliance if the frequency decreases "
            "by the factor e (2.718); by default the compliance is constant. `cms` and "
            "`rms` apply at the frequency `fs`"
        ),
    )
    xmax: Excursion | None = Field(
        None,
        gt=0,
        description=(
            "Largest displacement of the cone from rest in one direction for linear operation"
        ),
    )
    tolerance: dict[str, Annotated[Ratio, Field(gt=0, lt=1)]] = Field(
        {},
        description=(
            "Relative tolerances of data-sheet values, each under the key of its value: for "
            "example, tolerance = { fs = '15 %' } is the tolerance of the key `fs`"
        ),
    )


DRIVER_UNITS = {
    "fs": "Hz", "re": "Ohm", "qms": "", "qes": "", "qts": "", "bl": "N/A", "mms": "kg",
    "cms": "m/N", "rms": "N s/m", "sd": "m2", "vas": "m3", "zmax": "Ohm", "mmd": "kg",
}  # fmt: skip
# Unit and description of each parameter of a loudspeaker's netlist.
DRIVER_PARAMETERS = {
    "fs": ("Hz", "resonance frequency in free air"),
    "re": ("Ohm", "DC resistance of the voice coil"),
    "qms": ("-", "mechanical Q factor"),
    "qes": ("-", "electrical Q factor"),
    "mms": ("kg", "moving mass with its air load"),
}


def compute_thiele_small(driver: Mapping[str, float]) -> dict[str, float]:
    """Compute all data-sheet values of a loudspeaker from six values.

    ``driver`` contains ``re``, ``bl``, ``mms``, ``cms``, ``rms`` and ``sd`` in SI units.
    """
    w = 1 / math.sqrt(driver["mms"] * driver["cms"])
    qms = w * driver["mms"] / driver["rms"]
    qes = w * driver["mms"] * driver["re"] / driver["bl"] ** 2
    return dict(driver) | {
        "fs": w / TWO_PI,
        "qms": qms,
        "qes": qes,
        "qts": qms * qes / (qms + qes),
        "vas": AIR_STIFFNESS * driver["sd"] ** 2 * driver["cms"],
        "zmax": driver["re"] * (1 + qms / qes),
        "mmd": driver["mms"] - 2 * compute_baffle_air_mass(driver["sd"]),
    }


def make_relation(key: str, names: tuple[str, ...]) -> Relation:
    """Return a function that computes one data-sheet value from other values.

    The function computes ``key`` from the values of ``names``.
    """
    area = {"sd": EXAMPLE_WOOFER["sd"]}
    return lambda values: compute_thiele_small(
        area | dict(zip(names, values.tolist(), strict=True))
    )[key]
