"""The rungs of the retry ladder: named changes of ngspice's settings, and a deck that has them."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import Literal

from kc2spice.sim.log import Kind
from kc2spice.spice.cards import comment, number
from kc2spice.spice.circuit import Deck

# "coarse": ngspice finished, but the energy books of the result do not balance.
Cause = Kind | Literal["coarse"]
_ANALYSIS = re.compile(r"(?im)^\s*\.(tran|ac|dc|op)\b.*$")
_RELTOL, _CHGTOL = 1e-3, 1e-14  # ngspice's own, where the deck says nothing


@dataclass(frozen=True)
class Settings:
    """Changes on top of a deck's own options: cards, and a factor on tolerances and step limit."""

    options: tuple[tuple[str, str], ...] = ()
    closer: float = 1.0

    def plus(self, other: Settings) -> Settings:
        """Both changes; ``other`` has the last word."""
        options = tuple((dict(self.options) | dict(other.options)).items())
        return Settings(options, self.closer * other.closer)

    def __str__(self) -> str:
        words = [f"{key}={value}" for key, value in self.options]
        if self.closer != 1.0:
            words.append(f"reltol, chgtol and largest step times {self.closer:g}")
        return ", ".join(words) or "unchanged"


@dataclass(frozen=True)
class Rung:
    """One way to try again: ``cures`` are the causes that it is for, ``why`` it may help."""

    name: str
    settings: Settings
    cures: tuple[Cause, ...]
    why: str


FIRST = Rung("the scene's own settings", Settings(), (), "")
# Measured on the kick at a penalty of 1e11 and 1e12 N/m, where the scene's own settings end in
# "timestep too small": firmer pivots finish at 1.2 to 2 times the cost a point; gear alone, closer
# tolerances alone and more iterations never do. Gear on firmer pivots ends ringing at the last
# bit that makes the trapezoidal rule crawl, at about twice the error a step.
RUNGS = (
    Rung(
        "firmer pivots",
        Settings((("pivrel", "0.1"),)),
        ("timestep", "singular"),
        "the pivots chosen at the first step lose the digits that short steps need",
    ),
    Rung(
        "gear",
        Settings((("pivrel", "0.1"), ("method", "gear"))),
        ("timestep",),
        "the trapezoidal rule rings at switching edges and in stiff contact",
    ),
    Rung(
        "closer tolerances",
        Settings(closer=0.1),
        ("coarse", "timestep"),
        "the steps are too coarse for the contact",
    ),
    Rung(
        "much closer tolerances",
        Settings(closer=0.1),
        ("coarse",),
        "the steps are still too coarse for the contact",
    ),
)


def next_rung(cause: Cause | None, tried: tuple[str, ...]) -> Rung | None:
    """The first rung for ``cause`` that was not tried; None where nothing is left to try."""
    fitting = (rung for rung in RUNGS if cause in rung.cures and rung.name not in tried)
    return next(fitting, None)


def with_settings(deck: Deck, rung: Rung, settings: Settings) -> Deck:
    """``deck`` with ``settings`` behind its own options, where they have the last word."""
    if settings == Settings():
        return deck
    text = deck.files[deck.main]
    options = dict(settings.options)
    if settings.closer != 1.0:
        options["reltol"] = number(settings.closer * own_reltol(deck))
        options["chgtol"] = number(settings.closer * _own(text, "chgtol", _CHGTOL))
    cards = [f"* Retry ladder, rung {comment(rung.name)!r}: {comment(rung.why)}"]
    cards += [f".options {key}={value}" for key, value in options.items()]

    def replaced(match: re.Match[str]) -> str:
        return "\n".join([*cards, _limited(match[0], settings.closer)])

    changed = _ANALYSIS.sub(replaced, text, count=1)
    return replace(deck, files=deck.files | {deck.main: changed})


def own_reltol(deck: Deck) -> float:
    """The last ``reltol`` among the options of ``deck``."""
    return _own(deck.files[deck.main], "reltol", _RELTOL)


def _own(text: str, key: str, default: float) -> float:
    found = re.findall(rf"(?im)^\s*\.opt\w*\b.*\b{key}\s*=\s*([-+0-9.eE]+)", text)
    return float(found[-1]) if found else default


def _limited(card: str, factor: float) -> str:
    """A ``.tran step stop start limit`` card with its limit times ``factor``."""
    words = card.split()
    if factor != 1.0 and words[0].lower() == ".tran" and len(words) > 4:
        words[4] = number(factor * float(words[4]))
    return " ".join(words)
