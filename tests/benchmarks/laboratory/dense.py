"""Plane ``dense``: one device as decoupled resonators and as generic exporters write it, in .ac."""

from functools import partial

import numpy as np

from kc2spice.netlist.deck import Deck
from kc2spice.sim.ngspice import run_deck
from kc2spice.spice.header import Header
from kc2spice.spice.realize import subcircuit
from laboratory.forms import FORMS, synthetic, with_form
from laboratory.points import Outcome, Plane, Point, Ratio, fastest, timed

PORTS = 7
# Name of the ratio, modes, frequencies, target. 30 is the order of the scenes' reduced chip, 348
# are first-order states. The small device needs many points to outlast start-up.
SIZES = (("30", 30, 5000, 5.0), ("348", 174, 20, 50.0))
QUICK_SIZES = (("30", 15, 50, 5.0), ("348", 30, 5, 50.0))
EQUAL = 1e-6


def dense(setup):
    """Time of an .ac sweep of each form, error against the closed form of the response."""
    points: list[Point] = []
    ratios: list[Ratio] = []
    for size, modes, frequencies, target in QUICK_SIZES if setup.quick else SIZES:
        model = synthetic(modes, PORTS)
        deck, exact = ac_deck(model, frequencies)
        found = {}
        for form in FORMS:
            setup.clock.progress("dense", None, f"{modes} modes, {form}")
            other = with_form(deck, model, form)
            repeats = 1 if modes > 100 and form != FORMS[0] else setup.repeats
            waves, time = timed(partial(run_deck, other, setup.work / "dense"), repeats, "children")
            error = _error(waves, exact)
            sources = sum(line.startswith("G") for line in other.files["kick.lib"].splitlines())
            facts = {"controlled sources": float(sources)}
            label = f"{modes} modes, {frequencies} frequencies, {form}"
            found[form] = Point(form, label, error, time, {"response": error}, facts)
        points += found.values()
        slow = fastest((found[form] for form in FORMS[1:]), {"response": EQUAL})
        ours = found[FORMS[0]]
        ratios.append(
            Ratio(
                f"dense_vs_resonator_{size}",
                None if slow is None else slow.time.median / ours.time.median,
                max(ours.error, ours.error if slow is None else slow.error), target,
                f"faster dense form over resonators, {modes} modes ({2 * modes} states), {PORTS} "
                f"ports, .ac at {frequencies} frequencies, whole process",
            )
        )  # fmt: skip
    notes = ("made-up devices of the chip's kind, resonances from 270 kHz to 30 MHz",)
    plane = Plane(
        "dense", "Forms of one device in .ac", "largest relative error of any response",
        "CPU time [s]", tuple(points), notes,
    )  # fmt: skip
    return Outcome((plane,), tuple(ratios))


def ac_deck(model, count):
    """Unit voltage on the anode over ``count`` frequencies to 1 MHz; displacements in closed form.

    The second result is (frequencies, rings) in um.
    """
    part = subcircuit(model.linear(), "kick", Header("forms", "0"))
    rings = [port.name for port in model.ports if port.kind == "mechanical"]
    step = 1e6 / count
    lines = [
        "* one device",
        f".include {part.filename}",
        "V1 anode 0 DC 0 AC 1",
        f"Xkick anode 0 {' '.join(rings)} 0 {part.name}",
        *(f"G{ring} {ring} 0 {ring} 0 1e-12" for ring in rings),
        f".ac lin {count} {step!r} 1e6",
        *(f".save v({ring})" for ring in rings),
        ".end",
        "",
    ]
    vectors = {ring: (f"v({ring.lower()})", 1.0) for ring in rings}  # fmt: skip
    frequency = np.linspace(step, 1e6, count)
    exact = 1e6 * model.transfer(frequency)[:, : len(rings), -1]
    return Deck(name="dense", text="\n".join(lines), vectors=vectors, parts=(part,)), exact


def _error(waves, exact):
    found = np.column_stack([values for name, values in waves.data.items() if name != "frequency"])
    return float((np.abs(found - exact) / np.abs(exact).max(axis=0)).max())
