"""Sections that say what a result must keep: truth checks of every run, gates of a verification."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from kc2spice.core.quantities import GateLength, GateTime, Ratio, Section

Action = Literal["fail", "warn", "off"]


class Checks(Section):
    """What becomes of a run whose result violates a check: it fails (exit 5), warns, or neither."""

    energy: Action = Field("fail", description="books of sphere, contact and chip")
    touches: Action = Field("fail", description="of a kick before it throws, against solver.reltol")
    range: Action = Field("fail", description="sphere in the field table, contact within the rings")
    penetration: Action = Field("warn", description="of sphere and chip, against the ring gaps")
    saturation: Action = Field("warn", description="share of the time at the current limit")


class Gates(Section):
    """Largest errors that a result may have; those with a dimension must be given with a unit."""

    launch_velocity: Ratio = Field(1e-4, gt=0, description="relative, ngspice against scipy")
    trajectory: GateLength = Field(  # type: ignore[assignment]  # validated like a file's value
        default="1 um", gt=0, description="largest, ngspice against scipy"
    )
    launch_full_model: Ratio = Field(1e-3, gt=0, description="relative, against the full model")
    position: Ratio = Field(1e-4, gt=0, description="of the travel in an impact, any two roads")
    rebound_velocity: Ratio = Field(1e-4, gt=0, description="relative, any two roads")
    separation_time: GateTime = Field(  # type: ignore[assignment]
        default="20 ns", gt=0, description="end of the impact, any two roads"
    )
    energy: Ratio = Field(1e-4, gt=0, description="unexplained part of the energy turned over")
    imprint_rom: Ratio = Field(1e-9, gt=0, description="static force, ROM against full model")
    imprint_ngspice: Ratio = Field(1e-6, gt=0, description="static force, ngspice against full")
    harmonic_rom: Ratio = Field(1e-4, gt=0, description="response over the band, ROM against full")
    harmonic_low: Ratio = Field(1e-8, gt=0, description="the same below a fifth of the band")
    harmonic_ngspice: Ratio = Field(1e-8, gt=0, description="response, ngspice against the ROM")
    superposition: Ratio = Field(1e-12, gt=0, description="EM force, brute force to coefficients")
    lookup_slope: Ratio = Field(
        0.05, gt=0, description="jump of the EM lookup's slope, of the largest"
    )
    lookup: Ratio = Field(1e-4, gt=0, description="EM force, ngspice lookup to largest FE force")
