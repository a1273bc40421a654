"""Decks of a transient scene with one thing changed, as points of speed against error."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace

from kc2spice.scene.need import need
from kc2spice.scene.schema import Scene
from kc2spice.spice.circuit import Deck
from kc2spice.workflow.decks import make_deck
from kc2spice.workflow.models import Models
from laboratory.forms import with_form
from laboratory.setup import Setup

RELTOL = (1e-3, 1e-4, 1e-5, 1e-2, 1e-6, 1e-7)
CHGTOL = (1e-7, 1e-9, 1e-10)
CEILINGS = (1e-6, 50e-6)
# reltol, chgtol [C], longest step [s], heights looked up: room left by a launch error of 1e-4.
FOR_1E_4 = ((1.5e-3, 2e-8, 50e-6, 101), (1.5e-3, 2e-8, 50e-6, 201), (2e-3, 1e-8, 50e-6, 101))
LOOKUPS = (51, 101, 401)
SHORT = 1e-4  # s; explicit methods and the densest form are for runs up to this length
AS_SHIPPED = "the scene as it is"
PAPER_STEP = 10e-6  # s, system step of the paper's co-simulation (3.5)


@dataclass(frozen=True)
class Variant:
    """A deck to run and its place in the plane."""

    family: str
    label: str
    deck: Deck
    note: str = ""


def variants(scene: Scene, models: Models, setup: Setup) -> Iterator[Variant]:
    """All decks of one reduced model: tolerances, methods, ceilings, lookups, realisations."""
    own = make_deck(scene, models)
    yield Variant("ngspice, as shipped", AS_SHIPPED, own)
    for method, tolerances in (("trap", RELTOL), ("gear", RELTOL[:3])):
        for reltol in setup.some(tolerances, 2 if method == "trap" else 1):
            deck = make_deck(_solver(scene, reltol=reltol, method=method), models)
            yield Variant(f"ngspice, {method}", f"{method}, reltol {reltol:g}", deck)
    for reltol in setup.some((1e-3, 1e-4), 1):
        for chgtol in setup.some(CHGTOL, 1):
            deck = _option(make_deck(_solver(scene, reltol=reltol), models), "chgtol", chgtol)
            yield Variant("ngspice, chgtol", f"reltol {reltol:g}, chgtol {chgtol:g}", deck)
    for ceiling in setup.some(CEILINGS, 0):
        deck = make_deck(_solver(scene, max_step=ceiling), models)
        yield Variant("ngspice, step ceiling", f"steps up to {ceiling * 1e6:g} us", deck)
    for reltol, chgtol, ceiling, points in setup.some(FOR_1E_4, 1):
        coarse = _lookup(_solver(scene, reltol=reltol, max_step=ceiling), points)
        label = f"reltol {reltol:g}, chgtol {chgtol:g}, steps up to {ceiling * 1e6:g} us"
        label += f", {points} heights" if scene.catch else ""
        deck = _option(make_deck(coarse, models), "chgtol", chgtol)
        yield Variant("ngspice, for 1e-4", label, deck)
    if scene.catch is not None:
        for points in setup.some(LOOKUPS, 1):
            deck = make_deck(_lookup(scene, points), models)
            yield Variant("ngspice, lookup", f"lookup of {points} heights", deck)
    model = need(models.kick, "kick").resonators
    forms: tuple[str, ...] = ("second order", "first order")
    if scene.solver.stop > SHORT and not setup.full_sweep:
        forms = forms[:1]  # the other takes minutes
    for form in setup.some(forms, 0):
        # Rounding in a dense chip is more than ngspice's own abstol of 1 pA lets pass as converged.
        deck = _option(with_form(own, model, form), "abstol", 1e-9)
        note = "as generic exporters write, abstol 1e-9"
        yield Variant("ngspice, dense", f"dense {form}", deck, note)
    deck = with_form(own, model, "resonators", behavioural=True)
    yield Variant("ngspice, behavioural", "behavioural sources", deck)


def fixed_steps(scene: Scene, models: Models) -> Variant:
    """The paper's fixed system step: ngspice with error control and watched contacts taken away."""
    deck = make_deck(_solver(scene, max_step=PAPER_STEP), models)
    deck = _option(_option(deck, "trtol", 1e12), "chgtol", 1.0)
    unwatched = re.sub(r"(?m)^Snear.*\n", "", deck.files["contact.lib"])
    deck = replace(deck, files={**deck.files, "contact.lib": unwatched})
    return Variant(
        "fixed 10 us steps", "fixed 10 us steps, as in the paper", deck,
        "no error control; the pulse's corners are still met",
    )  # fmt: skip


def _solver(scene: Scene, **changes: object) -> Scene:
    return scene.model_copy(update={"solver": scene.solver.model_copy(update=changes)})


def _lookup(scene: Scene, points: int) -> Scene:
    """``scene`` with its force, if it has one, looked up between so many heights."""
    if scene.catch is None:
        return scene
    return scene.model_copy(update={"catch": scene.catch.model_copy(update={"points": points})})


def _option(deck: Deck, name: str, value: float) -> Deck:
    """``deck`` with one simulator option set to another value, wherever it was set before."""
    card = f".options {name}={value!r}"
    text = re.sub(rf"\b{name}=\S+", "", deck.files[deck.main])
    text = text.replace("\n.tran ", f"\n{card}\n.tran ", 1)
    return replace(deck, files={**deck.files, deck.main: text})
