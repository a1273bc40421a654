"""Retry settings: named changes of a simulator's options, and the causes that they may cure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from kc2spice.netlist.cards import number
from kc2spice.netlist.deck import Deck
from kc2spice.sim.log import Kind

# "coarse": ngspice finished, but the energy balances of the result do not close.
Cause = Kind | Literal["coarse"]
_RELTOL, _CHGTOL = "1e-3", "1e-14"  # ngspice's own, where the deck says nothing


@dataclass(frozen=True)
class Settings:
    """Changes of a deck's own options: entries, and a factor on tolerances and step limit."""

    options: tuple[tuple[str, str], ...] = ()
    factor: float = 1.0

    def plus(self, other: Settings) -> Settings:
        """Both changes; ``other`` has the last word."""
        options = tuple((dict(self.options) | dict(other.options)).items())
        return Settings(options, self.factor * other.factor)

    def __str__(self) -> str:
        words = [f"{key}={value}" for key, value in self.options]
        if self.factor != 1.0:
            words.append(f"reltol, chgtol and largest step times {self.factor:g}")
        return ", ".join(words) or "unchanged"


@dataclass(frozen=True)
class RetrySetting:
    """One way to try again: ``cures`` are the causes that it is for, ``why`` it may help."""

    name: str
    settings: Settings
    cures: tuple[Cause, ...]
    why: str


FIRST = RetrySetting("the scene's own settings", Settings(), (), "")
# Measured on the kick at a penalty of 1e11 and 1e12 N/m, where the scene's own settings end in
# "timestep too small": firmer pivots finish at 1.2 to 2 times the cost a point; gear alone, tighter
# tolerances alone and more iterations never do. Gear on firmer pivots ends ringing at the last
# bit that makes the trapezoidal rule crawl, at about twice the error a step.
RETRIES = (
    RetrySetting(
        "firmer pivots",
        Settings((("pivrel", "0.1"),)),
        ("timestep", "singular"),
        "the pivots chosen at the first step lose the digits that short steps need",
    ),
    RetrySetting(
        "gear",
        Settings((("pivrel", "0.1"), ("method", "gear"))),
        ("timestep",),
        "the trapezoidal rule rings at switching edges and in stiff contact",
    ),
    RetrySetting(
        "tighter tolerances",
        Settings(factor=0.1),
        ("coarse", "timestep"),
        "the steps are too coarse for the contact",
    ),
    RetrySetting(
        "much tighter tolerances",
        Settings(factor=0.1),
        ("coarse",),
        "the steps are still too coarse for the contact",
    ),
)


def next_setting(cause: Cause | None, tried: tuple[str, ...]) -> RetrySetting | None:
    """The first retry setting for ``cause`` that was not tried; None where none is left."""
    fitting = (each for each in RETRIES if cause in each.cures and each.name not in tried)
    return next(fitting, None)


def with_settings(deck: Deck, retry: RetrySetting, settings: Settings) -> Deck:
    """``deck`` with ``settings`` instead of its own options."""
    if settings == Settings():
        return deck
    options = dict(settings.options)
    if settings.factor != 1.0:
        options["reltol"] = number(settings.factor * own_reltol(deck))
        options["chgtol"] = number(settings.factor * float(deck.option("chgtol") or _CHGTOL))
    changed = deck.with_options(options, f"retry with {retry.name}: {retry.why}")
    return changed.with_steps(settings.factor)


def own_reltol(deck: Deck) -> float:
    """The ``reltol`` of ``deck``."""
    return float(deck.option("reltol") or _RELTOL)
