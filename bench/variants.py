"""Decks of a transient scene with one thing changed, as points of speed against error."""

import re
from dataclasses import dataclass, replace

from bench.setup import changed
from kc2spice.netlist.card_parser import read_cards
from kc2spice.netlist.deck import Deck
from kc2spice.netlist.number_and_name_spelling import format_number
from kc2spice.workflow.decks import make_deck

RELTOL = (1e-3, 1e-4, 1e-5, 1e-2, 1e-6, 1e-7)
# reltol, chgtol [C], longest step [s], heights looked up: room left by a launch error of 1e-4.
FOR_1E_4 = ((1.5e-3, 2e-8, 50e-6, 101), (1.5e-3, 2e-8, 50e-6, 201), (2e-3, 1e-8, 50e-6, 101))
# Without inertia behind the contact: reltol, chgtol, heights, ringing of bodies, controller.
LAUNCH = (
    (2e-3, 1e-8, 91, "coarse", "ideal"), (1.5e-3, 1e-8, 91, "coarse", "ideal"),
    (1e-3, 1e-8, 91, "coarse", "ideal"), (1.5e-3, 1e-8, 91, "coarse", "opamps"),
    (1.5e-3, 2e-8, 101, "followed", "ideal"), (1.5e-3, 2e-8, 101, "followed", "opamps"),
)  # fmt: skip
SHORT = 1e-4  # s; explicit methods are for runs up to this length
NO_INERTIA = "ngspice, no inertia at the contact"
PAPER_STEP = 10e-6  # s, system step of the paper's co-simulation (3.5)


@dataclass(frozen=True)
class Variant:
    """A deck to run and its place in the plane."""

    family: str
    label: str
    deck: Deck
    note: str = ""


def variants(build, setup):
    """Decks of one reduced model: tolerances, methods, ceilings, lookups."""
    scene, catch = build.scene, build.scene.find_only_part("ring_magnet_coils")
    yield Variant("ngspice, as shipped", "unmodified scene", make_deck(build))
    for method, tolerances in (("trap", RELTOL), ("gear", RELTOL[:3])):
        for reltol in setup.some(tolerances, 2 if method == "trap" else 1):
            deck = _deck(build, {"solver.reltol": reltol, "solver.method": method})
            yield Variant(f"ngspice, {method}", f"{method}, reltol {reltol:g}", deck)
    for reltol, chgtol, ceiling, points in setup.some(FOR_1E_4, 1):
        ceiling = min(ceiling, scene.stop_time)
        keys = {"solver.reltol": reltol, "solver.max_step": ceiling}
        if catch is not None:
            keys[f"{catch.name}.points"] = points
        label = f"reltol {reltol:g}, chgtol {chgtol:g}, steps up to {ceiling * 1e6:g} us"
        label += f", {points} heights" if catch else ""
        deck = _option(_deck(build, keys), "chgtol", chgtol)
        yield Variant("ngspice, for 1e-4", label, deck)


def launches(build, setup):
    """Decks of a loop whose contact ports have no inertia: as it is, and for a launch alone."""
    yield Variant(NO_INERTIA, "no inertia, unmodified scene", make_deck(build))
    catch, control = (
        build.scene.find_only_part("ring_magnet_coils"),
        build.scene.find_only_part("pid"),
    )
    if catch is None or control is None:
        return
    for reltol, chgtol, points, ringing, form in setup.some(LAUNCH, 1):
        keys = {
            "solver.reltol": reltol, "solver.chgtol": chgtol, "solver.max_step": 15e-6,
            "solver.ringing": ringing, f"{catch.name}.points": points,
            f"{control.name}.form": form,
        }  # fmt: skip
        words = f"reltol {reltol:g}, chgtol {chgtol:g}, {points} heights, {ringing}, {form}"
        yield Variant(NO_INERTIA, f"no inertia, {words}", _deck(build, keys))


def fixed_steps(build):
    """The paper's fixed system step: ngspice with error control and watched contacts taken away."""
    deck = _deck(build, {"solver.max_step": PAPER_STEP})
    deck = _option(_option(deck, "trtol", 1e12), "chgtol", 1.0)
    unwatched, watches = re.subn(r"(?m)^Sedge.*\n(?:\+.*\n)*", "", deck.files["contact.lib"])
    assert watches, "no watched contacts"
    circuit = read_cards(unwatched, "contact.lib")
    parts = (
        replace(part, circuit=circuit, source=unwatched) if part.filename == "contact.lib" else part
        for part in deck.parts
    )
    deck = replace(deck, parts=tuple(parts))
    return Variant(
        "fixed 10 us steps", "fixed 10 us steps, as in the paper", deck,
        "no error control, except at the corners of the drive pulse",
    )  # fmt: skip


def _deck(build, keys):
    return make_deck(changed(build, keys))


def _option(deck, name, value):
    """``deck`` with one simulator option set to another value."""
    return deck.with_options({name: format_number(value)}, "of the benchmark")
