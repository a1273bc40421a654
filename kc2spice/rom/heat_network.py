"""Heat networks with one port, in Foster's form and in Cauer's form.

Foster's form is a chain of thermal resistances, each in parallel with a heat capacity::

    Z(s) = D + sum_k R_k / (1 + s t_k)          C_k = t_k / R_k

Cauer's form is a ladder of thermal resistances between nodes, with a heat capacity from each node
to the pin ``ambient``. A continued fraction converts Foster's form to Cauer's form::

    Z(s) = D + 1 / (s C_1 + 1 / (R_1 + 1 / (s C_2 + 1 / (R_2 + ...))))

The equations of the ladder contain the temperature drops ``x_k`` across the resistances, and the
sums ``S_k = C_1 + ... + C_k``::

    sum_j S_min(j,k) x_j' + x_k / R_k = q        T = sum_k x_k + D q

A linear model whose matrices have the form of the ladder equations is recognised as a heat ladder.
Sources: E. A. Guillemin, Synthesis of Passive Networks, 1957, chapter 4; JESD51-14.
"""

from __future__ import annotations

from dataclasses import dataclass
from decimal import Decimal, localcontext
from itertools import pairwise, zip_longest
from typing import Literal

import numpy as np

from kc2spice.core.domains import THERMAL
from kc2spice.core.equality import EqualByContent
from kc2spice.core.errors import UsageError, did_you_mean
from kc2spice.rom.linear_model import LinearModel, Port

NetworkForm = Literal["foster", "cauer"]
NETWORK_FORMS: tuple[NetworkForm, ...] = ("foster", "cauer")
# relative difference below which time constants count as equal: about a hundred times eps
EQUAL_TIME = 2e-14
# Precision of the continued fraction, in decimal digits for each time constant of the network.
# In each step of the continued fraction, cancellation removes at most 14 digits of the numerator
# and 14 digits of the denominator, so that 30 digits per time constant are sufficient.
# If two time constants agree in k digits, a step of the continued fraction loses k digits.
DIGITS_PER_MODE = 30


@dataclass(frozen=True, eq=False)
class FosterNetwork(EqualByContent):
    """Thermal resistances (n,) [K/W] in series, each in parallel with a heat capacity.

    ``time_constant`` (n,) [s] are the products of resistance and capacity. ``direct`` [K/W] is an
    additional resistance in series, without a heat capacity.

    Examples
    --------
    >>> network = FosterNetwork(np.array([1.0, 3.0]), np.array([0.1, 2.0]))
    >>> network.compute_step_response(np.array([0.0, 100.0]))
    array([0., 4.])
    """

    resistance: np.ndarray
    time_constant: np.ndarray
    direct: float = 0.0

    @property
    def total_resistance(self) -> float:
        """Thermal resistance [K/W] in the steady state."""
        return self.direct + float(self.resistance.sum())

    def compute_step_response(self, time: np.ndarray) -> np.ndarray:
        """Return the temperature rise (m,) [K] at times (m,) [s] after a step of 1 W."""
        rise = compute_step_basis(time, self.time_constant) @ self.resistance
        return np.asarray(self.direct * (time >= 0) + rise)

    def to_linear_model(self, port: Port) -> LinearModel:
        """Make the linear model whose unknowns are temperature drops across resistances."""
        return LinearModel(
            E=np.diag(self.time_constant / self.resistance),
            K=np.diag(1 / self.resistance),
            B=np.ones((len(self.resistance), 1)),
            D=np.array([[self.direct]]),
            ports=(port,),
        )

    def convert_to_ladder(self) -> HeatLadder:
        """Convert the network to Cauer's form by a continued fraction."""
        resistance, times = self._merge_equal_times()
        capacities, resistances = list[float](), list[float]()
        with localcontext() as context:
            context.prec = DIGITS_PER_MODE * (len(times) + 1)
            above, below = _add_modes(list(map(Decimal, resistance)), list(map(Decimal, times)))
            while above:
                capacity = below[-1] / above[-1]
                below = _subtract_polynomials(below, [Decimal(0), *(capacity * x for x in above)])
                drop = above[-1] / below[-1]
                above = _subtract_polynomials(above, [drop * x for x in below])
                capacities.append(float(capacity))
                resistances.append(float(drop))
        return HeatLadder(np.array(resistances), np.array(capacities), self.direct)

    def _merge_equal_times(self) -> tuple[np.ndarray, np.ndarray]:
        """Merge equal time constants; return resistances and time constants."""
        order = np.argsort(self.time_constant)
        times, resistance = self.time_constant[order], self.resistance[order]
        first = np.r_[True, np.diff(times) > EQUAL_TIME * times[1:]]
        return np.add.reduceat(resistance, np.flatnonzero(first)), times[first]


@dataclass(frozen=True, eq=False)
class HeatLadder(EqualByContent):
    """Cauer network: ladder of heat capacities (n,) [J/K] and resistances (n,) [K/W].

    The ladder connects the port to ``ambient``.

    ``direct`` [K/W] is a resistance between the port and the first capacity.
    """

    resistance: np.ndarray
    capacity: np.ndarray
    direct: float = 0.0

    def to_linear_model(self, port: Port) -> LinearModel:
        """Make the linear model whose unknowns are temperature drops across resistances."""
        number = np.arange(len(self.capacity))
        return LinearModel(
            E=np.cumsum(self.capacity)[np.minimum.outer(number, number)],
            K=np.diag(1 / self.resistance),
            B=np.ones((len(self.capacity), 1)),
            D=np.array([[self.direct]]),
            ports=(port,),
        )


def compute_step_basis(time: np.ndarray, time_constant: np.ndarray) -> np.ndarray:
    """Return unit step responses ``1 - exp(-t / t_k)`` of shape (times, modes).

    At negative times, the step responses are zero.
    """
    return np.asarray(-np.expm1(-np.maximum(time, 0.0)[:, None] / time_constant))


def find_heat_ladder(model: LinearModel) -> HeatLadder | None:
    """Return the heat ladder that a model represents, or None for other models."""
    one = len(model.ports) == 1 and model.ports[0].domain is THERMAL
    if not one or not model.symmetric or (model.B != 1).any():
        return None
    K, E = model.pencil.make_dense().coefficients[:2]
    conductance, content = np.diag(K), np.diag(E)
    number = np.arange(len(content))
    if (np.diag(conductance) != K).any() or (content[np.minimum.outer(number, number)] != E).any():
        return None
    capacity = np.diff(content, prepend=0.0)
    if len(number) < 2 or (conductance <= 0).any() or (capacity <= 0).any():
        return None
    return HeatLadder(1 / conductance, capacity, float(model.D[0, 0]))


def parse_network_form(form: str | None, where: str) -> NetworkForm | None:
    """Parse the name of a network form, Foster or Cauer; return None for None.

    Raises
    ------
    UsageError : the form does not exist.
    """
    if form is None:
        return None
    for known in NETWORK_FORMS:
        if form.lower() == known:
            return known
    raise UsageError(
        "this form of a thermal network does not exist",
        where=where,
        got=repr(form),
        expected=" or ".join(NETWORK_FORMS),
        hint=did_you_mean(form, NETWORK_FORMS)
        or f"leave out {where}, so that the form is {NETWORK_FORMS[0]}",
    )


def make_network_model(network: FosterNetwork, form: NetworkForm, port: Port) -> LinearModel:
    """Return the model of a network in Foster's or Cauer's form."""
    return (
        network.convert_to_ladder().to_linear_model(port)
        if form == "cauer"
        else network.to_linear_model(port)
    )


def _add_modes(
    resistance: list[Decimal], times: list[Decimal]
) -> tuple[list[Decimal], list[Decimal]]:
    """Sum the modes of a network; return numerator and denominator polynomials in s.

    The coefficients are in ascending powers of s.
    """
    above, below = list[Decimal](), [Decimal(1)]
    for R, t in zip(resistance, times, strict=True):
        above = _add_polynomials(_multiply_by_time_constant(above, t), [R * x for x in below])
        below = _multiply_by_time_constant(below, t)
    return above, below


def _multiply_by_time_constant(polynomial: list[Decimal], t: Decimal) -> list[Decimal]:
    """Multiply a polynomial in s by ``1 + s t`` with the time constant t."""
    if not polynomial:
        return []
    inner = [high + t * low for low, high in pairwise(polynomial)]
    return [polynomial[0], *inner, t * polynomial[-1]]


def _add_polynomials(first: list[Decimal], second: list[Decimal]) -> list[Decimal]:
    """Add two polynomials whose coefficients are in ascending powers of s."""
    return [a + b for a, b in zip_longest(first, second, fillvalue=Decimal(0))]


def _subtract_polynomials(first: list[Decimal], second: list[Decimal]) -> list[Decimal]:
    """Return the difference of two polynomials whose terms of highest degree cancel."""
    return _add_polynomials(first, [-x for x in second])[:-1]
