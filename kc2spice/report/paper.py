"""What Schütz et al. 2021 print, next to the same quantity here."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from kc2spice.report.html import Section
from kc2spice.report.words import fact


@dataclass(frozen=True)
class Printed:
    """A number of the paper: where it stands, what it is, and the key of ours.

    ``key`` is looked up in the values that :func:`paper_section` is given; its suffix is the unit.
    """

    where: str
    what: str
    key: str
    paper: float | None
    note: str = ""


TIMES = "another machine, 2021"

PRINTED: dict[str, tuple[Printed, ...]] = {
    "harmonic": (
        Printed("3.2", "equations of the full model", "unknowns", 16702),
        Printed("3.2", "order of the reduced model", "rom_order", 30),
        Printed("3.2.1", "frequency of the main peak", "peak_hz", 250e3, "about, from Fig. 7"),
        Printed("3.2.1", "full model, 200 frequencies", "full_wall_s", 327.0, TIMES),
        Printed("3.2.1", "reduced model, 200 frequencies", "rom_wall_s", 45.0e-3, TIMES),
    ),
    "imprint": (
        Printed("4", "largest relative error of the force", "rom_error", 1e-5, "less than"),
        Printed("3.2.2", "full model, one step", "full_step_wall_s", 8.206, TIMES),
        Printed("3.2.2", "reduced model, one step", "rom_step_wall_s", 21.96e-3, TIMES),
    ),
    "impact": (
        Printed("3.2.3", "sphere leaves contact", "separation_time_s", 11e-6, "circa"),
        Printed("3.2.3", "full model, 15 µs in 50 ns steps", "full_wall_s", 10675.0, TIMES),
        Printed("3.2.3", "reduced model, the same steps", "rom_wall_s", 5.983, TIMES),
    ),
    "kick_and_catch": (
        Printed("3.3", "sphere stabilised at 2.5 mm", "settling_time_s", 3e-3, "read as ±5 %"),
        Printed("2.4", "set point", "setpoint_m", 2.5e-3),
        Printed("3.3", "5 ms at system level", "simulate_wall_s", 0.515, "10 µs steps; 2021"),
    ),
}


def paper_section(scene: str, values: Mapping[str, Any]) -> Section:
    """Table "paper / here" of one scene; a quantity that ``values`` lacks is left out."""
    rows = [
        (p.where, p.what, fact(p.key, p.paper)[1], fact(p.key, values[p.key])[1], p.note)
        for p in PRINTED.get(scene, ())
        if p.key in values
    ]
    head = ("section", "quantity", "paper", "here", "")
    return Section(f"{scene}: paper and here", rows, head)
