"""Parameters of subcircuits with their ranges: cards that check them, and samples of the ranges."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from itertools import product

import numpy as np

from kc2spice.netlist.circuit import Element, Param, Parameters
from kc2spice.netlist.elements import Line
from kc2spice.netlist.spelling import format_number
from kc2spice.rom.linear_model import LinearModel
from kc2spice.rom.ranges import ModelOverRanges

# Random points of the parameter range at which the emitted circuit is compared, in addition to its
# corners.
INSIDE = 6
RANGE_STOPS = """
* Outside of its range a parameter stops the simulator at these cards: nothing is extrapolated."""


def list_parameters(model: ModelOverRanges) -> list[Param]:
    """List the parameters that a model states, in the order of ``model.parameter_axes``."""
    result = []
    for name, axis in model.parameter_axes.items():
        default, unit = model.defaults.get(name, axis.middle), model.units.get(name, "-")
        words = model.descriptions.get(name) or name
        result.append(Param(name, default, unit, words, axis.low, axis.high))
    return result


def sample_range(
    model: ModelOverRanges, parameters: Sequence[Param]
) -> Iterator[tuple[LinearModel, dict[str, float]]]:
    """Yield the model at the corners of the range and at random points inside.

    Each model is paired with the values of the netlist's parameters.
    """
    corners = product((-1.0, 1.0), repeat=len(model.parameter_axes))
    inner = np.random.default_rng(7).uniform(-1.0, 1.0, (INSIDE, len(model.parameter_axes)))
    names = [p.name.lower() for p in parameters]
    for x in (*corners, *inner):
        axes = zip(model.parameter_axes.values(), x, strict=True)
        values = [axis.value(float(at)) for axis, at in axes]
        by_name = dict(zip(names, values, strict=True))
        yield model.at(dict(zip(model.parameter_axes, values, strict=True))), by_name


def parameter_card(name: str, expression: str) -> Parameters:
    """Return the ``.param`` card of an expression."""
    return Parameters({name: f"{{{expression}}}"})


def range_cards(parameters: Sequence[Param]) -> Iterator[Line]:
    """Yield ``.param`` cards that state whether each parameter is within its range."""
    yield "* 1 within the range of a parameter, -1 outside of it"
    for k, p in enumerate(parameters, 1):
        room = 1e-9 * (p.high - p.low)
        low, high = format_number(p.low - room), format_number(p.high + room)
        # two factors that are positive inside; || and && are spelled differently elsewhere
        yield parameter_card(f"inside{k}", f"(({p.name}-{low})*({high}-{p.name})>=0 ? 1 : -1)")


def range_stops(parameters: Sequence[Param], base: str) -> Iterator[Line]:
    """Yield resistors that stop the simulator if a parameter is out of range.

    A resistor has an ohm within the range of its parameter, and no number outside. The name of the
    resistor is the message.
    """
    for k, p in enumerate(parameters, 1):
        words = f"{p.name}_must_be_{p.low:.6g}_to_{p.high:.6g}"
        suffix = re.sub(r"\W", lambda c: {".": "p", "-": "m", "+": ""}[c[0]], words)
        yield Element.of(f"R{suffix}", "tick", base, f"{{sqrt(inside{k})}}")
