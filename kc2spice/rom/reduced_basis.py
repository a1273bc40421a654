"""The full-order model in the coordinates of a basis: reduced-order models of every order."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from kc2spice.core.errors import SimulationError
from kc2spice.rom.entries import Entries
from kc2spice.rom.error_estimate import Judge, above_band
from kc2spice.rom.intermediate import Subspace
from kc2spice.rom.linear import Certificate, LinearModel, Norm
from kc2spice.rom.pencil import Pencil
from kc2spice.rom.response import FLANK, SHARPEST, Response
from kc2spice.rom.stability import Structure, structure

ROUNDING = 1e-11  # no estimate says less: direct solutions are hardly better in the response
DIGITS = 4.0  # times rounding over a damping ratio: how well any solution knows that resonance
SAFETY = 1.15  # on differences at samples, for what lies between them


@dataclass(frozen=True)
class Reduction:
    """The subspace model in ordered directions, so that the model of order q is its leading part,
    and the ``judge`` of their errors, who knows the subspace model in coordinates that may
    decouple. ``first`` directions are free motions and the static answers that conservative ports
    keep.
    """

    full: LinearModel
    pencil: Pencil
    space: Subspace
    judge: Judge
    first: int = 0
    origin: str = ""
    balanced: bool = False

    def states(self, order: int) -> int:
        """First-order states of the model of this order."""
        return order * self.pencil.degree

    @property
    def relaxing(self) -> bool:
        """Whether the model is of first order and symmetric, as a network of resistors and
        capacitors is: a congruence keeps its real poles and its passivity."""
        pencil = self.pencil
        return pencil.degree == 1 and pencil.symmetric and pencil.collocated

    @property
    def size(self) -> int:
        """Largest order."""
        return self.pencil.size

    def error(self, order: int, limit: float = np.inf) -> float:
        """Estimated largest relative error of any transfer function over the band; above ``limit``
        something that shows it."""
        error = self.judge.error(self.leading(order), (limit - self.space.error) / SAFETY)
        return max(self.space.error + SAFETY * error, ROUNDING)

    def structure(self, order: int) -> Structure:
        """Stability and passivity of the model of this order."""
        result = self.leading(order)
        return structure(result.pencil, self.judge.band, None if result.decoupled else result.poles)

    def leading(self, order: int) -> Response:
        """Response of the model of this order."""
        if order not in self._models:
            self._models[order] = Response(self.pencil.leading(order))
        return self._models[order]

    @cached_property
    def _models(self) -> dict[int, Response]:
        return {}

    @cached_property
    def _keeps(self) -> bool:
        """Whether smaller models must be stable: a stable subspace model must not lose that."""
        return self.balanced or self.structure(self.size).stable is not False

    def good(self, order: int, tolerance: float) -> bool:
        """Whether the model of this order is within the tolerance, and as stable as it must be."""
        if not self.error(order, tolerance) <= tolerance:
            return False
        stable = self.structure(order).stable
        return bool(stable) if self.balanced else stable is not False or not self._keeps

    def fewest(self, tolerance: float, states: float = np.inf) -> int | None:
        """The least :meth:`good` order of those with fewer first-order ``states``; None where there
        is none."""
        most = int(min(self.size, (states - 1) // self.pencil.degree))
        orders = range(max(self.first, 1), most + 1)
        return next((order for order in orders if self.good(order, tolerance)), None)

    def model(self, order: int) -> LinearModel:
        """The reduced model with its certificate."""
        answer, judge, model = self.structure(order), self.judge, self.full
        response, error = self.leading(order), self.error(order) + self.space.floor
        count, parts = self.space.pencil.size, response.pencil.coefficients
        method = f"{self.origin}difference to {count} states at resonances, flanks and notches"
        if self.space.proof:
            method += f"; those {self.space.proof}; stability from {answer.proof}"
        method += _zeros(judge.reference[1], model)
        if not self.space.static or self.space.pencil.free:
            method += "; free to move at zero frequency"
            if hidden := self.space.hidden:
                method += f", supports that resonate below {hidden:.1e} Hz being hidden by rounding"
        ratio = judge.exact.visible(judge.band)[1].min(initial=1.0)
        if ratio < SHARPEST:
            method += f"; beside resonances, by {FLANK:g}, of a damping ratio below {SHARPEST:g}"
        if not np.isfinite(error):
            raise SimulationError(
                "the reduced model has a state that nothing holds, slows or carries",
                where=model.name,
                got="sizes that double precision cannot tell from zero",
                hint="another order or a tolerance; units in which its entries are closer in size",
            )
        rounding = max(ROUNDING, DIGITS * float(np.finfo(float).eps) / max(ratio, SHARPEST))
        above = above_band(model.ports, judge.exact, response, judge.band)
        certificate = Certificate(
            judge.band,
            max(error, rounding),
            method,
            answer.stable,
            answer.passive,
            above,
            judge.norm,
        )
        first = {"A": -parts[0], "E": parts[1]}
        result = LinearModel(
            **(first if parts[2:] == () else dict(zip("KEM", parts, strict=True))),
            **{letter: getattr(response.pencil, letter) for letter in "BCD"},
            **{key: getattr(model, key) for key in ("ports", "facts", "name")},
            certificate=certificate,
            band=judge.band,
        )
        result.state_space()  # refuses what no netlist can hold before it is certified
        return result


LISTED_ZEROS = 6  # entries that a certificate lists


def _zeros(entries: Entries, model: LinearModel) -> str:
    """Entries that count as zero, for the certificate."""
    places = zip(*np.nonzero(entries.zero), strict=True)
    names = [f"{model.outputs[i]}/{model.inputs[j]}" for i, j in places]
    if not names:
        return ""
    more = f" and {len(names) - LISTED_ZEROS} more" if len(names) > LISTED_ZEROS else ""
    return f"; zero by symmetry: {', '.join(names[:LISTED_ZEROS])}{more}"


def subspace_model(
    model: LinearModel, space: Subspace, band: tuple[float, float], norm: Norm
) -> Reduction:
    """The subspace model as it is, before its directions are ordered."""
    return Reduction(model, space.pencil, space, space.judge(band, norm))
