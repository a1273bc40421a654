"""What every nonlinear or switched law is: smooth within a mode that guards end."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np

from kc2spice.core.laws.pin import Pin


@dataclass(frozen=True)
class Tap:
    """An input of a device: across of ``pin`` less those of ``minus`` and ``less``, or its rate."""

    pin: str
    minus: str = ""
    rate: bool = False
    less: str = ""


@dataclass(frozen=True)
class Flow:
    """An output of a device: a through quantity into it at ``pin``, out of it at ``minus``, and as
    much at ``less``."""

    pin: str
    minus: str = ""
    less: str = ""


class Device(ABC):
    """A nonlinear or switched law; subclasses are frozen dataclasses with a ``name``.

    With the taps and then the own states as its inputs ``e`` (m,), in a mode that is any value::

        out = [through of every flow, rate of every state's store, value of every signal it drives]
        d/dt store(e) = rate,   store(e) = the states themselves unless said otherwise

    Flows that are ``charged`` are the rates of further entries of ``store`` besides.
    A mode lasts while every guard is positive.
    """

    name: str

    @property
    @abstractmethod
    def pins(self) -> tuple[Pin, ...]:
        """All pins."""

    @property
    @abstractmethod
    def taps(self) -> tuple[Tap, ...]:
        """What it sees."""

    @property
    def flows(self) -> tuple[Flow, ...]:
        """What it exerts."""
        return ()

    @property
    def charged(self) -> tuple[int, ...]:
        """Places of the flows to which the rate of a stored quantity adds, such as a charge's."""
        return ()

    @property
    def states(self) -> tuple[str, ...]:
        """Names of its own states."""
        return ()

    @property
    def drives(self) -> tuple[str, ...]:
        """Signal pins that it sets."""
        return ()

    @property
    def scales(self) -> tuple[float, ...]:
        """Sizes of the states that errors are judged by."""
        return (1.0,) * len(self.states)

    @property
    def affine(self) -> bool:
        """Whether ``evaluate`` is affine in ``e`` and constant in time within a mode."""
        return False

    def initial(self, taps: np.ndarray) -> np.ndarray | None:
        """States at the start (len(states),), given the taps then; None: those in equilibrium."""
        return None

    @abstractmethod
    def evaluate(self, t: float, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """``out`` (k,) and its derivative (k, m) by ``e``."""

    def store(self, e: np.ndarray, mode: Any = None) -> tuple[np.ndarray, np.ndarray]:
        """Stored quantities (len(states) + len(charged),) and their derivatives by ``e``."""
        k, m = len(self.states), len(e)
        return e[m - k :], np.eye(k, m, m - k)

    def small(self, s: complex, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of ``out`` (k, m) and of the store (len(states), m) for small signals
        ``exp(s t)`` about ``e``; complex where they depend on the frequency."""
        return self.evaluate(0.0, e, mode)[1], self.store(e, mode)[1]

    def mode(self, t: float, e: np.ndarray, before: Any = None) -> Any:
        """Mode at ``t``: the first one, or after one of its own corners or a switched guard."""
        return None

    def corners(self, stop: float) -> np.ndarray:
        """Times at which the mode is asked for anew."""
        return np.empty(0)

    def guards(self, t: float, e: np.ndarray, mode: Any) -> np.ndarray:
        """(g,) values that are positive within the mode."""
        return np.empty(0)

    def switch(self, mode: Any, guard: int) -> tuple[Any, str]:
        """Mode after ``guard`` fell to zero, and the words of the event ('' keeps it quiet)."""
        return mode, ""

    def check(self, t: float, e: np.ndarray) -> None:  # noqa: B027 (most laws hold anywhere)
        """Raise SimulationError where the inputs leave the law's range."""

    def energy(self, e: np.ndarray, mode: Any) -> float:
        """Energy stored [J]."""
        return 0.0

    def loss(self, t: float, e: np.ndarray, mode: Any) -> float:
        """Power that it turns into heat [W]; negative for what it brings in from outside."""
        return 0.0

    def stores(self, first: np.ndarray, last: np.ndarray, mode: Any) -> float | None:
        """Energy [J] that is stored between two instants of a mode where :meth:`loss` is all power
        that comes in; None where it is that of heat."""
        return None

    @property
    def extra(self) -> tuple[str, ...]:
        """Names of further quantities to record as ``NAME.EXTRA``."""
        return ()

    def waves(self, t: float, e: np.ndarray, mode: Any) -> dict[str, float]:
        """Their values."""
        return {}


def inside(value: float, low: float, high: float, side: int) -> tuple[float, float]:
    """Guards of a clip: towards its low and its high limit while inside, back while outside."""
    if side == 0:
        return value - low, high - value
    return (low - value, 1.0) if side < 0 else (1.0, value - high)
